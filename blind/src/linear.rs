//! The nominal vehicle as a discrete-time recursion, for records on which only the model acts; it is fast
//! enough for the sensitivities to every parameter.

use nalgebra::{DMatrix, DVector};
use whirlstand_vehicle::Vehicle;

use super::commands::Commands;

/// Recursion x_{k+1} = F x_k + G u_k.
pub(crate) struct Recursion {
    pub f: DMatrix<f64>,
    pub g: DMatrix<f64>,
}

impl Recursion {
    /// Zero-order-hold discretization: both upper blocks of exp([A B; 0 0] T).
    pub fn new(a: &DMatrix<f64>, b: &DMatrix<f64>, period_s: f64) -> Self {
        let (n, m) = b.shape();
        let mut block = DMatrix::zeros(n + m, n + m);
        block.view_mut((0, 0), (n, n)).copy_from(&(a * period_s));
        block.view_mut((0, n), (n, m)).copy_from(&(b * period_s));
        let finite = block.iter().all(|v| v.is_finite());
        #[expect(
            clippy::disallowed_methods,
            reason = "it ends for finite numbers, and the judge has its own numerics"
        )]
        let e = if finite { block.exp() } else { block * f64::NAN };
        Self { f: e.view((0, 0), (n, n)).into_owned(), g: e.view((0, n), (n, m)).into_owned() }
    }

    /// The outputs C x + D u of a run from `x0` (samples x outputs).
    pub fn outputs(&self, c: &DMatrix<f64>, d: &DMatrix<f64>, x0: &[f64], commands: &Commands) -> Vec<f64> {
        let mut x = DVector::from_column_slice(x0);
        let mut u = DVector::zeros(self.g.ncols());
        let mut all = Vec::with_capacity(commands.samples() * c.nrows());
        for k in 0..commands.samples() {
            for (u, column) in u.iter_mut().zip(&commands.inputs) {
                *u = column[k];
            }
            all.extend((c * &x + d * &u).iter());
            x = &self.f * &x + &self.g * &u;
        }
        all
    }
}

/// Outputs of the vehicle's model without any effect (samples x outputs).
pub(crate) fn model(vehicle: &Vehicle, x0: &[f64], commands: &Commands) -> Vec<f64> {
    let recursion = Recursion::new(&vehicle.a, &vehicle.b, commands.period_s);
    recursion.outputs(&vehicle.c, &vehicle.d, x0, commands)
}
