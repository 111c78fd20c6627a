//! The log has what left the bridge: every channel of a frame, no channel that was left to the radio, and
//! nothing where a line took nothing.

use std::time::Duration;

use whirlstand_bridge::arming::{ArmBy, Mode, Reason};
use whirlstand_bridge::config::{BridgeConfig, BridgeKind, PilotConfig};
use whirlstand_bridge::crsf::{self, Attitude, Event, Parser};
use whirlstand_bridge::mavlink::{Encoder, MavMessage, dialect};
use whirlstand_bridge::vehicle::{Port, Vehicle};
use whirlstand_msgs::charge;

use crate::support::{self, Pair, config};

/// A bridge whose channels leave through a line of their own.
fn sbus() -> BridgeConfig {
    let text =
        r#"{"link": "udpin://127.0.0.1:1", "output": "sbus", "output_link": "serial:///dev/x:100000:8E2"}"#;
    let mut config = config();
    config.options.mavlink = Some(support::mavlink(text));
    config
}

#[test]
fn every_channel_of_a_frame_is_logged_with_the_switches_that_nobody_named() {
    let mut config = config();
    config.kind = BridgeKind::Crsf;
    config.options.safety.arm = ArmBy::Start;
    config.options.crsf = serde_json::from_str(r#"{"link": "serial:///dev/x:420000"}"#).unwrap();
    let mut vehicle = Vehicle::new(&config, support::bench()).unwrap();
    let mut now = Duration::from_secs(1);
    let mut last = None;
    for _ in 0..20 {
        now += Duration::from_millis(10);
        let mut bytes = Vec::new();
        crsf::write_attitude(&Attitude { roll: 0.0, pitch: 0.0, yaw: 0.0 }, &mut bytes);
        vehicle.receive(Port::Link, &bytes, false, now);
        vehicle.command(&[10.0, -4.0], now);
        let mut parser = Parser::new();
        parser.push(&std::mem::take(vehicle.output(Port::Link)));
        while let Some(event) = parser.next_event() {
            if let Event::Channels(channels) = event {
                last = Some(channels.0.map(crsf::us_of_ticks));
            }
        }
    }
    let (sent, last) = (vehicle.sent(now), last.unwrap());
    assert_eq!((sent.in_charge, last[4]), (charge::CONTROLLER, 2000.0), "armed by its switch");
    for (channel, (logged, went_out)) in sent.channels.iter().zip(last).enumerate() {
        assert!(
            (logged - went_out).abs() < 0.5,
            "channel {}: {logged}, and {went_out} went out",
            channel + 1
        );
    }
}

#[test]
fn channels_left_to_the_vehicles_own_radio_are_not_logged_as_sent() {
    let mut config = config();
    let pilot: PilotConfig = serde_json::from_str(r#"{"source": "mavlink"}"#).unwrap();
    config.options.pilot = Some(pilot);
    let mut pair = Pair::new(&config);
    for k in 0..40 {
        pair.armed = k >= 20;
        pair.say(&MavMessage::RC_CHANNELS(dialect::RC_CHANNELS_DATA {
            chan1_raw: 1500,
            chan2_raw: 1500,
            chan3_raw: 1300,
            chan4_raw: 1500,
            chan5_raw: 1000,
            chan6_raw: 2000,
            chancount: 6,
            ..Default::default()
        }));
        pair.step([10.0, -4.0]);
    }
    assert_eq!(pair.vehicle.mode(), Mode::Automatic);
    let sent = pair.vehicle.sent(pair.now);
    assert_eq!(sent.channels[..2], [1750.0, 1400.0]);
    assert!(sent.channels[2..].iter().all(|us| us.is_nan()), "65535 went out: {:?}", sent.channels);
}

#[test]
fn an_output_that_its_line_did_not_take_is_not_logged_and_not_counted() {
    let mut pair = Pair::flying(&config());
    let before = pair.vehicle.sent(pair.now);
    assert_eq!((before.u[..2].to_vec(), before.channels[0]), (vec![10.0, -4.0], 1750.0));
    pair.takes = false;
    pair.step([5.0, 0.0]);
    let lost = pair.vehicle.sent(pair.now);
    assert!(lost.channels.iter().chain(&lost.u[..2]).all(|v| v.is_nan()), "{lost:?}");
    assert_eq!((lost.in_charge, lost.messages), (charge::CONTROLLER, before.messages));
    // What else is lost on that port is no output.
    pair.vehicle.handed_on(Port::Link, 60, false, pair.now);
    pair.takes = true;
    pair.step([5.0, 0.0]);
    let sent = pair.vehicle.sent(pair.now);
    assert_eq!((sent.u[0], sent.messages), (5.0, before.messages + 1));
}

#[test]
fn a_line_that_takes_nothing_is_no_line_to_be_in_charge_of() {
    let mut pair = Pair::flying(&config());
    let begun = pair.now;
    pair.takes = false;
    while pair.vehicle.mode() == Mode::Automatic {
        assert!(pair.now < begun + Duration::from_secs(1));
        pair.step([5.0, 0.0]);
    }
    let after = pair.now - begun;
    assert_eq!(pair.vehicle.mode(), Mode::Failed(Reason::OutputDown));
    assert!((250..=300).contains(&after.as_millis()), "command_timeout_s is 0.25: {after:?}");
    assert!(pair.notes().iter().any(|n| n.contains("FAILSAFE") && n.contains("closed or full")));
}

#[test]
fn nobody_is_in_charge_of_an_unplugged_line_of_the_channels() {
    let mut pair = Pair::flying(&sbus());
    assert_eq!(pair.vehicle.mode(), Mode::Automatic);
    pair.vehicle.closed(Port::Output);
    pair.step([5.0, 0.0]);
    assert_eq!(pair.vehicle.mode(), Mode::Failed(Reason::OutputDown), "at once");
    let notes = pair.notes();
    assert!(notes.iter().any(|n| n.contains("outputs at neutral") && n.contains("their line is closed")));
    // Plugged in again it stays neutral, until somebody arms again.
    pair.vehicle.connected(Port::Output);
    pair.step([5.0, 0.0]);
    assert_eq!(pair.vehicle.channels().0[0], 1500.0);
    for armed in [false, true] {
        pair.armed = armed;
        pair.step([5.0, 0.0]);
    }
    assert_eq!(pair.vehicle.mode(), Mode::Automatic);
}

#[test]
fn the_log_is_told_the_mode_and_how_well_the_radios_hear() {
    let mut pair = Pair::new(&config());
    let before = pair.vehicle.reported(pair.now);
    assert!(before.known == 0 && before.rssi.is_nan() && before.pilot_rssi.is_nan());
    pair.step([0.0; 2]);
    assert_eq!((pair.vehicle.reported(pair.now).known, pair.vehicle.reported(pair.now).custom_mode), (1, 0));
    let MavMessage::HEARTBEAT(mut beat) = pair.heartbeat() else { panic!() };
    beat.custom_mode = 0x0304_0000;
    pair.say(&MavMessage::HEARTBEAT(beat));
    pair.say(&MavMessage::RC_CHANNELS(dialect::RC_CHANNELS_DATA { rssi: 127, ..Default::default() }));
    // The modem at this end speaks as a system of its own.
    let radio = dialect::RADIO_STATUS_DATA { rssi: 254, remrssi: 255, ..Default::default() };
    let mut bytes = Vec::new();
    Encoder::new(51, 68).encode(&MavMessage::RADIO_STATUS(radio), pair.now, &mut bytes);
    pair.vehicle.receive(Port::Link, &bytes, false, pair.now);
    let told = pair.vehicle.reported(pair.now);
    assert_eq!((told.custom_mode, told.system_status), (0x0304_0000, 4));
    assert_eq!((told.rssi, told.pilot_rssi), (1.0, 0.5));
    assert!(told.remote_rssi.is_nan(), "255 means that it is unknown");
    pair.now += Duration::from_secs(4);
    let told = pair.vehicle.reported(pair.now);
    assert!(told.known == 1 && told.rssi.is_nan() && told.pilot_rssi.is_nan(), "too old: {told:?}");
}
