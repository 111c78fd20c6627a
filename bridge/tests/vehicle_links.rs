//! Lines that are wrong, and lines that come back.

mod support;

use std::time::Duration;

use support::{Pair, config};
use whirlstand_bridge::arming::Mode;
use whirlstand_bridge::config::BridgeKind;
use whirlstand_bridge::vehicle::{Group, Port, Vehicle};

/// What a line at half the baud rate gives: each byte is read as two others.
fn at_half_the_rate(bytes: &[u8]) -> Vec<u8> {
    let double = |nibble: u8| (0..4).map(|i| (nibble >> i & 1) * (0b11 << (2 * i))).sum::<u8>();
    bytes.iter().flat_map(|b| [double(b & 15), double(b >> 4)]).collect()
}

#[test]
fn a_wrong_baud_rate_is_told_once_in_words() {
    let mut pair = Pair::new(&config());
    let mut bytes = Vec::new();
    for _ in 0..40 {
        pair.autopilot.encode(&pair.attitude(0.1), pair.now, &mut bytes);
    }
    for piece in at_half_the_rate(&bytes).chunks(50) {
        pair.now += Duration::from_millis(5);
        pair.vehicle.receive(Port::Link, piece, false, pair.now);
    }
    let told: Vec<_> = pair.notes().into_iter().filter(|n| n.contains("is the baud rate right")).collect();
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].contains("none of them is MAVLink"), "{told:?}");
    let figures = pair.vehicle.figures();
    assert!(figures.messages == 0 && figures.noise_bytes > 0, "{figures:?}");

    let mut crsf = config();
    crsf.kind = BridgeKind::Crsf;
    crsf.options.safety.arm = whirlstand_bridge::arming::ArmBy::Start;
    crsf.options.crsf = serde_json::from_str(r#"{"link": "serial:///dev/x:115200"}"#).unwrap();
    let mut vehicle = Vehicle::new(&crsf, support::bench()).unwrap();
    let mut bytes = Vec::new();
    for _ in 0..40 {
        let attitude = whirlstand_bridge::crsf::Attitude { roll: 0.1, pitch: 0.2, yaw: 0.3 };
        whirlstand_bridge::crsf::write_attitude(&attitude, &mut bytes);
    }
    vehicle.receive(Port::Link, &at_half_the_rate(&bytes), false, Duration::from_secs(1));
    let told: Vec<_> = std::iter::from_fn(|| vehicle.note()).map(|n| n.text).collect();
    assert!(told.iter().any(|n| n.contains("is the baud rate right (416666 or 420000)")), "{told:?}");
}

#[test]
fn half_a_message_of_a_lost_line_does_not_spoil_the_next_line() {
    let mut pair = Pair::flying(&config());
    let mut bytes = Vec::new();
    pair.autopilot.encode(&pair.attitude(0.5), pair.now, &mut bytes);
    pair.vehicle.receive(Port::Link, &bytes[..15], false, pair.now);
    pair.silence(1000, [10.0, -4.0]);
    assert!(matches!(pair.vehicle.mode(), Mode::Failed(_)));
    let lost = |pair: &mut Pair| pair.vehicle.figures().dropped + pair.vehicle.figures().noise_bytes;
    let before = lost(&mut pair);
    pair.vehicle.connected(Port::Link);
    assert!(lost(&mut pair) > before, "the half is counted");
    pair.heard.clear();
    pair.say(&pair.heartbeat());
    pair.say(&pair.attitude(0.25));
    assert_eq!(
        pair.vehicle.telemetry().values(Group::Attitude).unwrap()[0],
        0.25,
        "the first message counts"
    );
    for _ in 0..20 {
        pair.step([10.0, -4.0]);
    }
    let asked = |m: &whirlstand_bridge::mavlink::MavMessage| {
        matches!(m, whirlstand_bridge::mavlink::MavMessage::COMMAND_LONG(_))
    };
    assert!(pair.heard.iter().any(asked), "its messages are asked for again");
    assert_eq!(pair.channels(), Some([1500, 1500]), "and nobody is in charge until it is armed again");
}
