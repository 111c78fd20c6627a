//! Whose will the channels follow: the controller's only while the vehicle obeys, the pilot's on his own channels always, and
//! the log is told.

use std::time::Duration;

use whirlstand_bridge::arming::{Mode, Reason};
use whirlstand_bridge::config::PilotConfig;
use whirlstand_bridge::mavlink::{MavMessage, dialect};
use whirlstand_msgs::{armed, charge};

use crate::support::{self, Pair, config, releasing};

const NEUTRAL: [u16; 2] = [1500, 1500];
/// 10 and -4 of 20, 500 us for all of it.
const COMMANDED: [u16; 2] = [1750, 1400];

#[test]
fn a_vehicle_that_turns_against_its_commands_ends_it_and_is_told() {
    for (turns_as_commanded, wanted) in [(1.0, Mode::Automatic), (-1.0, Mode::Failed(Reason::WrongSign))] {
        let mut pair = Pair::with(&config(), support::turning(-0.02));
        pair.armed = true;
        let (mut roll, mut rate) = (0.02f32, 0.0f32);
        let mut ended = None;
        for k in 0..600 {
            pair.now += Duration::from_millis(5);
            pair.say(&pair.heartbeat());
            let time_boot_ms = (pair.now + pair.boot).as_millis() as u32;
            pair.say(&MavMessage::ATTITUDE(dialect::ATTITUDE_DATA {
                time_boot_ms,
                roll,
                rollspeed: rate,
                ..Default::default()
            }));
            // Back to level, by a vehicle file in which a positive input rolls to the left.
            let u = f64::from(4.0 * roll + 3.0 * rate) / 0.02;
            pair.vehicle.command(&[u.clamp(-20.0, 20.0), 0.0], pair.now);
            pair.listen();
            // It rolls right on stick right, or left when somebody has turned its channel.
            let stick = pair.channels().map_or(0.0, |[us, _]| (f32::from(us) - 1500.0) / 500.0);
            rate += turns_as_commanded * 0.4 * stick * 0.005;
            roll += rate * 0.005;
            if ended.is_none() && pair.vehicle.mode() == Mode::Failed(Reason::WrongSign) {
                ended = Some((k, roll));
                assert_eq!(pair.channels(), Some(NEUTRAL));
            }
        }
        assert_eq!(pair.vehicle.mode(), wanted, "{ended:?}");
        if let Some((k, roll)) = ended {
            assert!(k < 500 && roll < 0.26, "after {k} steps at {roll} rad");
            let notes = pair.notes();
            assert!(notes.iter().any(|n| n.contains("FAILSAFE") && n.contains("wrong sign")), "{notes:?}");
            assert!(
                notes.iter().any(|n| n.starts_with("roll: the vehicle accelerates opposite")),
                "{notes:?}"
            );
        }
    }
}

#[test]
fn the_signs_are_judged_by_the_outputs_that_left() {
    let mut pair = Pair::with(&config(), support::turning(-0.02));
    pair.armed = true;
    let (mut roll, mut rate) = (0.02f32, 0.0f32);
    for k in 0..1200 {
        pair.now += Duration::from_millis(5);
        pair.say(&pair.heartbeat());
        let time_boot_ms = (pair.now + pair.boot).as_millis() as u32;
        let rollspeed = rate;
        let attitude = dialect::ATTITUDE_DATA { time_boot_ms, roll, rollspeed, ..Default::default() };
        pair.say(&MavMessage::ATTITUDE(attitude));
        // A line that takes one output of ten; the others, which never act, command the opposite.
        pair.takes = k % 10 == 0;
        let target = if k / 150 % 2 == 0 { 0.1 } else { -0.1 };
        let u = f64::from(4.0 * (roll - target) + 3.0 * rate) / if pair.takes { 0.02 } else { -0.02 };
        pair.vehicle.command(&[u.clamp(-20.0, 20.0), 0.0], pair.now);
        pair.listen();
        // The vehicle obeys the last output that arrived.
        let stick = pair.channels().map_or(0.0, |[us, _]| (f32::from(us) - 1500.0) / 500.0);
        rate += 0.4 * stick * 0.005;
        roll += rate * 0.005;
        let mode = pair.vehicle.mode();
        assert_eq!(mode, Mode::Automatic, "after {k} steps at {roll} rad: {:?}", pair.notes());
    }
}

