//! A linear model with delays on its inputs and outputs, sampled exactly.
//!
//! A delay of h periods and a fraction f of one means that the input changes f after the beginning of a
//! period, from the command h + 1 periods ago to that of h periods ago (the modified z-transform: Jury,
//! "Theory and Application of the z-Transform Method", 1964; Astrom and Wittenmark, "Computer-Controlled
//! Systems", 3rd edition, section 2.3). So a period is split where an input changes or an output is sampled;
//! within each part all inputs are constant, and one matrix exponential solves it. Past commands and past
//! outputs are states: shift registers that advance once per period.

use nalgebra::DMatrix;
use whirlstand_vehicle::{DiscretiseError, LinearModel, discretise, finite_horizon_gramian, split_time};

use crate::lqr::sampled_cost;

/// Largest distance of two splits, relative to the period, at which they are the same.
const SAME: f64 = 2e-9;

/// Order of the states of a [`SampledModel`]: the vehicle's own states, its actuators', past commands (those
/// of the first input first, the newest first), its sensors' lags, past outputs.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Layout {
    /// Number of the vehicle's own states.
    pub own: usize,
    /// Number of states of lags and modes on inputs.
    pub actuators: usize,
    /// Number of past commands stored for each input.
    pub commands: Vec<usize>,
    /// Number of states of sensor lags.
    pub lags: usize,
    /// Number of past values stored for each output.
    pub outputs: Vec<usize>,
}

impl Layout {
    /// Number of own states and actuator states: those of a continuous model of the motion.
    pub fn motion(&self) -> usize {
        self.own + self.actuators
    }

    /// Number of own states and all states that follow from the commands alone.
    pub fn known(&self) -> usize {
        self.motion() + self.commands.iter().sum::<usize>()
    }

    /// Total number of states.
    pub fn size(&self) -> usize {
        self.known() + self.lags + self.outputs.iter().sum::<usize>()
    }

    /// Index of a state of the continuous model.
    fn place(&self, z: usize) -> usize {
        if z < self.motion() { z } else { z - self.motion() + self.known() }
    }

    /// Index of the command of `input` of `back` periods ago, `back` from 1.
    pub fn command(&self, input: usize, back: usize) -> usize {
        self.motion() + self.commands[..input].iter().sum::<usize>() + back - 1
    }

    /// Index of the value of `output` stored `back` periods ago, `back` from 1.
    fn output(&self, output: usize, back: usize) -> usize {
        self.known() + self.lags + self.outputs[..output].iter().sum::<usize>() + back - 1
    }
}

/// `s+ = f s + g u`, `y = h s + d u`, exact at the samples; u is the command in force less the trim.
#[derive(Debug, Clone, PartialEq)]
pub struct SampledModel {
    /// The order of the states.
    pub layout: Layout,
    /// Transition, N x N.
    pub f: DMatrix<f64>,
    /// Input matrix, N x m.
    pub g: DMatrix<f64>,
    /// Output matrix, p x N.
    pub h: DMatrix<f64>,
    /// Feed-through, p x m.
    pub d: DMatrix<f64>,
    period_s: f64,
    substeps: Vec<Substep>,
    /// For every output, the offset at which it is sampled for later, and the number of periods after which
    /// it is read.
    taps: Vec<(f64, usize)>,
    model: LinearModel,
}

/// A part of the period over which all inputs are constant.
#[derive(Debug, Clone, PartialEq)]
struct Substep {
    start_s: f64,
    length_s: f64,
    phi: DMatrix<f64>,
    /// The continuous states at its beginning and the inputs during it, as functions of `[s; u]`.
    state: DMatrix<f64>,
    drive: DMatrix<f64>,
}

impl SampledModel {
    /// The model of the motion alone, without sensors and outputs.
    ///
    /// # Errors
    /// [`DiscretiseError`] when an unstable mode is too fast for the period.
    pub fn motion(model: &LinearModel, period_s: f64) -> Result<Self, DiscretiseError> {
        let (nz, m) = (model.own + model.actuators, model.b.ncols());
        let blind = LinearModel {
            a: model.a.view((0, 0), (nz, nz)).into_owned(),
            b: model.b.rows(0, nz).into_owned(),
            c: DMatrix::zeros(0, nz),
            d: DMatrix::zeros(0, m),
            mix: DMatrix::zeros(0, 0),
            output_delays_s: Vec::new(),
            ..model.clone()
        };
        Self::new(&blind, period_s)
    }

