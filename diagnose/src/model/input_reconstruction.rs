//! Input reconstruction: estimates the unknown input or force that would explain a residual.
//!
//! The residual is modelled as the response of the linear model to an unknown input or force that is a random
//! walk, plus noise. A Kalman filter forward and the smoother of Rauch, Tung and Striebel (1965) backward,
//! both with steady gains, estimate the unknown.

use crate::thresholds::{RESPONSE_STEPS, RICCATI_ROUNDS};
use nalgebra::{DMatrix, DVector};
use whirlstand_vehicle::{Vehicle, discretise};

use crate::data::record::Data;
use whirlstand_ident::identify::normal::pseudo_inverse;
use whirlstand_logs::stats::rms;

/// Entry of the unknown signal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Entry {
    /// Added to an input.
    Input(usize),
    /// Added to the derivative of a state.
    State(usize),
}

/// The linear model augmented by the unknown at one entry, with its filter and smoother.
struct Inverse {
    /// State transition matrix of model and unknown.
    f: DMatrix<f64>,
    /// Output matrix of model and unknown, all channels.
    h: DMatrix<f64>,
    /// Gain of the filter.
    gain: DMatrix<f64>,
    /// Gain of the smoother.
    back: DMatrix<f64>,
}

/// Estimates of the unknown over the steps of a record for several residuals (samples of all channels), all
/// with the same smoothing: that for the first of them, which is free of noise. `noise` is the standard
/// deviation of each channel's noise.
///
/// `None` when no channel responds to the entry, or the filter does not settle.
pub fn reconstruct(
    vehicle: &Vehicle,
    data: &Data,
    entry: Entry,
    noise: &[f64],
    residuals: &[&[f64]],
) -> Option<Vec<Vec<f64>>> {
    let rows: Vec<Vec<f64>> = residuals.iter().map(|r| spread(data, r)).collect();
    let clean = rows.first()?;
    let p = data.channels.len();
    let (f, h) = augmented(vehicle, data, entry)?;
    let sizes: Vec<f64> =
        (0..p).map(|c| rms(&clean.iter().skip(c).step_by(p).copied().collect::<Vec<_>>())).collect();
    let loud = sizes.iter().copied().fold(0.0, f64::max);
    let response = response(&f, &h);
    let step = (0..p)
        .filter(|c| response[*c] > 0.0 && sizes[*c] > 1e-6 * loud)
        .map(|c| sizes[c] / response[c])
        .fold(f64::INFINITY, f64::min);
    if !(step.is_finite() && step > 0.0) {
        return None;
    }
    // First without noise: how much the unknown changes from step to step.
    let quiet: Vec<f64> = sizes.iter().map(|s| 1e-3 * s.max(1e-6 * loud)).collect();
    let first = Inverse::new(&f, &h, step, &quiet)?.trace(data, clean);
    let moves = rms(&first.windows(2).map(|w| w[1] - w[0]).collect::<Vec<_>>());
    let moves = moves.max(1e-3 * rms(&first));
    if !(moves.is_finite() && moves > 0.0) {
        return None;
    }
    let noise: Vec<f64> = noise
        .iter()
        .zip(&data.channels)
        .zip(&quiet)
        .map(|((n, channel), q)| (n * (channel.stride as f64).sqrt()).max(*q))
        .collect();
    let inverse = Inverse::new(&f, &h, moves, &noise)?;
    let traces: Vec<Vec<f64>> = rows.iter().map(|r| inverse.trace(data, r)).collect();
    traces.iter().flatten().all(|v| v.is_finite()).then_some(traces)
}

/// Response of the linear model to a sequence at the entry: all channels side by side, step after step.
pub fn answers(vehicle: &Vehicle, data: &Data, entry: Entry, sequence: &[f64]) -> Option<Vec<f64>> {
    let (f, h) = augmented(vehicle, data, entry)?;
    let n = f.nrows();
    let mut x = DVector::zeros(n);
    let mut rows: Vec<f64> = Vec::with_capacity(sequence.len() * h.nrows());
    for v in sequence {
        x[n - 1] = *v;
        rows.extend((&h * &x).iter());
        x = &f * x;
    }
    rows.iter().all(|v| v.is_finite()).then_some(rows)
}

/// Samples of all channels at every step, channels side by side; linear interpolation between the samples of
/// a slow sensor.
pub fn spread(data: &Data, samples: &[f64]) -> Vec<f64> {
    let p = data.channels.len();
    let mut rows = vec![0.0; data.steps * p];
    for (c, (channel, range)) in data.channels.iter().zip(data.ranges()).enumerate() {
        let mut values = samples[range.clone()].to_vec();
        values.iter_mut().filter(|v| !v.is_finite()).for_each(|v| *v = 0.0);
        let last = values.len().saturating_sub(1);
        for k in 0..data.steps {
            let at = (k.saturating_sub(channel.first)) as f64 / channel.stride as f64;
            let i = (at as usize).min(last);
            let (a, b) = (
                values.get(i).copied().unwrap_or(0.0),
                values.get((i + 1).min(last)).copied().unwrap_or(0.0),
            );
            rows[k * p + c] = a + (b - a) * (at - i as f64).clamp(0.0, 1.0);
        }
    }
    rows
}

