use super::*;
use crate::mavlink::dialect::{COMMAND_LONG_DATA, HIL_ACTUATOR_CONTROLS_DATA, HIL_SENSOR_DATA};
use crate::sensors::{Errors, Motion, SensorModel, SensorOptions};
use proptest::prelude::*;

const PERIOD_NS: u64 = 4_000_000;

pub(super) struct Bench {
    pub px4: Px4,
    pub model: SensorModel,
    encoder: Encoder,
    deframer: Deframer,
    pub now: Duration,
}

impl Bench {
    pub(super) fn new(options: Px4Options) -> Self {
        Self {
            px4: Px4::new(options, true),
            model: SensorModel::new(SensorOptions::default(), PERIOD_NS, 1),
            encoder: Encoder::new(1, 1),
            deframer: Deframer::new(),
            now: Duration::ZERO,
        }
    }

    pub(super) fn sense(&mut self) -> Vec<MavMessage> {
        self.now += Duration::from_nanos(PERIOD_NS);
        let sensors = self.model.step(&Motion::default(), &Errors::default());
        let deframer = &mut self.deframer;
        self.px4.sense(&sensors, &Rc::default(), self.now, &mut |_, bytes| deframer.push(bytes));
        let events = std::iter::from_fn(|| self.deframer.next(self.now));
        events
            .map(|e| match e {
                crate::mavlink::Event::Message(_, message) => message,
                other => panic!("{other:?}"),
            })
            .collect()
    }

    pub(super) fn bytes(&mut self, message: &MavMessage) -> Vec<u8> {
        let mut out = Vec::new();
        self.encoder.encode(message, self.now, &mut out);
        out
    }

    pub(super) fn receive(&mut self, bytes: &[u8]) -> Option<Outputs> {
        self.px4.receive(0, bytes, self.now, &mut |port, _| assert_eq!(port, STATION, "nothing is asked"));
        match self.px4.next()? {
            Event::Outputs(outputs) => Some(outputs),
            other => panic!("{other:?}"),
        }
    }
}

pub(super) fn controls(time_usec: u64, first: f32, armed: bool, lockstep: bool) -> MavMessage {
    let mut controls = [0.5; 16];
    controls[0] = first;
    controls[15] = f32::NAN;
    let mut mode = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
    mode.set(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED, armed);
    let mut flags = HilActuatorControlsFlags::empty();
    flags.set(HilActuatorControlsFlags::HIL_ACTUATOR_CONTROLS_FLAGS_LOCKSTEP, lockstep);
    MavMessage::HIL_ACTUATOR_CONTROLS(HIL_ACTUATOR_CONTROLS_DATA { time_usec, flags, controls, mode })
}

fn sensor(messages: &[MavMessage]) -> HIL_SENSOR_DATA {
    match messages.last() {
        Some(MavMessage::HIL_SENSOR(sensor)) => sensor.clone(),
        other => panic!("the sensors come last: {other:?}"),
    }
}

