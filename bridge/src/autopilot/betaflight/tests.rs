use super::*;
use crate::sensors::{Axis, Errors, Motion, SensorModel, SensorOptions, wrapped};
use nalgebra::{Quaternion, UnitQuaternion};
use proptest::prelude::*;

const PERIOD: Duration = Duration::from_millis(4);

fn raw(pulses: [f32; 16]) -> Vec<u8> {
    let mut bytes = vec![4, 0, 0xAA, 0x55];
    bytes.extend(pulses.iter().flat_map(|p| p.to_le_bytes()));
    bytes
}

fn motors(motors: [f32; 4]) -> Vec<u8> {
    motors.iter().flat_map(|m| m.to_le_bytes()).collect()
}

fn received(betaflight: &mut Betaflight, port: usize, bytes: &[u8]) -> Option<[f64; MAX_OUTPUTS]> {
    betaflight.receive(port, bytes, Duration::ZERO, &mut |_, _| panic!("nothing is asked"));
    match betaflight.next()? {
        Event::Outputs(outputs) => Some(outputs.values),
        other => panic!("{other:?}"),
    }
}

/// Receives outputs, as they arrive while its main loop runs.
fn received_at(betaflight: &mut Betaflight, now: Duration, bytes: &[u8]) {
    assert!(betaflight.receive(RAW, bytes, now, &mut |_, _| panic!("nothing is asked")));
}

/// Fields of the state packet of a vehicle that moved from level rest to this motion.
fn state_of(flavour: Flavour, motion: Motion) -> [f64; 18] {
    let options = SensorOptions {
        gyro_noise: 0.0,
        accel_noise: 0.0,
        baro_noise: 0.0,
        gps_hz: 1000.0,
        ..SensorOptions::default()
    };
    let mut model = SensorModel::new(options, 4_000_000, 1);
    let rest = Motion {
        axes: motion.axes.map(|a| Axis { position: a.position.map(|_| 0.0), ..a }),
        ..Motion::default()
    };
    let mut betaflight = Betaflight::new(BetaflightOptions { flavour, ..Default::default() }, true);
    let mut fields = [0.0; 18];
    for (k, motion) in [rest, motion].into_iter().enumerate() {
        let now = PERIOD * (k as u32 + 1);
        let sensors = model.step(&motion, &Errors::default());
        betaflight.sense(&sensors, &Rc::default(), now, &mut |port, bytes| {
            if port == STATE {
                assert_eq!(bytes.len(), FDM_BYTES);
                for (field, b) in fields.iter_mut().zip(bytes.chunks(8)) {
                    *field = f64::from_le_bytes(b.try_into().unwrap());
                }
            }
        });
    }
    fields
}

/// Gyro and attitude that Betaflight derives from a packet, according to its published source.
fn inside(flavour: Flavour, f: &[f64; 18]) -> ([f64; 3], UnitQuaternion<f64>) {
    let yaw = if flavour == Flavour::Gazebo { f[3] } else { -f[3] };
    let gyro = [f[1], -f[2], yaw];
    let q = match flavour {
        // It changes the signs of those matrix entries that contain pitch and yaw.
        Flavour::Legacy => Quaternion::new(f[7], f[8], -f[9], -f[10]),
        Flavour::Gazebo => {
            let (w, x, y, z) = (f[7], f[8], -f[9], -f[10]);
            let k = std::f64::consts::FRAC_1_SQRT_2;
            Quaternion::new(k * (w - z), k * (x - y), k * (y + x), k * (z + w))
        }
    };
    (gyro, UnitQuaternion::from_quaternion(q))
}

#[test]
fn outputs_are_read_from_either_packet_and_no_other() {
    let mut betaflight = Betaflight::new(BetaflightOptions::default(), true);
    let mut pulses = [0.0; 16];
    pulses[..4].copy_from_slice(&[1000.0, 1250.0, 2000.0, 2100.0]);
    let values = received(&mut betaflight, RAW, &raw(pulses)).unwrap();
    assert_eq!(values[..6], [0.0, 0.25, 1.0, 1.0, 0.0, 0.0]);
    assert_eq!(
        received(&mut betaflight, MOTORS, &motors([0.1, 0.2, 0.3, 0.4])),
        None,
        "raw packets were asked for"
    );

    let options = BetaflightOptions { packets: Packets::Motors, ..Default::default() };
    let mut other = Betaflight::new(options, true);
    let values = received(&mut other, MOTORS, &motors([0.0, 0.25, 0.5, 1.0])).unwrap();
    assert_eq!(values[..5], [0.0, 0.25, 0.5, 1.0, 0.0]);

    let mut servos = Betaflight::new(BetaflightOptions::default(), false);
    assert_eq!(received(&mut servos, RAW, &raw([1250.0; 16])).unwrap()[..2], [-0.5, -0.5]);
    for (port, bad) in [
        (RAW, raw([f32::NAN; 16])),
        (RAW, raw([9000.0; 16])),
        (RAW, raw([1500.0; 16])[..67].to_vec()),
        (RAW, [&[17, 0], &raw([1500.0; 16])[2..]].concat()),
        (MOTORS, motors([0.0, 0.0, 0.0, 1.5])),
        (MOTORS, motors([0.0, f32::INFINITY, 0.0, 0.5])),
        (MOTORS, raw([1500.0; 16])),
    ] {
        let before = other.counts();
        assert_eq!(received(&mut other, port, &bad), None);
        assert_eq!(other.counts().malformed, before.malformed + 1);
    }
    let error = parse_motors(&motors([0.0, 0.0, 0.0, 1.5])).unwrap_err().to_string();
    assert_eq!(error, "output 4 is 1.5: 0 to 1 is expected");
}

