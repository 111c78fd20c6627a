//! Data of an identification: stretches of records on an even grid, with the vehicle's signals.

use whirlstand_logs::{Record, pauses};
use whirlstand_vehicle::Vehicle;

use super::IdentifyError;
use crate::compare::gaps::bridged_s;
use crate::compare::grid::grid;
use crate::compare::{CompareError, CompareOptions};

/// A part of a record on an even grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    /// Path of the record.
    pub origin: String,
    /// Time of the first step in the record, s.
    pub start_s: f64,
    /// Steps from the beginning of the whole record, at which the clock of effects starts, to the first step.
    pub first_step: u64,
    /// Time between two steps, s.
    pub period_s: f64,
    /// Inputs within the vehicle's limits, SI: steps x inputs, row after row.
    pub inputs: Vec<f64>,
    /// Outputs, SI: steps x outputs of the vehicle, row after row; NaN where there is no value or the output
    /// is not fitted.
    pub outputs: Vec<f64>,
    /// Number of steps.
    pub steps: usize,
}

impl Segment {
    /// Extracts a part of a record: the vehicle's inputs and those of its outputs that the record has.
    ///
    /// # Errors
    /// When the record lacks an input, an output that the vehicle file requires to be fitted, or any output at all;
    /// when it is too short or has no clock.
    pub fn new(
        record: &Record,
        vehicle: &Vehicle,
        period_s: Option<f64>,
        (from_s, until_s): (Option<f64>, Option<f64>),
    ) -> Result<Self, IdentifyError> {
        for (name, _) in vehicle.fit.iter().filter(|(_, weight)| *weight > 0.0) {
            record.signal(name).map_err(CompareError::from)?;
        }
        let options = CompareOptions { period_s, from_s, until_s, ..CompareOptions::default() };
        let grid = grid(record, vehicle, &options)?;
        let (m, p, steps) = (vehicle.inputs.len(), vehicle.outputs.len(), grid.t.len());
        let mut inputs = grid.inputs;
        for row in inputs.chunks_exact_mut(m) {
            for (u, input) in row.iter_mut().zip(&vehicle.inputs) {
                *u = u.clamp(input.lower, input.upper);
            }
        }
        let mut outputs = vec![f64::NAN; steps * p];
        for (values, &i) in grid.measured.iter().zip(&grid.outputs) {
            if vehicle.fit_weight(&vehicle.outputs[i].name) > 0.0 {
                for (k, value) in values.iter().enumerate() {
                    outputs[k * p + i] = *value;
                }
            }
        }
        Ok(Self {
            origin: record.origin.clone(),
            start_s: grid.start_s,
            first_step: grid.first_step,
            period_s: grid.period_s,
            inputs,
            outputs,
            steps,
        })
    }

    /// Extracts a part of a record like [`Segment::new`], cut where the inputs pause for longer than they can be held
    /// ([`bridged_s`]): a shorter gap is one of missing measurements, which a filter predicts through. Pieces that are
    /// too short for a fit are left out.
    ///
    /// # Errors
    /// As [`Segment::new`].
    pub fn unbroken(
        record: &Record,
        vehicle: &Vehicle,
        period_s: Option<f64>,
        (from_s, until_s): (Option<f64>, Option<f64>),
    ) -> Result<Vec<Self>, IdentifyError> {
        let mut gaps: Vec<(f64, f64)> = Vec::new();
        for input in &vehicle.inputs {
            let signal = record.signal(&input.name).map_err(CompareError::from)?;
            let known = record.time.iter().zip(&signal.values).filter(|(_, v)| v.is_finite());
            gaps.extend(pauses(&known.map(|(t, _)| *t).collect::<Vec<_>>()));
        }
        let (from, until) = (from_s.unwrap_or(f64::NEG_INFINITY), until_s.unwrap_or(f64::INFINITY));
        let longest = bridged_s(record, vehicle, record.period().unwrap_or(0.0));
        gaps.retain(|(a, b)| *b > from && *a < until && b - a > longest);
        if gaps.is_empty() || record.time_unit != "s" {
            return Ok(vec![Self::new(record, vehicle, period_s, (from_s, until_s))?]);
        }
        gaps.sort_by(|a, b| a.0.total_cmp(&b.0));
        // One clock made all pieces, though the median of its jitter is another in each.
        let period_s = period_s.or_else(|| record.period());
        let mut pieces = Vec::new();
        let mut start = from_s;
        for (a, b) in gaps.into_iter().chain([(until, f64::INFINITY)]) {
            let end = if a.is_finite() { Some(a) } else { None };
            match Self::new(record, vehicle, period_s, (start, end)) {
                Ok(piece) => pieces.push(piece),
                Err(IdentifyError::Record(CompareError::TooShort { .. })) => {}
                Err(error) => return Err(error),
            }
            start = Some(start.unwrap_or(b).max(b));
        }
        if pieces.is_empty() {
            return Ok(vec![Self::new(record, vehicle, period_s, (from_s, until_s))?]);
        }
        Ok(pieces)
    }

