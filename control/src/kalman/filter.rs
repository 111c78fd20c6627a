//! The Kalman filter for a linear model, with intermittent measurements and stored periodic gains.

use nalgebra::DMatrix;

use super::filter_model::FilterModel;
use super::recursion::Recursion;
use crate::kernel::{Block, Packed, blocks};

/// A discrete-time Kalman filter for `x+ = F x + G u + w`, `y = H x + D u + v`, with w of covariance Q and v
/// of independent components.
///
/// Measurements are processed sequentially in Joseph form (Bucy and Joseph 1968), which keeps the covariance
/// symmetric and positive despite rounding errors of the gain. When the pattern of fresh measurements repeats
/// and the covariance hardly changes, gains are stored and reused, so that a step costs a few matrix-vector
/// products; the first step that breaks the pattern returns to the full recursion from the covariance of the
/// stored gains.
#[derive(Debug, Clone)]
pub struct KalmanFilter {
    states: usize,
    pub(super) outputs: usize,
    model: FilterModel,
    pub(super) f: Packed,
    pub(super) g: Packed,
    pub(super) h: Packed,
    /// Feed-through matrix; `None` when it is zero.
    pub(super) d: Option<Packed>,
    x: Vec<Block>,
    innovation: Vec<Block>,
    independent: Vec<Block>,
    scratch: Vec<Block>,
    pub(super) recursion: Recursion,
    nis: f64,
    dof: u32,
}

impl KalmanFilter {
    /// A filter with initial state zero and the given initial standard deviations of the n states.
    pub fn new(model: FilterModel, initial: &[f64]) -> Self {
        let (states, outputs) = (model.f.nrows(), model.h.nrows());
        let p = DMatrix::from_fn(states, states, |i, j| if i == j { initial[i] * initial[i] } else { 0.0 });
        let recursion = Recursion::new(&model, &p);
        Self {
            states,
            outputs,
            f: Packed::new(&model.f),
            g: Packed::new(&model.g),
            h: Packed::new(&model.h),
            d: model.d.iter().any(|v| *v != 0.0).then(|| Packed::new(&model.d)),
            model,
            x: vec![[0.0; 4]; blocks(states)],
            innovation: vec![[0.0; 4]; blocks(outputs)],
            independent: vec![[0.0; 4]; blocks(outputs)],
            scratch: vec![[0.0; 4]; blocks(states)],
            recursion,
            nis: 0.0,
            dof: 0,
        }
    }

    /// The model of the filter.
    pub fn model(&self) -> &FilterModel {
        &self.model
    }

    /// Estimated state.
    pub fn x(&self) -> &[f64] {
        &self.x.as_flattened()[..self.states]
    }

    /// Standard deviations of the estimated states.
    pub fn std(&self) -> &[f64] {
        &self.recursion.gains().std
    }

    /// Covariance of the estimate, n x n; while stored gains are in use, it is that of the step for which
    /// they were computed.
    pub fn covariance(&self) -> DMatrix<f64> {
        self.recursion.covariance(self.states)
    }

    /// Normalised innovation squared of the last step, chi-square distributed with [`Self::dof`] degrees of
    /// freedom.
    pub fn nis(&self) -> f64 {
        self.nis
    }

    /// Number of measurements used in the last step.
    pub fn dof(&self) -> u32 {
        self.dof
    }

    /// Whitened innovations of the last step: independent and of variance one when the model is correct.
    /// Entry i is that of measurement i given the measurements before it; zero where measurement i was not
    /// used.
    pub fn whitened(&self) -> &[f64] {
        &self.independent.as_flattened()[..self.outputs]
    }

    /// Whether the gains have converged for good.
    pub fn settled(&self) -> bool {
        self.recursion.settled()
    }

    /// Sets the state; the covariance is kept.
    pub fn set_state(&mut self, x: &[f64]) {
        self.x.as_flattened_mut().iter_mut().take(self.states).zip(x).for_each(|(a, b)| *a = *b);
    }

