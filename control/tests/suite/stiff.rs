//! Plants from slow to stiff, 1 Hz to 20 kHz and 1e-6 to 1e6 1/s: design, filter and simulator sample them alike, and what
//! is designed for them is an answer of numbers or a sentence.

use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use whirlstand_control::{
    Design, Estimator, EstimatorOptions, InputLimits, LawOptions, SampledPlant, Sensors, Weights,
};
use whirlstand_vehicle::{discretise, finite_horizon_gramian};

struct Case {
    name: String,
    a: DMatrix<f64>,
    b: DMatrix<f64>,
    period_s: f64,
}

/// The plants of the vehicle room's table.
fn table() -> Vec<Case> {
    let text = include_str!("../../../vehicle/reference/stiff.json");
    let table: serde_json::Value = serde_json::from_str(text).expect("a table");
    let cases = table["cases"].as_array().expect("cases").iter().map(|case| {
        let matrix = |key: &str| {
            let rows = case[key].as_array().expect("rows");
            let entry = |i: usize, j: usize| rows[i][j].as_f64().expect("a number");
            DMatrix::from_fn(rows.len(), rows[0].as_array().expect("a row").len(), entry)
        };
        Case {
            name: case["name"].as_str().expect("a name").into(),
            a: matrix("a"),
            b: matrix("b"),
            period_s: case["period_s"].as_f64().expect("a period"),
        }
    });
    cases.collect()
}

/// With one limit for all inputs.
fn plant(a: &DMatrix<f64>, b: &DMatrix<f64>, period_s: f64) -> SampledPlant {
    let limits = InputLimits { lower: -1.0, upper: 1.0, rate: f64::INFINITY };
    SampledPlant::new(a.clone(), b.clone(), period_s)
        .and_then(|p| p.with_limits(vec![limits; b.ncols()]))
        .expect("finite")
}

/// All states are measured, each to a hundredth of its scale.
fn sensors(plant: &SampledPlant) -> Sensors {
    let n = plant.state_count();
    Sensors {
        c: DMatrix::identity(n, n),
        d: DMatrix::zeros(n, plant.input_count()),
        std: plant.scales().iter().map(|s| 0.01 * s).collect(),
        names: (1..=n).map(|i| format!("y{i}")).collect(),
    }
}

/// What `options` make of the plant: numbers, or a sentence without a NaN.
fn assert_answer(name: &str, plant: &SampledPlant, law: &str) -> Result<(), String> {
    let fail = |what: String| Err(format!("{name}, {law}: {what}"));
    let design = match Design::new(plant, &LawOptions::named(law).expect("known")) {
        Ok(design) => design,
        Err(e) if e.to_string().contains("NaN") => return fail(e.to_string()),
        Err(_) => return Ok(()),
    };
    let gains = [&design.linear.gain, &design.linear.memory_gain, &design.integral_tracking];
    if gains.iter().any(|g| g.iter().any(|v| !v.is_finite())) {
        return fail(format!("{}", design.linear.gain));
    }
    let closed = whirlstand_linalg::eigenvalues(&design.linear.closed_loop(plant)).expect("finite");
    if closed.iter().any(|p| p.norm().is_nan() || p.norm() >= 1.0) {
        return fail(format!("{closed:?}"));
    }
    let m = &design.multivariable_margins;
    if [m.min_return_difference, m.max_sensitivity, m.disk, m.disk_gain_low, m.disk_phase_deg]
        .iter()
        .any(|v| v.is_nan())
    {
        return fail(format!("{m:?}"));
    }
    Ok(())
}

/// The filter's uncertainty stays a number over many steps, and never exceeds that of one measurement by rounding.
fn assert_filter(name: &str, plant: &SampledPlant) -> Result<(), String> {
    let (n, sensors) = (plant.state_count(), sensors(plant));
    let options = EstimatorOptions { bias: Some(Vec::new()), ..EstimatorOptions::default() };
    let mut filter = Estimator::new(plant, &sensors, &options)
        .map_err(|e| format!("{name}: all states are measured, but: {e}"))?;
    let all = u64::MAX >> (64 - n);
    for k in 0..600 {
        filter.step(&vec![0.0; n], all, &[0.0], &[0.0]);
        let sound = (0..n).all(|i| filter.std()[i] >= 0.0 && filter.std()[i] <= 1.000_001 * sensors.std[i]);
        if !sound || filter.x().iter().any(|x| *x != 0.0) || !filter.nis().is_finite() {
            return Err(format!(
                "{name}, step {k}: {:?} of {:?}, {:?}",
                filter.std(),
                sensors.std,
                filter.x()
            ));
        }
    }
    Ok(())
}

