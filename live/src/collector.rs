//! Makes frames from messages: the rows, events and nodes since the previous frame.

use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::json;
use whirlstand_logs::{BenchMessage, Event, Events};
use whirlstand_msgs::{Adjustment, AdjustmentKind, AdjustmentVerdict};
use whirlstand_vehicle::{Engine, Vehicle};

use crate::hub::Hub;
use crate::nodes::{NodeRow, Nodes};
use crate::rows::{Block, Rows};
use crate::scene::{Scene, bench_info};

/// Time between two frames.
pub(crate) const FRAME: Duration = Duration::from_millis(50);

/// Most rows in a frame: every step of a bench up to 2 kHz, a part of the steps of a faster one.
pub(crate) const MOST_ROWS: usize = 100;

/// Number of frames between two that contain the nodes.
const NODES_EVERY: u64 = 10;

/// Most events in a frame; more would not be readable.
const MOST_EVENTS: usize = 32;

/// Steps by which a message may be ahead of the latest measurement: two full queues.
const AHEAD: u64 = 2 * whirlstand_bus::MAX_DEPTH as u64;

/// A frame: all data since the previous frame.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub(crate) struct Frame {
    /// Bench time of the newest row, s.
    pub t: Option<f64>,
    /// Wall-clock time since the first frame, s.
    pub wall_s: f64,
    /// Whether the earlier data belong to another run.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub anew: bool,
    pub rows: Block,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub events: Vec<Event>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nodes: Option<Vec<NodeRow>>,
    /// Number of messages that were lost because they arrived faster than they were taken.
    pub lost: u64,
}

/// Collects the messages of a bench.
pub struct Collector {
    scene: Scene,
    rows: Rows,
    nodes: Nodes,
    events: Events,
    happened: Vec<Event>,
    anew: bool,
    /// The latest step at the previous frame: the messages that this step lacked then have arrived by now.
    settled: Option<u64>,
    frames: u64,
    began: Option<Instant>,
}

impl Collector {
    /// A collector without messages; `is_running` for a bench whose processes run now.
    pub fn new(scene: Scene, vehicle: &Vehicle, is_running: bool) -> Self {
        Self {
            rows: Rows::new(&scene, vehicle),
            nodes: if is_running { Nodes::running() } else { Nodes::default() },
            events: Events::new(
                &bench_info(vehicle, (scene.period_s * 1e9).round() as u64),
                scene.effects.iter().map(|e| (e.number, e.text.clone())).collect(),
            ),
            happened: Vec::new(),
            anew: false,
            settled: None,
            frames: 0,
            began: None,
            scene,
        }
    }

    /// Sets the engine state at the start of the bench; without this it is flying.
    pub fn with_engine(mut self, engine: Engine) -> Self {
        self.rows.set_engine(engine);
        self
    }

    /// Whether the plant has reported the end of its run.
    pub(crate) fn plant_has_stopped(&self) -> bool {
        self.nodes.has_stopped("plant")
    }

    /// Whether all of these nodes have sent their `Health`.
    pub(crate) fn has_heard(&self, nodes: &[String]) -> bool {
        nodes.iter().all(|node| self.nodes.is_known(node))
    }

    /// Period of the loop, s.
    pub(crate) fn period_s(&self) -> f64 {
        self.scene.period_s
    }

    /// Sends the description of the vehicle to every viewer.
    pub fn greet(&self, hub: &Hub) {
        hub.greet(&json!({ "scene": self.scene, "columns": Rows::columns(&self.scene) }));
    }

    /// Takes in a message.
    pub(crate) fn hear(&mut self, heard: &BenchMessage, now: Instant) {
        let step = heard.head().step;
        if let BenchMessage::Imu(_) = heard
            && (self.rows.newest().is_some_and(|newest| step.saturating_add(AHEAD) < newest)
                || self.went_back(step))
        {
            self.begin_anew();
        }
        let event = self.events.hear(heard);
        if self.happened.len() < MOST_EVENTS {
            self.happened.extend(event);
        }
        match heard {
            BenchMessage::Health(health) => return self.nodes.hear(health, now),
            BenchMessage::Adjustment(m) => return self.adjusted(m),
            _ => {}
        }
        // The last messages of the previous run do not belong to this one. A measurement defines the latest step,
        // however far it is ahead.
        let leads = matches!(heard, BenchMessage::Imu(_));
        if leads || self.rows.newest().is_none_or(|newest| step <= newest.saturating_add(AHEAD)) {
            self.rows.hear(heard);
        }
    }

