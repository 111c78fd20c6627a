//! Outliers: single samples far from the values that their neighbours suggest.

use crate::thresholds::{
    MIN_BIC_GAIN, MIN_OUTLIERS, MIXTURE_ROUNDS, MIXTURE_SETTLED, NORMAL_DEGREES, OUTLIER_SIGMAS,
    OUTLIER_SIZE_RATIO, OUTLIER_STEP_RATIO, STUDENT_DEGREES, STUDENT_ROUNDS,
};
use std::collections::BTreeMap;

use statrs::distribution::{Continuous, StudentsT};

use whirlstand_vehicle::Kind;

use crate::data::deviations::{Deviation, Wild, far, foretold};
use crate::data::record::Data;
use crate::data::sample_effect::{SampleEffect, longest_run, share_interval};
use whirlstand_logs::stats::{mad_std, mean, rms};

/// Noise of which a share is shifted by one magnitude, up or down (Tukey 1960), with its log-likelihood. The noise is Student's t:
/// nearly normal with many degrees of freedom, heavy-tailed with few.
struct Contaminated {
    likelihood: f64,
    magnitude: f64,
    share: f64,
    spread: f64,
    degrees: f64,
    /// Density of the noise at 0, of spread one.
    peak: f64,
}

/// Mean of the deviations' magnitudes, and their spread.
fn sizes(of: &[Deviation]) -> (f64, f64) {
    let sizes: Vec<f64> = of.iter().map(|wild| wild.size.abs()).collect();
    let magnitude = mean(&sizes);
    (magnitude, rms(&sizes.iter().map(|s| s - magnitude).collect::<Vec<_>>()))
}

impl Wild {
    /// The outliers of the table, isolated samples of one magnitude up or down, where these samples are a population of
    /// their own beside the noise, by BIC. Otherwise they are its tails (Lange, Little and Taylor 1989). Those that more likely
    /// belong to the noise are not among them: coloured noise comes in bursts.
    fn outliers(&self) -> Option<Vec<Deviation>> {
        let all: Vec<f64> =
            self.others.iter().copied().chain(self.samples.iter().map(|wild| wild.size)).collect();
        let degrees = STUDENT_DEGREES.into_iter().chain([NORMAL_DEGREES]);
        let found = degrees.filter_map(|degrees| self.contaminated(&all, degrees));
        let found = found.max_by(|a, b| a.likelihood.total_cmp(&b.likelihood))?;
        // Magnitude and share are two parameters more.
        let gain = 2.0 * (found.likelihood - student(&all));
        if gain <= 2.0 * (all.len() as f64).ln() + MIN_BIC_GAIN {
            return None;
        }
        let own: Vec<Deviation> = self.samples.iter().copied().filter(|wild| found.has(wild.size)).collect();
        let (magnitude, differing) = sizes(&own);
        let alone = own.iter().filter(|wild| wild.alone).count();
        (!own.is_empty() && differing <= 0.35 * magnitude && alone * 10 >= own.len() * 9).then_some(own)
    }

    /// The likeliest noise with a shifted share, by expectation maximisation starting from the largest of these samples: the
    /// boundary between the two populations is no fixed limit.
    fn contaminated(&self, all: &[f64], degrees: f64) -> Option<Contaminated> {
        let n = all.len() as f64;
        let largest = self.samples.iter().map(|wild| wild.size.abs()).fold(0.0, f64::max);
        let far: Vec<f64> =
            self.samples.iter().map(|wild| wild.size.abs()).filter(|size| *size > 0.5 * largest).collect();
        let mut found = Contaminated {
            likelihood: f64::NEG_INFINITY,
            magnitude: mean(&far),
            share: far.len() as f64 / n,
            spread: self.spread,
            degrees,
            peak: StudentsT::new(0.0, 1.0, degrees).ok()?.pdf(0.0),
        };
        for _ in 0..MIXTURE_ROUNDS {
            if found.spread <= 0.0 {
                return None;
            }
            let (mut sum, mut wild, mut near, mut off, mut square) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for x in all.iter().map(|x| x.abs()) {
                let (bulk, apart) = found.densities(x);
                let total = (bulk + apart).max(f64::MIN_POSITIVE);
                let weight = apart / total;
                let (own, others) = (found.weight(x - found.magnitude), found.weight(x));
                sum += total.ln();
                wild += weight;
                near += weight * own;
                off += weight * own * x;
                square += (1.0 - weight) * others * x * x + weight * own * (x - found.magnitude).powi(2);
            }
            let is_settled = sum - found.likelihood < MIXTURE_SETTLED;
            found.likelihood = sum;
            if wild <= 0.0 || is_settled {
                break;
            }
            (found.share, found.magnitude, found.spread) = (wild / n, off / near, (square / n).sqrt());
        }
        Some(found)
    }
}

