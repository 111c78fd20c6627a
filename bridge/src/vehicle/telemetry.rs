//! Measurements of a vehicle, in the fields and signs of the bus.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use whirlstand_msgs::{Imu, Message, Odometry, valid};

use super::clock::PeerClock;
use crate::config::{ConfigError, Trim};
use crate::sign_watch::Attitude;

/// Names of the bus's fields for a vehicle: six of `Imu`, then six of `Odometry`. Each three consecutive
/// fields form a group and share one validity bit.
pub const FIELDS: [&str; 12] = [
    "roll",
    "pitch",
    "yaw",
    "roll_rate",
    "pitch_rate",
    "yaw_rate",
    "longitudinal_position",
    "lateral_position",
    "height",
    "longitudinal_speed",
    "lateral_speed",
    "vertical_speed",
];

/// Step back of the vehicle's clock from which it was restarted, ns, unless newer stamps arrived within
/// [`SILENCE`].
const RESTART_NS: i64 = 1_000_000_000;

/// Time after newer stamps within which a message with an older stamp was only delayed.
const SILENCE: Duration = Duration::from_millis(200);

/// Largest time between rates and an attitude that belong together.
const TOGETHER: Duration = Duration::from_millis(20);

/// Number of attitudes from which the rate is determined, and the fewest intervals between them.
const ARRIVALS: usize = 9;
const LEAST_INTERVALS: usize = 3;

/// Measurements that arrive together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Group {
    /// Roll, pitch and yaw, rad.
    Attitude = 0,
    /// Body rates about the forward, right and down axes, rad/s.
    Rates = 1,
    /// Position forward, right, up, m.
    Position = 2,
    /// Speed forward, right, up, m/s.
    Speed = 3,
}

/// Reason why a measurement was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refused {
    /// A value is NaN or infinite.
    NotFinite,
    /// The time stamp is not after that of the last measurement: repeated, or overtaken in transit.
    Old,
}

#[derive(Debug, Clone, Copy, Default)]
struct Held {
    values: [f64; 3],
    stamp_ns: Option<i64>,
    /// Time of measurement, by our clock.
    at: Option<Duration>,
    fresh: bool,
}

/// Counts of refused measurements.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Refusals {
    /// Number of measurements with a value that is not finite.
    pub not_finite: u64,
    /// Number of measurements that are not newer than the last.
    pub old: u64,
    /// Number of restarts of the vehicle's clock.
    pub restarts: u64,
}

/// The newest measurements.
#[derive(Debug, Clone)]
pub struct Telemetry {
    trims: [Trim; FIELDS.len()],
    held: [Held; 4],
    clock: PeerClock,
    /// The newest stamp, and its time of arrival.
    newest: Option<(i64, Duration)>,
    /// Times of arrival of the last attitudes.
    arrivals: VecDeque<Duration>,
    restarted: bool,
    refusals: Refusals,
}

impl Telemetry {
    /// Telemetry without any measurement.
    ///
    /// # Errors
    /// For a trim of a field that the bus does not have, or that is not finite.
    pub fn new(trims: &BTreeMap<String, Trim>) -> Result<Self, ConfigError> {
        let mut table = [Trim::default(); FIELDS.len()];
        for (name, trim) in trims {
            let Some(i) = FIELDS.iter().position(|f| f == name) else {
                let message = format!("there is no '{name}'; the bus has {}", FIELDS.join(", "));
                return Err(ConfigError::new(&["measured", name], message));
            };
            if !trim.scale.is_finite() || !trim.offset.is_finite() || trim.scale == 0.0 {
                let message = "a finite offset and a finite scale other than 0 are expected";
                return Err(ConfigError::new(&["measured", name], message));
            }
            table[i] = *trim;
        }
        Ok(Self {
            trims: table,
            held: [Held::default(); 4],
            clock: PeerClock::default(),
            newest: None,
            arrivals: VecDeque::with_capacity(ARRIVALS + 1),
            restarted: false,
            refusals: Refusals::default(),
        })
    }

    /// Clock of the vehicle.
    pub fn clock(&mut self) -> &mut PeerClock {
        &mut self.clock
    }

    /// The newest stamp of the vehicle, ns.
    pub fn newest_ns(&self) -> Option<i64> {
        self.newest.map(|(stamp, _)| stamp)
    }

