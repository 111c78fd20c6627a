//! A MAVLink autopilot as the source of measurements.

use std::time::Duration;

use super::clock::ns;
use super::output::euler;
use super::receivers::{Receivers, is_vehicle, rc_channels};
use super::reported::Report;
use super::requests::{Answer, Requests};
use super::telemetry::Group;
use super::warnings::Warnings;
use crate::config::{AttitudeMessage, MavlinkConfig, RatesMessage};
use crate::mavlink::{Counts, Deframer, Encoder, Event, Header, MavMessage, Readiness, Signing, dialect};
use crate::note::Notes;

/// Time between two heartbeats of the bridge.
const HEARTBEAT: Duration = Duration::from_secs(1);
/// Time between two time synchronisations, after the first ones.
const TIMESYNC: Duration = Duration::from_secs(1);
/// Time between the first time synchronisations.
const TIMESYNC_FIRST: Duration = Duration::from_millis(100);
/// Number of the first time synchronisations.
const FIRST_EXCHANGES: u32 = 16;
/// Message numbers.
const HIGHRES_IMU: u32 = 105;
const SCALED_IMU: u32 = 26;
/// Difference of time stamps from which they belong to different clocks, ns.
const OTHER_CLOCK_NS: i64 = 10_000_000_000;

/// Name of the autopilot in notes.
const NAME: &str = "the vehicle";

/// The other end of a MAVLink link.
pub(super) struct Autopilot {
    config: MavlinkConfig,
    timeout: Duration,
    deframer: Deframer,
    encoder: Encoder,
    requests: Requests,
    target: Option<(u8, u8)>,
    heartbeat_at: Option<Duration>,
    /// Armed state of the vehicle, with the reasons for not being armed.
    readiness: Readiness,
    well: bool,
    pub(super) report: Report,
    heading: Option<f64>,
    origin: Option<[f64; 3]>,
    /// Channels that the vehicle reports to receive, us, and the time of that report.
    sent_rc: Option<(Vec<f64>, Duration)>,
    next_heartbeat: Duration,
    next_timesync: Duration,
    exchanges: u32,
    warnings: Warnings,
    /// Number of messages of the vehicle.
    spoken: u64,
}

impl Autopilot {
    pub(super) fn new(
        config: &MavlinkConfig,
        rate_hz: f64,
        wants_odometry: bool,
        wants_rc: bool,
        timeout: Duration,
        signing: Option<Signing>,
    ) -> Self {
        let encoder = Encoder::new(config.system, config.component);
        let (deframer, encoder) = match signing {
            Some(s) => (Deframer::with_signing(s.clone()), encoder.with_signing(s)),
            None => (Deframer::new(), encoder),
        };
        let rate_hz = config.message_rate_hz.unwrap_or(rate_hz);
        let attitude = match config.attitude {
            AttitudeMessage::Euler => 30,
            AttitudeMessage::Quaternion => 31,
        };
        let wanted = [
            (true, attitude, rate_hz),
            (config.rates == RatesMessage::Imu, HIGHRES_IMU, rate_hz),
            (wants_odometry, 32, rate_hz),
            // Without a pilot they still show whether the outputs arrive.
            (true, 65, rate_hz.min(if wants_rc { 50.0 } else { 10.0 })),
        ];
        let wanted: Vec<_> =
            wanted.iter().filter(|w| w.0 && rate_hz > 0.0).map(|(_, id, rate)| (*id, *rate)).collect();
        Self {
            heading: config.heading,
            config: config.clone(),
            timeout,
            deframer,
            encoder,
            requests: Requests::new(&wanted),
            target: None,
            heartbeat_at: None,
            readiness: Readiness::new(NAME),
            well: true,
            report: Report::default(),
            origin: None,
            sent_rc: None,
            next_heartbeat: Duration::ZERO,
            next_timesync: Duration::ZERO,
            exchanges: 0,
            warnings: Warnings::default(),
            spoken: 0,
        }
    }

    pub(super) fn counts(&self) -> &Counts {
        self.deframer.counts()
    }

    /// Counts including those of unrecognised senders.
    pub(super) fn counts_with_strangers(&self) -> Counts {
        self.deframer.counts_with_strangers()
    }

