//! Fits of one decoupled part of a vehicle.
//!
//! Where an axis is decoupled from the others, a cause on it changes nothing for them: beside a fit of all axes, only
//! its own is fitted again. The likelihood is a sum over the channels, each with a noise model of its own, so that
//! the parts' optima together are the optimum of the whole.

use std::ops::Range;
use std::sync::Arc;

use whirlstand_vehicle::{Effect, Free};

use crate::candidates::library::Candidate;
use crate::model::columns::Column;
use crate::model::fit::{Effort, Fit, Model};
use crate::model::free_run::FreeRun;
use crate::model::noise::{Noise, Profile};
use crate::model::optimum::{ModelError, Optimum};
use crate::model::part::{Memo, Part, Start};
use crate::model::reach::Reach;

/// A model of one part, with where its values and samples are in those of the whole.
struct Within {
    part: Arc<Part>,
    /// The term that was added or removed, at its place in the part.
    changed: Candidate,
    free: Vec<Free>,
    terms: Vec<Candidate>,
    /// Index in the whole of every value.
    values: Vec<usize>,
    /// Sample ranges in the whole of its channels.
    ranges: Vec<Range<usize>>,
}

impl Model<'_, '_> {
    /// The optimum as by [`Model::optimum`], beside a `fit` at its optimum of the same model with or without a term.
    /// `others` are the values in that fit of all parameters of this model; those of parts on which the `changed` term
    /// does not act stay. `initial` as in [`Model::fit`].
    ///
    /// # Errors
    /// As [`Model::optimum`].
    pub fn optimum_beside(
        &self,
        fit: &Fit,
        changed: (&Candidate, &[f64]),
        (start, others): (&[f64], Vec<f64>),
        initial: Option<&[Column]>,
        effort: Effort,
    ) -> Result<Optimum, ModelError> {
        let noise = fit.profile.noise.shared();
        let within = if noise.is_none() { self.within(changed, start) } else { None };
        let Some(within) = within else { return self.optimum(start.to_vec(), noise, initial, effort) };
        let free_run = self.free_run.of_part(&within.part);
        let model = within.model(&free_run);
        let initial = initial.map(|columns| -> Vec<Column> {
            let states = &within.values[..model.states()];
            states.iter().map(|i| Arc::new(within.samples(&columns[*i]))).collect()
        });
        let own = within.own(start);
        // The fit beside which it starts may have other values, and other sensitivities with them.
        let beside = within.own(&others);
        let variant = u8::from(initial.is_some()) + 2 * u8::from(effort == Effort::Full);
        let found = within.part.fits.once(
            Start::new(own.iter().chain(&beside), variant),
            (model.free, &model.terms),
            || model.optimum(own, None, initial.as_deref(), effort),
        )?;
        let mut values = others;
        within.values.iter().zip(&found.values).for_each(|(i, value)| values[*i] = *value);
        let before = Noise::fit(&within.part.data, &within.samples(&fit.residual));
        Ok(Optimum { values, profile: within.joined(&fit.profile, &before, found.profile) })
    }

    /// The fit at an optimum as by [`Model::at`], beside a `fit` of the same model with or without the `changed` term, whose
    /// values begin at index `at`: only what it affects is computed again.
    ///
    /// # Errors
    /// As [`Model::at`].
    pub fn at_beside(
        &self,
        fit: &Fit,
        (changed, own): (&Candidate, &[f64]),
        at: usize,
        optimum: &Optimum,
    ) -> Result<Fit, ModelError> {
        let initial = &fit.columns[..self.states()];
        let within = if fit.profile.noise.shared().is_none() {
            self.within((changed, own), &optimum.values)
        } else {
            None
        };
        let Some(within) = within else { return self.at(optimum, initial) };
        let free_run = self.free_run.of_part(&within.part);
        let model = within.model(&free_run);
        let values = within.own(&optimum.values);
        let states = within.values[..model.states()].iter();
        let initial: Vec<Column> = states.map(|i| Arc::new(within.samples(&fit.columns[*i]))).collect();
        let part = model.at(&Optimum { values, profile: optimum.profile.clone() }, &initial)?;
        let mut predicted = fit.predicted.clone();
        within.put(&part.predicted, &mut predicted);
        let added = self.terms.contains(changed);
        let before = |i: usize| match (i < at, added) {
            (true, _) => i,
            (false, true) => i - own.len(),
            (false, false) => i + own.len(),
        };
        let column = |i: usize| match within.values.iter().position(|of_part| *of_part == i) {
            Some(of_part) if i >= self.states() => {
                let mut column = vec![0.0; predicted.len()];
                within.put(&part.columns[of_part], &mut column);
                Arc::new(column)
            }
            _ => Arc::clone(&fit.columns[before(i)]),
        };
        let columns = (0..optimum.values.len()).map(column).collect();
        let residual = self.free_run.data.residual(&predicted);
        let Optimum { values, profile } = optimum.clone();
        Ok(Fit { values, predicted, residual, profile, columns })
    }

