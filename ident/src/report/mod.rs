//! Reports: one self-contained HTML file with zoomable plots. See `docs/report.md`.

mod decimate;
pub mod page;
pub mod plot;

pub use decimate::decimate;