    /// Number of messages of the vehicle.
    pub(super) fn spoken(&self) -> u64 {
        self.spoken
    }

    /// System and component id of the vehicle; 0 for all, before it was heard.
    pub(super) fn target(&self) -> (u8, u8) {
        self.target.unwrap_or((0, 0))
    }

    pub(super) fn is_known(&self) -> bool {
        self.target.is_some()
    }

    pub(super) fn is_linked(&self, now: Duration) -> bool {
        self.heartbeat_at.is_some_and(|at| now.saturating_sub(at) <= self.timeout)
    }

    pub(super) fn is_armed(&self) -> bool {
        self.readiness.is_armed()
    }

    pub(super) fn is_well(&self) -> bool {
        self.well
    }

    /// True when the loop requested the message with this number.
    pub(super) fn needs(&self, id: f32) -> bool {
        self.requests.asks_for(id)
    }

    /// Channels that the vehicle reports to receive, us.
    pub(super) fn sent_channels(&self, age: Duration, now: Duration) -> Option<Vec<f64>> {
        let (us, at) = self.sent_rc.as_ref()?;
        (now.saturating_sub(*at) <= age).then(|| us.clone())
    }

    /// Appends the frame of a message.
    pub(super) fn send(&mut self, message: &MavMessage, now: Duration, out: &mut Vec<u8>) {
        self.encoder.encode(message, now, out);
    }

    /// Requests everything again, after a reconnection or a restart of the vehicle.
    pub(super) fn begin_anew(&mut self) {
        self.requests.restart();
        (self.next_heartbeat, self.next_timesync) = (Duration::ZERO, Duration::ZERO);
        self.exchanges = 0;
        self.origin = None;
        self.heading = self.config.heading;
        let _ = self.deframer.end();
    }

    /// Resets for another address: the system id and the reports of the previous one are discarded.
    pub(super) fn forget(&mut self) {
        (self.target, self.heartbeat_at, self.sent_rc) = (None, None, None);
        (self.readiness, self.well, self.report) = (Readiness::new(NAME), true, Report::default());
        self.begin_anew();
    }

    /// True when a datagram of an unknown sender is the vehicle's: it contains the heartbeat of the awaited
    /// autopilot.
    pub(super) fn recognises(&mut self, datagram: &[u8], now: Duration, notes: &mut Notes) -> bool {
        let wanted = self.config.target_system;
        let found = self.deframer.recognises(
            datagram,
            now,
            |header, message| matches!(message, MavMessage::HEARTBEAT(beat) if is_vehicle(wanted, header, beat)),
        );
        if !found {
            self.warnings.look(&self.deframer.counts_with_strangers(), &self.config.link, notes);
        }
        found
    }

    /// Decodes bytes; `end` means that no frame continues after them.
    pub(super) fn receive(&mut self, bytes: &[u8], end: bool, now: Duration, receivers: &mut Receivers<'_>) {
        self.deframer.push(bytes);
        while let Some(event) = self.deframer.next(now) {
            if let Event::Message(header, message) = event {
                self.message(header, &message, now, receivers);
            }
        }
        if end {
            let _ = self.deframer.end();
        }
        self.warnings.look(&self.deframer.counts_with_strangers(), &self.config.link, receivers.notes);
    }

