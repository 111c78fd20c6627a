//! A period split into substeps with constant inputs.
//!
//! Splits come from fractional delays, in every period alike, and from single events: the edges of a pulse, a
//! mode transition. Over a substep all inputs are constant, so one matrix exponential solves it exactly.

use nalgebra::DMatrix;

use super::compile::System;
use super::inputs::{TIME_TOLERANCE, split};
use super::kernel::Kernel;
use super::known_steps;
use crate::error::SimulatorError;

/// A time as index of the step and offset within it, s.
pub type Moment = (u64, f64);

/// A part of a period with constant inputs.
#[derive(Debug, Clone)]
pub struct Substep {
    /// Offset from the period's start, s.
    pub start_s: f64,
    /// Length, s.
    pub length_s: f64,
    /// Discretisations over the whole length, its half, its quarter and so on. Inputs are v, then one per own
    /// state.
    pub levels: Vec<Kernel>,
}

/// Substeps of every period.
#[derive(Debug, Clone)]
pub struct Schedule {
    /// Regular substeps and the step from which they apply, ascending, beginning with step 0.
    regular: Vec<(u64, Vec<Substep>)>,
    /// Single periods with additional splits, ascending.
    special: Vec<(u64, Vec<Substep>)>,
    next_regular: usize,
    next_special: usize,
}

impl Schedule {
    /// `cuts_s` split every period, `events` only their own; `levels` is the number of halvings of a substep.
    pub fn new(
        system: &System,
        period_s: f64,
        cuts_s: &[f64],
        events: &[Moment],
        levels: usize,
    ) -> Result<Self, SimulatorError> {
        let transitions: Vec<Moment> = system.transitions_s.iter().map(|t| split(*t, period_s)).collect();
        let build = |step: u64, extra: &[f64]| -> Result<Vec<Substep>, SimulatorError> {
            let mut cuts: Vec<f64> =
                [0.0].into_iter().chain(cuts_s.iter().copied()).chain(extra.iter().copied()).collect();
            cuts.sort_by(f64::total_cmp);
            cuts.dedup_by(|b, a| *b - *a <= 2.0 * TIME_TOLERANCE * period_s);
            let ends = cuts.iter().skip(1).copied().chain([period_s]);
            cuts.iter()
                .zip(ends)
                .map(|(&start_s, end)| {
                    let passed = |t: &&Moment| reached(**t, step, start_s, period_s);
                    let stage = transitions.iter().filter(passed).count();
                    substep(&system.stages[stage], system.n, start_s, end - start_s, levels)
                })
                .collect()
        };
        let mut regular = vec![(0, build(0, &[])?)];
        // A stage that begins inside a period is regular from the next one on.
        for &(step, offset) in &transitions {
            let from = if offset > 0.0 { step + 1 } else { step };
            if regular.last().is_some_and(|(last, _)| *last == from) {
                regular.pop();
            }
            regular.push((from, build(from, &[])?));
        }
        let mut steps: Vec<u64> =
            events.iter().chain(&transitions).filter(|e| e.1 > 0.0).map(|e| e.0).collect();
        steps.sort_unstable();
        steps.dedup();
        let special = steps
            .into_iter()
            .map(|step| {
                let inside = events.iter().chain(&transitions).filter(|e| e.0 == step).map(|e| e.1);
                Ok((step, build(step, &inside.collect::<Vec<_>>())?))
            })
            .collect::<Result<_, SimulatorError>>()?;
        Ok(Self { regular, special, next_regular: 0, next_special: 0 })
    }

    /// The kernel of all periods but the special ones, where it is the same for all; and the special periods.
    pub fn one_kernel(&self) -> Option<(&Kernel, impl Iterator<Item = u64>)> {
        match &self.regular[..] {
            [(_, substeps)] if substeps.len() == 1 => {
                Some((&substeps[0].levels[0], self.special.iter().map(|(step, _)| *step)))
            }
            _ => None,
        }
    }

    /// The substeps of a period; steps must be asked for in ascending order.
    pub fn substeps(&mut self, step: u64) -> &[Substep] {
        while self.regular.get(self.next_regular + 1).is_some_and(|(from, _)| *from <= step) {
            self.next_regular += 1;
        }
        while self.special.get(self.next_special).is_some_and(|(at, _)| *at < step) {
            self.next_special += 1;
        }
        match self.special.get(self.next_special) {
            Some((at, substeps)) if *at == step => substeps,
            _ => &self.regular[self.next_regular].1,
        }
    }
}

/// True when `moment` is not after this offset in this step, rounding aside.
pub fn reached(moment: Moment, step: u64, offset_s: f64, period_s: f64) -> bool {
    moment.0 < step || moment.0 == step && moment.1 <= offset_s + 2.0 * TIME_TOLERANCE * period_s
}

fn substep(
    (a, b): &(DMatrix<f64>, DMatrix<f64>),
    n: usize,
    start_s: f64,
    length_s: f64,
    levels: usize,
) -> Result<Substep, SimulatorError> {
    let (size, m) = b.shape();
    let mut inputs = DMatrix::zeros(size, m + n);
    inputs.view_mut((0, 0), (size, m)).copy_from(b);
    for i in 0..n {
        inputs[(i, m + i)] = 1.0;
    }
    let levels = (0..levels)
        .map(|level| {
            known_steps::kernel(a, &inputs, length_s * 0.5f64.powi(level as i32))
                .map_err(|_| SimulatorError::NotFinite { vehicle: String::new(), period_s: length_s })
        })
        .collect::<Result<_, SimulatorError>>()?;
    Ok(Substep { start_s, length_s, levels })
}
