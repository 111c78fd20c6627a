//! Vehicle files: TOML in the user's units, described in `docs/vehicle-file.md`.

mod axes;
mod copies;
mod free;
mod map;
mod read;
mod table;
pub(crate) mod text;
mod write;
