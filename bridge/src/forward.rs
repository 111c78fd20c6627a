//! Frames of a ground station on their way to the vehicle: they wait for the pauses between the outputs of the
//! loop, so that a station that sends much, as for an upload of parameters, delays no output.

use std::collections::VecDeque;
use std::time::Duration;

use crate::line::serial_line;
use crate::note::Notes;

/// Largest number of bytes that wait; a line of 57,600 baud without a loop carries them in 1.4 s.
const MOST_BYTES: usize = 8192;

/// Seconds per byte of a link without a baud rate.
const FAST: f64 = 1e-6;

/// Longest time between two outputs of a loop.
const LONGEST_INTERVAL: Duration = Duration::from_millis(50);

/// Wait after which a frame that is longer than the pauses is sent all the same; the output behind it is late.
const LONG_WAIT: Duration = Duration::from_millis(500);

/// Time until a line without a loop is free that counts as none.
const SOON: Duration = Duration::from_millis(1);

/// The waiting frames, and the occupation of the line.
#[derive(Debug)]
pub(crate) struct Forward {
    frames: VecDeque<Vec<u8>>,
    bytes: usize,
    dropped: u64,
    seconds_per_byte: f64,
    /// Shortest time between two outputs.
    period: Duration,
    /// Time from which the line is free of everything that was sent.
    free_at: Duration,
    output_at: Option<Duration>,
    /// Expected time of the next output.
    next_output: Duration,
    /// Time since which the first frame has been the first.
    first_since: Duration,
}

impl Forward {
    /// A queue for the line with this address, on which the loop has an output every `period` or less often.
    pub(crate) fn new(link: &str, period: Duration) -> Self {
        Self {
            frames: VecDeque::new(),
            bytes: 0,
            dropped: 0,
            seconds_per_byte: serial_line(link).map_or(FAST, |(baud, bits)| bits / baud),
            period,
            free_at: Duration::ZERO,
            output_at: None,
            next_output: Duration::ZERO,
            first_since: Duration::ZERO,
        }
    }

    /// Adds a frame, unless too many wait.
    pub(crate) fn push(&mut self, frame: &[u8], now: Duration, notes: &mut Notes) {
        if self.bytes + frame.len() > MOST_BYTES {
            self.dropped += 1;
            if self.dropped == 1 {
                notes.warn(
                    "the ground station sends more than the line carries besides the loop: the rest is left out",
                );
            }
            return;
        }
        if self.frames.is_empty() {
            self.first_since = now;
        }
        self.bytes += frame.len();
        self.frames.push_back(frame.to_vec());
    }

    /// Number of frames that were left out.
    pub(crate) fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Discards the frames, because the line was lost.
    pub(crate) fn clear(&mut self) {
        self.dropped += self.frames.len() as u64;
        self.frames.clear();
        self.bytes = 0;
    }

    /// Bytes of the loop were sent, with an output among them or not.
    pub(crate) fn sent(&mut self, bytes: usize, is_output: bool, now: Duration) {
        self.occupy(bytes, now);
        if is_output {
            let last = self.output_at.replace(now).map_or(self.period, |last| now.saturating_sub(last));
            self.next_output = now + last.min(LONGEST_INTERVAL).max(self.period);
        }
    }

    /// The next frame for which the line has room. It must be sent at once.
    pub(crate) fn next(&mut self, now: Duration) -> Option<Vec<u8>> {
        let length = self.frames.front()?.len();
        if !self.has_room(length, now) {
            return None;
        }
        self.occupy(length, now);
        self.bytes -= length;
        self.first_since = now;
        self.frames.pop_front()
    }

    fn has_room(&self, bytes: usize, now: Duration) -> bool {
        let begin = self.free_at.max(now);
        if now >= self.next_output + self.period {
            // The loop has no outputs.
            return begin <= now + SOON;
        }
        let waited = now.saturating_sub(self.first_since);
        begin + self.time_of(bytes) <= self.next_output || waited >= LONG_WAIT && begin <= self.next_output
    }

    fn occupy(&mut self, bytes: usize, now: Duration) {
        self.free_at = self.free_at.max(now) + self.time_of(bytes);
    }

    fn time_of(&self, bytes: usize) -> Duration {
        Duration::from_secs_f64(bytes as f64 * self.seconds_per_byte)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(20);

    fn forward(link: &str) -> (Forward, Notes) {
        (Forward::new(link, PERIOD), Notes::default())
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn a_frame_goes_when_it_has_passed_before_the_next_output() {
        let (mut forward, mut notes) = forward("serial:///dev/x:57600");
        // 50 bytes last 8.7 ms, 35 bytes 6.1 ms: one fits behind each output, and two do not.
        for _ in 0..3 {
            forward.push(&[0; 35], ms(99), &mut notes);
        }
        for k in 0..3 {
            let now = ms(100) + k * PERIOD;
            forward.sent(50, true, now);
            assert!(forward.next(now).is_some() && forward.next(now).is_none(), "{k}");
        }
        // A late output is not delayed further.
        forward.push(&[0; 35], ms(160), &mut notes);
        assert_eq!(forward.next(ms(165)), None);
        assert!(forward.next(ms(200)).is_some(), "the loop has no outputs any more");
    }

    #[test]
    fn a_frame_longer_than_the_pauses_goes_after_a_while() {
        let (mut forward, mut notes) = forward("serial:///dev/x:57600");
        forward.push(&[0; 280], ms(0), &mut notes);
        let mut went = Vec::new();
        for k in 0..50 {
            let now = k * PERIOD;
            forward.sent(50, true, now);
            went.extend(forward.next(now).map(|_| now));
        }
        assert_eq!(went, [LONG_WAIT]);
    }

    #[test]
    fn what_does_not_fit_is_left_out_counted_and_told_once() {
        let (mut forward, mut notes) = forward("udpin://0.0.0.0:14550");
        for _ in 0..100 {
            forward.push(&[0; 100], ms(1), &mut notes);
        }
        assert_eq!(forward.dropped(), 100 - (MOST_BYTES / 100) as u64);
        assert!(notes.take().is_some_and(|n| n.warn && n.text.contains("more than the line carries")));
        assert_eq!(notes.take(), None);
        let mut went = 0;
        for k in 0..20 {
            while forward.next(ms(100 + k)).is_some() {
                went += 1;
            }
        }
        assert_eq!(went, MOST_BYTES / 100);
        forward.push(&[0; 100], ms(200), &mut notes);
        forward.clear();
        assert_eq!((forward.next(ms(300)), forward.dropped()), (None, 100 - went as u64 + 1));
    }
}