impl Contaminated {
    fn density(&self, x: f64) -> f64 {
        let z = x / self.spread;
        self.peak / self.spread * (1.0 + z * z / self.degrees).powf(-0.5 * (self.degrees + 1.0))
    }

    /// Weight of a deviation in the spread, 1 of all in normal noise.
    fn weight(&self, x: f64) -> f64 {
        let z = x / self.spread;
        (self.degrees + 1.0) / (self.degrees + z * z)
    }

    /// Densities of a magnitude as a part of the noise and as one of the shifted values.
    fn densities(&self, x: f64) -> (f64, f64) {
        let apart = self.density(x - self.magnitude) + self.density(x + self.magnitude);
        ((1.0 - self.share) * self.density(x), 0.5 * self.share * apart)
    }

    /// True where a value is more likely one of the shifted.
    fn has(&self, value: f64) -> bool {
        let (bulk, apart) = self.densities(value.abs());
        apart > bulk
    }
}

/// Maximum log-likelihood of Student's t about zero: degrees of freedom from a grid, the scale of each by
/// expectation maximisation.
fn student(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let of = |degrees: f64| {
        let mut square = mad_std(values).powi(2);
        for _ in 0..STUDENT_ROUNDS {
            let weighted = |x: &f64| (degrees + 1.0) * x * x / (degrees + x * x / square);
            square = values.iter().map(weighted).sum::<f64>() / n;
        }
        let student = StudentsT::new(0.0, square.sqrt(), degrees).ok()?;
        Some(values.iter().map(|x| student.ln_pdf(*x)).sum())
    };
    STUDENT_DEGREES.into_iter().filter_map(of).fold(f64::NEG_INFINITY, f64::max)
}

/// Samples that were excluded because they lie far from their neighbours, without being the outliers of the table.
#[derive(Debug, Clone, PartialEq)]
pub struct Excluded {
    /// Index of the channel.
    pub channel: usize,
    /// Index of each sample.
    pub samples: Vec<usize>,
}

/// Finds outliers in a residual (all channels), and excludes them. In a channel that is `known` to round,
/// clip or repeat its values, the remaining errors of these effects look like outliers to a model of coloured
/// noise: there, only several values far from their neighbours count.
pub fn outliers(
    data: &mut Data,
    residual: &[f64],
    known: &[SampleEffect],
) -> (Vec<SampleEffect>, Vec<Excluded>) {
    let ranges = data.ranges();
    let (mut found, mut excluded) = (Vec::new(), Vec::new());
    for (index, (channel, range)) in data.channels.iter_mut().zip(ranges).enumerate() {
        let r = &residual[range];
        let own: Vec<&SampleEffect> = known.iter().filter(|e| e.channel == index).collect();
        let step = own.iter().filter_map(|e| e.parameters.get("step")).fold(0.0f64, |m, v| m.max(v.0));
        let distinct = |wild: &Wild| {
            let at: Vec<usize> = wild.samples.iter().map(|wild| wild.at).collect();
            let limit = OUTLIER_SIZE_RATIO * OUTLIER_SIGMAS * wild.spread;
            let plain = wild.samples.iter().all(|wild| wild.size.abs() > limit);
            let enough = at.len() >= MIN_OUTLIERS || !at.is_empty() && plain && own.is_empty();
            enough && at.len() * 4 <= r.len() && longest_run(&at) <= 3
        };
        let colour = || {
            let wild = foretold(r, &channel.good).filter(|_| own.is_empty()).filter(distinct)?;
            wild.outliers().is_some().then_some(wild)
        };
        let Some(wild) =
            Some(far(r, &channel.good, OUTLIER_STEP_RATIO * step)).filter(distinct).or_else(colour)
        else {
            continue;
        };
        for wild in &wild.samples {
            channel.good[wild.at] = false;
        }
        let Some(outliers) = wild.outliers() else {
            let samples = wild.samples.iter().map(|wild| wild.at).collect();
            excluded.push(Excluded { channel: index, samples });
            continue;
        };
        let (magnitude, differing) = sizes(&outliers);
        let (n, samples) = (r.len() as f64, outliers.len());
        let count = samples as f64;
        let (low, high) = share_interval(count, n);
        let size = 1.96 * wild.spread.max(differing) / count.sqrt();
        let parameters = BTreeMap::from([
            ("fraction", (count / n, low, high)),
            ("magnitude", (magnitude, magnitude - size, magnitude + size)),
        ]);
        found.push(SampleEffect { kind: Kind::Outliers, channel: index, parameters, samples });
    }
    (found, excluded)
}

