use super::*;
use crate::mavlink::{Deframer, Encoder, MavMessage, dialect};
use crate::sensors::{Errors, Motion, SensorModel, SensorOptions};
use proptest::prelude::*;

fn packet(number: u32, pwm: [u16; 16]) -> Vec<u8> {
    let bytes = ServoPacket::bytes(400, number, &pwm);
    assert_eq!(
        bytes[..8],
        [0x1A, 0x48, 0x90, 0x01, number as u8, (number >> 8) as u8, 0, 0],
        "18458, 400, number"
    );
    bytes
}

fn pulses(first: u16) -> [u16; 16] {
    let mut pwm = [1500; 16];
    pwm[0] = first;
    pwm
}

struct Bench {
    autopilot: Ardupilot,
    model: SensorModel,
    now: Duration,
    sent: Vec<String>,
    /// What was sent to its MAVLink link.
    said: Vec<u8>,
}

impl Bench {
    fn new() -> Self {
        let model = SensorModel::new(SensorOptions::default(), 2_500_000, 1);
        let autopilot = Ardupilot::new(ArdupilotOptions::default(), true);
        Self { autopilot, model, now: Duration::ZERO, sent: Vec::new(), said: Vec::new() }
    }

    fn receive(&mut self, bytes: &[u8]) -> Vec<Event> {
        self.now += Duration::from_micros(2500);
        let sent = &mut self.sent;
        let mut send = |_: usize, b: &[u8]| sent.push(String::from_utf8(b.to_vec()).unwrap());
        self.autopilot.receive(0, bytes, self.now, &mut send);
        std::iter::from_fn(|| self.autopilot.next()).collect()
    }

    fn sense(&mut self) {
        let sensors =
            self.model.step(&Motion { angles: [0.1, -0.2, 0.0], ..Motion::default() }, &Errors::default());
        let (sent, said) = (&mut self.sent, &mut self.said);
        let mut send = |port: usize, b: &[u8]| match port {
            TELEMETRY => said.extend_from_slice(b),
            _ => sent.push(String::from_utf8(b.to_vec()).unwrap()),
        };
        self.autopilot.sense(&sensors, &Rc::default(), self.now, &mut send);
    }
}

fn first(events: &[Event]) -> f64 {
    match events {
        [.., Event::Outputs(outputs)] => outputs.values[0],
        other => panic!("{other:?}"),
    }
}

#[test]
fn pulses_become_shares_and_steps_alternate() {
    let mut bench = Bench::new();
    assert!(!bench.autopilot.is_answered());
    bench.sense();
    assert!(bench.sent.is_empty(), "nobody asked");
    assert_eq!(first(&bench.receive(&packet(0, pulses(1250)))), 0.25);
    assert!(bench.autopilot.is_answered());
    bench.sense();
    assert!(!bench.autopilot.is_answered());
    bench.sense();
    assert_eq!(bench.sent.len(), 1, "one answer to one packet");
    assert_eq!(first(&bench.receive(&packet(1, pulses(2100)))), 1.0);
    let mut wide = 29569u16.to_le_bytes().to_vec();
    wide.extend(400u16.to_le_bytes());
    wide.extend(2u32.to_le_bytes());
    wide.extend([1000u16; 32].iter().flat_map(|p| p.to_le_bytes()));
    bench.sense();
    assert_eq!(first(&bench.receive(&wide)), 0.0);
    assert_eq!(bench.autopilot.counts().outputs, 3);
    let servos = Ardupilot::new(ArdupilotOptions::default(), false);
    let outputs = servos.outputs(&ServoPacket::parse(&packet(0, pulses(1250))).unwrap());
    assert_eq!((outputs.values[0], outputs.values[1], outputs.values[20]), (-0.5, 0.0, 0.0));
}

#[test]
fn the_line_is_json_with_every_field_and_starts_at_time_zero() {
    let mut bench = Bench::new();
    bench.model.step(&Motion::default(), &Errors::default());
    bench.receive(&packet(0, pulses(1000)));
    bench.sense();
    let line = &bench.sent[0];
    assert!(
        line.starts_with('\n') && line.ends_with('\n') && !line.contains(": ") && line.lines().count() == 2
    );
    let json: serde_json::Value = serde_json::from_str(line).unwrap();
    assert_eq!(json["timestamp"].as_f64(), Some(0.0));
    let list =
        |v: &serde_json::Value| v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect::<Vec<_>>();
    let q = list(&json["quaternion"]);
    // Roll 0.1 and pitch -0.2: small half angles in order.
    assert!(
        (q[0] - 0.9938).abs() < 1e-3 && (q[1] - 0.0497).abs() < 1e-3 && (q[2] + 0.0998).abs() < 1e-3,
        "{q:?}"
    );
    for (key, length) in [("position", 3), ("velocity", 3)] {
        assert_eq!(list(&json[key]).len(), length);
    }
    assert_eq!(list(&json["imu"]["gyro"]).len(), 3);
    assert!(list(&json["imu"]["accel_body"])[2] < -9.0);
    bench.receive(&packet(1, pulses(1000)));
    bench.sense();
    let json: serde_json::Value = serde_json::from_str(&bench.sent[1]).unwrap();
    assert_eq!(json["timestamp"].as_f64(), Some(0.0025));
}

