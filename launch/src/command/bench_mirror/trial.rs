//! Flights monitored by the mirror: with an effect that begins at a random time, and without an effect.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use serde::Serialize;
use whirlstand_mirror::{Finding, Mirror, Options, Sample, Stage};
use whirlstand_nodes::config::{Engine, NodeConfig, SignalChange};
use whirlstand_nodes::flight::{Onset, Pilot};
use whirlstand_nodes::setup::Setup;
use whirlstand_vehicle::{Effect, Kind, Stream, Vehicle};

use super::hidden::{draw, is_right, text, vehicle_of};
use crate::command::design::controller_plan;
use crate::error::Failure;

/// Time after the onset of an effect at which the mirror's finding is judged, s.
pub(super) const NAMED_S: f64 = 10.0;

/// Mean time between false alarms for which the bound on the delay holds, s: that of the mirror itself.
const BETWEEN_FALSE_ALARMS_S: f64 = 360_000.0;

/// Largest attitude setpoint, rad, and the shortest and longest time between two setpoints, s.
const ASKED_RAD: f64 = 0.09;
const SETPOINTS_S: (f64, f64) = (1.0, 3.0);

/// Start and end of the part of a clean flight from which the range of each input is taken, s.
const RANGE_S: (f64, f64) = (0.5, 8.0);

/// A vehicle and its law, ready for many flights.
pub(super) struct Hangar {
    config: NodeConfig,
    pilot: Pilot,
    period_s: f64,
}

/// Result of a flight with a hidden effect.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Trial {
    /// Number of the flight, which is the seed of all its random numbers.
    pub number: u64,
    /// Name of the effect, one of the twelve.
    pub what: &'static str,
    /// The hidden effect in words.
    pub hidden: String,
    /// Onset of the effect, s.
    pub begin_s: f64,
    /// Time from the onset to the alarm, s.
    pub detected_s: Option<f64>,
    /// Lower bound on that time for any test (Lorden), s.
    pub bound_s: Option<f64>,
    /// Log-likelihood ratio of the hidden effect per second.
    pub information_per_s: Option<f64>,
    /// Whether there was an alarm before the onset.
    pub false_before: bool,
    /// Whether the finding at the end of the flight is right; `None` without a finding.
    pub right: Option<bool>,
    /// Whether a wrong cause was named at any time.
    pub wrong_ever: bool,
    /// Time from the onset to the finding that holds at the end, s.
    pub named_s: Option<f64>,
    /// All findings, each with the time since the onset.
    pub said: Vec<String>,
}

/// Result of a clean flight.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Clean {
    /// Number of the flight.
    pub number: u64,
    /// Steps flown.
    pub steps: u64,
    /// Number of alarms: times at which the mirror said that prediction is wrong.
    pub alarms: u64,
    /// Time that the mirror took, s.
    pub spent_s: f64,
    /// The findings.
    pub said: Vec<String>,
}

impl Hangar {
    /// A built-in vehicle under LQR.
    ///
    /// # Errors
    /// [`Failure`] for a rate at which the vehicle cannot fly.
    pub fn new(vehicle: &str, rate_hz: f64) -> Result<Self, Failure> {
        let mut config = controller_plan(vehicle, "lqr", rate_hz, &[])?.config;
        config.plant.engine = Engine::Flying;
        let pilot = Pilot::new(&config).map_err(Failure::mend)?;
        Ok(Self { period_s: Setup::period_s(&config), config, pilot })
    }

    /// Time of a step, s.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// The bench of a flight, with random setpoints of roll and pitch.
    fn bench(&self, number: u64, steps: u64) -> NodeConfig {
        let mut config = self.config.clone();
        (config.seed, config.steps) = (number, steps);
        let mut stream = Stream::new(number, "setpoint");
        let vehicle = self.pilot.vehicle();
        let angles: Vec<&str> =
            ["roll", "pitch"].into_iter().filter(|name| vehicle.state_index(name).is_some()).collect();
        let mut at_s = 0.0;
        config.setpoint.clear();
        while at_s < steps as f64 * self.period_s {
            let mut value = || ASKED_RAD * (2.0 * stream.uniform() - 1.0);
            let values: BTreeMap<String, f64> = angles.iter().map(|a| (a.to_string(), value())).collect();
            config.setpoint.push(SignalChange { at_s, values });
            at_s += SETPOINTS_S.0 + (SETPOINTS_S.1 - SETPOINTS_S.0) * stream.uniform();
        }
        config
    }

