//! The shared library of this platform: its location beside the executable, and its name in an archive.

use std::path::{Path, PathBuf};

macro_rules! named {
    ($prefix:literal, $suffix:literal) => {
        /// File name of the shared library, beside the executable.
        pub const LIBRARY: &str = concat!($prefix, "whirlstand_fmu", $suffix);
        /// Suffix of a shared library's name on this platform.
        pub(crate) const SUFFIX: &str = $suffix;
    };
}

#[cfg(not(any(target_os = "macos", target_os = "windows")))]
named!("lib", ".so");
#[cfg(target_os = "macos")]
named!("lib", ".dylib");
#[cfg(target_os = "windows")]
named!("", ".dll");

/// This platform's folder below `binaries`, as the standard names it (FMI 3.0, 2.5.1.4.1).
#[cfg(target_os = "macos")]
pub(crate) const PLATFORM: &str = match cfg!(target_arch = "aarch64") {
    true => "aarch64-darwin",
    false => "x86_64-darwin",
};
#[cfg(target_os = "windows")]
pub(crate) const PLATFORM: &str = "x86_64-windows";
#[cfg(not(any(target_os = "macos", target_os = "windows")))]
pub(crate) const PLATFORM: &str = match cfg!(target_arch = "aarch64") {
    true => "aarch64-linux",
    false => "x86_64-linux",
};

/// The reason why the library cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum LibraryError {
    /// Not found.
    #[error(
        "there is no {LIBRARY} beside {executable}, and an FMU contains it: `cargo build --release` in Whirlstand's source \
         makes both in target/release; copy it from there"
    )]
    Missing {
        /// The executable.
        executable: PathBuf,
    },
    /// It cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The library.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// Reads the library that was built with `executable`: beside it, or where cargo leaves it when only the
/// executable was built.
///
/// # Errors
/// [`LibraryError`] when there is none.
pub fn find_library(executable: &Path) -> Result<Vec<u8>, LibraryError> {
    let folder = executable.parent().unwrap_or(Path::new(""));
    // Cargo always writes the library in deps; the one beside the executable may be from an earlier build.
    let places = [folder.join("deps").join(LIBRARY), folder.join(LIBRARY)];
    let Some(path) = places.into_iter().find(|path| path.is_file()) else {
        return Err(LibraryError::Missing { executable: executable.into() });
    };
    std::fs::read(&path).map_err(|source| LibraryError::Read { path, source })
}
