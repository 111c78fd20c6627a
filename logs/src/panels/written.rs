//! Messages for panels in a log.

use foxglove::Encode;
use foxglove::messages::{FrameTransforms, Log, SceneUpdate};

use super::{EVENTS_TOPIC, Panel, SCENE_TOPIC, TRANSFORMS_TOPIC};
use crate::writer::{EncodedChannel, LogWriter, WriteError};

/// Channels of the panel messages in a log.
pub struct PanelChannels {
    transforms: EncodedChannel,
    scene: EncodedChannel,
    events: EncodedChannel,
    scratch: Vec<u8>,
}

impl PanelChannels {
    /// Adds the channels to a log.
    ///
    /// # Errors
    /// [`WriteError::Write`].
    pub fn open(log: &mut LogWriter) -> Result<Self, WriteError> {
        Ok(Self {
            transforms: channel::<FrameTransforms>(log, TRANSFORMS_TOPIC)?,
            scene: channel::<SceneUpdate>(log, SCENE_TOPIC)?,
            events: channel::<Log>(log, EVENTS_TOPIC)?,
            scratch: Vec::new(),
        })
    }

    /// Adds a message at a bench time, ns.
    ///
    /// # Errors
    /// [`WriteError::Write`].
    pub fn write(&mut self, log: &mut LogWriter, ns: u64, panel: &Panel) -> Result<(), WriteError> {
        self.scratch.clear();
        let (channel, encoded) = match panel {
            Panel::Transforms(m) => (&mut self.transforms, m.encode(&mut self.scratch)),
            Panel::Scene(m) => (&mut self.scene, m.encode(&mut self.scratch)),
            Panel::Event(m) => (&mut self.events, m.encode(&mut self.scratch)),
        };
        // Encoding fails only for a buffer without space, and this buffer grows.
        debug_assert!(encoded.is_ok());
        log.write_encoded(channel, ns, &self.scratch)
    }
}

fn channel<T: Encode>(log: &mut LogWriter, topic: &str) -> Result<EncodedChannel, WriteError> {
    let schema = T::get_schema();
    let schema = schema.as_ref().map(|s| (s.name.as_str(), s.encoding.as_str(), &*s.data));
    log.encoded_channel(topic, schema, &T::get_message_encoding())
}