#[test]
fn groups_of_sensors_are_whole_and_in_their_units() {
    let mut bench = Bench::new(Px4Options { airspeed: true, rc: true, ..Px4Options::default() });
    let mut times = Vec::new();
    let mut kinds = std::collections::BTreeMap::<&str, u32>::new();
    for _ in 0..250 {
        let messages = bench.sense();
        let s = sensor(&messages);
        let bits = s.fields_updated.bits();
        for group in [0x7, 0x38, 0x1C0, 0x1A00, 0x400] {
            assert!(bits & group == 0 || bits & group == group, "{bits:#x}");
        }
        assert_eq!(bits & !0x1FFF, 0);
        assert_eq!(s.id, 0);
        assert!((s.zacc + 9.81).abs() < 0.2 && (940.0..970.0).contains(&s.abs_pressure), "{s:?}");
        assert!((0.1..0.5).contains(&s.xmag) && (0.3..0.6).contains(&s.zmag), "gauss: {s:?}");
        assert!((s.temperature - 11.8).abs() < 0.1 && (s.pressure_alt - 488.0).abs() < 2.0, "{s:?}");
        times.push(s.time_usec);
        for (name, present) in [("mag", bits & 0x1C0), ("baro", bits & 0x1A00), ("pitot", bits & 0x400)] {
            *kinds.entry(name).or_default() += u32::from(present != 0);
        }
        for message in &messages {
            let name = match message {
                MavMessage::HEARTBEAT(_) => "heartbeat",
                MavMessage::HIL_GPS(gps) => {
                    assert_eq!((gps.lat, gps.lon, gps.alt), (473_977_420, 85_455_940, 488_000));
                    assert_eq!(
                        (gps.fix_type, gps.vel, gps.cog),
                        (3, 0, u16::MAX),
                        "one that stands has no course"
                    );
                    "gps"
                }
                MavMessage::RC_CHANNELS(rc) => {
                    assert_eq!((rc.chan1_raw, rc.chan3_raw, rc.chan5_raw), (1500, 1000, 1000));
                    "rc"
                }
                MavMessage::HIL_STATE_QUATERNION(state) => {
                    assert_eq!(state.attitude_quaternion, [1.0, 0.0, 0.0, 0.0]);
                    "state"
                }
                MavMessage::HIL_SENSOR(_) => "sensor",
                other => panic!("{other:?}"),
            };
            *kinds.entry(name).or_default() += 1;
        }
    }
    assert!(times.windows(2).all(|w| w[1] - w[0] == 4000) && times[0] > 0);
    // One second at 250 Hz.
    let wanted = [
        ("baro", 50),
        ("gps", 10),
        ("heartbeat", 1),
        ("mag", 100),
        ("pitot", 50),
        ("rc", 50),
        ("sensor", 250),
        ("state", 200),
    ];
    assert_eq!(kinds.into_iter().collect::<Vec<_>>(), wanted);
}

#[test]
fn lockstep_waits_for_the_outputs_of_its_time() {
    let mut bench = Bench::new(Px4Options::default());
    let s = sensor(&bench.sense());
    assert!(!bench.px4.is_lockstep(), "nobody has said yet that he waits");
    let bytes = bench.bytes(&controls(s.time_usec, 0.25, true, true));
    let outputs = bench.receive(&bytes).unwrap();
    assert_eq!((outputs.values[0], outputs.values[1], outputs.armed), (0.25, 0.5, Some(true)));
    assert!(outputs.values[15].is_nan() && outputs.values[16] == 0.0);
    assert!(bench.px4.is_lockstep() && bench.px4.is_answered());
    let next = sensor(&bench.sense());
    assert!(!bench.px4.is_answered());
    let late = bench.bytes(&controls(s.time_usec + 1, 0.3, true, true));
    assert!(bench.receive(&late).is_some() && !bench.px4.is_answered(), "still of the step before");
    let early = bench.bytes(&controls(next.time_usec + 1, 0.3, true, true));
    assert!(bench.receive(&early).is_none(), "a time that was never sensed");
    let right = bench.bytes(&controls(next.time_usec, 1.5, false, true));
    let outputs = bench.receive(&right).unwrap();
    assert_eq!((outputs.values[0], outputs.armed), (1.0, Some(false)));
    assert!(bench.px4.is_answered());
    let old = bench.bytes(&controls(s.time_usec, 0.9, true, true));
    assert!(bench.receive(&old).is_none());
    let counts = bench.px4.counts();
    assert_eq!((counts.outputs, counts.malformed, counts.stale, counts.lost), (3, 1, 1, 0));
    bench.px4.disconnected(0);
    assert_eq!(bench.px4.counts(), counts, "what was counted stays counted");
    assert!(bench.px4.is_answered(), "a new conversation");
}

#[test]
fn a_time_that_does_not_go_on_is_stale() {
    let mut bench = Bench::new(Px4Options::default());
    let s = sensor(&bench.sense());
    let played = bench.bytes(&controls(s.time_usec, 0.25, true, false));
    assert!(bench.receive(&played).is_some());
    for n in 1..=10 {
        bench.sense();
        let older = bench.bytes(&controls(s.time_usec - n, 0.9, true, false));
        for again in [&played, &older] {
            assert!(!bench.px4.receive(0, again, bench.now, &mut |_, _| {}), "it is no sign of life");
            assert!(bench.px4.next().is_none() && !bench.px4.is_answered());
        }
    }
    assert_eq!((bench.px4.counts().outputs, bench.px4.counts().stale), (1, 20));
}

