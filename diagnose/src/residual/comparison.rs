//! Comparison of a fit with forces and errors of devices that the table does not name.

use crate::thresholds::{BASES_REFITTED, BASES_SORTED, RELAY_PARAMETERS};
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
use crate::residual::device_basis::{Errors, Family, of_actuator, of_sensor};
use crate::residual::hysteresis_relay;
use crate::search::alternative::SearchSpace;
use whirlstand_ident::identify::normal::pseudo_inverse;

/// A force that is a function of a signal.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceOnSignal {
    /// Gain in BIC.
    pub gain: f64,
    /// Text such as "a force on roll_rate that follows roll times roll_rate".
    pub description: String,
}

/// A rival of the causes on a part of the vehicle, and the part of the samples that it explains.
pub type Rival = (ForceOnSignal, Vec<f64>);

/// The rival with the largest gain.
pub fn likelier(rivals: impl IntoIterator<Item = Rival>) -> Option<Rival> {
    rivals.into_iter().max_by(|(a, _), (b, _)| a.gain.total_cmp(&b.gain))
}

/// Text such as "a force on roll_rate that follows pitch".
pub fn on(vehicle: &Vehicle, entry: Entry, description: &str) -> String {
    match entry {
        Entry::State(i) => format!("a force on {} that {description}", vehicle.states[i].name),
        Entry::Input(j) => format!("a signal added to {} that {description}", vehicle.inputs[j].name),
    }
}

