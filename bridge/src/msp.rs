//! Betaflight's answers in the MultiWii Serial Protocol, version 1: `$M>`, length, command, payload, and the exclusive or of
//! all from the length on.
//!
//! Source: `src/main/msp/msp.c` and `src/main/fc/runtime_config.h` of Betaflight; <https://www.multiwii.com/wiki/index.php?title=Multiwii_Serial_Protocol>.

use crate::stream::Stream;

/// Number of MSP_ATTITUDE: i16 roll and pitch in 0.1 deg, i16 heading in deg.
const ATTITUDE: u8 = 108;
/// Payload length of MSP_ATTITUDE in bytes.
const PAYLOAD: usize = 6;
/// Length of `$M>`, length and command.
const HEAD: usize = 5;

/// Number of MSP_STATUS_EX, and offset of its variable part: u8 length of further modes, these, u8 number of
/// arming flags, u32 flags.
const STATUS_EX: u8 = 150;
const FURTHER_MODES: usize = 15;

/// Number of MSP_MODE_RANGES: for each range u8 mode, u8 AUX channel from 0, u8 begin and end in steps of 25
/// us from 900 us. A range whose end is not after its begin is unused.
const MODE_RANGES: u8 = 34;
const RANGE: usize = 4;
const RANGES: usize = 20;
/// Number of the arming mode.
const ARM: u8 = 0;
const FIRST_AUX: usize = 5;

/// Request for the attitude: no payload.
pub(crate) const ATTITUDE_REQUEST: [u8; 6] = request(ATTITUDE);

/// Request for the state with the arming flags.
pub(crate) const STATUS_REQUEST: [u8; 6] = request(STATUS_EX);

/// Request for the switches of modes.
pub(crate) const RANGES_REQUEST: [u8; 6] = request(MODE_RANGES);

const fn request(command: u8) -> [u8; 6] {
    [b'$', b'M', b'<', 0, command, command]
}

/// A decoded answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Answer {
    /// Attitude, rad: right side down, nose up, clockwise.
    Attitude([f64; 3]),
    /// Reasons why it cannot be armed.
    Arming(ArmingFlags),
    /// Position of the pilot's arm switch.
    Switch(ArmSwitch),
}

/// Channels and pulses that arm it, as far as there are any: AUX channel, begin and end as sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ArmSwitch([Option<[u8; 3]>; RANGES]);

impl ArmSwitch {
    /// Reason why this pulse of a channel, from 1, does not arm; `None` when it does. Betaflight has no flag
    /// for that.
    pub(crate) fn reason(&self, channel: usize, pulse: u16) -> Option<String> {
        let us = |steps: u8| 900 + 25 * u16::from(steps);
        let range = |[aux, begin, end]: [u8; 3]| (FIRST_AUX + usize::from(aux), [us(begin), us(end)]);
        let ranges = || self.0.iter().flatten().copied().map(range);
        if ranges().any(|(at, [begin, end])| at == channel && (begin..end).contains(&pulse)) {
            return None;
        }
        let aux = (channel + 1).saturating_sub(FIRST_AUX);
        Some(match ranges().next() {
            Some((at, [begin, end])) => format!(
                "it is armed by channel {at} between {begin} and {end} us, and bridge.rc.arm_channel is {channel} with {pulse} us"
            ),
            None => format!(
                "no switch of the transmitter arms it: 'aux 0 0 {} 1700 2100 0 0' and 'save' in its command line make channel {} one",
                aux.saturating_sub(1),
                channel.max(FIRST_AUX)
            ),
        })
    }
}

/// Betaflight's reasons for not being armed, one bit each.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct ArmingFlags(u32);

