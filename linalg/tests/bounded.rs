//! Every decomposition ends, for matrices at which unbounded iterations stall too, and what it gives makes the matrix again.

use std::time::{Duration, Instant};

use nalgebra::DMatrix;
use proptest::prelude::*;
use whirlstand_linalg::{
    C64, DecompositionError, GeneralizedSchur, Schur, Svd, complex, eigenvalues, pseudo_inverse,
    singular_values, symmetric_eigen,
};

/// 0/1, each row to the next: all shifts of a plain QR iteration are zero.
fn cyclic(n: usize) -> DMatrix<f64> {
    DMatrix::from_fn(n, n, |i, j| f64::from(u8::from(j == (i + 1) % n)))
}

fn jordan(n: usize, value: f64) -> DMatrix<f64> {
    DMatrix::from_fn(n, n, |i, j| if i == j { value } else { f64::from(u8::from(j == i + 1)) })
}

/// Of the polynomial with these coefficients, the highest of one left out.
fn companion(coefficients: &[f64]) -> DMatrix<f64> {
    let n = coefficients.len();
    DMatrix::from_fn(n, n, |i, j| if i + 1 == n { -coefficients[j] } else { f64::from(u8::from(j == i + 1)) })
}

/// What has stalled iterations or is at an edge of what numbers can hold.
fn difficult() -> Vec<(String, DMatrix<f64>)> {
    let mut all = Vec::new();
    for n in [1, 2, 3, 4, 6, 9, 16, 33, 64] {
        all.push((format!("cyclic {n}"), cyclic(n)));
        all.push((format!("zero {n}"), DMatrix::zeros(n, n)));
        all.push((format!("identity {n}"), DMatrix::identity(n, n)));
        all.push((format!("ones {n}"), DMatrix::from_element(n, n, 1.0)));
    }
    for value in [0.0, -1.0, 2.5, 1e-300] {
        all.extend([2, 4, 6, 12].map(|n| (format!("Jordan {n} {value}"), jordan(n, value))));
    }
    // Pairs repeated, in a real Jordan form.
    let pair = |i: usize, j: usize| match (i / 2 == j / 2, i % 2 == j % 2) {
        (true, true) => -0.5,
        (true, false) => {
            if i < j {
                3.0
            } else {
                -3.0
            }
        }
        (false, same) => f64::from(u8::from(same && j == i + 2)),
    };
    all.push(("repeated pairs".into(), DMatrix::from_fn(4, 4, pair)));
    all.push(("Wilkinson's polynomial".into(), {
        let mut p = vec![1.0];
        for root in 1..=12 {
            let mut next = vec![0.0; p.len() + 1];
            for (k, c) in p.iter().enumerate() {
                next[k + 1] += c;
                next[k] -= c * f64::from(root);
            }
            p = next;
        }
        p.pop();
        companion(&p)
    }));
    all.push(("companion of z^8 - 1".into(), companion(&[-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])));
    all.push(("companion of large coefficients".into(), companion(&[1e300, -1e250, 1e200, 1e100])));
    for size in [1e300, 1e154, 1e-160, 1e-300] {
        all.push((format!("cyclic of {size:e}"), cyclic(6) * size));
        all.push((
            format!("dense of {size:e}"),
            DMatrix::from_fn(5, 5, |i, j| size * ((3 * i + 5 * j + 1) as f64).sin()),
        ));
    }
    let graded = DMatrix::from_fn(6, 6, |i, j| 10f64.powi(50 * (i as i32 - j as i32)));
    all.push(("graded from 1e-250 to 1e250".into(), graded));
    all
}

/// What a decomposition says, or nothing when it refuses; and that within a second.
fn within_a_second<T>(name: &str, f: impl FnOnce() -> Result<T, DecompositionError>) -> Option<T> {
    let begun = Instant::now();
    let found = f();
    assert!(begun.elapsed() < Duration::from_secs(1), "{name}: {:?}", begun.elapsed());
    found.ok()
}

/// Largest difference of two matrices as a share of the largest entry of the second, without overflow.
fn apart(found: &DMatrix<C64>, wanted: &DMatrix<C64>) -> f64 {
    let size = |m: &DMatrix<C64>| m.iter().map(|v| v.re.abs().max(v.im.abs())).fold(0.0, f64::max);
    let largest = size(wanted);
    if largest == 0.0 {
        size(found)
    } else {
        size(&(found / C64::new(largest, 0.0) - wanted / C64::new(largest, 0.0)))
    }
}

