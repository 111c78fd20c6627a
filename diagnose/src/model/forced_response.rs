//! Responses of the samples to forces on the states: by the recursion of a linear vehicle, many forces side by side; else one
//! simulation per force, small enough that any model is linear.

use multiversion::multiversion;
use nalgebra::DMatrix;
use rayon::prelude::*;
use whirlstand_vehicle::{Place, Vehicle, discretise};

use crate::data::record::Data;
use crate::model::fit::{Fit, Model};
use crate::model::free_run::FreeRun;

/// Number of forces side by side: their arithmetic uses the full vector width instead of waiting for one recursion.
const LANES: usize = 16;
type Lane = [f64; LANES];

/// A fitted model to which forces are added.
pub struct Forces<'a> {
    free_run: &'a FreeRun<'a>,
    fit: &'a Fit,
    vehicle: &'a Vehicle,
    /// Forced states, each with a force smaller than a nonlinear effect would notice and larger than
    /// rounding.
    states: Vec<(usize, f64)>,
    linear: Option<LinearMotion<'a>>,
}

impl<'a> Forces<'a> {
    /// For forces on `states`, of about the given sizes.
    pub fn new(model: &Model<'a, 'a>, fit: &'a Fit, vehicle: &'a Vehicle, states: &[(usize, f64)]) -> Self {
        let states = states.iter().map(|(state, slope)| (*state, 1e-3 * slope.max(1e-9))).collect();
        let free_run = model.free_run;
        // A filter answers to forces too.
        let free = free_run.data.memory_s.is_none();
        let linear = if free { LinearMotion::new(vehicle, free_run.data) } else { None };
        Self { free_run, fit, vehicle, states, linear }
    }

    /// Changes of all samples due to forces (one value per step, in the unit of the state's derivative);
    /// `visit` is called with the state, the force's index and the samples.
    pub fn each<T: Send>(
        &self,
        forces: &[&[f64]],
        visit: impl Fn(usize, usize, Vec<f64>) -> T + Sync,
    ) -> Vec<T> {
        if let Some(linear) = &self.linear {
            let states = self.states.iter().map(|(state, _)| *state);
            let all: Vec<_> = states.flat_map(|state| (0..forces.len()).map(move |i| (state, i))).collect();
            let responses = all.par_chunks(LANES).flat_map_iter(|some| {
                let of_each = some.iter().zip(linear.responses(some, forces));
                of_each.map(|((state, i), response)| visit(*state, *i, response)).collect::<Vec<_>>()
            });
            return responses.collect();
        }
        let all: Vec<((usize, f64), usize)> =
            self.states.iter().flat_map(|state| (0..forces.len()).map(move |i| (*state, i))).collect();
        let changed = all.into_par_iter().filter_map(|((state, size), i)| {
            let initial = &self.fit.values[..self.free_run.initials()];
            let run = self.free_run.run_forced(self.vehicle, initial, state, (size, forces[i]));
            let mut samples = run.ok()?;
            samples.iter_mut().zip(&self.fit.predicted).for_each(|(y, p)| *y = (*y - p) / size);
            Some(visit(state, i, samples))
        });
        changed.collect()
    }
}

/// Free motion of a vehicle whose effects all act on its inputs: forces on its states do not meet them.
#[derive(Debug)]
struct LinearMotion<'d> {
    data: &'d Data,
    /// Entries of a step's transition that are not zero, row after row.
    transition: Vec<Vec<(usize, f64)>>,
    /// Response of the states to a constant force on each over one step, states x states.
    push: DMatrix<f64>,
    /// For each channel the states that it shows.
    shown: Vec<Vec<(usize, f64)>>,
}

impl<'d> LinearMotion<'d> {
    fn new(vehicle: &Vehicle, data: &'d Data) -> Option<Self> {
        let on_input = |place| matches!(place, Place::Input(_) | Place::InputPair(..));
        if !vehicle.effects.iter().all(|effect| effect.resolve(vehicle).is_ok_and(on_input)) {
            return None;
        }
        let n = vehicle.states.len();
        let (phi, push) = discretise(&vehicle.a, &DMatrix::identity(n, n), data.period_s).ok()?;
        let row = |matrix: &DMatrix<f64>, i: usize| -> Vec<(usize, f64)> {
            matrix.row(i).iter().copied().enumerate().filter(|(_, entry)| *entry != 0.0).collect()
        };
        Some(Self {
            data,
            transition: (0..n).map(|i| row(&phi, i)).collect(),
            push,
            shown: data.channels.iter().map(|channel| row(&vehicle.c, channel.output)).collect(),
        })
    }

