//! A vehicle bridge and a peer that speaks MAVLink to it, over no wire at all.

use std::time::Duration;

use whirlstand_bridge::arming::ArmBy;
use whirlstand_bridge::channels::Input;
use whirlstand_bridge::config::{BridgeConfig, BridgeKind, BridgeOptions, MavlinkConfig, OnFailure};
use whirlstand_bridge::mavlink::{Deframer, Encoder, Event, MavMessage, dialect};
use whirlstand_bridge::turning::OwnMotion;
use whirlstand_bridge::vehicle::{Bench, Port, Vehicle};

/// Limit of the inputs.
pub const FULL: f64 = 20.0;

/// The table `[bridge.mavlink]` of a text.
pub fn mavlink(text: &str) -> MavlinkConfig {
    serde_json::from_str(text).unwrap()
}

/// A bridge that arms by the autopilot.
pub fn config() -> BridgeConfig {
    let mut options = BridgeOptions::default();
    options.safety.arm = ArmBy::Autopilot;
    options.mavlink = Some(mavlink(r#"{"link": "udpin://127.0.0.1:14550"}"#));
    BridgeConfig { kind: BridgeKind::Mavlink, options }
}

pub fn releasing(mut config: BridgeConfig) -> BridgeConfig {
    config.options.safety.on_failure = OnFailure::Release;
    config
}

pub fn bench() -> Bench {
    turning(1.0)
}

/// A bench whose `u_roll` accelerates roll and `u_pitch` pitch, by so much each.
pub fn turning(by: f64) -> Bench {
    let mut inputs =
        ["u_roll", "u_pitch"].map(|name| Input { name: name.into(), full: FULL, turns: [0.0; 3] });
    (inputs[0].turns[0], inputs[1].turns[1]) = (by, by);
    Bench {
        inputs: inputs.to_vec(),
        own: OwnMotion::default(),
        rate_hz: 200.0,
        wants_odometry: true,
        signing: None,
    }
}

/// Both ends and the time between them.
pub struct Pair {
    pub vehicle: Vehicle,
    pub autopilot: Encoder,
    pub listener: Deframer,
    pub now: Duration,
    pub armed: bool,
    pub state: dialect::MavState,
    /// The autopilot's clock is ahead by this.
    pub boot: Duration,
    /// False while the line takes nothing.
    pub takes: bool,
    /// What the vehicle sent and the line took, in order.
    pub heard: Vec<MavMessage>,
}

impl Pair {
    pub fn new(config: &BridgeConfig) -> Self {
        Self::with(config, bench())
    }

    /// A bridge to this bench.
    pub fn with(config: &BridgeConfig, bench: Bench) -> Self {
        Self {
            vehicle: Vehicle::new(config, bench).unwrap(),
            autopilot: Encoder::new(1, 1),
            listener: Deframer::new(),
            now: Duration::from_secs(1),
            armed: false,
            state: dialect::MavState::MAV_STATE_ACTIVE,
            boot: Duration::from_secs(60),
            takes: true,
            heard: Vec::new(),
        }
    }

    pub fn heartbeat(&self) -> MavMessage {
        let armed = if self.armed {
            dialect::MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED
        } else {
            dialect::MavModeFlag::empty()
        };
        MavMessage::HEARTBEAT(dialect::HEARTBEAT_DATA {
            mavtype: dialect::MavType::MAV_TYPE_QUADROTOR,
            autopilot: dialect::MavAutopilot::MAV_AUTOPILOT_GENERIC,
            base_mode: armed,
            system_status: self.state,
            mavlink_version: 3,
            ..Default::default()
        })
    }

    pub fn attitude(&self, roll: f32) -> MavMessage {
        MavMessage::ATTITUDE(dialect::ATTITUDE_DATA {
            time_boot_ms: (self.now + self.boot).as_millis() as u32,
            roll,
            ..Default::default()
        })
    }

    /// The autopilot says something.
    pub fn say(&mut self, message: &MavMessage) {
        let mut bytes = Vec::new();
        self.autopilot.encode(message, self.now, &mut bytes);
        self.vehicle.receive(Port::Link, &bytes, false, self.now);
    }

    /// Five milliseconds in which everything is well: heartbeat, attitude, command.
    pub fn step(&mut self, u: [f64; 2]) {
        self.now += Duration::from_millis(5);
        self.say(&self.heartbeat());
        self.say(&self.attitude(0.0));
        self.vehicle.measure();
        self.vehicle.command(&u, self.now);
        self.vehicle.poll(self.now);
        self.listen();
    }

    /// Time in which the autopilot says nothing while commands go on.
    pub fn silence(&mut self, ms: u64, u: [f64; 2]) {
        for _ in 0..ms / 5 {
            self.now += Duration::from_millis(5);
            self.vehicle.command(&u, self.now);
            self.vehicle.poll(self.now);
            self.listen();
        }
    }

    /// Hears what the vehicle sent, as far as the line takes it.
    pub fn listen(&mut self) {
        let mut bytes = std::mem::take(self.vehicle.output(Port::Link));
        if !bytes.is_empty() {
            self.vehicle.handed_on(Port::Link, bytes.len(), self.takes, self.now);
        }
        if !self.takes {
            return;
        }
        while let Some(frame) = self.vehicle.next_forwarded(self.now) {
            bytes.extend(frame);
        }
        self.listener.push(&bytes);
        while let Some(event) = self.listener.next(self.now) {
            match event {
                Event::Message(_, message) => self.heard.push(message),
                Event::Dropped(drop) => panic!("the vehicle sent {drop:?}"),
            }
        }
    }

    /// The first two channels of the last override; 0 for one that was given back.
    pub fn channels(&self) -> Option<[u16; 2]> {
        self.heard.iter().rev().find_map(|m| match m {
            MavMessage::RC_CHANNELS_OVERRIDE(o) => Some([o.chan1_raw, o.chan2_raw]),
            _ => None,
        })
    }

    /// Notes that were written since the last call.
    pub fn notes(&mut self) -> Vec<String> {
        std::iter::from_fn(|| self.vehicle.note()).map(|n| n.text).collect()
    }

    /// Armed and flying.
    pub fn flying(config: &BridgeConfig) -> Self {
        let mut pair = Self::new(config);
        for _ in 0..10 {
            pair.step([10.0, -4.0]);
        }
        pair.armed = true;
        pair.step([10.0, -4.0]);
        pair
    }
}
