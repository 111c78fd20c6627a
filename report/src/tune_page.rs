//! The page of a tuning: old and new law side by side.

use whirlstand_control::design::Pole;
use whirlstand_msgs::units::ShownUnit;

use crate::ReportError;
use crate::page::{Attachment, Cell, Level, Page, Row, Section, Table};
use crate::plot::{Plot, Style, Trace};

/// The data of the page.
#[derive(Debug, Clone)]
pub struct TuneReport {
    /// Title.
    pub title: String,
    /// The verdict in a sentence.
    pub verdict: String,
    /// Whether the new law is kept.
    pub kept: bool,
    /// The figures of both laws.
    pub lines: Vec<LawLine>,
    /// The motion of every state over the draws.
    pub fans: Vec<Fan>,
    /// Frequencies, rad/s.
    pub frequencies: Vec<f64>,
    /// Sensitivity of the old and of the new loop at these frequencies; empty where unknown.
    pub sensitivity: [Vec<f64>; 2],
    /// Poles of the old and of the new loop.
    pub poles: [Vec<Pole>; 2],
    /// The tuning as text.
    pub text: String,
}

/// A figure of both laws.
#[derive(Debug, Clone)]
pub struct LawLine {
    /// Name of the figure.
    pub what: String,
    /// Value under the old law.
    pub before: String,
    /// Value under the new law.
    pub after: String,
}

/// The motion of one state over all draws.
#[derive(Debug, Clone)]
pub struct Fan {
    /// Name of the state.
    pub name: String,
    /// Unit of the state.
    pub unit: ShownUnit,
    /// For the old and the new law: time, s, and the quantiles 5 %, 50 % and 95 % of the draws.
    pub laws: [[Vec<f64>; 4]; 2],
}

const LAWS: [&str; 2] = ["old law", "new law"];

/// The page of a tuning.
///
/// # Errors
/// [`ReportError`], which would be a bug.
pub fn tune_report(report: &TuneReport) -> Result<String, ReportError> {
    let page = Page {
        kind: "tuning".into(),
        title: report.title.clone(),
        verdict: report.verdict.clone(),
        level: if report.kept { Level::Good } else { Level::Neutral },
        sections: vec![figures(report), fans(report), loops(report)],
        facts: vec![("version".into(), env!("CARGO_PKG_VERSION").into())],
        attachments: vec![Attachment { title: "as text".into(), text: report.text.clone() }],
        ..Page::default()
    };
    page.to_html()
}

fn figures(report: &TuneReport) -> Section {
    let rows = report.lines.iter().map(|line| Row {
        label: line.what.clone(),
        group: false,
        cells: vec![Cell::new(&line.before), Cell::new(&line.after)],
    });
    Section {
        title: "Before and after".into(),
        tables: vec![Table {
            head: ["", LAWS[0], LAWS[1]].map(String::from).to_vec(),
            rows: rows.collect(),
            note: "Median and 95 % range of the draws; SI.".into(),
            words: true,
        }],
        ..Section::default()
    }
}

fn fans(report: &TuneReport) -> Section {
    let plots = report.fans.iter().enumerate().map(|(i, fan)| {
        let (unit, factor) = (fan.unit.symbol(), fan.unit.factor());
        let mut plot = Plot::over_time(format!("fan-{i}"), &fan.name, unit);
        for (law, [t, low, median, high]) in fan.laws.iter().enumerate() {
            let scaled = |values: &[f64]| values.iter().map(|v| v * factor).collect::<Vec<_>>();
            plot.traces.push(Trace::new(LAWS[law], law, Style::Main, t, &scaled(median)));
            for edge in [low, high] {
                let name = format!("{}, 5 % and 95 % of the draws", LAWS[law]);
                plot.traces.push(Trace::new(name, law, Style::Second, t, &scaled(edge)));
            }
        }
        plot
    });
    Section { title: "Flights".into(), plots: plots.collect(), columns: 2, ..Section::default() }
}

fn loops(report: &TuneReport) -> Section {
    let mut sensitivity =
        Plot::new("sensitivity", "sensitivity, largest singular value", "frequency, rad/s", "dB");
    sensitivity.log_x = true;
    let mut poles =
        Plot::new("poles", "poles of the loop with its filter", "real part, 1/s", "imaginary part, 1/s");
    poles.square = true;
    poles.height = 420;
    for (law, name) in LAWS.iter().enumerate() {
        let values: Vec<f64> = report.sensitivity[law].iter().map(|s| 20.0 * s.log10()).collect();
        if !values.is_empty() {
            sensitivity.traces.push(Trace::new(*name, law, Style::Main, &report.frequencies, &values));
        }
        if let Some((w, peak)) = report.frequencies.iter().zip(&values).max_by(|a, b| a.1.total_cmp(b.1)) {
            sensitivity.notes.push((*w, *peak, format!("{}: {peak:.1} dB", name)));
        }
        // The poles of past commands are far to the left and carry no information.
        let shown = report.poles[law].iter().filter(|p| p.discrete[0].hypot(p.discrete[1]) > 0.7);
        let (x, y): (Vec<f64>, Vec<f64>) =
            shown.filter_map(|p| p.continuous).map(|[re, im]| (re, im)).unzip();
        poles.traces.push(Trace::new(*name, law, Style::Crosses, &x, &y));
    }
    Section {
        title: "Loops".into(),
        text: "Loop of law, filter and the diagnosed vehicle, broken at the plant input.".into(),
        plots: vec![sensitivity, poles],
        columns: 2,
        ..Section::default()
    }
}
