//! What a vehicle is sent when: neutral until armed, and neutral or handed over soon after anything breaks.

use std::time::Duration;

use whirlstand_bridge::arming::{ArmBy, Mode, Reason};
use whirlstand_bridge::config::{BridgeKind, PilotConfig};
use whirlstand_bridge::crsf;
use whirlstand_bridge::mavlink::{MavMessage, dialect};
use whirlstand_bridge::sbus;
use whirlstand_bridge::vehicle::{Port, Vehicle};

use crate::support::{self, Pair, config, mavlink, releasing};

const NEUTRAL: [u16; 2] = [1500, 1500];
/// 10 and -4 of 20, 500 us for all of it.
const COMMANDED: [u16; 2] = [1750, 1400];

#[test]
fn outputs_are_neutral_until_the_autopilot_is_armed() {
    let mut pair = Pair::new(&config());
    for _ in 0..100 {
        pair.step([10.0, -4.0]);
        assert!(pair.channels().is_none_or(|c| c == NEUTRAL));
    }
    assert_eq!(pair.channels(), Some(NEUTRAL));
    pair.armed = true;
    pair.step([10.0, -4.0]);
    assert_eq!(pair.channels(), Some(COMMANDED));
    pair.armed = false;
    pair.step([10.0, -4.0]);
    assert_eq!(pair.channels(), Some(NEUTRAL));
    assert!(pair.notes().iter().any(|n| n.contains("disarmed")));
}

#[test]
fn a_silent_vehicle_is_neutral_within_the_stated_time() {
    let mut pair = Pair::flying(&config());
    pair.silence(250, [10.0, -4.0]);
    assert_eq!(pair.channels(), Some(COMMANDED));
    pair.silence(10, [10.0, -4.0]);
    assert_eq!(pair.channels(), Some(NEUTRAL));
    assert_eq!(pair.vehicle.mode(), Mode::Failed(Reason::Stale));
    assert!(pair.notes().iter().any(|n| n.contains("FAILSAFE") && n.contains("stale")));
    for _ in 0..1000 {
        pair.step([10.0, -4.0]);
    }
    assert_eq!(pair.channels(), Some(NEUTRAL), "it does not come back by itself");
    pair.armed = false;
    pair.step([0.0; 2]);
    pair.armed = true;
    pair.step([10.0, -4.0]);
    assert_eq!(pair.channels(), Some(COMMANDED));
}

#[test]
fn a_vehicle_that_is_handed_over_gets_its_channels_back() {
    let mut pair = Pair::flying(&releasing(config()));
    pair.silence(300, [10.0, -4.0]);
    assert_eq!(pair.channels(), Some([0, 0]));
    assert!(pair.notes().iter().any(|n| n.contains("handed over")));
}

#[test]
fn whatever_breaks_ends_it_and_the_note_says_why() {
    type Break = fn(&mut Pair);
    let breaks: [(Break, Reason); 6] = [
        (|p| p.silence(260, [10.0, -4.0]), Reason::Stale),
        (
            |p| {
                p.now += Duration::from_millis(5);
                p.vehicle.command(&[f64::NAN, 0.0], p.now);
            },
            Reason::NotFinite,
        ),
        (
            |p| {
                p.state = dialect::MavState::MAV_STATE_CRITICAL;
                p.step([10.0, -4.0]);
            },
            Reason::VehicleFailsafe,
        ),
        (
            |p| {
                for _ in 0..60 {
                    p.now += Duration::from_millis(5);
                    p.say(&p.heartbeat());
                    p.say(&p.attitude(0.0));
                    p.vehicle.poll(p.now);
                }
            },
            Reason::NoCommand,
        ),
        (
            |p| {
                for _ in 0..60 {
                    p.vehicle.estimate(&[0.0; 4], 1e6, 4, p.now);
                    p.step([10.0, -4.0]);
                }
            },
            Reason::Diverged,
        ),
        (
            |p| {
                p.silence(210, [10.0, -4.0]);
                p.boot = Duration::ZERO;
                p.step([10.0, -4.0]);
            },
            Reason::Restarted,
        ),
    ];
    for (break_it, reason) in breaks {
        let mut pair = Pair::flying(&config());
        assert_eq!(pair.channels(), Some(COMMANDED));
        break_it(&mut pair);
        pair.listen();
        assert_eq!(pair.vehicle.mode(), Mode::Failed(reason));
        assert_eq!(pair.channels(), Some(NEUTRAL), "{reason}");
        let notes = pair.notes();
        assert!(notes.iter().any(|n| n.contains("FAILSAFE") && n.contains(&reason.to_string())), "{notes:?}");
    }
}

