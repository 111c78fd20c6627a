//! The data that the terminal shows, from the received frames.

use std::collections::{BTreeMap, VecDeque};

use serde_json::Value;

/// Values of a signal that are kept for its line, one per frame.
const KEPT: usize = 400;

/// Number of events that are kept.
const EVENTS: usize = 50;

/// A signal that is shown in a row.
#[derive(Debug, Clone, Default)]
pub(super) struct Shown {
    pub name: String,
    pub unit: String,
    pub limits: Option<(f64, f64)>,
}

/// A node that is shown in a row.
#[derive(Debug, Clone, Default)]
pub(super) struct ShownNode {
    pub name: String,
    pub state: String,
    /// Counts: steps, deadline misses, lost, rejected, restarts.
    pub counts: [u64; 5],
    pub p99_us: Option<f64>,
    pub cpu_percent: Option<f64>,
}

/// All data that are shown.
#[derive(Debug, Default)]
pub(super) struct Board {
    pub title: String,
    pub subtitle: String,
    pub t: Option<f64>,
    pub outputs: Vec<Shown>,
    pub inputs: Vec<Shown>,
    pub nodes: Vec<ShownNode>,
    /// Events: bench time and text, the newest first.
    pub events: VecDeque<(f64, String)>,
    pub over: Option<String>,
    columns: Vec<String>,
    newest: BTreeMap<String, f64>,
    lines: BTreeMap<String, VecDeque<f64>>,
}

impl Board {
    /// Takes in a frame.
    pub fn take(&mut self, text: &str) {
        let Ok(value) = serde_json::from_str::<Value>(text) else { return };
        if let Some(scene) = value.get("scene") {
            return self.begin(scene, &value["columns"]);
        }
        if let Some(over) = value["over"].as_str() {
            self.over = Some(over.into());
            return;
        }
        if value["anew"].as_bool() == Some(true) {
            (self.newest, self.lines) = Default::default();
            self.events.clear();
        }
        self.t = value["t"].as_f64().or(self.t);
        let columns = value["rows"]["values"].as_array().into_iter().flatten();
        for (name, column) in self.columns.iter().zip(columns) {
            let last = column.as_array().and_then(|c| c.iter().rev().find_map(Value::as_f64));
            let Some(last) = last else { continue };
            self.newest.insert(name.clone(), last);
            let line = self.lines.entry(name.clone()).or_default();
            line.push_back(last);
            while line.len() > KEPT {
                line.pop_front();
            }
        }
        for event in value["events"].as_array().into_iter().flatten() {
            let text = event["text"].as_str().unwrap_or_default().to_string();
            self.events.push_front((event["t"].as_f64().unwrap_or_default(), text));
        }
        self.events.truncate(EVENTS);
        if let Some(nodes) = value["nodes"].as_array() {
            self.nodes = nodes.iter().map(node).collect();
        }
    }

    /// The newest value of a column.
    pub fn newest(&self, column: &str) -> Option<f64> {
        self.newest.get(column).copied()
    }

    /// The last values of a column, the oldest first.
    pub fn line(&self, column: &str) -> impl DoubleEndedIterator<Item = f64> {
        self.lines.get(column).into_iter().flatten().copied()
    }

    fn begin(&mut self, scene: &Value, columns: &Value) {
        let text = |key: &str| scene[key].as_str().unwrap_or_default().to_string();
        let names = columns.as_array().into_iter().flatten().filter_map(|c| c.as_str().map(String::from));
        *self = Self {
            title: text("title"),
            subtitle: text("subtitle"),
            outputs: signals(&scene["outputs"]),
            inputs: signals(&scene["inputs"]),
            columns: names.collect(),
            ..Self::default()
        };
    }
}

fn signals(list: &Value) -> Vec<Shown> {
    let text = |value: &Value| value.as_str().unwrap_or_default().to_string();
    let one = |signal: &Value| Shown {
        name: text(&signal["name"]),
        unit: text(&signal["unit"]),
        limits: signal["limits"][0].as_f64().zip(signal["limits"][1].as_f64()),
    };
    list.as_array().into_iter().flatten().map(one).collect()
}

fn node(value: &Value) -> ShownNode {
    let counts = ["steps", "misses", "lost", "rejected", "restarts"];
    ShownNode {
        name: value["node"].as_str().unwrap_or_default().into(),
        state: value["state"].as_str().unwrap_or_default().into(),
        counts: counts.map(|key| value[key].as_u64().unwrap_or_default()),
        p99_us: value["p99_us"].as_f64(),
        cpu_percent: value["cpu_percent"].as_f64(),
    }
}