fn augmented(vehicle: &Vehicle, data: &Data, entry: Entry) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
    let (n, p) = (vehicle.states.len(), data.channels.len());
    let mut push = DMatrix::zeros(n, 1);
    match entry {
        Entry::Input(j) => push.copy_from(&vehicle.b.columns(j, 1)),
        Entry::State(i) => push[(i, 0)] = 1.0,
    }
    let (phi, gamma) = discretise(&vehicle.a, &push, data.period_s).ok()?;
    let mut f = DMatrix::identity(n + 1, n + 1);
    f.view_mut((0, 0), (n, n)).copy_from(&phi);
    f.view_mut((0, n), (n, 1)).copy_from(&gamma);
    let mut h = DMatrix::zeros(p, n + 1);
    for (c, channel) in data.channels.iter().enumerate() {
        h.view_mut((c, 0), (1, n)).copy_from(&vehicle.c.rows(channel.output, 1));
        if let Entry::Input(j) = entry {
            h[(c, n)] = vehicle.d[(channel.output, j)];
        }
    }
    Some((f, h))
}

/// Response of each channel to a constant unknown of one within some steps.
fn response(f: &DMatrix<f64>, h: &DMatrix<f64>) -> Vec<f64> {
    let n = f.nrows();
    let mut x = DVector::zeros(n);
    x[n - 1] = 1.0;
    let mut most = vec![0.0f64; h.nrows()];
    for _ in 0..=RESPONSE_STEPS {
        (h * &x).iter().zip(&mut most).for_each(|(y, m)| *m = m.max(y.abs()));
        x = f * x;
    }
    most
}

impl Inverse {
    /// The filter and smoother; `step` is the standard deviation of the unknown's change per step.
    fn new(f: &DMatrix<f64>, h: &DMatrix<f64>, step: f64, noise: &[f64]) -> Option<Self> {
        let n = f.nrows();
        let mut q = DMatrix::zeros(n, n);
        for i in 0..n {
            // A small process noise on the states keeps the recursion regular.
            let size = if i + 1 == n { step } else { 1e-3 * step * f[(i, n - 1)].abs() };
            q[(i, i)] = size * size;
        }
        let r = DMatrix::from_diagonal(&DVector::from_iterator(noise.len(), noise.iter().map(|s| s * s)));
        let mut predicted = q.clone();
        let (mut gain, mut filtered) = (DMatrix::zeros(n, noise.len()), q.clone());
        for _ in 0..RICCATI_ROUNDS {
            let through = h * &predicted;
            let inverse = pseudo_inverse(&(&through * h.transpose() + &r))?;
            gain = through.transpose() * inverse;
            filtered = &predicted - &gain * &through;
            let next = f * &filtered * f.transpose() + &q;
            let next = (&next + next.transpose()) * 0.5;
            let change = (&next - &predicted).amax() / next.amax();
            predicted = next;
            if change < 1e-7 {
                break;
            }
        }
        let back = &filtered * f.transpose() * pseudo_inverse(&predicted)?;
        let finite = gain.iter().chain(back.iter()).all(|v| v.is_finite());
        finite.then_some(Self { f: f.clone(), h: h.clone(), gain, back })
    }

    /// The estimated unknown over the steps of the record.
    fn trace(&self, data: &Data, rows: &[f64]) -> Vec<f64> {
        let (n, p) = (self.f.nrows(), self.h.nrows());
        let mut filtered: Vec<DVector<f64>> = Vec::with_capacity(data.steps);
        let mut x = DVector::zeros(n);
        let mut e = DVector::zeros(p);
        for k in 0..data.steps {
            if data.starts.contains(&k) {
                x.fill(0.0);
            }
            e.copy_from_slice(&rows[k * p..(k + 1) * p]);
            e.gemv(-1.0, &self.h, &x, 1.0);
            x.gemv(1.0, &self.gain, &e, 1.0);
            filtered.push(x.clone());
            x = &self.f * x;
        }
        let mut unknown = vec![0.0; data.steps];
        let mut after: Option<DVector<f64>> = None;
        for k in (0..data.steps).rev() {
            let mut now = filtered[k].clone();
            if let Some(mut next) = after.take().filter(|_| !data.starts.contains(&(k + 1))) {
                next.gemv(-1.0, &self.f, &now, 1.0);
                now.gemv(1.0, &self.back, &next, 1.0);
            }
            unknown[k] = now[n - 1];
            after = Some(now);
        }
        unknown
    }
}