#[test]
fn a_repeated_number_is_a_lost_answer_and_a_reset_is_a_restart() {
    let mut bench = Bench::new();
    bench.receive(&packet(0, pulses(1100)));
    bench.sense();
    bench.receive(&packet(1, pulses(1100)));
    assert!(bench.receive(&packet(1, pulses(1100))).is_empty(), "not answered yet: nothing to repeat");
    assert_eq!(bench.sent.len(), 1);
    bench.sense();
    assert!(bench.receive(&packet(1, pulses(1100))).is_empty(), "no second step");
    assert_eq!(bench.sent[1], bench.sent[2], "the same line again");
    assert!(bench.receive(&packet(0, pulses(1900))).is_empty(), "an old packet that was delayed");
    let events = bench.receive(&packet(7, pulses(1900)));
    assert!(events.is_empty(), "ahead of every answer");
    bench.now += Duration::from_secs(2);
    let events = bench.receive(&packet(0, pulses(1000)));
    assert!(matches!(events[..], [Event::Restarted, Event::Outputs(_)]), "{events:?}");
    bench.sense();
    assert!(bench.sent[3].contains("\"timestamp\":0.000000000"), "{}", bench.sent[3]);
    let counts = bench.autopilot.counts();
    assert_eq!((counts.repeated, counts.stale, counts.malformed), (2, 1, 1));
}

#[test]
fn pulses_beyond_the_range_are_held_and_told_by_number() {
    let autopilot = Ardupilot::new(ArdupilotOptions::default(), true);
    for (pulse, value, beyond) in [(2000, 1.0, 0), (1000, 0.0, 0), (2001, 1.0, 1), (900, 0.0, 1), (0, 0.0, 0)]
    {
        let outputs = autopilot.outputs(&ServoPacket::parse(&packet(0, pulses(pulse))).unwrap());
        assert_eq!((outputs.values[0], outputs.beyond), (value, beyond), "{pulse}");
    }
}

#[test]
fn only_what_counts_is_a_sign_of_life() {
    let mut bench = Bench::new();
    let mut says = |bytes: &[u8]| {
        let known = bench.autopilot.recognises(0, bytes, bench.now);
        let valid = bench.autopilot.receive(0, bytes, bench.now, &mut |_, _| {});
        (known, valid)
    };
    assert_eq!(says(&[1]), (false, false));
    assert_eq!(says(&packet(5, pulses(1500))), (true, true));
    assert_eq!(says(&packet(5, pulses(1500))), (true, true), "it asks again");
    assert_eq!(says(&packet(4, pulses(1500))), (true, false), "old");
    assert_eq!(says(&packet(9, pulses(1500))), (true, false), "ahead of every answer");
}

#[test]
fn what_is_no_packet_is_refused_in_words() {
    let good = packet(3, pulses(1500));
    for (bytes, words) in [
        (good[..39].to_vec(), "39 bytes"),
        (Vec::new(), "0 bytes"),
        ([&good[..], &[0]].concat(), "41 bytes"),
        ([&[0, 1], &good[2..]].concat(), "magic number is 256"),
        (packet(3, pulses(9000)), "channel 1 has a pulse of 9000 us"),
    ] {
        let error = ServoPacket::parse(&bytes).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}

proptest! {
    /// Datagrams that are repeated, overtaken, lost or truncated: outputs arrive in order, each once, and
    /// everything else is counted.
    #[test]
    fn a_bad_network_never_makes_a_wrong_output(
        fates in prop::collection::vec((0u8..6, 0usize..40, any::<u8>()), 1..200)
    ) {
        let mut bench = Bench::new();
        let (mut number, mut last, mut received) = (0u32, None::<u32>, 0u64);
        for (fate, at, byte) in fates {
            // The pulse of a packet encodes its number.
            let original = |n: u32| packet(n, pulses(1000 + (n % 1000) as u16));
            let mut bytes = original(number);
            let mut whole = true;
            match fate {
                0 => bytes = original(number.saturating_sub(at as u32)),
                1 => { bytes.truncate(at); whole = false; }
                2 => { bytes[at % 2] ^= byte | 1; whole = false; }
                3 => continue,
                _ => {}
            }
            let events = bench.receive(&bytes);
            received += 1;
            for event in events {
                let Event::Outputs(outputs) = event else { panic!("no restart within so short a time") };
                prop_assert!(whole);
                let told = (outputs.values[0] * 1000.0).round() as u32;
                prop_assert!(last.is_none_or(|l| told > l), "{told} after {last:?}");
                prop_assert_eq!(told, number % 1000);
                last = Some(told);
            }
            if bench.autopilot.is_answered() {
                bench.sense();
                number += 1;
            }
        }
        let counts = bench.autopilot.counts();
        prop_assert_eq!(counts.outputs + counts.repeated + counts.dropped(), received);
    }

    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..80)) {
        let mut bench = Bench::new();
        bench.receive(&bytes);
        prop_assert_eq!(bench.autopilot.counts().outputs + bench.autopilot.counts().malformed, 1);
    }
}

