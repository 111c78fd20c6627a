//! One sample period of slow, fast and stiff plants, from 1 Hz to 20 kHz and from 1e-6 to 1e6 1/s: against the
//! multi-precision table of `reference/stiff.py`, and by what holds for every plant.

use nalgebra::DMatrix;
use proptest::prelude::*;
use whirlstand_linalg::balancing_exponents;
use whirlstand_vehicle::{Simulator, Vehicle, discretise, finite_horizon_gramian};

struct Case {
    name: String,
    a: DMatrix<f64>,
    b: DMatrix<f64>,
    w: DMatrix<f64>,
    period_s: f64,
    phi: DMatrix<f64>,
    gamma: DMatrix<f64>,
    gramian: DMatrix<f64>,
}

fn table() -> Vec<Case> {
    let table: serde_json::Value = serde_json::from_str(include_str!("../../reference/stiff.json")).unwrap();
    let cases = table["cases"].as_array().unwrap().iter().map(|case| {
        let matrix = |key: &str| {
            let rows = case[key].as_array().unwrap();
            let entry = |i: usize, j: usize| rows[i][j].as_f64().unwrap();
            DMatrix::from_fn(rows.len(), rows[0].as_array().unwrap().len(), entry)
        };
        let w = case["w"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect::<Vec<_>>();
        Case {
            name: case["name"].as_str().unwrap().into(),
            a: matrix("a"),
            b: matrix("b"),
            w: DMatrix::from_diagonal(&w.into()),
            period_s: case["period_s"].as_f64().unwrap(),
            phi: matrix("phi"),
            gamma: matrix("gamma"),
            gramian: matrix("gramian"),
        }
    });
    cases.collect()
}

/// In units in which rows and columns of `a` are of one size.
fn units(a: &DMatrix<f64>) -> Vec<f64> {
    balancing_exponents(a).iter().map(|e| f64::powi(2.0, *e)).collect()
}

/// Largest difference of two transitions in such units, as a share of the largest entry or of one.
fn apart(a: &DMatrix<f64>, found: &DMatrix<f64>, wanted: &DMatrix<f64>) -> f64 {
    let d = units(a);
    let scaled = |m: &DMatrix<f64>| DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)] * d[j] / d[i]);
    (scaled(found) - scaled(wanted)).amax() / scaled(wanted).amax().max(1.0)
}

/// The same for what inputs do, as a share of the largest entry.
fn input_apart(a: &DMatrix<f64>, found: &DMatrix<f64>, wanted: &DMatrix<f64>) -> f64 {
    let d = units(a);
    let scaled = |m: &DMatrix<f64>| DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)] / d[i]);
    (scaled(found) - scaled(wanted)).amax() / scaled(wanted).amax()
}

/// Largest difference of two covariances, as a share of the two standard deviations an entry belongs to.
fn covariance_apart(found: &DMatrix<f64>, wanted: &DMatrix<f64>) -> f64 {
    let n = wanted.nrows();
    let share = |i: usize, j: usize| {
        (found[(i, j)] - wanted[(i, j)]).abs() / (wanted[(i, i)] * wanted[(j, j)]).sqrt()
    };
    (0..n * n).map(|k| share(k / n, k % n)).fold(0.0, |worst: f64, e| if e <= worst { worst } else { e })
}

#[test]
fn a_period_is_that_of_multiple_precision() {
    let (mut worst, cases) = ([0f64; 3], table());
    assert!(cases.len() > 80);
    for case in &cases {
        let (phi, gamma) = discretise(&case.a, &case.b, case.period_s).unwrap();
        let gramian = finite_horizon_gramian(&case.a, &case.w, case.period_s).unwrap();
        let errors = [
            apart(&case.a, &phi, &case.phi),
            input_apart(&case.a, &gamma, &case.gamma),
            covariance_apart(&gramian, &case.gramian),
        ];
        for (worst, error) in worst.iter_mut().zip(errors) {
            assert!(error < 3e-15, "{}: transition, input and noise are off by {errors:?}", case.name);
            *worst = worst.max(error);
        }
    }
    println!("{} cases; transition, input and noise within {worst:?}", cases.len());
}

/// A vehicle file of dx/dt = A x + B u with ideal sensors of all states.
fn vehicle(a: &DMatrix<f64>, b: &DMatrix<f64>) -> Vehicle {
    let rows = |m: &DMatrix<f64>| {
        let row = |i: usize| format!("{:?}", m.row(i).iter().collect::<Vec<_>>());
        (0..m.nrows()).map(row).collect::<Vec<_>>().join(", ")
    };
    let names = (1..=a.nrows()).map(|i| format!("{{ name = \"x{i}\" }}")).collect::<Vec<_>>().join(", ");
    let text = format!(
        "A = [{}]\nB = [{}]\nstates = [{names}]\ninputs = [{{ name = \"u\" }}]\n[[outputs]]\nname = \"x1\"\n",
        rows(a),
        rows(b)
    );
    Vehicle::parse(&text, "stiff.toml").unwrap()
}