#[test]
fn pulses_beyond_the_range_are_held_and_told_by_number_and_nothing_comes_to_other_ports() {
    let mut betaflight = Betaflight::new(BetaflightOptions::default(), true);
    let mut pulses = [0.0; 16];
    pulses[..4].copy_from_slice(&[1000.0, 2000.0, 2100.0, 900.0]);
    let outputs = betaflight.outputs(RAW, &raw(pulses)).unwrap();
    assert_eq!((&outputs.values[..4], outputs.beyond), (&[0.0, 1.0, 1.0, 0.0][..], 0b1100));
    assert!(betaflight.recognises(RAW, &raw(pulses), PERIOD) && !betaflight.recognises(RAW, &[1], PERIOD));
    for port in [STATE, CHANNELS] {
        assert!(!betaflight.recognises(port, &motors([0.5; 4]), PERIOD));
        assert_eq!(received(&mut betaflight, port, &motors([0.5; 4])), None);
    }
}

#[test]
fn each_axis_alone_arrives_in_betaflight_with_its_sign() {
    for flavour in [Flavour::Gazebo, Flavour::Legacy] {
        let level = state_of(flavour, Motion::default());
        assert!((level[6] + 9.80665).abs() < 1e-12, "a level accelerometer reads -g on z");
        for axis in 0..3 {
            for size in [0.02, -0.02] {
                let mut motion = Motion::default();
                motion.angles[axis] = size;
                let (gyro, attitude) = inside(flavour, &state_of(flavour, motion));
                // Internally, Betaflight's rates are about forward, left, up, and its attitude is of that
                // body over north, west, up: roll has its sign, nose up is a negative turn about left, nose
                // right one about up.
                let sign = [1.0, -1.0, -1.0];
                for i in 0..3 {
                    let wanted = if i == axis { sign[i] * size / 4e-3 } else { 0.0 };
                    assert!((gyro[i] - wanted).abs() < 1e-9, "{flavour:?} {axis}: {gyro:?}");
                }
                // Half way through the turn its accelerometer measures up at half of the angle, forward,
                // left, up: with the right side down from the left, with the nose up from the front.
                let f = state_of(flavour, motion);
                let felt = [[0.0, 0.5 * size, 1.0], [0.5 * size, 0.0, 1.0], [0.0, 0.0, 1.0]][axis];
                for (found, felt) in f[4..7].iter().zip(felt) {
                    assert!((-found - 9.80665 * felt).abs() < 1e-3, "{flavour:?} {axis}: {:?}", &f[4..7]);
                }
                let (roll, pitch, yaw) = attitude.euler_angles();
                for (i, angle) in [roll, -pitch, -yaw].into_iter().enumerate() {
                    let wanted = if i == axis { size } else { 0.0 };
                    assert!(wrapped(angle - wanted).abs() < 1e-9, "{flavour:?} {axis}: {angle}");
                }
            }
            let mut motion =
                Motion { axes: [Axis { position: Some(0.0), speed: None }; 3], ..Motion::default() };
            motion.axes[axis].position = Some(0.4);
            let f = state_of(flavour, motion);
            // Forward is north, right is east: velocity is east, north, up.
            let place = [1, 0, 2][axis];
            for i in 0..3 {
                assert!((f[11 + i] - if i == place { 100.0 } else { 0.0 }).abs() < 1e-6, "{flavour:?} {f:?}");
            }
            let origin = state_of(flavour, Motion::default());
            let moved = [f[14] - origin[14], f[15] - origin[15], f[16] - origin[16]];
            let mirror = if flavour == Flavour::Gazebo && axis < 2 { -1.0 } else { 1.0 };
            assert!(moved[place] * mirror > 1e-6, "{flavour:?} {axis}: {moved:?}");
        }
    }
}

