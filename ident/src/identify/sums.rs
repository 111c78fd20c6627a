//! Normal equations of one segment, output by output.

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::ar::{Ar, RowFilter};
use super::data::Segment;
use super::normal::{Normal, Sums};
use super::problem::{Divisible, Problem, Step, Sweep};

/// Normal equations of one segment, one entry per output; `None` for outputs without weight.
pub type OutputSums = Vec<Option<Sums>>;

/// Fewest steps of a part that is swept beside others: enough that a thread is worth waking. The parts depend on the
/// record alone, so that the sums have the same bits on any number of threads.
const PART: usize = 2048;

/// The sums of one segment; the residuals of output i are filtered by `whitening[i]`. `None` when the run diverged.
pub fn sums(
    problem: &Problem,
    simulation: &dyn Sweep,
    segment: &Segment,
    whitening: &[Ar],
    nuisance: &[f64],
) -> Option<OutputSums> {
    let parts = segment.steps / PART;
    // A filter needs the rows before a part as well.
    if parts > 1
        && whitening.iter().all(|ar| ar.order() == 0)
        && let Some(divisible) = simulation.divisible()
    {
        return in_parts(problem, divisible, simulation.columns(), segment, whitening, nuisance, parts);
    }
    let mut channels = channels(problem, whitening, simulation.columns(), segment);
    simulation
        .sweep(segment, nuisance, &mut |step| add(&mut channels, segment, step))
        .then(|| finished(channels))
}

/// Sweeps parts of a segment side by side, each with its own initial state among its unknowns, and moves on to the
/// unknowns of the segment by the chain rule: a part's initial state depends on them as the end of the part before does.
fn in_parts(
    problem: &Problem,
    simulation: &dyn Divisible,
    columns: usize,
    segment: &Segment,
    whitening: &[Ar],
    nuisance: &[f64],
    parts: usize,
) -> Option<OutputSums> {
    let n = problem.n();
    let at = |part: usize| part * segment.steps / parts;
    let states = simulation.states(segment, nuisance, &(0..parts).map(at).collect::<Vec<_>>())?;
    let swept: Vec<(OutputSums, DMatrix<f64>)> = states
        .into_par_iter()
        .enumerate()
        .map(|(part, state)| {
            let unknowns = [&state, &nuisance[n..]].concat();
            let mut channels = channels(problem, whitening, columns, segment);
            let end = simulation.sweep_part(segment, at(part)..at(part + 1), &unknowns, &mut |step| {
                add(&mut channels, segment, step);
            })?;
            Some((finished(channels), end))
        })
        .collect::<Option<_>>()?;
    let first = columns - problem.nuisances();
    let mut chain = DMatrix::identity(columns, columns);
    let mut all: OutputSums = vec![None; problem.p()];
    for (sums, end) in swept {
        for (total, sums) in all.iter_mut().zip(sums) {
            let Some(sums) = sums else { continue };
            let sums = sums.by(&chain);
            match total {
                Some(total) => total.add(&sums),
                None => *total = Some(sums),
            }
        }
        let start = end * &chain;
        chain.rows_mut(first, n).copy_from(&start);
    }
    Some(all)
}

fn channels(problem: &Problem, whitening: &[Ar], columns: usize, segment: &Segment) -> Vec<Option<Channel>> {
    let channel = |i: usize| Channel::new(&whitening[i], columns, segment, i, problem.p());
    (0..problem.p()).map(|i| (problem.weights[i] > 0.0).then(|| channel(i))).collect()
}

fn add(channels: &mut [Option<Channel>], segment: &Segment, step: &Step<'_>) {
    let p = channels.len();
    for (i, channel) in channels.iter_mut().enumerate() {
        if let Some(channel) = channel {
            let measured = segment.outputs[step.k * p + i];
            channel.add(step.k, step.slopes(i), measured - step.predicted[i]);
        }
    }
}

fn finished(channels: Vec<Option<Channel>>) -> OutputSums {
    channels.into_iter().map(|c| c.map(|c| c.normal.finish())).collect()
}

/// Accumulates the rows of one output.
struct Channel {
    normal: Normal,
    filter: RowFilter,
    row: Vec<f64>,
    plain: bool,
    /// Usual distance of fresh values, steps; a plain sum needs none.
    every: usize,
    last: Option<usize>,
}

impl Channel {
    fn new(ar: &Ar, columns: usize, segment: &Segment, i: usize, p: usize) -> Self {
        Self {
            normal: Normal::new(columns),
            filter: RowFilter::new(ar, false, columns + 1),
            row: vec![0.0; columns + 1],
            plain: ar.order() == 0,
            every: if ar.order() == 0 { 1 } else { spacing(segment, i, p) },
            last: None,
        }
    }

    fn add(&mut self, k: usize, slopes: &[f64], residual: f64) {
        if !residual.is_finite() {
            return;
        }
        if self.plain {
            self.normal.add(slopes, residual);
            return;
        }
        if self.last.is_some_and(|last| k - last != self.every) {
            self.filter.reset();
        }
        self.last = Some(k);
        let columns = slopes.len();
        self.row[..columns].copy_from_slice(slopes);
        self.row[columns] = residual;
        if let Some(row) = self.filter.next(&self.row) {
            self.normal.add(&row[..columns], row[columns]);
        }
    }
}

/// Median number of steps between fresh values of output `i` of `p`.
pub fn spacing(segment: &Segment, i: usize, p: usize) -> usize {
    let mut gaps = Vec::new();
    let mut last = None;
    for k in 0..segment.steps {
        if segment.outputs[k * p + i].is_finite()
            && let Some(last) = last.replace(k)
        {
            gaps.push(k - last);
        }
    }
    gaps.sort_unstable();
    gaps.get(gaps.len() / 2).copied().unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use whirlstand_vehicle::Vehicle;

    use super::super::linear::Linear;
    use super::super::problem::Nuisance;
    use super::super::tests::{pilot, record};
    use super::*;

    #[test]
    fn parts_side_by_side_give_the_sums_of_the_whole() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let mut structure = Vehicle::builtin("quadrotor-structure").unwrap();
        structure.a = vehicle.a.clone();
        structure.b = vehicle.b.clone();
        let segment = record(&vehicle, &pilot(601, 2, 0.01, 10.0, 1), 0.01, 1);
        for output_offsets in [false, true] {
            let nuisance = Nuisance { output_offsets, ..Nuisance::default() };
            let problem = Problem::new(&structure, std::slice::from_ref(&segment), nuisance).unwrap();
            let theta: Vec<f64> =
                problem.parameters.iter().map(|p| structure.free_value(&p.target) * 1.1 - 0.01).collect();
            let linear = Linear::new(&problem, &theta, None).unwrap();
            let (white, unknowns) = (vec![Ar::white(1.0); 4], vec![0.02; problem.nuisances()]);
            let whole = sums(&problem, &linear, &segment, &white, &unknowns).unwrap();
            let divided =
                in_parts(&problem, &linear, linear.columns(), &segment, &white, &unknowns, 3).unwrap();
            for (a, b) in whole.iter().flatten().zip(divided.iter().flatten()) {
                assert_eq!(a.rows, b.rows);
                assert!((a.square - b.square).abs() < 1e-9 * a.square);
                assert!((&a.right - &b.right).norm() < 1e-9 * a.right.norm());
                assert!((&a.information - &b.information).norm() < 1e-9 * a.information.norm());
            }
            assert_eq!(divided.len(), 4);
        }
    }
}
