//! Data of one input and one output, split into fitted and held-out blocks.

use whirlstand_logs::Record;
use whirlstand_logs::resample::means_over_steps;
use whirlstand_logs::stats::{mean, median, rms};
use whirlstand_vehicle::{Input, Intersample, Output, SignalUnit, State, Vehicle};

use super::own_past::lags;
use super::structure::LONGEST_LAG_S;
use crate::identify::{IdentifyError, Segment};

/// Least number of blocks of a record; two of three are fitted, the third is held out.
const BLOCKS: usize = 12;
/// Fewest steps per block.
const LEAST_STEPS: usize = 60;
/// Least share of the squared steps of an input in each third of the blocks. Calibrated: a tenth of even shares.
const LEAST_MOVED: f64 = 1.0 / 30.0;
/// Largest number of steps in the blocks of which two thirds are fitted; of longer records evenly spaced blocks are taken.
const MOST_FITTED_STEPS: usize = 9000;
/// The same for regressions and forecasts, which cost far less per step.
const MOST_STEPS: usize = 90_000;

/// Part of the flight that is held out.
pub const HELD_OUT: usize = 2;

/// Pole faster than any vehicle's, 1/s.
const FASTEST_POLE: f64 = -1e4;

/// Time before held-out data from which forecasts follow the record, s, where there is any: three time constants of the slowest
/// actuator, whose state is then known, to 5 % of what it was before.
const LEAD_S: f64 = 3.0 * LONGEST_LAG_S;

/// Held-out data with what was recorded before.
#[derive(Debug, Clone)]
pub struct LeadIn {
    /// Data from `lead` steps before the held-out data.
    pub segment: Segment,
    /// Steps that are not held out.
    pub lead: usize,
}

/// Data of one input and one output, with their means subtracted.
#[derive(Debug, Clone)]
pub struct Pair {
    /// Segments for fitting.
    pub fitted: Vec<Segment>,
    /// All data in three parts that each cover the whole flight, for cross-validation.
    pub folds: [Vec<Segment>; 3],
    /// The part that is held out, each segment with what was recorded before it.
    pub lead_ins: Vec<LeadIn>,
    /// Mean of the input over the fitted data, SI.
    pub input_level: f64,
    /// Mean of the output over the fitted data, SI.
    pub output_level: f64,
    /// Root mean square of the input about its level, SI.
    pub input_spread: f64,
    /// Root mean square of the output about its level, SI.
    pub output_spread: f64,
    /// Time between two steps, s.
    pub period_s: f64,
    /// What the input is taken to do between its samples.
    pub intersample: Intersample,
    /// True when the input may react to the output, as in a closed loop.
    pub reacts: bool,
}

/// Fewest steps of a record that can be cut.
pub const fn least_steps() -> usize {
    3 * LEAST_STEPS
}

/// A vehicle of one input and one output, used to extract both from a record. It is fast: while nothing is known of the
/// vehicle, its inputs are known in a gap only as far as their own band says.
fn probe(input: &str, output: &str) -> Vehicle {
    let unit = SignalUnit::default();
    let zero = nalgebra::DMatrix::zeros(1, 1);
    Vehicle {
        name: "probe".into(),
        description: String::new(),
        states: vec![State { name: output.into(), unit: unit.clone(), bound: None }],
        inputs: vec![Input {
            name: input.into(),
            unit: unit.clone(),
            lower: f64::NEG_INFINITY,
            upper: f64::INFINITY,
            rate_limit: f64::INFINITY,
            intersample: Intersample::Held,
        }],
        outputs: vec![Output {
            name: output.into(),
            unit,
            noise: 0.0,
            bias: 0.0,
            quantization: 0.0,
            every: 1,
            vibration: None,
        }],
        a: nalgebra::DMatrix::from_element(1, 1, FASTEST_POLE),
        b: zero.clone(),
        c: nalgebra::DMatrix::identity(1, 1),
        d: zero,
        effects: Vec::new(),
        free: Vec::new(),
        fit: Vec::new(),
        map: Vec::new(),
        provenance: Vec::new(),
        source_text: String::new(),
        folder: None,
    }
}

