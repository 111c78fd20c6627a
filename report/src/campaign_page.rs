//! The page of a campaign: how often limits are violated, the distributions of the figures, their sensitivities,
//! and the worst flights.

use whirlstand_campaign::{
    Ended, FigureColumn, Findings, Flight, LimitFindings, Proportion, Table as Flights, Value, WEIGHT, Worst,
    violated,
};
use whirlstand_logs::shown::{ShownUnit, number};

use super::ReportError;
use super::labels::with_unit;
use super::page::{Attachment, Cell, Level, Page, Row, Section, Table};
use super::plot::{Plot, Style, Trace};

/// Number of bars of a histogram.
const BARS: usize = 40;

/// Points of the line of a share over the number of flights.
const POINTS: usize = 400;

/// The data of the page.
#[derive(Debug, Clone, Copy)]
pub struct CampaignReport<'a> {
    /// Path of the campaign file, for the commands that show a flight.
    pub campaign: &'a str,
    /// The flights.
    pub table: &'a Flights,
    /// Statistics of the flights.
    pub findings: &'a Findings,
    /// The statistics as text.
    pub text: &'a str,
}

/// The page of a campaign.
///
/// # Errors
/// [`ReportError`], which would be a bug.
pub fn campaign_report(report: &CampaignReport) -> Result<String, ReportError> {
    let violated = &report.findings.violated;
    let page = Page {
        kind: "campaign".into(),
        title: format!("campaign {}", report.campaign),
        verdict: format!(
            "{} of {} flights exceeded a limit or did not finish: {} % ({} to {} % at 95 % confidence).",
            violated.count,
            violated.of,
            percent(violated.share),
            percent(violated.low),
            percent(violated.high)
        ),
        level: if violated.count == 0 { Level::Good } else { Level::Warn },
        sections: vec![shares(report), figures(report), moved(report), worst(report)],
        facts: vec![
            ("flights".into(), violated.of.to_string()),
            ("version".into(), report.table.info.version.clone()),
        ],
        attachments: vec![
            Attachment { title: "as text".into(), text: report.text.into() },
            Attachment { title: "campaign file".into(), text: report.table.info.text.clone() },
        ],
        ..Page::default()
    };
    page.to_html()
}

/// A share as a percentage; that of a rare event has many zeros before its first significant digit.
fn percent(share: f64) -> String {
    if share > 0.0 && share < 1e-3 {
        format!("{:.1e}", 100.0 * share)
    } else {
        number((1e4 * share).round() / 1e2)
    }
}

/// Whether the flights have different weights, as those drawn where failures are frequent.
fn is_weighted(report: &CampaignReport) -> bool {
    report.table.info.columns.figures.iter().any(|figure| figure.key == WEIGHT)
}

fn interval(p: &Proportion) -> Vec<Cell> {
    vec![
        Cell::new(format!("{} of {}", p.count, p.of)),
        Cell::new(percent(p.share)),
        Cell::new(percent(p.low)),
        Cell::new(percent(p.high)),
    ]
}

/// How often limits are violated, and how the interval narrows with the number of flights.
fn shares(report: &CampaignReport) -> Section {
    let findings = report.findings;
    let row = |label: String, p: &Proportion| Row { label, group: false, cells: interval(p) };
    let mut rows = vec![row("any limit, or not finished".into(), &findings.violated)];
    if findings.failed.count > 0 {
        rows.push(row("did not finish".into(), &findings.failed));
    }
    let figures = &report.table.info.columns.figures;
    let unit = |key: &str| figures.iter().find(|figure| figure.key == key).map(unit_of).unwrap_or_default();
    let wanted = |l: &LimitFindings| format!("{} <= {}", l.key, unit(&l.key).text(l.limit));
    rows.extend(findings.limits.iter().map(|l| row(wanted(l), &l.violated)));
    let flights = &report.table.flights;
    let step = flights.len().div_ceil(POINTS).max(1);
    let mut plot = Plot::new("share", "share of flights that exceed a limit", "flights", "%");
    let [mut at, mut share, mut low, mut high] = [const { Vec::new() }; 4];
    for first in (1..=flights.len()).filter(|n| n % step == 0 || *n == flights.len()) {
        let p = violated(report.table, first);
        at.push(p.of as f64);
        for (line, value) in [(&mut share, p.share), (&mut low, p.low), (&mut high, p.high)] {
            line.push(100.0 * value);
        }
    }
    plot.traces.push(Trace::new("share", 0, Style::Main, &at, &share));
    for line in [&low, &high] {
        plot.traces.push(Trace::new("95 %", 0, Style::Limit, &at, line));
    }
    Section {
        title: "Failure rates".into(),
        plots: vec![plot],
        tables: vec![Table {
            head: ["", "flights", "share, %", "from, %", "to, %"].map(String::from).to_vec(),
            rows,
            note: match is_weighted(report) {
                true => "Weighted means with Fay and Feuer's 95 % confidence interval: sampling was concentrated \
                         where failures are frequent. The histograms below show the samples, the quantiles are \
                         weighted.",
                false => "Wilson's 95 % confidence interval, or Clopper and Pearson's where the count is none or all.",
            }
            .into(),
            ..Table::default()
        }],
        columns: 2,
        ..Section::default()
    }
}

/// The unit in which the values of a figure are shown.
fn unit_of(figure: &FigureColumn) -> ShownUnit {
    ShownUnit::named(&figure.unit, &figure.shown)
}

/// The values of a figure over all flights, in the unit that is shown.
fn column(flights: &[Flight], at: usize, unit: &ShownUnit) -> Vec<f64> {
    let values = flights.iter().map(|f| f.figures.get(at).copied().flatten().unwrap_or(f64::NAN));
    values.map(|value| value * unit.factor()).collect()
}

