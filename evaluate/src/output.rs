//! The figures of one output, from its record while it is read or from a flight in memory.

use crate::metrics::{Judge, Judgement, Part, Recovery, Samples, StepResponse};
use crate::summary::{MOST_LISTED, OutputFigures};
use whirlstand_msgs::units::ShownUnit;

/// The greatest of all values; absent when there is no value, or one of them is absent.
#[derive(Debug, Clone, Copy, Default)]
struct Worst {
    any: bool,
    never: bool,
    greatest: Option<f64>,
}

impl Worst {
    fn take(&mut self, value: Option<f64>) {
        self.any = true;
        self.never |= value.is_none();
        self.greatest = match (self.greatest, value) {
            (Some(a), Some(b)) => Some(a.max(b)),
            (a, b) => a.or(b),
        };
    }

    fn value(&self) -> Option<f64> {
        self.greatest.filter(|_| !self.never)
    }

    /// Whether all events had a value; `None` when there was no event.
    fn all(&self) -> Option<bool> {
        self.any.then_some(!self.never)
    }
}

/// Steps and disturbances of an output.
#[derive(Debug, Clone, Default)]
struct Events {
    steps: Vec<StepResponse>,
    disturbances: Vec<Recovery>,
    not_listed: u64,
    peak: Worst,
    recovery: Worst,
    rise: Worst,
    settling: Worst,
    overshoot: Worst,
}

impl Events {
    /// Takes in a result. An initial error below `visible`, which the sensor could not measure, is not a step.
    fn take(&mut self, judgement: Judgement, visible: f64) {
        match judgement {
            Judgement::Step(step) if (step.to - step.from).abs() > visible => {
                self.rise.take(step.rise_s);
                self.settling.take(step.settling_s);
                self.overshoot.take(Some(step.overshoot_percent));
                self.not_listed += list(&mut self.steps, step);
            }
            Judgement::Step(_) => {}
            Judgement::Disturbance(recovery) => {
                self.peak.take(Some(recovery.peak));
                self.recovery.take(recovery.recovery_s);
                self.not_listed += list(&mut self.disturbances, recovery);
            }
        }
    }
}

/// Appends to a list unless it is full. Returns the number of entries left out: 0 or 1.
fn list<T>(list: &mut Vec<T>, entry: T) -> u64 {
    let full = list.len() >= MOST_LISTED;
    if !full {
        list.push(entry);
    }
    u64::from(full)
}

/// Integrals of the error of one output, in K flights side by side.
#[derive(Debug, Clone)]
pub(crate) struct ErrorSum<const K: usize> {
    iae: [f64; K],
    ise: [f64; K],
    first_s: Option<f64>,
    /// Time and error of the last sample.
    last: Option<(f64, [f64; K])>,
}

impl<const K: usize> ErrorSum<K> {
    pub fn new() -> Self {
        Self { iae: [0.0; K], ise: [0.0; K], first_s: None, last: None }
    }

    /// Takes in the value at time `t`, s, and its reference; NaN where nothing is tracked.
    #[inline(always)]
    pub fn take(&mut self, t: f64, y: &[f64; K], wanted: f64) {
        let wanted = if wanted.is_finite() { wanted } else { 0.0 };
        let error = y.map(|y| wanted - y);
        self.first_s.get_or_insert(t);
        if let Some((before_s, before)) = self.last.replace((t, error)) {
            // The trapezium rule.
            let half = 0.5 * (t - before_s);
            for l in 0..K {
                self.iae[l] += half * (before[l].abs() + error[l].abs());
                self.ise[l] += half * (before[l] * before[l] + error[l] * error[l]);
            }
        }
    }

    /// The sums of flight `l` alone.
    pub fn lane(&self, l: usize) -> ErrorSum<1> {
        ErrorSum {
            iae: [self.iae[l]],
            ise: [self.ise[l]],
            first_s: self.first_s,
            last: self.last.map(|(t, error)| (t, [error[l]])),
        }
    }
}

/// The figures of one output while its record is read.
#[derive(Debug, Clone)]
pub(crate) struct OutputSum {
    /// SI unit.
    unit: ShownUnit,
    /// Name of the evaluated signal.
    source: &'static str,
    tracked: bool,
    visible: f64,
    error: ErrorSum<1>,
    judge: Judge,
    events: Events,
}

impl OutputSum {
    /// An output in `unit` whose sensor declares the standard deviation `noise`, evaluated from `source` in the
    /// given parts.
    pub fn new(unit: ShownUnit, source: &'static str, tracked: bool, noise: f64, parts: Vec<Part>) -> Self {
        Self {
            unit,
            source,
            tracked,
            visible: 5.0 * noise,
            error: ErrorSum::new(),
            judge: Judge::new(parts),
            events: Events::default(),
        }
    }

    /// Takes in the value at time `t`, s, and its reference; NaN where nothing is tracked.
    pub fn take(&mut self, t: f64, y: f64, wanted: f64) {
        self.error.take(t, &[y], wanted);
        let (events, visible) = (&mut self.events, self.visible);
        self.judge.take(t, y, wanted, &mut |judgement| events.take(judgement, visible));
    }

    /// Takes in a whole record at once, with known integrals of its error and with the parts to be evaluated; this
    /// sum was made without parts.
    pub fn take_record(
        &mut self,
        error: ErrorSum<1>,
        (t, y, wanted): (&[f64], &[f64], &[f64]),
        parts: &[Part],
    ) {
        self.error = error;
        let samples = Samples::whole(t, y, wanted);
        for judgement in parts.iter().filter_map(|part| samples.judge(*part)) {
            self.events.take(judgement, self.visible);
        }
    }

    /// The figures.
    pub fn finish(mut self) -> OutputFigures {
        let (events, visible) = (&mut self.events, self.visible);
        self.judge.finish(&mut |judgement| events.take(judgement, visible));
        let ErrorSum { iae: [iae], ise: [ise], first_s, last } = self.error;
        let duration = last.zip(first_s).map_or(0.0, |((last, _), first)| last - first);
        let events = self.events;
        OutputFigures {
            unit: self.unit,
            source: self.source.into(),
            tracked: self.tracked,
            iae,
            ise,
            rms_error: if duration > 0.0 { (ise / duration).sqrt() } else { 0.0 },
            peak: events.peak.value(),
            recovery_s: events.recovery.value(),
            recovered: events.recovery.all(),
            rise_s: events.rise.value(),
            settling_s: events.settling.value(),
            settled: events.settling.all(),
            overshoot_percent: events.overshoot.value(),
            steps: events.steps,
            disturbances: events.disturbances,
            not_listed: events.not_listed,
        }
    }
}
