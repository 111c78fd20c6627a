//! Cache of recent discretisations. A search creates simulators of the same vehicle repeatedly, and changes a
//! size or a time that the matrices of a step do not depend on: their exponentials were a sixth of its time.

use std::cell::RefCell;
use std::sync::Arc;

use nalgebra::DMatrix;

use super::kernel::Kernel;
use crate::discretise::{DiscretiseError, discretise_halves};

/// Cached steps per thread: those of every entry of a vehicle of eight states and two inputs, and of a dozen
/// effects with their halves.
const REMEMBERED: usize = 128;

struct Known {
    a: DMatrix<f64>,
    inputs: DMatrix<f64>,
    length_s: f64,
    kernels: Arc<[Kernel]>,
}

thread_local! {
    /// Most recently used first.
    static KNOWN: RefCell<Vec<Known>> = const { RefCell::new(Vec::new()) };
}

/// The discretisations of dx/dt = A x + B v, v held, over a length, its half, its quarter and so on, `count` of them.
///
/// # Errors
/// As [`discretise_halves`].
pub fn kernels(
    a: &DMatrix<f64>,
    inputs: &DMatrix<f64>,
    length_s: f64,
    count: usize,
) -> Result<Arc<[Kernel]>, DiscretiseError> {
    KNOWN.with_borrow_mut(|known| {
        let same = |k: &Known| {
            k.length_s == length_s && k.kernels.len() == count && k.a == *a && k.inputs == *inputs
        };
        if let Some(at) = known.iter().position(same) {
            known[..=at].rotate_right(1);
        } else {
            let steps = discretise_halves(a, inputs, length_s, count as u32)?;
            let kernels = steps.iter().map(|(phi, gamma)| Kernel::new(phi, gamma)).collect();
            known.truncate(REMEMBERED - 1);
            known.insert(0, Known { a: a.clone(), inputs: inputs.clone(), length_s, kernels });
        }
        Ok(Arc::clone(&known[0].kernels))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_that_is_known_is_the_one_that_is_solved() {
        let inputs = DMatrix::from_row_slice(2, 1, &[0.0, 1.0]);
        let plant = |i: usize| DMatrix::from_row_slice(2, 2, &[0.0, 1.0, -(i as f64), -0.5]);
        for round in 0..3 {
            for i in 0..REMEMBERED + 5 {
                let length_s = 0.01 * (1 + round) as f64;
                let steps = discretise_halves(&plant(i), &inputs, length_s, 3).unwrap();
                let steps: Vec<Kernel> = steps.iter().map(|(phi, gamma)| Kernel::new(phi, gamma)).collect();
                for _ in 0..2 {
                    let known = kernels(&plant(i), &inputs, length_s, 3).unwrap();
                    assert_eq!(format!("{known:?}"), format!("{steps:?}"));
                }
            }
        }
        KNOWN.with_borrow(|known| assert_eq!(known.len(), REMEMBERED));
    }

    #[test]
    fn what_has_no_step_is_not_remembered() {
        let one = DMatrix::from_element(1, 1, 1.0);
        for _ in 0..2 {
            assert!(kernels(&DMatrix::from_element(1, 1, f64::NAN), &one, 0.01, 2).is_err());
            assert!(kernels(&one, &one, 0.01, 2).is_ok());
        }
    }
}