    /// The next frame. Unless all messages of the latest steps have arrived, these steps wait for the following
    /// frame.
    pub(crate) fn frame(&mut self, now: Instant, lost: u64, all_has_come: bool) -> Frame {
        let newest = self.rows.newest();
        let before = std::mem::replace(&mut self.settled, newest);
        let until = if all_has_come { newest } else { before };
        let rows = until.map(|until| self.rows.take(until, MOST_ROWS)).unwrap_or_default();
        let nodes = self.frames.is_multiple_of(NODES_EVERY).then(|| self.nodes.rows(now));
        self.frames += 1;
        Frame {
            wall_s: now.saturating_duration_since(*self.began.get_or_insert(now)).as_secs_f64(),
            t: rows.step.last().map(|step| *step as f64 * self.scene.period_s),
            anew: std::mem::take(&mut self.anew),
            rows,
            events: std::mem::take(&mut self.happened),
            nodes,
            lost,
        }
    }

    /// Discards all data, and tells the viewers.
    pub(crate) fn begin_anew(&mut self) {
        self.rows.clear();
        self.settled = None;
        self.anew = true;
        self.events.begin_run();
        self.happened.clear();
    }

    /// Whether a step begins a new run: a step 0 after others, also after a short run.
    fn went_back(&self, step: u64) -> bool {
        step == 0 && self.settled.is_some_and(|settled| settled > 0)
    }

    fn adjusted(&mut self, m: &Adjustment) {
        let is_done = m.verdict == AdjustmentVerdict::Done as u32 && m.what == AdjustmentKind::Engine as u32;
        let engines = [Engine::Off, Engine::On, Engine::Flying];
        let engine = engines.into_iter().find(|e| is_done && f64::from(*e as u8) == m.value);
        if let Some(engine) = engine {
            self.rows.set_engine(engine);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Controls;
    use whirlstand_msgs::{Head, Imu, Message, valid};

    fn imu(step: u64) -> BenchMessage {
        let head = Head { seq: step, step, stamp_ns: step * 5_000_000 };
        BenchMessage::Imu(Imu { head, roll: 0.1, valid: valid::FIRST, ..Imu::zeroed() })
    }

    #[test]
    fn a_bench_that_was_too_fast_is_shown_again_from_where_it_is() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let scene = Scene::new("lab", "", 5_000_000, &vehicle, Controls::Nothing);
        let mut collector = Collector::new(scene, &vehicle, false);
        let now = Instant::now();
        (0..20_000).for_each(|step| collector.hear(&imu(step), now));
        let all = collector.frame(now, 0, true).rows.step;
        collector.hear(&imu(20_000), now);
        assert_eq!(collector.frame(now, 0, true).rows.step, [20_000], "after {all:?}");
    }

    #[test]
    fn a_frame_has_what_is_settled_and_a_new_run_begins_anew() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let scene = Scene::new("lab", "", 5_000_000, &vehicle, Controls::Nothing);
        let mut collector = Collector::new(scene, &vehicle, false);
        let now = Instant::now();
        (0..10).for_each(|step| collector.hear(&imu(step), now));
        assert!(
            collector.frame(now, 0, false).rows.step.is_empty(),
            "the rest of the messages may be on its way"
        );
        collector.hear(&imu(10), now);
        let frame = collector.frame(now, 0, false);
        assert_eq!(frame.rows.step, (0..10).collect::<Vec<_>>());
        assert!((frame.t.unwrap() - 0.045).abs() < 1e-12);
        assert_eq!(collector.frame(now, 3, false).rows.step, [10]);
        collector.hear(&imu(0), now);
        let frame = collector.frame(now, 3, false);
        assert!(frame.anew && frame.rows.step.is_empty());
        assert_eq!(collector.frame(now, 3, false).rows.step, [0]);
    }
}
