use nalgebra::{Matrix2, Matrix4, Matrix4x2, SMatrix, Vector2, Vector4};
use whirlstand_vehicle::{Stream, Vehicle};

use super::*;
use crate::turning::{inputs_of, own_motion_of};

const STEP: f64 = 0.01;
const DURATION_S: f64 = 8.0;
/// The vehicles, and times between two attitudes, s: ExpressLRS by default, and 50 Hz.
const VEHICLES: [&str; 4] =
    ["quadrotor", "helicopter-hover", "helicopter-lateral", "helicopter-longitudinal"];
const TOLD_EVERY: [f64; 3] = [0.25, 0.1, 0.02];
/// Noise of reported angles and rates, rad and rad/s: of the file's sensors, and of an estimator.
const NOISES: [[f64; 2]; 2] = [[0.0021, 0.0122], [0.0001, 0.0012]];

/// Roll and pitch of a built-in vehicle under a linear-quadratic law and a filter designed for its file, with
/// unknown deviations.
struct Flight {
    vehicle: &'static str,
    told_every: f64,
    has_rates: bool,
    noise: [f64; 2],
    /// Sign of each channel, -1 for a reversed one.
    signs: [f64; 2],
    /// True for unknown gains, gusts and setpoints; otherwise the vehicle matches its file and the air is
    /// still. The delay is always unknown.
    unknown: bool,
    seed: u64,
}

/// Result of a flight: time and axis of the detection, and the largest angle until then, rad.
struct Outcome {
    wrong: Option<(f64, usize)>,
    right: [bool; 2],
    most: f64,
}

/// Deviations and disturbances unknown to law and filter.
struct Unknown {
    gains: Vector2<f64>,
    delay: usize,
    bias: Vector2<f64>,
    turbulence: Vector2<f64>,
    gusts: [(f64, f64, f64); 2],
    setpoint: (f64, Vector4<f64>),
}

fn uniform(noise: &mut Stream, from: f64, to: f64) -> f64 {
    from + (to - from) * noise.uniform()
}

impl Unknown {
    fn of(flight: &Flight, authority: Vector2<f64>, noise: &mut Stream) -> Self {
        let share = if flight.unknown { 1.0 } else { 0.0 };
        let mut pair = |of: &mut dyn FnMut(&mut Stream) -> f64| [of(noise), of(noise)];
        let gains = pair(&mut |n| (share * uniform(n, 0.5f64.ln(), 2f64.ln())).exp());
        // Up to 150 deg/s^2 for half a second, on two axes of three.
        let gusts = [0, 1].map(|_| {
            let on = if uniform(noise, 0.0, 1.0) < 0.7 { share } else { 0.0 };
            let begin = uniform(noise, 0.0, 0.7 * DURATION_S);
            (begin, begin + uniform(noise, 0.1, 0.5), on * uniform(noise, -2.6, 2.6))
        });
        let turbulence = [0.0, 0.05, 0.3][uniform(noise, 0.0, 2.999) as usize];
        let mut angle = || 0.1 * noise.normal() * share;
        let setpoint = Vector4::new(angle(), 0.0, angle(), 0.0);
        Self {
            gains: Vector2::new(gains[0] * flight.signs[0], gains[1] * flight.signs[1]),
            delay: uniform(noise, 0.0, 10.0).round() as usize,
            bias: authority.map(|a| 0.1 * a * share * noise.normal()),
            turbulence: authority * turbulence * share,
            gusts,
            setpoint: (uniform(noise, 0.0, DURATION_S), setpoint),
        }
    }
}

/// The law's gain for x(k+1) = a x + b u, by iterating the Riccati equation.
fn law(a: &Matrix4<f64>, b: &Matrix4x2<f64>, q: &Matrix4<f64>, r: &Matrix2<f64>) -> SMatrix<f64, 2, 4> {
    let mut p = *q;
    let mut gain = SMatrix::zeros();
    for _ in 0..1000 {
        gain = (r + b.transpose() * p * b).try_inverse().unwrap() * b.transpose() * p * a;
        p = q + a.transpose() * p * (a - b * gain);
    }
    gain
}

