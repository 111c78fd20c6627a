//! What forces on the states do to the samples: by convolution where the model is linear and constant, else by simulation.

use crate::thresholds::SUPERPOSITION_TOLERANCE;
use nalgebra::Complex;
use rayon::prelude::*;
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;
use whirlstand_vehicle::{Simulator, Vehicle};

use crate::data::record::Data;
use crate::model::fit::{Fit, Model};
use crate::model::free_run::FreeRun;

/// A fitted model that forces are added to.
pub struct Forces<'a> {
    free_run: &'a FreeRun<'a>,
    data: &'a Data,
    fit: &'a Fit,
    vehicle: &'a Vehicle,
    /// Response of every output to a force on a state at one step, in frequency.
    kernels: Vec<Kernel>,
    fft: Arc<dyn Fft<f64>>,
    back: Arc<dyn Fft<f64>>,
    length: usize,
}

/// Spectra of the responses, output by output.
struct Kernel {
    state: usize,
    size: f64,
    /// `None` where the model is not linear or changes.
    outputs: Option<Vec<Vec<Complex<f64>>>>,
}

impl<'a> Forces<'a> {
    /// For forces on `states`, of about the given sizes. `probe` is a force that shows whether the model is linear.
    pub fn new(
        model: &Model<'a, 'a>,
        fit: &'a Fit,
        vehicle: &'a Vehicle,
        states: &[(usize, f64)],
        probe: &[f64],
    ) -> Self {
        let data = model.free_run.data;
        let ends = data.starts.iter().copied().skip(1).chain([data.steps]);
        let longest = data.starts.iter().zip(ends).map(|(s, e)| e - s).max().unwrap_or(0);
        let length = (2 * longest).max(1).next_power_of_two();
        let mut planner = FftPlanner::new();
        let (fft, back) = (planner.plan_fft_forward(length), planner.plan_fft_inverse(length));
        let mut forces =
            Self { free_run: model.free_run, data, fit, vehicle, kernels: Vec::new(), fft, back, length };
        forces.kernels = states
            .par_iter()
            .map(|(state, slope)| {
                // Smaller than a nonlinear effect would notice, larger than rounding.
                let size = 1e-3 * slope.max(1e-9);
                let kernel = Kernel { state: *state, size, outputs: forces.kernel(*state, size, longest) };
                let simulated = forces.simulated(&kernel, probe);
                let convolved = forces.convolved(&kernel, probe, &vec![0.0; probe.len()]);
                let same = simulated.zip(convolved).is_some_and(|(s, (c, _))| {
                    let reach = s.iter().fold(0.0f64, |m, v| m.max(v.abs()));
                    s.iter().zip(&c).all(|(s, c)| (s - c).abs() <= SUPERPOSITION_TOLERANCE * reach)
                });
                Kernel { outputs: kernel.outputs.filter(|_| same), ..kernel }
            })
            .collect();
        forces
    }

    /// Changes of all samples by forces, each a value a step, in the unit of the state's derivative; `visit` is given the
    /// state, the force's index and the samples.
    pub fn each<T: Send>(
        &self,
        forces: &[&[f64]],
        visit: impl Fn(usize, usize, Vec<f64>) -> T + Sync,
    ) -> Vec<T> {
        // Two real forces make one complex sequence.
        let pairs: Vec<(&Kernel, usize)> =
            self.kernels.iter().flat_map(|k| (0..forces.len()).step_by(2).map(move |i| (k, i))).collect();
        let none = vec![0.0; self.data.steps];
        pairs
            .into_par_iter()
            .flat_map_iter(|(kernel, i)| {
                let second = forces.get(i + 1);
                let (a, b) = match self.convolved(kernel, forces[i], second.copied().unwrap_or(&none)) {
                    Some((a, b)) => (Some(a), second.map(|_| b)),
                    None => (
                        self.simulated(kernel, forces[i]),
                        second.and_then(|force| self.simulated(kernel, force)),
                    ),
                };
                let visit = &visit;
                let visited =
                    [a.map(|a| visit(kernel.state, i, a)), b.map(|b| visit(kernel.state, i + 1, b))];
                visited.into_iter().flatten()
            })
            .collect()
    }

    /// From rest, what a step does less what it did a step before.
    fn kernel(&self, state: usize, size: f64, steps: usize) -> Option<Vec<Vec<Complex<f64>>>> {
        let run = |force: f64| -> Option<Vec<Vec<f64>>> {
            let mut simulator = Simulator::expected(self.vehicle, self.data.period_s).ok()?;
            let mut derivative = vec![0.0; self.vehicle.states.len()];
            derivative[state] = force;
            let rest = vec![0.0; self.data.m];
            let mut outputs = vec![Vec::with_capacity(steps); self.vehicle.outputs.len()];
            for _ in 0..steps {
                simulator.disturb(&derivative);
                simulator.apply(&rest);
                outputs.iter_mut().zip(simulator.measure()).for_each(|(o, y)| o.push(*y));
                simulator.advance();
            }
            (!simulator.diverged()).then_some(outputs)
        };
        let (with, without) = (run(size)?, run(0.0)?);
        let spectrum = |(with, without): (Vec<f64>, Vec<f64>)| {
            let mut last = 0.0;
            let mut buffer = vec![Complex::new(0.0, 0.0); self.length];
            for (b, (w, o)) in buffer.iter_mut().zip(with.iter().zip(&without)) {
                let now = (w - o) / size;
                *b = Complex::new((now - last) / self.length as f64, 0.0);
                last = now;
            }
            self.fft.process(&mut buffer);
            buffer
        };
        Some(with.into_iter().zip(without).map(spectrum).collect())
    }

