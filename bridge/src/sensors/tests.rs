use super::*;
use proptest::prelude::*;

const PERIOD_NS: u64 = 4_000_000;
const DT: f64 = 4e-3;

fn perfect() -> SensorOptions {
    SensorOptions {
        gyro_noise: 0.0,
        accel_noise: 0.0,
        mag_noise: 0.0,
        baro_noise: 0.0,
        ..SensorOptions::default()
    }
}

fn tilted(roll: f64, pitch: f64, yaw: f64) -> Motion {
    Motion { angles: [roll, pitch, yaw], ..Motion::default() }
}

fn close(a: Vector3<f64>, b: [f64; 3], tolerance: f64) {
    assert!((a - Vector3::from(b)).norm() < tolerance, "{a} is not {b:?}");
}

#[test]
fn each_axis_alone_has_its_sign() {
    let still = |motion: Motion| {
        let mut model = SensorModel::new(perfect(), PERIOD_NS, 1);
        model.step(&motion, &Errors::default());
        model.step(&motion, &Errors::default())
    };
    let g = STANDARD_GRAVITY;
    let a = 0.3f64;
    close(still(tilted(0.0, 0.0, 0.0)).accel, [0.0, 0.0, -g], 1e-12);
    // Right wing down: the specific force points to its left. Nose up: to its front.
    close(still(tilted(a, 0.0, 0.0)).accel, [0.0, -g * a.sin(), -g * a.cos()], 1e-12);
    close(still(tilted(0.0, a, 0.0)).accel, [g * a.sin(), 0.0, -g * a.cos()], 1e-12);
    // Facing east, north is to the left.
    let east = still(tilted(0.0, 0.0, std::f64::consts::FRAC_PI_2)).mag;
    let field = Field::default().ned();
    close(east * 1e6, [field.y * 1e6, -field.x * 1e6, field.z * 1e6], 1e-9);

    let turning = |to: Motion| {
        let mut model = SensorModel::new(perfect(), PERIOD_NS, 1);
        model.step(&tilted(0.0, 0.0, 0.0), &Errors::default());
        model.step(&to, &Errors::default()).gyro
    };
    close(turning(tilted(0.01, 0.0, 0.0)), [0.01 / DT, 0.0, 0.0], 1e-12);
    close(turning(tilted(0.0, 0.01, 0.0)), [0.0, 0.01 / DT, 0.0], 1e-12);
    close(turning(tilted(0.0, 0.0, 0.01)), [0.0, 0.0, 0.01 / DT], 1e-12);
}

#[test]
fn moving_along_each_axis_moves_the_fix_and_is_felt() {
    let moving = |axis: usize| {
        let mut model = SensorModel::new(perfect(), PERIOD_NS, 1);
        let mut at = Motion { axes: [Axis { position: Some(0.0), speed: None }; 3], ..Motion::default() };
        let first = model.step(&at, &Errors::default());
        let mut last = first;
        for k in 1..=100 {
            // One metre per second squared.
            let t = f64::from(k) * DT;
            at.axes[axis].position = Some(0.5 * t * t);
            last = model.step(&at, &Errors::default());
        }
        (first, last)
    };
    let g = STANDARD_GRAVITY;
    let (_, forward) = moving(0);
    close(forward.position, [0.08, 0.0, 0.0], 1e-12);
    close(forward.velocity, [0.398, 0.0, 0.0], 1e-9);
    close(forward.accel, [1.0, 0.0, -g], 1e-9);
    assert!(forward.differential_pressure > 0.0);
    let (_, right) = moving(1);
    close(right.accel, [0.0, 1.0, -g], 1e-9);
    close(right.velocity, [0.0, 0.398, 0.0], 1e-9);
    let (first, up) = moving(2);
    close(up.accel, [0.0, 0.0, -g - 1.0], 1e-9);
    close(up.velocity, [0.0, 0.0, -0.398], 1e-9);
    assert!(up.pressure < first.pressure && (up.pressure_altitude - 488.08).abs() < 1e-6);
    assert_eq!(first.gps.altitude, 488.0);
}

#[test]
fn speeds_alone_are_integrated() {
    let mut model =
        SensorModel::new(SensorOptions { heading: std::f64::consts::FRAC_PI_2, ..perfect() }, PERIOD_NS, 1);
    let mut at = Motion::default();
    let mut last = model.step(&at, &Errors::default());
    for k in 0..=250 {
        at.axes[0].speed = Some(f64::from(k) * DT);
        last = model.step(&at, &Errors::default());
    }
    // Facing east: forward is east. 250 periods of 1 m/s^2 after one at rest.
    close(last.position, [0.0, 0.5, 0.0], 1e-9);
    close(last.velocity, [0.0, 1.0, 0.0], 1e-9);
}

