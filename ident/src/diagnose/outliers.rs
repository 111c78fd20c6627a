//! Wild values: single samples that stand far from where their neighbours say that they should be.

use std::collections::BTreeMap;

use whirlstand_vehicle::Kind;

use super::data::Data;
use super::noise::{MOST, filtered};
use super::samples::{NEIGHBOURS, SampleEffect, longest_run, share_interval};
use crate::identify::ar::Ar;
use crate::stats::{mad_std, mean, median, rms};

/// Fewer wild values than this may be anything,
const FEW: usize = 3;
/// but one that stands this many times as far is one.
const FAR: f64 = 1.5;
/// A wild value stands this many standard deviations away from its neighbours,
const WILD: f64 = 6.5;
/// and this many times as far as half of the neighbours stand from their middle.
const ALONE: f64 = 5.0;
/// Of a channel that rounds, a wild value is off by so many steps.
const STEPS: f64 = 2.5;
/// Rounds in which colour and wild values are told from each other.
const ROUNDS: usize = 2;

/// Values of a channel that do not belong there.
struct Wild {
    /// Sample, and by how much it is off.
    values: Vec<(usize, f64)>,
    /// Standard deviation of that without wild values.
    spread: f64,
    /// How many of them stand by themselves: a bend is no wild value.
    alone: usize,
}

impl Wild {
    /// Mean of the sizes, and how much they differ.
    fn sizes(&self) -> (f64, f64) {
        let sizes: Vec<f64> = self.values.iter().map(|(_, size)| size.abs()).collect();
        let magnitude = mean(&sizes);
        (magnitude, rms(&sizes.iter().map(|s| s - magnitude).collect::<Vec<_>>()))
    }
}

/// Finds values far from their neighbours in a residual (all channels), and sets them aside. Where a channel is `known` to
/// round, cut or repeat its values, what is left of that looks wild by the colour: there, only plain ones count.
pub fn outliers(data: &mut Data, residual: &[f64], known: &[SampleEffect]) -> Vec<SampleEffect> {
    let ranges = data.ranges();
    let mut found = Vec::new();
    for (index, (channel, range)) in data.channels.iter_mut().zip(ranges).enumerate() {
        let r = &residual[range];
        let own: Vec<&SampleEffect> = known.iter().filter(|e| e.channel == index).collect();
        let step = own.iter().filter_map(|e| e.parameters.get("step")).fold(0.0f64, |m, v| m.max(v.0));
        let told = |wild: &Wild| {
            let at: Vec<usize> = wild.values.iter().map(|(k, _)| *k).collect();
            let plain = wild.values.iter().all(|(_, size)| size.abs() > FAR * WILD * wild.spread);
            let enough = at.len() >= FEW || !at.is_empty() && plain && own.is_empty();
            enough && at.len() * 4 <= r.len() && longest_run(&at) <= 3
        };
        // The effect of the table is off by one magnitude, up or down, and by itself.
        let alike = |wild: &Wild| {
            let (magnitude, differing) = wild.sizes();
            differing <= 0.35 * magnitude && wild.alone * 10 >= wild.values.len() * 9
        };
        let colour = || foretold(r, &channel.good).filter(|_| own.is_empty()).filter(told).filter(alike);
        let Some(wild) = Some(far(r, &channel.good, STEPS * step)).filter(told).or_else(colour) else {
            continue;
        };
        for (k, _) in &wild.values {
            channel.good[*k] = false;
        }
        if !alike(&wild) {
            continue;
        }
        let (magnitude, differing) = wild.sizes();
        let (n, count) = (r.len() as f64, wild.values.len() as f64);
        let (low, high) = share_interval(count, n);
        let size = 1.96 * wild.spread.max(differing) / count.sqrt();
        let parameters = BTreeMap::from([
            ("fraction", (count / n, low, high)),
            ("magnitude", (magnitude, magnitude - size, magnitude + size)),
        ]);
        let samples = wild.values.len();
        found.push(SampleEffect { kind: Kind::Outliers, channel: index, parameters, samples });
    }
    found
}

