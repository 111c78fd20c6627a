//! Forces outside the library: tests whether apparent turbulence, or several causes together, is a force that
//! is a function of inputs and states of a shape that the table does not name.
//!
//! Turbulence explains any slow force, as it has one value per step, and several causes together can imitate
//! a force that is none of them. A force that follows a signal has few parameters: where these explain as
//! much in BIC, the causes are not credible.

use crate::thresholds::{BASES_REFITTED, BASES_SORTED, FORCE_P_VALUE, RELAY_PARAMETERS};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use whirlstand_vehicle::Vehicle;

use crate::model::fit::{Fit, Model};
use crate::model::forced_response::Forces;
use crate::model::input_reconstruction::Entry;
use crate::model::noise::{Noise, Profile};
use crate::model::score_test::ScoreTest;
use crate::residual::axis::Axis;
use crate::residual::basis::{Basis, Recipe, Signal, Signals, scale};
use crate::residual::device_basis::{of_actuator, of_sensor};
use crate::residual::hysteresis_relay;
use crate::search::alternative::SearchSpace;
use whirlstand_ident::identify::normal::pseudo_inverse;
use whirlstand_logs::stats::chi_square_tail;

/// A force that is a function of a signal.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceOnSignal {
    /// Gain in BIC.
    pub gain: f64,
    /// Text such as "a force on roll_rate that follows roll times roll_rate".
    pub description: String,
}

/// The most likely force on a state, relative to a fit under noise models of single channels.
///
/// `None` when no basis could be tested.
pub fn on_state(
    model: &Model<'_, '_>,
    fit: &Fit,
    state: usize,
    space: &SearchSpace<'_>,
) -> Option<ForceOnSignal> {
    let vehicle = model.vehicle(&fit.values).ok()?;
    let signals =
        Signals::new(model, model.free_run.run_states(&vehicle, &fit.values[..model.states()]).ok()?);
    Comparison::new(model, fit, &vehicle, space)
        .best(Entry::State(state), &signals.all())
        .map(|(force, _)| force)
}

/// A force on the state that turbulence drives, where it follows a state so closely that no turbulence does:
/// it switches with a state, or is a periodic function of one. Its gain is the score in excess of that of
/// turbulence alone.
///
/// The states are those that the turbulence's filter predicts from earlier samples, so that a function of
/// them is independent of later innovations: under turbulence alone the score is chi-square.
pub fn beyond_turbulence(
    (model, fit): (&Model<'_, '_>, &Fit),
    state: usize,
    noise: &Noise,
    space: &SearchSpace<'_>,
) -> Option<ForceOnSignal> {
    let data = model.free_run.data;
    let common = noise.common.as_ref()?;
    let vehicle = model.vehicle(&fit.values).ok()?;
    let mut states = model.free_run.run_states(&vehicle, &fit.values[..model.states()]).ok()?;
    for (i, x) in states.iter_mut().enumerate() {
        let foretold = common.states(data, &fit.residual, i);
        x.iter_mut().skip(1).zip(foretold).for_each(|(x, moved)| *x += moved);
    }
    let signals = Signals::new(model, states);
    let score_test = ScoreTest::new(data, noise, &fit.residual, &fit.columns);
    let pushed = [(state, space.sizes.slopes[state])];
    let forces = Forces::new(model, fit, &vehicle, &pushed);
    let relay = hysteresis_relay::likeliest(&score_test, &forces, &signals.states, false)?;
    let ripples = signals.ripples();
    let functions: Vec<&[f64]> = ripples.iter().flat_map(|f| &f.functions).map(Vec::as_slice).collect();
    let mut responses = forces.each(&functions, |_, index, mut response| {
        data.fill(&mut response);
        (index, response)
    });
    responses.sort_by_key(|(index, _)| *index);
    // Two functions (sine and cosine) form one sinusoid.
    let pairs = responses.chunk_by(|(a, _), (b, _)| a / 2 == b / 2).filter(|pair| pair.len() == 2);
    let waves = pairs.filter_map(|pair| {
        let columns: Vec<Vec<f64>> = pair.iter().map(|(_, response)| response.clone()).collect();
        Some((explained(&score_test, &columns)?.0, &ripples[pair[0].0 / 2].description))
    });
    let wave = waves.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let looks = (signals.states.len() * hysteresis_relay::looks() + ripples.len()) as f64;
    let (switched, waved) = (chi_square_tail(relay.score, 1.0), chi_square_tail(wave.0, 2.0));
    let (score, description) = if switched < waved {
        (relay.score, relay.description(&signals.states))
    } else {
        (wave.0, wave.1.clone())
    };
    (looks * switched.min(waved) < FORCE_P_VALUE)
        .then(|| ForceOnSignal { gain: score, description: on(&vehicle, Entry::State(state), &description) })
}

