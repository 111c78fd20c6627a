//! Responses of the samples to forces on the states: one simulation per force, small enough that any model is
//! linear.

use rayon::prelude::*;
use whirlstand_vehicle::Vehicle;

use crate::model::fit::{Fit, Model};
use crate::model::free_run::FreeRun;

/// A fitted model to which forces are added.
pub struct Forces<'a> {
    free_run: &'a FreeRun<'a>,
    fit: &'a Fit,
    vehicle: &'a Vehicle,
    /// Forced states, each with a force smaller than a nonlinear effect would notice and larger than
    /// rounding.
    states: Vec<(usize, f64)>,
}

impl<'a> Forces<'a> {
    /// For forces on `states`, of about the given sizes.
    pub fn new(model: &Model<'a, 'a>, fit: &'a Fit, vehicle: &'a Vehicle, states: &[(usize, f64)]) -> Self {
        let states = states.iter().map(|(state, slope)| (*state, 1e-3 * slope.max(1e-9))).collect();
        Self { free_run: model.free_run, fit, vehicle, states }
    }

    /// Changes of all samples due to forces (one value per step, in the unit of the state's derivative);
    /// `visit` is called with the state, the force's index and the samples.
    pub fn each<T: Send>(
        &self,
        forces: &[&[f64]],
        visit: impl Fn(usize, usize, Vec<f64>) -> T + Sync,
    ) -> Vec<T> {
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
    use super::*;
    use crate::data::record::{Channel, Data};
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
}
