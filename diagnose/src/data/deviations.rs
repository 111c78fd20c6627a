//! Samples far from the values that their neighbours suggest.

use whirlstand_ident::identify::ar::Ar;
use whirlstand_logs::stats::{mad_std, median, rms};

use crate::model::noise::filtered;
use crate::thresholds::{ISOLATED_SIGMAS, MAX_AR_ORDER, NEIGHBOURS, OUTLIER_ROUNDS, OUTLIER_SIGMAS};

/// Samples of a channel that lie far from what others suggest.
pub struct Wild {
    /// These samples, in the order of time.
    pub samples: Vec<Deviation>,
    /// Standard deviation of the deviations without these samples.
    pub spread: f64,
    /// Deviations of all other samples that count.
    pub others: Vec<f64>,
}

/// A sample that lies far from what others suggest.
#[derive(Debug, Clone, Copy)]
pub struct Deviation {
    /// Index of the sample.
    pub at: usize,
    /// How far it lies from what the others suggest.
    pub size: f64,
    /// False on a bend of the signal.
    pub alone: bool,
}

/// Values far from the median of their neighbours, by more than `least`, whatever the colour of the noise.
pub fn far(r: &[f64], good: &[bool], least: f64) -> Wild {
    let (away, scatter): (Vec<f64>, Vec<f64>) =
        (0..r.len()).map(|k| from_neighbours(r, good, k).unwrap_or((0.0, 0.0))).unzip();
    let kept: Vec<f64> = away.iter().copied().filter(|a| *a != 0.0).collect();
    let spread = mad_std(&kept);
    let wild = |k: &usize| spread > 0.0 && away[*k].abs() > (OUTLIER_SIGMAS * spread).max(least);
    let deviation =
        |at: usize| Deviation { at, size: away[at], alone: away[at].abs() > ISOLATED_SIGMAS * scatter[at] };
    let samples = (0..away.len()).filter(wild).map(deviation).collect();
    let others = (0..away.len()).filter(|k| good[*k] && !wild(k)).map(|k| away[k]).collect();
    Wild { samples, spread, others }
}

/// Distance of a value from its neighbours, and their scatter.
fn from_neighbours(r: &[f64], good: &[bool], k: usize) -> Option<(f64, f64)> {
    let last = r.len() - 1;
    // As many on either side, so that a slope does not count.
    let reach = match NEIGHBOURS.min(k).min(last - k) {
        0 => NEIGHBOURS,
        reach => reach,
    };
    let near = k.saturating_sub(reach)..=(k + reach).min(last);
    let around: Vec<f64> = near.filter(|j| *j != k && good[*j]).map(|j| r[j]).collect();
    if !good[k] || around.is_empty() {
        return None;
    }
    let middle = median(&around);
    let apart: Vec<f64> = around.iter().map(|v| (v - middle).abs()).collect();
    // At either end one neighbour, or the far ones, decide alone: a line through the inner ones may explain the distance.
    let line = match k {
        0 | 1 if k + 2 <= last => 2.0 * r[k + 1] - r[k + 2],
        _ if k + 2 > last && k > 1 => 2.0 * r[k - 1] - r[k - 2],
        _ => middle,
    };
    let away = [r[k] - middle, r[k] - line];
    Some((away.into_iter().min_by(|a, b| a.abs().total_cmp(&b.abs()))?, median(&apart)))
}

/// Values far from what an autoregressive noise model predicts from the samples before and after. Where the
/// noise varies fast, a small outlier stands out only this way.
pub fn foretold(r: &[f64], good: &[bool]) -> Option<Wild> {
    let mut rest = r.to_vec();
    let mut found = None;
    for _ in 0..OUTLIER_ROUNDS {
        let ar = Ar::fit(&[&rest], MAX_AR_ORDER);
        let mut colour = vec![1.0];
        colour.extend(&ar.coefficients);
        let mut white = filtered(&ar, r);
        // The first samples have no known past.
        white.iter_mut().take(ar.order()).for_each(|e| *e = 0.0);
        let kept: Vec<f64> = white.iter().copied().filter(|e| *e != 0.0).collect();
        let unit = mad_std(&kept);
        let spread = unit / rms(&colour) / (colour.len() as f64).sqrt();
        if unit.is_nan() || unit <= 0.0 {
            return None;
        }
        let off = |white: &[f64], k: usize| {
            let all = colour.iter().zip(&white[k..]);
            let (product, energy) = all.fold((0.0, 0.0), |(p, n), (a, e)| (p + a * e, n + a * a));
            product / energy
        };
        let mut open: Vec<usize> = (ar.order()..r.len())
            .filter(|k| good[*k] && off(&white, *k).abs() > OUTLIER_SIGMAS * spread)
            .collect();
        let mut values = Vec::new();
        while let Some((at, size)) = open
            .iter()
            .map(|k| off(&white, *k))
            .enumerate()
            .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
            .filter(|(_, size)| size.abs() > OUTLIER_SIGMAS * spread)
        {
            let k = open.swap_remove(at);
            white[k..].iter_mut().zip(&colour).for_each(|(e, a)| *e -= size * a);
            values.push((k, size));
        }
        values.sort_unstable_by_key(|(k, _)| *k);
        let calm = |k: usize| white[k..].iter().take(colour.len()).all(|e| e.abs() < ISOLATED_SIGMAS * unit);
        let samples: Vec<Deviation> =
            values.into_iter().map(|(at, size)| Deviation { at, size, alone: calm(at) }).collect();
        rest = r.to_vec();
        samples.iter().for_each(|wild| rest[wild.at] -= wild.size);
        let calm = (ar.order()..r.len()).filter(|k| good[*k] && rest[*k] == r[*k]);
        let others = calm.map(|k| off(&white, k)).collect();
        found = Some(Wild { samples, spread, others });
    }
    found
}
