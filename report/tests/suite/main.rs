//! Pages of reports.

mod comparison_report;
mod diagnosis_report;
#[path = "../../../ident/tests/suite/support/mod.rs"]
mod flights;
mod runs;
mod support;
