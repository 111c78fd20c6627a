//! One filter for several simultaneous flights, which share the gains, since these depend only on the model
//! and on the pattern of measurements. Every number is bit-identical to that of [`Estimator`] for the single
//! flight.

#![expect(clippy::needless_range_loop, reason = "a loop over lanes indexes several rows alike")]

use super::model::Estimator;
use super::recursion::Recursion;
use crate::kernel::Packed;

/// An [`Estimator`] over K flights with measurements at the same steps.
#[derive(Debug, Clone)]
pub struct EstimatorLanes<const K: usize> {
    states: usize,
    used: u64,
    f: Packed,
    g: Packed,
    h: Packed,
    d: Option<Packed>,
    recursion: Recursion,
    x: Vec<[f64; K]>,
    predicted: Vec<[f64; K]>,
    innovation: Vec<[f64; K]>,
    independent: Vec<[f64; K]>,
    nis: [f64; K],
    dof: u32,
}

impl<const K: usize> EstimatorLanes<K> {
    /// Starts all flights in the state of `estimator`. `None` for a filter with delays, lags or nonlinear
    /// inputs.
    pub fn new(estimator: &Estimator) -> Option<Self> {
        let filter = estimator.filter();
        estimator.knows_plain_inputs().then(|| Self {
            states: estimator.x().len(),
            used: estimator.used(),
            f: filter.f.clone(),
            g: filter.g.clone(),
            h: filter.h.clone(),
            d: filter.d.clone(),
            recursion: filter.recursion.clone(),
            x: filter.x().iter().map(|x| [*x; K]).collect(),
            predicted: vec![[0.0; K]; filter.x().len()],
            innovation: vec![[0.0; K]; filter.outputs],
            independent: vec![[0.0; K]; filter.outputs],
            nis: [filter.nis(); K],
            dof: filter.dof(),
        })
    }

    /// Updates each flight as [`Estimator::step`]; `valid` marks the outputs that are fresh in all of them.
    /// Values that are not finite invalidate their own flight only.
    #[inline(always)]
    pub fn step(&mut self, y: &[[f64; K]], valid: u64, u_before: &[[f64; K]], u_now: &[[f64; K]]) {
        let outputs = self.innovation.len();
        let mask = valid & self.used & u64::MAX.checked_shr(64 - outputs as u32).unwrap_or(0);
        if self.recursion.started() {
            self.predicted.fill([0.0; K]);
            self.f.add_lanes(&mut self.predicted, &self.x);
            self.g.add_lanes(&mut self.predicted, u_before);
            std::mem::swap(&mut self.x, &mut self.predicted);
        }
        self.recursion.advance(mask);
        for (i, (innovation, y)) in self.innovation.iter_mut().zip(y).enumerate() {
            *innovation = if mask >> i & 1 == 1 { *y } else { [0.0; K] };
        }
        self.h.subtract_lanes(&mut self.innovation, &self.x);
        if let Some(d) = &self.d {
            d.subtract_lanes(&mut self.innovation, u_now);
        }
        let gains = self.recursion.gains();
        gains.gain.add_lanes(&mut self.x, &self.innovation);
        self.independent.fill([0.0; K]);
        gains.whitening.add_lanes(&mut self.independent, &self.innovation);
        self.nis = [0.0; K];
        for independent in &self.independent {
            for l in 0..K {
                self.nis[l] += independent[l] * independent[l];
            }
        }
        self.dof = mask.count_ones();
    }

    /// Estimated states in the plant's order, each as an array over the flights.
    #[inline(always)]
    pub fn x(&self) -> &[[f64; K]] {
        &self.x[..self.states]
    }

    /// Standard deviation of the states, the same in all flights.
    #[inline(always)]
    pub fn std(&self) -> &[f64] {
        &self.recursion.gains().std[..self.states]
    }

    /// Normalised innovation squared of the last step, per flight.
    #[inline(always)]
    pub fn nis(&self) -> &[f64; K] {
        &self.nis
    }

    /// Number of measurements used in the last step.
    pub fn dof(&self) -> u32 {
        self.dof
    }

    /// Whether the gains have converged.
    pub fn converged(&self) -> bool {
        self.recursion.settled()
    }
}
