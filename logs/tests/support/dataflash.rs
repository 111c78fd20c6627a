//! A DataFlash log after ArduPilot's public format, "LogStructure.h": a writer, and a flight of two seconds.

/// Types of the messages of [`flight`].
const FMTU: u8 = 1;
const UNIT: u8 = 2;
const MULT: u8 = 3;
const PARM: u8 = 4;
const MSG: u8 = 5;
const IMU: u8 = 130;
const RATE: u8 = 131;
const ATT: u8 = 132;
const RCOU: u8 = 133;
const POS: u8 = 134;

/// Puts a log together.
#[derive(Default)]
pub struct Writer {
    pub bytes: Vec<u8>,
}

/// Text in a field of fixed length.
fn padded<const N: usize>(text: &str) -> [u8; N] {
    let mut field = [0; N];
    field[..text.len()].copy_from_slice(text.as_bytes());
    field
}

impl Writer {
    /// A message: its type, and the bytes of its fields.
    pub fn message(&mut self, kind: u8, fields: &[&[u8]]) {
        self.bytes.extend([0xa3, 0x95, kind]);
        self.bytes.extend(fields.concat());
    }

    /// The definition of a type whose messages have `length` bytes with their header.
    pub fn define(&mut self, kind: u8, length: u8, name: &str, format: &str, labels: &str) {
        self.message(
            128,
            &[&[kind, length], &padded::<4>(name), &padded::<16>(format), &padded::<64>(labels)],
        );
    }

    /// Ids of unit and multiplier of the fields of a type.
    fn describe(&mut self, kind: u8, units: &str, multipliers: &str) {
        self.message(FMTU, &[&0u64.to_le_bytes(), &[kind], &padded::<16>(units), &padded::<16>(multipliers)]);
    }
}

/// The messages of the log that say what the others are.
pub fn definitions() -> Writer {
    let mut log = Writer::default();
    log.define(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns");
    log.define(FMTU, 44, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds");
    log.define(UNIT, 76, "UNIT", "QbZ", "TimeUS,Id,Label");
    log.define(MULT, 20, "MULT", "Qbd", "TimeUS,Id,Mult");
    log.define(PARM, 35, "PARM", "QNff", "TimeUS,Name,Value,Default");
    log.define(MSG, 75, "MSG", "QZ", "TimeUS,Message");
    log.define(IMU, 20, "IMU", "QBff", "TimeUS,I,GyrX,AccZ");
    log.define(RATE, 19, "RATE", "Qff", "TimeUS,RDes,R");
    log.define(ATT, 15, "ATT", "Qcc", "TimeUS,DesRoll,Roll");
    log.define(RCOU, 15, "RCOU", "QHH", "TimeUS,C1,C2");
    log.define(POS, 15, "POS", "QL", "TimeUS,Lat");
    for (id, label) in [
        (b's', "s"),
        (b'E', "rad/s"),
        (b'k', "deg/s"),
        (b'd', "deg"),
        (b'D', "deglatitude"),
        (b'o', "m/s/s"),
        (b'Y', "us"),
        (b'#', "instance"),
        (b'-', ""),
    ] {
        log.message(UNIT, &[&0u64.to_le_bytes(), &[id], &padded::<64>(label)]);
    }
    for (id, factor) in [(b'-', 0.0), (b'0', 1.0), (b'B', 1e-2), (b'F', 1e-6), (b'G', 1e-7)] {
        log.message(MULT, &[&0u64.to_le_bytes(), &[id], &f64::to_le_bytes(factor)]);
    }
    log.describe(IMU, "s#Eo", "F-00");
    log.describe(RATE, "skk", "F00");
    log.describe(ATT, "sdd", "FBB");
    log.describe(RCOU, "sYY", "F--");
    log.describe(POS, "sD", "FG");
    log.message(PARM, &[&0u64.to_le_bytes(), &padded::<16>("ATC_RAT_RLL_P"), &[0; 8]]);
    log
}

/// Time of the first sample, us.
pub const START_US: u64 = 30_000_000;

/// Two seconds: two gyroscopes at 400 Hz, rates at 100 Hz, attitude at 50 Hz, outputs at 25 Hz, position at 5 Hz. The
/// rate of turn rises by 0.01 rad/s with every sample of the gyroscope that `keep` keeps.
pub fn flight(keep: impl Fn(u64) -> bool) -> Vec<u8> {
    let mut log = definitions();
    log.message(MSG, &[&START_US.to_le_bytes(), &padded::<64>("ArduCopter V4.5.7")]);
    for k in 0..=800u64 {
        let time = (START_US + k * 2500).to_le_bytes();
        let rate = k as f32 * 0.01;
        if keep(k) {
            for (sensor, rate) in [(0u8, rate), (1, -rate)] {
                log.message(IMU, &[&time, &[sensor], &rate.to_le_bytes(), &(-9.5f32).to_le_bytes()]);
            }
        }
        if k % 4 == 0 {
            log.message(RATE, &[&time, &90f32.to_le_bytes(), &(k as f32).to_le_bytes()]);
        }
        if k % 8 == 0 {
            log.message(ATT, &[&time, &(-4500i16).to_le_bytes(), &(k as i16).to_le_bytes()]);
        }
        if k % 16 == 0 {
            log.message(RCOU, &[&time, &(1100 + k as u16).to_le_bytes(), &1500u16.to_le_bytes()]);
        }
        if k % 80 == 0 {
            log.message(POS, &[&time, &473_977_000i32.to_le_bytes()]);
        }
    }
    log.bytes
}