/// Betaflight's clock according to its published source (`updateState`, `micros64`): it runs at the ratio of
/// packet time to wall time between the last two packets, when the packet time difference is more than 0 and
/// less than 20 ms. A packet older than the previous one is refused, and so is the first after half a second
/// without any.
#[derive(Default)]
struct Clock {
    told: f64,
    wall: f64,
    rate: Option<f64>,
    time: f64,
    refused: usize,
}

impl Clock {
    /// Receives a packet at a wall time, s.
    fn take(&mut self, told: f64, wall: f64) {
        let (step, spent) = (told - self.told, wall - self.wall);
        if spent > 0.5 {
            self.refused += 1;
        } else if step < 0.0 {
            self.refused += 1;
            return;
        } else if step > 0.0 && step < 0.02 {
            self.time += self.rate.unwrap_or(1.0) * spent;
            self.rate = Some(step / spent);
            (self.told, self.wall) = (told, wall);
            return;
        }
        self.time += self.rate.unwrap_or(1.0) * spent;
        (self.told, self.wall) = (told, wall);
    }
}

/// Betaflight polls its socket once a millisecond, and every 70 ms it gets no processor time for 9 ms; states
/// are sent early and late; after a second the bridge is restarted.
#[test]
fn betaflights_clock_is_the_walls_however_packets_come() {
    let mut model = SensorModel::new(SensorOptions::default(), 4_000_000, 1);
    let mut clock = Clock::default();
    let (mut queue, mut together, mut states, mut channels) = (Vec::new(), 0, 0, 0);
    let mut betaflight = Betaflight::new(BetaflightOptions::default(), true);
    // In units of 0.1 ms.
    for tick in 0..20_000u64 {
        if tick == 10_000 {
            betaflight = Betaflight::new(BetaflightOptions::default(), true);
        }
        if tick % 40 == tick / 40 % 3 * 10 {
            let sensors = model.step(&Motion::default(), &Errors::default());
            let now = Duration::from_micros(100 * (tick % 10_000));
            received_at(&mut betaflight, now, &raw([1000.0; 16]));
            betaflight.sense(&sensors, &Rc::default(), now, &mut |port, bytes| match port {
                STATE => queue.push(f64::from_le_bytes(bytes[..8].try_into().unwrap())),
                CHANNELS => {
                    assert_eq!(bytes.len(), RC_BYTES);
                    assert_eq!(u16::from_le_bytes([bytes[8 + 4], bytes[8 + 5]]), 1000, "throttle low");
                    channels += 1;
                }
                MSP => {
                    assert!([STATUS_REQUEST, RANGES_REQUEST].iter().any(|question| bytes == question));
                }
                _ => panic!("port {port}"),
            });
        }
        if tick % 700 >= 610 || tick % 10 != 5 {
            continue;
        }
        together += usize::from(queue.len() > 1);
        for (k, told) in queue.drain(..).enumerate() {
            clock.take(told, 1e-4 * tick as f64 + 20e-6 * k as f64);
            states += 1;
        }
    }
    assert_eq!(clock.rate, None, "it never runs at another rate, and shows {} s after 2 s", clock.time);
    assert_eq!((clock.refused, states), (0, 500), "every state is used");
    assert!((clock.time - 2.0).abs() < 0.02, "{} s", clock.time);
    assert!(together > 20, "{together}");
    assert!((80..=101).contains(&channels), "at most 50 Hz: {channels}");
}

/// Channels received during its start would be its last: it makes them its receiver when the first one
/// arrives, and then initialises its receiver as if there were none (`udpRCThread`, `rxInit`).
#[test]
fn channels_wait_until_it_runs_and_again_while_it_is_restarted() {
    let mut model = SensorModel::new(SensorOptions::default(), PERIOD.as_nanos() as u64, 1);
    let mut betaflight = Betaflight::new(BetaflightOptions::default(), true);
    let runs = |ms: u64| (1000..2000).contains(&ms) || ms >= 4000;
    let (mut states, mut channels) = (0, Vec::new());
    for ms in (0..5000).step_by(4) {
        let now = Duration::from_millis(ms);
        if runs(ms) {
            received_at(&mut betaflight, now, &raw([1000.0; 16]));
        }
        let sensors = model.step(&Motion::default(), &Errors::default());
        betaflight.sense(&sensors, &Rc::default(), now, &mut |port, _| match port {
            STATE => states += 1,
            CHANNELS => channels.push(ms),
            _ => {}
        });
    }
    assert_eq!(states, 1250, "it sends no outputs without states");
    let silent = |from, to| !channels.iter().any(|ms| (from..to).contains(ms));
    assert!(silent(0, 1000) && silent(2500, 4000), "{channels:?}");
    assert!(!silent(1000, 1030) && !silent(1970, 2000) && !silent(4000, 4030), "{channels:?}");
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..160), port in 0usize..2, size in 0..3) {
        let mut bytes = bytes;
        match size {
            0 => bytes.resize(16, 0),
            1 => bytes.resize(68, 0),
            _ => {}
        }
        let options = BetaflightOptions { packets: if port == RAW { Packets::Raw } else { Packets::Motors }, ..Default::default() };
        let mut betaflight = Betaflight::new(options, true);
        match received(&mut betaflight, port, &bytes) {
            Some(values) => prop_assert!(values.iter().all(|v| (0.0..=1.0).contains(v))),
            None => prop_assert_eq!(betaflight.counts().malformed, 1),
        }
    }
}

