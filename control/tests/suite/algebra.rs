//! What holds for any system: Schur forms, Riccati and Lyapunov equations, placed poles, limits.

use nalgebra::DMatrix;
use proptest::prelude::*;
use whirlstand_control::place::place;
use whirlstand_control::riccati::{RiccatiError, care, care_residual, dare, dare_residual};
use whirlstand_control::smc::{Shaping, Surface};
use whirlstand_control::{
    Controller, Design, Estimator, EstimatorOptions, InputLimits, LawOptions, LqrOptions, PpcOptions,
    SampledPlant, Selector, Sensors, SmcOptions,
};
use whirlstand_linalg::{
    C64, GeneralizedSchur, Schur, complex, eigenvalues, solve_lyapunov, solve_stein, symmetric_eigen,
};

use crate::support::{self, SplitMix, distance};

/// n states, m inputs and the numbers to fill matrices with.
fn sizes() -> impl Strategy<Value = (usize, usize, SplitMix)> {
    (1usize..9, 1usize..4, any::<u64>()).prop_map(|(n, m, seed)| (n, m.min(n), SplitMix(seed)))
}

fn is_unitary(q: &DMatrix<C64>) -> bool {
    (q * q.adjoint() - DMatrix::<C64>::identity(q.nrows(), q.nrows())).norm() < 1e-13 * q.nrows() as f64
}

fn is_upper(s: &DMatrix<C64>) -> bool {
    (0..s.ncols()).all(|j| (j + 1..s.nrows()).all(|i| s[(i, j)].norm() == 0.0))
}

