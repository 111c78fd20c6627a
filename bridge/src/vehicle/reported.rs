//! Log message of the state that a MAVLink vehicle reports: its mode, and how well its radios hear.

use std::time::Duration;

use whirlstand_msgs::{Message, Reported};

use crate::mavlink::{MavMessage, dialect};

/// Age from which a signal strength is unknown: radios report theirs about once a second.
const OLD: Duration = Duration::from_secs(3);

/// Largest signal strength; the next value means that it is not known.
const MOST: u8 = 254;

/// Reported state.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Report {
    /// Mode, its flags and the state of the last heartbeat.
    mode: Option<[u32; 3]>,
    /// Signal strengths at this end of the radio link, at the vehicle's end, and of the pilot's radio.
    signals: [Option<(f64, Duration)>; 3],
}

impl Report {
    /// Notes the heartbeat of the vehicle.
    pub(super) fn beat(&mut self, beat: &dialect::HEARTBEAT_DATA) {
        self.mode =
            Some([beat.custom_mode, u32::from(beat.base_mode.bits()), u32::from(beat.system_status as u8)]);
    }

    /// Notes signal strengths. The modem of a radio link speaks for itself, as a system of its own.
    pub(super) fn hear(&mut self, message: &MavMessage, is_vehicles: bool, now: Duration) {
        let share = |signal: u8| (signal <= MOST).then(|| (f64::from(signal) / f64::from(MOST), now));
        match message {
            MavMessage::RADIO_STATUS(m) => {
                (self.signals[0], self.signals[1]) = (share(m.rssi), share(m.remrssi));
            }
            MavMessage::RC_CHANNELS(m) if is_vehicles => self.signals[2] = share(m.rssi),
            _ => {}
        }
    }

    /// The log message, without its head.
    pub(super) fn message(&self, now: Duration) -> Reported {
        let young = |(share, at): (f64, Duration)| (now.saturating_sub(at) <= OLD).then_some(share);
        let [rssi, remote_rssi, pilot_rssi] = self.signals.map(|s| s.and_then(young).unwrap_or(f64::NAN));
        let [custom_mode, base_mode, system_status] = self.mode.unwrap_or_default();
        Reported {
            rssi,
            remote_rssi,
            pilot_rssi,
            custom_mode,
            base_mode,
            system_status,
            known: u32::from(self.mode.is_some()),
            ..Reported::zeroed()
        }
    }
}