#[test]
fn outputs_beyond_their_range_are_held_and_told_by_number() {
    let mut bench = Bench::new(Px4Options::default());
    for (control, value, beyond) in
        [(1.0005, 1.0, 0), (-0.5, 0.0, 0), (1.5, 1.0, 1), (-2.0, 0.0, 1), (3e38, 1.0, 1)]
    {
        let s = sensor(&bench.sense());
        let bytes = bench.bytes(&controls(s.time_usec, control, true, false));
        let outputs = bench.receive(&bytes).unwrap();
        assert_eq!((outputs.values[0], outputs.beyond), (value, beyond), "{control}");
    }
    let s = sensor(&bench.sense());
    let bytes = bench.bytes(&controls(s.time_usec, f32::INFINITY, true, false));
    let outputs = bench.receive(&bytes).unwrap();
    assert!(outputs.values[0].is_nan() && outputs.beyond == 0, "no number has no range");
}

#[test]
fn a_board_that_rebooted_on_its_line_is_recognised_and_a_replay_is_not() {
    let ms = Duration::from_millis;
    for (silent, armed, back_us, wanted) in [
        (ms(600), false, 2_000_000, true),
        (ms(100), false, 2_000_000, false),
        (ms(600), false, 500_000, false),
        // Outputs of a flight that are replayed after a silence.
        (ms(600), true, 2_000_000, false),
    ] {
        let mut bench = Bench::new(Px4Options::default());
        let old = bench.bytes(&controls(60_000_000, 0.5, true, false));
        assert!(bench.receive(&old).is_some());
        bench.now += silent;
        let again = bench.bytes(&controls(60_000_000 - back_us, 0.0, armed, false));
        bench.px4.receive(0, &again, bench.now, &mut |_, _| {});
        assert_eq!(bench.px4.next() == Some(Event::Restarted), wanted, "{silent:?}, {armed}, {back_us}");
        let next = bench.bytes(&controls(60_000_000 - back_us + 4000, 0.25, armed, false));
        assert_eq!(bench.receive(&next).is_some(), wanted);
    }
}

#[test]
fn a_reboot_is_told_also_where_further_outputs_are_read_at_once() {
    let mut bench = Bench::new(Px4Options::default());
    let old = bench.bytes(&controls(60_000_000, 0.5, true, false));
    assert!(bench.receive(&old).is_some());
    bench.now += Duration::from_secs(1);
    let late: Vec<u8> =
        [0, 4000, 8000].iter().flat_map(|us| bench.bytes(&controls(*us, 0.25, false, false))).collect();
    bench.px4.receive(0, &late, bench.now, &mut |_, _| {});
    assert_eq!(bench.px4.next(), Some(Event::Restarted));
    assert!(matches!(bench.px4.next(), Some(Event::Outputs(outputs)) if outputs.values[0] == 0.25));
    assert_eq!(bench.px4.next(), None);
}

#[test]
fn px4_says_in_words_why_it_does_not_arm() {
    let mut bench = Bench::new(Px4Options::default());
    let text = "Arming denied: not ready".into();
    let bytes = bench.bytes(&MavMessage::STATUSTEXT(crate::mavlink::dialect::STATUSTEXT_DATA {
        text,
        ..Default::default()
    }));
    assert!(bench.receive(&bytes).is_none());
    assert_eq!(bench.px4.said(), Some("Arming denied: not ready"));
}

#[test]
fn a_datagram_of_somebody_unknown_is_px4s_only_by_itself() {
    let mut bench = Bench::new(Px4Options::default());
    let good = bench.bytes(&controls(1, 0.5, true, false));
    let now = bench.now;
    assert!(bench.px4.recognises(0, &good, now));
    let station = bench.bytes(&simulator::heartbeat());
    for bad in [&good[..good.len() - 1], &good[1..], &[0xFD], &[], &station] {
        assert!(!bench.px4.recognises(0, bad, now), "{bad:?}");
    }
    assert_eq!(bench.px4.counts(), Counts::default(), "whose it is, is counted where it came in");
    // Half a frame in a datagram is not continued.
    bench.px4.receive(0, &good[..20], now, &mut |_, _| {});
    bench.px4.end_of_datagram(0);
    assert!(bench.receive(&good).is_some());
}