#[test]
fn design_and_filter_sample_as_the_simulator_does() {
    for case in table() {
        let (a, b, period_s) = (&case.a, &case.b, case.period_s);
        let n = a.nrows();
        let (phi, gamma) = discretise(a, b, period_s).expect("finite");
        let plant = plant(a, b, period_s);
        assert_eq!((plant.phi(), plant.gamma()), (&phi, &gamma), "{}", case.name);
        let density = DMatrix::from_diagonal(&DVector::from_element(n, 0.25));
        let process_noise = Some(Weights::Uniform(0.5));
        let options =
            EstimatorOptions { process_noise, bias: Some(Vec::new()), ..EstimatorOptions::default() };
        let filter = Estimator::new(&plant, &sensors(&plant), &options).expect("all is measured");
        let model = filter.filter().model();
        assert_eq!((&model.f, &model.g), (&phi, &gamma), "{}", case.name);
        assert_eq!(model.q, finite_horizon_gramian(a, &density, period_s).expect("finite"), "{}", case.name);
    }
}

#[test]
fn laws_and_filters_of_stiff_plants_are_numbers() {
    let mut wrong = Vec::new();
    for case in table() {
        let plant = plant(&case.a, &case.b, case.period_s);
        wrong.extend(assert_filter(&case.name, &plant).err());
        for law in ["lqr", "ppc", "smc"] {
            wrong.extend(assert_answer(&case.name, &plant, law).err());
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The fast actuator of a slow vehicle is the usual stiff plant: a regulator has to come out of it, not a refusal.
#[test]
fn a_fast_actuator_is_regulated_as_if_it_were_not_there() {
    let vehicle = [[0.0, 1.0, 0.0], [-1.1, -0.7, 2.0]];
    let gain = |rate: f64| {
        let mut a = DMatrix::zeros(3, 3);
        (0..2).for_each(|i| (0..3).for_each(|j| a[(i, j)] = vehicle[i][j]));
        a[(2, 2)] = -rate;
        let b = DMatrix::from_column_slice(3, 1, &[0.0, 0.0, rate]);
        let design = Design::new(&plant(&a, &b, 0.005), &LawOptions::named("lqr").expect("known"));
        design.unwrap_or_else(|e| panic!("{rate}: {e}")).linear.gain
    };
    let slowest = gain(1e4);
    for rate in [1e5, 1e6, 1e7] {
        let found = gain(rate);
        let apart = (found.columns(0, 2) - slowest.columns(0, 2)).norm() / slowest.columns(0, 2).norm();
        assert!(apart < 0.02, "{rate}: {found} {slowest}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    #[test]
    fn stiff_plants_drawn_at_random_have_numbers_or_a_sentence(
        exponents in prop::collection::vec(-6.0f64..6.0, 1..5),
        couplings in prop::collection::vec(-1.0f64..1.0, 5),
        stable in any::<bool>(),
        period in -4.3f64..0.0,
    ) {
        let n = exponents.len();
        let a = DMatrix::from_fn(n, n, |i, j| {
            let w = 10f64.powf(exponents[i]);
            match () {
                // One slow mode may grow.
                () if i == j && !stable && i == 0 && w < 10.0 => w,
                () if i == j => -w,
                () if j + 1 == i => couplings[i] * w,
                () => 0.0,
            }
        });
        let b = DMatrix::from_fn(n, 1, |i, _| if i == 0 { 10f64.powf(exponents[0]) } else { 0.0 });
        let plant = plant(&a, &b, 10f64.powf(period));
        let sound = assert_filter("filter", &plant);
        prop_assert!(sound.is_ok(), "{:?} {}", sound, a);
        for law in ["lqr", "ppc", "smc"] {
            let sound = assert_answer("design", &plant, law);
            prop_assert!(sound.is_ok(), "{:?} {}", sound, a);
        }
    }
}
