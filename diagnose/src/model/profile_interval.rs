//! Confidence intervals from the profile of the likelihood.
//!
//! An interval holds every value that a likelihood ratio test does not reject, all other values fitted anew (Venzon and
//! Moolgavkar 1988; Pawitan, In All Likelihood, 2001, section 3.4). Multiples of the standard error to either side are
//! its approximation where the log-likelihood is a parabola: that is checked at their ends, and where it holds they are
//! the answer. It does not hold for a pulse shorter than the vehicle's response, of which a record determines only the
//! area; for a limit that a record reaches in a few samples; and for a value at the end of its range, where the
//! standard error is zero and the value is anything but certain.

use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::model::fit::{Effort, Fit, Model};
use crate::thresholds::{INTERVAL_EVALUATIONS, INTERVAL_SIGMAS, PARABOLA_TOLERANCE};

impl<'r, 'd> Model<'r, 'd> {
    /// Lower and upper ends of the 95 % intervals of a term's values, then of those that it keeps fixed: what is left
    /// out of a hypothesis is not known any better than what is in it.
    pub fn intervals(&self, fit: &Fit, term: usize) -> Vec<(f64, f64)> {
        let (freed, fit) = self.freed(fit, term);
        let covariance = freed.covariance(&fit).ok();
        let interval = |own: usize| {
            let likelihood = ProfileLikelihood::new(&freed, &fit, covariance.as_ref(), term, own);
            rayon::join(|| likelihood.end(-1.0), || likelihood.end(1.0))
        };
        (0..freed.terms[term].tunables.len()).into_par_iter().map(interval).collect()
    }

    /// This model with all values of a term free.
    fn freed(&self, fit: &Fit, term: usize) -> (Self, Fit) {
        let (mut freed, mut fit) = (self.clone(), fit.clone());
        let end = self.range(term).end;
        let candidate = &mut freed.terms[term];
        let (tunables, values): (Vec<_>, Vec<_>) = std::mem::take(&mut candidate.fixed).into_iter().unzip();
        candidate.tunables.extend(tunables);
        fit.values.splice(end..end, values);
        (freed, fit)
    }
}

/// The likelihood as a function of one value, all others at their best.
struct ProfileLikelihood<'m, 'r, 'd> {
    model: &'m Model<'r, 'd>,
    fit: &'m Fit,
    /// Index of the value among those of the term, and among all.
    own: usize,
    index: usize,
    term: usize,
    /// Standard error of the value, and how the best of all values moves with it.
    error: f64,
    direction: Vec<f64>,
}

impl<'m, 'r, 'd> ProfileLikelihood<'m, 'r, 'd> {
    fn new(
        model: &'m Model<'r, 'd>,
        fit: &'m Fit,
        covariance: Option<&DMatrix<f64>>,
        term: usize,
        own: usize,
    ) -> Self {
        let index = model.range(term).start + own;
        let variance = covariance.map_or(0.0, |c| c[(index, index)]).max(0.0);
        let mut direction = vec![0.0; fit.values.len()];
        if let (Some(covariance), true) = (covariance, variance > 0.0) {
            direction.iter_mut().enumerate().for_each(|(i, d)| *d = covariance[(i, index)] / variance);
        }
        direction[index] = 1.0;
        Self { model, fit, own, index, term, error: variance.sqrt(), direction }
    }

    /// All values when this one is `at`, as the parabola has them, within their ranges.
    fn along(&self, at: f64) -> Vec<f64> {
        let distance = at - self.fit.values[self.index];
        let moved = self.fit.values.iter().zip(&self.direction).map(|(v, d)| v + distance * d);
        let slots = self.model.slots();
        moved.zip(slots).map(|(v, slot)| v.clamp(slot.lower, slot.upper)).collect()
    }

    /// Distance from the optimum in standard deviations: the root of twice the loss in log-likelihood. What cannot be
    /// simulated is beyond all bounds.
    fn sigmas(&self, log_likelihood: Option<f64>) -> f64 {
        let lost = log_likelihood.map(|l| 2.0 * (self.fit.profile.log_likelihood - l));
        lost.filter(|lost| lost.is_finite()).map_or(f64::INFINITY, |lost| lost.max(0.0).sqrt())
    }

    /// Distance of the values on the parabola.
    fn sigmas_along(&self, at: f64) -> f64 {
        let data = self.model.free_run.data;
        let predicted = self.model.predict(&self.along(at)).ok();
        let profile = predicted.map(|p| self.fit.profile.noise.again(data, &data.residual(&p)));
        self.sigmas(profile.map(|profile| profile.log_likelihood))
    }

    /// Distance of the best values when this one is `at`.
    fn sigmas_at(&self, at: f64) -> f64 {
        let mut pinned = self.model.clone();
        let candidate = &mut pinned.terms[self.term];
        let tunable = candidate.tunables.remove(self.own);
        candidate.fixed.push((tunable, at));
        let mut start = self.along(at);
        start.remove(self.index);
        let initial = self.fit.columns.get(..self.model.states());
        let optimum = pinned.optimum(start, Some(&self.fit.profile.noise), initial, Effort::Glance).ok();
        self.sigmas(optimum.map(|optimum| optimum.profile.log_likelihood))
    }

    /// The end of the interval on the side of `sign`.
    fn end(&self, sign: f64) -> f64 {
        let (value, tunable) = (self.fit.values[self.index], &self.model.terms[self.term].tunables[self.own]);
        let bound = if sign < 0.0 { tunable.lower } else { tunable.upper };
        let within = |at: f64| if sign < 0.0 { at.max(bound) } else { at.min(bound) };
        if value == bound {
            return bound;
        }
        let mut at = within(value + sign * INTERVAL_SIGMAS * self.error);
        if self.error > 0.0 {
            let along = self.sigmas_along(at) / INTERVAL_SIGMAS;
            if at != bound && (along - 1.0).abs() < PARABOLA_TOLERANCE || at == bound && along < 1.0 {
                return at;
            }
        } else {
            at = if bound.is_finite() { bound } else { value + sign * tunable.scale };
        }
        // Distances grow almost in proportion to the change of the value: the end is found by dividing.
        let (mut inside, mut outside) = ((value, 0.0), None);
        for _ in 0..INTERVAL_EVALUATIONS {
            let sigmas = self.sigmas_at(at) / INTERVAL_SIGMAS;
            if sigmas < 1.0 && at == bound {
                return bound;
            }
            if (sigmas - 1.0).abs() < PARABOLA_TOLERANCE {
                return at;
            }
            if sigmas < 1.0 {
                inside = (at, sigmas);
            } else {
                outside = Some((at, sigmas));
            }
            at = match outside {
                None => within(value + (at - value) * (1.0 / sigmas).min(3.0)),
                Some((out, beyond)) => {
                    // Where the record shows nothing at all, or no vehicle is possible, there is no proportion.
                    let is_curved = inside.1 > 0.0 && beyond.is_finite();
                    let share = if is_curved { (1.0 - inside.1) / (beyond - inside.1) } else { 0.5 };
                    let share = share.clamp(0.1, 0.9);
                    inside.0 + share * (out - inside.0)
                }
            };
        }
        outside.map_or(inside.0, |(out, _)| out)
    }
}