#[test]
fn a_lost_heartbeat_ends_it_even_while_attitudes_come() {
    let mut pair = Pair::flying(&config());
    for _ in 0..610 {
        pair.now += Duration::from_millis(5);
        pair.say(&pair.attitude(0.0));
        pair.vehicle.command(&[10.0, -4.0], pair.now);
        pair.listen();
    }
    assert_eq!(pair.vehicle.mode(), Mode::Failed(Reason::LinkDown));
    assert_eq!(pair.channels(), Some(NEUTRAL));
}

#[test]
fn a_link_that_holds_data_back_is_stale_though_data_flows() {
    let mut pair = Pair::flying(&config());
    for _ in 0..200 {
        pair.step([10.0, -4.0]);
    }
    // From now on everything comes 300 ms late, at the full rate.
    for _ in 0..80 {
        pair.now += Duration::from_millis(5);
        pair.say(&pair.heartbeat());
        let late = pair.now.saturating_sub(Duration::from_millis(300)) + pair.boot;
        let time_boot_ms = late.as_millis() as u32;
        pair.say(&MavMessage::ATTITUDE(dialect::ATTITUDE_DATA { time_boot_ms, ..Default::default() }));
        pair.vehicle.command(&[10.0, -4.0], pair.now);
        pair.listen();
    }
    assert_eq!(pair.vehicle.mode(), Mode::Failed(Reason::Stale));
}

#[test]
fn the_end_of_the_run_takes_the_override_back() {
    let mut pair = Pair::flying(&config());
    pair.vehicle.end(pair.now);
    pair.listen();
    let overrides: Vec<_> = pair
        .heard
        .iter()
        .filter_map(|m| match m {
            MavMessage::RC_CHANNELS_OVERRIDE(o) => Some([o.chan1_raw, o.chan2_raw]),
            _ => None,
        })
        .collect();
    assert_eq!(overrides[overrides.len() - 2..], [NEUTRAL, [0, 0]]);
}

#[test]
fn the_autopilot_is_asked_for_messages_and_the_time() {
    let mut pair = Pair::new(&config());
    for _ in 0..400 {
        pair.step([0.0; 2]);
    }
    let asked: Vec<_> = pair
        .heard
        .iter()
        .filter_map(|m| match m {
            MavMessage::COMMAND_LONG(c) => Some((c.param1, c.param2)),
            _ => None,
        })
        .collect();
    assert_eq!(asked[0], (30.0, 5000.0));
    let beats = pair.heard.iter().filter(|m| matches!(m, MavMessage::HEARTBEAT(_))).count();
    assert!((2..=3).contains(&beats), "{beats} heartbeats in 2 s");
    let asks = pair.heard.iter().filter(|m| matches!(m, MavMessage::TIMESYNC(t) if t.tc1 == 0)).count();
    assert!(asks >= 10, "{asks}");
    let ask = pair.heard.iter().find_map(|m| match m {
        MavMessage::TIMESYNC(t) if t.tc1 == 0 => Some(t.clone()),
        _ => None,
    });
    let sent = ask.unwrap().ts1;
    let theirs = sent + 60_000_000_000 + 500_000;
    pair.now = Duration::from_nanos(sent as u64) + Duration::from_millis(1);
    pair.say(&MavMessage::TIMESYNC(dialect::TIMESYNC_DATA { tc1: theirs, ts1: sent, ..Default::default() }));
    let figures = pair.vehicle.figures();
    assert_eq!((figures.clock_offset_ns, figures.round_trip_ns), (Some(60_000_000_000), Some(1_000_000)));
}