#[test]
fn it_is_asked_why_it_is_not_armed_and_that_is_told_once_its_switch_is_on() {
    let mut betaflight = Betaflight::new(BetaflightOptions::default(), true);
    let mut rc =
        Rc::new(crate::autopilot::RcOptions { arm: true, grace_s: 1.0, ..Default::default() }).unwrap();
    let mut model = SensorModel::new(SensorOptions::default(), PERIOD.as_nanos() as u64, 1);
    // MSP_STATUS_EX with one byte of further modes: throttle not low, and the switch, which is flag 28.
    let mut answer = vec![b'$', b'M', b'>', 22, 150];
    answer.extend([&[0; 15][..], &[1, 0, 29], &(1_u32 << 28 | 1 << 7).to_le_bytes()].concat());
    answer.push(answer[3..].iter().fold(0, |sum, b| sum ^ b));
    // MSP_MODE_RANGES with the arm switch on AUX 1.
    let mut ranges = vec![b'$', b'M', b'>', 4, 34, 0, 0, 32, 48];
    ranges.push(ranges[3..].iter().fold(0, |sum, b| sum ^ b));
    let (mut asked, mut asked_of_ranges, mut told) = (0, 0, Vec::new());
    for ms in (0..4000).step_by(4) {
        let now = Duration::from_millis(ms);
        rc.turn(true, true, now);
        let sensors = model.step(&Motion::default(), &Errors::default());
        let (mut question, mut of_ranges) = (false, false);
        betaflight.sense(&sensors, &rc, now, &mut |port, bytes| {
            question |= port == MSP && bytes == STATUS_REQUEST;
            of_ranges |= port == MSP && bytes == RANGES_REQUEST;
        });
        if of_ranges {
            asked_of_ranges += 1;
            betaflight.receive(MSP, &ranges, now, &mut |_, _| panic!("nothing is asked"));
        }
        if question {
            asked += 1;
            assert!(betaflight.receive(MSP, &answer, now, &mut |_, _| panic!("nothing is asked")));
        }
        told.extend(std::iter::from_fn(|| betaflight.note()).map(|note| (ms, note.text)));
    }
    assert_eq!((asked, asked_of_ranges), (8, 1), "twice a second, and until it has answered");
    assert_eq!(told, [(1000, "Betaflight cannot be armed: THROTTLE (the throttle is not low)".to_string())]);
    assert_eq!(betaflight.said(), Some("THROTTLE (the throttle is not low)"));
    // Once its motors turn it flies, and is not queried.
    assert!(betaflight.receive(RAW, &raw([1100.0; 16]), Duration::from_secs(4), &mut |_, _| {}));
    let sensors = model.step(&Motion::default(), &Errors::default());
    betaflight.sense(&sensors, &rc, Duration::from_secs(9), &mut |port, _| assert_ne!(port, MSP));
}

/// Betaflight has no flag for this: nothing prevents it from being armed, and no switch arms it.
#[test]
fn one_that_no_switch_arms_is_told_before_its_switch_is_on() {
    let mut betaflight = Betaflight::new(BetaflightOptions::default(), true);
    let mut rc = Rc::new(crate::autopilot::RcOptions { arm: true, ..Default::default() }).unwrap();
    let mut model = SensorModel::new(SensorOptions::default(), PERIOD.as_nanos() as u64, 1);
    let mut ranges = vec![b'$', b'M', b'>', 80, 34];
    ranges.extend([0; 80]);
    ranges.push(80 ^ 34);
    let mut said_at = None;
    for ms in (0..5000).step_by(4) {
        let now = Duration::from_millis(ms);
        rc.turn(true, true, now);
        let sensors = model.step(&Motion::default(), &Errors::default());
        let mut of_ranges = false;
        betaflight.sense(&sensors, &rc, now, &mut |port, bytes| {
            of_ranges |= port == MSP && bytes == RANGES_REQUEST
        });
        if of_ranges {
            betaflight.receive(MSP, &ranges, now, &mut |_, _| panic!("nothing is asked"));
        }
        if said_at.is_none()
            && betaflight.said().is_some_and(|why| why.contains("no switch of the transmitter arms it"))
        {
            said_at = Some(ms);
        }
    }
    assert!(said_at.is_some_and(|ms| ms < 1000), "{said_at:?}: {:?}", betaflight.said());
}
