//! CRSF, the serial protocol of Crossfire and ExpressLRS: channels out, telemetry in.
//!
//! A frame is sync or address, length, type, payload, CRC8 (DVB-S2 polynomial 0xD5) over type and payload; the length
//! counts type, payload and CRC. Numbers in telemetry are big-endian, channels are 16 times 11 bits little-endian.
//! The serial line runs at 416 666 or 420 000 baud, 8N1.
//!
//! Source: the CRSF specification, <https://github.com/crsf-wg/crsf/wiki>.
//! The crate `crsf` 2.0 decodes channels and link statistics only, and gives up the bytes behind each frame of less
//! than 64; so the codec is here, and that crate is the independent reader of the tests.

mod frames;
mod parser;

pub use frames::{
    Attitude, Battery, Channels, LinkStatistics, ticks_of_us, us_of_ticks, write_attitude, write_channels,
};
pub(crate) use frames::{pack_channels, unpack_channels};
pub use parser::{Counts, Event, Parser};

/// First byte of a frame, which is the address of a flight controller as well.
pub const SYNC: u8 = 0xC8;
/// First byte of some handsets' frames: the address of a transmitter module.
pub const TRANSMITTER: u8 = 0xEE;
/// First byte of some transmitter modules' telemetry: the address of a handset.
pub const HANDSET: u8 = 0xEA;
/// Longest frame.
pub const LONGEST_FRAME: usize = 64;
/// Baud rate of ExpressLRS.
pub const BAUD: u32 = 420_000;

/// Types of frames.
mod kind {
    pub const BATTERY: u8 = 0x08;
    pub const LINK_STATISTICS: u8 = 0x14;
    pub const CHANNELS: u8 = 0x16;
    pub const ATTITUDE: u8 = 0x1E;
}

/// CRC-8/DVB-S2: polynomial 0xD5, initial value 0, not reflected.
fn crc8(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |crc, byte| CRC8[usize::from(crc ^ byte)])
}

const CRC8: [u8; 256] = {
    let mut table = [0; 256];
    let mut i = 0;
    while i < table.len() {
        let mut crc = i as u8;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 0x80 != 0 { (crc << 1) ^ 0xD5 } else { crc << 1 };
            bit += 1;
        }
        table[i] = crc;
        i += 1;
    }
    table
};
