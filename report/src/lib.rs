//! Reports: one self-contained HTML file with zoomable plots. See `docs/report.md`.

mod campaign_page;
mod comparison_page;
mod correlation;
mod design_page;
mod diagnosis_page;
mod diagnosis_signals;
mod diagnosis_tables;
mod figures_table;
mod identification_page;
mod labels;
mod outcome;
mod packed;
pub mod page;
pub mod plot;
mod run_events;
mod run_page;
mod run_signals;
mod run_spectra;
mod text_diff;
mod tune_page;
mod winner;

pub use campaign_page::{CampaignReport, campaign_report};
pub use comparison_page::comparison_report;
pub use design_page::{DesignReport, design_report};
pub use diagnosis_page::diagnosis_report;
pub use identification_page::identification_report;
pub use outcome::{Expected, Outcome};
pub use run_page::run_report;
pub use tune_page::{Fan, LawLine, TuneReport, tune_report};
pub use winner::winner;

/// Reason why a report cannot be put together: the error of the template engine. The template is part of the
/// program, so this is a bug of the program.
#[derive(Debug, thiserror::Error)]
#[error("the report's template failed, which is a bug in this program: {0}")]
pub struct ReportError(#[from] minijinja::Error);
