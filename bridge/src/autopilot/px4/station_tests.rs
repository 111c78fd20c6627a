//! PX4 and its ground station on a shared line.

use super::tests::{Bench, controls};
use super::*;
use crate::mavlink::dialect::MavAutopilot;
use crate::mavlink::dialect::{
    COMMAND_INT_DATA, COMMAND_LONG_DATA, HIL_SENSOR_DATA, MavParamType, PARAM_SET_DATA,
};
use crate::sensors::{Errors, Motion};

/// Sends a station's message through its port; true when it reaches PX4.
fn passed(bench: &mut Bench, system: u8, message: &MavMessage) -> bool {
    let mut bytes = Vec::new();
    Encoder::new(system, 190).encode(message, bench.now, &mut bytes);
    let mut sent = Vec::new();
    assert!(bench.px4.receive(STATION, &bytes, bench.now, &mut |port, bytes| {
        assert_eq!(port, 0);
        sent.extend_from_slice(bytes);
    }));
    assert!(sent.is_empty() || sent == bytes, "as it was said");
    !sent.is_empty()
}

#[test]
fn a_station_reaches_px4_but_never_with_what_the_loop_owns() {
    let interval = |message: f32| {
        MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            target_system: 1,
            command: MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
            param1: message,
            ..Default::default()
        })
    };
    let interval_int = |message: f32| {
        MavMessage::COMMAND_INT(COMMAND_INT_DATA {
            target_system: 1,
            command: MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
            param1: message,
            ..Default::default()
        })
    };
    let arm = MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
        target_system: 1,
        command: MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
        param1: 1.0,
        ..Default::default()
    });
    let stick = MavMessage::MANUAL_CONTROL(Default::default());
    let sensor = MavMessage::HIL_SENSOR(HIL_SENSOR_DATA::default());
    let signing = MavMessage::SETUP_SIGNING(Default::default());
    let mut bench = Bench::new(Px4Options::default());
    for (message, may) in [
        (&simulator::heartbeat(), true),
        (&arm, true),
        (&stick, true),
        (&interval(30.0), true),
        (&interval(93.0), false),
        (&interval_int(30.0), true),
        (&interval_int(93.0), false),
        (&sensor, false),
        (&controls(1, 0.5, true, false), false),
        (&signing, false),
    ] {
        assert_eq!(passed(&mut bench, 255, message), may, "{message:?}");
    }
    assert!(!passed(&mut bench, SYSTEM, &sensor), "nobody else speaks as the simulator");
    assert_eq!(bench.px4.counts().refused, 6);
    assert!(bench.px4.note().is_some_and(|note| note.warn && note.text.contains("is not passed on")));
    assert!(bench.px4.note().is_none(), "told once");
    // Where the bench has the pilot's channels, no other source is permitted.
    let mut bench = Bench::new(Px4Options { rc: true, ..Px4Options::default() });
    assert!(!passed(&mut bench, 255, &stick) && passed(&mut bench, 255, &arm));
}

#[test]
fn what_px4_says_goes_to_the_station_but_for_what_it_says_to_the_simulator() {
    let mut bench = Bench::new(Px4Options::default());
    let own = COMMAND_LONG_DATA { target_system: SYSTEM, ..Default::default() };
    let attitude = MavMessage::ATTITUDE(Default::default());
    let stream: Vec<_> =
        [&controls(1, 0.5, false, false), &attitude, &MavMessage::COMMAND_LONG(own), &attitude]
            .iter()
            .map(|message| bench.bytes(message))
            .collect();
    // A complete message of another dialect, between others.
    let foreign = [&[0xFD, 1, 0, 0, 9, 1, 1, 0xFF, 0xFF, 0x0F, 7][..], &[0, 0]].concat();
    let (mut forwarded, now) = (Vec::new(), bench.now);
    let wire = [&stream[0], &stream[1], &foreign, &stream[2], &stream[3]].map(|b| &b[..]).concat();
    for piece in wire.chunks(7) {
        bench.px4.receive(0, piece, now, &mut |port, bytes| {
            assert_eq!(port, STATION);
            forwarded.extend_from_slice(bytes);
        });
    }
    assert_eq!(forwarded, [&stream[1], &foreign, &stream[3]].map(|b| &b[..]).concat());
    assert_eq!(bench.px4.counts().malformed, 0, "another dialect is no damage");
}

