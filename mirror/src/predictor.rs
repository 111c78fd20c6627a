//! The predictor in innovations form: the simulation of all that is known, corrected by the Kalman filter of its errors.

use whirlstand_control::kalman::KalmanFilter;
use whirlstand_vehicle::Simulator;

use crate::error::MirrorError;
use crate::known::Knowledge;

/// The measurement of a step.
#[derive(Debug, Clone, Copy)]
pub struct Sample<'a> {
    /// Number of the step.
    pub step: u64,
    /// Outputs in the vehicle's order, SI.
    pub y: &'a [f64],
    /// Bit i is set when output i is fresh.
    pub fresh: u64,
    /// Inputs that act from this step on, within the vehicle's limits, SI.
    pub u: &'a [f64],
}

/// Predicts one step after the other. A step allocates nothing.
#[derive(Debug, Clone)]
pub struct Predictor {
    simulator: Simulator,
    filter: KalmanFilter,
    /// Residual of a measurement.
    residual: Vec<f64>,
    /// State of the filter.
    errors: Vec<f64>,
    states: usize,
}

impl Predictor {
    /// A predictor before the first measurement.
    ///
    /// # Errors
    /// [`MirrorError`].
    pub fn new(known: &Knowledge) -> Result<Self, MirrorError> {
        let (model, initial) = known.filter()?;
        let mut simulator = Simulator::expected(&known.vehicle, known.period_s)?;
        simulator.set_engine(if known.phases { known.engine } else { whirlstand_vehicle::Engine::Off });
        Ok(Self {
            residual: vec![0.0; known.noise.len()],
            errors: vec![0.0; initial.len()],
            states: known.scales.len(),
            filter: KalmanFilter::new(model, &initial),
            simulator,
        })
    }

    /// A copy of the filter in its present state, with another simulation and the errors predicted at that time.
    pub(crate) fn around(&self, simulator: Simulator, errors: &[f64]) -> Self {
        let mut other = Self { simulator, ..self.clone() };
        other.errors.copy_from_slice(errors);
        other.filter.set_state(&other.errors);
        other
    }

    /// Advances one step; [`Self::whitened`] then holds the innovations of the measurement.
    pub fn step(&mut self, sample: &Sample<'_>) {
        self.simulator.apply(sample.u);
        let expected = self.simulator.measure();
        for ((r, y), e) in self.residual.iter_mut().zip(sample.y).zip(expected) {
            *r = y - e;
        }
        self.filter.step(&self.residual, sample.fresh, &[0.0], &[0.0]);
        self.errors.copy_from_slice(self.filter.x());
        self.simulator.correct(&self.errors[..self.states]);
        self.errors[..self.states].fill(0.0);
        self.filter.set_state(&self.errors);
        self.simulator.advance();
    }

    /// Whitened innovations of the last step, one for each output; zero where it was not fresh.
    pub fn whitened(&self) -> &[f64] {
        self.filter.whitened()
    }

    /// Predicted states at the next step, SI.
    pub fn state(&self) -> &[f64] {
        self.simulator.state()
    }

    /// Predicted errors at the next step other than those of the states.
    pub(crate) fn errors(&self) -> &[f64] {
        &self.errors
    }

    /// The simulation.
    pub(crate) fn simulator(&mut self) -> &mut Simulator {
        &mut self.simulator
    }
}
