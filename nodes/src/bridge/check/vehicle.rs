//! Check of a vehicle.
//!
//! First the vehicle is moved by hand, axis by axis, and its attitude and rates must follow with the correct
//! sign, mostly about that axis. Then, with consent, each channel is moved by 100 us and read back where the
//! vehicle reports it (`RC_CHANNELS`), and the sticks of the vehicle's own radio show the sign of each channel.
//! Outputs pass the same limits as in flight, and an armed vehicle is refused.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use whirlstand_bridge::channels::{CHANNELS, Input, Steering};
use whirlstand_bridge::config::BridgeConfig;
use whirlstand_bridge::sensors::wrapped;
use whirlstand_bridge::turning::inputs_of;
use whirlstand_bridge::vehicle::Group;
use whirlstand_msgs::valid;

use super::super::vehicle::links::VehicleLinks;
use super::super::vehicle::open_vehicle;
use super::super::vehicle::shared_vehicle::{SharedVehicle, lock};
use super::consent::{self, Consent, MOVED_BY_US};
use super::{CheckOptions, Finding, sticks};
use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::gate::Gate;
use crate::setup::Setup;

/// Smallest rotation by hand, rad.
const TURN: f64 = 0.25;

/// Polling period.
const POLL_PERIOD: Duration = Duration::from_millis(5);

/// Duration of a channel's movement.
const PULSE_TIME: Duration = Duration::from_millis(600);

/// Longest movement of a channel, while the vehicle has not reported its channels since: autopilots report them once a
/// second or more often.
const LONGEST_PULSE: Duration = Duration::from_secs(2);

/// Smallest change of a channel that must be reported, us.
const LEAST_CHANGE_US: f64 = 50.0;

/// The axes, the movement by hand, and their index in the attitude.
const AXES: [(&str, &str); 3] = [
    ("roll", "roll the vehicle to the right: right side down, by about 30 degrees"),
    ("pitch", "pitch the vehicle up: nose up, by about 30 degrees"),
    ("yaw", "yaw the vehicle clockwise, seen from above, by about 30 degrees"),
];

/// State of a check.
struct Check<'a> {
    shared: Mutex<SharedVehicle>,
    links: VehicleLinks,
    timeout: Duration,
    say: &'a mut dyn FnMut(Finding),
}

/// Checks the bridge to a vehicle; `say` receives each finding when it is made. `ask` receives the question
/// whether the channels may move, before anything is sent.
///
/// # Errors
/// For invalid options, and a vehicle that does not answer.
pub fn check_vehicle(
    config: &NodeConfig,
    bridge: &BridgeConfig,
    options: &CheckOptions,
    ask: &mut dyn FnMut(&str) -> Consent,
    say: &mut dyn FnMut(Finding),
) -> Result<(), NodeError> {
    let setup = Setup::new(config)?;
    let vehicle = open_vehicle(config, bridge, &setup)?;
    let inputs = inputs_of(&setup.vehicle);
    let in_use: Vec<_> = (0..CHANNELS).filter(|c| vehicle.channels().1[*c]).collect();
    // Asked before the link is opened: nobody serves the link while an answer is awaited.
    let consent = options.outputs.then(|| ask(&consent::question(&in_use, &vehicle.steering(&inputs).0)));
    let links = VehicleLinks::new(bridge)?;
    let shared = links.share(vehicle, Gate::new(setup.limits, 1), Instant::now());
    let mut check = Check { shared: Mutex::new(shared), links, timeout: options.timeout, say };
    check.wait_for_vehicle()?;
    if lock(&check.shared).vehicle.is_armed() {
        (check.say)(Finding::Wrong("the vehicle is armed: disarm it, then check again".into()));
        return Ok(());
    }
    check.link();
    for (axis, (name, ask)) in AXES.iter().enumerate() {
        check.axis(axis, name, ask);
    }
    match consent {
        Some(Consent::Given) => {
            check.outputs(&in_use, bridge);
            check.signs(&inputs, bridge);
        }
        Some(without) => in_use.iter().for_each(|c| (check.say)(consent::unmoved(*c, without))),
        None => {}
    }
    let mut shared = lock(&check.shared);
    let now = shared.now();
    shared.vehicle.end(now);
    shared.flush();
    Ok(())
}

