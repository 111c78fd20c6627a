//! A vehicle as a functional mock-up unit (FMU) for co-simulation, after FMI 3.0
//! (<https://fmi-standard.org/docs/3.0/>).
//!
//! An FMU is an archive of a description in XML and a shared library. [`write_archive`] packs the vehicle file
//! itself, and the library that this crate is when it is built as one. The library reads the vehicle file and
//! simulates it with the same simulator, so that a tool gets the motion of the plant, bit for bit, without a
//! compiler.
//!
//! Values are in SI, as everywhere in memory; the description names the file's own units for display.

mod archive;
mod c_interface;
mod contents;
mod description;
mod instance;
mod library;
mod variables;

pub use archive::{ExportError, write_archive};
pub use contents::Settings;
pub use library::{LIBRARY, LibraryError, find_library};
