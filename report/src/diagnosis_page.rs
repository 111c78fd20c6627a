//! The report of a diagnosis: the verdict, the evidence of each cause, the gain in accuracy, and the signals of
//! each output.

use super::ReportError;
use super::diagnosis_signals::{evidence, output};
use super::diagnosis_tables::{causes, gains, not_testable, refitted, rejected};
use super::page::{Attachment, Level, Page, Section};
use super::text_diff::changed_lines;
use whirlstand_diagnose::{Diagnosis, Verdict};
use whirlstand_logs::shown::{instant, number};

/// The report of a diagnosis as one HTML text.
///
/// # Errors
/// [`ReportError`], which would be a bug.
pub fn diagnosis_report(answer: &Diagnosis) -> Result<String, ReportError> {
    let mut sections = Vec::new();
    let shown = evidence(answer, true);
    if !shown.is_empty() {
        sections.push(Section {
            title: "What the record shows".into(),
            text: "The residual without the cause, traced back through the model to the place where the cause acts. \
                   Points: means of the record. Line: prediction of the cause, processed in the same way."
                .into(),
            columns: 2,
            plots: shown,
            ..Section::default()
        });
    }
    sections.extend(causes(answer));
    sections.extend(vehicle(answer));
    sections.extend(refitted(answer));
    sections.push(gains(answer));
    sections.extend(answer.figures.outputs.iter().map(|o| output(answer, o)));
    sections.extend(left(answer));
    sections.extend(not_testable(answer));
    let attachment = |title: &str, text: String| Attachment { title: title.into(), text };
    let mut attachments = Vec::new();
    attachments.extend(answer.extended.iter().map(|v| attachment("extended vehicle file", v.to_toml())));
    attachments.push(attachment("given vehicle file", answer.figures.given_vehicle.clone()));
    Page {
        kind: "diagnosis".into(),
        title: format!("{} compared with {}", names(&answer.records), answer.vehicle),
        verdict: answer.summary.clone(),
        level: match answer.verdict {
            Verdict::Consistent | Verdict::Explained => Level::Good,
            Verdict::PartlyExplained | Verdict::Inconclusive => Level::Warn,
            Verdict::Unexplained => Level::Bad,
        },
        remarks: remarks(answer),
        sections,
        facts: facts(answer),
        attachments,
        ..Page::default()
    }
    .to_html()
}

fn names(records: &[String]) -> String {
    let names: Vec<&str> = records.iter().map(|r| r.rsplit('/').next().unwrap_or(r)).collect();
    names.join(", ")
}

fn remarks(answer: &Diagnosis) -> Vec<(Level, String)> {
    let data = answer
        .data
        .iter()
        .map(|d| (if d.blocking { Level::Bad } else { Level::Warn }, format!("Data: {}.", d.text)));
    let other = answer.remarks.iter().map(|r| (Level::Neutral, r.clone()));
    let advice = answer.advice.iter().map(|a| (Level::Neutral, format!("Next: {a}")));
    data.chain(other).chain(advice).collect()
}

/// The extended vehicle, as the changes to the given one; `None` without causes.
fn vehicle(answer: &Diagnosis) -> Option<Section> {
    let extended = answer.extended.as_ref()?;
    let written = answer.extended_vehicle.as_ref().map(|path| format!(" It is in {path}."));
    Some(Section {
        title: "The extended vehicle".into(),
        text: format!("Changes to the vehicle file.{}", written.unwrap_or_default()),
        diff: changed_lines(&answer.figures.given_vehicle, &extended.to_toml()),
        ..Section::default()
    })
}

/// The remaining deviation, and the rejected causes.
fn left(answer: &Diagnosis) -> Option<Section> {
    let table = rejected(answer);
    let plots = evidence(answer, false);
    let share = 100.0 * answer.unexplained.share;
    let text = match answer.unexplained.description.as_str() {
        "" => "The remaining residual is noise.".to_string(),
        description => format!("{share:.0} % of the residual power remains. {description}"),
    };
    (!table.rows.is_empty() || !plots.is_empty() || !answer.unexplained.description.is_empty()).then(|| {
        Section {
            title: "Remaining residual, and the closest effects that were rejected".into(),
            text,
            tables: if table.rows.is_empty() { Vec::new() } else { vec![table] },
            plots,
            columns: 2,
            ..Section::default()
        }
    })
}

fn facts(answer: &Diagnosis) -> Vec<(String, String)> {
    let verdict =
        serde_json::to_value(answer.verdict).ok().and_then(|v| v.as_str().map(|v| v.replace('_', " ")));
    let t = &answer.figures.t;
    let span = t.first().zip(t.last()).map(|(a, b)| format!("{} to {} s", instant(*a), instant(*b)));
    vec![
        ("records".into(), answer.records.join(", ")),
        ("vehicle".into(), answer.vehicle.clone()),
        ("verdict".into(), verdict.unwrap_or_default()),
        ("time".into(), span.unwrap_or_default()),
        ("period".into(), format!("{} s ({} steps)", number(answer.period_s), t.len())),
        ("version".into(), answer.version.clone()),
    ]
}
