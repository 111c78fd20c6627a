//! What a law needs to take over from another in flight: an offset of its command that dies away, and how its integrals reach a command.

use nalgebra::DMatrix;

use crate::design::Design;

/// Bounds on the time in which the offset dies away, s. Between them it is that of the slowest pole of the loop without
/// integrals: a faster one would be a bump again, and a slower one would outlive what it was made of.
const FADING_S: (f64, f64) = (0.05, 1.0);

/// What a controller keeps for taking over.
#[derive(Debug, Clone)]
pub struct Handover {
    /// What is added to the command.
    pub offset: Vec<f64>,
    /// What is left of it in the next step.
    keep: f64,
    /// From commands to the integrals that reach them, q x m; without rows where integrals are taken as they are.
    pub tracking: DMatrix<f64>,
    /// Place for the command of a law that flies along.
    pub command: Vec<f64>,
}

impl Handover {
    pub fn new(design: &Design) -> Self {
        let plant = &design.plant;
        let (period, m) = (plant.period_s(), plant.input_count());
        // As many poles as integrals are theirs, and these are the slowest.
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

    /// Adds the offset to what the law wants, and lets it fade.
    pub fn add(&mut self, wanted: &mut [f64]) {
        for (wanted, offset) in wanted.iter_mut().zip(&mut self.offset) {
            *wanted += *offset;
            *offset *= self.keep;
        }
    }
}