    /// Change of the predicted samples when an effect is added to this model at its fit.
    ///
    /// # Errors
    /// When the effect does not fit, or the run diverges.
    pub fn change(&self, fit: &Fit, candidate: &Candidate, own: &[f64]) -> Result<Vec<f64>, ModelError> {
        self.change_of(Some(&fit.predicted), &fit.values, (candidate, own))
    }

    /// Change of the predicted samples when an effect is added to this model at these values, where it predicts
    /// `predicted`.
    ///
    /// # Errors
    /// When the effect does not fit, or a run diverges.
    pub fn change_of(
        &self,
        predicted: Option<&[f64]>,
        values: &[f64],
        (candidate, own): (&Candidate, &[f64]),
    ) -> Result<Vec<f64>, ModelError> {
        let extended = |mut model: Model<'_, '_>, candidate: &Candidate, values: &[f64]| {
            model.terms.push(candidate.clone());
            model.predict(&[values, own].concat())
        };
        let less = |mut samples: Vec<f64>, before: &[f64]| {
            samples.iter_mut().zip(before).for_each(|(y, p)| *y -= p);
            samples
        };
        let Some(within) = self.within((candidate, own), values) else {
            let samples = extended(self.clone(), candidate, values)?;
            return Ok(match predicted {
                Some(predicted) => less(samples, predicted),
                None => less(samples, &self.predict(values)?),
            });
        };
        let free_run = self.free_run.of_part(&within.part);
        let (model, values) = (within.model(&free_run), within.own(values));
        let before = match predicted {
            Some(predicted) => within.samples(predicted),
            None => model.predict(&values)?,
        };
        let mut samples = vec![0.0; self.free_run.data.ranges().last().map_or(0, |range| range.end)];
        within.put(&less(extended(model, &within.changed, &values)?, &before), &mut samples);
        Ok(samples)
    }

    /// What `make` gives for a candidate beside the fit of this model, made once while the part on which it acts stays the
    /// same; `variant` distinguishes calls that give something else.
    pub fn once<T: Clone>(
        &self,
        fit: &Fit,
        candidate: &Candidate,
        (memo, variant): (impl Fn(&Part) -> &Memo<T>, u8),
        make: impl FnOnce() -> T,
    ) -> T {
        let own = candidate.starts.first().filter(|_| fit.profile.noise.shared().is_none());
        let Some(within) = own.and_then(|own| self.within((candidate, own), &fit.values)) else {
            return make();
        };
        let start = Start::new(&within.own(&fit.values), variant);
        let terms = [within.terms.as_slice(), std::slice::from_ref(candidate)].concat();
        memo(&within.part).once(start, (&within.free, &terms), make)
    }