#[test]
fn heartbeats_words_and_arming_checks_are_told_once() {
    use crate::mavlink::dialect::{EVENT_DATA, HEARTBEAT_DATA, STATUSTEXT_DATA};

    let mut bench = Bench::new(Px4Options::default());
    let beat = |armed| {
        let base_mode = if armed { MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED } else { MavModeFlag::empty() };
        let autopilot = MavAutopilot::MAV_AUTOPILOT_PX4;
        MavMessage::HEARTBEAT(HEARTBEAT_DATA { autopilot, base_mode, ..Default::default() })
    };
    let words =
        MavMessage::STATUSTEXT(STATUSTEXT_DATA { text: "Preflight Fail".into(), ..Default::default() });
    let event = |failing: u32, modes: u32| {
        let mut arguments = [0; 40];
        arguments[1..5].copy_from_slice(&failing.to_le_bytes());
        arguments[9..13].copy_from_slice(&modes.to_le_bytes());
        // The number of libevents' own tests.
        MavMessage::EVENT(EVENT_DATA { id: 1 << 24 | 11_047_904, arguments, ..Default::default() })
    };
    let mut told = Vec::new();
    for message in [beat(false), beat(false), words.clone(), words, event(8, 0), event(8, 0)] {
        let bytes = bench.bytes(&message);
        assert!(bench.receive(&bytes).is_none());
        told.extend(std::iter::from_fn(|| bench.px4.note()).map(|note| note.text));
    }
    let asked = bench.sense();
    assert!(
        asked.iter().any(|m| matches!(m, MavMessage::COMMAND_LONG(c)
            if c.command == MavCmd::MAV_CMD_RUN_PREARM_CHECKS && c.target_system == 1)),
        "it tells its checks by itself only when they change: {asked:?}"
    );
    assert_eq!(bench.px4.said(), Some("its arming checks fail, in every mode: GPS; Preflight Fail"));
    for message in [event(0, 1), beat(true)] {
        let bytes = bench.bytes(&message);
        assert!(bench.receive(&bytes).is_none());
        told.extend(std::iter::from_fn(|| bench.px4.note()).map(|note| note.text));
    }
    assert_eq!(
        told,
        [
            "PX4 is system 1, component 1, and says that it is not armed",
            "PX4 says: Preflight Fail",
            "PX4 cannot be armed: its arming checks fail, in every mode: GPS",
            "PX4 can be armed: its arming checks pass",
            "PX4 says that it is armed",
        ]
    );
}

#[test]
fn a_line_carries_its_sensors_or_is_refused_with_the_rate_that_it_carries() {
    let on =
        |baud: u32| Px4Options { link: format!("serial:///dev/ttyACM0:{baud}"), ..Px4Options::default() };
    assert_eq!(Px4Options::default().state_period_ns(1000.0, 10.0), Ok(STATE_PERIOD_NS), "not a serial line");
    assert_eq!(on(921_600).state_period_ns(250.0, 10.0), Ok(STATE_PERIOD_NS));
    let error = on(57_600).state_period_ns(250.0, 10.0).unwrap_err();
    assert!(error.contains("rate_hz at most 52"), "{error}");
    assert!(
        on(57_600).state_period_ns(52.0, 10.0).unwrap() > 100 * STATE_PERIOD_NS,
        "the truth is thinned first"
    );
}

#[test]
fn an_upload_of_parameters_waits_for_the_pauses_between_the_sensors() {
    let options = Px4Options { link: "serial:///dev/ttyACM0:57600".into(), ..Px4Options::default() };
    let period = Duration::from_millis(20);
    let mut bench = Bench::new(options);
    bench.px4 = Px4::with_state_period(bench.px4.options.clone(), true, u64::MAX).with_period(period);
    let mut encoder = Encoder::new(255, 190);
    let mut upload = Vec::new();
    while upload.len() < 65_536 {
        let message = MavMessage::PARAM_SET(PARAM_SET_DATA {
            param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
            ..Default::default()
        });
        encoder.encode(&message, bench.now, &mut upload);
    }
    let (mut free_at, mut passed) = (Duration::ZERO, 0);
    for k in 0..250u32 {
        let mut written: Vec<usize> = Vec::new();
        if k == 5 {
            bench.px4.receive(STATION, &upload, bench.now, &mut |port, bytes| {
                assert_eq!(port, 0);
                written.push(bytes.len());
            });
        }
        let sensors = bench.model.step(&Motion::default(), &Errors::default());
        bench.now += period;
        let now = bench.now;
        bench.px4.sense(&sensors, &Rc::default(), now, &mut |_, bytes| written.push(bytes.len()));
        assert!(free_at <= now + period / 2, "{k}: the sensors wait for {:?}", free_at - now);
        passed += written.len() - 1;
        let bytes: usize = written.iter().sum();
        free_at = free_at.max(now) + Duration::from_secs_f64(bytes as f64 * 10.0 / 57_600.0);
    }
    let left_out = bench.px4.counts().unforwarded;
    assert!(passed > 50 && left_out > 1000, "{passed} passed, {left_out} left out");
    assert!(bench.px4.note().is_some_and(|note| note.text.contains("more than the line carries")));
}
