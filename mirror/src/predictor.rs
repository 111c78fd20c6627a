//! The predictor in innovations form: the simulation of all that is known, corrected by the Kalman filter of
//! its errors.

use whirlstand_control::kalman::KalmanFilter;
use whirlstand_vehicle::Simulator;

use crate::error::MirrorError;
use crate::known::Knowledge;
use crate::lateness::Lateness;

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

/// Predicts step by step, without allocation.
#[derive(Debug, Clone)]
pub struct Predictor {
    simulator: Simulator,
    filter: KalmanFilter,
    /// Age of the measurements of a real vehicle.
    lateness: Option<Lateness>,
    /// Measured minus expected outputs.
    residual: Vec<f64>,
    /// Estimated errors (filter state).
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
        simulator.set_engine(known.simulated_engine());
        let filter = KalmanFilter::new(model, &initial);
        Ok(Self {
            lateness: known.lateness(&filter)?,
            residual: vec![0.0; known.noise.len()],
            errors: vec![0.0; initial.len()],
            states: known.scales.len(),
            filter,
            simulator,
        })
    }

    /// A copy of the filter in its present state, with another simulation, and with the predicted errors and
    /// the measurement age of that time.
    pub(crate) fn around(&self, simulator: Simulator, errors: &[f64], lateness: Option<Lateness>) -> Self {
        let mut other = Self { simulator, lateness, ..self.clone() };
        other.errors.copy_from_slice(errors);
        other.filter.set_state(&other.errors);
        other
    }

    /// Advances one step; [`Self::whitened`] then holds the innovations of the measurement.
    pub fn step(&mut self, sample: &Sample<'_>) {
        self.step_by(sample, &[]);
    }

    /// As [`Self::step`], but with the gains of another predictor at the same step, unless `gains` is empty. At the
    /// same step the state is then known equally well under each hypothesis, also shortly after the begin; and for a
    /// real vehicle, whose gains change at every step, their computation costs more than all the rest.
    pub(crate) fn step_by(&mut self, sample: &Sample<'_>, gains: &[f64]) {
        self.simulator.apply(sample.u);
        let expected = match &mut self.lateness {
            None => self.simulator.measure(),
            Some(lateness) => {
                self.simulator.advance();
                lateness.expect(sample.u, self.simulator.measure())
            }
        };
        for ((r, y), e) in self.residual.iter_mut().zip(sample.y).zip(expected) {
            *r = y - e;
        }
        match &mut self.lateness {
            None => {
                match gains {
                    [] => self.filter.step(&self.residual, sample.fresh, &[0.0], &[0.0]),
                    gains => self.filter.step_by(&self.residual, sample.fresh, gains),
                }
                self.errors.copy_from_slice(self.filter.x());
            }
            Some(lateness) => {
                let measured = (&self.residual[..], sample.fresh);
                lateness.step(&mut self.filter, measured, gains, &mut self.errors);
            }
        }
        self.simulator.correct(&self.errors[..self.states]);
        self.errors[..self.states].fill(0.0);
        self.filter.set_state(&self.errors);
        if self.lateness.is_none() {
            self.simulator.advance();
        }
    }

    /// Whitened innovations of the last step, one for each output; zero where the output was not fresh.
    pub fn whitened(&self) -> &[f64] {
        self.lateness.as_ref().map_or_else(|| self.filter.whitened(), Lateness::whitened)
    }

    /// Number of values that [`Self::write_gains`] writes.
    pub(crate) fn gains_len(&self) -> usize {
        self.filter.gains_len()
    }

    /// Writes the gains of the last step.
    pub(crate) fn write_gains(&self, to: &mut [f64]) {
        self.filter.write_gains(to);
    }

    /// Predicted states at the next step, SI.
    pub fn state(&self) -> &[f64] {
        self.simulator.state()
    }

    /// Predicted errors at the next step; those of the states are zero.
    pub(crate) fn errors(&self) -> &[f64] {
        &self.errors
    }

    /// Takes over the measurement age from `other`, for inputs that are held back by `more` additional
    /// periods.
    pub(crate) fn know_age(&mut self, other: &Self, more: f64) {
        if let (Some(own), Some(other)) = (&mut self.lateness, &other.lateness) {
            own.know(other, more);
        }
    }

    /// A copy that holds an age of the measurements, given with its standard deviation, s; `None` for a
    /// simulation.
    pub(crate) fn holding(&self, age: [f64; 2]) -> Option<Self> {
        let mut other = self.clone();
        other.lateness.as_mut()?.hold(age);
        Some(other)
    }

    /// The age of the measurements of a real vehicle.
    pub(crate) fn lateness(&self) -> Option<&Lateness> {
        self.lateness.as_ref()
    }

    /// Mutable access to the simulation.
    pub(crate) fn simulator(&mut self) -> &mut Simulator {
        &mut self.simulator
    }
}
