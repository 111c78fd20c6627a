//! Fits of a model: descents under one noise model by the engine of the identification, in turns with fits of the
//! noise model.

use std::ops::ControlFlow;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use whirlstand_ident::identify::normal::pseudo_inverse;
use whirlstand_ident::identify::search::{Derivatives, Limits, Point, search};

use crate::data::record::Data;
use crate::model::columns::{Column, Slot, blocks, dot, dots, products};
use crate::model::fit::{Effort, Fit, Model, Optimum};
use crate::model::free_run::ModelError;
use crate::model::noise::Noise;
use crate::thresholds::{FIT_LIMITS, FIT_TOLERANCE};

impl Model<'_, '_> {
    /// Fits all values to the optimum, alternating with the noise model. `initial` are sensitivities to the
    /// initial state from a model nearby: they guide the search, and the result does not depend on them.
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

    /// Searches the optimum, in turns with the noise model. There are no columns where the values have moved
    /// since the last ones.
    fn search(
        &self,
        start: Vec<f64>,
        noise: Option<&Noise>,
        initial: Option<&[Column]>,
        effort: Effort,
    ) -> Result<Fit, ModelError> {
        let data = self.free_run.data;
        let (rounds, steps) = effort.rounds();
        let slots = self.slots();
        let values = start.iter().zip(&slots).map(|(v, s)| v.clamp(s.lower, s.upper)).collect();
        let mut best = Run::new(self, values)?;
        let again =
            |residual: &[f64]| noise.map_or_else(|| Noise::fit(data, residual), |n| n.again(data, residual));
        let mut profile = again(&best.residual);
        let mut used = noise.cloned().unwrap_or_else(|| profile.noise.clone());
        for _ in 0..rounds {
            best = Descent::new(self, &slots, &used, initial).lowest(best, steps)?;
            let next = again(&best.residual);
            let gain = next.log_likelihood - profile.log_likelihood;
            let same = next.noise == used;
            profile = next;
            used = profile.noise.clone();
            if same || gain.abs() < FIT_TOLERANCE || self.free_run.is_stopped() {
                break;
            }
        }
        let own = best.columns.into_iter().flatten();
        let columns = initial.unwrap_or_default().iter().cloned().chain(own).collect::<Vec<_>>();
        let columns = if columns.len() == best.values.len() { columns } else { Vec::new() };
        Ok(Fit { values: best.values, predicted: best.predicted, residual: best.residual, profile, columns })
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

/// A model's run over the record at some values.
#[derive(Debug)]
struct Run {
    values: Vec<f64>,
    predicted: Vec<f64>,
    /// Measured minus predicted, with gaps filled.
    residual: Vec<f64>,
    /// Sensitivities to the values whose own are not given, unless the values have moved since.
    columns: Option<Vec<Column>>,
}

impl Run {
    /// The run at `values`.
    fn new(model: &Model, values: Vec<f64>) -> Result<Self, ModelError> {
        let predicted = model.predict(&values)?;
        let residual = model.free_run.data.residual(&predicted);
        Ok(Self { values, predicted, residual, columns: None })
    }
}

/// The search for the likeliest values of a model under one noise model.
struct Descent<'m> {
    model: &'m Model<'m, 'm>,
    slots: &'m [Slot],
    noise: &'m Noise,
    /// Whitened sensitivities that are given, and their products: they are the same in every step.
    given: Option<(DMatrix<f64>, Vec<Vec<f64>>)>,
}

impl<'m> Descent<'m> {
    /// A descent with given sensitivities to the initial state, or with none.
    fn new(
        model: &'m Model<'m, 'm>,
        slots: &'m [Slot],
        noise: &'m Noise,
        initial: Option<&[Column]>,
    ) -> Self {
        let given = initial.map(|columns| whitened(noise, model.free_run.data, columns));
        Self { model, slots, noise, given: given.map(|white| (products(&white), white)) }
    }

    /// The likeliest run, after at most so many steps.
    ///
    /// # Errors
    /// When a sensitivity cannot be simulated.
    fn lowest(&self, start: Run, steps: usize) -> Result<Run, ModelError> {
        let bounds: Vec<(f64, f64)> = self.slots.iter().map(|s| (s.lower, s.upper)).collect();
        let limits = Limits { iterations: steps, ..FIT_LIMITS };
        let observe = |_, _| match self.model.free_run.is_stopped() {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        };
        let (best, _) = search(self.weighed(start), &bounds, limits, Weighed::moved, observe);
        best.failed.map_or(Ok(best.run), Err)
    }

    fn weighed(&self, run: Run) -> Weighed<'_> {
        let white = self.noise.whiten(self.model.free_run.data, &run.residual);
        let cost = 0.5 * dot(&white, &white);
        Weighed { descent: self, run, white, cost, failed: None }
    }

    fn columns(&self, run: &Run) -> Result<Vec<Column>, ModelError> {
        match self.given {
            Some(_) => self.model.own_columns(&run.values, &run.predicted, self.slots),
            None => self.model.columns(&run.values, &run.predicted, self.slots, None),
        }
    }
}

/// A run and its negative log-likelihood, up to a constant.
struct Weighed<'d> {
    descent: &'d Descent<'d>,
    run: Run,
    white: Vec<f64>,
    cost: f64,
    failed: Option<ModelError>,
}

impl Weighed<'_> {
    fn moved(from: &Self, values: &[f64], _: &DVector<f64>) -> Option<Self> {
        let mut to = from.descent.weighed(Run::new(from.descent.model, values.to_vec()).ok()?);
        // Another noise model does not change sensitivities, and a converged step hardly does.
        if (0.0..FIT_LIMITS.gain).contains(&(from.cost - to.cost)) {
            to.run.columns.clone_from(&from.run.columns);
        }
        Some(to)
    }
}

impl Point for Weighed<'_> {
    fn position(&self) -> &[f64] {
        &self.run.values
    }

    fn cost(&self) -> f64 {
        self.cost
    }

    fn derivatives(&mut self) -> Option<Derivatives> {
        let Descent { model, noise, given, .. } = self.descent;
        let known = self.run.columns.take().map_or_else(|| self.descent.columns(&self.run), Ok);
        let columns = known.map_err(|error| self.failed = Some(error)).ok()?;
        let own = whitened(noise, model.free_run.data, &columns);
        self.run.columns = Some(columns);
        let (information, right) = match given {
            Some((products, given)) => bordered(given, products, &own, &self.white),
            None => normal(&own, &self.white),
        };
        Some(Derivatives { information, right })
    }
}

/// Columns whitened by a noise model.
fn whitened(noise: &Noise, data: &Data, columns: &[Column]) -> Vec<Vec<f64>> {
    columns.par_iter().map(|c| noise.whiten(data, &data.filled(c))).collect()
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