#[test]
fn the_simulator_flies_what_the_table_says() {
    for case in table() {
        let n = case.a.nrows();
        let mut simulator = Simulator::new(&vehicle(&case.a, &case.b), case.period_s, 1).unwrap();
        let mut after = |state: &[f64], u: f64| {
            simulator.set_state(state);
            simulator.step(&[u]);
            DMatrix::from_column_slice(n, 1, simulator.state())
        };
        let gamma = after(&vec![0.0; n], 1.0);
        assert!(input_apart(&case.a, &gamma, &case.gamma) < 3e-15, "{}", case.name);
        let mut phi = DMatrix::zeros(n, n);
        for j in 0..n {
            let state: Vec<f64> = (0..n).map(|i| f64::from(u8::from(i == j))).collect();
            phi.set_column(j, &after(&state, 0.0).column(0));
        }
        assert!(apart(&case.a, &phi, &case.phi) < 3e-15, "{}", case.name);
    }
}

/// Stable plants of one to five states: blocks with real poles or pairs between 1e-6 and 1e6 1/s, each driving the next,
/// and periods from 1 s to 50 us.
fn plants() -> impl Strategy<Value = (DMatrix<f64>, f64)> {
    let blocks = prop::collection::vec((-6.0f64..6.0, 0.05f64..1.0, any::<bool>(), -1.0f64..1.0), 1..4);
    (blocks, -4.3f64..0.0).prop_map(|(blocks, period)| {
        let n = blocks.iter().map(|b| 1 + usize::from(b.2)).sum::<usize>();
        let mut a = DMatrix::zeros(n, n);
        let mut i = 0;
        for (exponent, damping, pair, coupling) in blocks {
            let w = 10f64.powf(exponent);
            let last = if pair {
                a[(i, i + 1)] = 1.0;
                (a[(i + 1, i)], a[(i + 1, i + 1)]) = (-w * w, -2.0 * damping * w);
                i + 1
            } else {
                a[(i, i)] = -w;
                i
            };
            if i > 0 {
                a[(last, i - 1)] = coupling * w;
            }
            i = last + 1;
        }
        (a, 10f64.powf(period))
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, ..ProptestConfig::default() })]

    /// Two halves of a period, one after the other, are the whole.
    #[test]
    fn halves_make_the_whole((a, period_s) in plants()) {
        let n = a.nrows();
        let (b, w) = (DMatrix::from_element(n, 1, 0.5), DMatrix::identity(n, n));
        let (phi, gamma) = discretise(&a, &b, period_s).unwrap();
        let gramian = finite_horizon_gramian(&a, &w, period_s).unwrap();
        let (half, half_gamma) = discretise(&a, &b, 0.5 * period_s).unwrap();
        let half_gramian = finite_horizon_gramian(&a, &w, 0.5 * period_s).unwrap();
        // What one state moves another by grows with their ratio, and rounding with it.
        let d = units(&a);
        let balanced = DMatrix::from_fn(n, n, |i, j| half[(i, j)] * d[j] / d[i]);
        let size = balanced.amax().max(1.0).powi(2);
        prop_assert!(apart(&a, &(&half * &half), &phi) < 1e-13 * size);
        prop_assert!(input_apart(&a, &(&half * &half_gamma + &half_gamma), &gamma) < 1e-12 * size);
        let added = &half * &half_gramian * half.transpose() + &half_gramian;
        prop_assert!(covariance_apart(&added, &gramian) < 1e-12 * size);
    }

    /// A covariance has no negative variance, and no correlation beyond one.
    #[test]
    fn noise_gathers_to_a_covariance((a, period_s) in plants(), densities in prop::collection::vec(0.0f64..1.0, 6)) {
        let n = a.nrows();
        let w = DMatrix::from_fn(n, n, |i, j| if i == j { densities[i] } else { 0.0 });
        let q = finite_horizon_gramian(&a, &w, period_s).unwrap();
        prop_assert_eq!(q.transpose(), q.clone());
        for i in 0..n {
            prop_assert!(q[(i, i)] >= 0.0, "{}", q);
            for j in 0..n {
                prop_assert!(q[(i, j)].abs() <= (1.0 + 1e-12) * (q[(i, i)] * q[(j, j)]).sqrt(), "{}", q);
            }
        }
    }

    /// In the long run a stable plant holds A W + W A' + w = 0.
    #[test]
    fn a_long_period_ends_at_the_lyapunov_equation(poles in prop::collection::vec(0.0f64..6.0, 1..5)) {
        let n = poles.len();
        let a = DMatrix::from_fn(n, n, |i, j| match () {
            () if i == j => -10f64.powf(poles[i]),
            () if j + 1 == i => 10f64.powf(poles[i]),
            () => 0.0,
        });
        let w = DMatrix::identity(n, n);
        let q = finite_horizon_gramian(&a, &w, 60.0).unwrap();
        let x = whirlstand_linalg::solve_lyapunov(&a.transpose(), &w).unwrap();
        prop_assert!(covariance_apart(&q, &x) < 1e-9, "{} {}", q, x);
    }
}
