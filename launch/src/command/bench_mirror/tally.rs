//! Statistics over all flights of the measurement.

use serde::Serialize;
use whirlstand_campaign::Proportion;
use whirlstand_logs::stats;

use super::trial::{Clean, NAMED_S, Trial};

/// Largest bound on the detection delay for which a right name is required, s: half of the time is left for
/// the name.
const SUFFICIENT_S: f64 = 0.5 * NAMED_S;

/// Goals: least share of right names among the flights with sufficient information, largest share of wrong names
/// among all flights, most false alarms per hour.
const LEAST_RIGHT: f64 = 0.9;
const MOST_WRONG: f64 = 0.02;
const MOST_FALSE_PER_H: f64 = 0.1;

/// Goals: largest share of a core at 1 kHz, and the time per step that it allows, us.
const MOST_CPU: f64 = 0.2;

/// All results of one call.
#[derive(Debug, Serialize)]
pub(super) struct Tally {
    /// `whirlstand.bench-mirror.v1`.
    pub schema: &'static str,
    /// The command line that repeats this measurement.
    pub call: String,
    /// Results of each effect, and of all effects together in the last row.
    pub effects: Vec<Row>,
    /// Results of the flights without an effect.
    pub clean: Option<CleanRow>,
    /// The goals and whether they are met.
    pub goals: Vec<Goal>,
    /// Every flight with an effect.
    pub trials: Vec<Trial>,
    /// Every clean flight.
    pub clean_flights: Vec<Clean>,
}

/// Results of the flights with one effect.
#[derive(Debug, Serialize)]
pub(super) struct Row {
    /// Name of the effect, one of the twelve.
    pub effect: String,
    /// Number of flights.
    pub flights: u64,
    /// Flights in which the change was detected after its onset.
    pub detected: u64,
    /// Flights with an alarm before the onset.
    pub false_before: u64,
    /// Flights with sufficient information: their bound on the delay leaves half of the time for a name.
    pub sufficient: u64,
    /// Share of right names 10 s after the onset among the flights with sufficient information.
    pub right: Proportion,
    /// Share of wrong names 10 s after the onset among all flights.
    pub wrong: Proportion,
    /// Share of all flights in which a wrong name was given at any time.
    pub wrong_ever: Proportion,
    /// Number of flights without a name 10 s after the onset.
    pub unnamed: u64,
    /// Median time from the onset to the alarm, s.
    pub delay_s: Option<f64>,
    /// Median of the lower bound on the detection delay, s.
    pub bound_s: Option<f64>,
    /// Median information per second.
    pub information_per_s: Option<f64>,
    /// Median time from the onset to the right name, s.
    pub named_s: Option<f64>,
}

/// Results of the clean flights.
#[derive(Debug, Serialize)]
pub(super) struct CleanRow {
    /// Time flown, h.
    pub hours: f64,
    /// Number of false alarms.
    pub alarms: u64,
    /// False alarms per hour, with the exact interval of a Poisson count (95 %).
    pub per_h: f64,
    pub low_per_h: f64,
    pub high_per_h: f64,
    /// Time that the mirror took per step, us.
    pub step_us: f64,
}

/// A goal of the measurement.
#[derive(Debug, Serialize)]
pub(super) struct Goal {
    /// The goal in words.
    pub goal: String,
    /// The measured value.
    pub value: f64,
    /// Whether the goal is met.
    pub met: bool,
}

/// Median of the values; `None` where there are none.
fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.collect();
    (!values.is_empty()).then(|| stats::median(&values))
}

