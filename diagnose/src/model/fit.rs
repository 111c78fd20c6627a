//! A hypothesis about a record: a vehicle and effects with free parameters, fitted together.

use crate::thresholds::{FIT_TOLERANCE, MAX_DAMPED_STEPS};
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use whirlstand_vehicle::{Effect, Free, Vehicle};

use crate::candidates::library::Candidate;
use crate::data::record::Data;
use crate::model::columns::{Column, Slot, blocks, dot, dots, products};
use crate::model::free_run::{FreeRun, ModelError};
use crate::model::noise::{Noise, Profile};
use whirlstand_ident::identify::normal::pseudo_inverse;

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
    fn rounds(self) -> (usize, usize) {
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

/// Result of a fit without anything as long as the record: all that is kept of the many fits of a search.
#[derive(Debug, Clone)]
pub struct Optimum {
    /// Best values.
    pub values: Vec<f64>,
    /// Likelihood and noise model of the residual.
    pub profile: Profile,
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

    /// Searches the optimum. The sensitivities of the last step are kept where all of them were computed;
    /// where those to the initial state were given, there are none.
    fn search(
        &self,
        start: Vec<f64>,
        noise: Option<&Noise>,
        initial: Option<&[Column]>,
        effort: Effort,
    ) -> Result<Fit, ModelError> {
        let data = self.free_run.data;
        let (outer, inner) = effort.rounds();
        let slots = self.slots();
        let mut values: Vec<f64> = start.iter().zip(&slots).map(|(v, s)| v.clamp(s.lower, s.upper)).collect();
        let mut predicted = self.predict(&values)?;
        let mut residual = data.residual(&predicted);
        let again =
            |residual: &[f64]| noise.map_or_else(|| Noise::fit(data, residual), |n| n.again(data, residual));
        let mut profile = again(&residual);
        let mut used = noise.cloned().unwrap_or_else(|| profile.noise.clone());
        let mut columns = Vec::new();
        // The fit's own sensitivities, while the values have moved by less than the fit's tolerance: another
        // noise model does not change them.
        let mut kept: Option<Vec<Vec<f64>>> = None;
        let mut damping = 1e-4;
        // Sensitivities to the initial state of a model nearby lead near the optimum. At the optimum itself, those of this
        // model are orthogonal to the residual: each further round has its own.
        let mut exact: Option<Vec<Column>> = None;
        for round in 0..outer {
            if round > 0 && initial.is_some() {
                let vehicle = self.vehicle(&values)?;
                let own = self.free_run.initial_columns(&vehicle, &values[..self.states()], &predicted)?;
                exact = Some(own.into_iter().map(Arc::new).collect());
            }
            let mut white = used.whiten(data, &residual);
            let mut cost = dot(&white, &white);
            // Given sensitivities are the same in every step: they are whitened once.
            let given = exact.as_deref().or(initial);
            let known = given.map(|columns| whitened(&used, data, columns)).map(|w| (products(&w), w));
            for _ in 0..inner {
                let (information, right) = match &known {
                    Some((products, known)) => {
                        let own =
                            kept.take().map_or_else(|| self.own_columns(&values, &predicted, &slots), Ok)?;
                        let normal = bordered(known, products, &whitened(&used, data, &own), &white);
                        kept = Some(own);
                        normal
                    }
                    None => {
                        columns = self.columns(&values, &predicted, &slots, None)?;
                        normal(&whitened(&used, data, &columns), &white)
                    }
                };
                let moved = self.lower((&values, &information, &right), &slots, &mut damping, |predicted| {
                    let residual = data.residual(predicted);
                    let white = used.whiten(data, &residual);
                    let lower = dot(&white, &white);
                    (lower < cost).then_some((residual, white, lower))
                });
                let Some((next, p, (r, w, c))) = moved else { break };
                let gain = cost - c;
                (values, predicted, residual, white, cost) = (next, p, r, w, c);
                damping = (0.1 * damping).max(1e-9);
                if gain < FIT_TOLERANCE {
                    break;
                }
                kept = None;
            }
            let next = again(&residual);
            let gain = next.log_likelihood - profile.log_likelihood;
            let same = next.noise == used;
            profile = next;
            used = profile.noise.clone();
            let settled = same || gain.abs() < FIT_TOLERANCE;
            if settled && (initial.is_none() || exact.is_some()) || self.free_run.is_stopped() {
                break;
            }
        }
        Ok(Fit { values, predicted, residual, profile, columns })
    }

    /// The first damped step that `accept` takes: the values, their prediction and the result of `accept`.
    /// The damping grows with every refused step.
    fn lower<T>(
        &self,
        (values, information, right): (&[f64], &DMatrix<f64>, &DVector<f64>),
        slots: &[Slot],
        damping: &mut f64,
        accept: impl Fn(&[f64]) -> Option<T>,
    ) -> Option<(Vec<f64>, Vec<f64>, T)> {
        for _ in 0..MAX_DAMPED_STEPS {
            let step = damped(information, right, *damping)?;
            let moved = values.iter().zip(step.iter()).zip(slots);
            let next: Vec<f64> = moved.map(|((v, d), s)| (*v + d).clamp(s.lower, s.upper)).collect();
            if let Ok(predicted) = self.predict(&next)
                && let Some(accepted) = accept(&predicted)
            {
                return Some((next, predicted, accepted));
            }
            *damping = (*damping * 10.0).max(1e-4);
        }
        None
    }

    /// Covariance of the values (Cramer-Rao bound), from exact sensitivities at the fit.
    ///
    /// # Errors
    /// When a sensitivity cannot be simulated, or the information matrix is not finite.
    pub fn covariance(&self, fit: &Fit) -> Result<DMatrix<f64>, ModelError> {
        let columns = self.columns(&fit.values, &fit.predicted, &self.slots(), None)?;
        let data = self.free_run.data;
        let zero = vec![0.0; fit.residual.len()];
        let (information, _) = normal(&whitened(&fit.profile.noise, data, &columns), &zero);
        pseudo_inverse(&information).ok_or(ModelError::NotDetermined)
    }
}

fn whitened<C: AsRef<Vec<f64>> + Sync>(noise: &Noise, data: &Data, columns: &[C]) -> Vec<Vec<f64>> {
    columns.par_iter().map(|c| noise.whiten(data, &data.filled(c.as_ref()))).collect()
}

/// Information matrix and gradient from whitened columns and residual.
fn normal(columns: &[Vec<f64>], white: &[f64]) -> (DMatrix<f64>, DVector<f64>) {
    (products(columns), DVector::from_vec(dots(columns, white)))
}

/// Information matrix and gradient, when the products of the first columns are known.
fn bordered(
    known: &[Vec<f64>],
    known_products: &DMatrix<f64>,
    own: &[Vec<f64>],
    white: &[f64],
) -> (DMatrix<f64>, DVector<f64>) {
    let (k, n) = (known.len(), known.len() + own.len());
    let mut information = DMatrix::zeros(n, n);
    information.view_mut((0, 0), (k, k)).copy_from(known_products);
    information.view_mut((k, k), (n - k, n - k)).copy_from(&products(own));
    for rows in blocks(white.len()) {
        for (i, a) in own.iter().enumerate() {
            for (j, b) in known.iter().enumerate() {
                information[(k + i, j)] += dot(&a[rows.clone()], &b[rows.clone()]);
            }
        }
    }
    information.fill_upper_triangle_with_lower_triangle();
    let gradient = dots(known, white).into_iter().chain(dots(own, white));
    (information, DVector::from_iterator(n, gradient))
}

/// A Levenberg-Marquardt step; directions that the data do not determine stay at zero.
fn damped(information: &DMatrix<f64>, right: &DVector<f64>, damping: f64) -> Option<DVector<f64>> {
    let mut damped = information.clone();
    for i in 0..damped.nrows() {
        damped[(i, i)] *= 1.0 + damping;
    }
    Some(pseudo_inverse(&damped)? * right)
}