impl Pair {
    /// Splits the record; `None` when it is too short to hold data out.
    ///
    /// # Errors
    /// When the record has no grid, or lacks a signal.
    pub fn new(record: &Record, input: &str, output: &str) -> Result<Option<Self>, IdentifyError> {
        let whole = Segment::unbroken(record, &probe(input, output), None, (None, None))?;
        let Split { mut fitted, mut folds, mut lead_ins } = Split::of(&whole);
        if fitted.is_empty() || folds.iter().any(Vec::is_empty) {
            return Ok(None);
        }
        let level = |of: fn(&Segment) -> &[f64]| {
            let known: Vec<f64> = fitted.iter().flat_map(of).copied().filter(|v| v.is_finite()).collect();
            let mean = mean(&known);
            (mean, rms(&known.iter().map(|v| v - mean).collect::<Vec<_>>()))
        };
        let (input_level, input_spread) = level(|s| &s.inputs);
        let (output_level, output_spread) = level(|s| &s.outputs);
        let before = lead_ins.iter_mut().map(|part| &mut part.segment);
        for segment in fitted.iter_mut().chain(folds.iter_mut().flatten()).chain(before) {
            segment.inputs.iter_mut().for_each(|u| *u -= input_level);
            segment.outputs.iter_mut().for_each(|y| *y -= output_level);
        }
        let period_s = fitted[0].period_s;
        Ok(Some(Self {
            fitted,
            folds,
            lead_ins,
            input_level,
            output_level,
            input_spread,
            output_spread,
            period_s,
            intersample: Intersample::Held,
            reacts: true,
        }))
    }

    /// The same with an input that goes straight from one sample to the next.
    pub fn interpolated(&self) -> Self {
        let mut straight = Self { intersample: Intersample::Interpolated, ..self.clone() };
        let before = straight.lead_ins.iter_mut().map(|part| &mut part.segment);
        for segment in straight.fitted.iter_mut().chain(straight.folds.iter_mut().flatten()).chain(before) {
            segment.inputs = means_over_steps(&segment.inputs);
        }
        straight
    }

    /// Held-out segments for validation: the part that is not fitted.
    pub fn held(&self) -> &[Segment] {
        &self.folds[HELD_OUT]
    }

    /// Total length of the held-out data, s.
    pub fn held_s(&self) -> f64 {
        self.held().iter().map(|s| s.steps as f64 * s.period_s).sum()
    }
}

/// Steps `from..until` of a segment of one input and one output.
fn part(segment: &Segment, from: usize, until: usize) -> Segment {
    Segment {
        origin: segment.origin.clone(),
        start_s: segment.time(from),
        first_step: segment.first_step + from as u64,
        period_s: segment.period_s,
        inputs: segment.inputs[from..until].to_vec(),
        outputs: segment.outputs[from..until].to_vec(),
        steps: until - from,
    }
}

/// Fitted data, and the parts of a cross-validation: of every three blocks of the flight one belongs to each part, and the
/// first two are the fitted data.
struct Split {
    fitted: Vec<Segment>,
    folds: [Vec<Segment>; 3],
    lead_ins: Vec<LeadIn>,
}

impl Split {
    /// Parts of a record with gaps that are shorter than three blocks are blocks of their own.
    fn of(whole: &[Segment]) -> Self {
        let steps: usize = whole.iter().map(|s| s.steps).sum();
        let longest = (steps.min(MOST_FITTED_STEPS) / BLOCKS).max(LEAST_STEPS);
        // Blocks short enough for the input to move in all parts, if it moves long enough for that.
        let mut lengths = std::iter::successors(Some(longest), |block| Some(block / 2))
            .take_while(|block| *block >= LEAST_STEPS);
        let moving = lengths.find(|block| Self::in_blocks(whole, *block).moves_in_all());
        Self::in_blocks(whole, moving.unwrap_or(longest))
    }

    /// True where each part has a share of the input's movements by which its effect can be known.
    fn moves_in_all(&self) -> bool {
        let moved = |part: &Vec<Segment>| -> f64 {
            let steps = part.iter().flat_map(|s| s.inputs.windows(2).map(|w| (w[1] - w[0]).powi(2)));
            steps.filter(|square| square.is_finite()).sum()
        };
        let parts = self.folds.each_ref().map(moved);
        parts.iter().all(|part| *part > LEAST_MOVED * parts.iter().sum::<f64>())
    }

