//! Laws without delay, flown on late inputs: the state that they feed back is ahead of that of the vehicle.
//!
//! `phi` is the transition of the motion with further states (`extra` of them, integrals) that it drives.

use std::ops::AddAssign;

use nalgebra::{DMatrix, DVector};
use whirlstand_vehicle::split_time;

use crate::sampled_model::{Layout, SampledModel};

/// What the motion at the end of a period has of the command of `input` of `back` periods ago, with zeros up to `count`.
fn entry(model: &SampledModel, input: usize, back: usize, count: usize) -> DVector<f64> {
    let source = match back {
        0 => model.g.column(input),
        _ => model.f.column(model.layout.command(input, back)),
    };
    source.rows(0, model.layout.motion()).into_owned().resize_vertically(count, 0.0)
}

/// All inputs as far ahead as the latest of them reaches, over commands that are known: the Artstein reduction (IEEE Trans.
/// Autom. Control 27, 1982), here in discrete time. With `M` and `b` returned, `p = M [s; extra]` obeys `p+ = phi p + b u`
/// whatever the law asks for, and registers have nothing to do with p but through it.
pub fn to_the_latest(model: &SampledModel, phi: &DMatrix<f64>, extra: usize) -> (DMatrix<f64>, DMatrix<f64>) {
    let (motion, known, m) = (model.layout.motion(), model.layout.known(), model.g.ncols());
    let count = motion + extra;
    let longest = model.layout.commands.iter().copied().max().unwrap_or(0);
    let mut powers = vec![DMatrix::identity(count, count)];
    (0..longest).for_each(|k| powers.push(phi * &powers[k]));
    let mut map = DMatrix::zeros(count, known + extra);
    map.columns_mut(0, motion).copy_from(&powers[longest].columns(0, motion));
    map.columns_mut(known, extra).copy_from(&powers[longest].columns(motion, extra));
    let mut input = DMatrix::zeros(count, m);
    for (i, &registers) in model.layout.commands.iter().enumerate() {
        // A command of k periods ago enters at register r after r - k further periods; `longest` periods ahead its part
        // has moved on for the rest of them.
        for back in 0..=registers {
            let mut sum = DVector::zeros(count);
            for r in back..=registers {
                let periods = longest + usize::from(back == 0);
                let moved = periods - 1 - (r - back);
                if r - back < periods {
                    sum += &powers[moved] * entry(model, i, r, count);
                }
            }
            if back == 0 {
                input.set_column(i, &sum);
            } else {
                map.set_column(model.layout.command(i, back), &sum);
            }
        }
    }
    (map, input)
}

/// Late inputs that each look as far ahead as it is late itself.
///
/// With h_i whole periods of delay, the motion obeys `e+ = phi e + sum b_i u_i(k - h_i)`. A feedback `v = -K e` on this plant
/// without delay is flown as `u_i(k) = -K_i e(k + h_i)`. What acts until then is known of the inputs that are later; of those that
/// are not it is what they will be asked for, `-K_j e` at its time. So the loop is `e+ = (phi - b K) e` once the last delay is
/// over (Tsubakino, Oliveira and Krstic, "Exact predictor-feedback for multi-input LTI systems with distinct input delays",
/// Automatica 71, 2016; here in discrete time).
pub struct Lookahead {
    /// b, one column an input.
    pub input: DMatrix<f64>,
    phi: DMatrix<f64>,
    /// e of now, by states, past commands and further states.
    now: DMatrix<f64>,
    /// Whole periods that each input is late.
    periods: Vec<usize>,
    layout: Layout,
}

impl Lookahead {
    /// Of inputs that are late by `delays_s`.
    pub fn new(
        model: &SampledModel,
        delays_s: &[f64],
        period_s: f64,
        phi: &DMatrix<f64>,
        extra: usize,
    ) -> Self {
        let (motion, known) = (model.layout.motion(), model.layout.known());
        let count = motion + extra;
        let delays: Vec<(usize, f64)> = delays_s
            .iter()
            .map(|d| split_time(*d, period_s))
            .map(|(periods, fraction_s)| (periods as usize, fraction_s))
            .collect();
        // A command that comes in the middle of a period is split over two: e is the end of this period then, less what
        // commands that are as many whole periods late put into it.
        let is_split = delays.iter().any(|d| d.1 > 0.0);
        let start = if is_split { phi.clone() } else { DMatrix::identity(count, count) };
        let mut now = DMatrix::zeros(count, known + extra);
        now.columns_mut(0, motion).copy_from(&start.columns(0, motion));
        now.columns_mut(known, extra).copy_from(&start.columns(motion, extra));
        let mut input = DMatrix::zeros(count, delays.len());
        for (i, &(periods, fraction_s)) in delays.iter().enumerate() {
            input.set_column(i, &(&start * entry(model, i, periods, count)));
            if fraction_s > 0.0 {
                let rest = entry(model, i, periods + 1, count);
                now.set_column(model.layout.command(i, periods + 1), &rest);
                input.column_mut(i).add_assign(&rest);
            }
        }
        let periods = delays.into_iter().map(|d| d.0).collect();
        Self { input, phi: phi.clone(), now, periods, layout: model.layout.clone() }
    }

    /// A feedback on e as one on states, past commands and further states.
    pub fn whole(&self, feedback: &DMatrix<f64>) -> DMatrix<f64> {
        let mut gain = DMatrix::zeros(feedback.nrows(), self.now.ncols());
        let mut e = self.now.clone();
        for ahead in 0..=self.periods.iter().copied().max().unwrap_or(0) {
            let asked = feedback * &e;
            e = &self.phi * e;
            for (i, &late) in self.periods.iter().enumerate() {
                if late == ahead {
                    gain.set_row(i, &asked.row(i));
                }
                if late > ahead {
                    e.column_mut(self.layout.command(i, late - ahead)).add_assign(&self.input.column(i));
                } else {
                    e -= self.input.column(i) * asked.row(i);
                }
            }
        }
        gain
    }
}
