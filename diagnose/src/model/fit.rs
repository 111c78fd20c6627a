//! A hypothesis about a record: a vehicle and effects with free parameters, fitted together.

use whirlstand_vehicle::{Effect, Free, Vehicle};

use crate::candidates::library::Candidate;
use crate::model::columns::Column;
use crate::model::free_run::FreeRun;
use crate::model::noise::{Noise, Profile};
use crate::model::optimum::{ModelError, Optimum};

/// Effort of a fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effort {
    /// A few steps under one noise model: enough to rank a candidate.
    Glance,
    /// Iterate to the optimum.
    Full,
}

impl Effort {
    /// How often the noise model is refitted, and the Levenberg-Marquardt steps under each.
    pub(super) fn rounds(self) -> (usize, usize) {
        match self {
            Effort::Glance => (1, 3),
            Effort::Full => (20, 6),
        }
    }
}

/// A vehicle with free parameters and effects whose parameters are fitted.
///
/// Parameter values are in one vector: initial state, free parameters of the vehicle, then the tunables of
/// every effect.
#[derive(Debug, Clone)]
pub struct Model<'r, 'd> {
    /// Simulation of the vehicle over the record.
    pub free_run: &'r FreeRun<'d>,
    /// Free parameters of the vehicle itself, for one that was identified.
    pub free: &'r [Free],
    /// Effects with free parameters.
    pub terms: Vec<Candidate>,
}

/// A model at its best-fitting parameter values.
#[derive(Debug, Clone)]
pub struct Fit {
    /// Best values.
    pub values: Vec<f64>,
    /// Predicted samples.
    pub predicted: Vec<f64>,
    /// Residual, measured minus predicted, with gaps filled.
    pub residual: Vec<f64>,
    /// Likelihood and noise model of the residual.
    pub profile: Profile,
    /// Sensitivities, not whitened, one column per parameter value.
    pub columns: Vec<Column>,
}

impl<'r, 'd> Model<'r, 'd> {
    /// Number of values that are initial states, over all records.
    pub fn states(&self) -> usize {
        self.free_run.initials()
    }

    /// Number of values before those of the effects: initial states and free parameters.
    pub fn base(&self) -> usize {
        self.states() + self.free.len()
    }

    /// Number of values that are not initial states: those that BIC counts.
    pub fn parameters(&self) -> usize {
        self.free.len() + self.terms.iter().map(|t| t.tunables.len()).sum::<usize>()
    }

    /// Index range of the values of a term.
    pub fn range(&self, term: usize) -> std::ops::Range<usize> {
        let from = self.base() + self.terms[..term].iter().map(|t| t.tunables.len()).sum::<usize>();
        from..from + self.terms[term].tunables.len()
    }

    /// The effects at the given values.
    ///
    /// # Errors
    /// [`ModelError::Inapplicable`] when the table does not allow the values of one.
    pub fn effects(&self, values: &[f64]) -> Result<Vec<Effect>, ModelError> {
        let effect = |t: usize| self.terms[t].effect(&values[self.range(t)]).ok_or(ModelError::Inapplicable);
        (0..self.terms.len()).map(effect).collect()
    }

    /// The vehicle at the given values.
    ///
    /// # Errors
    /// [`ModelError::Inapplicable`] when an effect does not fit.
    pub fn vehicle(&self, values: &[f64]) -> Result<Vehicle, ModelError> {
        let mut vehicle = self.free_run.with(&self.effects(values)?)?;
        for (free, value) in self.free.iter().zip(&values[self.states()..]) {
            vehicle.set_free(&free.target, *value).map_err(|_| ModelError::Inapplicable)?;
        }
        Ok(vehicle)
    }

    /// Predicted samples.
    ///
    /// # Errors
    /// When an effect does not fit, or the free run diverges.
    pub fn predict(&self, values: &[f64]) -> Result<Vec<f64>, ModelError> {
        self.free_run.run_vehicle(&self.vehicle(values)?, &values[..self.states()])
    }

    /// Fits all values to the optimum, alternating with the noise model. `initial` are sensitivities to the
    /// initial state from a model nearby, with which the search begins: the result does not depend on them.
    ///
    /// # Errors
    /// When the start, or a point next to it, cannot be simulated.
    pub fn fit(
        &self,
        start: Vec<f64>,
        noise: Option<&Noise>,
        initial: Option<&[Column]>,
    ) -> Result<Fit, ModelError> {
        let fit = self.search(start, noise, initial, Effort::Full)?;
        if fit.columns.is_empty() {
            let columns = self.columns(&fit.values, &fit.predicted, &self.slots(), initial)?;
            return Ok(Fit { columns, ..fit });
        }
        Ok(fit)
    }

    /// The optimum of [`Model::fit`], with the given effort.
    ///
    /// # Errors
    /// As [`Model::fit`].
    pub fn optimum(
        &self,
        start: Vec<f64>,
        noise: Option<&Noise>,
        initial: Option<&[Column]>,
        effort: Effort,
    ) -> Result<Optimum, ModelError> {
        let Fit { values, profile, .. } = self.search(start, noise, initial, effort)?;
        Ok(Optimum { values, profile })
    }

    /// The fit at an optimum: predictions, residual and sensitivities are computed again. `initial` as in
    /// [`Model::fit`].
    ///
    /// # Errors
    /// As [`Model::fit`].
    pub fn at(&self, optimum: &Optimum, initial: &[Column]) -> Result<Fit, ModelError> {
        let Optimum { values, profile } = optimum.clone();
        let predicted = self.predict(&values)?;
        let residual = self.free_run.data.residual(&predicted);
        let columns = self.columns(&values, &predicted, &self.slots(), Some(initial))?;
        Ok(Fit { values, predicted, residual, profile, columns })
    }
}