    fn message(
        &mut self,
        header: Header,
        message: &MavMessage,
        now: Duration,
        receivers: &mut Receivers<'_>,
    ) {
        if let MavMessage::HEARTBEAT(beat) = message {
            self.heartbeat(header, beat, now, receivers.notes);
        }
        let is_vehicles = self.target == Some((header.system, header.component));
        self.report.hear(message, is_vehicles, now);
        if !is_vehicles {
            return;
        }
        self.spoken += 1;
        self.requests.heard(mavlink::Message::message_id(message));
        self.readiness.hear(message, receivers.notes);
        match message {
            MavMessage::ATTITUDE(m) if self.config.attitude == AttitudeMessage::Euler => {
                let stamp = Some(i64::from(m.time_boot_ms) * 1_000_000);
                let taken = receivers.take(Group::Attitude, [m.roll, m.pitch, m.yaw], stamp, now);
                if taken && self.config.rates == RatesMessage::Attitude {
                    receivers.take(Group::Rates, [m.rollspeed, m.pitchspeed, m.yawspeed], stamp, now);
                }
            }
            MavMessage::ATTITUDE_QUATERNION(m) if self.config.attitude == AttitudeMessage::Quaternion => {
                let stamp = Some(i64::from(m.time_boot_ms) * 1_000_000);
                let angles = euler([m.q1, m.q2, m.q3, m.q4].map(f64::from)).unwrap_or([f64::NAN; 3]);
                let taken = receivers.telemetry.take(Group::Attitude, angles, stamp, now).is_ok();
                if taken && self.config.rates == RatesMessage::Attitude {
                    receivers.take(Group::Rates, [m.rollspeed, m.pitchspeed, m.yawspeed], stamp, now);
                }
            }
            MavMessage::HIGHRES_IMU(m) if self.config.rates == RatesMessage::Imu && m.id == 0 => {
                let stamp = i64::try_from(m.time_usec).ok().and_then(|us| us.checked_mul(1000));
                // Some autopilots stamp this message with the time of day.
                let same = |newest: i64| stamp.is_some_and(|s| s.abs_diff(newest) < OTHER_CLOCK_NS as u64);
                let stamp = stamp.filter(|_| receivers.telemetry.newest_ns().is_some_and(same));
                receivers.take(Group::Rates, [m.xgyro, m.ygyro, m.zgyro], stamp, now);
            }
            MavMessage::SCALED_IMU(m) => {
                self.scaled_imu([m.xgyro, m.ygyro, m.zgyro], m.time_boot_ms, now, receivers)
            }
            MavMessage::SCALED_IMU2(m) => {
                self.scaled_imu([m.xgyro, m.ygyro, m.zgyro], m.time_boot_ms, now, receivers)
            }
            MavMessage::SCALED_IMU3(m) => {
                self.scaled_imu([m.xgyro, m.ygyro, m.zgyro], m.time_boot_ms, now, receivers)
            }
            MavMessage::LOCAL_POSITION_NED(m) => self.position(m, now, receivers),
            MavMessage::RC_CHANNELS(m) => {
                let us = rc_channels(m);
                if let Some(pilot) = &mut receivers.pilot {
                    pilot.update(&us, false, now);
                }
                self.sent_rc = Some((us, now));
            }
            MavMessage::TIMESYNC(m) => self.timesync(m, now, receivers),
            MavMessage::COMMAND_ACK(ack) => match self.requests.acknowledged(ack, now) {
                Some(Answer::Refused(id, _)) => {
                    self.refused(id, "refuses to send message", receivers.notes);
                }
                Some(Answer::Accepted(_)) | None => {}
            },
            _ => {}
        }
    }

    fn heartbeat(
        &mut self,
        header: Header,
        beat: &dialect::HEARTBEAT_DATA,
        now: Duration,
        notes: &mut Notes,
    ) {
        if self.target.is_none() && is_vehicle(self.config.target_system, &header, beat) {
            self.target = Some((header.system, header.component));
            notes.info(format!(
                "heard the autopilot: system {}, component {}, MAVLink {}",
                header.system,
                header.component,
                if header.v2 { 2 } else { 1 }
            ));
        }
        if self.target != Some((header.system, header.component)) {
            return;
        }
        self.heartbeat_at = Some(now);
        self.report.beat(beat);
        self.readiness.set_armed(beat.base_mode.contains(dialect::MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED));
        use dialect::MavState as State;
        self.well = !matches!(
            beat.system_status,
            State::MAV_STATE_CRITICAL
                | State::MAV_STATE_EMERGENCY
                | State::MAV_STATE_POWEROFF
                | State::MAV_STATE_FLIGHT_TERMINATION
        );
    }

    fn scaled_imu(&self, gyro: [i16; 3], boot_ms: u32, now: Duration, receivers: &mut Receivers<'_>) {
        if self.config.rates == RatesMessage::Imu {
            let stamp = Some(i64::from(boot_ms) * 1_000_000);
            receivers.take(Group::Rates, gyro.map(|mrad| f32::from(mrad) * 1e-3), stamp, now);
        }
    }

