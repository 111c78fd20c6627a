//! A whole record at once.

use super::Simulator;

impl Simulator {
    /// Runs a whole record: for each row of `inputs` (steps x inputs, row after row) the outputs measured at that
    /// step go into the same row of `outputs` (steps x outputs).
    ///
    /// # Panics
    /// When the two have not the same number of whole rows.
    pub fn run(&mut self, inputs: &[f64], outputs: &mut [f64]) {
        let p = self.sensors.fresh().len();
        assert_eq!(inputs.len() * p, outputs.len() * self.m, "a row of outputs for each row of inputs");
        for (u, y) in inputs.chunks_exact(self.m).zip(outputs.chunks_exact_mut(p)) {
            self.apply(u);
            y.copy_from_slice(self.measure());
            self.advance();
        }
    }
}