    /// The model of the part on which a term acts, beside the terms at these values; `None` where that is the whole.
    fn within(&self, (changed, own): (&Candidate, &[f64]), values: &[f64]) -> Option<Within> {
        let free_run = self.free_run;
        if free_run.is_coupled() {
            return None;
        }
        let effect = changed.effect(own)?;
        let mut whole = self.vehicle(values).ok()?;
        if !self.terms.contains(changed) {
            whole.add_effect(effect.clone()).ok()?;
        }
        let reach = Reach::new(&whole, free_run.data, self.free.iter().map(|free| &free.target));
        let subsystem = reach.part_around(reach.of_effect(&effect, &whole))?;
        if subsystem.inputs.is_empty() {
            return None;
        }
        let part = free_run.part(&subsystem);
        let n = self.states() / free_run.data.starts.len().max(1);
        let records = (0..free_run.data.starts.len()).map(|record| record * n);
        let mut places: Vec<usize> =
            records.flat_map(|first| subsystem.states.iter().map(move |state| first + state)).collect();
        let mut free = Vec::new();
        for (i, of_whole) in self.free.iter().enumerate() {
            if let Some(of_part) = subsystem.free(of_whole, &free_run.vehicle) {
                free.push(of_part);
                places.push(self.states() + i);
            }
        }
        let of_part = |term: &Candidate, effect: &Effect| {
            let place = subsystem.effect(effect, &whole)?.place().into();
            Some(Candidate { place, ..term.clone() })
        };
        let mut terms = Vec::new();
        for (t, term) in self.terms.iter().enumerate() {
            if let Some(term) = of_part(term, &term.effect(&values[self.range(t)])?) {
                terms.push(term);
                places.extend(self.range(t));
            }
        }
        let ranges = free_run.data.ranges();
        let ranges = part.channels.iter().map(|c| ranges[*c].clone()).collect();
        let changed = of_part(changed, &effect)?;
        Some(Within { part, changed, free, terms, values: places, ranges })
    }
}

