//! The mirror: prediction, tests, and the search for the cause.

use whirlstand_vehicle::{Effect, Engine, Vehicle};

use crate::bank::Bank;
use crate::capture::Capture;
use crate::error::MirrorError;
use crate::excess;
use crate::finding::{Cause, Finding, Stage};
use crate::known::Knowledge;
use crate::lateness::{HeldInputs, Lateness};
use crate::onsets::Onset;
use crate::predictor::{Predictor, Sample};
use crate::replay::{Belief, predictor};
use crate::rounding::Rounding;
use crate::search::Search;
use crate::verdict::Answer;

/// Mean time between false alarms, s: a hundred hours, so that ten hours of clean flight have none with 90 %
/// probability.
const BETWEEN_FALSE_ALARMS_S: f64 = 360_000.0;

/// Time that is stored before (`KEPT_S`) and after (`LOOKED_AT_S`) a change, s.
const KEPT_S: f64 = 10.0;
const LOOKED_AT_S: f64 = 20.0;

/// Largest number of stored steps, which bounds the memory at any rate.
const MOST_KEPT: usize = 60_000;

/// Settling time of the filter after the first measurement, without tests, in time constants of the fastest
/// pole.
const SETTLING: f64 = 3.0;

/// Length of the data with which a search begins, s, and the factor by which it grows for the next search.
const FIRST_LOOK_S: f64 = 0.5;
const GROWTH: f64 = 0.3;

/// A change has ended when no test has alarmed for this multiple of the time from onset to alarm, plus this
/// number of seconds.
const SILENCE: (f64, f64) = (3.0, 3.0);

/// Options of a mirror.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// State of the engine at the start.
    pub engine: Engine,
    /// Whether a real vehicle is measured, and not a simulation.
    pub real: bool,
    /// Largest number of predictions per step for the search for a cause.
    pub budget: usize,
}

impl Options {
    /// Options for a loop of this period. The budget lets the search use an eighth of a core, at about 0.35
    /// us per prediction.
    pub fn new(engine: Engine, real: bool, period_s: f64) -> Self {
        Self { engine, real, budget: (0.125 * period_s / 0.35e-6) as usize + 1 }
    }
}

/// Factor by which an interval must have narrowed before a value is reported again, which takes ten times the
/// data.
const SHARPER: f64 = 3.0;

/// A detected change.
struct Open {
    number: u64,
    output: usize,
    since: u64,
    /// Number of steps from onset to alarm.
    took: u64,
    last_alarm: u64,
    search: Option<Search>,
    next_look: u64,
    said: Option<Cause>,
}

/// Monitors a vehicle step by step.
pub struct Mirror {
    known: Knowledge,
    predictor: Predictor,
    /// While a change of a real vehicle is open: the predictor that holds the age of the measurements from before
    /// the change. The other one takes the errors of a changed vehicle for those of an age, which shows whether
    /// the link alone has changed, but is no start for a search.
    holding: Option<Predictor>,
    new: Predictor,
    /// Delay line for the inputs of a real vehicle.
    held: Option<HeldInputs>,
    bank: Bank,
    /// Whether the outputs of a real vehicle are rounded.
    rounding: Vec<Rounding>,
    capture: Capture,
    budget: usize,
    /// Mean number of steps between false alarms.
    run_length: f64,
    /// First step that is tested, after settling.
    settled: Option<u64>,
    /// Whether the age of the measurements has ever been known.
    timed: bool,
    next: u64,
    open: Option<Open>,
    changes: u64,
}

impl Mirror {
    /// A mirror of `vehicle`, whose effects include everything that is declared for the flight.
    ///
    /// # Errors
    /// [`MirrorError`] for a vehicle whose states are not detectable from its measurements.
    pub fn new(vehicle: &Vehicle, period_s: f64, options: &Options) -> Result<Self, MirrorError> {
        let known = Knowledge::new(vehicle, period_s, options.engine, options.real)?;
        let predictor = Predictor::new(&known)?;
        let run_length = BETWEEN_FALSE_ALARMS_S / period_s;
        let capacity = (((KEPT_S + LOOKED_AT_S) / period_s) as usize).clamp(64, MOST_KEPT);
        let (p, m) = (known.noise.len(), vehicle.inputs.len());
        Ok(Self {
            bank: Bank::new(&excess::anyway(&known), run_length),
            capture: Capture::new(capacity, p, m, &predictor),
            new: predictor.clone(),
            holding: None,
            rounding: vec![Rounding::default(); if known.real { p } else { 0 }],
            held: known.real.then(|| HeldInputs::new(m, period_s)),
            predictor,
            budget: options.budget,
            run_length,
            settled: None,
            timed: false,
            next: 0,
            open: None,
            changes: 0,
            known,
        })
    }