    fn in_blocks(whole: &[Segment], block: usize) -> Self {
        let steps: usize = whole.iter().map(|s| s.steps).sum();
        // Groups of three blocks; of a long record an even share of them.
        let taken = |most: usize, group: usize| {
            let share = (most as f64 / steps as f64).min(1.0);
            (share * (group + 1) as f64).ceil() > (share * group as f64).ceil()
        };
        let mut split = Self { fitted: Vec::new(), folds: Default::default(), lead_ins: Vec::new() };
        let (mut group, mut short) = (0, 0);
        for segment in whole {
            let groups = segment.steps / (3 * block);
            if groups == 0 && segment.steps >= LEAST_STEPS {
                if taken(MOST_STEPS, short / 3) {
                    split.folds[short % 3].push(segment.clone());
                    split.lead_ins.extend(
                        (short % 3 == HELD_OUT).then(|| LeadIn { segment: segment.clone(), lead: 0 }),
                    );
                }
                if taken(MOST_FITTED_STEPS, short / 3) {
                    split.fitted.extend((short % 3 < 2).then(|| segment.clone()));
                }
                short += 1;
            }
            // Remaining steps lengthen the groups.
            let length = segment.steps.checked_div(groups).unwrap_or(0);
            for g in 0..groups {
                let cuts: [usize; 4] = std::array::from_fn(|third| g * length + third * length / 3);
                if taken(MOST_FITTED_STEPS, group) {
                    split.fitted.push(part(segment, cuts[0], cuts[2]));
                }
                if taken(MOST_STEPS, group) {
                    for (fold, cut) in split.folds.iter_mut().zip(cuts.windows(2)) {
                        fold.push(part(segment, cut[0], cut[1]));
                    }
                    let lead = ((LEAD_S / segment.period_s).ceil() as usize).min(cuts[HELD_OUT]);
                    let segment = part(segment, cuts[HELD_OUT] - lead, cuts[HELD_OUT + 1]);
                    split.lead_ins.push(LeadIn { segment, lead });
                }
                group += 1;
            }
        }
        split
    }
}

/// Steps at the start of held-out data in which a filter settles.
pub fn warm(pair: &Pair, horizon: usize) -> usize {
    lags(pair.period_s).max(horizon)
}

/// Prediction horizons, steps. The first has at least four samples of the slower of input and output, so that
/// the input can act; each next one is twice as long, up to the time over which the output's autocorrelation
/// falls to one half, since beyond it the past alone predicts little, and up to half a second. Lags and
/// integrations show at longer horizons, where a direct response is hidden by the change of the inputs. The
/// samples' noise is excluded from the autocorrelation by smoothing over three steps.
pub fn horizons(pair: &Pair, slowest_interval_s: f64) -> Vec<usize> {
    let steps = |time_s: f64| ((time_s / pair.period_s).round() as usize).max(4);
    let (least, half) = (steps(4.0 * slowest_interval_s), steps(half_correlation_s(pair)));
    let last = half.max(least);
    let mut all: Vec<usize> =
        std::iter::successors(Some(least), |h| Some(2 * h)).take_while(|h| 3 * h < 2 * last).collect();
    all.push(last);
    all
}

/// Time over which the output's autocorrelation falls to one half, s.
fn half_correlation_s(pair: &Pair) -> f64 {
    let lags = (LONGEST_HORIZON_S / pair.period_s) as usize;
    let smooth: Vec<Vec<f64>> = pair
        .fitted
        .iter()
        .map(|s| s.outputs.windows(3).map(|w| (w[0] + w[1] + w[2]) / 3.0).collect())
        .collect();
    let correlation = |lag: usize| {
        let products = smooth.iter().flat_map(|s| s.iter().zip(s.iter().skip(lag)).map(|(a, b)| a * b));
        let known: Vec<f64> = products.filter(|v| v.is_finite()).collect();
        mean(&known)
    };
    let whole = correlation(0);
    (1..=lags).find(|lag| correlation(*lag) < 0.5 * whole).unwrap_or(lags) as f64 * pair.period_s
}