impl Within {
    /// The model over free runs of the part.
    fn model<'w>(&'w self, free_run: &'w FreeRun<'w>) -> Model<'w, 'w> {
        Model { free_run, free: &self.free, terms: self.terms.clone() }
    }

    /// The part's values among those of the whole.
    fn own(&self, of_whole: &[f64]) -> Vec<f64> {
        self.values.iter().map(|i| of_whole[*i]).collect()
    }

    /// The part's samples among those of the whole.
    fn samples(&self, of_whole: &[f64]) -> Vec<f64> {
        self.ranges.iter().flat_map(|range| &of_whole[range.clone()]).copied().collect()
    }

    /// Puts samples of the part in their places in the whole.
    fn put(&self, own: &[f64], whole: &mut [f64]) {
        let mut own = own.iter();
        for range in &self.ranges {
            whole[range.clone()].iter_mut().zip(&mut own).for_each(|(of_whole, own)| *of_whole = *own);
        }
    }

    /// The whole's profile with that of the part in place of what it was before.
    fn joined(&self, whole: &Profile, before: &Profile, after: Profile) -> Profile {
        let mut all = whole.clone();
        let own = after.noise.channels.into_iter().zip(after.noise.total);
        for (c, (channel, total)) in self.part.channels.iter().zip(own) {
            all.noise.channels[*c] = channel;
            all.noise.total[*c] = total;
        }
        all.log_likelihood += after.log_likelihood - before.log_likelihood;
        all.parameters = all.parameters + after.parameters - before.parameters;
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidates::library::{Sizes, library};
    use crate::data::flown::flown;
    use crate::data::record::Data;
    use whirlstand_vehicle::{Kind, Matrix, Target, Vehicle};

    /// Two decoupled axes, roll with its angle; a free entry on each, and a free effect on one.
    fn two_axes() -> Vehicle {
        let text = "A = [[-2.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -4.0, -1.0]]\n\
                    B = [[0.0, 5.0], [0.0, 0.0], [3.0, 0.0]]\n\
                    C = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]\n\
                    states = [{ name = \"r\" }, { name = \"phi\" }, { name = \"p\" }]\n\
                    inputs = [{ name = \"u_roll\" }, { name = \"u_yaw\" }]\n\
                    outputs = [{ name = \"roll\" }, { name = \"yaw_rate\" }, { name = \"roll_rate\" }]\n\
                    [[effects]]\neffect = \"actuator_lag\"\nwhere = \"u_yaw\"\ntime_constant_s = 0.1\n";
        let mut vehicle = Vehicle::parse(text, "axes.toml").unwrap();
        vehicle.outputs.iter_mut().for_each(|output| output.noise = 0.02);
        let lag = Target::Effect(0, "time_constant_s");
        let open =
            [(Target::Entry(Matrix::A, 0, 0), -9.0), (Target::Entry(Matrix::A, 2, 2), -9.0), (lag, 0.01)];
        let free = open.map(|(target, lower)| Free { target, lower, upper: 1.0, start: None });
        vehicle.free = free.into();
        vehicle
    }

    /// A fit of one axis beside the other is the fit of both, whether the vehicle runs free or follows the record, also
    /// where a cause couples the axes.
    #[test]
    fn what_is_fitted_on_one_axis_is_the_fit_of_all() {
        let vehicle = two_axes();
        let mut true_vehicle = vehicle.clone();
        let effects = [
            Effect::new(Kind::InputGain, "u_roll", &[("factor", 0.8)]).unwrap(),
            Effect::new(Kind::DeadZone, "u_yaw", &[("width", 0.1)]).unwrap(),
        ];
        effects.into_iter().for_each(|effect| true_vehicle.add_effect(effect).unwrap());
        let input = |k: usize, j: usize| if k % (70 + 30 * j) < 35 { 0.3 } else { -0.3 };
        let inputs: Vec<f64> = (0..2000).map(|at| input(at / 2, at % 2)).collect();
        let flight = flown(&true_vehicle, inputs, 5);
        let candidates = library(&vehicle, &Sizes::ones(&vehicle, 20.0, 0.02), &[0, 1, 2]);
        let candidate = |kind: Kind, place: &str| -> Candidate {
            candidates.iter().find(|c| c.kind == kind && c.place == place).unwrap().clone()
        };
        let cases = [
            (candidate(Kind::InputGain, "u_roll"), vec![0.9], 2),
            (candidate(Kind::DeadZone, "u_yaw"), vec![0.05], 1),
            (candidate(Kind::SensorScale, "yaw_rate"), vec![1.1], 1),
            (candidate(Kind::InputCoupling, "u_roll->u_yaw"), vec![0.1], 3),
        ];
        for memory_s in [None, Some(0.5)] {
            let data = Data { memory_s, ..flight.clone() };
            let free_run = FreeRun::new(&vehicle, &data);
            let mut model = Model { free_run: &free_run, free: &vehicle.free, terms: Vec::new() };
            let mut start = vec![0.0; 3];
            start.extend(vehicle.free.iter().map(|free| vehicle.free_value(&free.target)));
            // Beside a term of one axis, and without any.
            for beside in [None, Some((candidate(Kind::InputBias, "u_yaw"), 0.01))] {
                if let Some((term, value)) = beside {
                    model.terms.push(term);
                    start.push(value);
                }
                let fit = model.fit(start.clone(), None, None).unwrap();
                for (candidate, own, outputs) in &cases {
                    let what = format!("{memory_s:?}, {}, {} terms", candidate.name(), model.terms.len());
                    let within = model.within((candidate, own), &fit.values);
                    let seen = within.map_or(3, |within| within.part.subsystem.outputs.len());
                    assert_eq!(seen, *outputs, "{what}");
                    agree(&model, &fit, (candidate, own), &what);
                }
            }
        }
    }

    fn agree(model: &Model<'_, '_>, fit: &Fit, (candidate, own): (&Candidate, &[f64]), what: &str) {
        let mut extended = model.clone();
        extended.terms.push(candidate.clone());
        let start = [&fit.values, own].concat();
        let change = model.change(fit, candidate, own).unwrap();
        let all = extended.predict(&start).unwrap();
        for ((change, all), before) in change.iter().zip(&all).zip(&fit.predicted) {
            assert!((change - (all - before)).abs() < 1e-9, "{what}: {change} and {}", all - before);
        }
        let initial = &fit.columns[..model.states()];
        let whole = extended.optimum(start.clone(), None, Some(initial), Effort::Full).unwrap();
        let beside = (&start[..], start.clone());
        let part =
            extended.optimum_beside(fit, (candidate, own), beside, Some(initial), Effort::Full).unwrap();
        let gain = |optimum: &Optimum| optimum.profile.log_likelihood - fit.profile.log_likelihood;
        assert!((gain(&part) - gain(&whole)).abs() < 0.05, "{what}: {} and {}", gain(&part), gain(&whole));
        assert_eq!(part.profile.parameters, whole.profile.parameters, "{what}");
        let again = extended.at(&part, initial).unwrap();
        let profile = Noise::fit(model.free_run.data, &again.residual);
        let apart = (profile.log_likelihood - part.profile.log_likelihood).abs();
        assert!(apart < 1e-6, "{what}: the likelihood of its values is apart by {apart}");
    }
}