/// Reasons by their bit, as numbered in releases since 4.3, with explanations.
const REASONS: [&str; 28] = [
    "NO_GYRO (no gyroscope was found)",
    "FAILSAFE (a failsafe is active)",
    "RX_LOSS (no valid signal of the receiver)",
    "NOT_DISARMED (the arm switch was on when the receiver came back)",
    "BOXFAILSAFE (the failsafe switch is on)",
    "RUNAWAY (it turned motors up without control)",
    "CRASH (a crash was detected)",
    "THROTTLE (the throttle is not low)",
    "ANGLE (the vehicle is not level)",
    "BOOTGRACE (it started a moment ago)",
    "NOPREARM (the prearm switch is off)",
    "LOAD (the processor is overloaded)",
    "CALIB (a sensor is being calibrated)",
    "CLI (its command line is open)",
    "CMS (its menu is open)",
    "BST (a blackbox or OSD device forbids it)",
    "MSP (a configurator forbids it)",
    "PARALYZE (it is paralysed)",
    "GPS (no fix for the rescue mode)",
    "RESCUE_SW (the rescue switch is on)",
    "DSHOT_TELEM (a motor tells no speed)",
    "REBOOT_REQUIRED (settings need a restart)",
    "DSHOT_BBANG (motor timing fails)",
    "ACC_CALIB (the accelerometer is not calibrated)",
    "MOTOR_PROTO (no motor protocol is set)",
    "CRASHFLIP (the crash flip switch is on)",
    "ALTHOLD (the altitude switch is on)",
    "POSHOLD (the position switch is on)",
];

impl ArmingFlags {
    /// Reasons as text; `None` without any. The last flag of every release, that the switch is on despite
    /// another reason, does not count.
    pub(crate) fn reason(self) -> Option<String> {
        let named = REASONS.iter().enumerate().filter(|(bit, _)| self.0 >> bit & 1 == 1);
        let named: Vec<_> = named.map(|(_, name)| *name).collect();
        (!named.is_empty()).then(|| named.join(", "))
    }
}

/// Finds answers in a stream of bytes.
#[derive(Debug, Clone, Default)]
pub(crate) struct Parser(Stream);

impl Parser {
    pub(crate) fn push(&mut self, bytes: &[u8]) {
        self.0.push(bytes);
    }

    /// The next known answer; `None` until more bytes arrive. Other bytes are skipped.
    pub(crate) fn next_answer(&mut self) -> Option<Answer> {
        loop {
            let bytes = self.0.waiting();
            let start = bytes.iter().position(|b| *b == b'$').unwrap_or(bytes.len());
            self.0.skip(start);
            let bytes = self.0.waiting();
            let head = bytes.first_chunk::<HEAD>()?;
            let length = usize::from(head[3]);
            if head[1] != b'M' || head[2] != b'>' {
                self.0.skip(1);
                continue;
            }
            let frame = bytes.get(..HEAD + length + 1)?;
            let sum = frame[3..HEAD + length].iter().fold(0, |sum, b| sum ^ b);
            let whole = sum == frame[HEAD + length];
            let payload = &frame[HEAD..HEAD + length];
            let answer = match head[4] {
                ATTITUDE if whole => attitude(payload),
                STATUS_EX if whole => arming(payload),
                MODE_RANGES if whole => Some(switch(payload)),
                _ => None,
            };
            self.0.skip(if whole { HEAD + length + 1 } else { 1 });
            if answer.is_some() {
                return answer;
            }
        }
    }
}

/// Betaflight's pitch is positive nose down.
fn attitude(payload: &[u8]) -> Option<Answer> {
    let payload = payload.first_chunk::<PAYLOAD>()?;
    let value = |at: usize| f64::from(i16::from_le_bytes([payload[at], payload[at + 1]]));
    let angles = [0.1 * value(0), -0.1 * value(2), value(4)].map(f64::to_radians);
    Some(Answer::Attitude(angles))
}

fn switch(payload: &[u8]) -> Answer {
    let mut switch = ArmSwitch([None; RANGES]);
    let ranges = payload.chunks_exact(RANGE).filter(|r| r[0] == ARM && r[2] < r[3]);
    for (slot, range) in switch.0.iter_mut().zip(ranges) {
        *slot = Some([range[1], range[2], range[3]]);
    }
    Answer::Switch(switch)
}