    /// The vehicle model with which the flight is compared.
    pub fn vehicle(&self) -> &Vehicle {
        &self.known.vehicle
    }

    /// Whitened innovations of the last step.
    pub fn whitened(&self) -> &[f64] {
        self.predictor.whitened()
    }

    /// Restarts the mirror, because the vehicle was restarted or its inputs were unknown for a time.
    pub fn restart(&mut self) {
        self.renew(0.0);
        self.settled = None;
    }

    /// Replaces the predictor by a new one that keeps the measurement age; the inputs are held back by `more`
    /// additional periods.
    fn renew(&mut self, more: f64) {
        let before = std::mem::replace(&mut self.predictor, self.new.clone());
        let before = self.holding.take().unwrap_or(before);
        self.predictor.know_age(&before, more);
    }

    /// Sets the engine state, on which declared vibrations depend.
    pub fn set_engine(&mut self, engine: Engine) {
        self.known.engine = engine;
        if !self.known.real {
            self.predictor.simulator().set_engine(engine);
            self.new.simulator().set_engine(engine);
        }
    }

    /// Processes a step, and returns a finding if there is a new one. Steps must be consecutive; after a gap
    /// the mirror restarts.
    pub fn observe(&mut self, sample: &Sample<'_>) -> Option<Finding> {
        let Some(mut held) = self.held.take() else { return self.look(sample) };
        let found = self.look(&Sample { u: held.hold(sample.u), ..*sample });
        // While a change is open the delay is kept, since the change affects the estimated age.
        let lateness = self.predictor.lateness().filter(|_| self.open.is_none());
        let amiss = lateness.map_or(0.0, Lateness::amiss);
        let more = if amiss == 0.0 { 0.0 } else { held.hold_more(amiss) };
        if more != 0.0 {
            self.renew(more);
            self.settled = None;
        }
        self.held = Some(held);
        found
    }

    fn look(&mut self, sample: &Sample<'_>) -> Option<Finding> {
        let begins = self.settled.is_none() || sample.step != self.next;
        if begins {
            self.begin(sample.step);
        }
        self.next = sample.step + 1;
        self.notice_rounding(sample);
        let kept = self.capture.push(sample, self.holding.as_ref().unwrap_or(&self.predictor));
        self.predictor.step(sample);
        if let Some(holding) = &mut self.holding {
            holding.step(sample);
        }
        if kept {
            self.capture.complete(self.holding.as_ref().unwrap_or(&self.predictor));
        }
        if self.settled.is_none_or(|from| sample.step < from) {
            return None;
        }
        self.timed |= self.predictor.lateness().is_none_or(Lateness::is_known);
        if !self.timed {
            return None;
        }
        let whitened = self.predictor.whitened();
        if let Some(alarm) = self.bank.step(sample.step, whitened, sample.y, sample.fresh) {
            self.bank.restart(sample.step + 1);
            match &mut self.open {
                Some(open) => open.last_alarm = sample.step,
                None => return Some(self.alarmed(sample.step, alarm.since, alarm.output)),
            }
        }
        self.pursue(sample.step)
    }

    fn notice_rounding(&mut self, sample: &Sample<'_>) {
        for (output, rounding) in self.rounding.iter_mut().enumerate() {
            let rounded = &mut self.known.rounded[output];
            if *rounded || sample.fresh >> output & 1 == 0 {
                continue;
            }
            *rounded = rounding.is_rounded(sample.y[output], self.known.noise[output]);
            if *rounded {
                self.bank.expect_repeats(output);
            }
        }
    }

    /// Log-likelihood ratio of an effect with onset at `since`, for each step since then. `None` when the vehicle
    /// cannot have the effect, or the step is no longer stored.
    pub fn evidence_of(&self, effect: &Effect, since: u64) -> Option<Vec<f64>> {
        let kept = self.capture.first()..self.capture.next();
        let effect = kept.contains(&since).then_some(effect)?.clone();
        let belief = Belief { effect, since, stood: None };
        let mut other = predictor(&self.known, &self.predictor, &self.capture, &belief)?;
        let squares = |e: &[f64]| e.iter().map(|v| v * v).sum::<f64>();
        let mut sum = 0.0;
        let after = (since..self.capture.next()).map(|step| {
            other.step_by(&self.capture.sample(step), self.capture.gains(step));
            sum += 0.5 * (squares(self.capture.whitened(step)) - squares(other.whitened()));
            sum
        });
        Some(after.collect())
    }

