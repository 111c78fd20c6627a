//! The part of a record in which a vehicle flies: a log begins and ends on the ground, with the motors off.

use serde::Serialize;
use whirlstand_logs::stats::{mean, rms, white_noise_std};
use whirlstand_logs::{Record, SignalError};

use super::proposal::Chosen;

/// Shortest rest with the motors off that is taken for the ground, s: an experiment may begin with a moment of rest.
const REST_S: f64 = 2.0;
/// Time between the first or last turn of a motor and free flight, s: a small vehicle spools up and lifts off, or touches
/// down and comes to rest, within about a second, and meanwhile the ground moves it.
const CONTACT_S: f64 = 1.0;
/// Share of the motion that an output has while the inputs move, below which it is still. Definition.
const STILL_SHARE: f64 = 0.1;
/// Share of its range within which an input does not change.
const CONSTANT_SHARE: f64 = 1e-3;

/// The part of a record that was used because the vehicle flies in it, s of the record's clock.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Flown {
    /// Start of the part; `None` for that of the record.
    pub from_s: Option<f64>,
    /// End of the part; `None` for that of the record.
    pub to_s: Option<f64>,
}

impl Flown {
    /// Finds the flight between two rests of all inputs and outputs, in which one input at least is at its lowest, as a motor
    /// that is off: what still swings when its motor is off does not stand on the ground. An end that was `chosen` is kept.
    /// `None` where the whole record is used.
    pub fn find(
        record: &Record,
        (inputs, outputs): (&[Chosen], &[Chosen]),
        chosen: (bool, bool),
    ) -> Option<Self> {
        let of = |input: &Chosen| {
            let values = &record.get(&input.name)?.values;
            Some(record.time.iter().copied().zip(values.iter().copied()).filter(|(_, v)| v.is_finite()))
        };
        let forwards: Vec<Rest> = inputs.iter().filter_map(|i| Rest::until(of(i)?.collect())).collect();
        let backwards = inputs.iter().filter_map(|i| {
            let mut samples: Vec<(f64, f64)> = of(i)?.collect();
            samples.reverse();
            Rest::until(samples)
        });
        let backwards: Vec<Rest> = backwards.collect();
        let begins = forwards.iter().map(|r| r.until_s).fold(f64::INFINITY, f64::min);
        let ends = backwards.iter().map(|r| r.until_s).fold(f64::NEG_INFINITY, f64::max);
        let off = |rests: &[Rest]| rests.iter().any(|r| r.is_lowest);
        let (first, last) = (*record.time.first()?, *record.time.last()?);
        let still = |from: f64, to: f64| {
            outputs.iter().all(|output| is_still(record, output, (from, to), (begins, ends)))
        };
        let from_s =
            (!chosen.0 && off(&forwards) && begins - first >= REST_S && still(first, begins - CONTACT_S))
                .then_some(begins + CONTACT_S);
        let to_s = (!chosen.1 && off(&backwards) && last - ends >= REST_S && still(ends + CONTACT_S, last))
            .then_some(ends - CONTACT_S);
        let length = to_s.unwrap_or(last) - from_s.unwrap_or(first);
        (from_s.is_some() || to_s.is_some())
            .then_some(Self { from_s, to_s })
            .filter(|_| length > 0.5 * (ends - begins))
    }

    /// The part in a sentence, as a part of the log with what `identify` and `diagnose` need to use the same.
    pub fn sentence(&self) -> String {
        format!("{}; give identify and diagnose the same", self.in_words())
    }

    fn in_words(&self) -> String {
        let end = |flag: &str, at: Option<f64>| at.map(|at| format!(" --{flag} {at:.2}")).unwrap_or_default();
        format!(
            "the motors are off at the {} of the log, and the ground moves what takes off or lands: used without it, as \
             with{}{}",
            match (self.from_s, self.to_s) {
                (Some(_), Some(_)) => "beginning and end",
                (Some(_), None) => "beginning",
                _ => "end",
            },
            end("from", self.from_s),
            end("to", self.to_s)
        )
    }
}

/// True where an output shows its noise and little of the motion that it has while the inputs move.
fn is_still(record: &Record, output: &Chosen, rest: (f64, f64), moved: (f64, f64)) -> bool {
    let Some(signal) = record.get(&output.name) else { return true };
    let within = |(from, to): (f64, f64)| -> Vec<f64> {
        let at =
            record.time.iter().zip(&signal.values).filter(|(t, v)| (from..=to).contains(*t) && v.is_finite());
        at.map(|(_, v)| *v).collect()
    };
    let spread = |values: &[f64]| {
        let level = mean(values);
        rms(&values.iter().map(|v| v - level).collect::<Vec<_>>())
    };
    let resting = within(rest);
    resting.len() < 2
        || spread(&resting) <= (STILL_SHARE * spread(&within(moved))).max(2.0 * white_noise_std(&resting))
}

/// The part of one of several logs in which the vehicle flies.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlownIn {
    /// Path of the log.
    pub log: String,
    /// The part of it.
    #[serde(flatten)]
    pub part: Flown,
}

impl FlownIn {
    /// The part in a sentence. It is another in each log, which one `--from` cannot say.
    pub fn sentence(&self) -> String {
        format!("{}: {}; cut the log there for identify and diagnose", self.log, self.part.in_words())
    }
}

/// The rest of an input at one end of a record.
struct Rest {
    /// Time of the first change.
    until_s: f64,
    /// True when it rests at the lowest value that it has in the record.
    is_lowest: bool,
}

