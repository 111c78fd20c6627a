//! The topics that are offered, and what goes out on each.

use std::collections::HashMap;
use std::sync::Arc;

use foxglove::messages::log::Level;
use foxglove::messages::{FrameTransforms, Log, SceneUpdate};
use foxglove::{Channel, Context, FoxgloveError, PartialMetadata, RawChannel, Schema};
use whirlstand_logs::{BenchInfo, CDR_HEADER};
use whirlstand_vehicle::Vehicle;

use super::poses::{Poses, timestamp};
use super::shape;
use crate::events::{Event, EventKind};
use crate::heard::Heard;

/// Bench time between two looks of the shape, for clients that came meanwhile, s.
const SHAPE_EVERY_S: f64 = 1.0;

/// The topics of one bench, until dropped.
pub(super) struct Channels {
    raw: HashMap<&'static str, Arc<RawChannel>>,
    poses: Poses,
    transforms: Channel<FrameTransforms>,
    scene: Channel<SceneUpdate>,
    events: Channel<Log>,
    vehicle: String,
    /// When the shape was told last, ns of bench time.
    told_shape: Option<u64>,
    /// Latest bench time, ns: where messages that carry the wall clock's are put.
    bench_ns: u64,
    scratch: Vec<u8>,
}

impl Channels {
    pub fn open(
        context: &Arc<Context>,
        info: &BenchInfo,
        vehicle: &Vehicle,
        period_s: f64,
    ) -> Result<Self, FoxgloveError> {
        let mut raw = HashMap::new();
        for heard in Heard::types(info) {
            let schema = Schema::new(heard.name, "ros2msg", heard.schema.into_bytes());
            let channel = context.channel_builder(format!("/{}", heard.topic));
            raw.insert(heard.topic, channel.message_encoding("cdr").schema(schema).build_raw()?);
        }
        Ok(Self {
            raw,
            poses: Poses::new(vehicle, period_s),
            transforms: context.channel_builder("/tf").build(),
            scene: context.channel_builder("/scene").build(),
            events: context.channel_builder("/log").build(),
            vehicle: vehicle.name.clone(),
            told_shape: None,
            bench_ns: 0,
            scratch: Vec::with_capacity(1024),
        })
    }

    /// Hands on a message, with bench time on all channels.
    pub fn hear(&mut self, heard: &Heard) {
        if !matches!(heard, Heard::Health(_)) {
            let stamp = heard.head().stamp_ns;
            // A new run of the plant begins at zero again.
            self.bench_ns = if matches!(heard, Heard::Imu(_)) { stamp } else { self.bench_ns.max(stamp) };
        }
        let (topic, image) = heard.raw();
        let Some(channel) = self.raw.get(topic) else { return };
        let stamp_ns = match heard {
            Heard::Health(_) => self.bench_ns,
            other => other.head().stamp_ns,
        };
        let time = PartialMetadata { log_time: Some(stamp_ns) };
        self.scratch.clear();
        self.scratch.extend_from_slice(&CDR_HEADER);
        self.scratch.extend_from_slice(image);
        channel.log_with_meta(&self.scratch, time);
        if let Some(transforms) = self.poses.hear(heard) {
            self.transforms.log_with_meta(&transforms, time);
            self.show_shape(stamp_ns);
        }
    }

    /// Hands on something that happened.
    pub fn tell(&self, event: &Event) {
        let level = match event.kind {
            EventKind::Warning => Level::Warning,
            EventKind::Asked | EventKind::Disturbance | EventKind::Note => Level::Info,
        };
        let ns = (event.t * 1e9).round() as u64;
        let line = Log {
            timestamp: Some(timestamp(ns)),
            level: level.into(),
            message: event.text.clone(),
            name: "whirlstand".into(),
            ..Log::default()
        };
        self.events.log_with_meta(&line, PartialMetadata { log_time: Some(ns) });
    }

    fn show_shape(&mut self, ns: u64) {
        let since = |told: u64| ns.abs_diff(told) as f64 * 1e-9;
        if self.told_shape.is_none_or(|told| since(told) >= SHAPE_EVERY_S) {
            self.told_shape = Some(ns);
            let scene =
                SceneUpdate { deletions: Vec::new(), entities: shape::of(&self.vehicle, timestamp(ns)) };
            self.scene.log_with_meta(&scene, PartialMetadata { log_time: Some(ns) });
        }
    }
}

impl Drop for Channels {
    fn drop(&mut self) {
        self.raw.values().for_each(|channel| channel.close());
        self.transforms.close();
        self.scene.close();
        self.events.close();
    }
}
