//! Predictors that follow a record: a Kalman filter along its samples, with missing ones skipped.
//!
//! A free run is the limit of a family of predictors, without any correction: an unrecorded disturbance (a
//! gust, a drift) stays in it forever, and where the vehicle is unstable it grows. A predictor with process
//! noise is corrected by its prediction errors (Ljung, System Identification, 1999, chapter 7; Jategaonkar,
//! Flight Vehicle System Identification, 2015, chapter 5: filter error). Its innovations are residuals like
//! those of a free run: any predictor of the next sample from earlier ones gives a likelihood (Ljung, 7.4),
//! so that all predictors of one record can be compared by it.

use nalgebra::{DMatrix, DVector};
use whirlstand_vehicle::{Vehicle, discretise};

use crate::data::record::Data;
use crate::thresholds::SETTLED_GAIN_CHANGE;
use whirlstand_logs::stats::white_noise_std;

/// Filter gains along a record.
#[derive(Debug, Clone, PartialEq)]
pub struct Observer {
    /// Gains, states x channels, column after column.
    gains: Vec<Vec<f64>>,
    /// Index into `gains` of every step.
    steps: Vec<u32>,
    states: usize,
}

impl Observer {
    /// The filter of a vehicle over a record with a memory of `memory_s`: the process noise on each state
    /// with dynamics of its own is so large that within that time it moves a channel by the standard error of
    /// the mean of the channel's samples over that time.
    ///
    /// `None` when the linear model has no finite discretisation or the filter's covariance grows without
    /// bound: an unstable and unobservable mode cannot be followed.
    pub fn new(vehicle: &Vehicle, data: &Data, memory_s: &[f64]) -> Option<Self> {
        let (phi, _) = discretise(&vehicle.a, &vehicle.b, data.period_s).ok()?;
        let (n, p) = (vehicle.states.len(), data.channels.len());
        let c = DMatrix::from_fn(p, n, |i, j| vehicle.c[(data.channels[i].output, j)]);
        let noise = measurement_noise(vehicle, data);
        let driving = driving(vehicle, data, (&phi, &c), &noise, memory_s);
        let mut covariance = DMatrix::zeros(n, n);
        let mut observer =
            Self { gains: vec![vec![0.0; n * p]], steps: Vec::with_capacity(data.steps), states: n };
        // Where the same channels are measured as a step before and the covariance has settled, so has the
        // gain.
        let mut last: Option<(Vec<usize>, u32)> = None;
        for k in 0..data.steps {
            if data.starts.contains(&k) {
                covariance.fill(0.0);
                last = None;
            }
            let measured: Vec<usize> =
                (0..p).filter(|i| data.channels[*i].measured_at(k).is_some()).collect();
            if let Some((same, at)) = &last
                && *same == measured
            {
                observer.steps.push(*at);
                continue;
            }
            let before = covariance.clone();
            let mut at = 0;
            if !measured.is_empty() {
                let rows = c.select_rows(&measured);
                let shown = &covariance * rows.transpose();
                let mut innovation = &rows * &shown;
                measured.iter().enumerate().for_each(|(i, m)| innovation[(i, i)] += noise[*m].powi(2));
                let gain = innovation.cholesky()?.solve(&shown.transpose()).transpose();
                covariance -= &gain * shown.transpose();
                let mut whole = vec![0.0; n * p];
                measured.iter().zip(gain.column_iter()).for_each(|(m, column)| {
                    whole[m * n..(m + 1) * n].iter_mut().zip(column.iter()).for_each(|(w, g)| *w = *g);
                });
                at = observer.gains.len() as u32;
                observer.gains.push(whole);
            }
            observer.steps.push(at);
            covariance = &phi * &covariance * phi.transpose();
            (0..n).for_each(|i| covariance[(i, i)] += driving[i]);
            covariance = 0.5 * (&covariance + covariance.transpose());
            let size = covariance.diagonal().max();
            if !size.is_finite() || size > 1e200 {
                return None;
            }
            let change = (&covariance - &before).abs().max();
            let settled = change <= SETTLED_GAIN_CHANGE * size;
            // Slow channels alternate: the gain settles only where all channels are measured at every step.
            last = (settled && data.channels.iter().all(|c| c.stride == 1)).then_some((measured, at));
        }
        Some(observer)
    }