/// The law with its filter.
struct Loop {
    a: Matrix4<f64>,
    b: Matrix4x2<f64>,
    gain: SMatrix<f64, 2, 4>,
    state: Vector4<f64>,
    covariance: Matrix4<f64>,
}

impl Loop {
    fn correct(&mut self, told: &[(usize, f64, f64)]) {
        for (i, value, deviation) in told {
            let column: Vector4<f64> = self.covariance.column(*i).into();
            let variance = column[*i] + deviation * deviation;
            self.state += column * ((value - self.state[*i]) / variance);
            self.covariance -= column * column.transpose() / variance;
        }
    }

    fn go_on(&mut self, u: &Vector2<f64>) {
        self.state = self.a * self.state + self.b * u;
        let push = 0.27 * STEP;
        self.covariance = self.a * self.covariance * self.a.transpose()
            + Matrix4::from_diagonal(&Vector4::new(0.0, push, 0.0, push));
    }
}

impl Flight {
    fn fly(&self) -> Outcome {
        let vehicle = Vehicle::builtin(self.vehicle).unwrap();
        let noise = &mut Stream::new(self.seed, "flight");
        let a = vehicle.a.fixed_view::<4, 4>(0, 0).into_owned();
        let b = vehicle.b.fixed_view::<4, 2>(0, 0).into_owned();
        let full = Vector2::new(vehicle.inputs[0].upper, vehicle.inputs[1].upper);
        let unknown = Unknown::of(self, Vector2::new(b[(1, 0)] * full[0], b[(3, 1)] * full[1]).abs(), noise);
        let mut control = self.design(&a, &b, &full, noise);
        let mut watch = SignWatch::new(&inputs_of(&vehicle), &own_motion_of(&vehicle));
        // The vehicle is not level when it is armed.
        let mut x = Vector4::new(0.035 * noise.normal(), 0.0, 0.035 * noise.normal(), 0.0);
        let (mut past, mut turbulence) = (Vec::new(), Vector2::zeros());
        let mut attitude = Attitude { angles: [0.0; 3], rates: None, at: Duration::ZERO };
        let (steps, every) = ((DURATION_S / STEP) as usize, (self.told_every / STEP).round() as usize);
        let mut outcome = Outcome { wrong: None, right: [false; 2], most: 0.0 };
        for k in 0..steps {
            let t = k as f64 * STEP;
            let now = TICK * (k as u32 + 1);
            past.push(x);
            if k % every == 0 {
                let seen = past[k.saturating_sub(unknown.delay)];
                let told: [f64; 4] = std::array::from_fn(|i| seen[i] + self.noise[i % 2] * noise.normal());
                let rates = self.has_rates.then_some([told[1], told[3], 0.0]);
                attitude = Attitude { angles: [told[0], told[2], 0.0], rates, at: now };
                let known = (0..4).filter(|i| i % 2 == 0 || self.has_rates);
                let known: Vec<_> = known.map(|i| (i, told[i], NOISES[0][i % 2])).collect();
                control.correct(&known);
            }
            let setpoint = if t > unknown.setpoint.0 { unknown.setpoint.1 } else { Vector4::zeros() };
            let asked = control.gain * (setpoint - control.state);
            let u = asked.zip_map(&full, |u: f64, full| u.clamp(-full, full));
            watch.observe(u.as_slice(), attitude, now);
            outcome.right = [watch.right[0], watch.right[1]];
            if let Some(axis) = watch.wrong() {
                outcome.wrong = Some((t, axis));
                break;
            }
            control.go_on(&u);
            let change = (2.0 * STEP / 0.5f64).sqrt();
            turbulence = turbulence * (1.0 - STEP / 0.5)
                + unknown.turbulence.map(|size| change * size * noise.normal());
            let acts = u.component_mul(&unknown.gains);
            for _ in 0..2 {
                let mut dx = a * x + b * acts;
                for (i, (begin, end, size)) in unknown.gusts.into_iter().enumerate() {
                    dx[2 * i + 1] += unknown.bias[i] + turbulence[i];
                    dx[2 * i + 1] += if (begin..end).contains(&t) { size } else { 0.0 };
                }
                x += dx * (0.5 * STEP);
            }
            outcome.most = outcome.most.max(x[0].abs()).max(x[2].abs());
            // No flying vehicle reaches this angle.
            if outcome.most > 1.0 {
                break;
            }
        }
        outcome
    }

