//! Table of the events of a run, in the order of time.

use whirlstand_evaluate::run::Run;

use super::page::{Cell, Level, Row, Table};

/// Greatest number of rows in the table.
const MOST_EVENTS: usize = 40;
/// Distance, as a share of the run, below which spans are joined in one row.
const NEAR: f64 = 0.002;

struct Event {
    at_s: f64,
    until_s: Option<f64>,
    run: usize,
    what: String,
    level: Level,
}

/// Setpoint steps, disturbances, findings of the mirror, late commands, failsafe and holes of the log; `None`
/// without any.
pub(super) fn events_table(runs: &[&Run]) -> Option<Table> {
    let mut events: Vec<Event> = runs.iter().enumerate().flat_map(|(i, run)| of_run(i, run)).collect();
    events.sort_by(|a, b| a.at_s.total_cmp(&b.at_s).then(a.run.cmp(&b.run)));
    let several = runs.len() > 1;
    if several {
        same_in_all(&mut events, runs.len());
    }
    let more = events.len().saturating_sub(MOST_EVENTS);
    let rows: Vec<Row> = events.iter().take(MOST_EVENTS).map(|event| row(event, several, runs)).collect();
    let head = if several { vec!["time, s", "run", "what"] } else { vec!["time, s", "what"] };
    (!rows.is_empty()).then(|| Table {
        head: head.into_iter().map(String::from).collect(),
        rows,
        words: true,
        note: if more > 0 { format!("{more} more events are in the log.") } else { String::new() },
    })
}

/// Run number that stands for all runs.
const ALL: usize = usize::MAX;

/// Joins an event that occurs alike in all runs, such as a gust, into one.
fn same_in_all(events: &mut Vec<Event>, runs: usize) {
    let same = |a: &Event, b: &Event| a.at_s == b.at_s && a.what == b.what;
    let everywhere: Vec<bool> =
        events.iter().map(|event| events.iter().filter(|other| same(event, other)).count() == runs).collect();
    let mut keep = everywhere.iter();
    events.retain_mut(|event| {
        let all = *keep.next().unwrap_or(&false);
        let first = event.run == 0;
        if all {
            event.run = ALL;
        }
        !all || first
    });
}

fn row(event: &Event, several: bool, runs: &[&Run]) -> Row {
    let time = match event.until_s {
        Some(until) => format!("{:.2} to {until:.2}", event.at_s),
        None => format!("{:.2}", event.at_s),
    };
    let mut cells = Vec::new();
    if several {
        let name = runs.get(event.run).map_or("all", |run| run.name.as_str());
        cells.push(Cell::new(name));
    }
    cells.push(Cell::leveled(event.what.clone(), event.level));
    Row { label: time, group: false, cells }
}

fn of_run(run: usize, recorded: &Run) -> Vec<Event> {
    let figures = &recorded.figures;
    let event = |at_s, until_s, what, level| Event { at_s, until_s, run, what, level };
    let mut events = Vec::new();
    for (name, output) in figures.outputs.iter().filter(|(_, output)| output.tracked) {
        for step in &output.steps {
            let to = output.unit.text(step.to);
            events.push(event(step.at_s, None, format!("setpoint of {name} set to {to}"), Level::Neutral));
        }
    }
    for d in &figures.disturbances {
        let size = d.unit.text(d.magnitude).replace("^2", "²");
        let until = (d.until_s < figures.duration_s).then_some(d.until_s);
        events.push(event(d.at_s, until, format!("disturbance of {size} on {}", d.place), Level::Neutral));
    }
    for found in &figures.findings {
        events.push(event(found.at_s, None, format!("mirror: {}", found.text), Level::Warn));
    }
    let spans = [
        (&recorded.lines.held, "command late, last one held", Level::Warn),
        (&recorded.lines.failsafe, "failsafe", Level::Bad),
    ];
    for (parts, what, level) in spans {
        for (from, until) in parts.at_most(MOST_EVENTS, NEAR * figures.duration_s) {
            events.push(event(from, Some(until), what.to_string(), level));
        }
    }
    events
}
