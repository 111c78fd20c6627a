//! Kinematic rows of a model, which are definitions: an angle is the integral of its rate, a position that of
//! its speed.

use nalgebra::DMatrix;

use crate::effects::Matrix;
use crate::free::Target;
use crate::model::Vehicle;

/// The state j and coefficient c for which state `i` of x' = A x + B u is the integral of c times state j:
/// `(j, c)`. `None` for a row with another entry, such as one with a force. A is n x n, B n x m.
pub fn kinematic_row(a: &DMatrix<f64>, b: &DMatrix<f64>, i: usize) -> Option<(usize, f64)> {
    let row = a.row(i);
    let mut others = (0..row.ncols()).filter(|j| row[*j] != 0.0);
    match (others.next(), others.next()) {
        (Some(j), None) if j != i && b.row(i).iter().all(|v| *v == 0.0) => Some((j, row[j])),
        _ => None,
    }
}

impl Vehicle {
    /// The state j and coefficient c, SI, for which state `i` is the integral of c times state j by
    /// definition: `(j, c)`.
    ///
    /// Such a row of A (roll' = roll_rate) holds whatever the forces are: it has no process noise, no
    /// parameter to fit and no cause to find. `None` for a row that models forces, or with a free entry.
    pub fn kinematic_row(&self, i: usize) -> Option<(usize, f64)> {
        let entry =
            |target: &Target| matches!(target, Target::Entry(Matrix::A | Matrix::B, row, _) if *row == i);
        if self.free.iter().any(|f| entry(&f.target)) {
            return None;
        }
        kinematic_row(&self.a, &self.b, i)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::free::Free;

    #[test]
    fn angles_and_positions_are_kinematic_and_forces_are_not() {
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        let index = |vehicle: &Vehicle, name: &str| vehicle.state_index(name).unwrap();
        let (roll, rate) = (index(&vehicle, "roll"), index(&vehicle, "roll_rate"));
        assert_eq!(vehicle.kinematic_row(roll), Some((rate, 1.0)));
        assert_eq!(vehicle.kinematic_row(rate), None);
        let target = Target::Entry(Matrix::A, roll, rate);
        vehicle.free.push(Free { target, lower: 0.0, upper: 2.0, start: None });
        assert_eq!(vehicle.kinematic_row(roll), None);
    }

    #[test]
    fn a_lag_of_its_own_and_a_driven_row_are_models() {
        let a = DMatrix::from_row_slice(3, 3, &[-2.0, 0.0, 0.0, 3.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        let b = DMatrix::from_row_slice(3, 1, &[0.0, 0.0, 1.0]);
        assert_eq!([0, 1, 2].map(|i| kinematic_row(&a, &b, i)), [None, Some((0, 3.0)), None]);
        assert_eq!(kinematic_row(&DMatrix::zeros(1, 1), &DMatrix::zeros(1, 1), 0), None);
    }
}