    fn design(&self, a: &Matrix4<f64>, b: &Matrix4x2<f64>, full: &Vector2<f64>, noise: &mut Stream) -> Loop {
        let a_step = Matrix4::identity() + a * STEP + a * a * (0.5 * STEP * STEP);
        let b_step = b * STEP + a * b * (0.5 * STEP * STEP);
        // From a slow law to a fast one: 10 deg and 60 deg/s have the weight of a fifth of full deflection,
        // or of five times it.
        let eager = 10f64.powf(uniform(noise, -0.7, 0.7));
        let weights = [0.175f64, 1.05].map(|size| eager / (size * size));
        let q = Matrix4::from_diagonal(&Vector4::new(weights[0], weights[1], weights[0], weights[1]));
        let r = Matrix2::from_diagonal(&full.map(|full| 1.0 / (full * full)));
        Loop {
            gain: law(&a_step, &b_step, &q, &r),
            a: a_step,
            b: b_step,
            state: Vector4::zeros(),
            covariance: Matrix4::identity() * 3e-4,
        }
    }
}

/// Each vehicle at each telemetry rate, and once with rates, with each noise.
fn kinds() -> impl Iterator<Item = (&'static str, f64, bool, [f64; 2])> {
    VEHICLES.into_iter().flat_map(|vehicle| {
        NOISES.into_iter().flat_map(move |noise| {
            let angles = TOLD_EVERY.map(|every| (vehicle, every, false, noise));
            angles.into_iter().chain([(vehicle, TOLD_EVERY[2], true, noise)])
        })
    })
}

#[test]
fn a_vehicle_that_obeys_is_let_fly_in_gusts_late_and_with_half_or_twice_the_gain() {
    let seeds = std::env::var("WHIRLSTAND_SEEDS").ok().and_then(|n| n.parse().ok()).unwrap_or(40);
    let (mut flights, mut right, mut accused) = (0, 0, Vec::new());
    for (vehicle, told_every, has_rates, noise) in kinds() {
        for seed in 0..seeds {
            let flight =
                Flight { vehicle, told_every, has_rates, noise, signs: [1.0; 2], unknown: true, seed };
            let outcome = flight.fly();
            if let Some((at, axis)) = outcome.wrong {
                accused.push(format!(
                    "{vehicle}, every {told_every} s, rates {has_rates}, noise {noise:?}, seed {seed}: axis {axis} at {at:.2} s"
                ));
            }
            flights += 1;
            right += usize::from(outcome.right[0]);
        }
    }
    eprintln!("{} of {flights} accused; of {right} it is known that roll is right", accused.len());
    assert!(accused.len() * 1000 <= flights, "{accused:#?}");
    assert!(right > flights / 2, "{right} of {flights}");
}

#[test]
fn a_turned_sign_is_noticed_before_the_vehicle_is_far_with_and_without_rates() {
    for (vehicle, told_every, has_rates, noise) in kinds() {
        let (mut noticed, mut far, mut flights, mut delays) = (0, 0, 0, Vec::new());
        for signs in [[-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]] {
            for seed in 0..20 {
                let flight = Flight { vehicle, told_every, has_rates, noise, signs, unknown: false, seed };
                let outcome = flight.fly();
                flights += 1;
                far += usize::from(outcome.wrong.is_none() && outcome.most > 0.26);
                noticed += usize::from(outcome.wrong.is_some());
                let turned = outcome.right.into_iter().zip(signs).any(|(right, sign)| right && sign < 0.0);
                assert!(!turned, "a turned axis is told to be right: {vehicle}, {signs:?}, seed {seed}");
                delays.extend(outcome.wrong.map(|(at, _)| (at, outcome.most.to_degrees())));
            }
        }
        delays.sort_by(|a, b| a.0.total_cmp(&b.0));
        let middle = delays.get(delays.len() / 2);
        eprintln!(
            "{vehicle}, every {told_every} s, rates {has_rates}, noise {noise:?}: {noticed} of {flights} noticed, {far} beyond 15 deg and not; \
             median (s, deg) {middle:?}"
        );
        assert!(far * 10 <= flights, "{vehicle}, every {told_every} s: {far} of {flights} unnoticed");
    }
}
