//! Filter model for a vehicle with linear effects: delayed inputs and sensors, lags, modes, and vibration as
//! an oscillator.
//!
//! States that follow from the commands alone (past commands, lags and modes of the inputs) are known and
//! need no estimate: they enter the filter as additional inputs. Lags of sensors and past outputs are states;
//! a delayed measurement is then an exact measurement of an earlier state, at the cost of one state per
//! period of delay (Anderson and Moore, "Optimal Filtering", 1979, section 11.2 on augmentation). A tone of
//! known frequency is an oscillator with process noise, which keeps it in phase. A notch filter would also
//! remove the tone from the output, but with a phase lag of the motion below the tone; the oscillator, as
//! part of the model, causes none.

use nalgebra::DMatrix;
use whirlstand_vehicle::{DiscretiseError, LinearModel};

use super::acting::Acting;
use super::filter_model::FilterModel;
use crate::kernel::{Block, Packed, blocks};
use crate::sampled_model::SampledModel;

/// Initial standard deviation of a tone, and (`TONE_WALK`) its random walk per sqrt(s), relative to its
/// output's noise.
const TONE_START: f64 = 30.0;
const TONE_WALK: f64 = 0.3;

/// Parameters of the extended model besides the vehicle.
pub struct Ingredients<'a> {
    /// Density of the process noise on each own state.
    pub noise: &'a [f64],
    /// Standard deviation of the noise of each output.
    pub std: &'a [f64],
    /// Scales of the own states.
    pub scales: &'a [f64],
    /// Outputs with an estimated bias: index, initial standard deviation, and walk per sqrt(s).
    pub biases: &'a [(usize, f64, f64)],
    /// Inputs with an estimated offset: index, initial standard deviation, and walk per sqrt(s).
    pub input_biases: &'a [(usize, f64, f64)],
}

/// The extended model of a filter.
pub struct Extended {
    /// Model of the filter; its inputs are the commands and the known states.
    pub model: FilterModel,
    /// Initial standard deviations of its states.
    pub initial: Vec<f64>,
    /// Index of the first bias.
    pub first_bias: usize,
    /// States that follow from the commands alone.
    pub known: Known,
}

impl Extended {
    /// Builds the extended model.
    ///
    /// # Errors
    /// [`DiscretiseError`] when an unstable mode of the plant is too fast for the period.
    pub fn new(
        linear: &LinearModel,
        period_s: f64,
        given: &Ingredients<'_>,
    ) -> Result<Self, DiscretiseError> {
        let sampled = SampledModel::new(linear, period_s)?;
        let (own, known, size) = (sampled.layout.own, sampled.layout.known(), sampled.layout.size());
        let (m, p, nb) = (linear.b.ncols(), linear.c.nrows(), given.biases.len());
        // States of the filter: own states, lags of sensors and past outputs, biases, tones.
        let kept: Vec<usize> = (0..own).chain(known..size).collect();
        let trims = given.input_biases.len();
        let (n, count) = (kept.len(), kept.len() + nb + trims + 2 * linear.tones.len());
        let mut density = DMatrix::zeros(linear.a.nrows(), linear.a.nrows());
        for i in 0..own {
            density[(i, i)] = given.noise[i].powi(2) + linear.turbulence[i].powi(2);
        }
        let noise = sampled.noise(&density)?;
        let pick = |m: &DMatrix<f64>, i: usize, j: usize| m[(kept[i], kept[j])];
        let mut f = DMatrix::identity(count, count);
        let mut q = DMatrix::zeros(count, count);
        for i in 0..n {
            for j in 0..n {
                (f[(i, j)], q[(i, j)]) = (pick(&sampled.f, i, j), pick(&noise, i, j));
            }
        }
        let extra = known - own;
        let mut g = DMatrix::zeros(count, m + extra);
        let mut h = DMatrix::zeros(p, count);
        let mut d = DMatrix::zeros(p, m + extra);
        for (i, &at) in kept.iter().enumerate() {
            g.view_mut((i, 0), (1, m)).copy_from(&sampled.g.row(at));
            g.view_mut((i, m), (1, extra)).copy_from(&sampled.f.view((at, own), (1, extra)));
            h.set_column(i, &sampled.h.column(at));
        }
        d.columns_mut(0, m).copy_from(&sampled.d);
        d.columns_mut(m, extra).copy_from(&sampled.h.columns(own, extra));
        let mut initial = starts(linear, &sampled, given);
        for (k, &(output, std, walk)) in given.biases.iter().enumerate() {
            h[(output, n + k)] = 1.0;
            q[(n + k, n + k)] = walk * walk * period_s;
            initial.push(std);
        }
        // An offset of an input acts like a constant command, with past commands, lags and modes at their
        // steady state.
        let rest = rest_under_commands(&sampled);
        for (k, &(input, std, walk)) in given.input_biases.iter().enumerate() {
            let at = n + nb + k;
            for (i, &state) in kept.iter().enumerate() {
                let through = sampled.f.view((state, own), (1, extra)) * rest.column(input);
                f[(i, at)] = sampled.g[(state, input)] + through[0];
            }
            h.set_column(at, &(sampled.d.column(input) + sampled.h.columns(own, extra) * rest.column(input)));
            q[(at, at)] = walk * walk * period_s;
            initial.push(std);
        }
        for (k, &(output, frequency_hz)) in linear.tones.iter().enumerate() {
            let at = n + nb + trims + 2 * k;
            let (sine, cosine) = (std::f64::consts::TAU * frequency_hz * period_s).sin_cos();
            f.view_mut((at, at), (2, 2)).copy_from_slice(&[cosine, -sine, sine, cosine]);
            h[(output, at)] = 1.0;
            for i in at..at + 2 {
                q[(i, i)] = (TONE_WALK * given.std[output]).powi(2) * period_s;
                initial.push(TONE_START * given.std[output]);
            }
        }
        let variance = given.std.iter().map(|s| s * s).collect();
        let known = Known::new(linear, &sampled, period_s);
        Ok(Self { model: FilterModel { f, g, h, d, q, variance }, initial, first_bias: n, known })
    }
}

