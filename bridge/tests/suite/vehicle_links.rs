//! Lines that are wrong, and lines that come back.

use std::time::Duration;

use whirlstand_bridge::arming::Mode;
use whirlstand_bridge::config::BridgeKind;
use whirlstand_bridge::mavlink::{Encoder, Key, MavMessage, Signing, dialect};
use whirlstand_bridge::vehicle::{Bench, Group, Port, Vehicle};

use crate::support::{self, Pair, config};

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
    let told: Vec<_> = pair.notes().into_iter().filter(|n| n.contains("check the baud rate")).collect();
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].contains("none of them MAVLink"), "{told:?}");
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
    assert!(told.iter().any(|n| n.contains("check the baud rate (416666 or 420000)")), "{told:?}");
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

fn signed(key: &str) -> Signing {
    Signing::new(Key::from_passphrase(key), 0, Duration::from_secs(1_700_000_000))
}

#[test]
fn a_wrong_signing_key_is_told_as_such_and_not_as_a_baud_rate() {
    for is_datagram in [true, false] {
        let bench = || Bench { signing: Some(signed("ours")), ..support::bench() };
        let mut vehicle = Vehicle::new(&config(), bench()).unwrap();
        // What each channel does is told before anything comes.
        while vehicle.note().is_some() {}
        let pair = Pair::new(&config());
        let mut theirs = Encoder::new(1, 1).with_signing(signed("theirs"));
        for _ in 0..40 {
            let mut bytes = Vec::new();
            theirs.encode(&pair.heartbeat(), pair.now, &mut bytes);
            if is_datagram {
                assert!(!vehicle.recognises(Port::Link, &bytes, pair.now));
            } else {
                assert!(!vehicle.receive(Port::Link, &bytes, false, pair.now).valid);
            }
        }
        let told: Vec<_> = std::iter::from_fn(|| vehicle.note()).map(|n| n.text).collect();
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(told[0].contains("5 messages had a wrong signature"), "{told:?}");
        assert_eq!(vehicle.figures().signature, 40);
    }
}

#[test]
fn a_stranger_is_recognised_by_a_signed_heartbeat_of_the_autopilot_and_by_nothing_less() {
    let bench = Bench { signing: Some(signed("ours")), ..support::bench() };
    let mut vehicle = Vehicle::new(&config(), bench).unwrap();
    let pair = Pair::new(&config());
    let now = pair.now;
    let frame = |encoder: &mut Encoder, message: &MavMessage| {
        let mut bytes = Vec::new();
        encoder.encode(message, now, &mut bytes);
        bytes
    };
    let mut ours = Encoder::new(1, 1).with_signing(signed("ours"));
    let (beat, attitude) = (pair.heartbeat(), pair.attitude(0.5));
    let unsigned = frame(&mut Encoder::new(1, 1), &beat);
    let of_another = frame(&mut ours, &attitude);
    let good = frame(&mut ours, &beat);
    for bad in [&[][..], &[0xFD], &[1], &unsigned, &of_another, &good[..good.len() - 1]] {
        assert!(!vehicle.recognises(Port::Link, bad, now), "{bad:?}");
    }
    assert!(vehicle.recognises(Port::Link, &good, now));
    // The look at it has not used the signature up; the message counts once.
    assert!(vehicle.receive(Port::Link, &good, true, now).valid);
    assert!(
        !vehicle.recognises(Port::Link, &good, now) && !vehicle.receive(Port::Link, &good, true, now).valid
    );
}

#[test]
fn another_peer_is_another_vehicle_and_nobody_is_in_charge_of_it() {
    let mut pair = Pair::flying(&config());
    assert_eq!(pair.vehicle.mode(), Mode::Automatic);
    pair.vehicle.peer_changed(Port::Link);
    assert!(matches!(pair.vehicle.mode(), Mode::Failed(_)));
    assert!(pair.vehicle.telemetry().values(Group::Attitude).is_none() && !pair.vehicle.is_armed());
    // It speaks as another system, with a clock of its own.
    pair.autopilot = Encoder::new(7, 1);
    pair.boot = Duration::ZERO;
    pair.heard.clear();
    pair.armed = true;
    for _ in 0..20 {
        pair.step([10.0, -4.0]);
    }
    assert_eq!(pair.channels(), Some([1500, 1500]), "armed already is not armed again");
    assert!(pair.vehicle.telemetry().values(Group::Attitude).is_some());
}

