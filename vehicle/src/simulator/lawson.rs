//! A step of a linear system with smooth forces on its states.
//!
//! The linear part is solved exactly by its exponential, the forces are integrated around it: the integrating-factor
//! Runge-Kutta method of order 4 (Lawson, SIAM J. Numer. Anal. 4, 1967).

use super::kernel::{Kernel, State, Work};

/// A smooth force: it follows from one state and acts on one.
#[derive(Debug, Clone, Copy)]
pub enum Smooth {
    /// Quadratic drag: state, coefficient.
    Drag(usize, f64),
    /// Cubic stiffness: the state that determines it, the state on which it acts, coefficient.
    Cubic(usize, usize, f64),
}

impl Smooth {
    /// The state that determines the force.
    #[inline(always)]
    pub fn from(self) -> usize {
        match self {
            Self::Drag(state, _) | Self::Cubic(state, ..) => state,
        }
    }

    /// The state whose derivative it adds to.
    #[inline(always)]
    pub fn onto(self) -> usize {
        match self {
            Self::Drag(state, _) | Self::Cubic(_, state, _) => state,
        }
    }

    /// The force where the state that determines it is `x`.
    #[inline(always)]
    fn force(self, x: f64) -> f64 {
        match self {
            Self::Drag(_, c) => -c * x * x.abs(),
            Self::Cubic(.., c) => -c * x * x * x,
        }
    }
}

/// A smooth effect within a step of [`lawson`].
#[derive(Debug, Clone, Copy, Default)]
pub struct Stages {
    /// The state that determines the force, half a step on, without any of these forces.
    half: f64,
    /// Forces at the four stages.
    forces: [f64; 4],
}

/// Lawson's method of order 4 over a step h: levels[0] is the exact flow over h, levels[1] over h/2.
///
/// Flows are affine, F(z + d) = F(z) + Phi d, and every force acts on one state and follows from one state: a step needs the
/// flow of z alone, of half a step only the states that the forces follow from, and the columns of Phi of the states on which
/// they act.
#[inline(always)]
pub fn lawson<V: State>(
    smooth: &[Smooth],
    stages: &mut [Stages],
    levels: &[Kernel],
    h: f64,
    z: &V,
    inputs: &[f64],
    work: &mut Work<V>,
) {
    let Work { result, scratch } = work;
    result.as_mut().copy_from_slice(z.as_ref());
    result.flow(&levels[0], inputs, scratch);
    if smooth.is_empty() {
        return;
    }
    let (whole, half, z) = (&levels[0], &levels[1], z.as_ref());
    for (of, at) in smooth.iter().zip(&mut *stages) {
        at.half = half.row(of.from(), z, inputs);
        at.forces[0] = of.force(z[of.from()]);
    }
    for (i, of) in smooth.iter().enumerate() {
        let mut x = stages[i].half;
        for (other, at) in smooth.iter().zip(&*stages) {
            x += 0.5 * h * half.entry(of.from(), other.onto()) * at.forces[0];
        }
        stages[i].forces[1] = of.force(x);
    }
    for (i, of) in smooth.iter().enumerate() {
        let mut x = stages[i].half;
        for (_, at) in smooth.iter().zip(&*stages).filter(|(other, _)| other.onto() == of.from()) {
            x += 0.5 * h * at.forces[1];
        }
        stages[i].forces[2] = of.force(x);
    }
    for (i, of) in smooth.iter().enumerate() {
        let mut x = result.as_ref()[of.from()];
        for (other, at) in smooth.iter().zip(&*stages) {
            x += h * half.entry(of.from(), other.onto()) * at.forces[2];
        }
        stages[i].forces[3] = of.force(x);
    }
    for (of, Stages { forces: [k1, k2, k3, k4], .. }) in smooth.iter().zip(&*stages) {
        result.add(whole, of.onto(), h / 6.0 * k1);
        result.add(half, of.onto(), h / 3.0 * (k2 + k3));
        result.as_mut()[of.onto()] += h / 6.0 * k4;
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;
    use crate::discretise::discretise_halves;

    /// Drag and two stiffnesses that drive each other's states, against a thousand classical Runge-Kutta steps; half the
    /// step has a thirty-second of the error.
    #[test]
    fn forces_that_drive_each_other_are_integrated_to_fourth_order() {
        let a = DMatrix::from_row_slice(
            4,
            4,
            &[0.0, 1.0, 0.0, 0.0, -9.0, -0.5, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, -4.0, -0.8],
        );
        let mut b = DMatrix::zeros(4, 5);
        b[(1, 0)] = 3.0;
        b.view_mut((0, 1), (4, 4)).fill_with_identity();
        let smooth = [Smooth::Drag(1, 0.7), Smooth::Cubic(0, 3, 2.0), Smooth::Cubic(2, 1, -1.5)];
        let (start, inputs) = ([0.8, -1.0, 0.6, 0.9], [0.4]);
        let slope = |x: &DVector<f64>| {
            let mut slope = &a * x + b.column(0) * inputs[0];
            smooth.iter().for_each(|of| slope[of.onto()] += of.force(x[of.from()]));
            slope
        };
        let error = |h: f64| {
            let mut x = DVector::from_row_slice(&start);
            let dt = h / 1000.0;
            for _ in 0..1000 {
                let k1 = slope(&x);
                let k2 = slope(&(&x + &k1 * (0.5 * dt)));
                let k3 = slope(&(&x + &k2 * (0.5 * dt)));
                let k4 = slope(&(&x + &k3 * dt));
                x += (k1 + k2 * 2.0 + k3 * 2.0 + k4) * (dt / 6.0);
            }
            let levels = discretise_halves(&a, &b, h, 2).unwrap();
            let levels: Vec<Kernel> = levels.iter().map(|(phi, gamma)| Kernel::new(phi, gamma)).collect();
            let mut work = Work::like(&start);
            lawson(&smooth, &mut [Stages::default(); 3], &levels, h, &start, &inputs, &mut work);
            (DVector::from_row_slice(&work.result) - x).norm()
        };
        let (whole, half) = (error(0.05), error(0.025));
        assert!(whole < 1e-6 && (20.0..50.0).contains(&(whole / half)), "{whole:e} {half:e}");
    }
}
