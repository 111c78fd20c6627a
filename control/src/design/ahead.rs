//! Predictor feedback: laws designed without delay, applied to delayed inputs by feeding back a predicted
//! state.
//!
//! `phi` is the transition matrix of the motion with further states (`extra` of them, integrals) that it
//! drives.

use std::ops::AddAssign;

use nalgebra::{DMatrix, DVector};
use whirlstand_vehicle::split_time;

use crate::sampled_model::{Layout, SampledModel};

/// Contribution of the command of `input` of `back` periods ago to the motion at the end of a period, with
/// zeros up to `count`.
fn entry(model: &SampledModel, input: usize, back: usize, count: usize) -> DVector<f64> {
    let source = match back {
        0 => model.g.column(input),
        _ => model.f.column(model.layout.command(input, back)),
    };
    source.rows(0, model.layout.motion()).into_owned().resize_vertically(count, 0.0)
}

/// Prediction over the longest delay for all inputs, from known commands: the Artstein reduction (IEEE Trans.
/// Autom. Control 27, 1982), here in discrete time. With `M` and `b` returned, `p = M [s; extra]` obeys `p+ =
/// phi p + b u` for any law, and registers affect p only through M.
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
        // A command of k periods ago enters at register r after r - k further periods; `longest` periods
        // ahead its contribution has propagated over the remaining ones.
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

/// Prediction for delayed inputs, over each input's own delay.
///
/// With h_i whole periods of delay, the motion obeys `e+ = phi e + sum b_i u_i(k - h_i)`. A feedback `v = -K
/// e` designed without delay is applied as `u_i(k) = -K_i e(k + h_i)`. Until then the commands of inputs with
/// longer delays are known; those of inputs with shorter ones are the future demands `-K_j e` at their time.
/// So the loop is `e+ = (phi - b K) e` after the longest delay (Tsubakino, Oliveira and Krstic, "Exact
/// predictor-feedback for multi-input LTI systems with distinct input delays", Automatica 71, 2016; here in
/// discrete time).
pub struct Lookahead {
    /// Input matrix b, one column per input.
    pub input: DMatrix<f64>,
    phi: DMatrix<f64>,
    /// The present e as a function of states, past commands and further states.
    now: DMatrix<f64>,
    /// Delay of each input in whole periods.
    periods: Vec<usize>,
    layout: Layout,
}

impl Lookahead {
    /// Prediction for inputs with delays of `delays_s`.
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
        // A command with a fractional delay is split over two periods: e is then the state at the end of this
        // period, without the contribution of commands with that number of whole periods of delay.
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

    /// Converts a feedback on e to one on states, past commands and further states.
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