    /// One step: prediction with the input that acted since the previous step (none before the first), then
    /// the measurements whose bit in `mask` is set. `y` has p entries, the inputs have m. Measurements that
    /// are not finite are ignored.
    pub fn step(&mut self, y: &[f64], mask: u64, u_before: &[f64], u_now: &[f64]) {
        let mask = self.usable(y, mask);
        self.predict(u_before);
        self.recursion.advance(mask);
        self.apply(y, mask, u_now);
    }

    /// A step as [`Self::step`] without inputs and with more uncertainty: the state also changes by each
    /// vector of `pushes` times an independent random number of variance one, and the variance of each
    /// measurement increases by its entry of `more`. Either all steps of a filter are of this kind, or none.
    pub fn step_uncertain(&mut self, y: &[f64], mask: u64, (pushes, more): (&[f64], &[f64])) {
        let mask = self.usable(y, mask);
        self.predict(&[]);
        self.recursion.advance_uncertain(mask, pushes, more);
        self.apply(y, mask, &[]);
    }

    /// Number of values that [`Self::write_gains`] writes.
    pub fn gains_len(&self) -> usize {
        (self.states + self.outputs) * self.outputs
    }

    /// Writes the gain of the last step and the whitening matrix of its innovations into `to`, column by
    /// column.
    pub fn write_gains(&self, to: &mut [f64]) {
        let gains = self.recursion.gains();
        let (gain, whitening) = to.split_at_mut(self.states * self.outputs);
        for (j, column) in gain.chunks_exact_mut(self.states).enumerate() {
            column.copy_from_slice(&gains.gain.column(j).as_flattened()[..self.states]);
        }
        for (j, column) in whitening.chunks_exact_mut(self.outputs).enumerate() {
            column.copy_from_slice(&gains.whitening.column(j).as_flattened()[..self.outputs]);
        }
    }

    /// A step with gains that another filter of the same model has [written](Self::write_gains), for the same
    /// measurements. The covariance is not updated.
    pub fn step_by(&mut self, y: &[f64], mask: u64, gains: &[f64]) {
        let mask = self.usable(y, mask);
        self.predict(&[]);
        self.recursion.take_gains(mask, self.states, gains);
        self.apply(y, mask, &[]);
    }

    /// The mask restricted to existing measurements with finite values.
    fn usable(&self, y: &[f64], mask: u64) -> u64 {
        let mut mask = mask & u64::MAX.checked_shr(64 - self.outputs as u32).unwrap_or(0);
        for (i, v) in y.iter().enumerate().take(self.outputs) {
            if !v.is_finite() {
                mask &= !(1 << i);
            }
        }
        if y.len() < self.outputs {
            mask = 0;
        }
        mask
    }

    fn predict(&mut self, u_before: &[f64]) {
        if self.recursion.started() {
            self.scratch.fill([0.0; 4]);
            self.f.add(&mut self.scratch, self.x.as_flattened());
            self.g.add(&mut self.scratch, u_before);
            std::mem::swap(&mut self.x, &mut self.scratch);
        }
    }

    /// Computes innovations and NIS, and updates the state estimate.
    fn apply(&mut self, y: &[f64], mask: u64, u_now: &[f64]) {
        let gains = self.recursion.gains();
        for (i, v) in self.innovation.as_flattened_mut().iter_mut().enumerate().take(self.outputs) {
            // Unused outputs may be NaN, which a zero gain would not suppress.
            *v = if mask >> i & 1 == 1 { y[i] } else { 0.0 };
        }
        self.h.subtract(&mut self.innovation, self.x.as_flattened());
        if let Some(d) = &self.d {
            d.subtract(&mut self.innovation, u_now);
        }
        let innovation = &self.innovation.as_flattened()[..self.outputs];
        gains.gain.add(&mut self.x, innovation);
        self.independent.fill([0.0; 4]);
        gains.whitening.add(&mut self.independent, innovation);
        self.nis = self.independent.as_flattened().iter().map(|v| v * v).sum();
        self.dof = mask.count_ones();
    }
}