    /// The model of the vehicle with its sensors.
    ///
    /// # Errors
    /// [`DiscretiseError`] when an unstable mode is too fast for the period.
    pub fn new(model: &LinearModel, period_s: f64) -> Result<Self, DiscretiseError> {
        let (nz, m) = model.b.shape();
        let inputs: Vec<(usize, f64)> = model.input_delays_s.iter().map(|d| whole(*d, period_s)).collect();
        let taps: Vec<(f64, usize)> = model.output_delays_s.iter().map(|d| tap(*d, period_s)).collect();
        let layout = Layout {
            own: model.own,
            actuators: model.actuators,
            commands: inputs.iter().map(|(h, f)| h + usize::from(*f > 0.0)).collect(),
            lags: nz - model.own - model.actuators,
            outputs: taps.iter().map(|(_, back)| *back).collect(),
        };
        let (size, width) = (layout.size(), layout.size() + m);
        // The acting input i from the offset on.
        let drive = |offset_s: f64| {
            let mut rows = DMatrix::zeros(m, width);
            for (i, (h, f)) in inputs.iter().enumerate() {
                let back = if offset_s + SAME * period_s < *f { h + 1 } else { *h };
                rows[(i, if back == 0 { size + i } else { layout.command(i, back) })] = 1.0;
            }
            rows
        };
        let mut state = DMatrix::zeros(nz, width);
        (0..nz).for_each(|z| state[(z, layout.place(z))] = 1.0);
        let cuts = cuts(inputs.iter().map(|i| i.1).chain(taps.iter().map(|t| t.0)), period_s);
        let mut substeps = Vec::with_capacity(cuts.len());
        for (k, &start_s) in cuts.iter().enumerate() {
            let length_s = cuts.get(k + 1).copied().unwrap_or(period_s) - start_s;
            let (phi, gamma) = discretise(&model.a, &model.b, length_s)?;
            let held = drive(start_s);
            let next = &phi * &state + gamma * &held;
            substeps.push(Substep {
                start_s,
                length_s,
                phi,
                state: std::mem::replace(&mut state, next),
                drive: held,
            });
        }
        let (step, seen) = shift(model, &layout, &taps, &substeps, &state, period_s);
        let seen = if model.mix.is_identity(0.0) { seen } else { &model.mix * seen };
        Ok(Self {
            f: step.columns(0, size).into_owned(),
            g: step.columns(size, m).into_owned(),
            h: seen.columns(0, size).into_owned(),
            d: seen.columns(size, m).into_owned(),
            layout,
            period_s,
            substeps,
            taps,
            model: model.clone(),
        })
    }

    /// The same motion with every input delay reduced by `periods` whole periods; no delay may be shorter.
    ///
    /// # Errors
    /// [`DiscretiseError`] when an unstable mode is too fast for the period.
    pub fn sooner(&self, periods: usize, period_s: f64) -> Result<Self, DiscretiseError> {
        let mut model = self.model.clone();
        model.input_delays_s.iter_mut().for_each(|d| *d = (*d - periods as f64 * period_s).max(0.0));
        Self::new(&model, period_s)
    }

    /// The cost over one period of the continuous states, `z' q z` integrated, as a quadratic form in `[s; u]`.
    ///
    /// # Errors
    /// [`DiscretiseError`] when an unstable mode is too fast for the period.
    pub fn cost(&self, q: &DMatrix<f64>) -> Result<DMatrix<f64>, DiscretiseError> {
        let (nz, m) = self.model.b.shape();
        let width = self.f.nrows() + m;
        let mut total = DMatrix::zeros(width, width);
        for s in &self.substeps {
            let cost = sampled_cost(&self.model.a, &self.model.b, q, &DMatrix::zeros(m, m), s.length_s)?;
            let mut weight = DMatrix::zeros(nz + m, nz + m);
            weight.view_mut((0, 0), (nz, nz)).copy_from(&cost.q);
            weight.view_mut((nz, nz), (m, m)).copy_from(&cost.r);
            weight.view_mut((0, nz), (nz, m)).copy_from(&cost.s);
            weight.view_mut((nz, 0), (m, nz)).copy_from(&cost.s.transpose());
            let mut form = DMatrix::zeros(nz + m, width);
            form.rows_mut(0, nz).copy_from(&s.state);
            form.rows_mut(nz, m).copy_from(&s.drive);
            total += form.tr_mul(&(weight * &form));
        }
        Ok((&total + total.transpose()) * 0.5)
    }

