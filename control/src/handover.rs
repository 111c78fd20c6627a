//! State for a bumpless transfer between laws: a decaying offset of the command, and the integrals that
//! produce a given command.

use nalgebra::DMatrix;

use crate::design::Design;

/// Bounds of the offset's decay time, s. Between them it is the time constant of the slowest pole of the loop
/// without integrals: a faster decay would be a bump again, a slower one would outlast its cause.
const FADING_S: (f64, f64) = (0.05, 1.0);

/// Takeover state of a controller.
#[derive(Debug, Clone)]
pub struct Handover {
    /// Offset added to the command.
    pub offset: Vec<f64>,
    /// Factor by which the offset decays per step.
    keep: f64,
    /// Gain from commands to the integrals that produce them, q x m; without rows where integrals are copied
    /// unchanged.
    pub tracking: DMatrix<f64>,
    /// Buffer for the command of a law that runs in parallel.
    pub command: Vec<f64>,
}

impl Handover {
    pub fn new(design: &Design) -> Self {
        let plant = &design.plant;
        let (period, m) = (plant.period_s(), plant.input_count());
        // Integrals add their number of poles, and these are the slowest.
        let mut rates: Vec<f64> = design
            .closed_loop_poles
            .iter()
            .filter_map(|pole| pole.continuous.map(|[re, _]| -re))
            .filter(|rate| *rate > 0.0)
            .collect();
        rates.sort_by(f64::total_cmp);
        let slowest = rates.get(design.integral.len()).or(rates.last());
        let time = slowest.map_or(FADING_S.1, |rate| 1.0 / rate).clamp(FADING_S.0, FADING_S.1);
        let tracking = match design.sliding {
            None => design.integral_tracking.clone(),
            Some(_) => DMatrix::zeros(0, m),
        };
        Self { offset: vec![0.0; m], keep: (-period / time).exp(), tracking, command: vec![0.0; m] }
    }

    pub fn reset(&mut self) {
        self.offset.fill(0.0);
    }

    /// Adds the offset to the law's demand, and lets it decay.
    pub fn add(&mut self, wanted: &mut [f64]) {
        for (wanted, offset) in wanted.iter_mut().zip(&mut self.offset) {
            *wanted += *offset;
            *offset *= self.keep;
        }
    }
}