fn arming(payload: &[u8]) -> Option<Answer> {
    let further = usize::from(*payload.get(FURTHER_MODES)?);
    let rest = payload.get(FURTHER_MODES + 1 + further..)?;
    let (count, flags) = (*rest.first()?, u32::from_le_bytes(*rest.get(1..)?.first_chunk()?));
    // The last flag is the switch; it always occurs with another.
    let switch = u32::from(count).checked_sub(1).and_then(|bit| 1_u32.checked_shl(bit)).unwrap_or(0);
    Some(Answer::Arming(ArmingFlags(flags & !switch)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn frame(command: u8, payload: &[u8]) -> Vec<u8> {
        let mut bytes = vec![b'$', b'M', b'>', payload.len() as u8, command];
        bytes.extend(payload);
        bytes.push(bytes[3..].iter().fold(0, |sum, b| sum ^ b));
        bytes
    }

    #[test]
    fn arming_flags_are_read_behind_modes_of_any_length_and_the_switch_is_no_reason() {
        let said = |further: usize, count: u8, flags: u32| {
            let payload = [
                &[0; FURTHER_MODES][..],
                &[further as u8],
                &vec![9; further],
                &[count],
                &flags.to_le_bytes(),
                &[0],
            ];
            let mut parser = Parser::default();
            parser.push(&frame(STATUS_EX, &payload.concat()));
            match parser.next_answer() {
                Some(Answer::Arming(flags)) => flags.reason(),
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(said(0, 29, 0), None);
        assert_eq!(said(1, 29, 1 << 28), None, "the switch alone");
        let both = said(2, 29, 1 << 28 | 1 << 7 | 1 << 23).unwrap();
        assert_eq!(
            both,
            "THROTTLE (the throttle is not low), ACC_CALIB (the accelerometer is not calibrated)"
        );
        // In 4.2 the switch was bit 22.
        assert_eq!(said(1, 23, 1 << 22 | 1 << 9).unwrap(), "BOOTGRACE (it started a moment ago)");
    }

    #[test]
    fn a_switch_that_arms_nothing_is_told_with_what_would() {
        let reason = |ranges: &[[u8; 4]], channel, pulse| {
            let mut payload = ranges.concat();
            payload.resize(RANGE * RANGES, 0);
            let mut parser = Parser::default();
            parser.push(&frame(MODE_RANGES, &payload));
            match parser.next_answer() {
                Some(Answer::Switch(switch)) => switch.reason(channel, pulse),
                other => panic!("{other:?}"),
            }
        };
        // Angle mode on AUX 2, and arming on AUX 1 between 1700 and 2100 us.
        let set_up = [[1, 1, 32, 48], [ARM, 0, 32, 48]];
        assert_eq!(reason(&set_up, 5, 2000), None);
        let elsewhere =
            "it is armed by channel 5 between 1700 and 2100 us, and bridge.rc.arm_channel is 7 with 2000 us";
        assert_eq!(reason(&set_up, 7, 2000).unwrap(), elsewhere);
        let nowhere = reason(&[[1, 1, 32, 48]], 6, 2000).unwrap();
        assert!(nowhere.contains("'aux 0 0 1 1700 2100 0 0'") && nowhere.contains("channel 6"), "{nowhere}");
    }

    proptest! {
        #[test]
        fn attitudes_are_found_between_other_bytes_in_any_pieces(
            noise in prop::collection::vec(any::<u8>().prop_filter("no frame begins", |b| *b != b'$'), 0..40),
            raw in prop::array::uniform3(any::<i16>()),
            piece in 1usize..30,
        ) {
            let payload = raw.map(i16::to_le_bytes).concat();
            let stream = [&noise[..], &frame(100, &[1, 2, 3]), &noise, &frame(ATTITUDE, &payload), b"$$M"].concat();
            let (mut parser, mut found) = (Parser::default(), Vec::new());
            for bytes in stream.chunks(piece) {
                parser.push(bytes);
                found.extend(std::iter::from_fn(|| parser.next_answer()));
            }
            prop_assert_eq!(found, vec![attitude(&payload).unwrap()]);
        }

        #[test]
        fn any_bytes_are_taken_without_harm(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
            let mut parser = Parser::default();
            parser.push(&bytes);
            while parser.next_answer().is_some() {}
            prop_assert!(parser.0.waiting().len() < HEAD + 256);
        }
    }
}
