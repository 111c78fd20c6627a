//! A blackbox log after Betaflight's documentation, "Blackbox Internals", written as the firmware writes it.

/// Time between frames, us.
pub const PERIOD_US: u32 = 1000;

/// Frames from one that stands for itself to the next.
const INTERVAL: u32 = 32;

/// The header, with a gyroscope's scale of 1 deg/s and motors from 48 to 2047.
pub const HEADER: &str = "H Product:Blackbox flight data recorder by Nicholas Sherlock\n\
    H Data version:2\n\
    H Field I name:loopIteration,time,gyroADC[0],setpoint[0],motor[0],motor[1],accSmooth[2],vbatLatest\n\
    H Field I signed:0,0,1,1,0,0,1,0\n\
    H Field I predictor:0,0,0,0,11,5,0,9\n\
    H Field I encoding:1,1,0,0,1,0,0,3\n\
    H Field P predictor:6,2,3,1,3,3,3,1\n\
    H Field P encoding:9,0,0,6,0,0,0,6\n\
    H Field S name:flightModeFlags,failsafePhase\n\
    H Field S signed:0,0\n\
    H Field S predictor:0,0\n\
    H Field S encoding:1,1\n\
    H Firmware type:Cleanflight\n\
    H Firmware revision:Betaflight 4.5.1 (77d01ba3b) STM32F7X2\n\
    H gyro_scale:0x3f800000\n\
    H motorOutput:48,2047\n\
    H acc_1G:2048\n\
    H vbatref:1600\n";

/// The fields behind the time in frame `k`: a rate of turn in deg/s, its target, two motors, acceleration, voltage.
pub fn fields(k: u32) -> [i32; 6] {
    let wave = (f64::from(k) * 0.05).sin();
    let rate = (300.0 * wave) as i32;
    [rate, rate + 5, 1000 + rate, 1000 - rate, 2048 + (k % 7) as i32, 1600 - (k / 50) as i32]
}

/// Appends a number, seven bits in a byte.
pub fn unsigned(out: &mut Vec<u8>, mut number: u32) {
    while number > 0x7f {
        out.push(number as u8 | 0x80);
        number >>= 7;
    }
    out.push(number as u8);
}

fn signed(out: &mut Vec<u8>, number: i32) {
    unsigned(out, (number << 1 ^ number >> 31) as u32);
}

/// The event that ends a log.
pub const END: &[u8] = b"E\xffEnd of log\0";

/// A log of `frames` frames from `start_us` on, those left out that `keep` does not keep.
pub fn log(header: &str, start_us: u32, frames: u32, keep: impl Fn(u32) -> bool) -> Vec<u8> {
    let mut out = header.as_bytes().to_vec();
    let mut before: Option<[[i32; 7]; 2]> = None;
    for k in 0..frames {
        if !keep(k) {
            // The logger begins anew.
            before = None;
            continue;
        }
        let mut row = [0; 7];
        row[0] = start_us.wrapping_add(k * PERIOD_US) as i32;
        row[1..].copy_from_slice(&fields(k));
        match before.filter(|_| k % INTERVAL != 0) {
            Some([last, first]) => {
                let mean = |field: usize| (last[field] + first[field]) / 2;
                out.push(b'P');
                let straight = last[0].wrapping_mul(2).wrapping_sub(first[0]);
                signed(&mut out, row[0].wrapping_sub(straight));
                signed(&mut out, row[1] - mean(1));
                signed(&mut out, row[2] - last[2]);
                signed(&mut out, row[3] - mean(3));
                signed(&mut out, row[4] - mean(4));
                signed(&mut out, row[5] - mean(5));
                signed(&mut out, row[6] - last[6]);
                before = Some([row, last]);
            }
            None => {
                out.push(b'I');
                unsigned(&mut out, k);
                unsigned(&mut out, row[0] as u32);
                signed(&mut out, row[1]);
                signed(&mut out, row[2]);
                unsigned(&mut out, (row[3] - 48) as u32);
                signed(&mut out, row[4] - row[3]);
                signed(&mut out, row[5]);
                unsigned(&mut out, ((1600 - row[6]) & 0x3fff) as u32);
                before = Some([row, row]);
            }
        }
        if k % 100 == 0 {
            out.extend([b'S', 3, (k / 100) as u8]);
        }
    }
    out.extend(END);
    out
}
