//! Search of the optimum of a fit: a descent under a given noise model, in turns with the noise model.

use std::ops::ControlFlow;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use whirlstand_ident::identify::normal::pseudo_inverse;
use whirlstand_ident::identify::search::{Derivatives, Limits, Point, search};

use crate::data::record::Data;
use crate::model::columns::{Column, Slot, Sparse, dot};
use crate::model::fit::{Effort, Fit, Model};
use crate::model::noise::Noise;
use crate::model::optimum::ModelError;
use crate::thresholds::{DESCENT_LIMITS, FIT_TOLERANCE};

impl Model<'_, '_> {
    /// Searches the optimum. The sensitivities of the last step are kept where all of them were computed;
    /// where those to the initial state were given, there are none.
    pub(super) fn search(
        &self,
        start: Vec<f64>,
        noise: Option<&Noise>,
        initial: Option<&[Column]>,
        effort: Effort,
    ) -> Result<Fit, ModelError> {
        let data = self.free_run.data;
        let (outer, inner) = effort.rounds();
        let slots = self.slots();
        let values: Vec<f64> = start.iter().zip(&slots).map(|(v, s)| v.clamp(s.lower, s.upper)).collect();
        let mut evaluation = Evaluation::new(self, values)?;
        let again =
            |residual: &[f64]| noise.map_or_else(|| Noise::fit(data, residual), |n| n.again(data, residual));
        let mut profile = again(&evaluation.residual);
        let mut used = noise.cloned().unwrap_or_else(|| profile.noise.clone());
        let mut descent = Descent::new(self, slots, inner);
        // Sensitivities to the initial state of a model nearby lead near the optimum. At the optimum itself, those of this
        // model are orthogonal to the residual: each further round has its own.
        let mut exact: Option<Vec<Column>> = None;
        for round in 0..outer {
            if round > 0 && initial.is_some() {
                exact = Some(evaluation.initial_columns(self)?);
            }
            evaluation = descent.lowest(evaluation, &used, exact.as_deref().or(initial))?;
            let next = again(&evaluation.residual);
            let gain = next.log_likelihood - profile.log_likelihood;
            let same = next.noise == used;
            profile = next;
            used = profile.noise.clone();
            let settled = same || gain.abs() < FIT_TOLERANCE;
            if settled && (initial.is_none() || exact.is_some()) || self.free_run.is_stopped() {
                break;
            }
        }
        let columns = if initial.is_none() { evaluation.columns() } else { Vec::new() };
        let Evaluation { values, predicted, residual, .. } = evaluation;
        Ok(Fit { values, predicted, residual, profile, columns })
    }

    /// Covariance of the values (Cramer-Rao bound), from exact sensitivities at the fit.
    ///
    /// # Errors
    /// When a sensitivity cannot be simulated, or the information matrix is not finite.
    pub fn covariance(&self, fit: &Fit) -> Result<DMatrix<f64>, ModelError> {
        let columns = self.columns(&fit.values, &fit.predicted, &self.slots(), None)?;
        let data = self.free_run.data;
        let information = whitened(&fit.profile.noise, data, &columns).products();
        pseudo_inverse(&information).ok_or(ModelError::NotDetermined)
    }
}

/// Values of a model with what they predict.
struct Evaluation {
    pub values: Vec<f64>,
    /// Predicted samples.
    pub predicted: Vec<f64>,
    /// Measured minus predicted, with gaps filled.
    pub residual: Vec<f64>,
    /// Sensitivities that were computed here, or so near that they are the same: to the parameters, and to the initial
    /// state where it was not given. Another noise model does not change them.
    sensitivities: Option<Arc<Vec<Column>>>,
}

impl Evaluation {
    pub fn new(model: &Model<'_, '_>, values: Vec<f64>) -> Result<Self, ModelError> {
        let predicted = model.predict(&values)?;
        let residual = model.free_run.data.residual(&predicted);
        Ok(Self { values, predicted, residual, sensitivities: None })
    }

    /// Sensitivities to the initial state.
    pub fn initial_columns(&self, model: &Model<'_, '_>) -> Result<Vec<Column>, ModelError> {
        let (vehicle, initial) = (model.vehicle(&self.values)?, &self.values[..model.states()]);
        let columns = model.free_run.initial_columns(&vehicle, initial, &self.predicted)?;
        Ok(columns.into_iter().map(Arc::new).collect())
    }

    /// The sensitivities that are known here; empty where none are.
    pub fn columns(&self) -> Vec<Column> {
        self.sensitivities.as_deref().cloned().unwrap_or_default()
    }
}

/// Descents of one model under several noise models, one after the other.
struct Descent<'m, 'r, 'd> {
    model: &'m Model<'r, 'd>,
    slots: Vec<Slot>,
    bounds: Vec<(f64, f64)>,
    limits: Limits,
}