#[test]
#[expect(deprecated, reason = "ground stations send REQUEST_DATA_STREAM all the same")]
fn a_ground_station_may_ask_but_not_steer() {
    let mut config = config();
    config.options.mavlink =
        Some(mavlink(r#"{"link": "udpin://127.0.0.1:1", "forward": "udpout://127.0.0.1:2"}"#));
    let mut pair = Pair::flying(&config);
    assert!(!pair.vehicle.output(Port::Ground).is_empty(), "it hears the vehicle");
    let mut station = whirlstand_bridge::mavlink::Encoder::new(250, 1);
    let mut bytes = Vec::new();
    let steer = dialect::MANUAL_CONTROL_DATA { x: 1000, target: 1, ..Default::default() };
    station.encode(&MavMessage::MANUAL_CONTROL(steer), pair.now, &mut bytes);
    station.encode(&MavMessage::PARAM_REQUEST_LIST(Default::default()), pair.now, &mut bytes);
    let refused = pair.vehicle.figures().refused;
    pair.vehicle.receive(Port::Ground, &bytes, true, pair.now);
    pair.heard.clear();
    pair.listen();
    assert!(matches!(pair.heard[..], [MavMessage::PARAM_REQUEST_LIST(_)]), "{:?}", pair.heard);
    assert_eq!(pair.vehicle.figures().refused, refused + 1);
    let command = |command, param1| {
        let data = dialect::COMMAND_LONG_DATA { command, param1, target_system: 1, ..Default::default() };
        MavMessage::COMMAND_LONG(data)
    };
    let command_int = |command, param1| {
        let data = dialect::COMMAND_INT_DATA { command, param1, target_system: 1, ..Default::default() };
        MavMessage::COMMAND_INT(data)
    };
    let stream = |req_stream_id| {
        let data = dialect::REQUEST_DATA_STREAM_DATA {
            req_message_rate: 4,
            target_system: 1,
            req_stream_id,
            start_stop: 1,
            ..Default::default()
        };
        MavMessage::REQUEST_DATA_STREAM(data)
    };
    use dialect::{MavCmd as Cmd, MavDataStream as Stream};
    for (message, passes, counts) in [
        (command(Cmd::MAV_CMD_DO_MOTOR_TEST, 1.0), false, 1),
        (command(Cmd::MAV_CMD_DO_SET_SERVO, 1.0), false, 1),
        (command_int(Cmd::MAV_CMD_DO_MOTOR_TEST, 1.0), false, 1),
        (command_int(Cmd::MAV_CMD_DO_SET_SERVO, 1.0), false, 1),
        (command_int(Cmd::MAV_CMD_SET_MESSAGE_INTERVAL, 30.0), false, 0),
        (command_int(Cmd::MAV_CMD_SET_MESSAGE_INTERVAL, 74.0), true, 0),
        (command_int(Cmd::MAV_CMD_DO_REPOSITION, 1.0), true, 0),
        // Rates of what the loop flies on: attitude, and the group that holds it.
        (command(Cmd::MAV_CMD_SET_MESSAGE_INTERVAL, 30.0), false, 0),
        (stream(Stream::MAV_DATA_STREAM_EXTRA1), false, 0),
        (stream(Stream::MAV_DATA_STREAM_ALL), false, 0),
        // Rates of what only the station reads, and what the pilot may ask for.
        (command(Cmd::MAV_CMD_SET_MESSAGE_INTERVAL, 74.0), true, 0),
        (stream(Stream::MAV_DATA_STREAM_EXTRA2), true, 0),
        (command(Cmd::MAV_CMD_COMPONENT_ARM_DISARM, 1.0), true, 0),
    ] {
        let before = pair.vehicle.figures().refused;
        let mut bytes = Vec::new();
        station.encode(&message, pair.now, &mut bytes);
        pair.vehicle.receive(Port::Ground, &bytes, true, pair.now);
        pair.heard.clear();
        pair.listen();
        assert_eq!(!pair.heard.is_empty(), passes, "{message:?}");
        assert_eq!(pair.vehicle.figures().refused, before + counts, "{message:?}");
    }
    let notes = pair.notes();
    assert_eq!(notes.iter().filter(|n| n.contains("asked for other rates")).count(), 1, "{notes:?}");
}

/// Sticks of an SBUS receiver: roll, arm switch, manual or automatic.
fn sticks(roll_us: f64, arm: bool, automatic: bool, failsafe: bool) -> Vec<u8> {
    let switch = |on| if on { 2000.0 } else { 1000.0 };
    let mut us = [1500.0; 16];
    (us[0], us[2], us[4], us[5]) = (roll_us, 1300.0, switch(arm), switch(automatic));
    let mut bytes = Vec::new();
    let channels = us.map(sbus::ticks_of_us);
    sbus::write(&sbus::Frame { channels, digital: [false; 2], lost: false, failsafe }, &mut bytes);
    bytes
}

#[test]
fn the_pilots_switch_arms_takes_over_and_always_wins() {
    let mut config = config();
    config.kind = BridgeKind::Crsf;
    config.options.safety.arm = ArmBy::Switch;
    config.options.crsf = Some(serde_json::from_str(r#"{"link": "serial:///dev/x:420000"}"#).unwrap());
    let pilot: PilotConfig =
        serde_json::from_str(r#"{"source": "sbus", "link": "serial:///dev/y:100000:8E2"}"#).unwrap();
    config.options.pilot = Some(pilot);
    let mut vehicle = Vehicle::new(&config, support::bench()).unwrap();
    let mut now = Duration::from_secs(1);
    let mut parser = crsf::Parser::new();
    let mut fly = |bytes: &[u8], telemetry: bool| {
        let mut last = [0.0; 16];
        for _ in 0..10 {
            now += Duration::from_millis(10);
            if telemetry {
                let mut frame = Vec::new();
                crsf::write_attitude(&crsf::Attitude { roll: 0.1, pitch: 0.0, yaw: 0.0 }, &mut frame);
                vehicle.receive(Port::Link, &frame, false, now);
            }
            vehicle.receive(Port::Pilot, bytes, false, now);
            vehicle.command(&[10.0, 0.0], now);
            parser.push(&std::mem::take(vehicle.output(Port::Link)));
            while let Some(event) = parser.next_event() {
                let crsf::Event::Channels(c) = event else { panic!("{event:?}") };
                last = c.0.map(|t| crsf::us_of_ticks(t).round());
            }
        }
        ([last[0], last[2]], vehicle.mode())
    };
    assert_eq!(fly(&sticks(1500.0, false, true, false), true), ([1500.0, 1000.0], Mode::Disarmed));
    assert_eq!(
        fly(&sticks(1700.0, true, true, false), true).1,
        Mode::Disarmed,
        "the stick is not in the middle"
    );
    fly(&sticks(1500.0, false, true, false), true);
    assert_eq!(fly(&sticks(1500.0, true, true, false), true), ([1750.0, 1300.0], Mode::Automatic));
    assert_eq!(fly(&sticks(1600.0, true, false, false), true), ([1600.0, 1300.0], Mode::Manual));
    assert_eq!(fly(&sticks(1600.0, true, true, false), true), ([1750.0, 1300.0], Mode::Automatic));
    for _ in 0..3 {
        fly(&sticks(1600.0, true, true, false), false);
    }
    assert_eq!(
        fly(&sticks(1600.0, true, true, false), false),
        ([1500.0, 1300.0], Mode::Failed(Reason::Stale))
    );
    assert_eq!(fly(&sticks(1600.0, true, false, false), false), ([1600.0, 1300.0], Mode::Manual));
    let lost = fly(&sticks(1600.0, true, false, true), false);
    assert_eq!(lost, ([1500.0, 1000.0], Mode::Failed(Reason::PilotLost)));
}

#[test]
fn channels_of_the_vehicles_own_receiver_are_the_pilot() {
    let mut config = config();
    config.options.pilot = Some(serde_json::from_str(r#"{"source": "mavlink"}"#).unwrap());
    let mut pair = Pair::new(&config);
    let rc = |pair: &mut Pair, automatic_us: u16| {
        let m = dialect::RC_CHANNELS_DATA {
            chancount: 6,
            chan1_raw: 1500,
            chan2_raw: 1500,
            chan3_raw: 1200,
            chan4_raw: 1500,
            chan5_raw: 1000,
            chan6_raw: automatic_us,
            ..Default::default()
        };
        pair.say(&MavMessage::RC_CHANNELS(m));
        pair.step([10.0, -4.0]);
    };
    rc(&mut pair, 2000);
    pair.armed = true;
    rc(&mut pair, 2000);
    assert_eq!(pair.channels(), Some(COMMANDED));
    rc(&mut pair, 1000);
    assert_eq!(pair.vehicle.mode(), Mode::Manual);
    assert_eq!(pair.channels(), Some([0, 0]), "the pilot flies by the vehicle's own radio");
}

#[test]
fn impossible_options_are_told_with_their_key() {
    let tell = |change: fn(&mut whirlstand_bridge::config::BridgeConfig)| {
        let mut config = config();
        change(&mut config);
        Vehicle::new(&config, support::bench()).err().map(|e| e.to_string()).unwrap_or_default()
    };
    type Change = fn(&mut whirlstand_bridge::config::BridgeConfig);
    let cases: [(Change, &str, &str); 6] = [
        (|c| c.options.safety.arm = ArmBy::Switch, "bridge.safety.arm", "[bridge.pilot]"),
        (|c| c.options.safety.stale_s = 0.0, "bridge.safety.stale_s", "above 0"),
        (|c| c.options.safety.max_innovation = 0.5, "bridge.safety.max_innovation", "above 1"),
        (|c| c.options.mavlink = None, "bridge.mavlink", "link"),
        (
            |c| c.options.mavlink = Some(mavlink(r#"{"link": "x", "output": "sbus"}"#)),
            "bridge.mavlink.output_link",
            "serial port",
        ),
        (|c| c.options.safety.recover_after_s = Some(1.0), "bridge.safety.recover_after_s", "start"),
    ];
    for (change, key, word) in cases {
        let told = tell(change);
        assert!(told.starts_with(key) && told.contains(word), "{key}: {told}");
    }
}