/// A spread of magnitudes, as states in rad and m and inputs in counts have.
fn scaled(g: &mut SplitMix, rows: usize, columns: usize) -> DMatrix<f64> {
    let mut m = g.matrix(rows, columns);
    m.iter_mut().for_each(|v| *v *= 10f64.powf(g.uniform()));
    m
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, ..ProptestConfig::default() })]

    #[test]
    fn schur_forms_are_similar_to_their_matrices((n, _, mut g) in sizes()) {
        let (a, b) = (complex(&scaled(&mut g, n, n)), complex(&g.matrix(n, n)));
        let schur = Schur::new(&a).expect("converges");
        prop_assert!(is_unitary(&schur.u));
        prop_assert!((&schur.u * &schur.s * schur.u.adjoint() - &a).norm() <= 1e-13 * n as f64 * a.norm());
        let mut pencil = GeneralizedSchur::new(&a, &b).expect("converges");
        let mut before: Vec<C64> = (0..n).map(|k| pencil.s[(k, k)] / pencil.t[(k, k)]).collect();
        let chosen: Vec<bool> = before.iter().map(|l| l.re < 0.0).collect();
        let wanted = chosen.iter().filter(|c| **c).count();
        pencil.reorder(&chosen);
        prop_assert!(is_unitary(&pencil.q) && is_unitary(&pencil.z));
        prop_assert!(is_upper(&pencil.s) && is_upper(&pencil.t));
        prop_assert!((&pencil.q * &pencil.s * pencil.z.adjoint() - &a).norm() <= 1e-12 * a.norm());
        prop_assert!((&pencil.q * &pencil.t * pencil.z.adjoint() - &b).norm() <= 1e-12 * b.norm());
        // The same eigenvalues, those chosen first.
        let after: Vec<C64> = (0..n).map(|k| pencil.s[(k, k)] / pencil.t[(k, k)]).collect();
        let margin = before.iter().map(|l| l.re.abs()).fold(f64::INFINITY, f64::min);
        if margin > 1e-6 && before.iter().all(|l| l.norm() < 1e3) {
            prop_assert!(after[..wanted].iter().all(|l| l.re < 0.0) && after[wanted..].iter().all(|l| l.re > 0.0));
        }
        before.sort_by(|x, y| x.re.total_cmp(&y.re));
        let product = |v: &[C64]| v.iter().map(|l| l.norm().ln()).sum::<f64>();
        prop_assert!((product(&before) - product(&after)).abs() < 1e-6);
    }

    #[test]
    fn riccati_solutions_are_symmetric_semidefinite_and_stabilise((n, m, mut g) in sizes()) {
        let (a, b) = (scaled(&mut g, n, n), g.matrix(n, m));
        let (c, d) = (g.matrix(n, n), g.matrix(m, m));
        let (q, r) = (c.transpose() * &c, DMatrix::identity(m, m) + d.transpose() * &d);
        for discrete in [false, true] {
            let solution = if discrete { dare(&a, &b, &q, &r, None) } else { care(&a, &b, &q, &r, None) };
            // A random pair may come as near to an uncontrollable one as it likes; then the answer is a refusal.
            let solution = match solution {
                Err(RiccatiError::NoStabilisingSolution { .. } | RiccatiError::Eigenvalues(_)) => continue,
                other => other.expect("well-formed"),
            };
            let x = &solution.x;
            prop_assert_eq!(x.transpose(), x.clone());
            let least = symmetric_eigen(x.clone()).expect("finite").0.min();
            prop_assert!(least >= -1e-9 * x.norm(), "least eigenvalue {least}");
            // As small as rounding lets it be for an X of this size.
            let residual = if discrete {
                dare_residual(&a, &b, &q, &r, None, x)
            } else {
                care_residual(&a, &b, &q, &r, None, x)
            };
            prop_assert_eq!(residual, solution.relative_residual);
            let sensitive = x.norm() * b.norm_squared() + a.norm_squared();
            prop_assert!(residual <= 1e-10 * (1e-3 * sensitive).max(1.0), "{residual:e}, X {:e}", x.norm());
            let stable = |p: &C64| if discrete { p.norm() < 1.0 } else { p.re < 0.0 };
            prop_assert!(solution.poles.iter().all(stable));
        }
    }

    #[test]
    fn lyapunov_and_stein_equations_are_solved((n, _, mut g) in sizes()) {
        let (a, c) = (g.matrix(n, n), g.matrix(n, n));
        let q = &c * c.transpose();
        let stable = &a - DMatrix::identity(n, n) * (1.0 + a.norm());
        let x = solve_lyapunov(&stable, &q).expect("solvable");
        prop_assert!((stable.transpose() * &x + &x * &stable + &q).norm() <= 1e-12 * (q.norm() + x.norm() * stable.norm()));
        let small = &a * (0.9 / a.norm().max(1e-3));
        let x = solve_stein(&small, &q).expect("solvable");
        prop_assert!((small.transpose() * &x * &small - &x + &q).norm() <= 1e-12 * (q.norm() + x.norm()));
    }

    #[test]
    fn placed_poles_are_those_asked_for((n, m, mut g) in sizes(), pairs in any::<bool>()) {
        let (a, b) = (g.matrix(n, n), g.matrix(n, m));
        let mut wanted: Vec<C64> = Vec::new();
        while wanted.len() < n {
            let re = -1.0 - 0.4 * wanted.len() as f64 + 0.1 * g.uniform();
            if pairs && wanted.len() + 2 <= n {
                let im = 1.0 + g.uniform();
                wanted.extend([C64::new(re, im), C64::new(re, -im)]);
            } else {
                wanted.push(C64::new(re, 0.0));
            }
        }
        let Ok(placed) = place(&a, &b, &wanted) else { return Ok(()) };
        // What rounding of A - B K alone moves them by (Bauer and Fike).
        let rounding = f64::EPSILON * placed.condition * (a.norm() + b.norm() * placed.gain.norm());
        let error = distance(&placed.poles, &wanted);
        prop_assert!(error <= 1e-9 + 100.0 * rounding, "{error:e}, rounding {rounding:e}");
        prop_assert_eq!(distance(&eigenvalues(&(&a - &b * &placed.gain)).expect("converges"), &placed.poles), 0.0);
    }

    #[test]
    fn sliding_surfaces_act_as_integrators_of_their_inputs((n, m, mut g) in sizes()) {
        prop_assume!(n > m);
        let dt = 0.01;
        let phi = DMatrix::identity(n, n) + g.matrix(n, n) * dt;
        let gamma = g.matrix(n, m) * dt;
        let Ok(surface) = Surface::design(&phi, &gamma, dt, &Shaping::Cost(DMatrix::identity(n, n))) else {
            return Ok(());
        };
        let size = surface.c.norm();
        prop_assert!((&surface.c * &gamma - DMatrix::identity(m, m) * dt).norm() <= 1e-12 * size);
        let kept = &surface.c * (&phi - &gamma * &surface.equivalent) - &surface.c;
        prop_assert!(kept.norm() <= 1e-10 * size);
        prop_assert!(surface.poles.iter().all(|p| p.norm() < 1.0));
    }
}

