//! Expectations of a run (upper limits on its figures), and whether they hold.

use serde::Serialize;
use whirlstand_msgs::units::{ShownUnit, Unit, two_readings};
use whirlstand_vehicle::{SignalUnit, Vehicle};

use crate::metrics::Timing;
use crate::summary::{Figure, INPUT_KEYS, OUTPUT_KEYS, RunSummary};

/// Keys of counts and times of the whole bench that can be limited, with their SI unit.
pub const BENCH_LIMITS: [(&str, &str); 11] = [
    ("max_deadline_misses", ""),
    ("max_disarmed_share", ""),
    ("max_failsafe_at_end", ""),
    ("max_failsafe_share", ""),
    ("max_latency_p99_s", "s"),
    ("max_latency_s", "s"),
    ("max_lost", ""),
    ("max_pilot_share", ""),
    ("max_refused_commands", ""),
    ("max_rejected", ""),
    ("max_restarts", ""),
];

/// Greatest share of the steps in failsafe of a realtime run that does not state its own. An operating system
/// without real-time scheduling sometimes takes the processor away for longer than the misses that lead to the
/// failsafe.
const REALTIME_FAILSAFE_SHARE: f64 = 0.01;

/// The limits that apply to every run, whether stated or not: a run that violates one was not controlled.
/// `realtime` is true when the wall clock sets the pace.
pub fn strict_limits(realtime: bool) -> [Expectation; 5] {
    let failsafe_share = if realtime { REALTIME_FAILSAFE_SHARE } else { 0.0 };
    let limit = |key: &str, limit: f64| Expectation { key: key.into(), limit, unit: ShownUnit::default() };
    [
        limit("max_failsafe_share", failsafe_share),
        limit("max_failsafe_at_end", 0.0),
        limit("max_refused_commands", 0.0),
        limit("max_rejected", 0.0),
        limit("max_restarts", 0.0),
    ]
}

/// The additional limits for every run with a bridge: a run in which nobody or the pilot was in charge shows
/// nothing of the controller.
pub fn strict_bridge_limits() -> [Expectation; 2] {
    ["max_disarmed_share", "max_pilot_share"].map(|key| Expectation {
        key: key.into(),
        limit: 0.0,
        unit: ShownUnit::default(),
    })
}

/// One figure that must not be greater than its limit.
#[derive(Debug, Clone, PartialEq)]
pub struct Expectation {
    /// One of [`BENCH_LIMITS`], or a figure of a signal, for example `roll.peak`.
    pub key: String,
    /// Upper limit, SI.
    pub limit: f64,
    /// SI unit of the limit.
    pub unit: ShownUnit,
}

/// An expectation with the figure that was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckedExpectation {
    /// Key as in [`Expectation::key`].
    pub key: String,
    /// The limit, SI.
    pub limit: f64,
    /// The figure, SI; null when it has no value or was not measured.
    pub found: Option<f64>,
    /// SI unit of `limit` and `found`.
    pub unit: ShownUnit,
    /// Whether the expectation holds.
    pub holds: bool,
    /// Why the expectation does not hold; `None` when it holds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

/// The figures that an output or input of the vehicle has, and the unit of each; `None` for a name that is neither.
pub fn signal_figures(vehicle: &Vehicle, name: &str) -> Option<Vec<(&'static str, FigureUnit)>> {
    let output = vehicle.output_index(name).map(|i| (&vehicle.outputs[i].unit, &OUTPUT_KEYS[..]));
    let input = || vehicle.input_index(name).map(|i| (&vehicle.inputs[i].unit, &INPUT_KEYS[..]));
    let (unit, figures) = output.or_else(input)?;
    Some(figures.iter().map(|figure| (*figure, FigureUnit::of(figure, unit))).collect())
}

/// The unit of a figure of a signal, derived from the units in the vehicle file.
#[derive(Debug, Clone, PartialEq)]
pub struct FigureUnit {
    /// The unit.
    pub unit: Unit,
    /// The signal's own unit, for a figure that is measured in it.
    signal: Option<SignalUnit>,
    /// The unit in which values are shown.
    shown: ShownUnit,
}

impl FigureUnit {
    /// See the keys in [`crate::summary`].
    fn of(figure: &str, signal: &SignalUnit) -> Self {
        let own = signal.unit();
        let unit = match figure {
            "recovery_s" | "rise_s" | "settling_s" => Some(Unit::SECOND),
            "overshoot_percent" | "saturated" => Some(Unit::ONE),
            "iae" => own.times(&Unit::SECOND, 1),
            "ise" => own.times(own, 1).and_then(|square| square.times(&Unit::SECOND, 1)),
            "travel_per_s" => own.times(&Unit::SECOND, -1),
            _ => return Self { unit: *own, signal: Some(signal.clone()), shown: signal.shown() },
        };
        // The exponents of real units are far inside their range.
        let unit = unit.unwrap_or(*own);
        Self { unit, signal: None, shown: derived(figure, &signal.shown(), &unit) }
    }