/// A fit against which bases of forces are tested.
pub struct Comparison<'a, 'd> {
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
    /// Prepares a comparison with a fit.
    pub fn new(
        model: &'a Model<'a, 'd>,
        fit: &'a Fit,
        vehicle: &'a Vehicle,
        space: &SearchSpace<'a>,
    ) -> Self {
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

    /// The most likely force of some bases, and the part of the samples that it explains.
    pub fn best(&self, entry: Entry, bases: Vec<Recipe<'_>>) -> Option<Rival> {
        self.best_of(entry, (bases, Vec::new()))
    }

    /// The most likely force on any state of a part of the vehicle. The signals are those of a model `with` causes, which is
    /// closer to the truth.
    pub fn force(&self, (with, its): (&Model<'_, '_>, &Fit), axis: &Axis) -> Option<Rival> {
        let states = with.free_run.run_states(&with.vehicle(&its.values).ok()?, &its.values[..with.states()]);
        let signals = Signals::new(with, states.ok()?);
        let moved = |i: &usize| self.vehicle.kinematic_row(*i).is_none();
        let on_state = |i: usize| {
            let smooth = self.best(Entry::State(i), signals.of_states());
            smooth.into_iter().chain(self.relay(i, &signals.states))
        };
        likelier(axis.states.iter().copied().filter(moved).flat_map(on_state))
    }

    /// The most likely error of an actuator or a sensor of a part of the vehicle. Its signals are known, or predicted by the
    /// model.
    pub fn error_of_device(&self, axis: &Axis) -> Option<Rival> {
        let commands = Signals::new(self.model, Vec::new()).inputs;
        let of_actuator = |j: &usize| self.error_of_actuator(*j, &commands[*j]);
        likelier(axis.inputs.iter().filter_map(of_actuator).chain(self.error_of_sensor(&axis.channels)))
    }

    /// The most likely error of the actuator of an input, which gets this command, as [`Self::best`].
    fn error_of_actuator(&self, input: usize, command: &Signal) -> Option<Rival> {
        self.best_of(Entry::Input(input), of_actuator(command))
    }

    fn best_of(&self, entry: Entry, (bases, families): Errors<'_>) -> Option<Rival> {
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
        let respond = |bases: Vec<(usize, Basis)>| {
            self.columns(&forces, &pushed, bases.into_iter().map(|(_, basis)| basis).collect())
        };
        let bases = bases.into_iter().map(|basis| (0, basis)).collect();
        let families = families.into_iter().map(|family| (0, family)).collect();
        let (mut force, explained) = self.likeliest(bases, families, &respond)?;
        force.description = on(self.vehicle, entry, &force.description);
        Some((force, explained))
    }

    /// The most likely error of a sensor of some channels, as [`Self::best`]. None where a filter follows the record: it
    /// follows the error as well.
    pub fn error_of_sensor(&self, channels: &[usize]) -> Option<Rival> {
        let data = self.model.free_run.data;
        data.memory_s.is_none().then_some(())?;
        let ranges = data.ranges();
        let name = |c: usize| self.vehicle.outputs[data.channels[c].output].name.clone();
        let of = |c: &usize| {
            let channel = &data.channels[*c];
            let mut values = self.fit.predicted[ranges[*c].clone()].to_vec();
            scale(&mut values);
            let first = |start: &usize| start.saturating_sub(channel.first).div_ceil(channel.stride);
            (Signal { name: name(*c), values }, data.starts.iter().map(first).collect::<Vec<_>>())
        };
        let sensors: Vec<(Signal, Vec<usize>)> = channels.iter().map(of).collect();
        let (mut bases, mut families) = (Vec::new(), Vec::new());
        for (c, (y, starts)) in channels.iter().zip(&sensors) {
            let (own, some) = of_sensor(y, starts);
            bases.extend(own.into_iter().map(|basis| (*c, basis)));
            families.extend(some.into_iter().map(|family| (*c, family)));
        }
        let respond = |bases: Vec<(usize, Basis)>| -> Vec<Option<Responses>> {
            let column = |c: usize, function: &[f64]| {
                let mut column = vec![0.0; self.fit.predicted.len()];
                column[ranges[c].clone()].copy_from_slice(function);
                data.fill(&mut column);
                column
            };
            let responses = |(c, Basis { description, functions }): (usize, Basis)| {
                let description = format!("an error of the sensor of {} that {description}", name(c));
                Some((description, functions.iter().map(|function| column(c, function)).collect()))
            };
            bases.into_iter().map(responses).collect()
        };
        self.likeliest(bases, families, &respond)
    }

    /// The most likely of some bases and families of bases, each with what `respond` needs to know, which gives the responses
    /// of the samples; and the part of the samples that it explains.
    fn likeliest<'b>(
        &self,
        mut bases: Vec<(usize, Recipe<'b>)>,
        families: Vec<(usize, Family<'b>)>,
        respond: &(impl Fn(Vec<(usize, Basis)>) -> Vec<Option<Responses>> + Sync),
    ) -> Option<Rival> {
        let plain = bases.len();
        for (of, family) in families {
            if let Some(number) = self.likeliest_number(&family, |basis| respond(vec![(of, basis)])) {
                bases.push((of, Box::new(move || (family.make)(number))));
            }
        }
        let columns =
            |some: &[usize]| respond(some.iter().map(|basis| (bases[*basis].0, bases[*basis].1())).collect());
        // The fastest score test preselects; the others test only the remaining bases.
        let [rest @ .., quick] = self.score_tests.as_slice() else { return None };
        let mut sorted = weights(quick, 0..bases.len(), &columns);
        self.keep(&mut sorted, BASES_SORTED);
        let mut weighed: Vec<(&ScoreTest<'_>, Contribution)> = Vec::new();
        for score_test in rest {
            let mut own = weights(score_test, sorted.iter().map(|w| w.basis), &columns);
            self.keep(&mut own, BASES_REFITTED);
            weighed.extend(own.into_iter().map(|w| (score_test, w)));
        }
        self.keep(&mut sorted, BASES_REFITTED);
        weighed.extend(sorted.into_iter().map(|w| (quick, w)));
        let looks = 2.0 * (bases.len() as f64).ln();
        let bics = weighed.into_par_iter().filter_map(|(score_test, weight)| {
            let mut explained = vec![0.0; self.fit.residual.len()];
            let basis = columns(&[weight.basis]).pop().flatten()?;
            for (column, by) in basis.1.iter().zip(weight.by.iter()) {
                explained.iter_mut().zip(column).for_each(|(e, c)| *e += by * c);
            }
            let numbers = usize::from(weight.basis >= plain);
            let bic = self.bic(score_test, &explained, weight.by.len() + numbers);
            Some((bic, weight.description, explained))
        });
        let (bic, description, explained) = bics.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((ForceOnSignal { gain: self.plain.bic(0) - bic - looks, description }, explained))
    }

    /// The number of a family that explains most in the fastest score test.
    fn likeliest_number(
        &self,
        family: &Family<'_>,
        respond: impl Fn(Basis) -> Vec<Option<Responses>> + Sync,
    ) -> Option<f64> {
        let quick = self.score_tests.last()?;
        let (mut low, mut high) = (family.range.0.ln(), family.range.1.ln());
        let mut best = None;
        for &count in family.tried {
            let at = |i: usize| low + (high - low) * i as f64 / (count - 1) as f64;
            let energy = |i: usize| {
                let (_, columns) = respond((family.make)(at(i).exp())).pop().flatten()?;
                Some((explained(quick, &columns)?.0, i))
            };
            let all: Vec<(f64, usize)> = (0..count).into_par_iter().filter_map(energy).collect();
            let (_, i) = all.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
            best = Some(at(i).exp());
            (low, high) = (at(i.saturating_sub(1)), at((i + 1).min(count - 1)));
        }
        best
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
pub fn explained(score_test: &ScoreTest<'_>, columns: &[Vec<f64>]) -> Option<(f64, DVector<f64>)> {
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