#[test]
fn the_log_is_told_what_was_sent_and_whose_will_it_was() {
    let mut pair = Pair::new(&releasing(config()));
    for _ in 0..10 {
        pair.step([10.0, -4.0]);
    }
    let sent = pair.vehicle.sent(pair.now);
    assert_eq!((sent.in_charge, sent.armed, sent.count), (charge::NOBODY, armed::NO, 2));
    assert_eq!((sent.channels[0], sent.u[..2].to_vec()), (1500.0, vec![0.0, 0.0]), "and not the command");
    assert!(sent.channels[2].is_nan() && sent.stick[0].is_nan() && sent.link_quality.is_nan());
    pair.armed = true;
    pair.step([10.0, -4.0]);
    let sent = pair.vehicle.sent(pair.now);
    assert_eq!((sent.in_charge, sent.armed, sent.reason), (charge::CONTROLLER, armed::YES, 0));
    assert_eq!((sent.channels[..2].to_vec(), sent.u[..2].to_vec()), (vec![1750.0, 1400.0], vec![10.0, -4.0]));
    // Beyond the limits of the channel: what went out, not what was asked for.
    pair.step([90.0, 0.0]);
    assert_eq!(pair.vehicle.sent(pair.now).u[0], support::FULL);
    pair.silence(300, [10.0, -4.0]);
    let sent = pair.vehicle.sent(pair.now);
    assert_eq!(sent.in_charge, charge::FAILSAFE);
    assert!(sent.reason > 0 && sent.channels[0].is_nan() && sent.u[0] == 0.0, "handed over: {sent:?}");
}

#[test]
fn a_pilot_on_the_vehicles_own_radio_keeps_his_throttle_and_before_he_arms_everything() {
    let mut config = config();
    let pilot: PilotConfig = serde_json::from_str(r#"{"source": "mavlink"}"#).unwrap();
    config.options.pilot = Some(pilot);
    let mut pair = Pair::new(&config);
    // An autopilot that tells overridden channels as the pilot's, as ArduPilot and PX4 do.
    let mut throttle = 1200u16;
    let mut seen = Vec::new();
    for k in 0..200 {
        pair.armed = k >= 100;
        throttle += u16::from(k > 150);
        let overridden = |m: &MavMessage| match m {
            MavMessage::RC_CHANNELS_OVERRIDE(o) => {
                Some([o.chan1_raw, o.chan2_raw, o.chan3_raw, o.chan4_raw, o.chan9_raw])
            }
            _ => None,
        };
        let last = pair.heard.iter().rev().find_map(overridden).unwrap_or([0; 5]);
        let told = |own: u16, over: u16| if (800..=2200).contains(&over) { over } else { own };
        let message = MavMessage::RC_CHANNELS(dialect::RC_CHANNELS_DATA {
            time_boot_ms: (pair.now + pair.boot).as_millis() as u32,
            chan1_raw: told(1500, last[0]),
            chan2_raw: told(1500, last[1]),
            chan3_raw: told(throttle, last[2]),
            chan4_raw: told(1500, last[3]),
            chan5_raw: 1000,
            chan6_raw: 2000,
            chancount: 6,
            ..Default::default()
        });
        // Roll and pitch that the bridge itself moves are no stick that would keep it from arming.
        pair.say(&message);
        pair.step([10.0, -4.0]);
        seen.extend(pair.heard.iter().filter_map(overridden).map(|o| (pair.armed, o)));
        pair.heard.retain(|m| matches!(m, MavMessage::RC_CHANNELS_OVERRIDE(_)));
        let keep = pair.heard.len().saturating_sub(1);
        pair.heard.drain(..keep);
    }
    assert_eq!(pair.vehicle.mode(), Mode::Automatic);
    assert!(
        seen.iter().all(|(_, o)| o[2] == u16::MAX && o[3] == u16::MAX && o[4] >= u16::MAX - 1),
        "{seen:?}"
    );
    assert!(seen.iter().filter(|(armed, _)| !armed).all(|(_, o)| o[..2] == [0, 0]), "{seen:?}");
    assert!(seen.iter().any(|(armed, o)| *armed && o[..2] == COMMANDED), "{seen:?}");
}

#[test]
fn a_vehicle_that_does_not_arm_says_why_within_five_seconds() {
    let mut pair = Pair::new(&config());
    let text = |text: &str| {
        MavMessage::STATUSTEXT(dialect::STATUSTEXT_DATA {
            severity: dialect::MavSeverity::MAV_SEVERITY_CRITICAL,
            text: text.into(),
            ..Default::default()
        })
    };
    pair.step([0.0; 2]);
    for _ in 0..3 {
        pair.say(&text("PreArm: Compass not calibrated"));
    }
    let notes = pair.notes();
    let words = "the vehicle says: PreArm: Compass not calibrated";
    assert_eq!(notes.iter().filter(|n| *n == words).count(), 1, "{notes:?}");
    let mut told = None;
    for k in 0..1000 {
        pair.step([0.0; 2]);
        let waits = pair.notes().iter().any(|n| n.contains("the vehicle says that it is disarmed"));
        told = told.or(waits.then_some(k));
    }
    assert!(told.is_some_and(|k| k < 1000), "{told:?}");
}