/// Drops wild values that the causes explain: a late sensor errs most where its signal jumps. `good` are the samples that
/// counted before any were set aside.
pub fn still_wild(samples: &mut Vec<SampleEffect>, data: &Data, good: Vec<Vec<bool>>, predicted: &[f64]) {
    let (wild, others): (Vec<_>, Vec<_>) =
        samples.iter().cloned().partition(|e: &SampleEffect| e.kind == Kind::Outliers);
    if wild.is_empty() {
        return;
    }
    let mut data = data.clone();
    data.channels.iter_mut().zip(good).for_each(|(c, good)| c.good = good);
    let measured = data.channels.iter().flat_map(|c| &c.values);
    let mut residual: Vec<f64> = measured.zip(predicted).map(|(y, p)| y - p).collect();
    data.fill(&mut residual);
    let again = outliers(&mut data, &residual, &others);
    samples.retain(|e| e.kind != Kind::Outliers || again.iter().any(|a| a.channel == e.channel));
}

/// Values farther from the middle of their neighbours than `least`: whatever the colour of the others.
fn far(r: &[f64], good: &[bool], least: f64) -> Wild {
    // How far a value stands from its neighbours, and how far these stand from each other.
    let (away, scatter): (Vec<f64>, Vec<f64>) = (0..r.len())
        .map(|k| {
            let around: Vec<f64> = (k.saturating_sub(NEIGHBOURS)..(k + NEIGHBOURS + 1).min(r.len()))
                .filter(|j| *j != k && good[*j])
                .map(|j| r[j])
                .collect();
            if !good[k] || around.is_empty() {
                return (0.0, 0.0);
            }
            let middle = median(&around);
            let apart: Vec<f64> = around.iter().map(|v| (v - middle).abs()).collect();
            (r[k] - middle, median(&apart))
        })
        .unzip();
    let kept: Vec<f64> = away.iter().copied().filter(|a| *a != 0.0).collect();
    let spread = mad_std(&kept);
    let wild = |k: &usize| spread > 0.0 && away[*k].abs() > (WILD * spread).max(least);
    let values: Vec<(usize, f64)> = (0..away.len()).filter(wild).map(|k| (k, away[k])).collect();
    let alone = values.iter().filter(|(k, away)| away.abs() > ALONE * scatter[*k]).count();
    Wild { values, spread, alone }
}

/// Values far from what those before and after them foretell by the noise's own colour. Where the noise swings fast, a
/// value that is off by little stands out of that only.
fn foretold(r: &[f64], good: &[bool]) -> Option<Wild> {
    let mut rest = r.to_vec();
    let mut found = None;
    for _ in 0..ROUNDS {
        let ar = Ar::burg(&rest, MOST);
        let mut colour = vec![1.0];
        colour.extend(&ar.coefficients);
        let mut white = filtered(&ar, r);
        // What went before the first is not known.
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
        let mut open: Vec<usize> =
            (ar.order()..r.len()).filter(|k| good[*k] && off(&white, *k).abs() > WILD * spread).collect();
        let mut values = Vec::new();
        while let Some((at, size)) = open
            .iter()
            .map(|k| off(&white, *k))
            .enumerate()
            .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
            .filter(|(_, size)| size.abs() > WILD * spread)
        {
            let k = open.swap_remove(at);
            white[k..].iter_mut().zip(&colour).for_each(|(e, a)| *e -= size * a);
            values.push((k, size));
        }
        values.sort_unstable_by_key(|(k, _)| *k);
        let calm = |k: usize| white[k..].iter().take(colour.len()).all(|e| e.abs() < ALONE * unit);
        let alone = values.iter().filter(|(k, _)| calm(*k)).count();
        rest = r.to_vec();
        values.iter().for_each(|(k, size)| rest[*k] -= size);
        found = Some(Wild { values, spread, alone });
    }
    found
}
