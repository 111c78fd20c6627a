//! Destinations of the contents of a MAVLink message.

use std::time::Duration;

use super::telemetry::{Group, Telemetry};
use crate::mavlink::{Header, dialect};
use crate::note::Notes;
use crate::pilot::Pilot;

/// Destinations of the contents of a received message.
pub(super) struct Receivers<'a> {
    pub(super) telemetry: &'a mut Telemetry,
    pub(super) pilot: Option<&'a mut Pilot>,
    pub(super) notes: &'a mut Notes,
    pub(super) reply: &'a mut Vec<u8>,
}

impl Receivers<'_> {
    pub(super) fn take(&mut self, group: Group, values: [f32; 3], stamp: Option<i64>, now: Duration) -> bool {
        self.telemetry.take(group, values.map(f64::from), stamp, now).is_ok()
    }
}

/// True when a heartbeat is that of an autopilot with the requested system id.
pub(super) fn is_vehicle(wanted: Option<u8>, header: &Header, beat: &dialect::HEARTBEAT_DATA) -> bool {
    beat.autopilot != dialect::MavAutopilot::MAV_AUTOPILOT_INVALID
        && beat.mavtype != dialect::MavType::MAV_TYPE_GCS
        && wanted.is_none_or(|system| system == header.system)
}

/// The channels in a message, us.
pub(super) fn rc_channels(m: &dialect::RC_CHANNELS_DATA) -> Vec<f64> {
    let all = [
        m.chan1_raw,
        m.chan2_raw,
        m.chan3_raw,
        m.chan4_raw,
        m.chan5_raw,
        m.chan6_raw,
        m.chan7_raw,
        m.chan8_raw,
        m.chan9_raw,
        m.chan10_raw,
        m.chan11_raw,
        m.chan12_raw,
        m.chan13_raw,
        m.chan14_raw,
        m.chan15_raw,
        m.chan16_raw,
    ];
    let count = usize::from(m.chancount).min(all.len());
    all[..count].iter().map(|us| f64::from(*us)).collect()
}