    /// The unit in which values are shown: derived from the declared unit, or the SI unit.
    pub fn shown(&self) -> ShownUnit {
        self.shown.clone()
    }

    /// Text on the two readings of a number without a unit; `None` where the number is unambiguous.
    pub fn two_readings(&self, value: f64) -> Option<String> {
        match &self.signal {
            Some(signal) => signal.two_readings(value),
            None => two_readings(value, &self.unit, None),
        }
    }
}

/// Checks the expectations of a run. `timing` holds the figures of the whole bench, `figures` those of its log, if it
/// has one. An expectation of a figure that was not measured does not hold.
pub fn check(
    expectations: &[Expectation],
    timing: &Timing,
    figures: Option<&RunSummary>,
) -> Vec<CheckedExpectation> {
    expectations.iter().map(|e| checked(e, figure(&e.key, timing, figures))).collect()
}

fn figure(key: &str, timing: &Timing, figures: Option<&RunSummary>) -> Option<Figure> {
    let plant = timing.nodes.get("plant").and_then(|p| p.latency);
    match key {
        "max_deadline_misses" => Some(Figure::Value(timing.deadline_misses as f64)),
        "max_lost" => Some(Figure::Value(timing.lost as f64)),
        "max_restarts" => Some(Figure::Value(timing.restarts as f64)),
        "max_failsafe_share" => Some(Figure::Value(timing.failsafe_share)),
        "max_failsafe_at_end" => Some(Figure::Value(timing.failsafe_at_end as f64)),
        "max_disarmed_share" => timing.disarmed_share.map(Figure::Value),
        "max_pilot_share" => timing.pilot_share.map(Figure::Value),
        "max_refused_commands" => Some(Figure::Value(rejected(timing, |node| node == "plant"))),
        "max_rejected" => Some(Figure::Value(rejected(timing, |node| node != "plant"))),
        "max_latency_p99_s" => plant.map(|l| Figure::Value(l.p99_us * 1e-6)),
        "max_latency_s" => plant.map(|l| Figure::Value(l.max_us * 1e-6)),
        key => figures?.figure(key),
    }
}

/// Number of messages that the nodes chosen by name refused.
fn rejected(timing: &Timing, of: impl Fn(&str) -> bool) -> f64 {
    timing.nodes.iter().filter(|(node, _)| of(node)).map(|(_, n)| n.rejected).sum::<u64>() as f64
}

fn checked(e: &Expectation, figure: Option<Figure>) -> CheckedExpectation {
    let in_words = |value: f64| match e.unit.symbol().is_empty() && value.fract() == 0.0 {
        true => format!("{value}"),
        false => e.unit.text(value),
    };
    let limit = || in_words(e.limit);
    let (found, why) = match figure {
        Some(Figure::Value(value)) if value <= e.limit => (Some(value), None),
        Some(Figure::Value(value)) => {
            (Some(value), Some(format!("{} is {}, above the limit {}", e.key, in_words(value), limit())))
        }
        Some(Figure::Never) => (None, Some(format!("{} was never reached, the limit is {}", e.key, limit()))),
        Some(Figure::NoEvent) | None => (None, Some(format!("{} was not measured in this run", e.key))),
    };
    CheckedExpectation {
        key: e.key.clone(),
        limit: e.limit,
        found,
        unit: e.unit.clone(),
        holds: why.is_none(),
        why,
    }
}

