//! Consistency of the filters: NEES and NIS inside their chi-square bounds (Bar-Shalom, Li and Kirubarajan 2001,
//! section 5.4), over Monte Carlo trials with fixed seeds.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use whirlstand_control::{
    Estimator, EstimatorKind, EstimatorOptions, InputLimits, SampledPlant, Selector, Sensors,
};
use whirlstand_linalg::symmetric_eigen;
use whirlstand_vehicle::{Effect, Kind, LinearModel, Vehicle};

use crate::support::{VEHICLES, plant};

const TRIALS: u64 = 100;
const STEPS: usize = 400;

/// All states measured, at the noise that the built-in vehicles declare.
fn sensors(plant: &SampledPlant) -> Sensors {
    let n = plant.state_count();
    let degree = std::f64::consts::PI / 180.0;
    let std = [0.08 * degree, 0.4 * degree, 0.08 * degree, 0.4 * degree, 0.03, 0.03, 0.05, 0.05];
    Sensors {
        c: DMatrix::identity(n, n),
        d: DMatrix::zeros(n, plant.input_count()),
        std: std[..n].to_vec(),
        names: plant.state_names().to_vec(),
    }
}

/// Bounds of the mean of `count` chi-square variables of `dof` degrees of freedom each, at 99.9 %
/// (Wilson and Hilferty).
fn bounds(dof: f64, count: f64) -> (f64, f64) {
    let k = dof * count;
    let quantile = |z: f64| k * (1.0 - 2.0 / (9.0 * k) + z * (2.0 / (9.0 * k)).sqrt()).powi(3) / count;
    (quantile(-3.29), quantile(3.29))
}

struct Means {
    nees: f64,
    nis: f64,
    dof: f64,
    states: f64,
}

/// Runs the filter's own model as the truth and averages over trials the NEES and NIS of the last step, at which
/// trials are independent of each other.
fn trials(
    plant: &SampledPlant,
    options: &EstimatorOptions,
    steps: usize,
    pattern: impl Fn(usize) -> u64,
) -> Means {
    let sensors = sensors(plant);
    let new = || Estimator::new(plant, &sensors, options).expect("the sensors show every state");
    trials_of(&new, &sensors.std, steps, pattern)
}

/// The same of any filter whose inputs are the commands.
fn trials_of(
    new: &dyn Fn() -> Estimator,
    std: &[f64],
    steps: usize,
    pattern: impl Fn(usize) -> u64,
) -> Means {
    let mut means = Means { nees: 0.0, nis: 0.0, dof: 0.0, states: 0.0 };
    for seed in 0..TRIALS {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = |count: usize| DVector::from_fn(count, |_, _| StandardNormal.sample(&mut rng));
        let mut estimator = new();
        let model = estimator.filter().model();
        let size = model.f.nrows();
        let (values, vectors) = symmetric_eigen(model.q.clone()).expect("finite");
        let root = &vectors * DMatrix::from_diagonal(&values.map(|v| v.max(0.0).sqrt()));
        let start = estimator.filter().covariance().map(|v| v.sqrt());
        let (f, g, h) = (model.f.clone(), model.g.clone(), model.h.clone());
        let mut x = start * normal(size);
        let mut before = [0.0, 0.0];
        for k in 0..steps {
            let now = [10.0 * (0.02 * k as f64).sin(), 5.0 * (0.03 * k as f64).cos()];
            if k > 0 {
                x = &f * x + &g * DVector::from_column_slice(&before) + &root * normal(size);
            }
            let noise = normal(std.len());
            let y = &h * &x + DVector::from_fn(std.len(), |i, _| std[i] * noise[i]);
            estimator.step(y.as_slice(), pattern(k), &before, &now);
            before = now;
        }
        let error = DVector::from_column_slice(estimator.filter().x()) - &x;
        let covariance = estimator.filter().covariance().clone().cholesky().expect("positive definite");
        means.nees += error.dot(&covariance.solve(&error)) / TRIALS as f64;
        means.nis += estimator.nis() / TRIALS as f64;
        means.dof = f64::from(estimator.dof());
        means.states = size as f64;
    }
    means
}