/// Initial standard deviations of own states, lags and past outputs: ten times their scales.
fn starts(linear: &LinearModel, sampled: &SampledModel, given: &Ingredients<'_>) -> Vec<f64> {
    let size = |output: usize| -> f64 {
        let row = linear.c.row(output);
        let sum: f64 = given.scales.iter().enumerate().map(|(j, s)| row[j].abs() * s).sum();
        if sum > 0.0 { 10.0 * sum } else { 10.0 * given.scales.iter().copied().fold(0.0, f64::max) }
    };
    let motion = sampled.layout.motion();
    let mut initial: Vec<f64> = given.scales.iter().map(|s| 10.0 * s).collect();
    for z in motion..linear.a.nrows() {
        let shown = (0..linear.c.nrows()).find(|i| linear.c[(*i, z)] != 0.0);
        // A lag that no output shows, such as a lag of a lag, has the largest scale.
        initial.push(shown.map_or_else(
            || 10.0 * given.scales.iter().copied().fold(0.0, f64::max),
            |i| {
                let before = (0..given.scales.len())
                    .map(|j| (linear.a[(z, j)] / linear.a[(z, z)]).abs() * given.scales[j]);
                (10.0 * before.sum::<f64>()).max(size(i))
            },
        ));
    }
    for (output, count) in sampled.layout.outputs.iter().enumerate() {
        initial.extend(std::iter::repeat_n(size(output), *count));
    }
    initial
}

/// Steady state of past commands, lags and modes under constant commands, from (I - f) x = g u; all of them
/// decay.
fn rest_under_commands(sampled: &SampledModel) -> DMatrix<f64> {
    let (own, m) = (sampled.layout.own, sampled.g.ncols());
    let count = sampled.layout.known() - own;
    let g = sampled.g.rows(own, count).into_owned();
    let f = sampled.f.view((own, own), (count, count));
    let rest = match count {
        0 => None,
        _ => (DMatrix::identity(count, count) - f).lu().solve(&g),
    };
    rest.unwrap_or_else(|| DMatrix::zeros(count, m))
}

/// States that follow from the commands alone, updated step by step.
#[derive(Debug, Clone)]
pub struct Known {
    f: Packed,
    g: Packed,
    /// Steady state under constant commands.
    rest: Packed,
    state: Vec<f64>,
    scratch: Vec<Block>,
    acting: Vec<Acting>,
    offsets: Vec<f64>,
    /// True when a measurement contains the input of the same time.
    feedthrough: bool,
    begun: bool,
    /// Step number of the run.
    at: u64,
    /// Inputs of the filter over the previous step; `now` holds the present ones, and `y` the outputs minus
    /// their known offsets.
    pub before: Vec<f64>,
    /// See [`Self::before`].
    pub now: Vec<f64>,
    /// See [`Self::before`].
    pub y: Vec<f64>,
}