    fn mirror(&self) -> Result<Mirror, Failure> {
        let options = Options::new(self.config.plant.engine.into(), false, self.period_s);
        Mirror::new(self.pilot.vehicle(), self.period_s, &options).map_err(Failure::mend)
    }

    /// Least and greatest value of each input in a clean flight.
    fn ranges(&self, number: u64) -> Result<Vec<(f64, f64)>, Failure> {
        let mut ranges = vec![(f64::INFINITY, f64::NEG_INFINITY); self.pilot.vehicle().inputs.len()];
        let (mut step, from) = (0, (RANGE_S.0 / self.period_s) as u64);
        let config = self.bench(number, (RANGE_S.1 / self.period_s) as u64);
        let flown = self.pilot.fly(&config, |flown| {
            step += 1;
            for (range, u) in ranges.iter_mut().zip(flown.u).filter(|_| step > from) {
                *range = (range.0.min(*u), range.1.max(*u));
            }
        });
        flown.map_err(Failure::run)?;
        Ok(ranges)
    }

    /// Flies with an effect that is drawn with the flight's number as the seed.
    ///
    /// # Errors
    /// When the flight fails for another reason than the loss of the vehicle.
    pub fn hide(&self, what: &'static str, number: u64) -> Result<Trial, Failure> {
        let vehicle = self.pilot.vehicle();
        let mut stream = Stream::new(number, what);
        let onset =
            draw(what, vehicle, &mut stream, &self.ranges(number)?, self.period_s).map_err(Failure::run)?;
        let config = self.bench(number, onset.step + (NAMED_S / self.period_s) as u64);
        let mut mirror = self.mirror()?;
        let mut heard = Heard::new(&onset, self.period_s);
        let mut step = 0;
        let flown = self.pilot.fly_changed(&config, Some(&onset), |flown| {
            let sample = Sample { step, y: flown.y, fresh: flown.fresh, u: flown.u };
            heard.take(mirror.observe(&sample));
            step += 1;
        });
        match flown {
            // Findings before the loss of the vehicle count.
            Ok(_) | Err(whirlstand_nodes::NodeError::Diverged { .. }) => {}
            Err(error) => return Err(Failure::Run(format!("flight {number} with {what}: {error}"))),
        }
        let evidence = mirror.evidence_of(&onset.effect, onset.step);
        let rate = |sums: &Vec<f64>| sums.last().map(|l| l / (sums.len() as f64 * self.period_s));
        Ok(Trial {
            number,
            what,
            hidden: text(&onset.effect),
            begin_s: onset.step as f64 * self.period_s,
            detected_s: heard.detected.map(|step| (step - onset.step + 1) as f64 * self.period_s),
            bound_s: bound(vehicle, &onset.effect, evidence.as_deref(), self.period_s),
            information_per_s: evidence.as_ref().and_then(rate),
            false_before: heard.early,
            right: heard.stands.map(|(_, right)| right),
            wrong_ever: heard.wrong_ever,
            named_s: heard.stands.map(|(step, _)| (step as f64 - onset.step as f64) * self.period_s),
            said: heard.said,
        })
    }

