//! Cross-validation: gain on data that a fit has not used.

use crate::thresholds::{BLOCKS, MAX_BLOCK_SHARE, MIN_REMAINING_INFORMATION};
use nalgebra::DVector;

use crate::data::record::Data;
use crate::model::columns::dot;
use crate::model::fit::{Fit, Model};
use crate::model::noise::Noise;
use whirlstand_ident::identify::normal::pseudo_inverse;

/// The gain of `extended` over `reduced` on blocks left out of both fits, divided by its standard error.
///
/// Every block is predicted with the values estimated from the other blocks: the step from the fit of all
/// blocks to that without one follows from the block's own share of gradient and information. Both models are
/// judged under the noise model of the extended one. Blocks are cut so that the two predictions differ by the
/// same energy in each: an event of one second has its blocks within that second. Whitened residuals of
/// different blocks are independent.
///
/// Some values are kept fixed: the initial state, which would be unknown without the first block, the time of
/// an event, and values that only one block determines (such as the size of an event within it).
pub fn held_out_gain(reduced: (&Model<'_, '_>, &Fit), extended: (&Model<'_, '_>, &Fit)) -> f64 {
    let data = reduced.0.free_run.data;
    let ((small, reduced), (large, extended)) = (reduced, extended);
    let noise = &extended.profile.noise;
    let (cuts, energy) = cuts(data, noise, reduced, extended);
    let of = |model: &Model<'_, '_>, fit: &Fit| left_out(data, noise, fit, &estimated(model), &cuts);
    let (Some(before), Some(after)) = (of(small, reduced), of(large, extended)) else { return 0.0 };
    let n = before.len() as f64;
    let most = MAX_BLOCK_SHARE * 0.5 * energy / n;
    let gains: Vec<f64> = before.iter().zip(&after).map(|(b, a)| (0.5 * (b - a)).min(most)).collect();
    if n < 3.0 {
        return 0.0;
    }
    let mean = gains.iter().sum::<f64>() / n;
    let variance = gains.iter().map(|g| (g - mean) * (g - mean)).sum::<f64>() / (n - 1.0);
    if variance > 0.0 { mean / (variance / n).sqrt() } else { 0.0 }
}

/// Indices of the values that every part of a record helps to determine.
fn estimated(model: &Model<'_, '_>) -> Vec<usize> {
    let free = model.states()..model.base();
    let tunables = model.terms.iter().enumerate().flat_map(|(t, term)| model.range(t).zip(&term.tunables));
    let lasting = tunables.filter(|(_, tunable)| !matches!(tunable.name, "at_s" | "duration_s"));
    free.chain(lasting.map(|(i, _)| i)).collect()
}

/// First steps of the blocks and the end, and the energy by which the predictions differ.
fn cuts(data: &Data, noise: &Noise, reduced: &Fit, extended: &Fit) -> (Vec<usize>, f64) {
    let mut difference: Vec<f64> =
        extended.predicted.iter().zip(&reduced.predicted).map(|(a, b)| a - b).collect();
    data.fill(&mut difference);
    let white = noise.whiten(data, &difference);
    let mut energy = vec![0.0; data.steps];
    for (channel, range) in data.channels.iter().zip(data.ranges()) {
        for (k, w) in white[range].iter().enumerate() {
            energy[channel.step(k)] += w * w;
        }
    }
    let total: f64 = energy.iter().sum();
    let mut cuts = vec![0];
    let mut sum = 0.0;
    for (k, e) in energy.iter().enumerate() {
        sum += e;
        let wanted = cuts.len() as f64 / BLOCKS as f64;
        if sum >= wanted * total && cuts.len() < BLOCKS && k >= cuts[cuts.len() - 1] + 4 {
            cuts.push(k + 1);
        }
    }
    cuts.push(data.steps);
    cuts.dedup();
    (cuts, total)
}

/// Sum of squared whitened errors of every block when it is left out.
fn left_out(data: &Data, noise: &Noise, fit: &Fit, estimated: &[usize], cuts: &[usize]) -> Option<Vec<f64>> {
    let residual = noise.whiten(data, &fit.residual);
    let columns: Vec<Vec<f64>> =
        estimated.iter().map(|i| noise.whiten(data, &data.filled(&fit.columns[*i]))).collect();
    let n = columns.len();
    let parts: Vec<Vec<std::ops::Range<usize>>> = cuts
        .windows(2)
        .map(|cut| {
            data.channels
                .iter()
                .zip(data.ranges())
                .map(|(channel, range)| {
                    let sample = |step: usize| {
                        range.start
                            + step.saturating_sub(channel.first).div_ceil(channel.stride).min(range.len())
                    };
                    sample(cut[0])..sample(cut[1])
                })
                .collect()
        })
        .collect();
    let sums = |ranges: &[std::ops::Range<usize>], a: &[f64], b: &[f64]| -> f64 {
        ranges.iter().map(|r| dot(&a[r.clone()], &b[r.clone()])).sum()
    };
    let information = |ranges: &[std::ops::Range<usize>]| {
        let mut f = nalgebra::DMatrix::zeros(n, n);
        for i in 0..n {
            for j in 0..=i {
                let v = sums(ranges, &columns[i], &columns[j]);
                (f[(i, j)], f[(j, i)]) = (v, v);
            }
        }
        f
    };
    let blocks: Vec<_> = parts.iter().map(|p| information(p)).collect();
    let total = blocks.iter().fold(nalgebra::DMatrix::zeros(n, n), |sum, b| sum + b);
    parts
        .iter()
        .zip(&blocks)
        .map(|(ranges, own)| {
            let gradient = DVector::from_iterator(n, columns.iter().map(|c| sums(ranges, c, &residual)));
            let rest = &total - own;
            let determined: Vec<usize> =
                (0..n).filter(|i| rest[(*i, *i)] > MIN_REMAINING_INFORMATION * total[(*i, *i)]).collect();
            let known = rest.select_rows(&determined).select_columns(&determined);
            let moved = -(pseudo_inverse(&known)? * gradient.select_rows(&determined));
            let mut step = DVector::zeros(n);
            determined.iter().zip(moved.iter()).for_each(|(i, d)| step[*i] = *d);
            // |e - J d|^2 over the block.
            let square = sums(ranges, &residual, &residual);
            Some((square - 2.0 * gradient.dot(&step) + step.dot(&(own * &step))).max(0.0))
        })
        .collect()
}