impl Rest {
    /// The rest with which samples of time and value begin; `None` without samples.
    fn until(samples: Vec<(f64, f64)>) -> Option<Self> {
        let (_, rest) = *samples.first()?;
        let values = || samples.iter().map(|(_, v)| *v);
        let (lowest, highest) =
            (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
        let near = CONSTANT_SHARE * (highest - lowest);
        let until_s = samples.iter().find(|(_, v)| (v - rest).abs() > near)?.0;
        Some(Self { until_s, is_lowest: rest - lowest <= near })
    }
}

/// The record of one flight or of several, and the parts of the logs that they are.
pub struct Flight {
    /// Samples of the parts, those of one log after those of another.
    pub record: Record,
    /// The parts, where they are not the whole logs.
    pub flown: Vec<FlownIn>,
}

impl Flight {
    /// Puts the flights of several logs, of which `signals` are the inputs and the outputs, one after the other, without what lies before take-off and after landing, unless that
    /// end was `chosen`. The pause between two is as long as all flights together: no band of an input reaches
    /// over it, so that no prediction continues from one log into the next. `None` without a log.
    ///
    /// # Errors
    /// When a log lacks a signal of the first.
    pub fn of(
        records: Vec<Record>,
        signals: (&[Chosen], &[Chosen]),
        chosen: (bool, bool),
    ) -> Result<Option<Self>, SignalError> {
        let mut flown = Vec::new();
        let parts = records.into_iter().map(|record| match Flown::find(&record, signals, chosen) {
            Some(part) => {
                flown.push(FlownIn { log: record.origin.clone(), part });
                record.between(part.from_s.unwrap_or(f64::NEG_INFINITY), part.to_s.unwrap_or(f64::INFINITY))
            }
            None => record,
        });
        let parts: Vec<Record> = parts.collect();
        let pause_s = parts.iter().map(Record::duration).sum();
        let joined = parts.into_iter().map(Ok).reduce(|all, next| all?.followed_by(&next?, pause_s));
        Ok(joined.transpose()?.map(|record| Self { record, flown }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 20 s at 100 Hz: off for `before` s and from 18 s on, in between about 0.5.
    fn flight(before: f64, off: f64) -> Record {
        let time: Vec<f64> = (0..2000).map(|k| k as f64 * 0.01).collect();
        let motor = |t: &f64| if *t < before || *t >= 17.0 { off } else { 0.5 + 0.1 * (7.0 * t).sin() };
        let values = time.iter().map(motor).collect();
        let mut record = Record::new("x", time).unwrap();
        record.push("u", "", values).unwrap();
        record
    }

    fn signal(name: &str) -> Chosen {
        Chosen { name: name.into(), source: name.into(), interval_s: None, why: String::new() }
    }

    fn found(record: &Record, chosen: (bool, bool)) -> Option<(Option<f64>, Option<f64>)> {
        let rounded = |at: f64| (at * 10.0).round() / 10.0;
        Flown::find(record, (&[signal("u")], &[signal("y")]), chosen)
            .map(|f| (f.from_s.map(rounded), f.to_s.map(rounded)))
    }

    #[test]
    fn a_flight_lies_between_two_rests_with_the_motors_off() {
        let whole = flight(3.0, 0.0);
        assert_eq!(found(&whole, (false, false)), Some((Some(4.0), Some(16.0))));
        assert_eq!(found(&whole, (true, false)), Some((None, Some(16.0))), "a chosen end stays");
        assert_eq!(found(&whole, (true, true)), None);
        assert_eq!(found(&flight(0.0, 0.0), (false, false)), Some((None, Some(16.0))), "it begins in flight");
        // An experiment that begins and ends with the input in the middle of its range is no flight between two rests.
        assert_eq!(found(&flight(3.0, 0.5), (false, false)), None);
    }

    /// The crane of a stand after a push: most of what its record shows is how it swings when the motor is off.
    #[test]
    fn what_still_swings_with_the_motor_off_is_not_on_the_ground() {
        let with_output = |at: &dyn Fn(f64) -> f64| {
            let mut record = flight(0.0, 0.0);
            let values = record.time.iter().map(|t| at(*t)).collect();
            record.push("y", "", values).unwrap();
            record
        };
        let swinging = with_output(&|t| (6.0 * t).sin() * (-0.01 * t).exp());
        assert_eq!(found(&swinging, (false, false)), None);
        let settled = with_output(&|t| if t < 17.0 { (6.0 * t).sin() } else { 0.01 * (6.0 * t).sin() });
        assert_eq!(found(&settled, (false, false)), Some((None, Some(16.0))));
    }

    #[test]
    fn several_flights_follow_each_other_without_the_ground_between_them() {
        let records = vec![flight(3.0, 0.0), flight(0.0, 0.5), flight(0.0, 0.0)];
        let all = Flight::of(records, (&[signal("u")], &[]), (false, false)).unwrap().unwrap();
        // 12 s of the first, all 20 s of the second, 16 s of the third, and pauses as long as all of them.
        assert!((all.record.duration() - 3.0 * 48.0).abs() < 0.1, "{}", all.record.duration());
        let parts: Vec<(bool, bool)> =
            all.flown.iter().map(|f| (f.part.from_s.is_some(), f.part.to_s.is_some())).collect();
        assert_eq!(parts, [(true, true), (false, true)]);
        assert!(
            all.flown[0].sentence().contains("x: the motors are off at the beginning and end"),
            "{}",
            all.flown[0].sentence()
        );
        assert!(Flight::of(Vec::new(), (&[], &[]), (false, false)).unwrap().is_none());
    }
}
