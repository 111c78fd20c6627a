//! Vehicle files: TOML in the user's units, described in `docs/vehicle-file.md`.

mod axes;
mod free;
mod map;
mod read;
mod table;
mod text;
mod write;
