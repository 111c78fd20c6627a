//! Tests of the filter's covariance against the plain recursion, the composed map and the Riccati equation.

use nalgebra::DMatrix;
use proptest::prelude::*;

use super::covariance::{Covariance, Gains};
use super::filter::KalmanFilter;
use super::filter_model::FilterModel;
use super::flow::Flow;
use crate::kernel::Packed;
use crate::riccati::dare;

/// The covariance P after one more step by the textbook formulas.
fn plain(model: &FilterModel, p: &DMatrix<f64>, mask: u64) -> DMatrix<f64> {
    let p = &model.f * p * model.f.transpose() + &model.q;
    let rows: Vec<usize> = (0..model.h.nrows()).filter(|i| mask >> i & 1 == 1).collect();
    if rows.is_empty() {
        return p;
    }
    let h = model.h.select_rows(&rows);
    let r =
        DMatrix::from_fn(rows.len(), rows.len(), |i, j| if i == j { model.variance[rows[i]] } else { 0.0 });
    let s = &h * &p * h.transpose() + r;
    let gain = &p * h.transpose() * s.try_inverse().expect("positive");
    let left = DMatrix::identity(p.nrows(), p.nrows()) - gain * h;
    left * p
}

fn distance(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
    (a - b).norm() / b.norm()
}

/// Model of an angle, its rate and the bias of its gyro, at 200 Hz.
fn gyro() -> FilterModel {
    let (dt, walk) = (0.005, 1e-4);
    FilterModel {
        f: DMatrix::from_row_slice(3, 3, &[1.0, dt, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        g: DMatrix::zeros(3, 1),
        h: DMatrix::from_row_slice(2, 3, &[1.0, 0.0, 0.0, 0.0, 1.0, 1.0]),
        d: DMatrix::zeros(2, 1),
        q: DMatrix::from_row_slice(
            3,
            3,
            &[dt * dt * dt / 3.0, dt * dt / 2.0, 0.0, dt * dt / 2.0, dt, 0.0, 0.0, 0.0, walk * walk * dt],
        ),
        variance: vec![1.4e-3 * 1.4e-3, 7e-3 * 7e-3],
    }
}

/// Pattern with angles every third step, rates in every step.
fn divided(k: usize) -> u64 {
    if k.is_multiple_of(3) { 0b11 } else { 0b10 }
}

#[test]
fn kept_gains_stay_close_to_those_of_the_full_recursion() {
    for pattern in [|_| 0b11, divided] {
        let model = gyro();
        let initial = [0.5, 2.0, 0.07];
        let mut filter = KalmanFilter::new(model.clone(), &initial);
        let mut p = DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(&initial.map(|s| s * s)));
        let mut settled = None;
        let mut worst: f64 = 0.0;
        for k in 0..60_000 {
            let mask = pattern(k);
            filter.step(&[0.0; 2], mask, &[0.0], &[0.0]);
            if k == 0 {
                // There is no prediction before the first step.
                let still =
                    FilterModel { f: DMatrix::identity(3, 3), q: DMatrix::zeros(3, 3), ..model.clone() };
                p = plain(&still, &p, mask);
            } else {
                p = plain(&model, &p, mask);
            }
            for i in 0..3 {
                let full = p[(i, i)].sqrt();
                worst = worst.max((filter.std()[i] / full - 1.0).abs());
            }
            if filter.settled() && settled.is_none() {
                settled = Some(k);
            }
        }
        println!("standard deviations within {worst:.4} of the full recursion's; settled at {settled:?}");
        // Stored gains are reused while the variance changes by at most 4 %, the standard deviation by 2 %.
        assert!(worst < 0.025, "{worst}");
        assert!(settled.is_some(), "gains settle in the end");
        assert!(distance(&filter.covariance(), &p) < 1e-5);
    }
}

#[test]
fn the_settled_covariance_solves_the_riccati_equation() {
    let model = gyro();
    let mut filter = KalmanFilter::new(model.clone(), &[0.5, 2.0, 0.07]);
    while !filter.settled() {
        filter.step(&[0.0; 2], 0b11, &[0.0], &[0.0]);
    }
    let r = DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(&model.variance));
    let dual = dare(&model.f.transpose(), &model.h.transpose(), &model.q, &r, None).expect("observable");
    let predicted = &model.f * filter.covariance() * model.f.transpose() + &model.q;
    assert!(distance(&predicted, &dual.x) < 1e-5, "{}", distance(&predicted, &dual.x));
}

#[test]
fn a_broken_pattern_returns_to_the_full_recursion() {
    let mut filter = KalmanFilter::new(gyro(), &[0.5, 2.0, 0.07]);
    for _ in 0..3000 {
        filter.step(&[0.0; 2], 0b11, &[0.0], &[0.0]);
    }
    let before = filter.std()[0];
    for _ in 0..40 {
        filter.step(&[f64::NAN, 0.0], 0b11, &[0.0], &[0.0]);
        assert_eq!(filter.dof(), 1);
    }
    assert!(filter.std()[0] > before, "without its measurement the angle becomes less certain");
    for _ in 0..3000 {
        filter.step(&[0.0; 2], 0b11, &[0.0], &[0.0]);
    }
    assert!(filter.std()[0] <= before * 1.01);
}