#[test]
fn px4_sets_how_often_it_hears_the_truth() {
    let mut bench = Bench::new(Px4Options::default());
    let interval = |us: f32| {
        MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            command: MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
            param1: 115.0,
            param2: us,
            ..Default::default()
        })
    };
    for (us, wanted) in [(20_000.0, 50), (-1.0, 0), (0.0, 200)] {
        let bytes = bench.bytes(&interval(us));
        assert!(bench.receive(&bytes).is_none());
        let count =
            (0..250).flat_map(|_| bench.sense()).filter(|m| matches!(m, MavMessage::HIL_STATE_QUATERNION(_)));
        let count = count.count();
        assert!((wanted..=wanted + 1).contains(&count), "{us}: {count}");
    }
}

proptest! {
    /// A stream that is damaged, truncated, repeated and reordered: every received output is one that was
    /// sent, and times never go back.
    #[test]
    fn a_damaged_stream_never_makes_a_wrong_output(
        fates in prop::collection::vec((0u8..8, any::<prop::sample::Index>(), 1u8..), 1..120)
    ) {
        let mut bench = Bench::new(Px4Options::default());
        let mut held: Option<Vec<u8>> = None;
        let mut last = -1.0;
        for (k, (fate, at, flip)) in fates.into_iter().enumerate() {
            let s = sensor(&bench.sense());
            // The control encodes the step.
            let share = k as f32 / 1000.0;
            let mut bytes = bench.bytes(&controls(s.time_usec, share, true, true));
            match fate {
                0 => { let i = at.index(bytes.len()); bytes[i] ^= flip; }
                1 => bytes.truncate(at.index(bytes.len())),
                2 => bytes = [bytes.clone(), bytes].concat(),
                3 => { held = Some(bytes); continue; }
                4 => if let Some(h) = held.take() { bytes = [bytes, h].concat(); },
                5 => continue,
                _ => {}
            }
            for chunk in bytes.chunks(1 + at.index(40)) {
                bench.px4.receive(0, chunk, bench.now, &mut |_, _| {});
                while let Some(Event::Outputs(outputs)) = bench.px4.next() {
                    let told = outputs.values[0];
                    prop_assert!((told * 1000.0 - (told * 1000.0).round()).abs() < 1e-3 && told >= last && told <= f64::from(share));
                    last = told;
                }
            }
        }
    }

    #[test]
    fn any_bytes_are_taken_without_harm(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        let mut bench = Bench::new(Px4Options::default());
        bench.sense();
        bench.px4.receive(0, &bytes, bench.now, &mut |_, _| {});
        prop_assert!(bench.px4.next().is_none());
    }
}

/// HIL_GPS of a vehicle with this velocity, m/s, NED: ground speed, cm/s, and course, hundredths of a degree.
fn speed_and_course(velocity: [f64; 3]) -> (u16, u16) {
    let mut model = SensorModel::new(SensorOptions::default(), PERIOD_NS, 1);
    let mut sensors = model.step(&Motion::default(), &Errors::default());
    sensors.gps.velocity = velocity.into();
    match messages::gps(&sensors) {
        MavMessage::HIL_GPS(gps) => {
            assert_eq!(f64::from(gps.vd), 100.0 * velocity[2]);
            (gps.vel, gps.cog)
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_climb_alone_has_neither_ground_speed_nor_course() {
    assert_eq!(speed_and_course([0.0, 0.0, -3.0]), (0, u16::MAX));
    assert_eq!(speed_and_course([0.0, 0.0, 0.0]), (0, u16::MAX));
}

#[test]
fn ground_speed_and_course_are_those_of_the_motion_over_ground() {
    assert_eq!(speed_and_course([3.0, 3.0, -3.0]), (424, 4500), "north-east");
    for (north, east, course) in [(2.0, 0.0, 0), (0.0, 2.0, 9000), (-2.0, 0.0, 18_000), (0.0, -2.0, 27_000)] {
        assert_eq!(speed_and_course([north, east, 0.0]), (200, course));
    }
}
