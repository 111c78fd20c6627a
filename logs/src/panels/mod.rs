//! What the panels of Foxglove and Lichtblick understand by themselves: the vehicle's pose and shape, and events as log lines.
//!
//! They are made of the messages of a bench, here and nowhere else, for the live server and for the log. Types and schemas are
//! those of Foxglove's own SDK.

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

/// What the names of the schemas begin with.
const PACKAGE: &str = "foxglove.";

/// Bench time between two looks of the shape, for clients that came meanwhile, ns.
const SHAPE_EVERY_NS: u64 = 1_000_000_000;

/// Events of a second of bench time, at most: of a disturbance that changes with every step more tell no more.
const MOST_EVENTS: u32 = 32;

/// A message for a panel.
#[derive(Debug, Clone, PartialEq)]
pub enum Panel {
    /// Where the vehicle is.
    Transforms(FrameTransforms),
    /// What it looks like.
    Scene(SceneUpdate),
    /// Something happened.
    Event(Log),
}

/// Makes messages for panels.
pub struct Panels {
    poses: Poses,
    events: Events,
    vehicle: String,
    /// When the shape was told last, ns of bench time.
    told_shape: Option<u64>,
    /// The second in which events were told last, and how many.
    told_events: (u64, u32),
}

impl Panels {
    /// Those of a bench. `effects`: those that can be switched, by their number from 1.
    pub fn new(info: &BenchInfo, effects: BTreeMap<u32, String>) -> Self {
        Self {
            poses: Poses::new(info),
            events: Events::new(info, effects),
            vehicle: info.vehicle.clone(),
            told_shape: None,
            told_events: (0, 0),
        }
    }

    /// What a message of the bench tells, with the bench time at which, ns.
    pub fn hear(&mut self, message: &BenchMessage, mut tell: impl FnMut(u64, Panel)) {
        if let Some(transforms) = self.poses.hear(message) {
            let ns = message.head().stamp_ns;
            tell(ns, Panel::Transforms(transforms));
            if self.told_shape.is_none_or(|told| ns.abs_diff(told) >= SHAPE_EVERY_NS) {
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

    /// What follows is for somebody who has heard nothing: the shape is told at once.
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

/// Whether a topic holds what was made of others by [`Panels`], so that it tells nothing of its own.
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