#[test]
fn what_stalls_others_ends_here() {
    let mut refused = Vec::new();
    for (name, a) in difficult() {
        let n = a.nrows();
        match within_a_second(&name, || eigenvalues(&a)) {
            Some(values) => {
                assert!(values.len() == n && values.iter().all(|v| v.norm().is_finite()), "{name}")
            }
            None => refused.push(format!("eigenvalues of {name}")),
        }
        match within_a_second(&name, || Schur::new(&complex(&a))) {
            Some(s) => {
                assert!(apart(&(&s.u * &s.s * s.u.adjoint()), &complex(&a)) < 1e-13 * n as f64, "{name}")
            }
            None => refused.push(format!("Schur form of {name}")),
        }
        match within_a_second(&name, || Svd::new(&a)) {
            Some(s) => {
                let again = &s.u * DMatrix::from_diagonal(&s.values) * &s.v_t;
                assert!(apart(&complex(&again), &complex(&a)) < 1e-13 * n as f64, "{name}");
                assert!(s.values.as_slice().is_sorted_by(|x, y| x >= y), "{name}");
                assert_eq!(singular_values(&a).unwrap().len(), n);
            }
            None => refused.push(format!("singular values of {name}")),
        }
        let symmetric = &a * 0.5 + a.transpose() * 0.5;
        match within_a_second(&name, || symmetric_eigen(symmetric.clone())) {
            Some((values, vectors)) => {
                let again = &vectors * DMatrix::from_diagonal(&values) * vectors.transpose();
                assert!(apart(&complex(&again), &complex(&symmetric)) < 1e-13 * n as f64, "{name}");
            }
            None => refused.push(format!("eigenvalues of the symmetric part of {name}")),
        }
    }
    // These differ by hundreds of powers of ten within one matrix.
    println!("refused: {refused:#?}");
    refused.retain(|what| !what.ends_with("large coefficients") && !what.contains("graded"));
    assert!(refused.is_empty(), "{refused:#?}");
}

#[test]
fn eigenvalues_are_the_roots() {
    let unit = eigenvalues(&cyclic(6)).unwrap();
    assert!(unit.iter().all(|v| (v.norm() - 1.0).abs() < 1e-14));
    let far = eigenvalues(&(cyclic(6) * 1e300)).unwrap();
    assert!(far.iter().all(|v| (v.norm() / 1e300 - 1.0).abs() < 1e-14));
    // A Jordan block scatters by the root of the rounding, about its value.
    for n in [2, 4, 6] {
        let reach = 10.0 * f64::EPSILON.powf(1.0 / n as f64);
        assert!(eigenvalues(&jordan(n, -1.0)).unwrap().iter().all(|v| (v + 1.0).norm() < reach), "{n}");
    }
}

#[test]
fn what_is_not_finite_or_empty_is_told() {
    for wrong in [f64::NAN, f64::INFINITY] {
        let a = DMatrix::from_element(3, 3, wrong);
        assert_eq!(eigenvalues(&a), Err(DecompositionError::NotFinite));
        assert_eq!(singular_values(&a), Err(DecompositionError::NotFinite));
        assert_eq!(symmetric_eigen(a.clone()).unwrap_err(), DecompositionError::NotFinite);
        assert_eq!(
            GeneralizedSchur::new(&complex(&a), &complex(&a)).unwrap_err(),
            DecompositionError::NotFinite
        );
    }
    let empty = DMatrix::<f64>::zeros(0, 3);
    assert_eq!(singular_values(&empty).unwrap().len(), 0);
    assert_eq!(pseudo_inverse(&empty, 0.0).unwrap().shape(), (3, 0));
    assert_eq!(eigenvalues(&DMatrix::zeros(0, 0)), Ok(Vec::new()));
    assert_eq!(symmetric_eigen(DMatrix::<f64>::zeros(0, 0)).unwrap().0.len(), 0);
}

/// Matrices with zeros, repeated entries and entries of very different size, which is what stalls an iteration.
fn matrices() -> impl Strategy<Value = DMatrix<f64>> {
    let entry = prop_oneof![
        3 => Just(0.0),
        2 => Just(1.0),
        1 => Just(-1.0),
        3 => -1.0f64..1.0,
        1 => (-12i32..12).prop_map(|e| 10f64.powi(e)),
    ];
    (1usize..9, 1usize..9).prop_flat_map(move |(n, m)| {
        prop::collection::vec(entry.clone(), n * m).prop_map(move |v| DMatrix::from_column_slice(n, m, &v))
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4096, ..ProptestConfig::default() })]

    #[test]
    fn decompositions_make_the_matrix_again(a in matrices()) {
        let svd = Svd::new(&a).unwrap();
        let again = &svd.u * DMatrix::from_diagonal(&svd.values) * &svd.v_t;
        prop_assert!(apart(&complex(&again), &complex(&a)) < 1e-13, "{}", a);
        let k = svd.values.len();
        prop_assert!((svd.u.tr_mul(&svd.u) - DMatrix::identity(k, k)).amax() < 1e-13);
        prop_assert!((&svd.v_t * svd.v_t.transpose() - DMatrix::identity(k, k)).amax() < 1e-13);
        let square = &a * a.transpose();
        let (values, vectors) = symmetric_eigen(square.clone()).unwrap();
        let again = &vectors * DMatrix::from_diagonal(&values) * vectors.transpose();
        prop_assert!(apart(&complex(&again), &complex(&square)) < 1e-13);
        let n = a.nrows().min(a.ncols());
        let a = a.view((0, 0), (n, n)).into_owned();
        let schur = Schur::new(&complex(&a)).unwrap();
        prop_assert!(apart(&(&schur.u * &schur.s * schur.u.adjoint()), &complex(&a)) < 1e-13 * n as f64);
        let sum: C64 = eigenvalues(&a).unwrap().iter().sum();
        // The trace, as near as rounding lets it be told.
        prop_assert!((sum.re - a.trace()).abs() <= 1e-12 * a.norm() && sum.im.abs() <= 1e-12 * a.norm());
    }
}
