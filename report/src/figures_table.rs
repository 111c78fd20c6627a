//! The tables of a run report.

use super::labels::with_unit;
use super::outcome::Expected;
use super::page::{Cell, Level, Row, Table};
use whirlstand_evaluate::summary::{Figure, RunSummary};
use whirlstand_logs::shown::number;
use whirlstand_msgs::units::ShownUnit;

/// How a figure scales with the unit of its output.
#[derive(Clone, Copy, PartialEq)]
enum Scale {
    Unit,
    Plain,
    Square,
}

/// Figures of an output that the table shows: key and head. IAE and ISE are in the unit of the row, times s.
const OUTPUT_COLUMNS: [(&str, &str, Scale); 8] = [
    ("peak", "peak after disturbance", Scale::Unit),
    ("recovery_s", "recovery, s", Scale::Plain),
    ("rise_s", "rise, s", Scale::Plain),
    ("settling_s", "settling, s", Scale::Plain),
    ("overshoot_percent", "overshoot, %", Scale::Plain),
    ("rms_error", "rms error", Scale::Unit),
    ("iae", "IAE, unit · s", Scale::Unit),
    ("ise", "ISE, unit² · s", Scale::Square),
];

/// Figures of an input that the table shows: key, head and factor.
const INPUT_COLUMNS: [(&str, &str, f64, Scale); 5] = [
    ("mean", "mean", 1.0, Scale::Unit),
    ("rms", "rms", 1.0, Scale::Unit),
    ("peak", "peak", 1.0, Scale::Unit),
    ("travel_per_s", "total variation per s", 1.0, Scale::Unit),
    ("saturated", "time at a limit, %", 100.0, Scale::Plain),
];

/// Figures of the outputs: a row per output, or with several variants a group per output and a row per
/// variant.
pub fn output_table(summaries: &[RunSummary]) -> Table {
    let note = "Each row is in its own unit. Worst case over all steps and disturbances of the run, from the true \
                motion if available. Recovery and settling: until the output stays within 5 % (of the peak, of the \
                step) or within the noise level, if that is larger. Errors are relative to the setpoint, or to trim \
                where nothing is tracked.";
    let Some(first) = summaries.first() else { return Table::default() };
    // Angles, speeds and positions come before their rates, and tracked outputs come first.
    let mut names: Vec<&String> = first.outputs.keys().collect();
    let tracked = |name: &str| summaries.iter().any(|s| s.outputs.get(name).is_some_and(|o| o.tracked));
    names.sort_by_key(|n| (!tracked(n), n.ends_with("_rate")));
    let rows = names.into_iter().map(|name| {
        let unit = &first.outputs[name].unit;
        let what = if tracked(name) { " (tracked)" } else { "" };
        (format!("{}{what}", with_unit(name, unit.symbol())), name.as_str(), unit)
    });
    let columns: Vec<Column> = OUTPUT_COLUMNS
        .iter()
        .map(|(key, head, scale)| Column { key, head, factor: 1.0, scale: *scale })
        .collect();
    Table { note: note.into(), ..table(summaries, rows, &columns) }
}

/// Figures of the inputs, in the layout of [`output_table`].
pub fn input_table(summaries: &[RunSummary]) -> Table {
    let Some(first) = summaries.first() else { return Table::default() };
    let rows = first.inputs.iter().map(|(name, input)| {
        let unit = &input.unit;
        (with_unit(name, unit.symbol()), name.as_str(), unit)
    });
    let columns: Vec<Column> = INPUT_COLUMNS
        .iter()
        .map(|(key, head, factor, scale)| Column { key, head, factor: *factor, scale: *scale })
        .collect();
    table(summaries, rows, &columns)
}

struct Column {
    key: &'static str,
    head: &'static str,
    factor: f64,
    scale: Scale,
}

/// A table of figures; rows are `(label, name of the signal, unit)`.
fn table<'a>(
    summaries: &[RunSummary],
    rows: impl Iterator<Item = (String, &'a str, &'a ShownUnit)>,
    columns: &[Column],
) -> Table {
    let mut table = Table {
        head: std::iter::once("").chain(columns.iter().map(|c| c.head)).map(String::from).collect(),
        ..Table::default()
    };
    let mut used = vec![false; columns.len()];
    for (label, name, unit) in rows {
        // One column of figures per key; the best variant is marked.
        let figures: Vec<Vec<Cell>> = columns
            .iter()
            .zip(&mut used)
            .map(|(column, used)| {
                let figures: Vec<Option<Figure>> =
                    summaries.iter().map(|s| s.figure(&format!("{name}.{}", column.key))).collect();
                *used |= figures.iter().flatten().any(|f| *f != Figure::NoEvent);
                let factor = unit.factor();
                let power = match column.scale {
                    Scale::Unit => factor,
                    Scale::Plain => 1.0,
                    Scale::Square => factor * factor,
                };
                cells(&figures, column.factor * power, column.key != "mean")
            })
            .collect();
        let row = |i: usize| figures.iter().map(|column| column[i].clone()).collect();
        if summaries.len() == 1 {
            table.rows.push(Row { label, group: false, cells: row(0) });
            continue;
        }
        table.rows.push(Row { label, group: true, cells: vec![Cell::default(); columns.len()] });
        for (i, s) in summaries.iter().enumerate() {
            table.rows.push(Row { label: s.name.clone(), group: false, cells: row(i) });
        }
    }
    // A figure without a value in any row gets no column.
    let keep = |i: &usize| used[*i];
    let kept: Vec<usize> = (0..columns.len()).filter(keep).collect();
    table.head =
        std::iter::once(0).chain(kept.iter().map(|i| i + 1)).map(|i| table.head[i].clone()).collect();
    for row in &mut table.rows {
        row.cells = kept.iter().map(|&i| row.cells[i].clone()).collect();
    }
    table
}

