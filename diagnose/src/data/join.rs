//! Joins several records, or the parts of one, into one.

use std::borrow::Cow;

use whirlstand_ident::compare::gaps::bridged_s;
use whirlstand_logs::Record;
use whirlstand_vehicle::Vehicle;

use crate::DiagnoseError;
use crate::data::record::{Channel, Data};
use crate::thresholds::{MAX_AR_ORDER, MIN_PART_STEPS, MIN_STEPS, SAME_PERIOD_SHARE};

/// At most one step in this many is dropped from a record to align its sensors with the steps before. Cost.
const MOST_LEAD: usize = 10;

impl Data {
    /// Several records as one, with the outputs that all of them have. Commands in a long gap are unknown:
    /// the part after it counts as a record of its own. In a short gap samples are missing, and the
    /// prediction continues.
    ///
    /// # Errors
    /// As [`Data::new`], when periods differ, when the records have no output in common, and when all records
    /// together are too short.
    pub fn join(records: &[Record], vehicle: &Vehicle, period_s: Option<f64>) -> Result<Self, DiagnoseError> {
        let mut parts = Vec::new();
        for record in records {
            let unbroken = unbroken(record, vehicle, period_s);
            // One clock made all parts, though the median of its jitter is another in each.
            let own = record.period().filter(|own| {
                let apart = |part: &Cow<'_, Record>| {
                    part.period().is_some_and(|period| (period / own - 1.0).abs() > SAME_PERIOD_SHARE)
                };
                record.time_unit == "s" && unbroken.len() > 1 && unbroken.iter().any(apart)
            });
            let period_s = period_s.or(own);
            parts.extend(unbroken.iter().map(|r| Self::new(r, vehicle, period_s)));
        }
        let mut parts = parts.into_iter().collect::<Result<Vec<_>, _>>()?;
        let mut whole = parts.remove(0);
        for part in parts {
            if (part.period_s / whole.period_s - 1.0).abs() > SAME_PERIOD_SHARE {
                return Err(DiagnoseError::Periods {
                    first: whole.origin,
                    first_s: whole.period_s,
                    other: part.origin,
                    other_s: part.period_s,
                });
            }
            let (first, other) = (whole.origin.clone(), part.origin.clone());
            whole.append(part);
            if whole.channels.is_empty() {
                return Err(DiagnoseError::NothingShared { first, other });
            }
        }
        if whole.steps < MIN_STEPS {
            let (origin, steps) = (whole.origin, whole.steps);
            return Err(DiagnoseError::TooShort { origin, steps, least: MIN_STEPS });
        }
        whole.begin_anew();
        Ok(whole)
    }

    /// Marks the first samples of every record after the first as early: a noise model must not take one record for the past
    /// of the next.
    fn begin_anew(&mut self) {
        for channel in &mut self.channels {
            let begins: Vec<usize> = channel.begins(&self.starts).skip(1).collect();
            for from in begins {
                for k in from..(from + MAX_AR_ORDER).min(channel.good.len()) {
                    if std::mem::take(&mut channel.good[k]) {
                        channel.early.push(k);
                    }
                }
            }
        }
    }

    /// Appends another record, without as many of its first steps as align most sensors with their sampling
    /// steps; samples of the other sensors do not count. Of a sensor that is slower in one of the two, as many
    /// samples are taken from both, so that one noise model describes it.
    fn append(&mut self, mut other: Self) {
        self.channels.retain(|c| other.channels.iter().any(|o| o.output == c.output));
        other.channels.retain(|o| self.channels.iter().any(|c| o.output == c.output));
        for (own, theirs) in self.channels.iter_mut().zip(&mut other.channels) {
            let stride = own.stride.max(theirs.stride);
            own.slow_down_to(stride);
            theirs.slow_down_to(stride);
        }
        let goes_on = |own: &Channel, theirs: &Channel, lead: usize| {
            (self.steps + theirs.first) % own.stride == (own.first + lead) % own.stride
        };
        let both = || self.channels.iter().zip(&other.channels);
        let going_on = |lead: usize| both().filter(|(own, theirs)| goes_on(own, theirs, lead)).count();
        let round = self.channels.iter().map(|c| c.stride).product::<usize>();
        // The first of equally good alignments.
        let leads = (0..round.min(other.steps / MOST_LEAD)).rev();
        let lead = leads.max_by_key(|lead| going_on(*lead)).unwrap_or(0);
        let aligned: Vec<bool> = both().map(|(own, theirs)| goes_on(own, theirs, lead)).collect();
        other.drop_first(lead);
        self.starts.push(self.steps);
        self.clocks.extend(other.clocks);
        for ((own, theirs), aligned) in self.channels.iter_mut().zip(other.channels).zip(aligned) {
            let from = (self.steps + theirs.first).saturating_sub(own.first) / own.stride;
            own.values.resize(from, f64::NAN);
            own.good.resize(from, false);
            own.values.extend(theirs.values);
            own.good.extend(theirs.good.into_iter().map(|good| good && aligned));
        }
        self.inputs.extend(other.inputs);
        self.steps += other.steps;
        // Parts of one record have one name.
        if !self.origin.split(", ").any(|name| name == other.origin) {
            self.origin = format!("{}, {}", self.origin, other.origin);
        }
    }

    fn drop_first(&mut self, steps: usize) {
        self.steps -= steps;
        self.inputs.drain(..steps * self.m);
        self.clocks.iter_mut().for_each(|clock| *clock += steps as u64);
        for channel in &mut self.channels {
            let gone = steps.saturating_sub(channel.first).div_ceil(channel.stride);
            channel.values.drain(..gone.min(channel.values.len()));
            channel.good.drain(..gone.min(channel.good.len()));
            channel.first = channel.first + gone * channel.stride - steps;
        }
    }
}