/// Histograms of the figures that have a limit, with the limit.
fn figures(report: &CampaignReport) -> Section {
    let columns = &report.table.info.columns;
    let plots = report.findings.limits.iter().enumerate().filter_map(|(i, limit)| {
        let at = columns.figures.iter().position(|figure| figure.key == limit.key)?;
        let unit = unit_of(&columns.figures[at]);
        let known: Vec<f64> =
            column(&report.table.flights, at, &unit).into_iter().filter(|v| v.is_finite()).collect();
        let low = known.iter().copied().fold(f64::INFINITY, f64::min);
        let high = known.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if known.is_empty() || low == high {
            return None;
        }
        let width = (high - low) / BARS as f64;
        let mut counts = vec![0.0; BARS];
        for value in &known {
            counts[(((value - low) / width) as usize).min(BARS - 1)] += 1.0;
        }
        // The last edge closes the outline.
        counts.push(0.0);
        let edges: Vec<f64> = (0..=BARS).map(|bar| low + bar as f64 * width).collect();
        let label = with_unit(&limit.key, unit.symbol());
        let mut plot = Plot::new(format!("figure-{i}"), limit.key.clone(), label, "flights");
        let most = counts.iter().copied().fold(0.0, f64::max);
        plot.traces.push(Trace::new("flights", 0, Style::Histogram, &edges, &counts));
        plot.traces.push(Trace::new(
            "limit",
            0,
            Style::Limit,
            &[limit.limit * unit.factor(); 2],
            &[0.0, most],
        ));
        Some(plot)
    });
    let rows = report.findings.figures.iter().map(|f| {
        let unit = ShownUnit::named(&f.unit, &f.shown);
        let cells = f.quantiles.iter().map(|q| Cell::new(unit.text(*q))).collect();
        Row { label: f.key.clone(), group: false, cells }
    });
    Section {
        title: "Figures".into(),
        plots: plots.collect(),
        tables: vec![Table {
            head: ["", "least", "5 %", "median", "95 %", "most"].map(String::from).to_vec(),
            rows: rows.collect(),
            ..Table::default()
        }],
        columns: 2,
        ..Section::default()
    }
}

/// Each figure with a limit, plotted over the key that moves it most.
fn moved(report: &CampaignReport) -> Section {
    let (flights, columns) = (&report.table.flights, &report.table.info.columns);
    let limited =
        || report.findings.figures.iter().filter(|f| columns.limits.iter().any(|(key, _)| *key == f.key));
    let plots = limited().enumerate().filter_map(|(i, figure)| {
        let first = figure.sensitivities.first()?;
        let key = columns.keys.iter().position(|(key, _)| *key == first.key)?;
        let at = columns.figures.iter().position(|column| column.key == figure.key)?;
        let unit = unit_of(&columns.figures[at]);
        let draws: Vec<f64> =
            flights.iter().map(|f| f.values.get(key).and_then(Value::number).unwrap_or(f64::NAN)).collect();
        if draws.iter().all(|v| v.is_nan()) {
            return None;
        }
        let label = with_unit(&first.key, &columns.keys[key].1);
        let mut plot = Plot::new(format!("moved-{i}"), figure.key.clone(), label, unit.symbol());
        plot.traces.push(Trace::new("flights", 0, Style::Cloud, &draws, &column(flights, at, &unit)));
        Some(plot)
    });
    let rows = limited().flat_map(|figure| {
        figure.sensitivities.iter().enumerate().map(|(i, s)| Row {
            label: if i == 0 { figure.key.clone() } else { String::new() },
            group: false,
            cells: vec![Cell::new(s.key.clone()), Cell::new(format!("{:+.2}", s.rank_correlation))],
        })
    });
    Section {
        title: "Sensitivities".into(),
        text: "Spearman's rank correlation of each figure with a limit and each varied quantity: +1 or -1 for a \
               monotonic relation, 0 for no relation or one that both rises and falls."
            .into(),
        plots: plots.collect(),
        tables: vec![Table {
            head: ["figure", "varied quantity", "rank correlation"].map(String::from).to_vec(),
            rows: rows.collect(),
            words: true,
            ..Table::default()
        }],
        columns: 2,
        ..Section::default()
    }
}

fn worst(report: &CampaignReport) -> Section {
    let how = |worst: &Worst| match (&worst.of_limit, &worst.ended) {
        (_, Some(why)) => why.clone(),
        (Some(share), None) => format!("{} at {} of its limit", worst.key, number(*share)),
        (None, None) => format!("{} was never reached", worst.key),
    };
    let drawn = |flight: u64| {
        let flight = report.table.flights.iter().find(|f| f.number == flight);
        let values = flight.into_iter().flat_map(|f| report.table.info.columns.keys.iter().zip(&f.values));
        values.map(|((key, _), value)| format!("{key}={value}")).collect::<Vec<_>>().join(" ")
    };
    let rows = report.findings.worst.iter().map(|worst| Row {
        label: worst.flight.to_string(),
        group: false,
        cells: vec![
            Cell::new(how(worst)),
            Cell::new(drawn(worst.flight)),
            Cell::new(format!("whirlstand campaign replay {} --flight {}", report.campaign, worst.flight)),
        ],
    });
    let ended = report.table.flights.iter().filter(|f| f.ended != Ended::Complete).count();
    Section {
        title: "The worst flights".into(),
        text: if ended > 0 { format!("{ended} flights did not finish.") } else { String::new() },
        tables: vec![Table {
            head: ["flight", "how", "drawn values", "to replay it"].map(String::from).to_vec(),
            rows: rows.collect(),
            words: true,
            ..Table::default()
        }],
        ..Section::default()
    }
}