fn check(name: &str, means: &Means) {
    let (low, high) = bounds(means.states, TRIALS as f64);
    println!("{name}: NEES {:.3} in [{low:.3}, {high:.3}]", means.nees);
    assert!(means.nees > low && means.nees < high, "{name}: NEES {} outside [{low}, {high}]", means.nees);
    let (low, high) = bounds(means.dof, TRIALS as f64);
    println!("{name}: NIS {:.3} in [{low:.3}, {high:.3}], {} degrees of freedom", means.nis, means.dof);
    assert!(means.nis > low && means.nis < high, "{name}: NIS {} outside [{low}, {high}]", means.nis);
}

#[test]
fn model_based_filter_is_consistent_on_every_vehicle() {
    for name in VEHICLES {
        let means = trials(&plant(name), &EstimatorOptions::default(), STEPS, |_| u64::MAX);
        check(name, &means);
    }
}

#[test]
fn kinematic_filter_is_consistent_on_every_vehicle() {
    let options = EstimatorOptions { kind: EstimatorKind::Kinematic, ..EstimatorOptions::default() };
    for name in VEHICLES {
        check(name, &trials(&plant(name), &options, STEPS, |_| u64::MAX));
    }
}

#[test]
fn dividers_and_dropouts_do_not_break_consistency() {
    let plant = plant("helicopter-hover");
    // Attitude and rates always, speeds every fourth step, positions every tenth.
    let divided = |k: usize| {
        0b1111 | if k.is_multiple_of(4) { 0b11_0000 } else { 0 } | if k % 10 == 9 { 0b1100_0000 } else { 0 }
    };
    check("dividers", &trials(&plant, &EstimatorOptions::default(), STEPS, divided));
    let dropouts = move |k: usize| if (k * 7919) % 31 < 4 && k != STEPS - 1 { 0 } else { divided(k) };
    check("dividers and dropouts", &trials(&plant, &EstimatorOptions::default(), STEPS, dropouts));
}

#[test]
fn gains_that_are_kept_for_long_stay_consistent() {
    let plant = plant("quadrotor");
    let options = EstimatorOptions::default();
    for steps in [900, 2500] {
        check(&format!("{steps} steps"), &trials(&plant, &options, steps, |_| u64::MAX));
    }
    let divided = |k: usize| if k.is_multiple_of(5) { 0b1111 } else { 0b1010 };
    check("dividers, 2501 steps", &trials(&plant, &options, 2501, divided));
}

/// A filter of the quadrotor whose gyros shake at two frequencies, and the noise of its sensors.
fn shaking() -> (Estimator, Vec<f64>) {
    let mut vehicle = Vehicle::builtin("quadrotor").expect("built in");
    for (place, frequency_hz) in
        [("roll_rate", 33.0), ("roll_rate", 66.0), ("pitch_rate", 33.0), ("pitch_rate", 66.0)]
    {
        let tone = [("frequency_hz", frequency_hz), ("amplitude", 0.01)];
        vehicle.add_effect(Effect::new(Kind::Vibration, place, &tone).expect("in range")).expect("fits");
    }
    let linear = LinearModel::new(&vehicle).expect("fits");
    let limits = InputLimits { lower: -20.0, upper: 20.0, rate: f64::INFINITY };
    let plant = SampledPlant::of(&linear, TONE_PERIOD_S).and_then(|p| p.with_limits(vec![limits; 2]));
    let plant = plant.expect("sound");
    let sensors = sensors(&plant);
    let estimator = Estimator::of(&plant, &sensors, Some(&linear), &EstimatorOptions::default());
    (estimator.expect("observable"), sensors.std)
}

const TONE_PERIOD_S: f64 = 0.005;