impl Known {
    fn new(linear: &LinearModel, sampled: &SampledModel, period_s: f64) -> Self {
        let (own, known, m) = (sampled.layout.own, sampled.layout.known(), linear.b.ncols());
        let count = known - own;
        let f = sampled.f.view((own, own), (count, count)).into_owned();
        let g = sampled.g.rows(own, count).into_owned();
        Self {
            rest: Packed::new(&rest_under_commands(sampled)),
            f: Packed::new(&f),
            g: Packed::new(&g),
            state: vec![0.0; count],
            scratch: vec![[0.0; 4]; blocks(count)],
            acting: linear
                .on_inputs
                .iter()
                .zip(&linear.trim)
                .map(|(e, t)| Acting::new(*e, *t, period_s))
                .collect(),
            offsets: linear.offsets.clone(),
            feedthrough: linear.d.iter().any(|v| *v != 0.0),
            begun: false,
            at: 0,
            before: vec![0.0; m + count],
            now: vec![0.0; m + count],
            y: vec![0.0; linear.c.nrows()],
        }
    }

    /// Sets the step number of the next update, where it does not follow the last one.
    pub fn set_step(&mut self, step: u64) {
        self.at = step;
    }

    /// Applies the static effects to the commands. Effects with memory are evaluated once per period: with
    /// feedthrough, the input acting now is reused as the previous one at the next step.
    fn act(&mut self, u_before: &[f64], u_now: &[f64]) {
        let since = self.at.saturating_sub(1);
        for (i, acting) in self.acting.iter_mut().enumerate() {
            self.before[i] = match self.feedthrough && self.begun {
                true => self.now[i],
                false => acting.next(u_before[i], since),
            };
            self.now[i] = if self.feedthrough { acting.next(u_now[i], self.at) } else { self.before[i] };
        }
        self.at = self.at.saturating_add(1);
    }

    /// Propagates the known states by the commands that acted since the previous step, and stores the present
    /// outputs and commands.
    pub fn step(&mut self, y: &[f64], u_before: &[f64], u_now: &[f64]) {
        let m = self.acting.len();
        self.act(u_before, u_now);
        if !self.begun {
            // The past is unknown: the commands are assumed to have been constant.
            self.scratch.fill([0.0; 4]);
            self.rest.add(&mut self.scratch, &self.before[..m]);
            self.state.iter_mut().zip(self.scratch.as_flattened()).for_each(|(s, v)| *s = *v);
        }
        self.before[m..].copy_from_slice(&self.state);
        if self.begun && !self.state.is_empty() {
            self.scratch.fill([0.0; 4]);
            self.f.add(&mut self.scratch, &self.state);
            self.g.add(&mut self.scratch, &self.before[..m]);
            self.state.iter_mut().zip(self.scratch.as_flattened()).for_each(|(s, v)| *s = *v);
        }
        self.begun = true;
        self.now[m..].copy_from_slice(&self.state);
        for (i, value) in self.y.iter_mut().enumerate() {
            *value = y.get(i).map_or(f64::NAN, |y| y - self.offsets[i]);
        }
    }
}

/// The model of a filter that uses only the kinematics of the vehicle, without forces and inputs; sensors are
/// unchanged.
pub fn kinematic(linear: &LinearModel, kinematics: &[Option<(usize, f64)>]) -> LinearModel {
    let (own, first) = (linear.own, linear.own + linear.actuators);
    let kept: Vec<usize> = (0..own).chain(first..linear.a.nrows()).collect();
    let count = kept.len();
    let a = DMatrix::from_fn(count, count, |i, j| match (i < own, j < own) {
        (true, true) => kinematics[i].filter(|(d, _)| *d == j).map_or(0.0, |(_, c)| c),
        (true, false) => 0.0,
        _ => linear.a[(kept[i], kept[j])],
    });
    LinearModel {
        a,
        b: DMatrix::zeros(count, linear.b.ncols()),
        c: linear.c.select_columns(&kept),
        d: linear.d.map(|_| 0.0),
        actuators: 0,
        input_delays_s: vec![0.0; linear.b.ncols()],
        names: linear.names[linear.actuators..].to_vec(),
        ..linear.clone()
    }
}