/// The unit in which a figure derived from a signal is shown: based on the signal's unit where a symbol for the
/// result can be written, else `unit`.
fn derived(figure: &str, signal: &ShownUnit, unit: &Unit) -> ShownUnit {
    let si = unit.si_symbol();
    if unit.is_si() {
        return ShownUnit::si(&si);
    }
    // A second after a slash would be in the denominator as well.
    let (symbol, rate_of) = (signal.symbol(), signal.symbol().strip_suffix("/s"));
    let symbol = match (figure, rate_of) {
        ("iae", Some(of)) => of.into(),
        ("iae", None) => format!("{symbol}*s"),
        ("ise", Some(of)) => format!("{of}^2/s"),
        ("ise", None) => format!("{symbol}^2*s"),
        _ => signal.per_second().symbol().into(),
    };
    let reads_back = symbol.parse::<Unit>().is_ok_and(|read| {
        read.dimension() == unit.dimension() && (read.factor() / unit.factor() - 1.0).abs() < 1e-12
    });
    if reads_back { ShownUnit::named(&si, &symbol) } else { ShownUnit::of(&si) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expectation(key: &str, limit: f64, unit: &str) -> Expectation {
        Expectation { key: key.into(), limit, unit: ShownUnit::of(unit) }
    }

    #[test]
    fn what_was_not_measured_or_never_came_does_not_hold() {
        let peak = expectation("roll.peak", 1.0, "rad");
        for (figure, found, words) in [
            (Some(Figure::Value(1.5)), Some(1.5), "roll.peak is 85.9 deg, above the limit 57.3 deg"),
            (Some(Figure::Never), None, "roll.peak was never reached, the limit is 57.3 deg"),
            (Some(Figure::NoEvent), None, "roll.peak was not measured in this run"),
            (None, None, "roll.peak was not measured in this run"),
        ] {
            let checked = checked(&peak, figure);
            assert_eq!((checked.holds, checked.found, checked.why.as_deref()), (false, found, Some(words)));
        }
        let met = checked(&peak, Some(Figure::Value(1.0)));
        assert_eq!((met.holds, met.found, met.why), (true, Some(1.0), None));
    }

    #[test]
    fn figures_of_the_bench_need_no_log_and_those_of_signals_do() {
        let expectations = [
            expectation("max_lost", 0.0, ""),
            expectation("max_deadline_misses", 2.0, ""),
            expectation("roll.peak", 1.0, "rad"),
            expectation("max_latency_s", 1.0, "s"),
        ];
        let timing = Timing { deadline_misses: 3, ..Timing::default() };
        let holds: Vec<bool> = check(&expectations, &timing, None).iter().map(|c| c.holds).collect();
        assert_eq!(holds, [true, false, false, false]);
    }

    #[test]
    fn what_shows_that_nobody_controlled_is_told_with_its_value_and_limit() {
        let node = |rejected| crate::metrics::NodeTiming {
            steps: 200,
            deadline_misses: 0,
            lost: 0,
            rejected,
            restarts: 0,
            latency: None,
        };
        let nodes = [("plant", node(3)), ("estimator", node(1)), ("recorder", node(1))];
        let nodes = nodes.map(|(name, node)| (name.to_string(), node)).into();
        let mut timing = Timing { nodes, restarts: 1, ..Timing::default() };
        timing.witness_failsafe(50, 20, 200);
        let whys: Vec<_> =
            check(&strict_limits(true), &timing, None).into_iter().filter_map(|c| c.why).collect();
        assert_eq!(
            whys,
            [
                "max_failsafe_share is 0.250, above the limit 0.0100",
                "max_failsafe_at_end is 20, above the limit 0",
                "max_refused_commands is 3, above the limit 0",
                "max_rejected is 2, above the limit 0",
                "max_restarts is 1, above the limit 0",
            ]
        );
        let calm = Timing::default();
        assert!(check(&strict_limits(false), &calm, None).iter().all(|c| c.holds));
    }

    #[test]
    fn who_was_in_charge_behind_a_bridge_holds_only_where_it_was_measured() {
        let whys = |disarmed_share, pilot_share| {
            let timing = Timing { disarmed_share, pilot_share, ..Timing::default() };
            let all = check(&strict_bridge_limits(), &timing, None);
            all.into_iter().map(|c| c.why.unwrap_or_default()).collect::<Vec<_>>()
        };
        assert_eq!(whys(Some(0.0), Some(0.0)), ["", ""]);
        assert_eq!(
            whys(Some(1.0), Some(0.25)),
            ["max_disarmed_share is 1, above the limit 0", "max_pilot_share is 0.250, above the limit 0"]
        );
        assert_eq!(
            whys(None, None),
            [
                "max_disarmed_share was not measured in this run",
                "max_pilot_share was not measured in this run"
            ]
        );
    }

    #[test]
    fn every_figure_of_a_signal_has_its_unit() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let unit = |signal: &str, figure: &str| {
            let all = signal_figures(&vehicle, signal).unwrap();
            all.into_iter().find(|(name, _)| *name == figure).unwrap().1.unit.si_symbol()
        };
        assert_eq!(unit("roll", "peak"), "rad");
        assert_eq!(unit("roll", "ise"), "rad^2*s");
        assert_eq!(unit("roll_rate", "recovery_s"), "s");
        assert_eq!(unit("roll_rate", "iae"), "rad");
        assert_eq!(unit("roll_rate", "ise"), "rad^2/s");
        assert_eq!(unit("u_roll", "travel_per_s"), "1/s");
        assert_eq!(signal_figures(&vehicle, "yaw"), None);
    }

    #[test]
    fn what_comes_of_a_signal_is_shown_in_its_unit() {
        for (declared, iae, ise, travel) in [
            ("deg", "deg*s", "deg^2*s", "deg/s"),
            ("mrad", "mrad*s", "mrad^2*s", "mrad/s"),
            ("deg/s", "deg", "deg^2/s", "deg/s^2"),
            ("rad", "rad*s", "rad^2*s", "rad/s"),
            ("rad/s", "rad", "rad^2/s", "rad/s^2"),
        ] {
            let signal: SignalUnit = declared.parse().unwrap();
            let shown = ["iae", "ise", "travel_per_s"].map(|figure| FigureUnit::of(figure, &signal).shown());
            assert_eq!(shown.each_ref().map(ShownUnit::symbol), [iae, ise, travel], "{declared}");
        }
    }
}