/// Oscillators are states as any other: where air and rotors do what the filter takes them for, it knows its errors.
#[test]
fn a_filter_with_oscillators_is_consistent() {
    let (estimator, std) = shaking();
    check("oscillators", &trials_of(&|| estimator.clone(), &std, STEPS, |_| u64::MAX));
}

/// Tones that stand still are followed as if they wandered. A component of a tone wanders by w std per sqrt(s) and is seen in every
/// other sample's worth of information, so that its variance settles at w sqrt(2 T) of the sensor's, half of which is there when
/// nothing wanders: two tones of w = 0.3 at 200 Hz take 3 % off the NIS of their sensor, and half of the sensors have them.
#[test]
fn tones_that_stand_still_take_little_off_the_nis() {
    let (new, std) = shaking();
    let model = new.filter().model();
    let (f, h, size) = (model.f.clone(), model.h.clone(), model.f.nrows());
    let mut q = model.q.clone();
    let first = size - 8;
    q.view_mut((first, first), (8, 8)).fill(0.0);
    let (values, vectors) = symmetric_eigen(q).expect("finite");
    let root = &vectors * DMatrix::from_diagonal(&values.map(|v| v.max(0.0).sqrt()));
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut normal = |count: usize| DVector::from_fn(count, |_, _| StandardNormal.sample(&mut rng));
    let (mut estimator, mut x) = (new.clone(), DVector::zeros(size));
    x.rows_mut(first, 8).fill(0.01);
    let (mut sum, mut degrees) = (0.0, 0.0);
    for k in 0..40_000 {
        x = &f * x + &root * normal(size);
        let noise = normal(std.len());
        let y = &h * &x + DVector::from_fn(std.len(), |i, _| std[i] * noise[i]);
        estimator.step(y.as_slice(), u64::MAX, &[0.0; 2], &[0.0; 2]);
        if k >= 2000 {
            sum += estimator.nis();
            degrees += f64::from(estimator.dof());
        }
    }
    let excess = 0.3 * (2.0 * TONE_PERIOD_S).sqrt();
    let expected = 0.5 * (1.0 + (1.0 + excess) / (1.0 + 2.0 * excess));
    println!("NIS {:.4}, expected {expected:.4}", sum / degrees);
    assert!((sum / degrees - expected).abs() < 0.008, "{} is not {expected}", sum / degrees);
}

/// An offset of the input is a state of the model, so the trials draw it as well.
#[test]
fn a_filter_that_estimates_the_offset_of_an_input_is_consistent() {
    let options =
        EstimatorOptions { input_bias: vec![Selector::Name("u_roll".into())], ..EstimatorOptions::default() };
    for name in VEHICLES {
        check(name, &trials(&plant(name), &options, STEPS, |_| u64::MAX));
    }
}

#[test]
fn offsets_of_inputs_that_make_no_sense_are_refused() {
    let plant = plant("quadrotor");
    let refused = |options: EstimatorOptions| {
        Estimator::new(&plant, &sensors(&plant), &options).expect_err("refused").to_string()
    };
    let of = |name: &str| EstimatorOptions {
        input_bias: vec![Selector::Name(name.into())],
        ..EstimatorOptions::default()
    };
    assert!(refused(of("u_yaw")).contains("the inputs are u_roll, u_pitch"));
    let kinematic = EstimatorOptions { kind: EstimatorKind::Kinematic, ..of("u_roll") };
    assert!(refused(kinematic).contains("knows no inputs"));
    let nothing = EstimatorOptions { input_bias_walk: Some(0.0), ..of("u_roll") };
    assert!(refused(nothing).contains("0 is not positive"));
    // Five constants do not show in four outputs.
    let all = (0..4).map(Selector::Index).collect();
    let hidden = refused(EstimatorOptions { bias: Some(all), ..of("u_roll") });
    assert!(hidden.contains("the offset of u_roll"), "{hidden}");
}
