//! The sequence of frames in a log, and the byte ranges that contain none.
//!
//! Most frames store only the difference from the frames before them, and there is no checksum. A frame counts
//! only if the letter of another frame follows its end and its time continues that of the frame before. After a
//! damaged frame, difference frames have no meaning until the next self-contained frame.

use super::encoding::{Broken, Bytes};
use super::header::{Frame, Header, Predictor, Storage};

/// Letters with which frames begin.
const LETTERS: &[u8] = b"IPSGHE";

/// Longest accepted time step from one frame to the next, us: the same as in Betaflight's own tools.
const LONGEST_STEP: u32 = 10_000_000;

/// Kind of a frame's data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Data logged at every iteration.
    Main,
    /// Data that change rarely.
    Slow,
    /// Data of the satellite receiver.
    Gps,
}

/// Result of reading a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Reading {
    /// Whether the log has its end mark.
    pub ended: bool,
    /// Number of byte ranges that contain no frame, except for one at the end.
    pub places: u64,
    /// Number of bytes in these ranges.
    pub bytes: u64,
    /// Offset of the first of them from the beginning of the log.
    pub first: usize,
}

/// Reads the frames of a log.
struct Frames<'a> {
    header: &'a Header,
    data: &'a [u8],
    /// The two preceding main frames, the last one first; `None` after damage.
    before: Option<[Vec<i64>; 2]>,
    /// Time of the last main frame, us.
    time: Option<u64>,
    /// A stored time that did not fit: of a main frame, or of an event that resumes logging.
    unconfirmed: Option<u32>,
    /// Home position, where the vehicle was armed.
    home: Vec<i64>,
}

/// Result of reading a frame.
enum Found {
    /// A row of numbers at a time in us.
    Row(Kind, u64, Vec<i64>),
    /// No data.
    Nothing,
    /// The end mark.
    End,
}

/// Reads all frames after the header. `visit` receives the kind, the time in us and the numbers of each.
pub(super) fn read(header: &Header, data: &[u8], visit: &mut dyn FnMut(Kind, u64, &[i64])) -> Reading {
    let mut frames = Frames { header, data, before: None, time: None, unconfirmed: None, home: Vec::new() };
    let mut reading = Reading::default();
    let mut open: Option<usize> = None;
    let mut at = header.end;
    while at < data.len() {
        let Ok((found, next)) = frames.frame(at, open.is_some()) else {
            open.get_or_insert(at);
            frames.before = None;
            at += 1;
            continue;
        };
        if let Some(from) = open.take() {
            if reading.places == 0 {
                reading.first = from;
            }
            reading.places += 1;
            reading.bytes += (at - from) as u64;
        }
        at = next;
        match found {
            Found::Row(kind, time, values) => visit(kind, time, &values),
            Found::Nothing => {}
            Found::End => {
                reading.ended = true;
                break;
            }
        }
    }
    reading
}