    /// Responses of all samples to at most [`LANES`] forces, each on a state.
    fn responses(&self, forced: &[(usize, usize)], forces: &[&[f64]]) -> Vec<Vec<f64>> {
        let mut push = vec![[0.0; LANES]; self.transition.len()];
        for (lane, (state, _)) in forced.iter().enumerate() {
            push.iter_mut().zip(self.push.column(*state).iter()).for_each(|(push, by)| push[lane] = *by);
        }
        let forces: Vec<&[f64]> = forced.iter().map(|(_, i)| forces[*i]).collect();
        let mut responses = vec![vec![0.0; self.data.samples()]; forced.len()];
        respond(self, &push, &forces, &mut responses);
        responses
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn respond(linear: &LinearMotion<'_>, push: &[Lane], forces: &[&[f64]], responses: &mut [Vec<f64>]) {
    let LinearMotion { data, transition, shown, .. } = linear;
    let mut x = vec![[0.0; LANES]; transition.len()];
    let mut next = x.clone();
    let ranges = data.ranges();
    let sum = |sum: &mut Lane, terms: &[(usize, f64)], x: &[Lane]| {
        for (j, by) in terms {
            sum.iter_mut().zip(&x[*j]).for_each(|(sum, x)| *sum += by * x);
        }
    };
    for k in 0..data.steps {
        if data.starts.contains(&k) {
            x.fill([0.0; LANES]);
        }
        for ((channel, range), shown) in data.channels.iter().zip(&ranges).zip(shown) {
            if let Some(sample) = channel.sample_at(k).map(|s| range.start + s).filter(|s| *s < range.end) {
                let mut y = [0.0; LANES];
                sum(&mut y, shown, &x);
                responses.iter_mut().zip(y).for_each(|(response, y)| response[sample] = y);
            }
        }
        let mut force = [0.0; LANES];
        force.iter_mut().zip(forces).for_each(|(force, values)| *force = values[k]);
        for ((next, row), push) in next.iter_mut().zip(transition).zip(push) {
            *next = [0.0; LANES];
            next.iter_mut().zip(push).zip(&force).for_each(|((next, push), force)| *next = push * force);
            sum(next, row, &x);
        }
        std::mem::swap(&mut x, &mut next);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::record::Channel;
    use crate::model::free_run::FreeRun;
    use crate::model::noise::Noise;
    use whirlstand_vehicle::{Effect, Kind, Stream};

    /// Two records of a quadrotor with one slower sensor; `effect` is part of the vehicle. Calls `check` with
    /// forces on two of its states.
    fn with(effect: Effect, check: impl Fn(&Forces<'_>, &[f64])) {
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        vehicle.effects.clear();
        vehicle.add_effect(effect).unwrap();
        let (steps, m) = (700, vehicle.inputs.len());
        let mut stream = Stream::new(5, "forces");
        let channel = |output: usize| {
            let stride = if output == 1 { 3 } else { 1 };
            let values: Vec<f64> = (0..steps / stride).map(|k| if k % 2 == 0 { 1.0 } else { -1.0 }).collect();
            Channel { output, stride, first: 0, good: vec![true; values.len()], values, declared: 0.0 }
        };
        let data = Data {
            origin: "none".into(),
            start_s: 0.0,
            period_s: 0.01,
            steps,
            inputs: (0..steps * m).map(|k| if k / m % 100 < 50 { 0.2 } else { -0.2 }).collect(),
            m,
            starts: vec![0, 400],
            clocks: vec![0, 0],
            held: false,
            memory_s: None,
            likeliest_s: None,
            likeliest_filter: None,
            channels: (0..4).map(channel).collect(),
        };
        let free_run = FreeRun::new(&vehicle, &data);
        let model = Model { free_run: &free_run, free: &[], terms: Vec::new() };
        let initial = vec![0.01; 2 * vehicle.states.len()];
        let fit = model.fit(initial, Some(&Noise::white(&[1.0; 4])), None).unwrap();
        let force: Vec<f64> = (0..steps).map(|_| stream.normal()).collect();
        check(&Forces::new(&model, &fit, &free_run.vehicle, &[(1, 0.1), (3, 0.1)]), &force);
    }

    #[test]
    fn responses_add_up_where_the_model_is_linear() {
        let late = Effect::new(Kind::SensorDelay, "roll_rate", &[("delay_s", 0.033)]).unwrap();
        with(late, |forces, force| {
            let twice: Vec<f64> = force.iter().map(|f| 2.0 * f).collect();
            let all = forces.each(&[force, &twice], |state, i, samples| (state, i, samples));
            let of = |state: usize, i: usize| &all.iter().find(|r| (r.0, r.1) == (state, i)).unwrap().2;
            for state in [1, 3] {
                let reach = of(state, 0).iter().fold(0.0f64, |m, v| m.max(v.abs()));
                assert!(reach > 0.0);
                for (a, b) in of(state, 0).iter().zip(of(state, 1)) {
                    assert!((2.0 * a - b).abs() < 1e-6 * reach, "{state}: {a} {b}");
                }
            }
        });
    }

    /// Simulations are the judge of the recursion.
    #[test]
    fn a_vehicle_with_effects_on_its_inputs_responds_as_in_simulation() {
        let late = Effect::new(Kind::InputDelay, "u_roll", &[("delay_s", 0.033)]).unwrap();
        with(late, |forces, force| {
            assert!(forces.linear.is_some());
            let other: Vec<f64> = force.iter().rev().copied().collect();
            let seen =
                |forces: &Forces<'_>| forces.each(&[force, &other], |state, i, samples| (state, i, samples));
            let Forces { free_run, fit, vehicle, ref states, .. } = *forces;
            let simulated = Forces { free_run, fit, vehicle, states: states.clone(), linear: None };
            for ((state, i, own), (same_state, same, other)) in seen(forces).iter().zip(seen(&simulated)) {
                assert_eq!((*state, *i), (same_state, same));
                let reach = own.iter().fold(0.0f64, |m, v| m.max(v.abs()));
                for (a, b) in own.iter().zip(other) {
                    assert!((a - b).abs() < 1e-6 * reach, "{state} {i}: {a} {b}");
                }
            }
        });
    }
}