impl Row {
    fn new(effect: &str, trials: &[&Trial]) -> Self {
        let count = |what: &dyn Fn(&&&Trial) -> bool| trials.iter().filter(what).count() as u64;
        let of = trials.len() as u64;
        let suffices = |t: &Trial| t.bound_s.is_some_and(|b| b <= SUFFICIENT_S);
        let sufficient = count(&|t| suffices(t));
        let right = |t: &Trial| t.right == Some(true);
        Self {
            effect: effect.into(),
            flights: of,
            detected: count(&|t| t.detected_s.is_some()),
            false_before: count(&|t| t.false_before),
            sufficient,
            right: Proportion::new(count(&|t| suffices(t) && right(t)), sufficient),
            wrong: Proportion::new(count(&|t| t.right == Some(false)), of),
            wrong_ever: Proportion::new(count(&|t| t.wrong_ever), of),
            unnamed: count(&|t| t.right.is_none()),
            delay_s: median(trials.iter().filter_map(|t| t.bound_s.and(t.detected_s))),
            bound_s: median(trials.iter().filter_map(|t| t.bound_s)),
            information_per_s: median(trials.iter().filter_map(|t| t.information_per_s)),
            named_s: median(trials.iter().filter(|t| right(t)).filter_map(|t| t.named_s)),
        }
    }

    fn line(&self) -> String {
        let number = |v: Option<f64>| v.map_or("-".into(), |v| format!("{v:.2}"));
        let right = format!(
            "{} of {} ({:.0} to {:.0} %)",
            self.right.count,
            self.right.of,
            100.0 * self.right.low,
            100.0 * self.right.high
        );
        format!(
            "{:<22} {:>3} of {:<3} {:>24} {:>6} {:>8} {:>6} {:>8} {:>8} {:>8}\n",
            self.effect,
            self.detected,
            self.flights,
            right,
            self.wrong.count,
            self.wrong_ever.count,
            self.unnamed,
            number(self.delay_s),
            number(self.bound_s),
            number(self.named_s)
        )
    }
}

impl CleanRow {
    fn new(flights: &[Clean], period_s: f64) -> Option<Self> {
        let steps: u64 = flights.iter().map(|f| f.steps).sum();
        let alarms: u64 = flights.iter().map(|f| f.alarms).sum();
        let spent: f64 = flights.iter().map(|f| f.spent_s).sum();
        if steps == 0 {
            return None;
        }
        // With weights of one, the interval of a rare event's share is the exact interval of its count.
        let share = Proportion::weighted(&vec![1.0; alarms as usize], steps, 1.0);
        let steps_per_h = 3600.0 / period_s;
        Some(Self {
            hours: steps as f64 / steps_per_h,
            alarms,
            per_h: alarms as f64 / steps as f64 * steps_per_h,
            low_per_h: share.low * steps_per_h,
            high_per_h: share.high * steps_per_h,
            step_us: 1e6 * spent / steps as f64,
        })
    }

    fn text(&self) -> String {
        format!(
            "clean flight: {} false alarms in {:.2} h, {:.2} per hour (95 %: {:.2} to {:.2}); a step of the mirror \
             takes {:.1} us, {:.1} % of a core at 1 kHz\n",
            self.alarms,
            self.hours,
            self.per_h,
            self.low_per_h,
            self.high_per_h,
            self.step_us,
            0.1 * self.step_us
        )
    }
}