    /// Counts of refused measurements.
    pub fn refusals(&self) -> Refusals {
        self.refusals
    }

    /// Processes a group with the vehicle's time stamp, ns; `None` for a protocol without stamps.
    ///
    /// # Errors
    /// [`Refused`], which is counted; earlier measurements are kept.
    pub fn take(
        &mut self,
        group: Group,
        values: [f64; 3],
        stamp_ns: Option<i64>,
        now: Duration,
    ) -> Result<(), Refused> {
        if values.iter().any(|v| !v.is_finite()) {
            self.refusals.not_finite += 1;
            return Err(Refused::NotFinite);
        }
        if let Some(stamp) = stamp_ns {
            let went_back = |(newest, at): (i64, Duration)| {
                stamp < newest.saturating_sub(RESTART_NS) && now.saturating_sub(at) > SILENCE
            };
            if self.newest.is_some_and(went_back) {
                self.restart();
            }
            if self.held[group as usize].stamp_ns.is_some_and(|last| stamp <= last) {
                self.refusals.old += 1;
                return Err(Refused::Old);
            }
            self.clock.arrival(stamp, now);
            if self.newest.is_none_or(|(newest, _)| stamp > newest) {
                self.newest = Some((stamp, now));
            }
        }
        let at = stamp_ns.map_or(now, |stamp| self.clock.ours(stamp, now));
        let trims = &self.trims[group as usize * 3..];
        let mut trimmed = [0.0; 3];
        for ((out, value), trim) in trimmed.iter_mut().zip(values).zip(trims) {
            *out = trim.scale * value + trim.offset;
        }
        if group == Group::Attitude {
            self.arrivals.push_back(now);
            if self.arrivals.len() > ARRIVALS {
                self.arrivals.pop_front();
            }
        }
        self.held[group as usize] = Held { values: trimmed, stamp_ns, at: Some(at), fresh: true };
        Ok(())
    }

    /// Discards all measurements because the vehicle restarted.
    pub fn restart(&mut self) {
        self.held = [Held::default(); 4];
        self.clock.reset();
        self.newest = None;
        self.arrivals.clear();
        self.restarted = true;
        self.refusals.restarts += 1;
    }

    /// True when the vehicle restarted since the last call.
    pub fn take_restart(&mut self) -> bool {
        std::mem::take(&mut self.restarted)
    }

    /// Age of a group; `None` before the first.
    pub fn age(&self, group: Group, now: Duration) -> Option<Duration> {
        self.held[group as usize].at.map(|at| now.saturating_sub(at))
    }

    /// Typical time between the last attitudes, by their median, so that a single pause does not matter;
    /// `None` before several have arrived.
    pub fn interval(&self) -> Option<Duration> {
        let mut between = [Duration::ZERO; ARRIVALS];
        let pairs = self.arrivals.iter().zip(self.arrivals.iter().skip(1));
        let count = between.iter_mut().zip(pairs).map(|(slot, (a, b))| *slot = b.saturating_sub(*a)).count();
        let between = between.get_mut(..count).filter(|_| count >= LEAST_INTERVALS)?;
        between.sort_unstable();
        between.get(count / 2).copied()
    }

    /// The newest values of a group, with signs, scales and offsets applied, in the units of [`Group`].
    pub fn values(&self, group: Group) -> Option<[f64; 3]> {
        let held = &self.held[group as usize];
        held.at.map(|_| held.values)
    }

    /// The newest attitude, with the rates measured with it or shortly before.
    pub fn attitude(&self) -> Option<Attitude> {
        let [attitude, rates, ..] = &self.held;
        let at = attitude.at?;
        let belongs = |rates_at: Duration| at.abs_diff(rates_at) <= TOGETHER;
        let rates = rates.at.filter(|rates_at| belongs(*rates_at)).map(|_| rates.values);
        Some(Attitude { angles: attitude.values, rates, at })
    }

    /// True when a group has arrived since the last [`Telemetry::measure`].
    pub fn is_fresh(&self, group: Group) -> bool {
        self.held[group as usize].fresh
    }