/// Any number that a double can hold, often a plausible one.
fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![4 => -1.0f64..1.0, 1 => any::<f64>(), 1 => Just(f64::NAN), 1 => Just(f64::INFINITY)]
}

fn laws() -> Vec<LawOptions> {
    let integral = || vec![Selector::Name("roll".into()), Selector::Name("pitch".into())];
    vec![
        LawOptions::Lqr(LqrOptions { integral: integral(), ..LqrOptions::default() }),
        LawOptions::Ppc(PpcOptions { integral: integral(), ..PpcOptions::default() }),
        LawOptions::Smc(SmcOptions { integral: integral(), ..SmcOptions::default() }),
        LawOptions::Smc(SmcOptions { super_twisting: true, ..SmcOptions::default() }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn commands_stay_within_limits_and_rates_whatever_comes(
        law in 0usize..4,
        reach in (0.1f64..30.0, 0.1f64..30.0, 1.0f64..500.0),
        steps in prop::collection::vec(
            (prop::collection::vec(any_number(), 3..6), prop::collection::vec(any_number(), 3..6), any::<u64>()), 1..60),
    ) {
        let (lower, upper, rate) = (-reach.0, reach.1, reach.2);
        let plant = support::plant("quadrotor")
            .with_limits(vec![InputLimits { lower, upper, rate }; 2]).expect("sound");
        let design = Design::new(&plant, &laws()[law]).expect("controllable");
        let mut controller = Controller::new(&design);
        let mut before = [0.0; 2];
        for (estimate, reference, tracked) in steps {
            let mut u = [f64::NAN; 2];
            let outcome = controller.step(&estimate, &reference, tracked, &mut u);
            for (u, before) in u.iter().zip(before) {
                prop_assert!(*u >= lower && *u <= upper, "{u}");
                // Neutral after a few refused estimates is a failsafe, which no rate limits.
                let moved = (u - before).abs() <= rate * plant.period_s() * (1.0 + 1e-12);
                prop_assert!(moved || outcome.estimate_refused, "{before} to {u}");
            }
            prop_assert_eq!(outcome.estimate_refused, estimate.len() != 4 || outcome.estimate_refused);
            before = u;
        }
    }

    #[test]
    fn estimates_stay_finite_whatever_is_measured(
        steps in prop::collection::vec((prop::collection::vec(any_number(), 3..6), any::<u64>()), 1..80),
    ) {
        let plant = support::plant("quadrotor");
        let sensors = Sensors {
            c: DMatrix::identity(4, 4),
            d: DMatrix::zeros(4, 2),
            std: vec![1e-3; 4],
            names: plant.state_names().to_vec(),
        };
        let mut estimator = Estimator::new(&plant, &sensors, &EstimatorOptions::default()).expect("observable");
        for (y, valid) in steps {
            let y: Vec<f64> = y.iter().map(|v| if v.abs() > 1e100 { f64::NAN } else { *v }).collect();
            estimator.step(&y, valid, &[0.0; 2], &[0.0; 2]);
            prop_assert!(estimator.x().iter().chain(estimator.std()).all(|v| v.is_finite()));
            let wrong = y.len() < 4;
            prop_assert!(estimator.dof() <= 4 && (!wrong || estimator.dof() == 0));
        }
    }
}

#[test]
fn matrices_that_do_not_fit_are_refused_by_name() {
    let one = DMatrix::<f64>::identity(2, 2);
    let b = DMatrix::from_row_slice(2, 1, &[0.0, 1.0]);
    let r = DMatrix::from_element(1, 1, 1.0);
    let nan = DMatrix::from_element(2, 2, f64::NAN);
    let skew = DMatrix::from_row_slice(2, 2, &[1.0, 0.5, 0.0, 1.0]);
    for solve in [care, dare] {
        for (result, wanted) in [
            (solve(&one, &r, &one, &r, None), "B is 1 x 1, but 2 x 1 is needed"),
            (solve(&one, &b, &r, &r, None), "Q is 1 x 1, but 2 x 2 is needed"),
            (solve(&one, &b, &one, &one, None), "R is 2 x 2, but 1 x 1 is needed"),
            (solve(&one, &b, &one, &r, Some(&one)), "S is 2 x 2, but 2 x 1 is needed"),
            (solve(&nan, &b, &one, &r, None), "A has an entry that is not finite"),
            (solve(&one, &b, &skew, &r, None), "Q is not symmetric"),
            (solve(&(&one * 2.0), &b, &one, &r, None), "uncontrollable mode"),
        ] {
            let message = result.expect_err("refused").to_string();
            assert!(message.contains(wanted), "{message:?} does not say {wanted:?}");
        }
    }
    let zero = DMatrix::zeros(1, 1);
    assert_eq!(care(&one, &b, &one, &zero, None).expect_err("R = 0"), RiccatiError::SingularInputWeight);
    // An integrator that the weight does not see stays on the boundary.
    let (a, q) = (DMatrix::zeros(1, 1), DMatrix::zeros(1, 1));
    for (message, size) in
        [(care(&a, &r, &q, &r, None), "real part"), (dare(&r, &r, &q, &r, None), "magnitude")]
    {
        let message = message.expect_err("nothing to stabilise it for").to_string();
        assert!(message.contains(size) && message.contains("does not see a mode"), "{message}");
    }
    let pole = |re: f64| C64::new(re, 0.0);
    let stuck = DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 0.0, 3.0]);
    for (result, wanted) in [
        (place(&one, &b, &[pole(-1.0)]), "1 poles are asked for, but the plant has 2 states"),
        (place(&one, &r, &[pole(-1.0); 2]), "A has to be n x n"),
        (place(&nan, &b, &[pole(-1.0); 2]), "all finite"),
        (place(&stuck, &b, &[pole(-1.0), pole(-2.0)]), "the mode 1+0i is not controllable"),
    ] {
        let message = result.expect_err("refused").to_string();
        assert!(message.contains(wanted), "{message:?} does not say {wanted:?}");
    }
    for (plant, wanted) in [
        (SampledPlant::new(one.clone(), r.clone(), 0.01), "B has 1 rows, but 2 are needed"),
        (SampledPlant::new(b.clone(), b.clone(), 0.01), "A has 1 columns, but 2 are needed"),
        (SampledPlant::new(nan, b.clone(), 0.01), "A[1,1] is not finite"),
        (SampledPlant::new(one.clone(), b.clone(), 0.0), "the period is 0 s"),
        (SampledPlant::new(&one * 1e6, b.clone(), 1.0), "overflows"),
        (
            SampledPlant::new(one.clone(), b, 0.01).and_then(|p| p.with_scales(vec![1.0, -1.0])),
            "the scale of state x2",
        ),
    ] {
        let message = plant.expect_err("refused").to_string();
        assert!(message.contains(wanted), "{message:?} does not say {wanted:?}");
    }
}
