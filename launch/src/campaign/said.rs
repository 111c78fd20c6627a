//! The answer of a campaign, as text and as JSON.

use std::fmt::Write;
use std::path::PathBuf;

use serde::Serialize;
use whirlstand_campaign::{Columns, Findings, LimitFindings, Proportion};
use whirlstand_logs::shown::{ShownUnit, number};

/// Schema of the JSON answer.
const SCHEMA: &str = "whirlstand.campaign.v1";

/// The data of the answer.
#[derive(Debug, Serialize)]
#[serde(into = "Answer")]
pub(super) struct Said<'a> {
    /// The campaign file.
    pub campaign: &'a str,
    pub launch: &'a str,
    pub method: &'a str,
    pub seed: u64,
    /// Number of flights of the whole campaign, or of the part.
    pub planned: u64,
    /// Wall-clock time; `None` where nothing was flown.
    pub wall_s: Option<f64>,
    /// Flights that this call flew.
    pub flown_now: u64,
    pub jobs: usize,
    /// Whether a signal ended the campaign.
    pub partial: bool,
    /// Whether the campaign ended early because its stopping rule was met.
    pub enough: bool,
    pub table: Option<PathBuf>,
    pub report: Option<PathBuf>,
    pub findings: Findings,
    pub columns: &'a Columns,
}

/// The answer in the form of the JSON document.
#[derive(Debug, Serialize)]
struct Answer {
    schema: &'static str,
    campaign: String,
    launch: String,
    method: String,
    seed: u64,
    planned: u64,
    flown: u64,
    wall_s: Option<f64>,
    jobs: usize,
    partial: bool,
    ended_early: bool,
    table: Option<PathBuf>,
    report: Option<PathBuf>,
    findings: Findings,
}

impl Clone for Said<'_> {
    fn clone(&self) -> Self {
        let (table, report, findings) = (self.table.clone(), self.report.clone(), self.findings.clone());
        Self { table, report, findings, ..*self }
    }
}

impl From<Said<'_>> for Answer {
    fn from(said: Said<'_>) -> Self {
        Self {
            schema: SCHEMA,
            campaign: said.campaign.into(),
            launch: said.launch.into(),
            method: said.method.into(),
            seed: said.seed,
            planned: said.planned,
            flown: said.findings.violated.of,
            wall_s: said.wall_s,
            jobs: said.jobs,
            partial: said.partial,
            ended_early: said.enough,
            table: said.table,
            report: said.report,
            findings: said.findings,
        }
    }
}

impl Said<'_> {
    /// The answer in words.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, text: &mut String) -> std::fmt::Result {
        let found = &self.findings;
        let flown = found.violated.of;
        if self.partial {
            writeln!(text, "partial: {flown} of {} flights, continue with --resume", self.planned)?;
        }
        write!(
            text,
            "{flown} flights of {}, drawn by \"{}\" with seed {}",
            self.launch, self.method, self.seed
        )?;
        if self.enough {
            write!(text, ", fewer than the {} planned: the interval is narrow enough", self.planned)?;
        }
        match self.wall_s {
            Some(wall) if self.flown_now > 0 => writeln!(
                text,
                "; {} of them in {} s, {} at a time",
                self.flown_now,
                number((10.0 * wall).round() / 10.0),
                self.jobs
            )?,
            _ => writeln!(text)?,
        }
        writeln!(text, "  violated    {}", share(&found.violated))?;
        if found.failed.count > 0 {
            writeln!(text, "  unfinished  {}", share(&found.failed))?;
        }
        self.write_limits(text)?;
        if let Some(worst) = found.worst.first() {
            let how = match (&worst.of_limit, &worst.ended) {
                (_, Some(why)) => why.clone(),
                (Some(share), None) => format!("{} at {} of its limit", worst.key, number(*share)),
                (None, None) => format!("{} unfinished", worst.key),
            };
            let replay = format!("whirlstand campaign replay {} --flight {}", self.campaign, worst.flight);
            writeln!(text, "  worst       flight {}: {how}\n              {replay}", worst.flight)?;
        }
        for (what, path) in [("table", &self.table), ("report", &self.report)] {
            if let Some(path) = path {
                writeln!(text, "  {what:<11} {}", path.display())?;
            }
        }
        Ok(())
    }

    /// The limits, and the figures that have one.
    fn write_limits(&self, text: &mut String) -> std::fmt::Result {
        let found = &self.findings;
        let figures = &self.columns.figures;
        let unit = |key: &str| {
            figures.iter().find(|figure| figure.key == key).map(|f| ShownUnit::named(&f.unit, &f.shown))
        };
        // A limit on a count, such as that of lost messages, gets a line only where it was violated.
        let told = |l: &LimitFindings| unit(&l.key).is_some() || l.violated.count > 0;
        for limit in found.limits.iter().filter(|l| told(l)) {
            let wanted =
                format!("{} <= {}", limit.key, unit(&limit.key).unwrap_or_default().text(limit.limit));
            writeln!(text, "  {wanted:<34} violated in {}", share(&limit.violated))?;
        }
        let kept: Vec<&str> = found.limits.iter().filter(|l| !told(l)).map(|l| l.key.as_str()).collect();
        if !kept.is_empty() {
            writeln!(text, "  never       {}", kept.join(", "))?;
        }
        for figure in found.figures.iter().filter(|f| found.limits.iter().any(|l| l.key == f.key)) {
            let unit = ShownUnit::named(&figure.unit, &figure.shown);
            let [_, low, middle, high, most] = figure.quantiles.map(|q| unit.text(q));
            writeln!(text, "  {:<24} median {middle}, 5 to 95 % {low} to {high}, max {most}", figure.key)?;
            let moved: Vec<String> = figure
                .sensitivities
                .iter()
                .map(|s| format!("{} {:+.2}", s.key, s.rank_correlation))
                .collect();
            if !moved.is_empty() {
                writeln!(text, "    moved by  {} (rank correlation)", moved.join(", "))?;
            }
        }
        Ok(())
    }
}

fn share(p: &Proportion) -> String {
    // The percentage of a rare event has many zeros before its first significant digit.
    let percent = |share: f64| match share {
        share if share > 0.0 && share < 1e-3 => format!("{:.1e}", 100.0 * share),
        share => number((1e4 * share).round() / 1e2),
    };
    format!(
        "{} % ({} to {} % at 95 % confidence; {} of {})",
        percent(p.share),
        percent(p.low),
        percent(p.high),
        p.count,
        p.of
    )
}