    fn begin(&mut self, step: u64) {
        if self.settled.is_some() {
            self.renew(0.0);
        }
        self.predictor.simulator().begin_at(step);
        let settling = (SETTLING * self.known.fastest_s / self.known.period_s) as u64;
        let settled = step + settling.max(16);
        self.settled = Some(settled);
        self.bank.restart(step);
        self.capture.restart(step);
        if let Some(open) = &mut self.open {
            // The captured steps are lost; later steps show whether the change persists.
            open.search = None;
            self.holding =
                self.predictor.lateness().map(Lateness::age).and_then(|a| self.predictor.holding(a));
            self.capture.hold(step);
            (open.since, open.last_alarm) = (step, settled);
            open.next_look = settled + (FIRST_LOOK_S / self.known.period_s) as u64;
        }
    }

    fn steps(&self, seconds: f64) -> u64 {
        (seconds / self.known.period_s) as u64
    }

    fn alarmed(&mut self, step: u64, since: u64, output: usize) -> Finding {
        self.changes += 1;
        let since = since.max(self.capture.first() + 1).min(step);
        self.capture.hold(since.saturating_sub(self.steps(KEPT_S)));
        self.holding = self.predictor.holding(self.capture.age(since));
        self.open = Some(Open {
            number: self.changes,
            output,
            since,
            took: step - since,
            last_alarm: step,
            search: None,
            next_look: step.max(since + self.steps(FIRST_LOOK_S)),
            said: None,
        });
        Finding { number: self.changes, stage: Stage::Wrong, step, since, output, evidence: 0.0, cause: None }
    }

    /// Continues the search for the cause of a change, and checks whether the change has ended.
    fn pursue(&mut self, step: u64) -> Option<Finding> {
        let open = self.open.as_mut()?;
        let silence = (SILENCE.0 * open.took as f64) as u64 + (SILENCE.1 / self.known.period_s) as u64;
        if step > open.last_alarm + silence {
            let (number, since, output) = (open.number, open.since, open.output);
            self.open = None;
            self.holding = None;
            self.capture.restart(step + 1);
            return Some(Finding {
                number,
                stage: Stage::Over,
                step,
                since,
                output,
                evidence: 0.0,
                cause: None,
            });
        }
        self.extend_search()?;
        let open = self.open.as_mut()?;
        let search = open.search.as_mut()?;
        let like = self.holding.as_ref().unwrap_or(&self.predictor);
        let answer = search.work(&self.known, like, &self.capture, self.budget)?;
        let seen = search.end() - open.since;
        open.next_look = step.max(search.end() + (GROWTH * seen as f64) as u64);
        let finding = |stage, since, evidence, cause| Finding {
            number: open.number,
            stage,
            step,
            since,
            output: open.output,
            evidence,
            cause,
        };
        match answer {
            Answer::Cause(cause, since, evidence) => {
                let stage = match &open.said {
                    None => Stage::Named,
                    Some(before) if is_same(before, &cause) => return None,
                    Some(_) => Stage::Revised,
                };
                let finding = finding(stage, since, evidence, Some((*cause).clone()));
                open.said = Some(*cause);
                Some(finding)
            }
            Answer::Unexplained => {
                open.said.take()?;
                Some(finding(Stage::Withdrawn, open.since, 0.0, None))
            }
            Answer::Open => None,
        }
    }

    /// Begins the search for the cause of the open change, or extends it to later data once these are due; `None` while they
    /// are not.
    fn extend_search(&mut self) -> Option<()> {
        let open = self.open.as_mut()?;
        if open.search.as_ref().is_some_and(|s| s.end() >= open.next_look) {
            return Some(());
        }
        let end = self.capture.next();
        if end < open.next_look && !self.capture.is_full() || end <= open.since + 8 {
            return None;
        }
        match &mut open.search {
            Some(search) if end > search.end() => search.again(&self.known, &self.capture, end),
            // All stored data have been searched. Without a cause the search begins again with later data, since
            // something that passes, such as a stalled link, may have hidden the cause in these.
            Some(_) => {
                if open.said.is_none() {
                    self.restart();
                }
                return None;
            }
            None => {
                open.search = Some(Search::new(
                    &self.known,
                    &self.capture,
                    Onset { since: open.since, took: open.took },
                    end,
                    self.run_length,
                ));
            }
        }
        open.next_look = end;
        Some(())
    }
}

/// Whether a cause needs no new report: the same effect at the same location, with each value within the previous
/// interval.
fn is_same(before: &Cause, now: &Cause) -> bool {
    before.effect.kind() == now.effect.kind()
        && before.effect.place() == now.effect.place()
        && before.values.iter().zip(&now.values).all(|(a, b)| {
            let sharper = b.high - b.low < (a.high - a.low) / SHARPER;
            (a.low..=a.high).contains(&b.value) && !sharper
        })
}