    /// Covariance that white noise of this density (nz x nz) on the derivatives of the continuous states adds
    /// to all states in a period, including values sampled inside the period for a delayed sensor.
    ///
    /// # Errors
    /// [`DiscretiseError`] when an unstable mode is too fast for the period.
    pub fn noise(&self, density: &DMatrix<f64>) -> Result<DMatrix<f64>, DiscretiseError> {
        let (nz, size) = (self.model.a.nrows(), self.f.nrows());
        // For the noise of each part, its contribution to the states at the split reached so far.
        let mut parts: Vec<(DMatrix<f64>, DMatrix<f64>, DMatrix<f64>)> = Vec::new();
        let begun = |s: &Substep, offset_s: f64| s.start_s <= offset_s + SAME * self.period_s;
        for (k, s) in self.substeps.iter().enumerate() {
            for (reached, _, rows) in &mut parts {
                for (j, &(offset_s, back)) in self.taps.iter().enumerate() {
                    let later = self.substeps.get(k + 1).is_some_and(|next| begun(next, offset_s));
                    if back > 0 && begun(s, offset_s) && !later {
                        rows.set_row(self.layout.output(j, 1), &(self.model.c.row(j) * &*reached));
                    }
                }
                *reached = &s.phi * &*reached;
            }
            let gramian = finite_horizon_gramian(&self.model.a, density, s.length_s)?;
            parts.push((DMatrix::identity(nz, nz), gramian, DMatrix::zeros(size, nz)));
        }
        let mut total = DMatrix::zeros(size, size);
        for (reached, gramian, mut rows) in parts {
            (0..nz).for_each(|z| rows.set_row(self.layout.place(z), &reached.row(z)));
            total += &rows * gramian * rows.transpose();
        }
        Ok(total)
    }
}

/// Transition over a period and outputs at its beginning, as functions of `[s; u]`: the continuous states at
/// the end are `state`, and registers shift.
fn shift(
    model: &LinearModel,
    layout: &Layout,
    taps: &[(f64, usize)],
    substeps: &[Substep],
    state: &DMatrix<f64>,
    period_s: f64,
) -> (DMatrix<f64>, DMatrix<f64>) {
    let (nz, m) = model.b.shape();
    let (size, p) = (layout.size(), model.c.nrows());
    let width = size + m;
    let mut step = DMatrix::zeros(size, width);
    (0..nz).for_each(|z| step.set_row(layout.place(z), &state.row(z)));
    for (i, count) in layout.commands.iter().enumerate() {
        for back in 1..=*count {
            let from = if back == 1 { size + i } else { layout.command(i, back - 1) };
            step[(layout.command(i, back), from)] = 1.0;
        }
    }
    let mut seen = DMatrix::zeros(p, width);
    for (j, &(offset_s, back)) in taps.iter().enumerate() {
        let at = |s: &Substep| model.c.row(j) * &s.state + model.d.row(j) * &s.drive;
        match back {
            0 => seen.set_row(j, &at(&substeps[0])),
            _ => {
                let taken = substeps.iter().rfind(|s| s.start_s <= offset_s + SAME * period_s);
                taken.into_iter().for_each(|s| step.set_row(layout.output(j, 1), &at(s)));
                (2..=back).for_each(|b| step[(layout.output(j, b), layout.output(j, b - 1))] = 1.0);
                seen[(j, layout.output(j, back))] = 1.0;
            }
        }
    }
    (step, seen)
}

fn whole(delay_s: f64, period_s: f64) -> (usize, f64) {
    let (whole, fraction_s) = split_time(delay_s, period_s);
    (whole as usize, fraction_s)
}

/// Offset in the period at which a delayed output is sampled, and the number of periods after which it is
/// read.
fn tap(delay_s: f64, period_s: f64) -> (f64, usize) {
    match whole(delay_s, period_s) {
        (whole, 0.0) => (0.0, whole),
        (whole, fraction_s) => (period_s - fraction_s, whole + 1),
    }
}

fn cuts(offsets: impl Iterator<Item = f64>, period_s: f64) -> Vec<f64> {
    let mut cuts: Vec<f64> = [0.0].into_iter().chain(offsets).collect();
    cuts.sort_by(f64::total_cmp);
    cuts.dedup_by(|b, a| *b - *a <= SAME * period_s);
    cuts
}