impl Channel {
    /// Keeps the samples of every `stride` steps, from the step on that finds most new values: one that repeats its
    /// predecessor was measured before.
    fn slow_down_to(&mut self, stride: usize) {
        if stride <= self.stride {
            return;
        }
        let end = self.first + self.values.len() * self.stride;
        let sample = |step: usize| self.sample_at(step);
        let is_new = |k: usize| self.good[k] && (k == 0 || self.values[k] != self.values[k - 1]);
        let news = |first: &usize| {
            (*first..end).step_by(stride).filter(|step| sample(*step).is_some_and(is_new)).count()
        };
        // The first of equally good ones.
        let Some(first) = (0..stride.min(end)).rev().max_by_key(news) else { return };
        let kept: Vec<Option<usize>> = (first..end).step_by(stride).map(sample).collect();
        let (values, good) =
            kept.iter().map(|k| k.map_or((f64::NAN, false), |k| (self.values[k], self.good[k]))).unzip();
        (self.values, self.good, self.first, self.stride) = (values, good, first, stride);
    }
}

/// The parts of a record between the gaps that cannot be bridged; the record itself when it has none. A part
/// counts when it determines more than an initial state.
fn unbroken<'r>(record: &'r Record, vehicle: &Vehicle, period_s: Option<f64>) -> Vec<Cow<'r, Record>> {
    let steps: Vec<f64> = record.time.windows(2).map(|w| w[1] - w[0]).collect();
    let usual = whirlstand_logs::stats::median(&steps);
    if usual <= 0.0 {
        return vec![Cow::Borrowed(record)];
    }
    let longest = bridged_s(record, vehicle, usual);
    let gaps = steps.iter().enumerate().filter(|(_, d)| **d > longest).map(|(k, _)| k + 1);
    let mut cuts: Vec<usize> = std::iter::once(0).chain(gaps).collect();
    cuts.push(record.time.len());
    // Steps of the prediction, which may be longer than those of the record.
    let least_s = MIN_PART_STEPS as f64 * period_s.unwrap_or(usual).max(usual);
    let lasts = |c: &[usize]| record.time[c[1] - 1] - record.time[c[0]] >= least_s;
    let long: Vec<&[usize]> = cuts.windows(2).filter(|c| lasts(c)).collect();
    if cuts.len() == 2 || long.is_empty() {
        return vec![Cow::Borrowed(record)];
    }
    let part = |c: &&[usize]| Cow::Owned(record.between(record.time[c[0]], record.time[c[1] - 1]));
    long.iter().map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 100 steps of an axis, from a time on: the rate in every step from `late` on, the angle in every third from `phase` on.
    fn part(from_s: f64, late: usize, phase: usize) -> Record {
        let known = |k: usize, is: bool| if is { k as f64 } else { f64::NAN };
        let mut record = Record::new("axis", (0..100).map(|k| from_s + 0.01 * k as f64).collect()).unwrap();
        record.push("u", "", vec![0.5; 100]).unwrap();
        record.push("rate", "rad/s", (0..100).map(|k| known(k, k >= late)).collect()).unwrap();
        record.push("roll", "rad", (0..100).map(|k| known(k, k % 3 == phase)).collect()).unwrap();
        record
    }

    /// 45 samples are enough steps of the record, and too few of the prediction.
    #[test]
    fn a_part_between_two_gaps_is_counted_in_steps_of_the_prediction() {
        let text = "name = 'axis'\nA = [[-1.0]]\nB = [[1.0]]\ninputs = [{ name = 'u' }]\n\
                    states = [{ name = 'roll', unit = 'rad' }]\noutputs = [{ name = 'roll', unit = 'rad' }]\n";
        let vehicle = Vehicle::parse(text, "axis.toml").unwrap();
        let times = [(0.0, 1000), (3.0, 45), (5.0, 1000)].into_iter();
        let times: Vec<f64> =
            times.flat_map(|(t, n)| (0..n).map(move |k| t + 0.002 * f64::from(k))).collect();
        let steps = times.len();
        let mut record = Record::new("axis", times).unwrap();
        record.push("u", "", (0..steps).map(|k| (k as f64 * 0.01).sin()).collect()).unwrap();
        record.push("roll", "rad", (0..steps).map(|k| (k as f64 * 0.01).cos()).collect()).unwrap();
        let parts = |period_s| Data::join(&[record.clone()], &vehicle, period_s).unwrap().starts.len();
        assert_eq!((parts(None), parts(Some(0.006))), (3, 2));
        assert_eq!(Data::join(&[record.clone()], &vehicle, None).unwrap().origin, "axis");
    }

    /// The median of a jitter is another in each part.
    #[test]
    fn parts_of_one_record_have_one_period() {
        let text = "name = 'axis'\nA = [[-1.0]]\nB = [[1.0]]\ninputs = [{ name = 'u' }]\n\
                    states = [{ name = 'roll', unit = 'rad' }]\noutputs = [{ name = 'roll', unit = 'rad' }]\n";
        let vehicle = Vehicle::parse(text, "axis.toml").unwrap();
        let step = |k: usize| match (k % 400, k < 400, k % 2) {
            (399, ..) => 20.0,
            (_, true, 0) => 0.0099,
            (_, false, 0) => 0.0104,
            _ => 0.0101,
        };
        let times: Vec<f64> = (0..800).map(|k| (0..k).map(step).sum()).collect();
        let mut record = Record::new("axis", times).unwrap();
        record.push("u", "", (0..800).map(|k| (k as f64 * 0.1).sin()).collect()).unwrap();
        record.push("roll", "rad", (0..800).map(|k| (k as f64 * 0.1).cos()).collect()).unwrap();
        let data = Data::join(&[record.clone()], &vehicle, None).unwrap();
        assert_eq!((data.starts.len(), data.period_s), (2, record.period().unwrap()));
    }

    #[test]
    fn samples_of_joined_records_stay_at_their_steps() {
        let text = "name = 'axis'\nA = [[0.0, 1.0], [0.0, -1.0]]\nB = [[0.0], [1.0]]\ninputs = [{ name = 'u' }]\n\
                    states = [{ name = 'roll', unit = 'rad' }, { name = 'rate', unit = 'rad/s' }]\n\
                    outputs = [{ name = 'roll', unit = 'rad' }, { name = 'rate', unit = 'rad/s' }]";
        let vehicle = Vehicle::parse(text, "axis.toml").unwrap();
        for (late, phase, other_late, other_phase) in [(1, 0, 0, 0), (0, 0, 2, 1), (4, 2, 1, 0), (0, 1, 0, 2)]
        {
            let records = [part(0.0, late, phase), part(10.0, other_late, other_phase)];
            let data = Data::join(&records, &vehicle, None).unwrap();
            let begin = data.starts[1];
            let lead = data.clocks[1] as usize;
            assert!(lead < 3 && data.steps > 190, "{data:?}");
            for channel in &data.channels {
                assert!(channel.step(channel.values.len() - 1) < data.steps, "{channel:?}");
                let seen: Vec<usize> =
                    (0..data.steps).filter(|k| channel.measured_at(*k).is_some()).collect();
                assert!(seen.len() * channel.stride > 100, "{late} {phase}: {}", seen.len());
                for k in seen {
                    // Every value is the number of its step in its record.
                    let own = if k < begin { k } else { k - begin + lead };
                    assert_eq!(channel.measured_at(k), Some(own as f64), "{late} {phase}, step {k}");
                }
            }
        }
    }
    /// A sensor that is found to be slower in one part than in the other is used in both.
    #[test]
    fn a_sensor_of_two_rates_is_taken_at_the_slower_one() {
        let text = "name = 'axis'\nA = [[-1.0]]\nB = [[1.0]]\ninputs = [{ name = 'u' }]\n\
                    states = [{ name = 'roll', unit = 'rad' }]\noutputs = [{ name = 'roll', unit = 'rad' }]\n";
        let vehicle = Vehicle::parse(text, "axis.toml").unwrap();
        // A new value every `every` steps from `phase` on, repeated until the next where it is held.
        let part = |from_s: f64, every: usize, phase: usize, held: bool| {
            let times = (0..600).map(|k| from_s + 0.01 * f64::from(k)).collect();
            let mut record = Record::new("axis", times).unwrap();
            record.push("u", "", vec![0.5; 600]).unwrap();
            let value = |k: usize| match k.checked_sub(phase).map(|since| since % every) {
                Some(0) => k as f64,
                Some(since) if held => (k - since) as f64,
                _ => f64::NAN,
            };
            record.push("roll", "rad", (0..600).map(value).collect()).unwrap();
            record
        };
        let cases =
            [((1, 0, false), (3, 1, false)), ((4, 3, false), (1, 0, false)), ((2, 1, true), (6, 4, false))];
        for ((every, phase, held), (other_every, other_phase, other_held)) in cases {
            let records = [part(0.0, every, phase, held), part(10.0, other_every, other_phase, other_held)];
            let data = Data::join(&records, &vehicle, None).unwrap();
            let [channel] = &data.channels[..] else { panic!("{data:?}") };
            assert_eq!(channel.stride, every.max(other_every));
            let (begin, lead) = (data.starts[1], data.clocks[1] as usize);
            let seen: Vec<usize> = (0..data.steps).filter(|k| channel.measured_at(*k).is_some()).collect();
            assert!(seen.len() * channel.stride > 1000, "{seen:?}");
            for k in seen {
                let own = if k < begin { k } else { k - begin + lead };
                assert_eq!(channel.measured_at(k), Some(own as f64), "{every} {other_every}, step {k}");
            }
        }
    }

    /// Records of different outputs are refused in a sentence.
    #[test]
    fn records_without_an_output_in_common_are_refused() {
        let text = "name = 'axis'\nA = [[0.0, 1.0], [0.0, -1.0]]\nB = [[0.0], [1.0]]\ninputs = [{ name = 'u' }]\n\
                    states = [{ name = 'roll', unit = 'rad' }, { name = 'rate', unit = 'rad/s' }]\n\
                    outputs = [{ name = 'roll', unit = 'rad' }, { name = 'rate', unit = 'rad/s' }]";
        let vehicle = Vehicle::parse(text, "axis.toml").unwrap();
        let only = |name: &str| {
            let mut record = Record::new(name, (0..100).map(|k| 0.01 * f64::from(k)).collect()).unwrap();
            record.push("u", "", vec![0.5; 100]).unwrap();
            record.push(name, "", (0..100).map(f64::from).collect()).unwrap();
            record
        };
        let told = Data::join(&[only("roll"), only("rate")], &vehicle, None).unwrap_err().to_string();
        assert!(told.starts_with("roll and rate have no output in common"), "{told}");
    }
}