/// Messages of ArduPilot on its MAVLink link.
fn says(bench: &mut Bench, message: &MavMessage) {
    let mut bytes = Vec::new();
    Encoder::new(1, 1).encode(message, bench.now, &mut bytes);
    assert!(bench.autopilot.receive(TELEMETRY, &bytes, bench.now, &mut |_, _| panic!("nothing is answered")));
}

/// The arming checks that were requested since the last call, and other messages.
fn requests(bench: &mut Bench) -> (usize, usize) {
    let mut deframer = Deframer::new();
    deframer.push(&std::mem::take(&mut bench.said));
    let (mut checks, mut others) = (0, 0);
    while let Some(event) = deframer.next(bench.now) {
        match event {
            crate::mavlink::Event::Message(_, MavMessage::COMMAND_LONG(c)) => {
                assert_eq!((c.command, c.target_system), (dialect::MavCmd::MAV_CMD_RUN_PREARM_CHECKS, 1));
                checks += 1;
            }
            crate::mavlink::Event::Message(..) => others += 1,
            crate::mavlink::Event::Dropped(drop) => panic!("{drop:?}"),
        }
    }
    (checks, others)
}

fn heartbeat(armed: bool, custom_mode: u32) -> MavMessage {
    let armed =
        if armed { dialect::MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED } else { dialect::MavModeFlag::empty() };
    MavMessage::HEARTBEAT(dialect::HEARTBEAT_DATA {
        custom_mode,
        mavtype: dialect::MavType::MAV_TYPE_QUADROTOR,
        autopilot: dialect::MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
        base_mode: armed,
        ..Default::default()
    })
}

#[test]
fn its_mavlink_says_its_state_and_why_it_does_not_arm() {
    let mut bench = Bench::new();
    let step = |bench: &mut Bench, seconds: u64| {
        for _ in 0..10 * seconds {
            bench.now += Duration::from_millis(100);
            bench.sense();
        }
        requests(bench)
    };
    let notes = |bench: &mut Bench| -> Vec<String> {
        std::iter::from_fn(|| bench.autopilot.note()).map(|note| note.text).collect()
    };
    assert_eq!(step(&mut bench, 3), (0, 3), "a heartbeat a second, so that it speaks at all");
    assert!(bench.autopilot.advice().contains("nothing is received from it at tcpout://127.0.0.1:5762"));
    says(&mut bench, &heartbeat(false, 0));
    assert_eq!(
        notes(&mut bench),
        ["ArduPilot is system 1, component 1, and says that it is not armed, in mode Stabilize"]
    );
    assert_eq!(step(&mut bench, 8).0, 2, "its checks are requested every 4 s");
    assert!(bench.autopilot.advice().contains("arm it from its ground station"));
    let text = |text: &str| {
        MavMessage::STATUSTEXT(dialect::STATUSTEXT_DATA {
            severity: dialect::MavSeverity::MAV_SEVERITY_CRITICAL,
            text: text.into(),
            ..Default::default()
        })
    };
    says(&mut bench, &text("PreArm: RC not calibrated"));
    assert_eq!(bench.autopilot.said(), Some("PreArm: RC not calibrated"));
    // Its simulation interface began anew; the link that says why did not.
    bench.autopilot.disconnected(0);
    assert_eq!(bench.autopilot.said(), Some("PreArm: RC not calibrated"));
    says(&mut bench, &heartbeat(true, 4));
    assert_eq!(bench.autopilot.said(), None);
    assert_eq!(step(&mut bench, 8).0, 0, "armed");
    assert_eq!(
        notes(&mut bench),
        [
            "ArduPilot says: PreArm: RC not calibrated",
            "ArduPilot says that it is in mode Guided",
            "ArduPilot says that it is armed"
        ]
    );
    assert_eq!(bench.autopilot.counts().outputs, 0, "and nothing of it controls");
}