    /// Measured values of output `i` of `p`, one per step; NaN where there is none.
    pub fn output(&self, i: usize, p: usize) -> Vec<f64> {
        self.outputs.iter().skip(i).step_by(p).copied().collect()
    }

    /// Time of a step in the record, s.
    pub fn time(&self, step: usize) -> f64 {
        self.start_s + step as f64 * self.period_s
    }
}

/// Cuts segments into pieces of at most `steps` steps, each with its own initial state.
pub fn pieces(segments: &[Segment], steps: usize) -> Vec<Segment> {
    let mut all = Vec::new();
    for s in segments {
        let count = s.steps.div_ceil(steps.max(1)).max(1);
        let (m, p) = (s.inputs.len() / s.steps.max(1), s.outputs.len() / s.steps.max(1));
        for i in 0..count {
            let (from, until) = (i * s.steps / count, (i + 1) * s.steps / count);
            all.push(Segment {
                origin: s.origin.clone(),
                start_s: s.time(from),
                first_step: s.first_step + from as u64,
                period_s: s.period_s,
                inputs: s.inputs[from * m..until * m].to_vec(),
                outputs: s.outputs[from * p..until * p].to_vec(),
                steps: until - from,
            });
        }
    }
    all
}

/// A signal with its gaps (NaN) interpolated linearly; before its first and after its last value it is
/// constant.
pub fn filled(values: &[f64]) -> Vec<f64> {
    let known: Vec<usize> = (0..values.len()).filter(|k| values[*k].is_finite()).collect();
    let (Some(first), Some(last)) = (known.first(), known.last()) else { return vec![0.0; values.len()] };
    let mut out = values.to_vec();
    out[..*first].fill(values[*first]);
    out[*last..].fill(values[*last]);
    for pair in known.windows(2) {
        let (a, b) = (pair[0], pair[1]);
        let slope = (values[b] - values[a]) / (b - a) as f64;
        (a + 1..b).for_each(|k| out[k] = values[a] + slope * (k - a) as f64);
    }
    out
}

/// True for each of the `p` outputs of which at least one segment has a value.
pub fn present(segments: &[Segment], p: usize) -> Vec<bool> {
    (0..p)
        .map(|i| segments.iter().any(|s| s.outputs.iter().skip(i).step_by(p).any(|v| v.is_finite())))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A clock that jitters made pieces of periods that differed in the fourth digit, which no fit accepts.
    #[test]
    fn pieces_of_a_record_have_one_period() {
        let text = "name = 'axis'\nA = [[-1.0]]\nB = [[1.0]]\ninputs = [{ name = 'u' }]\n\
                    states = [{ name = 'roll', unit = 'rad' }]\noutputs = [{ name = 'roll', unit = 'rad' }]\n";
        let vehicle = Vehicle::parse(text, "axis.toml").unwrap();
        let mut stream = whirlstand_vehicle::Stream::new(1, "jitter");
        let mut t = 0.0;
        let times: Vec<f64> = (0..900)
            .map(|k| {
                t += 0.01
                    + 0.0005 * stream.normal().clamp(-3.0, 3.0)
                    + if k % 300 == 299 { 20.0 } else { 0.0 };
                t
            })
            .collect();
        let mut record = Record::new("axis", times).unwrap();
        record.push("u", "", (0..900).map(|k| (f64::from(k) * 0.1).sin()).collect()).unwrap();
        record.push("roll", "rad", (0..900).map(|k| (f64::from(k) * 0.1).cos()).collect()).unwrap();
        let pieces = Segment::unbroken(&record, &vehicle, None, (None, None)).unwrap();
        assert_eq!(pieces.len(), 3);
        let period_s = record.period().unwrap();
        assert!(pieces.iter().all(|piece| piece.period_s == period_s), "{period_s}");
    }

    #[test]
    fn gaps_become_straight_lines() {
        let nan = f64::NAN;
        assert_eq!(filled(&[nan, 1.0, nan, nan, 4.0, nan]), [1.0, 1.0, 2.0, 3.0, 4.0, 4.0]);
        assert_eq!(filled(&[nan, nan]), [0.0, 0.0]);
    }
}