/// Text such as "a force on roll_rate that follows pitch".
fn on(vehicle: &Vehicle, entry: Entry, description: &str) -> String {
    match entry {
        Entry::State(i) => format!("a force on {} that {description}", vehicle.states[i].name),
        Entry::Input(j) => format!("a signal added to {} that {description}", vehicle.inputs[j].name),
    }
}

/// A rival of the causes on a part of the vehicle, and the part of the samples that it explains.
pub type Rival = (ForceOnSignal, Vec<f64>);

/// The most likely force on any state of a part of the vehicle, relative to the fit of a model without causes there. The
/// signals are those of a model `with` causes, which is closer to the truth.
pub fn force(
    (model, fit): (&Model<'_, '_>, &Fit),
    (with, its): (&Model<'_, '_>, &Fit),
    axis: &Axis,
    space: &SearchSpace<'_>,
) -> Option<Rival> {
    let signals = Signals::new(
        with,
        with.free_run.run_states(&with.vehicle(&its.values).ok()?, &its.values[..with.states()]).ok()?,
    );
    let vehicle = model.vehicle(&fit.values).ok()?;
    let comparison = Comparison::new(model, fit, &vehicle, space);
    let bases = signals.of_states();
    let moved = |i: &usize| vehicle.kinematic_row(*i).is_none();
    let forces = axis.states.iter().copied().filter(moved);
    let forces = forces.flat_map(|i| {
        [comparison.best(Entry::State(i), &bases), comparison.relay(i, &signals.states)].into_iter().flatten()
    });
    likelier(forces)
}

/// The most likely error of an actuator or a sensor of a part of the vehicle, relative to the fit of a model without causes
/// there. Its signals are known, or predicted by that model.
pub fn device_error(
    (model, fit): (&Model<'_, '_>, &Fit),
    axis: &Axis,
    space: &SearchSpace<'_>,
) -> Option<Rival> {
    let vehicle = model.vehicle(&fit.values).ok()?;
    let comparison = Comparison::new(model, fit, &vehicle, space);
    let commands = Signals::new(model, Vec::new()).inputs;
    let inputs = axis.inputs.iter().copied();
    let inputs = inputs.filter_map(|j| comparison.best(Entry::Input(j), &of_actuator(&commands[j])));
    likelier(inputs.chain(comparison.error_of_sensor(&axis.channels)))
}

/// The rival with the largest gain.
pub fn likelier(rivals: impl IntoIterator<Item = Rival>) -> Option<Rival> {
    rivals.into_iter().max_by(|(a, _), (b, _)| a.gain.total_cmp(&b.gain))
}

/// A fit against which bases of forces are tested.
struct Comparison<'a, 'd> {
    model: &'a Model<'a, 'd>,
    fit: &'a Fit,
    vehicle: &'a Vehicle,
    plain: Profile,
    /// Score tests; the fastest one comes last.
    score_tests: Vec<ScoreTest<'d>>,
    slopes: &'a [f64],
}

/// A basis in a score test: its score, and the coefficients of its functions.
struct Contribution {
    energy: f64,
    by: DVector<f64>,
    /// Index of the basis.
    basis: usize,
    description: String,
}

impl<'a, 'd> Comparison<'a, 'd> {
    fn new(model: &'a Model<'a, 'd>, fit: &'a Fit, vehicle: &'a Vehicle, space: &SearchSpace<'a>) -> Self {
        let data = model.free_run.data;
        let plain = Noise::fit(data, &fit.residual);
        let mut score_tests = vec![ScoreTest::new(data, &plain.noise, &fit.residual, &fit.columns)];
        if space.declared.iter().all(|d| *d > 0.0) {
            score_tests.push(ScoreTest::new(
                data,
                &Noise::white(space.declared),
                &fit.residual,
                &fit.columns,
            ));
        }
        Self { model, fit, vehicle, plain, score_tests, slopes: &space.sizes.slopes }
    }

