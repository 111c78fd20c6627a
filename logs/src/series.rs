//! A signal on its own clock, as in logs of many topics.

use crate::record::Record;

/// Samples of one signal at its own times.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name.
    pub name: String,
    /// SI unit; empty for a pure number.
    pub unit: String,
    /// Times of the samples, strictly increasing, s.
    time: Vec<f64>,
    /// Values of the samples, one per time, none of them NaN.
    values: Vec<f64>,
}

impl Series {
    /// A series from samples `(time, value)` in any order. Samples that are NaN are left out; of two samples at
    /// the same time the later one in the list holds.
    pub fn new(name: impl Into<String>, unit: impl Into<String>, mut samples: Vec<(f64, f64)>) -> Self {
        samples.retain(|(t, v)| t.is_finite() && !v.is_nan());
        // The sort is stable: samples at the same time keep their order.
        samples.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut time: Vec<f64> = Vec::with_capacity(samples.len());
        let mut values = Vec::with_capacity(samples.len());
        for (t, v) in samples {
            if time.last() == Some(&t) {
                values.pop();
                time.pop();
            }
            time.push(t);
            values.push(v);
        }
        Self { name: name.into(), unit: unit.into(), time, values }
    }

    /// Times of the samples.
    pub fn time(&self) -> &[f64] {
        &self.time
    }

    /// Values of the samples.
    pub fn values(&self) -> &[f64] {
        &self.values
    }
}

impl Record {
    /// The signals of the record, each with the times at which it has a value.
    pub fn to_series(&self) -> Vec<Series> {
        self.signals()
            .iter()
            .map(|s| {
                let samples = self.time.iter().copied().zip(s.values.iter().copied()).collect();
                Series::new(&s.name, &s.unit, samples)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_put_in_order() {
        let s =
            Series::new("x", "", vec![(2.0, 1.0), (1.0, 5.0), (2.0, 3.0), (3.0, f64::NAN), (f64::NAN, 1.0)]);
        assert_eq!((s.time(), s.values()), (&[1.0, 2.0][..], &[5.0, 3.0][..]));
    }
}