/// One plant that is unstable, one that integrates without a sensor, and noises of very different sizes; fresh values in a
/// pattern. The settled covariance is that of a recursion of many steps.
#[test]
fn the_settled_covariance_is_that_of_many_steps() {
    let model = FilterModel {
        f: DMatrix::from_row_slice(3, 3, &[1.02, 0.01, 0.0, 0.0, 1.0, 0.0, 0.01, 0.0, 1.0]),
        g: DMatrix::zeros(3, 1),
        h: DMatrix::from_row_slice(2, 3, &[1.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        d: DMatrix::zeros(2, 1),
        q: DMatrix::from_diagonal(&nalgebra::dvector![1e-3, 1e-6, 1e-12]),
        variance: vec![1e-2, 1e-8],
    };
    for pattern in [vec![0b11], vec![0b01, 0b00, 0b11]] {
        let settled = super::settled_covariance(&model, &pattern).expect("observable");
        let mut p = DMatrix::<f64>::identity(3, 3);
        for k in 0..60_000 {
            p = plain(&model, &p, pattern[k % pattern.len()]);
        }
        let before = &model.f * p * model.f.transpose() + &model.q;
        assert!(distance(&settled, &before) < 1e-6, "{pattern:?}: {settled} {before}");
    }
    // Nothing shows the third state: its variance has no limit, and those of the others are as without it.
    let without = FilterModel {
        f: model.f.view((0, 0), (2, 2)).into(),
        h: model.h.view((0, 0), (1, 2)).into(),
        q: model.q.view((0, 0), (2, 2)).into(),
        g: DMatrix::zeros(2, 1),
        d: DMatrix::zeros(1, 1),
        variance: vec![1e-2],
    };
    let blind = super::settled_covariance(&model, &[0b01]).expect("finite");
    let without = super::settled_covariance(&without, &[0b01]).expect("observable");
    assert!(blind[(2, 2)] > 1.0, "{blind}");
    assert!(distance(&blind.view((0, 0), (2, 2)).into(), &without) < 1e-6, "{blind} {without}");
}

prop_compose! {
    fn models()(n in 1usize..8, p in 1usize..5)(
        n in Just(n),
        p in Just(p),
        f in prop::collection::vec(-1.0f64..1.0, n * n),
        h in prop::collection::vec(-1.0f64..1.0, p * n),
        w in prop::collection::vec(-1.0f64..1.0, n * n),
        variance in prop::collection::vec(1e-3f64..1.0, p),
        masks in prop::collection::vec(0u64..16, 1..5),
    ) -> (FilterModel, Vec<u64>) {
        let square = |v: &[f64]| DMatrix::from_column_slice(n, n, v);
        let w = square(&w);
        let model = FilterModel {
            f: square(&f) * (1.2 / n as f64),
            g: DMatrix::zeros(n, 1),
            h: DMatrix::from_column_slice(p, n, &h),
            d: DMatrix::zeros(p, 1),
            q: &w * w.transpose(),
            variance,
        };
        let all = (1 << p) - 1;
        (model, masks.into_iter().map(|m| m & all).collect())
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, ..ProptestConfig::default() })]

    #[test]
    fn recursion_and_map_are_the_textbooks((model, masks) in models(), doublings in 0usize..4) {
        let n = model.f.nrows();
        let start = DMatrix::<f64>::identity(n, n);
        let mut expected = start.clone();
        let mut covariance = Covariance::new(&model, &start);
        let mut gains = Gains::none(&start, model.h.nrows());
        for _ in 0..1 << doublings {
            for &mask in &masks {
                expected = plain(&model, &expected, mask);
                covariance.predict();
                covariance.update(mask, &mut gains);
            }
        }
        prop_assert!(distance(&covariance.p().to_matrix(n, n), &expected) < 1e-9);
        let mut flow = Flow::new(&model);
        flow.clear();
        masks.iter().for_each(|&mask| flow.append(mask));
        (0..doublings).for_each(|_| flow.double());
        let mut p = Packed::new(&start);
        flow.apply(&mut p);
        prop_assert!(distance(&p.to_matrix(n, n), &expected) < 1e-9);
        // The covariance must be symmetric, without a negative eigenvalue.
        let p = covariance.p().to_matrix(n, n);
        prop_assert_eq!(p.transpose(), p.clone());
        let least = whirlstand_linalg::symmetric_eigen(p.clone()).expect("finite").0.min();
        prop_assert!(least >= -1e-12 * p.norm(), "{}", least);
    }
}
