//! The report of a diagnosis: the verdict, what was gained, the causes.

use super::ReportError;
use super::page::{Attachment, Cell, Level, Page, Row, Section, Table};
use crate::diagnose::{Diagnosis, Verdict};
use crate::units::{number, shown_factor, shown_unit};

/// The report as one HTML text.
///
/// # Errors
/// [`ReportError`], which would be a bug.
pub fn diagnosis_report(answer: &Diagnosis) -> Result<String, ReportError> {
    let attachments = answer
        .extended
        .iter()
        .map(|v| Attachment { title: "extended vehicle file".into(), text: v.to_toml() })
        .collect();
    Page {
        kind: "diagnosis".into(),
        title: answer.vehicle.clone(),
        verdict: answer.summary.clone(),
        level: match answer.verdict {
            Verdict::Consistent | Verdict::Explained => Level::Good,
            Verdict::PartlyExplained | Verdict::Inconclusive => Level::Warn,
            Verdict::Unexplained => Level::Bad,
        },
        remarks: answer.advice.iter().map(|a| (Level::Neutral, a.clone())).collect(),
        sections: vec![gains(answer)],
        facts: vec![("records".into(), answer.records.join(", "))],
        attachments,
    }
    .to_html()
}

fn gains(answer: &Diagnosis) -> Section {
    let head = ["output", "fit before, %", "fit after, %", "error before", "error after", "noise"];
    let rows = answer.outputs.iter().map(|(name, o)| {
        let factor = shown_factor(&o.unit);
        let percent = |v: Option<f64>| Cell::new(v.map_or("-".into(), |v| format!("{v:.1}")));
        let value = |v: Option<f64>| Cell::new(v.map_or("-".into(), |v| number(v * factor)));
        Row {
            label: format!("{name}, {}", shown_unit(&o.unit)),
            group: false,
            cells: vec![
                percent(o.fit_before),
                percent(o.fit_after),
                value(o.rmse_before),
                value(o.rmse_after),
                value(Some(o.noise_floor)),
            ],
        }
    });
    Section {
        title: "What is gained on held-out data".into(),
        tables: vec![Table {
            head: head.iter().map(|h| h.to_string()).collect(),
            rows: rows.collect(),
            note: String::new(),
        }],
        ..Section::default()
    }
}