    /// The most likely basis, and the part of the samples that it explains.
    fn best(&self, entry: Entry, bases: &[Recipe<'_>]) -> Option<Rival> {
        // A force into an input acts on all states that the input drives.
        let pushed: Vec<(usize, f64)> = match entry {
            Entry::State(i) => vec![(i, 1.0)],
            Entry::Input(j) => {
                let column = self.vehicle.b.column(j);
                column.iter().copied().enumerate().filter(|(_, b)| *b != 0.0).collect()
            }
        };
        if pushed.is_empty() {
            return None;
        }
        let states: Vec<(usize, f64)> = pushed.iter().map(|(i, _)| (*i, self.slopes[*i])).collect();
        let forces = Forces::new(self.model, self.fit, self.vehicle, &states);
        let columns = |some: &[usize]| {
            self.columns(&forces, &pushed, some.iter().map(|basis| bases[*basis]()).collect())
        };
        let (mut force, explained) = self.weighed(bases.len(), &columns)?;
        force.description = on(self.vehicle, entry, &force.description);
        Some((force, explained))
    }

    /// The most likely error of a sensor of some channels, as [`Self::best`]. None where a filter follows the record: it
    /// follows the error as well.
    fn error_of_sensor(&self, channels: &[usize]) -> Option<Rival> {
        let data = self.model.free_run.data;
        data.memory_s.is_none().then_some(())?;
        let ranges = data.ranges();
        let of = |c: &usize| {
            let channel = &data.channels[*c];
            let mut values = self.fit.predicted[ranges[*c].clone()].to_vec();
            scale(&mut values);
            let signal = Signal { name: self.vehicle.outputs[channel.output].name.clone(), values };
            let first = |start: &usize| start.saturating_sub(channel.first).div_ceil(channel.stride);
            (signal, data.starts.iter().map(first).collect::<Vec<_>>())
        };
        let sensors: Vec<(Signal, Vec<usize>)> = channels.iter().map(of).collect();
        let bases = channels.iter().zip(&sensors);
        let bases: Vec<(usize, Recipe<'_>)> = bases
            .flat_map(|(c, (y, starts))| of_sensor(y, starts).into_iter().map(|basis| (*c, basis)))
            .collect();
        let columns = |some: &[usize]| -> Vec<Option<Responses>> {
            let column = |c: usize, function: &[f64]| {
                let mut column = vec![0.0; self.fit.predicted.len()];
                column[ranges[c].clone()].copy_from_slice(function);
                data.fill(&mut column);
                column
            };
            let responses = |basis: &usize| {
                let (c, make) = &bases[*basis];
                let Basis { description, functions } = make();
                let output = &self.vehicle.outputs[data.channels[*c].output].name;
                let description = format!("an error of the sensor of {output} that {description}");
                Some((description, functions.iter().map(|function| column(*c, function)).collect()))
            };
            some.iter().map(responses).collect()
        };
        self.weighed(bases.len(), &columns)
    }

    /// The most likely of so many bases, and the part of the samples that it explains, from their `columns`.
    fn weighed(
        &self,
        bases: usize,
        columns: &(impl Fn(&[usize]) -> Vec<Option<Responses>> + Sync),
    ) -> Option<Rival> {
        // The fastest score test preselects; the others test only the remaining bases.
        let [rest @ .., quick] = self.score_tests.as_slice() else { return None };
        let mut sorted = weights(quick, 0..bases, columns);
        self.keep(&mut sorted, BASES_SORTED);
        let mut weighed: Vec<(&ScoreTest<'_>, Contribution)> = Vec::new();
        for score_test in rest {
            let mut own = weights(score_test, sorted.iter().map(|w| w.basis), columns);
            self.keep(&mut own, BASES_REFITTED);
            weighed.extend(own.into_iter().map(|w| (score_test, w)));
        }
        self.keep(&mut sorted, BASES_REFITTED);
        weighed.extend(sorted.into_iter().map(|w| (quick, w)));
        let looks = 2.0 * (bases as f64).ln();
        let bics = weighed.into_par_iter().filter_map(|(score_test, weight)| {
            let mut explained = vec![0.0; self.fit.residual.len()];
            let basis = columns(&[weight.basis]).pop().flatten()?;
            for (column, by) in basis.1.iter().zip(weight.by.iter()) {
                explained.iter_mut().zip(column).for_each(|(e, c)| *e += by * c);
            }
            let bic = self.bic(score_test, &explained, weight.by.len());
            Some((bic, weight.description, explained))
        });
        let (bic, description, explained) = bics.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((ForceOnSignal { gain: self.plain.bic(0) - bic - looks, description }, explained))
    }

    /// BIC of what is left when this part of the samples is explained by as many parameters.
    fn bic(&self, score_test: &ScoreTest<'_>, explained: &[f64], parameters: usize) -> f64 {
        let rest: Vec<f64> = self.fit.residual.iter().zip(explained).map(|(r, e)| r - e).collect();
        Noise::fit(self.model.free_run.data, &score_test.without_nuisances(&rest)).bic(parameters)
    }

    /// The most likely force that switches with a state, and the part of the samples that it explains.
    fn relay(&self, state: usize, states: &[Signal]) -> Option<Rival> {
        let pushed = [(state, self.slopes[state])];
        let forces = Forces::new(self.model, self.fit, self.vehicle, &pushed);
        let looks = 2.0 * ((states.len() * hysteresis_relay::looks()) as f64).ln();
        let bics = self.score_tests.iter().filter_map(|score_test| {
            let relay = hysteresis_relay::likeliest(score_test, &forces, states, true)?;
            let explained = relay.response(score_test, &forces, states)?;
            let bic = self.bic(score_test, &explained, 1 + RELAY_PARAMETERS);
            Some((bic, relay.description(states), explained))
        });
        let (bic, description, explained) = bics.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let description = on(self.vehicle, Entry::State(state), &description);
        Some((ForceOnSignal { gain: self.plain.bic(0) - bic - looks, description }, explained))
    }

    /// Keeps the contributions with the largest gain, each parameter penalised.
    fn keep(&self, weights: &mut Vec<Contribution>, most: usize) {
        let worth = |w: &Contribution| w.energy - w.by.len() as f64 * (self.plain.rows as f64).ln();
        weights.sort_by(|a, b| worth(b).total_cmp(&worth(a)));
        weights.truncate(most);
    }

    /// Description of each basis, and the responses of the samples to its functions; `None` where one could not be
    /// simulated.
    fn columns(
        &self,
        forces: &Forces<'_>,
        pushed: &[(usize, f64)],
        bases: Vec<Basis>,
    ) -> Vec<Option<Responses>> {
        let values: Vec<&[f64]> = bases.iter().flat_map(|b| &b.functions).map(Vec::as_slice).collect();
        let mut sums: Vec<(usize, Vec<f64>)> = vec![(0, Vec::new()); values.len()];
        for (state, index, mut response) in
            forces.each(&values, |state, index, response| (state, index, response))
        {
            let by = pushed.iter().find(|(i, _)| *i == state).map_or(0.0, |(_, by)| *by);
            response.iter_mut().for_each(|r| *r *= by);
            let (told, sum) = &mut sums[index];
            if *told == 0 {
                *sum = response;
            } else {
                sum.iter_mut().zip(&response).for_each(|(s, r)| *s += r);
            }
            *told += 1;
        }
        let mut sums = sums.into_iter().map(|(told, mut sum)| {
            (told == pushed.len()).then(|| {
                self.model.free_run.data.fill(&mut sum);
                sum
            })
        });
        let of = |Basis { description, functions }: Basis| {
            let own: Vec<Option<Vec<f64>>> = sums.by_ref().take(functions.len()).collect();
            Some((description, own.into_iter().collect::<Option<_>>()?))
        };
        bases.into_iter().map(of).collect()
    }
}

/// Description of a basis, and the responses of the samples to its functions.
type Responses = (String, Vec<Vec<f64>>);

/// Number of bases whose responses are made together: most have two functions, and side by side these fill the lanes of a
/// recursion. Cost.
const BASES_TOGETHER: usize = 8;

/// Scores of bases in a score test, from the `columns` of some at a time: those of all together would fill the memory.
fn weights(
    score_test: &ScoreTest<'_>,
    bases: impl Iterator<Item = usize>,
    columns: &(impl Fn(&[usize]) -> Vec<Option<Responses>> + Sync),
) -> Vec<Contribution> {
    let bases: Vec<usize> = bases.collect();
    let some = bases.par_chunks(BASES_TOGETHER).flat_map_iter(|some| {
        let weight = |(basis, columns): (&usize, Option<Responses>)| {
            let (description, columns) = columns?;
            let (energy, by) = explained(score_test, &columns)?;
            Some(Contribution { energy, by, basis: *basis, description })
        };
        some.iter().zip(columns(some)).filter_map(weight).collect::<Vec<_>>()
    });
    some.collect()
}

/// Score of several columns together in a score test, and their coefficients.
fn explained(score_test: &ScoreTest<'_>, columns: &[Vec<f64>]) -> Option<(f64, DVector<f64>)> {
    let (products, right) = score_test.products(columns);
    let norms = products.diagonal().map(f64::sqrt);
    if columns.is_empty() || norms.iter().any(|n| !n.is_finite()) {
        return None;
    }
    let scale = norms.map(|n| if n > 0.0 { 1.0 / n } else { 0.0 });
    let gram = DMatrix::from_fn(scale.len(), scale.len(), |i, j| scale[i] * products[(i, j)] * scale[j]);
    let right = right.component_mul(&scale);
    let by = pseudo_inverse(&gram)? * &right;
    let energy = by.dot(&right);
    Some((energy, by.component_mul(&scale)))
}
