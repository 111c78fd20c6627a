//! Tilts the vehicle about an axis, and judges what the autopilot makes of it.
//!
//! A computer that is busy with something else stops this program, the autopilot's, or both, for seconds. The
//! vehicle then jumps, the outputs are stale, and the pilot's switch goes off: a tilt like that says nothing
//! about the axis, so it is flown again.

use std::time::Duration;

use whirlstand_bridge::sensors::Motion;

use super::super::Finding;
use super::super::reaction::{self, Demands};
use super::super::tilt::{self, AXES, RAMP, TILT};
use super::{Check, SILENCE};

/// Time after a tilt until it is evaluated: settling time of the autopilot's estimator and its telemetry.
const SETTLE: Duration = Duration::from_millis(1500);

/// Longest pause between two readings of the sensors in a tilt that counts: a quarter of it.
const PAUSE: Duration = Duration::from_millis(250);

/// Most flights of one tilt.
const TRIES: u32 = 4;

/// What was seen of one tilt.
struct Tilt {
    /// Reported attitude before and after it, as far as there was any.
    attitudes: Option<[[f64; 3]; 2]>,
    /// Demands of the outputs before and during it.
    demands: [Demands; 2],
    /// Longest pause between two readings of the sensors.
    pause: Duration,
    /// True when its outputs were not fresh all the time, and when it was not armed all the time.
    silent: bool,
    disarmed: bool,
}

impl Tilt {
    /// Whether it was flown as meant; `armed` also counts its outputs.
    fn counts(&self, armed: bool) -> bool {
        self.pause <= PAUSE && !self.silent && !(armed && self.disarmed)
    }
}

impl Check<'_> {
    /// Tilts the vehicle about `axis` in both directions, and says what the attitude (when `leveled`) and the
    /// outputs (when `armed`) did. An autopilot that is disarmed meanwhile has until `limit` to be armed again; false
    /// for one whose outputs have ended, of which nothing more can be said.
    pub(super) fn axis(&mut self, axis: usize, leveled: bool, armed: bool, limit: Duration) -> bool {
        let mut from = 0.0;
        for to in [TILT, -TILT] {
            let mut tilt = self.tilt(axis, from, to, leveled);
            for _ in 1..TRIES {
                if tilt.counts(armed) {
                    break;
                }
                if self.until(SILENCE, |check| check.flight.is_fresh(check.now()).then_some(())).is_none() {
                    let autopilot = self.name;
                    (self.say)(Finding::Wrong(format!(
                        "{}: {autopilot} sends no outputs any more",
                        AXES[axis].0
                    )));
                    return false;
                }
                self.tilt(axis, to, from, leveled);
                if armed {
                    self.wait_for_arming(limit);
                }
                tilt = self.tilt(axis, from, to, leveled);
            }
            self.judge(axis, to - from, &tilt, leveled, armed);
            from = to;
        }
        self.tilt(axis, from, 0.0, leveled);
        true
    }

    fn tilt(&mut self, axis: usize, from: f64, to: f64, leveled: bool) -> Tilt {
        let before = self.wait_for_attitude(leveled, &|_| tilt::motion(axis, from, from, RAMP));
        (self.pause, self.silent, self.disarmed) = (Duration::ZERO, false, false);
        self.demands = Demands::default();
        self.fly(RAMP / 4, |_| tilt::motion(axis, from, from, RAMP));
        let still = std::mem::take(&mut self.demands);
        self.fly(RAMP, |spent| tilt::motion(axis, from, to, spent));
        let moved = std::mem::take(&mut self.demands);
        self.fly(SETTLE, |_| tilt::motion(axis, from, to, RAMP));
        let (pause, silent, disarmed) = (self.pause, self.silent, self.disarmed);
        let after = self.wait_for_attitude(leveled, &|_| tilt::motion(axis, from, to, RAMP));
        let attitudes = before.zip(after).map(|(before, after)| [before, after]);
        Tilt { attitudes, demands: [still, moved], pause, silent, disarmed }
    }

    /// The reported attitude, for which a vehicle in this place waits a while where it was `leveled` by it.
    fn wait_for_attitude(&mut self, leveled: bool, place: &dyn Fn(Duration) -> Motion) -> Option<[f64; 3]> {
        let end = self.now() + SILENCE;
        while leveled && self.attitude().is_none() && self.now() < end {
            self.turn(place);
        }
        self.attitude()
    }

    fn judge(&mut self, axis: usize, by: f64, tilt: &Tilt, leveled: bool, armed: bool) {
        let [name, words] = [AXES[axis].0, AXES[axis].1[usize::from(by < 0.0)]];
        if tilt.pause > PAUSE {
            (self.say)(Finding::Unknown(format!(
                "{name}, {words}: the sensors paused for {:.1} s in each of {TRIES} tilts: this machine is too busy",
                tilt.pause.as_secs_f64()
            )));
            return;
        }
        match tilt.attitudes {
            Some([before, after]) => {
                let seen = tilt::check(axis, by, before, after);
                (self.say)(seen.map_or_else(Finding::Wrong, Finding::Good));
            }
            None if leveled => (self.say)(Finding::Wrong(format!("{name}: the telemetry stopped"))),
            None => {}
        }
        if armed && tilt.disarmed {
            let autopilot = self.name;
            (self.say)(Finding::Unknown(format!(
                "{name}, {words}: {autopilot} did not stay armed in any of {TRIES} tilts"
            )));
        } else if armed {
            (self.say)(reaction::check(axis, by, &tilt.demands[0], &tilt.demands[1]));
        }
    }
}