    /// Responses to two forces; `None` where the model is not linear.
    fn convolved(&self, kernel: &Kernel, a: &[f64], b: &[f64]) -> Option<(Vec<f64>, Vec<f64>)> {
        let outputs = kernel.outputs.as_ref()?;
        let data = self.data;
        let (mut first, mut second) = (vec![0.0; data.samples()], vec![0.0; data.samples()]);
        let ends = data.starts.iter().copied().skip(1).chain([data.steps]);
        for (start, end) in data.starts.iter().copied().zip(ends) {
            let mut force = vec![Complex::new(0.0, 0.0); self.length];
            let pair = a[start..end].iter().zip(&b[start..end]);
            force.iter_mut().zip(pair).for_each(|(f, (a, b))| *f = Complex::new(*a, *b));
            self.fft.process(&mut force);
            for (channel, range) in data.channels.iter().zip(data.ranges()) {
                let spectrum = &outputs[channel.output];
                let mut response: Vec<_> = force.iter().zip(spectrum).map(|(f, h)| f * h).collect();
                self.back.process(&mut response);
                for (sample, at) in range.enumerate() {
                    let step = channel.step(sample);
                    if (start..end).contains(&step) {
                        (first[at], second[at]) = (response[step - start].re, response[step - start].im);
                    }
                }
            }
        }
        Some((first, second))
    }

    /// The response to a force, linearly, by a run of its own.
    fn simulated(&self, kernel: &Kernel, force: &[f64]) -> Option<Vec<f64>> {
        let initial = &self.fit.values[..self.free_run.initials()];
        let forced = (kernel.size, force);
        let mut samples = self.free_run.run_forced(self.vehicle, initial, kernel.state, forced).ok()?;
        samples.iter_mut().zip(&self.fit.predicted).for_each(|(y, p)| *y = (*y - p) / kernel.size);
        Some(samples)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::record::Channel;
    use crate::model::free_run::FreeRun;
    use crate::model::noise::Noise;
    use whirlstand_vehicle::{Effect, Kind, Stream};

    /// Two records of a quadrotor, one sensor slower than the others; `effect` is part of it. Calls `check` with its forces on two states.
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
            held: false,
            memory_s: None,
            channels: (0..4).map(channel).collect(),
        };
        let free_run = FreeRun::new(&vehicle, &data);
        let model = Model { free_run: &free_run, free: &[], terms: Vec::new() };
        let initial = vec![0.01; 2 * vehicle.states.len()];
        let fit = model.fit(initial, Some(&Noise::white(&[1.0; 4])), None).unwrap();
        let force: Vec<f64> = (0..steps).map(|_| stream.normal()).collect();
        check(&Forces::new(&model, &fit, &free_run.vehicle, &[(1, 0.1), (3, 0.1)], &force), &force);
    }

    #[test]
    fn a_convolution_is_the_simulation() {
        let late = Effect::new(Kind::SensorDelay, "roll_rate", &[("delay_s", 0.033)]).unwrap();
        with(late, |forces, force| {
            let twice: Vec<f64> = force.iter().map(|f| 2.0 * f).collect();
            let mut all = forces.each(&[force, &twice, force], |state, i, samples| (state, i, samples));
            all.sort_by_key(|(state, i, _)| (*state, *i));
            assert_eq!(all.len(), 6);
            for (state, i, samples) in all {
                let kernel = forces.kernels.iter().find(|k| k.state == state).unwrap();
                assert!(kernel.outputs.is_some(), "linear");
                let simulated = forces.simulated(kernel, if i == 1 { &twice } else { force }).unwrap();
                let reach = simulated.iter().fold(0.0f64, |m, v| m.max(v.abs()));
                assert!(reach > 0.0);
                for (a, b) in simulated.iter().zip(&samples) {
                    assert!((a - b).abs() < 1e-6 * reach, "{state} {i}: {a} {b}");
                }
            }
        });
    }

    #[test]
    fn where_superposition_fails_each_force_is_simulated() {
        let dry = Effect::new(Kind::CoulombFriction, "roll_rate", &[("level", 0.05)]).unwrap();
        with(dry, |forces, force| {
            let roll = forces.kernels.iter().find(|k| k.state == 1).unwrap();
            assert!(roll.outputs.is_none());
            let responses = forces.each(&[force], |state, _, samples| (state, samples));
            let own = responses.iter().find(|(state, _)| *state == 1).unwrap();
            assert_eq!(Some(&own.1), forces.simulated(roll, force).as_ref());
        });
    }
}
