//! Any bytes at all, from an autopilot: nothing panics, every output is within its range, and every packet is counted.
//!
//! `cargo test` tries the kept corpus and some random inputs; `docs/bridges.md` says how to search for long.

use std::time::Duration;

use whirlstand_bridge::attitude_receiver::{AttitudeReceiver, TelemetryProtocol};
use whirlstand_bridge::autopilot::ardupilot::{Ardupilot, ArdupilotOptions, TELEMETRY};
use whirlstand_bridge::autopilot::betaflight::{Betaflight, BetaflightOptions, MOTORS, Packets, RAW};
use whirlstand_bridge::autopilot::px4::{Px4, Px4Options, STATION};
use whirlstand_bridge::autopilot::{Autopilot, Event, Rc};
use whirlstand_bridge::mavlink::dialect::{
    HIL_ACTUATOR_CONTROLS_DATA, HilActuatorControlsFlags, MavModeFlag,
};
use whirlstand_bridge::mavlink::{Encoder, MavMessage};
use whirlstand_bridge::sensors::{Errors, Motion, SensorModel, SensorOptions};
use whirlstand_bridge_fuzz::{mavlink_frame, msp_frame, pieces};

const PERIOD_NS: u64 = 4_000_000;

/// Deals the input out to a protocol: what comes, on which port and when, and when the sensors are sent in between.
fn drive(
    autopilot: &mut dyn Autopilot,
    ports: &[usize],
    input: &[u8],
    frame: impl Fn(&[u8], Duration) -> Vec<u8>,
) {
    let mut model = SensorModel::new(SensorOptions::default(), PERIOD_NS, 1);
    let mut now = Duration::ZERO;
    let (mut received, mut bytes) = (0, 0);
    for piece in pieces(input) {
        now += Duration::from_millis(1) + Duration::from_millis(200) * piece.pause();
        let port = ports[piece.choice() % ports.len()];
        let wire = piece.wire(|content| frame(content, now));
        // A look at what a stranger sent changes nothing.
        let before = autopilot.counts();
        autopilot.recognises(port, &wire, now);
        assert_eq!(autopilot.counts(), before);
        autopilot.receive(port, &wire, now, &mut |_, _| {});
        if piece.pause() == 1 {
            autopilot.end_of_datagram(port);
        }
        received += 1;
        bytes += wire.len() as u64;
        while let Some(event) = autopilot.next() {
            if let Event::Outputs(outputs) = event {
                assert!(outputs.values.iter().all(|v| v.is_nan() || (-1.0..=1.0).contains(v)), "{outputs:?}");
            }
        }
        if piece.choice() < 2 {
            let sensors = model.step(&Motion::default(), &Errors::default());
            autopilot.sense(&sensors, &Rc::default(), now, &mut |_, _| {});
        }
        if piece.choice() == 3 && piece.pause() == 3 {
            autopilot.disconnected(port);
        }
    }
    let counts = autopilot.counts();
    assert!(ports.len() > 1 || counts.outputs + counts.repeated + counts.dropped() <= received + bytes);
}

#[test]
fn px4() {
    bolero::check!().for_each(|input: &[u8]| {
        let mut px4 = Px4::new(Px4Options { rc: true, ..Px4Options::default() }, true);
        drive(&mut px4, &[0, STATION], input, |piece, now| {
            if piece.first().is_some_and(|b| b & 1 == 1) {
                return mavlink_frame(&piece[1..]);
            }
            // Outputs with any content.
            let byte = |i: usize| piece.get(i).copied().unwrap_or(0);
            let float = |i: usize| f32::from_le_bytes([byte(i), byte(i + 1), byte(i + 2), byte(i + 3)]);
            let message = MavMessage::HIL_ACTUATOR_CONTROLS(HIL_ACTUATOR_CONTROLS_DATA {
                time_usec: u64::from_le_bytes(std::array::from_fn(|i| byte(4 + i))),
                flags: HilActuatorControlsFlags::from_bits_retain(u64::from(byte(0))),
                mode: MavModeFlag::from_bits_retain(byte(1)),
                controls: std::array::from_fn(|i| float(12 + 4 * i)),
            });
            let mut out = Vec::new();
            Encoder::new(byte(2), byte(3)).encode(&message, now, &mut out);
            out
        });
    });
}

#[test]
fn ardupilot() {
    bolero::check!().for_each(|input: &[u8]| {
        let mut ardupilot =
            Ardupilot::new(ArdupilotOptions::default(), input.first().is_some_and(|b| b & 1 == 0));
        drive(&mut ardupilot, &[0], input, |piece, _| {
            let wide = piece.first().is_some_and(|b| b & 1 == 1);
            let (magic, length) = if wide { (29569u16, 72) } else { (18458u16, 40) };
            let mut bytes = [&magic.to_le_bytes(), piece].concat();
            bytes.resize(length, 0);
            // A small number is one that may follow.
            if bytes[5] & 3 != 0 {
                bytes[5..8].fill(0);
            }
            bytes
        });
        let counts = ardupilot.counts();
        // What it says beside the loop is none of its outputs.
        let mut beside = Ardupilot::new(ArdupilotOptions::default(), true);
        drive(&mut beside, &[TELEMETRY], input, |piece, _| mavlink_frame(piece));
        assert_eq!(beside.counts().outputs, 0);
        assert_eq!(counts.malformed + counts.outputs + counts.repeated + counts.stale == 0, input.is_empty());
    });
}

#[test]
fn betaflight() {
    bolero::check!().for_each(|input: &[u8]| {
        let packets = if input.first().is_some_and(|b| b & 1 == 0) { Packets::Raw } else { Packets::Motors };
        let options = BetaflightOptions { packets, ..BetaflightOptions::default() };
        let motors = input.first().is_some_and(|b| b & 2 == 0);
        let mut betaflight = Betaflight::new(options, motors);
        drive(&mut betaflight, &[RAW, MOTORS], input, |piece, _| {
            let mut bytes = piece.to_vec();
            bytes.resize(if piece.len() > 16 { 68 } else { 16 }, 0);
            bytes
        });
    });
}

/// What an autopilot tells of its attitude, in both languages: a number within a turn, or nothing.
#[test]
fn attitude_receiver() {
    bolero::check!().for_each(|input: &[u8]| {
        let protocol = if input.first().is_some_and(|b| b & 1 == 0) {
            TelemetryProtocol::Mavlink
        } else {
            TelemetryProtocol::Msp
        };
        let mut receiver = AttitudeReceiver::new(protocol);
        let now = Duration::from_secs(1);
        for piece in pieces(input) {
            let wire = match protocol {
                TelemetryProtocol::Mavlink => piece.wire(mavlink_frame),
                TelemetryProtocol::Msp => piece.wire(msp_frame),
            };
            receiver.receive(&wire, now);
            receiver.ask(now, &mut Vec::new());
        }
        let attitude = receiver.attitude(Duration::ZERO, now);
        assert!(attitude.is_none_or(|a| a.iter().all(|angle| angle.abs() <= 3.15)), "{attitude:?}");
    });
}