    /// The filter of a decoupled part, by its states and channels.
    pub fn of_part(&self, states: &[usize], channels: &[usize]) -> Self {
        let part = |gains: &Vec<f64>| {
            channels.iter().flat_map(|c| states.iter().map(move |i| gains[c * self.states + i])).collect()
        };
        Self { gains: self.gains.iter().map(part).collect(), steps: self.steps.clone(), states: states.len() }
    }

    /// Correction of the state by the prediction errors (measured minus predicted, one per channel, 0 for a
    /// channel without a sample) at step `k`.
    pub fn change(&self, k: usize, errors: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        let gains = &self.gains[self.steps[k] as usize];
        for (error, column) in errors.iter().zip(gains.chunks_exact(self.states)) {
            out.iter_mut().zip(column).for_each(|(x, gain)| *x += gain * error);
        }
    }
}

/// Standard deviation of each channel's noise: the declared one, or an estimate from sample-to-sample
/// changes.
fn measurement_noise(vehicle: &Vehicle, data: &Data) -> Vec<f64> {
    let noise = |channel: &crate::data::record::Channel| {
        let declared = vehicle.outputs[channel.output].noise;
        if declared > 0.0 {
            return declared;
        }
        let values: Vec<f64> = channel.values.iter().copied().filter(|v| v.is_finite()).collect();
        let mean = whirlstand_logs::stats::mean(&values);
        let spread = whirlstand_logs::stats::rms(&values.iter().map(|v| v - mean).collect::<Vec<_>>());
        white_noise_std(&values).max(1e-4 * spread).max(1e-12)
    };
    data.channels.iter().map(noise).collect()
}

/// Variance of the process noise per step, one per state.
fn driving(
    vehicle: &Vehicle,
    data: &Data,
    (phi, c): (&DMatrix<f64>, &DMatrix<f64>),
    noise: &[f64],
    memory_s: &[f64],
) -> Vec<f64> {
    let n = vehicle.states.len();
    // An unstable vehicle does not forget what moved it: without its growth, which would leave hardly any process noise.
    let poles = vehicle.poles().unwrap_or_default();
    let fastest_growth = poles.iter().fold(0.0f64, |most, pole| most.max(pole.re));
    let phi = phi * (-fastest_growth * data.period_s).exp();
    let one = |state: usize| {
        if vehicle.kinematic_row(state).is_some() {
            return 0.0;
        }
        let steps = ((memory_s[state] / data.period_s).round() as usize).max(1);
        let mut x = DVector::zeros(n);
        x[state] = 1.0;
        // Variance in each channel due to white process noise of variance one per step.
        let mut moved = vec![0.0; c.nrows()];
        for _ in 0..steps {
            moved.iter_mut().zip((c * &x).iter()).for_each(|(m, y)| *m += y * y);
            x = &phi * x;
        }
        let samples = data.channels.iter().map(|channel| (steps as f64 / channel.stride as f64).max(1.0));
        let least =
            moved.iter().zip(noise).zip(samples).map(|((m, noise), samples)| noise * noise / samples / m);
        let least = least.fold(f64::INFINITY, f64::min);
        if least.is_finite() { least } else { 0.0 }
    };
    (0..n).map(one).collect()
}

#[cfg(test)]
mod tests {
    use crate::data::flown::flown;
    use crate::data::record::Data;
    use crate::model::free_run::FreeRun;
    use whirlstand_vehicle::Vehicle;

    /// A pendulum that a law holds upright: what a filter with a long memory knew was lost in the growth, and its predictions
    /// left all bounds before it was corrected.
    #[test]
    fn an_unstable_vehicle_is_followed_with_any_memory() {
        let text = "A = [[10.0]]\nB = [[1.0]]\nC = [[1.0]]\nstates = [{ name = \"tilt\" }]\ninputs = [{ name = \"u\" }]\n\
                    outputs = [{ name = \"tilt\", noise = 0.01 }]\n";
        let vehicle = Vehicle::parse(text, "pendulum.toml").unwrap();
        // What is recorded stays near zero, as does what the loop made of it.
        let mut held = vehicle.clone();
        held.a[(0, 0)] = -1.0;
        for memory_s in [0.04, 0.5, 5.0] {
            let data = Data { memory_s: Some(memory_s), ..flown(&held, vec![0.0; 1000], 3) };
            let run = FreeRun::new(&vehicle, &data).run_vehicle(&vehicle, &[0.1]);
            let largest = run.unwrap().into_iter().fold(0.0f64, |most, y| most.max(y.abs()));
            assert!(largest < 10.0, "{memory_s} s: {largest}");
        }
    }
}
