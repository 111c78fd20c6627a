//! Messages for panels of Foxglove and Lichtblick that need no configuration: the vehicle's pose and shape, and
//! events as log lines.
//!
//! They are derived from the messages of a bench in this module only, for the live server and for the log. Types
//! and schemas are those of Foxglove's own SDK.

mod poses;
mod shape;
mod written;

use std::collections::BTreeMap;

use foxglove::messages::log::Level;
use foxglove::messages::{FrameTransforms, Log, SceneUpdate};

use crate::bench_info::BenchInfo;
use crate::bench_log::BenchMessage;
use crate::events::{Event, EventKind, Events};
use poses::{Poses, timestamp};
pub use written::PanelChannels;

/// Topic of [`Panel::Transforms`].
pub const TRANSFORMS_TOPIC: &str = "/tf";
/// Topic of [`Panel::Scene`].
pub const SCENE_TOPIC: &str = "/scene";
/// Topic of [`Panel::Event`].
pub const EVENTS_TOPIC: &str = "/log";

/// Prefix of the names of the schemas.
const PACKAGE: &str = "foxglove.";

/// Bench time between two messages of the shape, for clients that have joined in between, ns.
const SHAPE_EVERY_NS: u64 = 1_000_000_000;

/// Most events per second of bench time: more events of a disturbance that changes with every step carry no
/// more information.
const MOST_EVENTS: u32 = 32;

/// A message for a panel.
#[derive(Debug, Clone, PartialEq)]
pub enum Panel {
    /// Poses of the vehicle.
    Transforms(FrameTransforms),
    /// Shape of the vehicle.
    Scene(SceneUpdate),
    /// An event as a log line.
    Event(Log),
}

/// Derives messages for panels.
pub struct Panels {
    poses: Poses,
    events: Events,
    vehicle: String,
    /// Bench time of the last message of the shape, ns.
    told_shape: Option<u64>,
    /// The second of bench time of the last event, and the number of events in it.
    told_events: (u64, u32),
}

impl Panels {
    /// For the panels of a bench. `effects`: the switchable effects by their number from 1.
    pub fn new(info: &BenchInfo, effects: BTreeMap<u32, String>) -> Self {
        Self {
            poses: Poses::new(info),
            events: Events::new(info, effects),
            vehicle: info.vehicle.clone(),
            told_shape: None,
            told_events: (0, 0),
        }
    }

    /// Derives panel messages from a message of the bench, and passes each to `tell` with its bench time, ns.
    pub fn hear(&mut self, message: &BenchMessage, mut tell: impl FnMut(u64, Panel)) {
        if let Some(transforms) = self.poses.hear(message) {
            let ns = message.head().stamp_ns;
            tell(ns, Panel::Transforms(transforms));
            // Topics are heard in batches, so that the time of one may lie far behind that of another.
            if self.told_shape.is_none_or(|told| ns.saturating_sub(told) >= SHAPE_EVERY_NS) {
                self.told_shape = Some(ns);
                let entities = shape::of(&self.vehicle, timestamp(ns));
                tell(ns, Panel::Scene(SceneUpdate { deletions: Vec::new(), entities }));
            }
        }
        if let Some(event) = self.events.hear(message) {
            let ns = (event.t * 1e9).round() as u64;
            if self.has_room_for_event(ns) {
                tell(ns, Panel::Event(line(&event, ns)));
            }
        }
    }

    /// Prepares for a new receiver: the shape is sent at once.
    pub fn begin_anew(&mut self) {
        self.told_shape = None;
    }

    /// The plant begins a new run.
    pub fn begin_run(&mut self) {
        self.begin_anew();
        self.poses.begin_run();
        self.events.begin_run();
    }

    fn has_room_for_event(&mut self, ns: u64) -> bool {
        let second = ns / 1_000_000_000;
        if self.told_events.0 != second {
            self.told_events = (second, 0);
        }
        self.told_events.1 += 1;
        self.told_events.1 <= MOST_EVENTS
    }
}

/// Whether a topic holds messages that [`Panels`] derived from others, so that it contains no information of
/// its own.
pub(crate) fn is_made_of_others(topic: &str, schema: &str) -> bool {
    [TRANSFORMS_TOPIC, SCENE_TOPIC, EVENTS_TOPIC].contains(&topic) && schema.starts_with(PACKAGE)
}

fn line(event: &Event, ns: u64) -> Log {
    let level = match event.kind {
        EventKind::Warning => Level::Warning,
        EventKind::Asked | EventKind::Disturbance | EventKind::Note => Level::Info,
    };
    Log {
        timestamp: Some(timestamp(ns)),
        level: level.into(),
        message: event.text.clone(),
        name: "whirlstand".into(),
        ..Log::default()
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use whirlstand_msgs::{Estimate, Head, Truth};

    use super::*;
    use crate::bench_info::SignalInfo;

    /// Behind busy processors, a recorder hears seconds of one topic before those of the next.
    #[test]
    fn the_shape_is_told_once_a_second_however_long_the_batches_of_topics_are() {
        let states = vec![SignalInfo::new("roll", "rad")];
        let info = BenchInfo { period_ns: 5_000_000, states, ..BenchInfo::default() };
        for steps_of_a_batch in [1, 100, 500, 1200] {
            let mut panels = Panels::new(&info, BTreeMap::new());
            let mut told = Vec::new();
            let steps: Vec<u64> = (0..1200).collect();
            for batch in steps.chunks(steps_of_a_batch) {
                let heads = batch.iter().map(|&step| Head { seq: step, step, stamp_ns: step * 5_000_000 });
                let estimates = heads.clone().map(|head| Estimate { head, ..Estimate::zeroed() }.into());
                let truths = heads.map(|head| Truth { head, ..Truth::zeroed() }.into());
                for message in estimates.chain(truths) {
                    panels.hear(&message, |ns, panel| {
                        if let Panel::Scene(_) = panel {
                            told.push(ns / 1_000_000);
                        }
                    });
                }
            }
            assert_eq!(told, [0, 1000, 2000, 3000, 4000, 5000], "batches of {steps_of_a_batch}");
        }
    }
}