/// Drops outliers that the causes explain: a delayed sensor errs most where its signal jumps. `good` marks
/// the samples that counted before any were excluded.
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
    let (again, _) = outliers(&mut data, &residual, &others);
    samples.retain(|e| e.kind != Kind::Outliers || again.iter().any(|a| a.channel == e.channel));
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Stream;

    const SAMPLES: usize = 3000;

    fn normal(seed: u64) -> Vec<f64> {
        let mut stream = Stream::new(seed, "outliers");
        (0..SAMPLES).map(|_| stream.normal()).collect()
    }

    /// Student's t noise with the given degrees of freedom.
    fn heavy_tails(seed: u64, degrees: usize) -> Vec<f64> {
        let mut stream = Stream::new(seed, "outliers");
        let chi_square =
            |stream: &mut Stream| (0..degrees).map(|_| stream.normal().powi(2)).sum::<f64>() / degrees as f64;
        (0..SAMPLES).map(|_| stream.normal() / chi_square(&mut stream).sqrt()).collect()
    }

    #[test]
    fn outliers_beside_a_steep_beginning_have_one_magnitude() {
        let mut r: Vec<f64> = normal(7);
        r.iter_mut().enumerate().for_each(|(k, v)| *v += 200.0 * (-(k as f64) / 12.0).exp());
        for k in [800, 1700, 2900] {
            r[k] += 60.0;
        }
        let wild = far(&r, &[true; SAMPLES], 0.0);
        assert_eq!(wild.samples.iter().map(|wild| wild.at).collect::<Vec<_>>(), [800, 1700, 2900]);
        let (magnitude, differing) = sizes(&wild.samples);
        assert!(differing < 0.1 * magnitude && wild.outliers().is_some_and(|found| found.len() == 3));
    }

    /// The last sample of a record has neighbours on one side only, and was never one of the outliers.
    #[test]
    fn the_first_and_the_last_sample_may_lie_far_from_a_slope() {
        let mut r = normal(9);
        r.iter_mut().enumerate().for_each(|(k, v)| *v += 2.0 * k as f64);
        let ends = |r: &[f64]| far(r, &[true; SAMPLES], 0.0).samples.iter().map(|w| w.at).collect::<Vec<_>>();
        assert!(ends(&r).is_empty());
        r[0] -= 60.0;
        r[SAMPLES - 1] -= 60.0;
        assert_eq!(ends(&r), [0, SAMPLES - 1]);
    }

    #[test]
    fn heavy_tails_are_no_outliers_and_a_few_of_one_size_are() {
        let good = vec![true; SAMPLES];
        let named = |r: &[f64]| {
            let wild = far(r, &good, 0.0);
            wild.samples.len() >= MIN_OUTLIERS && wild.outliers().is_some()
        };
        let falsely = (0..50).filter(|seed| named(&heavy_tails(*seed, 3))).count();
        assert!(falsely <= 1, "{falsely} of 50");
        // Some of the outliers of size 8 are within the limit that defines an outlier.
        for (size, every) in [(15.0, 700), (8.0, 100)] {
            for seed in 0..50 {
                let mut r = normal(seed);
                for k in (100..SAMPLES).step_by(every) {
                    r[k] += if k % 200 == 0 { size } else { -size };
                }
                assert!(named(&r), "{seed}: {size}");
            }
        }
    }

    /// Bursts of a lightly damped noise lie far from their neighbours too, but not alone and not by one magnitude.
    #[test]
    fn bursts_of_noise_do_not_hide_outliers_of_one_magnitude() {
        for seed in 0..20 {
            let mut last = [0.0; 2];
            let mut r: Vec<f64> = normal(seed)
                .into_iter()
                .map(|e| {
                    let y = 0.1 * e + 1.7 * last[0] - 0.93 * last[1];
                    last = [y, last[0]];
                    y
                })
                .collect();
            let spread = mad_std(&r);
            let mut hidden: Vec<usize> = (40..SAMPLES).step_by(70).collect();
            hidden.iter().for_each(|k| r[*k] += if k % 140 == 40 { 10.0 } else { -10.0 } * spread);
            // Far from their neighbours, in a row.
            for k in [500, 1200, 2500] {
                r[k] += 6.0 * spread;
                r[k + 1] += 5.5 * spread;
            }
            let wild = far(&r, &vec![true; SAMPLES], 0.0);
            let found: Vec<usize> = wild.outliers().unwrap().iter().map(|wild| wild.at).collect();
            hidden.retain(|k| !found.contains(k));
            assert!(hidden.len() <= 2, "{seed}: {hidden:?} are not among {found:?}");
        }
    }
}
