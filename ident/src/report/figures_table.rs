//! The tables of a run report.

use super::page::{Cell, Level, Row, Table};
use crate::summary::{Figure, RunSummary};
use crate::units::{number, shown_factor, shown_unit};

/// Figures of an output that the table shows: key, words, whether in the unit of the output.
const OUTPUT_ROWS: [(&str, &str, Scale); 8] = [
    ("peak", "peak after disturbance", Scale::Unit),
    ("recovery_s", "recovery", Scale::Seconds),
    ("rise_s", "rise time", Scale::Seconds),
    ("settling_s", "settling time", Scale::Seconds),
    ("overshoot_percent", "overshoot", Scale::Percent),
    ("rms_error", "rms error", Scale::Unit),
    ("iae", "IAE", Scale::UnitSeconds),
    ("ise", "ISE", Scale::SquareSeconds),
];

#[derive(Clone, Copy, PartialEq)]
enum Scale {
    Unit,
    Seconds,
    Percent,
    UnitSeconds,
    SquareSeconds,
}

impl Scale {
    fn unit(self, si: &str) -> String {
        let unit = shown_unit(si);
        match self {
            Self::Unit => unit,
            Self::Seconds => "s".into(),
            Self::Percent => "%".into(),
            Self::UnitSeconds => format!("{unit} s"),
            Self::SquareSeconds if unit.contains('/') => format!("({unit})² s"),
            Self::SquareSeconds => format!("{unit}² s"),
        }
    }

    fn factor(self, si: &str) -> f64 {
        match self {
            Self::Unit | Self::UnitSeconds => shown_factor(si),
            Self::SquareSeconds => shown_factor(si).powi(2),
            Self::Seconds | Self::Percent => 1.0,
        }
    }
}

/// Control figures of all variants, one column each; the best of a row is marked when there are several.
pub fn figures_table(summaries: &[RunSummary]) -> Table {
    let mut table = Table {
        head: std::iter::once(String::new()).chain(summaries.iter().map(|s| s.name.clone())).collect(),
        note: "Worst over all steps and disturbances of the run, from the true motion where there is one. Recovery and \
               settling: until the output stays within 5 % (of the peak, of the step) or within what noise alone \
               reaches, if that is more. Errors count from the setpoint, or from trim where nothing is tracked."
            .into(),
        ..Table::default()
    };
    let Some(first) = summaries.first() else { return table };
    // Angles, speeds and positions before their rates, tracked ones first.
    let mut names: Vec<&String> = first.outputs.keys().collect();
    let tracked = |name: &str| summaries.iter().any(|s| s.outputs.get(name).is_some_and(|o| o.tracked));
    names.sort_by_key(|n| (!tracked(n), n.ends_with("_rate")));
    for name in names {
        let unit = &first.outputs[name].unit;
        let label = if tracked(name) { format!("{name}, tracked") } else { name.clone() };
        table.rows.push(Row { label, group: true, cells: vec![Cell::default(); summaries.len()] });
        for (key, words, scale) in OUTPUT_ROWS {
            let figures: Vec<Option<Figure>> =
                summaries.iter().map(|s| s.figure(&format!("{name}.{key}"))).collect();
            if figures.iter().flatten().all(|f| *f == Figure::NoEvent) {
                continue;
            }
            let label = format!("{words}, {}", scale.unit(unit));
            table.rows.push(Row { label, group: false, cells: cells(&figures, scale.factor(unit)) });
        }
    }
    for name in first.inputs.keys() {
        table.rows.push(Row {
            label: name.clone(),
            group: true,
            cells: vec![Cell::default(); summaries.len()],
        });
        for (key, words, factor) in [
            ("rms", "rms", 1.0),
            ("travel_per_s", "travel a second", 1.0),
            ("saturated", "time at a limit, %", 100.0),
        ] {
            let figures: Vec<Option<Figure>> =
                summaries.iter().map(|s| s.figure(&format!("{name}.{key}"))).collect();
            table.rows.push(Row { label: words.into(), group: false, cells: cells(&figures, factor) });
        }
    }
    let nis = summaries.iter().map(|s| match &s.estimator {
        None => Cell::new("-"),
        Some(e) => Cell::leveled(
            format!("{:.3} ({:.3} to {:.3})", e.nis_ratio, e.low, e.high),
            if e.consistent { Level::Good } else { Level::Warn },
        ),
    });
    table.rows.push(Row {
        label: "estimator".into(),
        group: true,
        cells: vec![Cell::default(); summaries.len()],
    });
    table.rows.push(Row { label: "NIS ratio (95 % interval)".into(), group: false, cells: nis.collect() });
    table
}

fn cells(figures: &[Option<Figure>], factor: f64) -> Vec<Cell> {
    let value = |f: &Option<Figure>| match f {
        Some(Figure::Value(v)) => Some(*v),
        _ => None,
    };
    let values: Vec<f64> = figures.iter().filter_map(value).collect();
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let differ = values.iter().any(|v| *v > least * 1.001) || values.len() < figures.len();
    figures
        .iter()
        .map(|f| match f {
            Some(Figure::Value(v)) => Cell {
                text: number(v * factor),
                best: figures.len() > 1 && differ && *v <= least,
                ..Cell::default()
            },
            Some(Figure::Never) => Cell::leveled("never", Level::Bad),
            _ => Cell::new("-"),
        })
        .collect()
}

/// Timing figures, one row a node.
pub fn timing_table(summaries: &[RunSummary]) -> Table {
    let head =
        ["", "steps", "misses", "lost", "refused", "restarts", "p50, us", "p99, us", "p99.9, us", "max, us"];
    let mut table = Table { head: head.iter().map(|h| h.to_string()).collect(), ..Table::default() };
    for s in summaries {
        if summaries.len() > 1 {
            table.rows.push(Row { label: s.name.clone(), group: true, cells: vec![Cell::default(); 9] });
        }
        for (node, t) in &s.timing.nodes {
            let count =
                |n: u64| Cell::leveled(n.to_string(), if n > 0 { Level::Warn } else { Level::Neutral });
            let mut cells = vec![Cell::new(t.steps.to_string())];
            cells.extend([t.deadline_misses, t.lost, t.rejected, t.restarts].map(count));
            let us = |f: fn(&crate::metrics::Latency) -> f64| {
                Cell::new(t.latency.as_ref().map_or("-".into(), |l| number(f(l))))
            };
            cells.extend([us(|l| l.p50_us), us(|l| l.p99_us), us(|l| l.p999_us), us(|l| l.max_us)]);
            table.rows.push(Row { label: node.clone(), group: false, cells });
        }
    }
    table
}
