//! Cache of recent discretisations. A search creates simulators of the same vehicle repeatedly, and changes a
//! size or a time that the matrices of a step do not depend on: their exponentials were a sixth of its time.

use std::cell::RefCell;

use nalgebra::DMatrix;

use super::kernel::Kernel;
use crate::discretise::{DiscretiseError, discretise};

/// Cached steps per thread: those of every entry of a vehicle of eight states and two inputs, and of a dozen
/// effects with their halves.
const REMEMBERED: usize = 128;

struct Known {
    a: DMatrix<f64>,
    inputs: DMatrix<f64>,
    length_s: f64,
    kernel: Kernel,
}

thread_local! {
    /// Most recently used first.
    static KNOWN: RefCell<Vec<Known>> = const { RefCell::new(Vec::new()) };
}

/// The discretisation of dx/dt = A x + B v over a length, v held.
///
/// # Errors
/// As [`discretise`].
pub fn kernel(a: &DMatrix<f64>, inputs: &DMatrix<f64>, length_s: f64) -> Result<Kernel, DiscretiseError> {
    KNOWN.with_borrow_mut(|known| {
        let same = |k: &Known| k.length_s == length_s && k.a == *a && k.inputs == *inputs;
        if let Some(at) = known.iter().position(same) {
            known[..=at].rotate_right(1);
        } else {
            let (phi, gamma) = discretise(a, inputs, length_s)?;
            let kernel = Kernel::new(&phi, &gamma);
            known.truncate(REMEMBERED - 1);
            known.insert(0, Known { a: a.clone(), inputs: inputs.clone(), length_s, kernel });
        }
        Ok(known[0].kernel.clone())
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
                let (phi, gamma) = discretise(&plant(i), &inputs, length_s).unwrap();
                let solved = format!("{:?}", Kernel::new(&phi, &gamma));
                for _ in 0..2 {
                    assert_eq!(format!("{:?}", kernel(&plant(i), &inputs, length_s).unwrap()), solved);
                }
            }
        }
        KNOWN.with_borrow(|known| assert_eq!(known.len(), REMEMBERED));
    }

    #[test]
    fn what_has_no_step_is_not_remembered() {
        let one = DMatrix::from_element(1, 1, 1.0);
        for _ in 0..2 {
            assert!(kernel(&DMatrix::from_element(1, 1, f64::NAN), &one, 0.01).is_err());
            assert!(kernel(&one, &one, 0.01).is_ok());
        }
    }
}
