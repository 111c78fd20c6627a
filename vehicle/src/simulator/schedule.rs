//! A period split into substeps with constant inputs.
//!
//! Splits come from fractional delays, in every period alike, and from single events: the edges of a pulse, a
//! mode transition. Over a substep all inputs are constant, so one matrix exponential solves it exactly.

use std::ops::Range;
use std::sync::Arc;

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
    pub levels: Arc<[Kernel]>,
}

/// A period that recurs.
#[derive(Debug, Clone)]
struct Period {
    substeps: Vec<Substep>,
    /// All substeps at once, where nothing but inputs changes within the period: its inputs are those after their changes,
    /// then those that change as they were before.
    whole: Option<Kernel>,
}

/// When the inputs and the sensors act within a period.
#[derive(Debug, Clone, Copy)]
pub struct Within<'w> {
    /// Offset at which each input changes, s; 0 at the beginning.
    pub changes_s: &'w [f64],
    /// Offsets at which outputs are sampled, s.
    pub samples_s: &'w [f64],
}

/// How the states flow over a period.
pub enum Flows<'s> {
    /// At once, as only inputs change within it: by those at its end, then those that change within it as they were before.
    Whole(&'s Kernel),
    /// Substep by substep.
    Parts(&'s [Substep]),
}

/// Substeps of every period.
#[derive(Debug, Clone)]
pub struct Schedule {
    /// Regular periods and the step from which they apply, ascending, beginning with step 0.
    regular: Vec<(u64, Period)>,
    /// Single periods with additional splits, ascending.
    special: Vec<(u64, Vec<Substep>)>,
    next_regular: usize,
    next_special: usize,
}

impl Schedule {
    /// `within` splits every period, `events` only their own; `levels` is the number of halvings of a substep.
    pub fn new(
        system: &System,
        period_s: f64,
        within: Within<'_>,
        events: &[Moment],
        levels: usize,
    ) -> Result<Self, SimulatorError> {
        let changes_s = within.changes_s.iter().filter(|change| **change > 0.0);
        let cuts_s: Vec<f64> = changes_s.chain(within.samples_s).copied().collect();
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
        let period = |step: u64| -> Result<Period, SimulatorError> {
            let substeps = build(step, &[])?;
            let whole = (substeps.len() > 1 && within.samples_s.is_empty() && levels == 1)
                .then(|| whole(&substeps, within.changes_s, period_s));
            Ok(Period { substeps, whole })
        };
        let mut regular = vec![(0, period(0)?)];
        // A stage that begins inside a period is regular from the next one on.
        for &(step, offset) in &transitions {
            let from = if offset > 0.0 { step + 1 } else { step };
            if regular.last().is_some_and(|(last, _)| *last == from) {
                regular.pop();
            }
            regular.push((from, period(from)?));
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
            [(_, Period { substeps, .. })] if substeps.len() == 1 => {
                Some((&substeps[0].levels[0], self.special.iter().map(|(step, _)| *step)))
            }
            _ => None,
        }
    }

    /// True when all these steps have the same substeps. Steps as for [`Self::substeps`].
    pub fn is_steady(&mut self, steps: &Range<u64>) -> bool {
        self.seek(steps.start);
        let next = self.regular.get(self.next_regular + 1).map(|(from, _)| from);
        let special = self.special.get(self.next_special).map(|(at, _)| at);
        next.into_iter().chain(special).all(|step| *step >= steps.end)
    }

    /// The substeps of a period; steps must be asked for in ascending order.
    pub fn substeps(&mut self, step: u64) -> &[Substep] {
        self.seek(step);
        match self.special.get(self.next_special) {
            Some((at, substeps)) if *at == step => substeps,
            _ => &self.regular[self.next_regular].1.substeps,
        }
    }

    /// The flows of a period: at once where it can be. Steps as for [`Self::substeps`].
    pub fn flows(&mut self, step: u64) -> Flows<'_> {
        self.seek(step);
        match (self.special.get(self.next_special), &self.regular[self.next_regular].1) {
            (Some((at, substeps)), _) if *at == step => Flows::Parts(substeps),
            (_, Period { whole: Some(whole), .. }) => Flows::Whole(whole),
            (_, Period { substeps, .. }) => Flows::Parts(substeps),
        }
    }

    fn seek(&mut self, step: u64) {
        while self.regular.get(self.next_regular + 1).is_some_and(|(from, _)| *from <= step) {
            self.next_regular += 1;
        }
        while self.special.get(self.next_special).is_some_and(|(at, _)| *at < step) {
            self.next_special += 1;
        }
    }
}

/// All substeps at once. A delay by a fraction of a period otherwise costs a matrix product more per step.
fn whole(substeps: &[Substep], changes_s: &[f64], period_s: f64) -> Kernel {
    let changing: Vec<usize> = (0..changes_s.len()).filter(|input| changes_s[*input] > 0.0).collect();
    let (n, m) = (substeps[0].levels[0].states, changes_s.len());
    let mut phi = DMatrix::identity(n, n);
    let mut gamma = DMatrix::zeros(n, m + changing.len());
    for substep in substeps {
        let kernel = &substep.levels[0];
        let own = DMatrix::from_fn(n, n, |i, j| kernel.entry(i, j));
        phi = &own * phi;
        gamma = own * gamma;
        for (input, change_s) in changes_s.iter().enumerate() {
            let changed = reached((0, *change_s), 0, substep.start_s, period_s);
            let before = changing.iter().position(|i| *i == input).filter(|_| !changed);
            let column = before.map_or(input, |before| m + before);
            (0..n).for_each(|i| gamma[(i, column)] += kernel.gamma(i, input));
        }
    }
    Kernel::new(&phi, &gamma)
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
    let levels = known_steps::kernels(a, &inputs, length_s, levels)
        .map_err(|_| SimulatorError::NotFinite { vehicle: String::new(), period_s: length_s })?;
    Ok(Substep { start_s, length_s, levels })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_period_at_once_is_its_substeps_one_by_one() {
        let a = DMatrix::from_row_slice(2, 2, &[0.0, 1.0, -40.0, -3.0]);
        let b = DMatrix::from_row_slice(2, 3, &[0.0, 0.5, 1.0, 9.0, -4.0, 2.0]);
        let (period_s, changes_s) = (0.02, [0.0125, 0.0, 0.004]);
        let ends = [(0.0, 0.004), (0.004, 0.0085), (0.0125, 0.0075)];
        let stage = (a, b);
        let substeps = ends.map(|(start_s, length_s)| substep(&stage, 2, start_s, length_s, 1).unwrap());
        let (before, after) = ([0.3, -1.0, 2.0], [0.7, 0.2, -0.5]);
        let (mut parts, mut once) = (vec![1.0, -2.0, 0.0, 0.0], vec![1.0, -2.0, 0.0, 0.0]);
        let mut scratch = vec![0.0; 4];
        for substep in &substeps {
            let v: Vec<f64> =
                (0..3).map(|i| if changes_s[i] <= substep.start_s { after[i] } else { before[i] }).collect();
            substep.levels[0].advance(&mut parts, &v, &mut scratch);
        }
        let u = [after[0], after[1], after[2], before[0], before[2]];
        whole(&substeps, &changes_s, period_s).advance(&mut once, &u, &mut scratch);
        assert!(parts.iter().zip(&once).all(|(a, b)| (a - b).abs() < 1e-14), "{parts:?} {once:?}");
    }
}
