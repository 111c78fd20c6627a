//! Step responses of the samples to a force on each state, and the responses to sines that follow from them.

use std::f64::consts::TAU;

use rayon::prelude::*;
use whirlstand_vehicle::{Effect, Kind};

use crate::candidates::library::Sizes;
use crate::data::record::Data;
use crate::model::fit::{Fit, Model};
use crate::model::wave::Wave;

/// Changes of all samples per unit of a constant force on each state, applied from the beginning of each
/// record on.
///
/// The model is assumed linear and time-invariant: effects found with these responses are refitted with the
/// simulator afterwards.
#[derive(Debug, Clone)]
pub struct Responses(Vec<Option<Vec<f64>>>);

impl Responses {
    /// Simulates one step response per state.
    pub fn new(model: &Model<'_, '_>, fit: &Fit, sizes: &Sizes) -> Self {
        let states = &model.free_run.vehicle.states;
        let step = |i: usize| -> Option<Vec<f64>> {
            // The force is smaller than a nonlinear effect would notice and larger than rounding.
            let size = 1e-3 * sizes.slopes[i].max(1e-9);
            let values = [("at_s", 0.0), ("magnitude", size)];
            let effect = Effect::new(Kind::StepDisturbance, &states[i].name, &values).ok()?;
            let mut vehicle = model.vehicle(&fit.values).ok()?;
            vehicle.add_effect(effect).ok()?;
            let mut response = model.free_run.run_vehicle(&vehicle, &fit.values[..model.states()]).ok()?;
            response.iter_mut().zip(&fit.predicted).for_each(|(r, y)| *r = (*r - y) / size);
            Some(response)
        };
        Self((0..states.len()).into_par_iter().map(step).collect())
    }

    /// Response to a unit step; `None` where the model cannot be simulated with it.
    pub fn step(&self, state: usize) -> Option<&[f64]> {
        self.0[state].as_deref()
    }

    /// Responses to sin and cos of 2 pi f t: the impulse response h up to t, turned back, is a running sum,
    /// y(t) = Im, Re of exp(iwt) times the integral of h(s) exp(-iws) from 0 to t. Between samples the step response is taken as straight.
    pub fn waves(&self, data: &Data, state: usize, frequency_hz: f64) -> Option<(Vec<f64>, Vec<f64>)> {
        let step = self.step(state)?;
        let (mut sine, mut cosine) = (vec![0.0; step.len()], vec![0.0; step.len()]);
        for (channel, range) in data.channels.iter().zip(data.ranges()) {
            let mut records = data.starts.iter().copied().peekable();
            let mut start = 0;
            let mut last = (0.0, 0.0);
            let mut sum = (0.0, 0.0);
            // From one sample to the next: half the angle, its cosine and sine, and the share of the step
            // response's increment that counts.
            let mut turn = (f64::NAN, 1.0, 0.0, 1.0);
            // Phases count from the record's beginning, the response from the beginning of the part in use.
            let mut phase = (0.0, 1.0);
            let mut wave = Wave::new(0.0, channel.stride as f64 * data.period_s * frequency_hz);
            for (k, at) in range.enumerate() {
                let now = channel.step(k);
                while let Some(next) = records.next_if(|s| *s <= now) {
                    (start, last, sum) = (next, (0.0, 0.0), (0.0, 0.0));
                    wave.begin((now - start) as f64 * data.period_s * frequency_hz);
                    phase = (TAU * data.time_s(start) * frequency_hz).sin_cos();
                }
                let t = (now - start) as f64 * data.period_s;
                let half = 0.5 * TAU * frequency_hz * (t - last.0);
                if (half - turn.0).abs() > 1e-9 * half || turn.0.is_nan() {
                    let share = if half.abs() > 1e-9 { half.sin() / half } else { 1.0 };
                    turn = (half, half.cos(), half.sin(), share);
                }
                let (_, half_c, half_s, share) = turn;
                let (s, c) = wave.advance();
                let rise = (step[at] - last.1) * share;
                // Midway between this sample and the last.
                sum = (sum.0 + rise * (c * half_c + s * half_s), sum.1 - rise * (s * half_c - c * half_s));
                let (own_s, own_c) = (s * sum.0 + c * sum.1, c * sum.0 - s * sum.1);
                sine[at] = own_s * phase.1 + own_c * phase.0;
                cosine[at] = own_c * phase.1 - own_s * phase.0;
                last = (t, step[at]);
            }
        }
        Some((sine, cosine))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::free_run::FreeRun;

    #[test]
    fn a_wave_from_the_step_response_is_the_simulated_one() {
        let vehicle = whirlstand_vehicle::Vehicle::builtin("quadrotor").unwrap();
        let period_s = 0.01;
        let steps = 800;
        let channels = (0..vehicle.outputs.len())
            .map(|output| crate::data::record::Channel {
                output,
                stride: 1,
                first: 0,
                values: (0..steps).map(|k| if k % 2 == 0 { 1.0 } else { -1.0 }).collect(),
                good: vec![true; steps],
                early: Vec::new(),
                declared: 0.0,
            })
            .collect();
        let m = vehicle.inputs.len();
        let data = Data {
            origin: "none".into(),
            start_s: 0.0,
            period_s,
            steps,
            inputs: vec![0.0; steps * m],
            m,
            starts: vec![0],
            clocks: vec![0],
            held: false,
            memory_s: None,
            likeliest_s: None,
            likeliest_filter: None,
            channels,
        };
        let free_run = FreeRun::new(&vehicle, &data);
        let model = Model { free_run: &free_run, free: &[], terms: Vec::new() };
        let n = vehicle.states.len();
        let fit = model.fit(vec![0.0; n], Some(&crate::model::noise::Noise::white(&[1.0; 4])), None).unwrap();
        let sizes = Sizes::ones(&vehicle, 8.0, period_s);
        let responses = Responses::new(&model, &fit, &sizes);
        for (state, frequency_hz) in [(0, 0.7), (1, 3.0), (3, 20.0)] {
            let (sine, cosine) = responses.waves(&data, state, frequency_hz).unwrap();
            for (phase, wave) in [(0.0, sine), (std::f64::consts::FRAC_PI_2, cosine)] {
                let values = [("frequency_hz", frequency_hz), ("amplitude", 1.0), ("phase_rad", phase)];
                let effect =
                    Effect::new(Kind::PeriodicDisturbance, &vehicle.states[state].name, &values).unwrap();
                let mut simulated = free_run.run(&[effect], &fit.values).unwrap();
                simulated.iter_mut().zip(&fit.predicted).for_each(|(y, p)| *y -= p);
                let peak = simulated.iter().fold(0.0f64, |m, y| m.max(y.abs()));
                let worst = simulated.iter().zip(&wave).fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
                assert!(worst < 0.02 * peak, "{state} {frequency_hz} Hz {phase}: {worst} of {peak}");
            }
        }
    }
}
