//! Responses of the samples to forces on the states: by the recursion of the linear motion; where an effect does not allow
//! that, by one simulation per force, small enough that any model is linear.

use rayon::prelude::*;
use whirlstand_vehicle::Vehicle;

use crate::model::fit::{Fit, Model};
use crate::model::free_run::FreeRun;
use crate::model::linear_motion::{LANES, LinearMotion};

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
        let trajectory = || free_run.run_states(vehicle, &fit.values[..free_run.initials()]).ok();
        let linear = if free { LinearMotion::new(vehicle, free_run.data, trajectory) } else { None };
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

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::data::record::{Channel, Data};
    use crate::model::free_run::FreeRun;
    use crate::model::noise::Noise;
    use crate::model::optimum::Optimum;
    use whirlstand_vehicle::{Effect, Kind, Stream};

    /// Two records of a quadrotor with one slower sensor; `effects` are part of the vehicle. Calls `check` with
    /// forces on two of its states.
    fn with(effects: &[Effect], check: impl Fn(&Forces<'_>, &[f64])) {
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        vehicle.effects.clear();
        effects.iter().for_each(|effect| vehicle.add_effect(effect.clone()).unwrap());
        let (steps, m) = (700, vehicle.inputs.len());
        let mut stream = Stream::new(5, "forces");
        let channel = |output: usize| {
            let stride = if output == 1 { 3 } else { 1 };
            let values: Vec<f64> = (0..steps / stride).map(|k| if k % 2 == 0 { 1.0 } else { -1.0 }).collect();
            Channel {
                output,
                stride,
                first: 0,
                good: vec![true; values.len()],
                values,
                early: Vec::new(),
                declared: 0.0,
            }
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
        let values = vec![0.01; 2 * vehicle.states.len()];
        let noise = Noise::white(&[1.0; 4]);
        let profile = noise.again(&data, &vec![0.0; data.samples()]);
        let nothing = Arc::new(vec![0.0; data.samples()]);
        let nothing = vec![nothing; values.len()];
        let fit = model.at(&Optimum { values, profile }, &nothing).unwrap();
        let force: Vec<f64> = (0..steps).map(|_| stream.normal()).collect();
        check(&Forces::new(&model, &fit, &free_run.vehicle, &[(1, 0.1), (3, 0.1)]), &force);
    }

    /// Simulations are the judge of the recursion.
    fn as_simulated(effects: &[Effect], tolerance: f64) {
        with(effects, |forces, force| {
            assert!(forces.linear.is_some(), "{effects:?}");
            let other: Vec<f64> = force.iter().rev().copied().collect();
            let seen =
                |forces: &Forces<'_>| forces.each(&[force, &other], |state, i, samples| (state, i, samples));
            let Forces { free_run, fit, vehicle, ref states, .. } = *forces;
            let simulated = Forces { free_run, fit, vehicle, states: states.clone(), linear: None };
            for ((state, i, own), (same_state, same, other)) in seen(forces).iter().zip(seen(&simulated)) {
                assert_eq!((*state, *i), (same_state, same));
                let reach = other.iter().fold(0.0f64, |m, v| m.max(v.abs()));
                let apart = own.iter().zip(&other).fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
                assert!(apart <= tolerance * reach, "{effects:?}, {state} {i}: {apart} of {reach}");
            }
        });
    }

    fn effect(kind: Kind, place: &str, parameters: &[(&str, f64)]) -> Effect {
        Effect::new(kind, place, parameters).unwrap()
    }

    #[test]
    fn a_linear_vehicle_responds_as_in_simulation() {
        let linear = [
            effect(Kind::InputDelay, "u_roll", &[("delay_s", 0.033)]),
            effect(Kind::InputSaturation, "u_pitch", &[("lower", -0.1), ("upper", 0.1)]),
            effect(Kind::ParameterChange, "A[2,2]", &[("value", -3.0)]),
            effect(
                Kind::PulseDisturbance,
                "pitch_rate",
                &[("at_s", 2.0), ("magnitude", 1.0), ("duration_s", 1.0)],
            ),
            effect(Kind::SensorBias, "roll", &[("offset", 0.1)]),
            effect(Kind::SensorScale, "roll_rate", &[("factor", 1.2)]),
            effect(Kind::SensorDelay, "roll_rate", &[("delay_s", 0.033)]),
            effect(Kind::SensorDelay, "pitch", &[("delay_s", 0.02)]),
            effect(Kind::SensorLag, "roll", &[("time_constant_s", 0.05)]),
            effect(Kind::Misalignment, "roll,pitch", &[("angle_rad", 0.3)]),
        ];
        linear.iter().for_each(|effect| as_simulated(std::slice::from_ref(effect), 1e-6));
        as_simulated(&linear, 1e-6);
    }

    /// A force that depends smoothly on a state is linear along the record's trajectory.
    #[test]
    fn a_vehicle_with_smooth_forces_responds_as_in_simulation() {
        let smooth = [
            effect(Kind::QuadraticDrag, "roll_rate", &[("coefficient", 3.0)]),
            effect(Kind::CubicStiffness, "pitch->pitch_rate", &[("coefficient", 300.0)]),
            effect(Kind::SensorDelay, "pitch", &[("delay_s", 0.033)]),
        ];
        as_simulated(&smooth, 0.02);
    }

    /// What depends on the size of a force is simulated; so is a force that changes the motion within a step.
    #[test]
    fn what_is_not_linear_is_simulated() {
        for effect in [
            effect(Kind::CoulombFriction, "roll_rate", &[("level", 0.1)]),
            effect(Kind::OutputSaturation, "roll", &[("lower", -0.1), ("upper", 0.1)]),
            effect(Kind::CubicStiffness, "roll->roll_rate", &[("coefficient", 1e8)]),
        ] {
            with(std::slice::from_ref(&effect), |forces, force| {
                assert!(forces.linear.is_none(), "{effect:?}");
                assert_eq!(forces.each(&[force], |_, _, _| ()).len(), 2, "{effect:?}");
            });
        }
    }
}