    /// The messages of a step, with measurements since the last call marked as fresh. The caller fills in the
    /// heads.
    pub fn measure(&mut self) -> (Imu, Odometry) {
        let (mut imu, mut odometry) = (Imu::zeroed(), Odometry::zeroed());
        let [attitude, rates, position, speed] = self.held.map(|h| h.values);
        [imu.roll, imu.pitch, imu.yaw] = attitude;
        [imu.roll_rate, imu.pitch_rate, imu.yaw_rate] = rates;
        [odometry.longitudinal_position, odometry.lateral_position, odometry.height] = position;
        [odometry.longitudinal_speed, odometry.lateral_speed, odometry.vertical_speed] = speed;
        let fresh = self.held.map(|h| u32::from(h.fresh));
        imu.valid = (fresh[0] * valid::FIRST) | (fresh[1] * valid::SECOND);
        odometry.valid = (fresh[2] * valid::FIRST) | (fresh[3] * valid::SECOND);
        self.held.iter_mut().for_each(|h| h.fresh = false);
        (imu, odometry)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn values_are_trimmed_and_fresh_once() {
        let trims = BTreeMap::from([("pitch".into(), Trim { scale: -1.0, offset: 0.5 })]);
        let mut t = Telemetry::new(&trims).unwrap();
        t.take(Group::Attitude, [0.1, 0.2, 0.3], Some(1_000_000), ms(10)).unwrap();
        let (imu, odometry) = t.measure();
        assert_eq!((imu.roll, imu.pitch, imu.yaw), (0.1, 0.3, 0.3));
        assert_eq!((imu.valid, odometry.valid), (valid::FIRST, 0));
        assert_eq!(t.measure().0.valid, 0);
    }

    #[test]
    fn what_is_old_repeated_or_no_number_is_refused_and_counted() {
        let mut t = Telemetry::new(&BTreeMap::new()).unwrap();
        let mut take = |value, stamp| t.take(Group::Attitude, [value; 3], Some(stamp), ms(10));
        take(0.1, 20_000_000).unwrap();
        assert_eq!(take(0.2, 20_000_000), Err(Refused::Old));
        assert_eq!(take(0.2, 15_000_000), Err(Refused::Old));
        assert_eq!(take(f64::NAN, 30_000_000), Err(Refused::NotFinite));
        assert_eq!(t.refusals(), Refusals { not_finite: 1, old: 2, restarts: 0 });
        assert_eq!(t.values(Group::Attitude), Some([0.1; 3]));
    }

    #[test]
    fn a_pause_makes_no_rare_attitude_and_a_rare_one_is_told() {
        let mut t = Telemetry::new(&BTreeMap::new()).unwrap();
        let mut at = 0;
        let mut come = |every: u64, times: u32| {
            for _ in 0..times {
                at += every;
                t.take(Group::Attitude, [0.1; 3], None, ms(at)).unwrap();
            }
            t.interval()
        };
        assert_eq!(come(10, 3), None);
        assert_eq!(come(10, 9), Some(ms(10)));
        assert_eq!(come(3000, 1), Some(ms(10)), "a link that was down for a while");
        assert_eq!(come(250, 8), Some(ms(250)));
    }

    #[test]
    fn a_clock_that_begins_anew_is_a_restart() {
        let mut t = Telemetry::new(&BTreeMap::new()).unwrap();
        t.take(Group::Attitude, [0.1; 3], Some(60_000_000_000), ms(10)).unwrap();
        let late = t.take(Group::Attitude, [0.2; 3], Some(1_000_000), ms(20));
        assert_eq!(late, Err(Refused::Old), "while the vehicle speaks it is only an old message");
        t.take(Group::Attitude, [0.2; 3], Some(1_000_000), ms(220)).unwrap();
        assert!(t.take_restart() && !t.take_restart());
        assert_eq!(t.age(Group::Attitude, ms(225)), Some(ms(5)));
        assert!(t.take(Group::Attitude, [0.3; 3], Some(2_000_000), ms(221)).is_ok());
    }

    #[test]
    fn a_trim_of_an_unknown_field_is_refused_by_name() {
        let trims = BTreeMap::from([("rol".to_string(), Trim::default())]);
        let error = Telemetry::new(&trims).unwrap_err();
        assert!(error.path.contains(&"rol".into()) && error.message.contains("roll_rate"), "{error}");
    }
}
