//! Any bytes at all, from an autopilot: nothing panics, every output is within its range, and every packet is counted.
//!
//! `cargo test` tries the kept corpus and some random inputs; `docs/bridges.md` says how to search for long.

use std::time::Duration;

use whirlstand_bridge::autopilot::ardupilot::{Ardupilot, ArdupilotOptions};
use whirlstand_bridge::autopilot::betaflight::{Betaflight, BetaflightOptions, MOTORS, Packets, RAW};
use whirlstand_bridge::autopilot::px4::{Px4, Px4Options};
use whirlstand_bridge::autopilot::{Autopilot, Event, Rc};
use whirlstand_bridge::mavlink::dialect::{
    HIL_ACTUATOR_CONTROLS_DATA, HilActuatorControlsFlags, MavModeFlag,
};
use whirlstand_bridge::mavlink::{Encoder, MavMessage};
use whirlstand_bridge::sensors::{Errors, Motion, SensorModel, SensorOptions};
use whirlstand_bridge::witness::{Language, Witness};

const PERIOD_NS: u64 = 4_000_000;

/// Deals the input out to a protocol: the first byte of each piece says what is done with it and how long it is.
fn drive(
    autopilot: &mut dyn Autopilot,
    ports: &[usize],
    input: &[u8],
    frame: impl Fn(&[u8], Duration) -> Vec<u8>,
) {
    let mut model = SensorModel::new(SensorOptions::default(), PERIOD_NS, 1);
    let mut now = Duration::ZERO;
    let mut rest = input;
    let mut received = 0;
    while let Some((&op, tail)) = rest.split_first() {
        now += Duration::from_millis(u64::from(op & 7) * 100);
        let (piece, tail) = tail.split_at(tail.len().min(usize::from(op >> 1)));
        rest = tail;
        let port = ports[usize::from(op) % ports.len()];
        let bytes = if op & 1 == 0 { piece.to_vec() } else { frame(piece, now) };
        autopilot.receive(port, &bytes, now, &mut |_, _| {});
        received += 1;
        while let Some(event) = autopilot.next() {
            if let Event::Outputs(outputs) = event {
                assert!(outputs.values.iter().all(|v| v.is_nan() || (-1.0..=1.0).contains(v)), "{outputs:?}");
            }
        }
        if op & 0x18 == 0 {
            let sensors = model.step(&Motion::default(), &Errors::default());
            autopilot.sense(&sensors, &Rc::default(), now, &mut |_, _| {});
        }
        if op == 0xFF {
            autopilot.disconnected(port);
        }
    }
    let counts = autopilot.counts();
    assert!(
        ports.len() > 1
            || counts.outputs + counts.repeated + counts.dropped() <= received + input.len() as u64
    );
}

#[test]
fn px4() {
    bolero::check!().for_each(|input: &[u8]| {
        let mut px4 = Px4::new(Px4Options { rc: true, ..Px4Options::default() }, true);
        drive(&mut px4, &[0], input, |piece, now| {
            // A whole message with any content.
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
            bytes
        });
        let counts = ardupilot.counts();
        assert_eq!(counts.malformed + counts.outputs + counts.repeated + counts.stale == 0, input.is_empty());
    });
}

#[test]
fn betaflight() {
    bolero::check!().for_each(|input: &[u8]| {
        let packets = if input.first().is_some_and(|b| b & 1 == 0) { Packets::Raw } else { Packets::Motors };
        let options = BetaflightOptions { packets, ..BetaflightOptions::default() };
        let motors = input.first().is_some_and(|b| b & 2 == 0);
        let mut betaflight = Betaflight::new(options, motors, Duration::from_nanos(PERIOD_NS));
        drive(&mut betaflight, &[RAW, MOTORS], input, |piece, _| {
            let mut bytes = piece.to_vec();
            bytes.resize(if piece.len() > 16 { 68 } else { 16 }, 0);
            bytes
        });
    });
}

/// What an autopilot tells of its attitude, in both languages: a number within a turn, or nothing.
#[test]
fn witness() {
    bolero::check!().for_each(|input: &[u8]| {
        let language =
            if input.first().is_some_and(|b| b & 1 == 0) { Language::Mavlink } else { Language::Msp };
        let mut witness = Witness::new(language);
        let now = Duration::from_secs(1);
        for piece in input.chunks(37) {
            witness.receive(piece, now);
            witness.ask(now, &mut Vec::new());
        }
        let attitude = witness.attitude(Duration::ZERO, now);
        assert!(attitude.is_none_or(|a| a.iter().all(|angle| angle.abs() <= 3.15)), "{attitude:?}");
    });
}