    /// Transforms north, east, down to forward, right, up, relative to the vehicle's initial position and
    /// heading.
    fn position(
        &mut self,
        m: &dialect::LOCAL_POSITION_NED_DATA,
        now: Duration,
        receivers: &mut Receivers<'_>,
    ) {
        let yaw = receivers.telemetry.values(Group::Attitude).map(|[_, _, yaw]| yaw);
        let Some(heading) = self.heading.or(yaw) else { return };
        let stamp = Some(i64::from(m.time_boot_ms) * 1_000_000);
        let (sin, cos) = heading.sin_cos();
        let turn = |[n, e, d]: [f64; 3]| [n * cos + e * sin, e * cos - n * sin, -d];
        let (place, speed) = ([m.x, m.y, m.z].map(f64::from), [m.vx, m.vy, m.vz].map(f64::from));
        if !place.iter().all(|v| v.is_finite()) {
            // It is counted as invalid, and must not become the origin.
            let _ = receivers.telemetry.take(Group::Position, place, stamp, now);
            return;
        }
        self.heading = Some(heading);
        let origin = *self.origin.get_or_insert(place);
        let moved = [place[0] - origin[0], place[1] - origin[1], place[2] - origin[2]];
        let _ = receivers.telemetry.take(Group::Position, turn(moved), stamp, now);
        let _ = receivers.telemetry.take(Group::Speed, turn(speed), stamp, now);
    }

    fn timesync(&mut self, m: &dialect::TIMESYNC_DATA, now: Duration, receivers: &mut Receivers<'_>) {
        if m.tc1 == 0 {
            let answer = dialect::TIMESYNC_DATA { tc1: ns(now), ts1: m.ts1, ..Default::default() };
            self.encoder.encode(&MavMessage::TIMESYNC(answer), now, receivers.reply);
        } else if let Ok(sent) = u64::try_from(m.ts1) {
            let sent = Duration::from_nanos(sent);
            if sent <= now && now - sent < TIMESYNC {
                receivers.telemetry.clock().exchange(sent, m.tc1, now);
                self.exchanges += 1;
            }
        }
    }

    /// Sends heartbeats, requests and time synchronisations that are due.
    pub(super) fn poll(&mut self, now: Duration, notes: &mut Notes, out: &mut Vec<u8>) {
        if now >= self.next_heartbeat {
            self.next_heartbeat = now + HEARTBEAT;
            let beat = dialect::HEARTBEAT_DATA {
                mavtype: dialect::MavType::MAV_TYPE_GCS,
                autopilot: dialect::MavAutopilot::MAV_AUTOPILOT_INVALID,
                system_status: dialect::MavState::MAV_STATE_ACTIVE,
                base_mode: dialect::MavModeFlag::empty(),
                mavlink_version: 3,
                ..Default::default()
            };
            self.encoder.encode(&MavMessage::HEARTBEAT(beat), now, out);
        }
        let Some(target) = self.target else { return };
        if now >= self.next_timesync {
            let wait = if self.exchanges < FIRST_EXCHANGES { TIMESYNC_FIRST } else { TIMESYNC };
            self.next_timesync = now + wait;
            let ask = dialect::TIMESYNC_DATA { tc1: 0, ts1: ns(now), ..Default::default() };
            self.encoder.encode(&MavMessage::TIMESYNC(ask), now, out);
        }
        if !self.is_linked(now) {
            self.requests.silent(now);
        } else if let Some(text) = self.requests.renew(now) {
            notes.warn(text);
        }
        match self.requests.next(target, now) {
            Ok(Some(message)) => self.encoder.encode(&message, now, out),
            Ok(None) | Err(Answer::Accepted(_)) => {}
            Err(Answer::Refused(id, _)) => self.refused(id, "does not answer the request for message", notes),
        }
    }

    /// Handles a refused request: an autopilot without `HIGHRES_IMU` may have `SCALED_IMU`.
    fn refused(&mut self, id: u32, how: &str, notes: &mut Notes) {
        if id != HIGHRES_IMU || !self.requests.ask_instead(HIGHRES_IMU, SCALED_IMU) {
            notes.warn(format!("the autopilot {how} {id}: set its rate there"));
        }
    }

    /// Time at which something is due.
    pub(super) fn wake_at(&self) -> Duration {
        self.next_heartbeat.min(self.next_timesync)
    }
}