impl Check<'_> {
    /// Polls for at most `limit`, until `done` returns a result.
    fn until<T>(
        &mut self,
        limit: Duration,
        mut done: impl FnMut(&mut SharedVehicle) -> Option<T>,
    ) -> Option<T> {
        let end = Instant::now() + limit;
        while Instant::now() < end {
            self.links.wait(POLL_PERIOD);
            self.links.turn(&self.shared);
            let mut shared = lock(&self.shared);
            let now = shared.now();
            shared.vehicle.poll(now);
            shared.flush();
            if let Some(found) = done(&mut shared) {
                return Some(found);
            }
        }
        None
    }

    fn wait_for_vehicle(&mut self) -> Result<(), NodeError> {
        let heard =
            self.until(self.timeout, |shared| shared.vehicle.telemetry().values(Group::Attitude).map(drop));
        if heard.is_some() {
            return Ok(());
        }
        Err(NodeError::no_vehicle(self.timeout.as_secs_f64(), &lock(&self.shared).vehicle.figures()))
    }

    /// Checks rate, losses and clock.
    fn link(&mut self) {
        let before = lock(&self.shared).vehicle.figures();
        let mut attitudes = 0;
        let second = Duration::from_secs(1);
        let _: Option<()> = self.until(second, |shared| {
            let (imu, _) = shared.vehicle.measure();
            attitudes += u32::from(imu.valid & valid::FIRST != 0);
            None
        });
        let after = lock(&self.shared).vehicle.figures();
        let (dropped, lost) = (after.dropped - before.dropped, after.lost - before.lost);
        let text =
            format!("the attitude comes {attitudes} times a second; {dropped} messages damaged, {lost} lost");
        (self.say)(if attitudes > 0 && dropped + lost == 0 {
            Finding::Good(text)
        } else {
            Finding::Wrong(text)
        });
        match (after.clock_offset_ns, after.round_trip_ns) {
            (Some(offset), Some(trip)) => (self.say)(Finding::Good(format!(
                "the vehicle's clock is {:.3} s ahead, by an exchange of {:.2} ms",
                offset as f64 * 1e-9,
                trip as f64 * 1e-6
            ))),
            _ => (self.say)(Finding::Unknown(
                "the vehicle does not report its time: delays cannot be measured".into(),
            )),
        }
    }

    fn axis(&mut self, axis: usize, name: &str, ask: &str) {
        (self.say)(Finding::Ask(format!("now {ask}")));
        let Some(start) = lock(&self.shared).vehicle.telemetry().values(Group::Attitude) else {
            return (self.say)(Finding::Unknown(format!(
                "{name}: the vehicle no longer reports its attitude"
            )));
        };
        // The integrated rate of each axis must match the change of its angle.
        let mut turned = [0.0; 3];
        let mut last = Instant::now();
        let moved = self.until(self.timeout, |shared| {
            let telemetry = shared.vehicle.telemetry();
            let angles = telemetry.values(Group::Attitude)?;
            let step = last.elapsed().as_secs_f64();
            last = Instant::now();
            for (sum, rate) in turned.iter_mut().zip(telemetry.values(Group::Rates).unwrap_or([0.0; 3])) {
                *sum += rate * step;
            }
            let change: [f64; 3] = std::array::from_fn(|i| wrapped(angles[i] - start[i]));
            change.iter().any(|c| c.abs() >= TURN).then_some(change)
        });
        let Some(change) = moved else {
            return (self.say)(Finding::Unknown(format!("{name}: nothing moved in time")));
        };
        let most = (0..3).max_by(|a, b| change[*a].abs().total_cmp(&change[*b].abs())).unwrap_or(axis);
        let has_rates = lock(&self.shared).vehicle.telemetry().values(Group::Rates).is_some();
        (self.say)(if most != axis {
            Finding::Wrong(format!("{name}: it is {} that moved; the axes are exchanged", AXES[most].0))
        } else if change[axis] < 0.0 {
            let trim = format!("set bridge.measured.{name}.scale = -1");
            Finding::Wrong(format!("{name}: the sign is turned; {trim}, and the same for {name}_rate"))
        } else if has_rates && turned[axis] < 0.25 * change[axis] {
            Finding::Wrong(format!(
                "{name}_rate: the angle moved by {:.2} rad, and the rate adds up to {:.2}; its sign, scale or axis is wrong",
                change[axis], turned[axis]
            ))
        } else {
            Finding::Good(format!("{name}: {:+.2} rad, and its rate agrees", change[axis]))
        });
        (self.say)(Finding::Ask("and back".into()));
        let _: Option<()> = self.until(self.timeout, |shared| {
            let angles = shared.vehicle.telemetry().values(Group::Attitude)?;
            (wrapped(angles[axis] - start[axis]).abs() < 0.3 * TURN).then_some(())
        });
    }

    fn outputs(&mut self, in_use: &[usize], bridge: &BridgeConfig) {
        for &channel in in_use {
            let number = channel + 1;
            let rest = self.pushed(channel, 0.0);
            let up = self.pushed(channel, MOVED_BY_US);
            let (Some(rest), Some(up)) = (rest, up) else {
                let why = sticks::no_channels(bridge.kind);
                (self.say)(Finding::Unknown(format!("channel {number}: whether it arrives, because {why}")));
                continue;
            };
            let change: Vec<_> = up.iter().zip(&rest).map(|(a, b)| a - b).collect();
            let others = (0..change.len()).filter(|i| *i != channel && change[*i].abs() > LEAST_CHANGE_US);
            let others: Vec<_> = others.map(|i| (i + 1).to_string()).collect();
            (self.say)(match change.get(channel) {
                Some(c) if *c > LEAST_CHANGE_US && others.is_empty() => {
                    Finding::Good(format!("channel {number}: {c:+.0} us came back for +100"))
                }
                Some(c) if *c < -LEAST_CHANGE_US => {
                    Finding::Wrong(format!("channel {number}: {c:+.0} us came back for +100"))
                }
                _ if !others.is_empty() => {
                    let list = others.join(", ");
                    Finding::Wrong(format!(
                        "channel {number} was moved, and channel {list} moved at the vehicle"
                    ))
                }
                _ => Finding::Wrong(format!("channel {number} was moved, and nothing moved at the vehicle")),
            });
        }
    }

    /// Determines the sign of each channel from the vehicle's own radio.
    fn signs(&mut self, inputs: &[Input], bridge: &BridgeConfig) {
        let (steering, sentences) = lock(&self.shared).vehicle.steering(inputs);
        for sentence in sentences {
            (self.say)(Finding::Told(sentence));
        }
        let output = bridge.options.mavlink.as_ref().map(|m| m.output);
        if let Some(line) = sticks::radio_line(bridge.kind, output) {
            if !steering.is_empty() {
                (self.say)(sticks::one_way(line, &steering));
            }
            return;
        }
        self.lend(true);
        for steering in steering {
            let finding = match self.resting() {
                Some(rest) => self.stick(steering, &rest),
                None => Finding::Unknown(format!(
                    "channel {}: which way it turns the vehicle, because the vehicle tells nothing of a radio of its own",
                    steering.channel + 1
                )),
            };
            (self.say)(finding);
        }
        self.lend(false);
    }

    /// Hands the channels over to the vehicle's own radio, or takes them back.
    fn lend(&mut self, lent: bool) {
        let mut shared = lock(&self.shared);
        let now = shared.now();
        shared.vehicle.lend(lent, now);
        shared.flush();
    }

    /// The vehicle's channels at rest.
    fn resting(&mut self) -> Option<Vec<f64>> {
        let begun = Instant::now();
        self.until(2 * PULSE_TIME, |shared| {
            let now = shared.now();
            let channels = shared.vehicle.sent_channels(PULSE_TIME / 2, now)?;
            (begun.elapsed() > PULSE_TIME).then_some(channels)
        })
    }

    fn stick(&mut self, steering: Steering, rest: &[f64]) -> Finding {
        let (name, place) = steering.stick();
        (self.say)(Finding::Ask(format!("now hold the {name} stick of the vehicle's own radio {place}")));
        let moved = self.until(self.timeout, |shared| {
            let now = shared.now();
            sticks::moved(rest, &shared.vehicle.sent_channels(PULSE_TIME, now)?)
        });
        let finding = sticks::judge(steering, moved);
        if moved.is_some() {
            (self.say)(Finding::Ask("and let it go".into()));
            let _: Option<()> = self.until(self.timeout, |shared| {
                let now = shared.now();
                let channels = shared.vehicle.sent_channels(PULSE_TIME, now)?;
                sticks::moved(rest, &channels).is_none().then_some(())
            });
        }
        finding
    }

    /// The vehicle's channels while one of them is moved.
    fn pushed(&mut self, channel: usize, by_us: f64) -> Option<Vec<f64>> {
        let begun = Instant::now();
        self.until(LONGEST_PULSE, |shared| {
            let now = shared.now();
            shared.vehicle.push(channel, by_us, now);
            shared.flush();
            let held = begun.elapsed();
            // Values received after half of the pulse include the movement.
            (held >= PULSE_TIME).then(|| shared.vehicle.sent_channels(held - PULSE_TIME / 2, now))?
        })
    }
}