    /// Flies `steps` steps without an effect.
    ///
    /// # Errors
    /// When the flight fails.
    pub fn clean(&self, number: u64, steps: u64) -> Result<Clean, Failure> {
        let config = self.bench(number, steps);
        let mut mirror = self.mirror()?;
        let (mut step, mut alarms, mut spent, mut said) = (0, 0, Duration::ZERO, Vec::new());
        let flown = self.pilot.fly(&config, |flown| {
            let sample = Sample { step, y: flown.y, fresh: flown.fresh, u: flown.u };
            let from = Instant::now();
            let finding = mirror.observe(&sample);
            spent += from.elapsed();
            if let Some(finding) = finding {
                alarms += u64::from(finding.stage == Stage::Wrong);
                said.push(line(&finding, 0, self.period_s));
            }
            step += 1;
        });
        flown.map_err(|e| Failure::Run(format!("clean flight {number}: {e}")))?;
        Ok(Clean { number, steps, alarms, spent_s: spent.as_secs_f64(), said })
    }
}

/// Name of the vehicle, and which effects are hidden in it.
pub(super) fn hangar_of<'a>(what: &str, hangars: &'a BTreeMap<&'static str, Hangar>) -> Option<&'a Hangar> {
    hangars.get(vehicle_of(what))
}

/// The findings of a mirror in one flight.
struct Heard<'a> {
    onset: &'a Onset,
    period_s: f64,
    detected: Option<u64>,
    early: bool,
    /// Step at which the current cause was named, and whether it is right.
    stands: Option<(u64, bool)>,
    wrong_ever: bool,
    said: Vec<String>,
}

impl<'a> Heard<'a> {
    fn new(onset: &'a Onset, period_s: f64) -> Self {
        Self {
            onset,
            period_s,
            detected: None,
            early: false,
            stands: None,
            wrong_ever: false,
            said: Vec::new(),
        }
    }

    fn take(&mut self, finding: Option<Finding>) {
        let Some(finding) = finding else { return };
        self.said.push(line(&finding, self.onset.step, self.period_s));
        let right = finding.cause.as_ref().map(|c| is_right(c, &self.onset.effect));
        match finding.stage {
            Stage::Wrong if finding.step < self.onset.step => self.early = true,
            Stage::Wrong => self.detected = self.detected.or(Some(finding.step)),
            Stage::Named | Stage::Revised => {
                let right = right.unwrap_or(false);
                self.wrong_ever |= !right;
                // A cause that was named right and refined later counts from its first naming.
                let since = self.stands.filter(|s| s.1 && right).map_or(finding.step, |s| s.0);
                self.stands = Some((since, right));
            }
            Stage::Withdrawn => self.stands = None,
            Stage::Over => {}
        }
    }
}

fn line(finding: &Finding, begin: u64, period_s: f64) -> String {
    let since = |step: u64| (step as f64 - begin as f64) * period_s;
    let cause = finding.cause.as_ref().map_or(String::new(), |c| {
        let alike: String =
            c.indistinguishable.iter().map(|(k, p)| format!(" or {} at {p}", k.name())).collect();
        format!(": {}{alike}", text(&c.effect))
    });
    format!("{:.2} s {:?} since {:.3} s{cause}", since(finding.step), finding.stage, since(finding.since))
}

/// Lower bound on the mean detection delay, s, of any test with so few false alarms, for a change of this size
/// (Lorden, Ann. Math. Stat. 42, 1971): the time at which the log-likelihood ratio exceeds the logarithm of the
/// number of steps between false alarms. `None` when the flight ends before.
fn bound(vehicle: &Vehicle, hidden: &Effect, evidence: Option<&[f64]>, period_s: f64) -> Option<f64> {
    let asked = (BETWEEN_FALSE_ALARMS_S / period_s).ln();
    match hidden.kind() {
        Kind::Noise => {
            let noise = vehicle.outputs[vehicle.output_index(hidden.place())?].noise;
            let variance = 1.0 + (hidden.parameter("std")? / noise).powi(2);
            // The Kullback-Leibler divergence per sample.
            Some(asked / (0.5 * (variance - 1.0 - variance.ln())) * period_s)
        }
        // A repeated value is certain within two steps.
        Kind::Dropouts => Some(2.0 * period_s),
        _ => {
            let passed = evidence?.iter().position(|sum| *sum >= asked)?;
            Some((passed + 1) as f64 * period_s)
        }
    }
}