impl<'m, 'r, 'd> Descent<'m, 'r, 'd> {
    /// Descents of at most `steps` steps each.
    pub fn new(model: &'m Model<'r, 'd>, slots: Vec<Slot>, steps: usize) -> Self {
        let bounds = slots.iter().map(|s| (s.lower, s.upper)).collect();
        Self { model, slots, bounds, limits: Limits { iterations: steps, ..DESCENT_LIMITS } }
    }

    /// The evaluation of the lowest cost that is reached from `start` under `noise`. `initial` are sensitivities to
    /// the initial state, the same in every step.
    pub fn lowest(
        &mut self,
        start: Evaluation,
        noise: &Noise,
        initial: Option<&[Column]>,
    ) -> Result<Evaluation, ModelError> {
        let white = noise.whiten(self.model.free_run.data, &start.residual);
        let known = initial.map(|columns| whitened(noise, self.model.free_run.data, columns));
        let known = known.map(|white| (white.products(), white));
        let objective = Objective { descent: self, noise, known };
        let start = Iterate {
            objective: &objective,
            cost: 0.5 * dot(&white, &white),
            evaluation: start,
            white,
            failure: None,
        };
        let (lowest, outcome) = search(
            start,
            &self.bounds,
            self.limits,
            |from, to, _| from.next(to),
            |_, _| ControlFlow::Continue(()),
        );
        let Iterate { evaluation, failure, .. } = lowest;
        // Directions that the data hardly determine are descended as the damping falls, from one noise model to the next.
        self.limits.damping = outcome.damping;
        failure.map_or(Ok(evaluation), Err)
    }
}

/// The cost under one noise model.
struct Objective<'g, 'm, 'r, 'd> {
    descent: &'g Descent<'m, 'r, 'd>,
    noise: &'g Noise,
    /// The given sensitivities, whitened, and their products.
    known: Option<(DMatrix<f64>, Sparse)>,
}

/// An iterate.
struct Iterate<'w, 'g, 'm, 'r, 'd> {
    objective: &'w Objective<'g, 'm, 'r, 'd>,
    evaluation: Evaluation,
    /// The whitened residual.
    white: Vec<f64>,
    cost: f64,
    failure: Option<ModelError>,
}

impl Iterate<'_, '_, '_, '_, '_> {
    fn next(&self, to: &[f64]) -> Option<Self> {
        let Objective { descent, noise, .. } = self.objective;
        let mut evaluation = Evaluation::new(descent.model, to.to_vec()).ok()?;
        let white = noise.whiten(descent.model.free_run.data, &evaluation.residual);
        let cost = 0.5 * dot(&white, &white);
        if (0.0..0.5 * FIT_TOLERANCE).contains(&(self.cost - cost)) {
            evaluation.sensitivities.clone_from(&self.evaluation.sensitivities);
        }
        Some(Self { objective: self.objective, evaluation, white, cost, failure: None })
    }

    fn sensitivities(&mut self) -> Result<Arc<Vec<Column>>, ModelError> {
        if let Some(known) = &self.evaluation.sensitivities {
            return Ok(Arc::clone(known));
        }
        let Objective { descent: Descent { model, slots, .. }, known, .. } = self.objective;
        let Evaluation { values, predicted, .. } = &self.evaluation;
        let given = known.is_some().then_some(&[][..]);
        let columns = Arc::new(model.columns(values, predicted, slots, given)?);
        self.evaluation.sensitivities = Some(Arc::clone(&columns));
        Ok(columns)
    }
}

impl Point for Iterate<'_, '_, '_, '_, '_> {
    fn position(&self) -> &[f64] {
        &self.evaluation.values
    }

    fn cost(&self) -> f64 {
        self.cost
    }

    fn derivatives(&mut self) -> Option<Derivatives> {
        let columns = self.sensitivities().map_err(|failure| self.failure = Some(failure)).ok()?;
        let own = whitened(self.objective.noise, self.objective.descent.model.free_run.data, &columns);
        Some(match &self.objective.known {
            Some((products, known)) => bordered(known, products, &own, &self.white),
            None => {
                Derivatives { information: own.products(), right: DVector::from_vec(own.dots(&self.white)) }
            }
        })
    }
}

/// Whitened columns.
fn whitened(noise: &Noise, data: &Data, columns: &[Column]) -> Sparse {
    Sparse::new(columns.par_iter().map(|c| noise.whiten(data, &data.filled(c))).collect())
}

/// Information matrix and gradient, when the products of the first columns are known.
fn bordered(known: &Sparse, known_products: &DMatrix<f64>, own: &Sparse, white: &[f64]) -> Derivatives {
    let (k, n) = (known.columns().len(), known.columns().len() + own.columns().len());
    let mut information = DMatrix::zeros(n, n);
    information.view_mut((0, 0), (k, k)).copy_from(known_products);
    information.view_mut((k, k), (n - k, n - k)).copy_from(&own.products());
    information.view_mut((k, 0), (n - k, k)).copy_from(&own.products_with(known));
    information.fill_upper_triangle_with_lower_triangle();
    let gradient = known.dots(white).into_iter().chain(own.dots(white));
    Derivatives { information, right: DVector::from_iterator(n, gradient) }
}
