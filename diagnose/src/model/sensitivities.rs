//! Sensitivities of all samples to the parameters, by one-sided finite differences.

use std::sync::Arc;

use rayon::prelude::*;
use whirlstand_vehicle::Vehicle;

use crate::model::columns::{Column, Slot};
use crate::model::fit::Model;
use crate::model::free_run::FreeRun;
use crate::model::optimum::ModelError;
use crate::model::reach::{Reach, Set, groups};
use crate::thresholds::INITIAL_STATE_STEP;

impl Model<'_, '_> {
    pub(super) fn slots(&self) -> Vec<Slot> {
        let mut slots: Vec<Slot> = (0..self.states())
            .map(|_| Slot { lower: f64::NEG_INFINITY, upper: f64::INFINITY, scale: 1e-2 })
            .collect();
        let vehicle = &self.free_run.vehicle;
        slots.extend(self.free.iter().map(|f| {
            let value = vehicle.free_value(&f.target).abs();
            // A fitted zero has no size of its own: the scale follows from its range.
            let scale = if value > 0.0 { value } else { 1e-3 * (f.upper - f.lower).min(1e3) };
            Slot { lower: f.lower, upper: f.upper, scale: 1e-3 * scale }
        }));
        let tunables = self.terms.iter().flat_map(|t| &t.tunables);
        slots.extend(tunables.map(|t| Slot { lower: t.lower, upper: t.upper, scale: t.scale }));
        slots
    }

    /// Sensitivities by one-sided differences; those to the initial state may be given.
    pub(super) fn columns(
        &self,
        values: &[f64],
        centre: &[f64],
        slots: &[Slot],
        initial: Option<&[Column]>,
    ) -> Result<Vec<Column>, ModelError> {
        let n = self.states();
        let mut columns: Vec<Column> = match initial {
            Some(columns) => columns.to_vec(),
            None => {
                let columns = self.free_run.initial_columns(&self.vehicle(values)?, &values[..n], centre)?;
                columns.into_iter().map(Arc::new).collect()
            }
        };
        columns.extend(self.own_columns(values, centre, slots)?.into_iter().map(Arc::new));
        Ok(columns)
    }

    /// Sensitivities to the parameters after the initial state.
    pub(super) fn own_columns(
        &self,
        values: &[f64],
        centre: &[f64],
        slots: &[Slot],
    ) -> Result<Vec<Vec<f64>>, ModelError> {
        let reached = self.reached(values)?;
        let groups = groups(&reached);
        let of = |members: &Vec<usize>| self.columns_of(members, &reached, (values, centre, slots));
        let found: Vec<Vec<(usize, Vec<f64>)>> = groups.par_iter().map(of).collect::<Result<_, _>>()?;
        let mut columns = vec![Vec::new(); reached.len()];
        found.into_iter().flatten().for_each(|(own, column)| columns[own] = column);
        Ok(columns)
    }

    /// The channels that each parameter after the initial state affects.
    fn reached(&self, values: &[f64]) -> Result<Vec<Set>, ModelError> {
        let (vehicle, effects) = (self.vehicle(values)?, self.effects(values)?);
        let reach = Reach::new(&vehicle, self.free_run.data, self.free.iter().map(|f| &f.target));
        let free = self.free.iter().map(|f| reach.of_target(&f.target, &vehicle));
        let terms = self.terms.iter().zip(&effects);
        let own = terms.flat_map(|(term, effect)| {
            std::iter::repeat_n(reach.of_effect(effect, &vehicle), term.tunables.len())
        });
        Ok(free.chain(own).collect())
    }

    /// Columns of some parameters after the initial state, of which no two affect the same channel, from one
    /// run; from one run each where that diverges.
    fn columns_of(
        &self,
        members: &[usize],
        reached: &[Set],
        (values, centre, slots): (&[f64], &[f64], &[Slot]),
    ) -> Result<Vec<(usize, Vec<f64>)>, ModelError> {
        let base = self.states();
        let steps: Vec<f64> = members
            .iter()
            .map(|own| {
                let (value, slot) = (values[base + own], &slots[base + own]);
                if value + slot.scale <= slot.upper { slot.scale } else { -slot.scale }
            })
            .collect();
        let towards = |sign: f64| {
            let mut moved = values.to_vec();
            members
                .iter()
                .zip(&steps)
                .for_each(|(own, step)| moved[base + own] = values[base + own] + sign * step);
            self.predict(&moved).map(|predicted| (moved, predicted))
        };
        let run = match towards(1.0) {
            Err(_) if members.len() > 1 => {
                let alone =
                    members.iter().map(|own| self.columns_of(&[*own], reached, (values, centre, slots)));
                return Ok(alone.collect::<Result<Vec<_>, _>>()?.concat());
            }
            Err(_) => towards(-1.0)?,
            Ok(run) => run,
        };
        let (moved, predicted) = run;
        let column = |own: &usize| {
            let inverse = 1.0 / (moved[base + own] - values[base + own]);
            let mut column = vec![0.0; centre.len()];
            let ranges = self.free_run.data.ranges().into_iter().enumerate();
            for (_, range) in ranges.filter(|(c, _)| reached[*own] >> c & 1 == 1) {
                let both = predicted[range.clone()].iter().zip(&centre[range.clone()]);
                column[range].iter_mut().zip(both).for_each(|(d, (y, c))| *d = (y - c) * inverse);
            }
            (*own, column)
        };
        Ok(members.iter().map(column).collect())
    }
}

