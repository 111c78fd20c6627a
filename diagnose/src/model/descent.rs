//! Descent of a fit to the optimum under a given noise model.

use std::ops::ControlFlow;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use whirlstand_ident::identify::search::{Derivatives, Limits, Point, search};

use crate::data::record::Data;
use crate::model::columns::{Column, Slot, blocks, dot, dots, products};
use crate::model::fit::Model;
use crate::model::free_run::ModelError;
use crate::model::noise::Noise;
use crate::thresholds::{DESCENT_LIMITS, FIT_TOLERANCE};

/// Values of a model with what they predict.
pub(super) struct Place {
    pub values: Vec<f64>,
    /// Predicted samples.
    pub predicted: Vec<f64>,
    /// Measured minus predicted, with gaps filled.
    pub residual: Vec<f64>,
    /// Sensitivities that were computed here, or so near that they are the same: to the parameters, and to the initial
    /// state where it was not given. Another noise model does not change them.
    sensitivities: Option<Arc<Vec<Column>>>,
}

impl Place {
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
pub(super) struct Descent<'m, 'r, 'd> {
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

    /// The lowest place that is reached from `start` under `noise`. `initial` are sensitivities to the initial state,
    /// the same in every step.
    pub fn lowest(
        &mut self,
        start: Place,
        noise: &Noise,
        initial: Option<&[Column]>,
    ) -> Result<Place, ModelError> {
        let white = noise.whiten(self.model.free_run.data, &start.residual);
        let known = initial.map(|columns| whitened(noise, self.model.free_run.data, columns));
        let known = known.map(|white| (products(&white), white));
        let ground = Ground { descent: self, noise, known };
        let start =
            OnWay { ground: &ground, cost: 0.5 * dot(&white, &white), place: start, white, failure: None };
        let (lowest, outcome) = search(
            start,
            &self.bounds,
            self.limits,
            |from, to, _| from.next(to),
            |_, _| ControlFlow::Continue(()),
        );
        let OnWay { place, failure, .. } = lowest;
        // Directions that the data hardly determine are descended as the damping falls, from one noise model to the next.
        self.limits.damping = outcome.damping;
        failure.map_or(Ok(place), Err)
    }
}

/// What stays the same along a descent.
struct Ground<'g, 'm, 'r, 'd> {
    descent: &'g Descent<'m, 'r, 'd>,
    noise: &'g Noise,
    /// The given sensitivities, whitened, and their products.
    known: Option<(DMatrix<f64>, Vec<Vec<f64>>)>,
}

/// A place on the way down.
struct OnWay<'w, 'g, 'm, 'r, 'd> {
    ground: &'w Ground<'g, 'm, 'r, 'd>,
    place: Place,
    /// The whitened residual.
    white: Vec<f64>,
    cost: f64,
    failure: Option<ModelError>,
}

impl OnWay<'_, '_, '_, '_, '_> {
    fn next(&self, to: &[f64]) -> Option<Self> {
        let Ground { descent, noise, .. } = self.ground;
        let mut place = Place::new(descent.model, to.to_vec()).ok()?;
        let white = noise.whiten(descent.model.free_run.data, &place.residual);
        let cost = 0.5 * dot(&white, &white);
        if (0.0..0.5 * FIT_TOLERANCE).contains(&(self.cost - cost)) {
            place.sensitivities.clone_from(&self.place.sensitivities);
        }
        Some(Self { ground: self.ground, place, white, cost, failure: None })
    }

    fn sensitivities(&mut self) -> Result<Arc<Vec<Column>>, ModelError> {
        if let Some(known) = &self.place.sensitivities {
            return Ok(Arc::clone(known));
        }
        let Ground { descent: Descent { model, slots, .. }, known, .. } = self.ground;
        let Place { values, predicted, .. } = &self.place;
        let given = known.is_some().then_some(&[][..]);
        let columns = Arc::new(model.columns(values, predicted, slots, given)?);
        self.place.sensitivities = Some(Arc::clone(&columns));
        Ok(columns)
    }
}

impl Point for OnWay<'_, '_, '_, '_, '_> {
    fn position(&self) -> &[f64] {
        &self.place.values
    }

    fn cost(&self) -> f64 {
        self.cost
    }

    fn derivatives(&mut self) -> Option<Derivatives> {
        let columns = self.sensitivities().map_err(|failure| self.failure = Some(failure)).ok()?;
        let own = whitened(self.ground.noise, self.ground.descent.model.free_run.data, &columns);
        Some(match &self.ground.known {
            Some((products, known)) => bordered(known, products, &own, &self.white),
            None => {
                Derivatives { information: products(&own), right: DVector::from_vec(dots(&own, &self.white)) }
            }
        })
    }
}

/// Whitened columns.
pub(super) fn whitened(noise: &Noise, data: &Data, columns: &[Column]) -> Vec<Vec<f64>> {
    columns.par_iter().map(|c| noise.whiten(data, &data.filled(c))).collect()
}

/// Information matrix and gradient, when the products of the first columns are known.
fn bordered(
    known: &[Vec<f64>],
    known_products: &DMatrix<f64>,
    own: &[Vec<f64>],
    white: &[f64],
) -> Derivatives {
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
    Derivatives { information, right: DVector::from_iterator(n, gradient) }
}
