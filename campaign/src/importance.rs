//! Importance sampling for rare failures: flights are drawn where failures are frequent, and each is weighted with
//! the ratio of its nominal probability to that of its draw.
//!
//! Sources: Rubinstein and Kroese, Simulation and the Monte Carlo Method, 2017, section 5.7. Every key that is
//! drawn from a continuous distribution has a standard normal coordinate. There the draws come from a normal
//! distribution of another centre and spread and, for a share of the flights, from the nominal one (a defensive
//! mixture: Hesterberg, Technometrics 37, 1995), so that no weight exceeds the inverse of that share. The mean of
//! the weights of the flights that fail is an unbiased estimate of the probability for any centre and spread.
//! These come from an earlier campaign's failures by the cross-entropy method (Rubinstein, Methodology and
//! Computing in Applied Probability 1, 1999).

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, Normal};

/// Share of the flights that are drawn from the nominal distribution.
const NOMINAL: f64 = 0.2;

/// Spread of the draws without an earlier campaign.
const SPREAD: f64 = 2.0;

/// Least and greatest spread that an earlier campaign may lead to.
const SPREADS: (f64, f64) = (0.7, 3.0);

/// Number of failures that an earlier campaign must have.
const LEAST_FAILURES: usize = 10;

/// The section on importance sampling in a campaign file.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct WrittenImportance {
    spread: Option<f64>,
    nominal: Option<f64>,
    /// Table of an earlier campaign.
    pub after: Option<String>,
}

/// Failures of an earlier campaign, in standard normal coordinates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Failures {
    /// Its keys and their units.
    pub keys: Vec<(String, String)>,
    centre: Vec<f64>,
    spread: Vec<f64>,
}

impl Failures {
    /// Centre and spread of weighted points of the unit cube; `None` where there are too few.
    pub fn of(keys: Vec<(String, String)>, points: &[(Vec<f64>, f64)]) -> Option<Self> {
        let n = points.first().filter(|_| points.len() >= LEAST_FAILURES)?.0.len();
        let total: f64 = points.iter().map(|(_, weight)| weight).sum();
        let mean = |f: &dyn Fn(&[f64]) -> f64| {
            points.iter().map(|(point, weight)| weight * f(point)).sum::<f64>() / total
        };
        let centre: Vec<f64> = (0..n).map(|j| mean(&|p| normal(p[j]))).collect();
        let spread = |j: usize| mean(&|p| (normal(p[j]) - centre[j]).powi(2)).sqrt();
        let spread = (0..n).map(|j| spread(j).clamp(SPREADS.0, SPREADS.1)).collect();
        Some(Self { keys, centre, spread })
    }
}

/// Distribution of the coordinates.
#[derive(Debug, Clone)]
pub(crate) struct Importance {
    nominal: f64,
    /// Centre and spread of each coordinate; `None` for one that is drawn from its nominal distribution, such
    /// as a seed.
    normals: Vec<Option<(f64, f64)>>,
}

impl Importance {
    /// `continuous` states for each coordinate whether its key is drawn from a continuous distribution.
    ///
    /// # Errors
    /// A sentence on a combination that is not possible.
    pub fn new(
        written: &WrittenImportance,
        failures: Option<&Failures>,
        continuous: &[bool],
    ) -> Result<Self, String> {
        let nominal = written.nominal.unwrap_or(NOMINAL);
        if !(nominal > 0.0 && nominal < 1.0) {
            return Err(
                "`nominal`, the share of flights drawn from the nominal distribution, must be between 0 and 1".into()
            );
        }
        if written.spread.is_some_and(|spread| !(spread > 0.5 && spread <= 10.0)) {
            return Err("`spread` must be between 0.5 and 10 standard deviations".into());
        }
        if !continuous.contains(&true) {
            return Err(
                "method \"importance\" needs a key that varies by `uniform`, `normal` or `found`".into()
            );
        }
        let of = |j: usize| match failures {
            Some(f) => (f.centre[j], written.spread.unwrap_or(f.spread[j])),
            None => (0.0, written.spread.unwrap_or(SPREAD)),
        };
        let normals = continuous.iter().enumerate().map(|(j, is)| is.then(|| of(j))).collect();
        Ok(Self { nominal, normals })
    }

    /// A point of the unit cube, and its weight.
    pub fn point(&self, rng: &mut ChaCha8Rng) -> (Vec<f64>, f64) {
        let as_in_nature = rng.random::<f64>() < self.nominal;
        let mut ratio = 1.0;
        let point = self.normals.iter().map(|coordinate| {
            let p = rng.random::<f64>().clamp(f64::EPSILON, 1.0 - f64::EPSILON);
            let Some((centre, spread)) = *coordinate else { return p };
            let z = if as_in_nature { normal(p) } else { centre + spread * normal(p) };
            let from_centre = (z - centre) / spread;
            // Ratio of the density of the draws to the nominal density.
            ratio *= (0.5 * (z * z - from_centre * from_centre)).exp() / spread;
            Normal::standard().cdf(z)
        });
        let point = point.collect();
        (point, 1.0 / (self.nominal + (1.0 - self.nominal) * ratio))
    }
}

fn normal(p: f64) -> f64 {
    Normal::standard().inverse_cdf(p)
}

#[cfg(test)]
mod tests {
    use crate::table::{Columns, Ended, FigureColumn, Flight, TableInfo, WEIGHT};
    use crate::{Campaign, Findings, Proportion, Table};

