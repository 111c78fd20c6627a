//! Functions that are compiled to the same code are linked once, where the linker can do that: generic code of many
//! types is a thirtieth of the executable.

use std::path::Path;
use std::process::{Command, Stdio};

const FOLD: &str = "-Wl,--icf=all";

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    if folds() == Some(true) {
        println!("cargo:rustc-link-arg-bins={FOLD}");
    }
}

/// Whether the linker knows the option: that of Rust's own distribution does, others of the same target do not.
fn folds() -> Option<bool> {
    let variable = |name: &str| std::env::var(name).ok();
    let out = variable("OUT_DIR")?;
    let program = Path::new(&out).join("empty.rs");
    std::fs::write(&program, "fn main() {}").ok()?;
    let mut rustc = Command::new(variable("RUSTC")?);
    rustc.arg(program).args([
        "--target",
        &variable("TARGET")?,
        "--out-dir",
        &out,
        "-C",
        &format!("link-arg={FOLD}"),
    ]);
    if let Some(linker) = variable("RUSTC_LINKER") {
        rustc.args(["-C", &format!("linker={linker}")]);
    }
    rustc.args(
        variable("CARGO_ENCODED_RUSTFLAGS").unwrap_or_default().split('\x1f').filter(|flag| !flag.is_empty()),
    );
    Some(rustc.stdout(Stdio::null()).stderr(Stdio::null()).status().ok()?.success())
}
