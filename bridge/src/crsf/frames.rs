//! Contents of CRSF frames.

use super::{SYNC, crc8, kind};

/// Number of channels in a frame.
pub const CHANNELS: usize = 16;
/// Bytes of 16 channels of 11 bits.
pub(super) const CHANNEL_BYTES: usize = 22;
/// Largest value of 11 bits.
const LARGEST: u16 = 0x7FF;

/// Sixteen channels in ticks, 0 to 2047; 172 is 988 us, 992 is 1500 us, 1811 is 2012 us.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Channels(pub [u16; CHANNELS]);

/// Attitude of the vehicle, rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attitude {
    /// Roll angle, right wing down is positive.
    pub roll: f64,
    /// Pitch angle, nose up is positive.
    pub pitch: f64,
    /// Yaw angle, clockwise seen from above is positive.
    pub yaw: f64,
}

/// State of the vehicle's battery.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Battery {
    /// Voltage, V.
    pub voltage_v: f64,
    /// Current, A.
    pub current_a: f64,
    /// Charge drawn, mAh.
    pub used_mah: u32,
    /// Remaining charge, percent.
    pub remaining_percent: u8,
}

/// Quality of the radio link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinkStatistics {
    /// Received signal at the vehicle, first antenna, dBm.
    pub uplink_rssi_dbm: i16,
    /// Share of packets that reach the vehicle, percent; 0 means a lost link.
    pub uplink_quality: u8,
    /// Signal-to-noise ratio at the vehicle, dB.
    pub uplink_snr_db: i8,
    /// Received signal at the handset, dBm.
    pub downlink_rssi_dbm: i16,
    /// Share of packets that reach the handset, percent.
    pub downlink_quality: u8,
}

/// Ticks of a pulse width by the published formula (TBS, CRSF, frame 0x16): (us - 1500) 8 / 5 + 992, limited
/// to 11 bits.
pub fn ticks_of_us(us: f64) -> u16 {
    let ticks = 992.0 + (us - 1500.0) * 8.0 / 5.0;
    // The conversion saturates; NaN would become 0, but does not occur here.
    (ticks.round() as u16).min(LARGEST)
}

/// Pulse width of ticks, us.
pub fn us_of_ticks(ticks: u16) -> f64 {
    1500.0 + (f64::from(ticks) - 992.0) * 5.0 / 8.0
}

/// Appends a frame of channels for a transmitter module.
pub fn write_channels(channels: &Channels, out: &mut Vec<u8>) {
    let mut payload = [0; CHANNEL_BYTES];
    pack_channels(&channels.0, &mut payload);
    write(SYNC, kind::CHANNELS, &payload, out);
}

/// Appends a frame of attitude telemetry, in steps of 0.0001 rad: what a vehicle sends.
pub fn write_attitude(attitude: &Attitude, out: &mut Vec<u8>) {
    let mut payload = [0; 6];
    for (bytes, angle) in payload.chunks_exact_mut(2).zip([attitude.pitch, attitude.roll, attitude.yaw]) {
        bytes.copy_from_slice(&((angle * 1e4).round() as i16).to_be_bytes());
    }
    write(SYNC, kind::ATTITUDE, &payload, out);
}

/// Packs channels of 11 bits, the first in the lowest bits of the first byte; SBUS uses the same packing.
pub(crate) fn pack_channels(channels: &[u16; CHANNELS], bytes: &mut [u8; CHANNEL_BYTES]) {
    let (mut bits, mut held, mut at) = (0u32, 0, 0);
    for channel in channels {
        bits |= u32::from((*channel).min(LARGEST)) << held;
        held += 11;
        while held >= 8 {
            bytes[at] = bits as u8;
            (bits, held, at) = (bits >> 8, held - 8, at + 1);
        }
    }
}

/// The reverse of [`pack_channels`].
pub(crate) fn unpack_channels(bytes: &[u8; CHANNEL_BYTES]) -> [u16; CHANNELS] {
    let mut channels = [0; CHANNELS];
    let (mut bits, mut held) = (0u32, 0);
    let mut bytes = bytes.iter();
    for channel in &mut channels {
        while held < 11 {
            bits |= u32::from(*bytes.next().unwrap_or(&0)) << held;
            held += 8;
        }
        *channel = (bits & u32::from(LARGEST)) as u16;
        (bits, held) = (bits >> 11, held - 11);
    }
    channels
}

fn write(address: u8, kind: u8, payload: &[u8], out: &mut Vec<u8>) {
    let start = out.len();
    // Payloads here are at most 22 bytes.
    out.extend_from_slice(&[address, payload.len() as u8 + 2, kind]);
    out.extend_from_slice(payload);
    out.push(crc8(&out[start + 2..]));
}

impl Attitude {
    pub(super) fn read(payload: &[u8]) -> Option<Self> {
        let [pitch, roll, yaw] = [0, 2, 4]
            .map(|i| payload.get(i..i + 2).map(|b| f64::from(i16::from_be_bytes([b[0], b[1]])) * 1e-4));
        Some(Self { roll: roll?, pitch: pitch?, yaw: yaw? })
    }
}

impl Battery {
    pub(super) fn read(payload: &[u8]) -> Option<Self> {
        let [v1, v0, c1, c0, u2, u1, u0, remaining] = *payload.first_chunk()?;
        Some(Self {
            voltage_v: f64::from(u16::from_be_bytes([v1, v0])) * 0.1,
            current_a: f64::from(u16::from_be_bytes([c1, c0])) * 0.1,
            used_mah: u32::from_be_bytes([0, u2, u1, u0]),
            remaining_percent: remaining,
        })
    }
}

impl LinkStatistics {
    pub(super) fn read(payload: &[u8]) -> Option<Self> {
        let [rssi, _, quality, snr, _, _, _, down_rssi, down_quality, _] = *payload.first_chunk()?;
        Some(Self {
            uplink_rssi_dbm: -i16::from(rssi),
            uplink_quality: quality,
            uplink_snr_db: snr as i8,
            downlink_rssi_dbm: -i16::from(down_rssi),
            downlink_quality: down_quality,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn pulse_widths_are_those_of_the_specification() {
        for (us, ticks) in
            [(987.5, 172), (988.0, 173), (1500.0, 992), (2012.0, 1811), (880.0, 0), (-1e9, 0), (1e9, 2047)]
        {
            assert_eq!(ticks_of_us(us), ticks, "{us}");
        }
        for ticks in 0..=LARGEST {
            assert_eq!(ticks_of_us(us_of_ticks(ticks)), ticks);
        }
    }

    proptest! {
        #[test]
        fn channels_survive_packing(channels in prop::array::uniform16(0u16..2048)) {
            let mut bytes = [0; CHANNEL_BYTES];
            pack_channels(&channels, &mut bytes);
            prop_assert_eq!(unpack_channels(&bytes), channels);
        }
    }
}