/// Longest horizon, s; predictions of a small vehicle's motion over longer times depend on unknown gusts.
const LONGEST_HORIZON_S: f64 = 0.5;

/// Median and largest absolute deviation of the finite values.
pub fn range(values: &[f64]) -> (f64, f64) {
    let known: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let middle = median(&known);
    (middle, known.iter().map(|v| (v - middle).abs()).fold(0.0, f64::max))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_third_from_all_of_the_flight_is_held_out() {
        let mut record = Record::new("x", (0..3000).map(|k| k as f64 * 0.01).collect()).unwrap();
        record.push("u", "", (0..3000).map(|k| 5.0 + f64::from(k % 7)).collect()).unwrap();
        record.push("y", "", (0..3000).map(|k| (k as f64 * 0.1).sin() - 2.0).collect()).unwrap();
        let pair = Pair::new(&record, "u", "y").unwrap().unwrap();
        let steps = |segments: &[Segment]| segments.iter().map(|s| s.steps).sum::<usize>();
        assert_eq!((steps(&pair.fitted), steps(pair.held())), (2000, 1000));
        assert_eq!((pair.fitted.len(), pair.held().len()), (4, 4));
        assert!((pair.input_level - 8.0).abs() < 0.02 && (pair.output_level + 2.0).abs() < 0.02);
        assert!((pair.held_s() - 10.0).abs() < 1e-9);
        // cos(10 t) falls to one half at t = pi / 30.
        let ahead = horizons(&pair, 0.01);
        assert!(ahead == [4, 10] || ahead == [4, 11], "{ahead:?}");
        assert_eq!(horizons(&pair, 0.05), [20]);
    }

    /// Five parts of 4 s, each shorter than three blocks of a record of 20 s.
    #[test]
    fn short_parts_between_gaps_are_blocks() {
        let mut record =
            Record::new("x", (0..2000).map(|k| k as f64 * 0.01 + (k / 400) as f64).collect()).unwrap();
        record.push("u", "", (0..2000).map(|k| f64::from(k % 7)).collect()).unwrap();
        record.push("y", "", (0..2000).map(|k| (k as f64 * 0.1).sin()).collect()).unwrap();
        let pair = Pair::new(&record, "u", "y").unwrap().unwrap();
        let steps = |segments: &[Segment]| segments.iter().map(|s| s.steps).collect::<Vec<_>>();
        assert_eq!((steps(&pair.fitted), steps(pair.held())), (vec![400; 4], vec![400]));
    }

    #[test]
    fn all_of_a_long_record_is_surveyed_and_an_even_share_of_it_fitted() {
        let steps = 10 * MOST_FITTED_STEPS;
        let mut record = Record::new("x", (0..steps).map(|k| k as f64 * 0.01).collect()).unwrap();
        record.push("u", "", (0..steps).map(|k| (k % 7) as f64).collect()).unwrap();
        record.push("y", "", (0..steps).map(|k| (k as f64 * 0.1).sin()).collect()).unwrap();
        let pair = Pair::new(&record, "u", "y").unwrap().unwrap();
        let count = |segments: &[Segment]| segments.iter().map(|s| s.steps).sum::<usize>();
        assert_eq!(pair.folds.iter().map(|fold| count(fold)).sum::<usize>(), steps);
        let fitted = count(&pair.fitted) as f64 / MOST_FITTED_STEPS as f64;
        assert!((0.6..0.8).contains(&fitted), "{fitted}");
        let starts: Vec<f64> = pair.fitted.iter().map(|s| s.start_s).collect();
        assert!(starts[0] < 100.0 && starts[starts.len() - 1] > 600.0, "{starts:?}");
    }

    #[test]
    fn a_short_record_cannot_be_cut() {
        let mut record = Record::new("x", (0..150).map(|k| k as f64 * 0.01).collect()).unwrap();
        record.push("u", "", (0..150).map(f64::from).collect()).unwrap();
        record.push("y", "", (0..150).map(f64::from).collect()).unwrap();
        assert!(Pair::new(&record, "u", "y").unwrap().is_none());
    }
}