impl Tally {
    /// Computes the statistics; `trials` and clean flights come in the order of their numbers.
    pub fn new(
        call: String,
        names: &[&'static str],
        mut trials: Vec<Trial>,
        mut clean: Vec<Clean>,
        period_s: f64,
    ) -> Self {
        let place = |t: &Trial| names.iter().position(|n| *n == t.what);
        trials.sort_by_key(|t| (place(t), t.number));
        clean.sort_by_key(|c| c.number);
        let of = |name: &str| trials.iter().filter(|t| t.what == name).collect::<Vec<_>>();
        let mut effects: Vec<Row> =
            names.iter().map(|n| Row::new(n, &of(n))).filter(|r| r.flights > 0).collect();
        let mut goals = Vec::new();
        let percent = |v: f64| format!("{:.0} %", 100.0 * v);
        for row in effects.iter().filter(|r| r.sufficient > 0) {
            goals.push(Goal {
                goal: format!("{}: right name within 10 s, at least {}", row.effect, percent(LEAST_RIGHT)),
                value: row.right.share,
                met: row.right.share >= LEAST_RIGHT,
            });
        }
        if !trials.is_empty() {
            let all = Row::new("all", &trials.iter().collect::<Vec<_>>());
            goals.push(Goal {
                goal: format!("wrong name after 10 s, at most {}", percent(MOST_WRONG)),
                value: all.wrong.share,
                met: all.wrong.share <= MOST_WRONG,
            });
            effects.push(all);
        }
        let summed = CleanRow::new(&clean, period_s);
        if let Some(row) = &summed {
            goals.push(Goal {
                goal: format!("false alarms, at most {MOST_FALSE_PER_H} per hour"),
                value: row.per_h,
                met: row.per_h <= MOST_FALSE_PER_H,
            });
            let share = 1e-3 * row.step_us;
            goals.push(Goal {
                goal: format!("share of a core at 1 kHz, at most {}", percent(MOST_CPU)),
                value: share,
                met: share <= MOST_CPU,
            });
        }
        Self {
            schema: "whirlstand.bench-mirror.v1",
            call,
            effects,
            clean: summed,
            goals,
            trials,
            clean_flights: clean,
        }
    }

    /// The table and the goals as text.
    pub fn text(&self) -> String {
        let mut text = format!("{}\n\n", self.call);
        if !self.effects.is_empty() {
            text += &format!(
                "{:<22} {:>10} {:>24} {:>6} {:>8} {:>6} {:>8} {:>8} {:>8}\n",
                "effect",
                "detected",
                "right of sufficient",
                "wrong",
                "on the way",
                "none",
                "delay s",
                "best s",
                "name s"
            );
            self.effects.iter().for_each(|row| text += &row.line());
            text += "\n";
        }
        if let Some(clean) = &self.clean {
            text += &clean.text();
        }
        for goal in self.goals.iter().filter(|g| !g.met) {
            text += &format!("MISSED: {}: {:.3}\n", goal.goal, goal.value);
        }
        if self.goals.iter().all(|g| g.met) {
            text += "all goals are met\n";
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trial(right: Option<bool>, bound_s: f64) -> Trial {
        Trial {
            number: 1,
            what: "lag",
            hidden: String::new(),
            begin_s: 9.0,
            detected_s: Some(0.5),
            bound_s: Some(bound_s),
            information_per_s: Some(40.0),
            false_before: false,
            right,
            wrong_ever: right == Some(false),
            named_s: right.map(|_| 3.0),
            said: Vec::new(),
        }
    }

    #[test]
    fn what_cannot_be_known_in_time_is_not_asked_for_and_a_wrong_name_always_counts() {
        let trials = vec![trial(Some(true), 0.4), trial(None, 6.0), trial(Some(false), 7.0)];
        let tally = Tally::new("call".into(), &["delay", "lag"], trials, Vec::new(), 0.005);
        let row = &tally.effects[0];
        assert_eq!((row.effect.as_str(), row.flights, row.sufficient), ("lag", 3, 1));
        assert_eq!((row.right.count, row.wrong.count, row.unnamed), (1, 1, 1));
        assert_eq!(tally.goals.iter().map(|g| g.met).collect::<Vec<_>>(), [true, false]);
        assert!(tally.text().contains("MISSED: wrong name"), "{}", tally.text());
    }

    #[test]
    fn false_alarms_have_the_exact_interval_of_a_poisson_count() {
        let flight = |alarms| Clean { number: 1, steps: 720_000, alarms, spent_s: 3.6, said: Vec::new() };
        let row = CleanRow::new(&[flight(0), flight(3)], 0.005).unwrap();
        // Garwood 1936: 0.619 to 8.767 for a count of 3.
        assert!((row.hours - 2.0).abs() < 1e-12 && (row.per_h - 1.5).abs() < 1e-12);
        assert!((row.low_per_h - 0.5 * 0.6187).abs() < 1e-3, "{}", row.low_per_h);
        assert!((row.high_per_h - 0.5 * 8.7673).abs() < 1e-3, "{}", row.high_per_h);
        assert!((row.step_us - 5.0).abs() < 1e-9);
        let none = CleanRow::new(&[flight(0)], 0.005).unwrap();
        assert!(none.low_per_h == 0.0 && (none.high_per_h - 3.689).abs() < 1e-3, "{}", none.high_per_h);
    }
}