fn cells(figures: &[Option<Figure>], factor: f64, less_is_better: bool) -> Vec<Cell> {
    let value = |f: &Option<Figure>| match f {
        Some(Figure::Value(v)) => Some(*v),
        _ => None,
    };
    let values: Vec<f64> = figures.iter().filter_map(value).collect();
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let differ = values.iter().any(|v| *v > least * 1.001) || values.len() < figures.len();
    let mark = less_is_better && figures.len() > 1 && differ;
    figures
        .iter()
        .map(|f| match f {
            Some(Figure::Value(v)) => {
                Cell { text: number(v * factor), best: mark && *v <= least, ..Cell::default() }
            }
            Some(Figure::Never) => Cell::leveled("never", Level::Bad),
            _ => Cell::new("-"),
        })
        .collect()
}

/// Standard deviations according to the estimator, and its actual errors.
pub fn estimator_table(summaries: &[RunSummary]) -> Option<Table> {
    let judged: Vec<_> = summaries.iter().filter_map(|s| Some((s, s.estimator.as_ref()?))).collect();
    let head = ["", "NIS ratio", "95 % interval", "judged from, s", "steps", "errors within 2 std, %"];
    let rows = judged.iter().map(|(s, e)| {
        let level = if e.consistent { Level::Good } else { Level::Warn };
        let inside = e.states.values().map(|s| s.within_two_std).fold(f64::NAN, f64::min);
        Row {
            label: s.name.clone(),
            group: false,
            cells: vec![
                Cell::leveled(format!("{:.3}", e.nis_ratio), level),
                Cell::new(format!("{:.3} to {:.3}", e.low, e.high)),
                Cell::new(number(e.from_s)),
                Cell::new(e.steps.to_string()),
                Cell::new(if inside.is_nan() { "-".into() } else { number(100.0 * inside) }),
            ],
        }
    });
    (!judged.is_empty()).then(|| Table {
        head: head.iter().map(|h| h.to_string()).collect(),
        rows: rows.collect(),
        note:
            "Computed up to the first disturbance. A NIS ratio below the interval means that the filter is too \
             conservative, for example because it allows for disturbances that did not occur; above it, the filter \
             is overconfident. Errors within 2 std: the worst state; 95.4 for a consistent filter."
                .into(),
        ..Table::default()
    })
}

/// Expectations and results: a row per expectation, a column per run.
pub fn expected_table(expected: &[Expected]) -> Table {
    let (mut rows, mut runs): (Vec<&Expected>, Vec<&str>) = (Vec::new(), Vec::new());
    for e in expected {
        if !rows.iter().any(|r| r.key == e.key && r.limit == e.limit) {
            rows.push(e);
        }
        if !runs.contains(&e.run.as_str()) {
            runs.push(&e.run);
        }
    }
    let head = ["", "limit"].into_iter().chain(runs.iter().copied()).map(String::from).collect();
    let rows = rows.into_iter().map(|row| {
        let value = |v: f64| row.unit.text(v);
        let of_run = |run: &&str| {
            let here = |e: &&Expected| e.run == *run && e.key == row.key && e.limit == row.limit;
            let Some(e) = expected.iter().find(here) else { return Cell::new("-") };
            let found = e.found.map_or("-".into(), value);
            let (mark, level) = if e.holds { ("✓", Level::Good) } else { ("✕", Level::Bad) };
            Cell::leveled(format!("{found} {mark}"), level)
        };
        let cells = std::iter::once(Cell::new(value(row.limit))).chain(runs.iter().map(of_run));
        Row { label: row.key.clone(), group: false, cells: cells.collect() }
    });
    Table { head, rows: rows.collect(), ..Table::default() }
}

/// Timing figures, one row per node.
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
            let us = |f: fn(&whirlstand_evaluate::metrics::Latency) -> f64| {
                Cell::new(t.latency.as_ref().map_or("-".into(), |l| number(f(l))))
            };
            cells.extend([us(|l| l.p50_us), us(|l| l.p99_us), us(|l| l.p999_us), us(|l| l.max_us)]);
            table.rows.push(Row { label: node.clone(), group: false, cells });
        }
    }
    table
}