#[test]
fn fixes_come_at_their_rate_and_errors_reach_the_sensor_of_their_cause() {
    let mut model = SensorModel::new(perfect(), PERIOD_NS, 1);
    let errors = Errors {
        angles: [0.02, 0.0, 0.0],
        rates: [0.0, 0.5, 0.0],
        position: [0.0, 0.0, 2.0],
        speed: [0.3, 0.0, 0.0],
    };
    let all: Vec<_> = (0..250).map(|_| model.step(&Motion::default(), &errors)).collect();
    assert_eq!(all.iter().filter(|s| s.gps_fresh).count(), 10, "ten fixes in a second");
    assert_eq!(all[249].time_ns, 249 * PERIOD_NS);
    let last = all[249];
    close(last.gyro, [0.0, 0.5, 0.0], 1e-12);
    close(last.accel, [0.0, -STANDARD_GRAVITY * 0.02f64.sin(), -STANDARD_GRAVITY * 0.02f64.cos()], 1e-12);
    assert_eq!(last.gps.altitude, 490.0);
    close(last.gps.velocity, [0.3, 0.0, 0.0], 1e-12);
    close(last.velocity, [0.0, 0.0, 0.0], 1e-12);
}

#[test]
fn noise_has_its_size_and_is_the_same_for_the_same_seed() {
    let run = |seed| {
        let mut model = SensorModel::new(SensorOptions::default(), PERIOD_NS, seed);
        (0..4000).map(|_| model.step(&Motion::default(), &Errors::default())).collect::<Vec<_>>()
    };
    let (one, again, other) = (run(1), run(1), run(2));
    assert_eq!(one, again);
    assert_ne!(one[7].accel, other[7].accel);
    let deviation = (one.iter().map(|s| s.accel.x * s.accel.x).sum::<f64>() / one.len() as f64).sqrt();
    assert!((deviation / 0.02 - 1.0).abs() < 0.05, "{deviation}");
}

#[test]
fn states_are_found_by_name() {
    let map = StateMap::new(["roll", "roll_rate", "pitch", "pitch_rate", "lateral_speed"]).unwrap();
    let motion = map.motion(&[1.0, 2.0, 3.0, 4.0, 5.0]);
    assert_eq!(motion.angles, [1.0, 3.0, 0.0]);
    assert_eq!(motion.rates, [2.0, 4.0, 0.0]);
    assert_eq!(motion.axes[1], Axis { position: None, speed: Some(5.0) });
    let error = StateMap::new(["roll", "yaw"]).unwrap_err().to_string();
    assert!(error.contains("\"pitch\"") && error.contains("roll, yaw"), "{error}");
}

proptest! {
    /// For any model: integrating the gyroscope gives the attitude, and integrating the accelerometer gives
    /// velocity and, with it, position.
    #[test]
    fn the_sensors_agree_with_each_other(
        tones in prop::collection::vec((0.0..0.9f64, 0.1..3.0f64, 0.0..6.0f64), 6),
        heading in -3.0..3.0f64,
    ) {
        let mut model = SensorModel::new(SensorOptions { heading, ..perfect() }, PERIOD_NS, 1);
        let wave = |i: usize, t: f64| tones[i].0 * (tones[i].1 * t + tones[i].2).sin();
        let at = |t: f64| Motion {
            angles: [wave(0, t), wave(1, t), 2.0 * wave(2, t)],
            rates: [0.0; 3],
            axes: [3, 4, 5].map(|i| Axis { position: Some(10.0 * wave(i, t)), speed: None }),
        };
        let start = model.step(&at(0.0), &Errors::default());
        // Positions alone do not determine the velocity before the second one.
        let (mut attitude, mut position) = (start.attitude, start.position);
        let mut velocity = Vector3::zeros();
        for k in 1..1000 {
            let s = model.step(&at(f64::from(k) * DT), &Errors::default());
            if k == 1 {
                (attitude, velocity, position) = (s.attitude, s.velocity, s.position);
                continue;
            }
            let half = UnitQuaternion::from_scaled_axis(s.gyro * (DT / 2.0));
            let middle = attitude * half;
            attitude = middle * half;
            velocity += (middle * s.accel + Vector3::new(0.0, 0.0, STANDARD_GRAVITY)) * DT;
            position += velocity * DT;
            prop_assert!(attitude.angle_to(&s.attitude) < 1e-9);
            prop_assert!((velocity - s.velocity).norm() < 1e-9, "{} {}", velocity, s.velocity);
            prop_assert!((position - s.position).norm() < 1e-8);
        }
    }
}