#[test]
fn no_more_outputs_go_to_a_line_than_it_carries_and_the_newest_count() {
    for (link, output, extra, most) in [
        // 25 bytes of 12 bits, 90 % of 100,000 baud: 300 a second, more than the loop's 200.
        ("udpin://127.0.0.1:1", "sbus", r#", "output_link": "serial:///dev/x:100000:8E2""#, 200),
        // 90 % of 57,600 baud: 172 a second.
        ("udpin://127.0.0.1:1", "sbus", r#", "output_link": "serial:///dev/x:57600:8E2""#, 172),
        ("serial:///dev/x:57600", "rc-override", "", 92),
        ("serial:///dev/x:921600", "rc-override", "", 200),
    ] {
        let text = format!(r#"{{"link": "{link}", "output": "{output}"{extra}}}"#);
        let mut config = config();
        config.options.mavlink = Some(support::mavlink(&text));
        let mut pair = Pair::flying(&config);
        let told = pair.notes().iter().any(|n| n.contains("more than") && n.contains("carries"));
        assert_eq!(told, most < 200, "{text}");
        let before = pair.vehicle.figures().outputs;
        for _ in 0..200 {
            pair.vehicle.output(Port::Output).clear();
            pair.step([5.0, 0.0]);
        }
        let sent = pair.vehicle.figures().outputs - before;
        assert!(sent <= most + 2 && sent + 1 >= most / 2, "{text}: {sent} in a second");
        // What was held back is not sent later: the next is the newest.
        pair.vehicle.output(Port::Output).clear();
        (0..5).for_each(|_| pair.step([-5.0, 0.0]));
        assert_eq!(pair.vehicle.channels().0[0], 1375.0, "{text}");
    }
    let asked = r#"{"link": "serial:///dev/x:57600", "output_rate_hz": 250.0}"#;
    let mut config = config();
    config.options.mavlink = Some(support::mavlink(asked));
    let error = Vehicle::new(&config, support::bench()).err().unwrap().to_string();
    assert!(error.contains("output_rate_hz") && error.contains("at most 92"), "{error}");
}

#[test]
fn an_upload_by_a_ground_station_delays_no_override() {
    let mut config = config();
    let text =
        r#"{"link": "serial:///dev/x:57600", "forward": "udpout://127.0.0.1:2", "message_rate_hz": 0.0}"#;
    config.options.mavlink = Some(support::mavlink(text));
    let mut pair = Pair::flying(&config);
    let mut station = Encoder::new(250, 1);
    let mut upload = Vec::new();
    while upload.len() < 65_536 {
        let message = MavMessage::PARAM_SET(dialect::PARAM_SET_DATA {
            param_type: dialect::MavParamType::MAV_PARAM_TYPE_REAL32,
            ..Default::default()
        });
        station.encode(&message, pair.now, &mut upload);
    }
    // What the line of 57,600 baud still has to send.
    let mut free_at = pair.now;
    let (mut passed, mut outputs, mut latest) = (0, 0, Duration::ZERO);
    let refused = pair.vehicle.figures().refused;
    for k in 0..600 {
        if k == 100 {
            pair.vehicle.receive(Port::Ground, &upload, true, pair.now);
        }
        pair.now += Duration::from_millis(5);
        pair.say(&pair.heartbeat());
        pair.say(&pair.attitude(0.0));
        let before = pair.vehicle.figures().outputs;
        pair.vehicle.command(&[5.0, 0.0], pair.now);
        pair.vehicle.poll(pair.now);
        let mut bytes = std::mem::take(pair.vehicle.output(Port::Link)).len();
        if pair.vehicle.figures().outputs > before {
            outputs += 1;
            latest = latest.max(free_at.saturating_sub(pair.now));
        }
        if bytes > 0 {
            pair.vehicle.handed_on(Port::Link, bytes, true, pair.now);
        }
        while let Some(frame) = pair.vehicle.next_forwarded(pair.now) {
            (passed, bytes) = (passed + 1, bytes + frame.len());
        }
        free_at = free_at.max(pair.now) + Duration::from_secs_f64(bytes as f64 * 10.0 / 57_600.0);
    }
    // The line carries at most 92 overrides a second.
    assert!(latest < Duration::from_millis(11), "an override waited for {latest:?}");
    assert!(outputs >= 190, "{outputs} in 3 s");
    let figures = pair.vehicle.figures();
    assert!(passed > 50 && figures.unforwarded > 1000, "{passed} passed, {} left out", figures.unforwarded);
    assert_eq!(figures.refused, refused + figures.unforwarded);
    let told = pair.notes();
    assert_eq!(
        told.iter().filter(|n| n.contains("more than the line carries besides")).count(),
        1,
        "{told:?}"
    );
}

#[test]
fn a_rate_that_another_station_lowered_is_asked_for_again() {
    let mut pair = Pair::flying(&config());
    let accepted = MavMessage::COMMAND_ACK(dialect::COMMAND_ACK_DATA {
        command: dialect::MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
        result: dialect::MavResult::MAV_RESULT_ACCEPTED,
        ..Default::default()
    });
    // The attitude comes every step, or in every tenth; other messages do not come at all.
    let seconds = |pair: &mut Pair, seconds: u32, every: u32| {
        let mut asked = 0;
        for k in 0..200 * seconds {
            pair.now += Duration::from_millis(5);
            pair.say(&pair.heartbeat());
            if k % every == 0 {
                pair.say(&pair.attitude(0.0));
            }
            pair.vehicle.command(&[5.0, 0.0], pair.now);
            pair.vehicle.poll(pair.now);
            pair.heard.clear();
            pair.listen();
            for message in std::mem::take(&mut pair.heard) {
                if let MavMessage::COMMAND_LONG(c) = message {
                    asked += u32::from(c.param1 == 30.0);
                    pair.say(&accepted);
                }
            }
        }
        asked
    };
    seconds(&mut pair, 5, 1);
    assert_eq!(seconds(&mut pair, 20, 1), 0, "it comes as asked for");
    pair.notes();
    assert_eq!(seconds(&mut pair, 4, 10), 1, "and again when it does not, once");
    let notes = pair.notes();
    assert!(
        notes.iter().any(|n| n.starts_with("message 30 arrives") && n.contains("instead of 200")),
        "{notes:?}"
    );
    assert_eq!(seconds(&mut pair, 20, 1), 0);
}