impl FreeRun<'_> {
    /// Derivatives of all samples by the initial states, one column per state of each record. One run
    /// perturbs the same state of all records, as records do not affect each other.
    ///
    /// # Errors
    /// When a run diverges.
    pub fn initial_columns(
        &self,
        vehicle: &Vehicle,
        initial: &[f64],
        centre: &[f64],
    ) -> Result<Vec<Vec<f64>>, ModelError> {
        let (n, data) = (self.states(), self.data);
        let reach = Reach::new(vehicle, data, std::iter::empty());
        let reached: Vec<Set> = (0..n).map(|state| reach.of_state(state)).collect();
        let runs = groups(&reached).into_par_iter().map(|members| {
            let mut moved = initial.to_vec();
            for state in &members {
                moved.iter_mut().skip(*state).step_by(n).for_each(|x| *x += INITIAL_STATE_STEP);
            }
            let mut run = self.run_vehicle(vehicle, &moved)?;
            run.iter_mut().zip(centre).for_each(|(y, c)| *y = (*y - c) / INITIAL_STATE_STEP);
            Ok((members, run))
        });
        let runs: Vec<(Vec<usize>, Vec<f64>)> = runs.collect::<Result<_, ModelError>>()?;
        let mut own = vec![vec![0.0; centre.len()]; n];
        for (state, run) in
            runs.iter().flat_map(|(members, run)| members.iter().map(move |state| (*state, run)))
        {
            let ranges = data.ranges().into_iter().enumerate();
            for (_, range) in ranges.filter(|(c, _)| reached[state] >> c & 1 == 1) {
                own[state][range.clone()].copy_from_slice(&run[range]);
            }
        }
        let runs = own;
        if data.starts.len() == 1 {
            return Ok(runs);
        }
        let mut columns = vec![vec![0.0; centre.len()]; self.initials()];
        for (state, run) in runs.iter().enumerate() {
            for (channel, range) in data.channels.iter().zip(data.ranges()) {
                let mut record = 0;
                for (sample, at) in range.enumerate() {
                    let step = channel.step(sample);
                    while data.starts.get(record + 1).is_some_and(|next| *next <= step) {
                        record += 1;
                    }
                    columns[record * n + state][at] = run[at];
                }
            }
        }
        Ok(columns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::flown::flown;
    use crate::data::record::Data;
    use whirlstand_vehicle::{Effect, Free, Kind, Matrix, Target};

    fn flight(vehicle: &Vehicle, memory_s: Option<f64>) -> Data {
        let m = vehicle.inputs.len();
        let input = |k: usize, j: usize| if k % (70 + 30 * j) < 35 { 0.3 } else { -0.3 };
        Data { memory_s, ..flown(vehicle, (0..400 * m).map(|at| input(at / m, at % m)).collect(), 5) }
    }

    /// Two decoupled axes, or a built-in vehicle.
    fn vehicle(name: &str) -> Vehicle {
        let two = "name = \"two\"\nA = [[0.0, 1.0, 0.0], [-4.0, -1.0, 0.0], [0.0, 0.0, -2.0]]\n\
                   B = [[0.0, 0.0], [3.0, 0.0], [0.0, 5.0]]\nC = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]\n\
                   states = [{ name = \"roll\", unit = \"rad\" }, { name = \"roll_rate\", unit = \"rad/s\" }, { name = \"yaw_rate\", unit = \"rad/s\" }]\n\
                   inputs = [{ name = \"u_roll\", unit = \"\" }, { name = \"u_pitch\", unit = \"\" }]\n\
                   outputs = [{ name = \"roll\", unit = \"rad\" }, { name = \"roll_rate\", unit = \"rad/s\" }, { name = \"yaw_rate\", unit = \"rad/s\" }]\n";
        if name == "two" { Vehicle::parse(two, "two.toml").unwrap() } else { Vehicle::builtin(name).unwrap() }
    }

    /// An effect at a place with its parameters.
    type Given = (Kind, &'static str, Vec<(&'static str, f64)>);

    /// Effects that couple axes, and effects that do not.
    fn effects(name: &str) -> Vec<Given> {
        let mut all = vec![
            (Kind::SensorScale, "roll_rate", vec![("factor", 1.1)]),
            (Kind::ParameterChange, "A[2,2]", vec![("value", -0.5)]),
        ];
        if ["quadrotor", "two"].contains(&name) {
            all.push((Kind::ActuatorLag, "u_pitch", vec![("time_constant_s", 0.1)]));
            all.push((Kind::InputCoupling, "u_roll->u_pitch", vec![("coefficient", 0.0)]));
        }
        if name == "quadrotor" {
            all.push((Kind::Misalignment, "roll,pitch", vec![("angle_rad", 0.0)]));
        }
        all
    }

    #[test]
    fn values_moved_together_have_the_columns_of_each_alone() {
        for name in ["two", "quadrotor", "helicopter-hover", "helicopter-lateral"] {
            for memory_s in [None, Some(0.5)] {
                for tied in 0..=effects(name).len() {
                    agrees(name, memory_s, &effects(name)[..tied]);
                }
            }
        }
    }

    fn agrees(name: &str, memory_s: Option<f64>, effects: &[Given]) {
        let mut vehicle = vehicle(name);
        let data = flight(&vehicle, memory_s);
        for (kind, place, parameters) in effects {
            // Some vehicles lack a signal that an effect needs.
            let _ = vehicle.add_effect(Effect::new(*kind, place, parameters).unwrap());
        }
        let parameters = vehicle.effects.iter().enumerate().flat_map(|(index, effect)| {
            effect.parameters().map(move |(parameter, _)| Target::Effect(index, parameter))
        });
        let n = vehicle.states.len();
        let entries = (0..n).map(|i| Target::Entry(Matrix::A, i, i));
        let targets: Vec<Target> = entries.chain(parameters).collect();
        let free = |target: Target| Free { target, lower: -10.0, upper: 10.0, start: None };
        let free: Vec<Free> = targets.into_iter().map(free).collect();
        let free_run = FreeRun::new(&vehicle, &data);
        let model = Model { free_run: &free_run, free: &free, terms: Vec::new() };
        let mut values = vec![0.01; model.states()];
        values.extend(free.iter().map(|f| vehicle.free_value(&f.target)));
        let centre = model.predict(&values).unwrap();
        let slots = model.slots();
        let together = model.own_columns(&values, &centre, &slots).unwrap();
        let whole = vec![Set::MAX; free.len()];
        for (own, column) in together.iter().enumerate() {
            let alone = model.columns_of(&[own], &whole, (&values, &centre, &slots)).unwrap();
            close(column, &alone[0].1, &format!("{name}, {memory_s:?}, {:?}, {effects:?}", free[own].target));
        }
        let initial = free_run.initial_columns(&vehicle, &values[..n], &centre).unwrap();
        for (state, column) in initial.iter().enumerate() {
            let mut moved = values[..n].to_vec();
            moved[state] += INITIAL_STATE_STEP;
            let run = free_run.run_vehicle(&vehicle, &moved).unwrap();
            let alone: Vec<f64> =
                run.iter().zip(&centre).map(|(y, c)| (y - c) / INITIAL_STATE_STEP).collect();
            close(column, &alone, &format!("{name}, {memory_s:?}, state {state}, {effects:?}"));
        }
    }

    fn close(a: &[f64], b: &[f64], what: &str) {
        let size = b.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let apart = a.iter().zip(b).fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
        assert!(apart <= 1e-7 * size, "{what}: {apart} of {size}");
    }

    #[test]
    fn values_that_move_no_common_channel_share_a_run() {
        assert_eq!(groups(&[0b001, 0b010, 0b011, 0b100]), [vec![0, 1, 3], vec![2]]);
        let vehicle = vehicle("two");
        for memory_s in [None, Some(0.5)] {
            let reach = Reach::new(&vehicle, &flight(&vehicle, memory_s), std::iter::empty());
            let reached: Vec<Set> = (0..3).map(|state| reach.of_state(state)).collect();
            assert_eq!(groups(&reached), [vec![0, 2], vec![1]], "{memory_s:?}");
        }
    }
}