    /// Two normal keys and a seed; a flight fails where a + b is greater than the threshold.
    fn campaign(flights: u64, seed: u64, more: &str) -> String {
        format!(
            "launch = \"x\"\nflights = {flights}\nseed = {seed}\n{more}\n\
             [[vary]]\nkey = \"a\"\nnormal = {{ mean = 1.0, std = 2.0 }}\n\
             [[vary]]\nkey = \"b\"\nnormal = {{ mean = 0.0, std = 1.0 }}\n\
             [[vary]]\nkey = \"seed\"\nintegers = [1, 9]\n"
        )
    }

    fn flown(text: &str, threshold: f64) -> Table {
        let campaign = Campaign::parse("c.toml", text).unwrap();
        let flights = (0..campaign.flights()).map(|number| {
            let values = campaign.values(number);
            let sum = values[0].number().unwrap() + values[1].number().unwrap();
            let figures = vec![Some(sum), campaign.weight(number)];
            Flight { number, values, ended: Ended::Complete, holds: vec![sum <= threshold], figures }
        });
        let columns = Columns {
            keys: campaign.keys(),
            limits: vec![("sum".into(), threshold)],
            figures: ["sum", WEIGHT]
                .map(|key| FigureColumn { key: key.into(), ..Default::default() })
                .to_vec(),
        };
        let info = TableInfo {
            digest: String::new(),
            version: String::new(),
            flights: campaign.flights(),
            shard: None,
            text: text.into(),
            columns,
        };
        Table { flights: flights.collect(), info }
    }

    fn probability(threshold: f64) -> f64 {
        use statrs::distribution::{ContinuousCDF, Normal};
        Normal::standard().sf((threshold - 1.0) / 5f64.sqrt())
    }

    fn estimates(threshold: f64, flights: u64, more: &str) -> Vec<Proportion> {
        let one = |seed| Findings::of(&flown(&campaign(flights, seed, more), threshold)).violated;
        (0..200).map(one).collect()
    }

    /// The mean of many campaigns is the known probability, and their intervals contain it as often as
    /// stated.
    fn hold(all: &[Proportion], truth: f64) {
        let n = all.len() as f64;
        let mean = all.iter().map(|p| p.share).sum::<f64>() / n;
        let std = (all.iter().map(|p| (p.share - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
        assert!((mean - truth).abs() < 4.0 * std / n.sqrt(), "{mean} {truth} {std}");
        let inside = all.iter().filter(|p| p.low <= truth && truth <= p.high).count();
        assert!(inside as f64 >= 0.9 * n, "{inside} of {n} hold {truth}");
    }

    #[test]
    fn a_frequent_failure_has_the_probability_that_brute_force_finds() {
        let truth = probability(4.0);
        let importance = estimates(4.0, 400, "method = \"importance\"");
        hold(&importance, truth);
        let brute = Findings::of(&flown(&campaign(40_000, 1, ""), 4.0)).violated;
        assert!(brute.low < truth && truth < brute.high, "{brute:?} {truth}");
    }

    #[test]
    fn a_failure_in_a_hundred_thousand_is_found_after_an_earlier_campaign() {
        let (threshold, dir) = (10.6, tempfile::tempdir().unwrap());
        let truth = probability(threshold);
        assert!(truth > 5e-6 && truth < 1e-5, "{truth}");
        let pilot =
            flown(&campaign(4000, 1, "method = \"importance\"\n[importance]\nspread = 3.0\n"), threshold);
        pilot.write(&dir.path().join("pilot.parquet")).unwrap();
        let path = dir.path().join("c.toml");
        let more = "method = \"importance\"\n[importance]\nafter = \"pilot.parquet\"\n";
        let one = |seed| {
            std::fs::write(&path, campaign(300, seed, more)).unwrap();
            // The text alone is the campaign: a part is joined without the pilot campaign's table.
            let text = Campaign::open(&path).unwrap().text;
            Findings::of(&flown(&text, threshold)).violated
        };
        let all: Vec<Proportion> = (0..200).map(one).collect();
        hold(&all, truth);
        // 300 flights estimate it to an eighth; plain sampling would need seven million for that.
        assert!(all.iter().all(|p| p.high < 4.0 * truth && p.high > 0.0), "{truth}");
    }

    #[test]
    fn what_cannot_be_weighed_is_refused() {
        let refused = |text: String| Campaign::parse("c.toml", &text).unwrap_err().to_string();
        let error = refused(campaign(10, 1, "method = \"importance\"\n[importance]\nnominal = 1.0\n"));
        assert!(error.contains("`nominal`"), "{error}");
        let error = refused(campaign(10, 1, "[importance]\nspread = 2.0\n"));
        assert!(error.contains("method = \"importance\""), "{error}");
        let dir = tempfile::tempdir().unwrap();
        flown(&campaign(50, 1, ""), 10.0).write(&dir.path().join("pilot.parquet")).unwrap();
        let path = dir.path().join("c.toml");
        std::fs::write(
            &path,
            campaign(10, 1, "method = \"importance\"\n[importance]\nafter = \"pilot.parquet\"\n"),
        )
        .unwrap();
        let error = Campaign::open(&path).unwrap_err().to_string();
        assert!(error.contains("pilot.parquet") && error.contains("at least 10"), "{error}");
    }

    #[test]
    fn a_campaign_without_a_failure_has_an_upper_end() {
        let none = Findings::of(&flown(&campaign(500, 1, "method = \"importance\""), 1e9)).violated;
        assert_eq!((none.count, none.share, none.low), (0, 0.0, 0.0));
        assert!(none.high > 0.0 && none.high < 0.05, "{none:?}");
    }
}