impl Frames<'_> {
    /// The frame at an offset, and the offset of its end. Where frames were `lost`, only a self-contained frame or
    /// the end mark is accepted.
    fn frame(&mut self, at: usize, lost: bool) -> Result<(Found, usize), Broken> {
        let mut bytes = Bytes::new(self.data, at);
        let letter = bytes.byte()?;
        if !LETTERS.contains(&letter) || (lost && !matches!(letter, b'I' | b'E')) {
            return Err(Broken);
        }
        let header = self.header;
        let row = match letter {
            b'I' => self.values(&mut bytes, &header.main, &header.main.whole, self.before.as_ref())?,
            b'P' if self.before.is_some() => {
                self.values(&mut bytes, &header.main, &header.main.difference, self.before.as_ref())?
            }
            b'S' => self.values(&mut bytes, &header.slow, &header.slow.whole, None)?,
            b'G' => self.values(&mut bytes, &header.gps, &header.gps.whole, None)?,
            b'H' => self.values(&mut bytes, &header.home, &header.home.whole, None)?,
            b'E' => return self.event(bytes, lost),
            _ => return Err(Broken),
        };
        self.is_followed(&bytes)?;
        Ok((self.taken(letter, row)?, bytes.at))
    }

    /// Checks that another frame or the end of the data follows.
    fn is_followed(&self, bytes: &Bytes<'_>) -> Result<(), Broken> {
        let fits = self.data.get(bytes.at).is_none_or(|next| LETTERS.contains(next));
        if fits { Ok(()) } else { Err(Broken) }
    }

    /// Takes in the numbers of a frame.
    fn taken(&mut self, letter: u8, row: Vec<i64>) -> Result<Found, Broken> {
        Ok(match (letter, self.time) {
            (b'S', Some(time)) => Found::Row(Kind::Slow, time, row),
            (b'G', Some(time)) => self.satellites(time, row)?,
            (b'H', _) => {
                self.home = row;
                Found::Nothing
            }
            (b'S' | b'G', None) => Found::Nothing,
            _ => {
                let time = self.main_time(row[self.header.time] as u32, letter == b'I').ok_or(Broken)?;
                self.time = Some(time);
                self.unconfirmed = None;
                // A self-contained frame also counts as the frame before the last one for the next.
                let last = match self.before.take() {
                    Some([last, _]) if letter == b'P' => last,
                    _ => row.clone(),
                };
                self.before = Some([row.clone(), last]);
                Found::Row(Kind::Main, time, row)
            }
        })
    }

    /// Takes in the numbers of a frame of the satellite receiver, after a main frame at `time` us.
    fn satellites(&self, time: u64, row: Vec<i64>) -> Result<Found, Broken> {
        let frame = &self.header.gps;
        let needs_home = frame.whole.predictors.iter().any(|p| matches!(p, Predictor::Home(_)));
        if needs_home && self.home.is_empty() {
            return Ok(Found::Nothing);
        }
        let since = match frame.names.iter().position(|name| name == "time") {
            Some(at) => (row[at] as u32).wrapping_sub(time as u32),
            None => 0,
        };
        if since > LONGEST_STEP {
            return Err(Broken);
        }
        Ok(Found::Row(Kind::Gps, time + u64::from(since), row))
    }

    /// Time of a main frame, extended where its 32 bits overflow; `None` if it is impossible.
    fn main_time(&mut self, stored: u32, whole: bool) -> Option<u64> {
        let Some(last) = self.time else { return Some(stored.into()) };
        let step = stored.wrapping_sub(last as u32);
        if step <= LONGEST_STEP {
            return Some(last + u64::from(step));
        }
        // Two times that fit each other outweigh the one before them: logging may have been off, or that one was
        // damaged.
        let confirmed = self.unconfirmed.is_some_and(|first| stored.wrapping_sub(first) <= LONGEST_STEP);
        if whole && confirmed {
            return Some(last.saturating_add_signed(i64::from(step as i32)));
        }
        if whole {
            self.unconfirmed = Some(stored);
        }
        None
    }

    fn event(&mut self, mut bytes: Bytes<'_>, lost: bool) -> Result<(Found, usize), Broken> {
        match bytes.byte()? {
            255 => {
                bytes.text(b"End of log")?;
                return Ok((Found::End, bytes.at));
            }
            _ if lost => return Err(Broken),
            // Events: a beep, disarming, a failure of the sensors.
            0 | 15 | 40 => {
                bytes.unsigned()?;
            }
            // Event: a setting was changed in flight.
            13 => {
                if bytes.byte()? & 0x80 == 0 {
                    bytes.signed()?;
                } else {
                    (0..4).try_for_each(|_| bytes.byte().map(|_| ()))?;
                }
            }
            // Event: logging resumes after a pause, with iteration and time.
            14 => {
                bytes.unsigned()?;
                let stored = bytes.unsigned()?;
                self.is_followed(&bytes)?;
                // The next frame must fit this time, otherwise it is damaged.
                self.unconfirmed = Some(stored);
                self.before = None;
                return Ok((Found::Nothing, bytes.at));
            }
            // Event: the flight mode and the one before.
            30 => {
                bytes.unsigned()?;
                bytes.unsigned()?;
            }
            _ => return Err(Broken),
        }
        self.is_followed(&bytes)?;
        Ok((Found::Nothing, bytes.at))
    }

    /// Decodes the numbers of a frame, given the two preceding frames of its kind.
    fn values(
        &self,
        bytes: &mut Bytes<'_>,
        frame: &Frame,
        storage: &Storage,
        before: Option<&[Vec<i64>; 2]>,
    ) -> Result<Vec<i64>, Broken> {
        let mut values: Vec<i64> = Vec::with_capacity(frame.names.len());
        for (encoding, count) in &storage.groups {
            for stored in &bytes.group(*encoding, *count)?[..*count] {
                let at = values.len();
                let (last, last_but_one) = before.map_or((0, 0), |[last, first]| (last[at], first[at]));
                let expected = match storage.predictors[at] {
                    Predictor::Constant(number) => number,
                    Predictor::Previous => last,
                    Predictor::StraightLine => 2 * last - last_but_one,
                    Predictor::Mean => (last + last_but_one) / 2,
                    Predictor::Increment => last + 1,
                    Predictor::Field(field) => values[field],
                    Predictor::Home(coordinate) => self.home.get(coordinate).copied().unwrap_or(0),
                    Predictor::MainTime => self.time.unwrap_or(0) as i64,
                };
                let sum = expected.wrapping_add(i64::from(*stored));
                values.push(if frame.signed[at] { i64::from(sum as i32) } else { i64::from(sum as u32) });
            }
        }
        if values.is_empty() { Err(Broken) } else { Ok(values) }
    }
}
