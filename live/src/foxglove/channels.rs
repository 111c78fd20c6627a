//! The Foxglove channels of a bench, and the messages sent on each.

use std::collections::HashMap;
use std::sync::Arc;

use foxglove::messages::{FrameTransforms, Log, SceneUpdate};
use foxglove::{Channel, Context, FoxgloveError, PartialMetadata, RawChannel, Schema};
use whirlstand_logs::panels::{EVENTS_TOPIC, Panel, Panels, SCENE_TOPIC, TRANSFORMS_TOPIC};
use whirlstand_logs::{BenchInfo, BenchMessage, CDR_HEADER};
use whirlstand_vehicle::Vehicle;

use crate::scene::SwitchedEffect;

/// The channels of one bench, open until dropped.
pub(super) struct Channels {
    raw: HashMap<&'static str, Arc<RawChannel>>,
    panels: Panels,
    transforms: Channel<FrameTransforms>,
    scene: Channel<SceneUpdate>,
    events: Channel<Log>,
    /// Latest bench time, ns, which is used for messages that carry wall-clock time.
    bench_ns: u64,
    scratch: Vec<u8>,
}

impl Channels {
    pub fn open(context: &Arc<Context>, info: &BenchInfo, vehicle: &Vehicle) -> Result<Self, FoxgloveError> {
        let mut raw = HashMap::new();
        for message in BenchMessage::types(info) {
            let schema = Schema::new(message.name, "ros2msg", message.schema.into_bytes());
            let channel = context.channel_builder(format!("/{}", message.topic));
            raw.insert(message.topic, channel.message_encoding("cdr").schema(schema).build_raw()?);
        }
        let effects = SwitchedEffect::all(vehicle).into_iter().map(|e| (e.number, e.text)).collect();
        Ok(Self {
            raw,
            panels: Panels::new(info, effects),
            transforms: context.channel_builder(TRANSFORMS_TOPIC).build(),
            scene: context.channel_builder(SCENE_TOPIC).build(),
            events: context.channel_builder(EVENTS_TOPIC).build(),
            bench_ns: 0,
            scratch: Vec::with_capacity(1024),
        })
    }

    /// Sends a message, and the panel messages derived from it, with bench time on all channels.
    pub fn hear(&mut self, message: &BenchMessage) {
        if let Some(stamp) = message.bench_ns() {
            let leads = matches!(message, BenchMessage::Imu(_));
            if leads && stamp < self.bench_ns && message.head().step == 0 {
                self.panels.begin_run();
            }
            // In a new run of the plant, bench time begins at zero again.
            self.bench_ns = if leads { stamp } else { self.bench_ns.max(stamp) };
        }
        let (topic, image) = message.raw();
        let Some(channel) = self.raw.get(topic) else { return };
        let at = |ns: u64| PartialMetadata { log_time: Some(ns) };
        self.scratch.clear();
        self.scratch.extend_from_slice(&CDR_HEADER);
        self.scratch.extend_from_slice(image);
        channel.log_with_meta(&self.scratch, at(message.bench_ns().unwrap_or(self.bench_ns)));
        let Self { panels, transforms, scene, events, .. } = self;
        panels.hear(message, |ns, panel| match panel {
            Panel::Transforms(m) => transforms.log_with_meta(&m, at(ns)),
            Panel::Scene(m) => scene.log_with_meta(&m, at(ns)),
            Panel::Event(m) => events.log_with_meta(&m, at(ns)),
        });
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
