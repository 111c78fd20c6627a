//! Fuzz targets of the decoders that face a vehicle and a pilot. `cargo test` runs each on its corpus and on some
//! random inputs; `docs/bridges.md` says how to run ten million.

use std::time::Duration;

use bolero::check;
use whirlstand_bridge::arming::Mode;
use whirlstand_bridge::channels::Input;
use whirlstand_bridge::config::{BridgeConfig, BridgeKind, BridgeOptions};
use whirlstand_bridge::mavlink::{Deframer, Event};
use whirlstand_bridge::turning::OwnMotion;
use whirlstand_bridge::vehicle::{Bench, Port, Vehicle};
use whirlstand_bridge::{crsf, sbus};
use whirlstand_bridge_fuzz::{crsf_frame, mavlink_frame, pieces, sbus_frame};

#[test]
fn fuzz_mavlink_deframer() {
    check!().for_each(|bytes: &[u8]| {
        let mut deframer = Deframer::new();
        let mut messages = 0;
        let mut sent = 0;
        for piece in pieces(bytes) {
            let wire = piece.wire(mavlink_frame);
            sent += wire.len() as u64;
            deframer.push(&wire);
            while let Some(event) = deframer.next(Duration::from_secs(1)) {
                messages += u64::from(matches!(event, Event::Message(..)));
            }
        }
        deframer.end();
        let counts = deframer.counts();
        assert_eq!((counts.bytes, counts.messages), (sent, messages));
        assert!(sent == 0 || messages + counts.dropped() + counts.noise_bytes > 0);
    });
}

#[test]
fn fuzz_crsf_parser() {
    check!().for_each(|bytes: &[u8]| {
        let mut parser = crsf::Parser::new();
        let mut sent = 0;
        for piece in pieces(bytes) {
            let wire = piece.wire(crsf_frame);
            sent += wire.len() as u64;
            parser.push(&wire);
            while let Some(event) = parser.next_event() {
                if let crsf::Event::Channels(c) = event {
                    assert!(c.0.iter().all(|ticks| *ticks < 2048));
                }
            }
        }
        parser.reset();
        let counts = parser.counts();
        assert_eq!(counts.bytes, sent);
        assert!(sent == 0 || counts.frames + counts.checksum + counts.malformed + counts.noise_bytes > 0);
    });
}

#[test]
fn fuzz_sbus_parser() {
    check!().for_each(|bytes: &[u8]| {
        let mut parser = sbus::Parser::new();
        for piece in pieces(bytes) {
            parser.push(&piece.wire(sbus_frame));
            while let Some(frame) = parser.next_frame() {
                assert!(frame.channels.iter().all(|ticks| *ticks < 2048));
            }
        }
        parser.reset();
        let counts = parser.counts();
        assert_eq!(counts.bytes, counts.noise_bytes + counts.frames * sbus::FRAME as u64);
    });
}

/// The whole bridge: bytes on every port, commands in between. What goes out stays within the limits and, while nobody
/// is in charge, at neutral.
#[test]
fn fuzz_vehicle() {
    let options: BridgeOptions = serde_json::from_str(
        r#"{
            "safety": {"arm": "autopilot"},
            "mavlink": {"link": "x", "forward": "y"},
            "pilot": {"source": "sbus", "link": "z"}
        }"#,
    )
    .unwrap();
    let config = BridgeConfig { kind: BridgeKind::Mavlink, options };
    let inputs =
        ["u_roll", "u_pitch"].map(|name| Input { name: name.into(), full: 1.0, turns: [1.0; 3] }).to_vec();
    check!().for_each(|bytes: &[u8]| {
        let bench = Bench {
            inputs: inputs.clone(),
            own: OwnMotion::default(),
            rate_hz: 200.0,
            wants_odometry: true,
            signing: None,
        };
        let Ok(mut vehicle) = Vehicle::new(&config, bench) else { panic!("the options are right") };
        let mut now = Duration::from_secs(1);
        for piece in pieces(bytes) {
            now += Duration::from_millis(3) + Duration::from_millis(40) * piece.pause();
            let (port, frame): (_, fn(&[u8]) -> Vec<u8>) = match piece.choice() {
                0 | 1 => (Port::Link, mavlink_frame),
                2 => (Port::Pilot, sbus_frame),
                _ => (Port::Ground, mavlink_frame),
            };
            let content = piece.content;
            let wire = piece.wire(frame);
            if vehicle.recognises(port, &wire, now) && content.len() % 5 == 0 {
                vehicle.peer_changed(port);
            }
            vehicle.receive(port, &wire, content.len() % 2 == 0, now);
            let asked = content.first().map_or(f64::NAN, |b| f64::from(*b) / 64.0 - 2.0);
            vehicle.command(&[asked, 2.0], now);
            vehicle.poll(now);
            let (us, in_use) = vehicle.channels();
            assert!(us.iter().all(|us| (1000.0..=2000.0).contains(us)));
            if vehicle.mode() == Mode::Disarmed {
                assert!(us.iter().zip(in_use).take(2).all(|(us, used)| !used || *us == 1500.0));
            }
            let (imu, odometry) = vehicle.measure();
            assert!(imu.roll.is_finite() && odometry.height.is_finite());
            for port in [Port::Link, Port::Output, Port::Pilot, Port::Ground] {
                let bytes = std::mem::take(vehicle.output(port)).len();
                if bytes > 0 {
                    vehicle.handed_on(port, bytes, content.len() % 7 != 0, now);
                }
            }
        }
    });
}
