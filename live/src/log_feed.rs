//! Plays a finished log, at any speed and from any position.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::Serialize;
use whirlstand_logs::{BenchMessage, Log, LogStream, ReadError};

use crate::collector::{Collector, FRAME, MOST_ROWS};
use crate::hub::Hub;

/// Lowest and highest playing speed.
const SPEEDS: (f64, f64) = (0.01, 1000.0);

/// Bench time that is shown before a requested position, s.
const LEAD_S: f64 = 60.0;

/// Messages that are read ahead: more than a full queue of every topic.
const AHEAD: usize = 10 * whirlstand_bus::MAX_DEPTH;

/// Most frames that are sent at once, in a turn or up to a requested position. A viewer's queue holds more.
const FRAMES_OF_A_TURN: usize = 16;
const FRAMES_OF_A_PLACE: usize = 128;

/// Longest wall-clock time that counts in one turn.
const LONGEST_TURN: Duration = Duration::from_millis(100);

/// Longest time between two frames.
const HEARTBEAT: Duration = Duration::from_secs(1);

/// State of playing, shared by the player and all viewers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct State {
    /// Speed: bench seconds per second.
    speed: f64,
    paused: bool,
    /// Requested position, s of bench time.
    #[serde(skip)]
    go_to: Option<f64>,
}

/// Shared control of how a log is played.
#[derive(Debug, Clone)]
pub struct Playback(Arc<Mutex<State>>);

impl Playback {
    /// Playing at a given speed.
    ///
    /// # Errors
    /// As [`Self::set`].
    pub fn new(speed: f64) -> Result<Self, String> {
        let playback = Self(Arc::new(Mutex::new(State { speed: 1.0, paused: false, go_to: None })));
        playback.set("speed", speed)?;
        Ok(playback)
    }

    /// Sets `speed`, `paused` (0 or 1) or `place` (s of bench time).
    ///
    /// # Errors
    /// A sentence, for another key or a value outside its limits.
    pub fn set(&self, key: &str, value: f64) -> Result<(), String> {
        let mut state = self.state();
        let (slowest, fastest) = SPEEDS;
        match key {
            "speed" if (slowest..=fastest).contains(&value) => state.speed = value,
            "speed" => return Err(format!("a speed from {slowest} to {fastest} is expected, not {value}")),
            "paused" => state.paused = value != 0.0,
            "place" if value.is_finite() => state.go_to = Some(value.max(0.0)),
            _ => return Err(format!("'{key}' cannot be set to {value}: speed, paused and place can be set")),
        }
        Ok(())
    }

    fn state(&self) -> MutexGuard<'_, State> {
        // After a panic in another thread the three numbers are still valid.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A frame together with the state of playing.
#[derive(Serialize)]
struct Played<'a, F: Serialize> {
    #[serde(flatten)]
    frame: F,
    play: Play<'a>,
}

#[derive(Serialize)]
struct Play<'a> {
    #[serde(flatten)]
    state: &'a State,
    at_s: f64,
    end_s: f64,
}

/// A feed from a log.
pub struct LogFeed {
    log: Log,
    stream: LogStream,
    ahead: Ahead,
    collector: Collector,
    hub: Hub,
    playback: Playback,
    /// Bench time up to which the log was played, s.
    at_s: f64,
    end_s: f64,
    last: Instant,
    /// State and position that were sent last, and when.
    told: Option<((State, f64), Instant)>,
}

impl LogFeed {
    /// Opens a log. It is read once as a whole to find its end.
    ///
    /// # Errors
    /// The log cannot be read.
    pub fn open(log: Log, collector: Collector, hub: Hub, playback: Playback) -> Result<Self, ReadError> {
        collector.greet(&hub);
        let stream = log.stream()?;
        let mut feed = Self {
            stream,
            log,
            ahead: Ahead::default(),
            collector,
            hub,
            playback,
            at_s: 0.0,
            end_s: 0.0,
            last: Instant::now(),
            told: None,
        };
        while let Some(heard) = read(&mut feed.stream)? {
            feed.end_s = feed.end_s.max(bench_s(&heard).unwrap_or(0.0));
        }
        feed.stream = feed.log.stream()?;
        Ok(feed)
    }

    /// Plays the messages that are due and sends a frame. Returns the time of the next call.
    ///
    /// # Errors
    /// The log cannot be read.
    pub fn turn(&mut self, now: Instant) -> Result<Instant, ReadError> {
        let place = self.playback.state().go_to.take();
        let state = *self.playback.state();
        if let Some(place) = place {
            self.go_to(place.min(self.end_s))?;
        } else if !state.paused {
            // A delayed player continues from where it was.
            let passed = now.saturating_duration_since(self.last).min(LONGEST_TURN);
            let until = (self.at_s + passed.as_secs_f64() * state.speed).min(self.end_s);
            self.show_until(until, FRAMES_OF_A_TURN, now, &state)?;
        }
        self.last = now;
        // While nothing changes, a frame is still sent from time to time to show that the player is alive.
        let told = (state, self.at_s);
        if self.told.is_none_or(|(before, at)| before != told || now.duration_since(at) >= HEARTBEAT) {
            self.told = Some((told, now));
            self.show(now, &state);
        }
        Ok(now + FRAME)
    }

    /// Whether the whole log was played.
    pub fn is_at_end(&self) -> bool {
        self.at_s >= self.end_s
    }

    fn show(&mut self, now: Instant, state: &State) {
        let frame = self.collector.frame(now, 0, true);
        let anew = frame.anew;
        let play = Play { state, at_s: self.at_s, end_s: self.end_s };
        self.hub.publish(&Played { frame, play }, anew);
    }

    fn go_to(&mut self, place: f64) -> Result<(), ReadError> {
        self.stream = self.log.stream()?;
        self.ahead = Ahead::default();
        self.collector.begin_anew();
        let state = *self.playback.state();
        let now = Instant::now();
        // Messages before the position are read without being shown, except for those that a viewer can look
        // back on.
        self.at_s = (place - LEAD_S).max(0.0);
        self.skip_until(self.at_s)?;
        self.show_until(place, FRAMES_OF_A_PLACE, now, &state)
    }

    /// Plays up to a time, in as many frames as needed to show every step, but at most `most`.
    fn show_until(&mut self, until: f64, most: usize, now: Instant, state: &State) -> Result<(), ReadError> {
        let (from, steps) = (self.at_s, (until - self.at_s) / self.collector.period_s());
        // Both ends of an interval may have a row.
        let frames = ((steps / (MOST_ROWS - 1) as f64).ceil() as usize).clamp(1, most);
        for i in 1..=frames {
            let part = from + (until - from) * i as f64 / frames as f64;
            self.play_until(part, now)?;
            self.at_s = part;
            if i < frames {
                self.show(now, state);
            }
        }
        self.at_s = until;
        Ok(())
    }

    fn skip_until(&mut self, until: f64) -> Result<(), ReadError> {
        while self.ahead.next(&mut self.stream, |t| t < until)?.is_some() {}
        Ok(())
    }

    fn play_until(&mut self, until: f64, now: Instant) -> Result<(), ReadError> {
        while let Some(heard) = self.ahead.next(&mut self.stream, |t| t <= until)? {
            self.collector.hear(&heard, now);
        }
        Ok(())
    }
}

/// Messages that were read before they are due. A recorder writes a queue of one topic after the other, so the
/// messages of one step are far apart in the file.
#[derive(Default)]
struct Ahead {
    /// Messages by run of the plant, bench time in ns, and order in the file.
    waiting: BTreeMap<(u32, u64, u64), BenchMessage>,
    run: u32,
    /// Step and time of the latest truth or measurement.
    newest: (u64, u64),
    read: u64,
    ended: bool,
}

impl Ahead {
    /// The next message in the order of bench time, if `is_due` accepts its time in s.
    fn next(
        &mut self,
        stream: &mut LogStream,
        is_due: impl Fn(f64) -> bool,
    ) -> Result<Option<BenchMessage>, ReadError> {
        while !self.ended && self.waiting.len() < AHEAD {
            match read(stream)? {
                Some(heard) => self.take(heard),
                None => self.ended = true,
            }
        }
        let entry = self.waiting.first_entry().filter(|entry| is_due(entry.key().1 as f64 * 1e-9));
        Ok(entry.map(|entry| entry.remove()))
    }

    fn take(&mut self, heard: BenchMessage) {
        let head = *heard.head();
        if let BenchMessage::Imu(_) = heard {
            self.run += u32::from(head.step < self.newest.0);
            self.newest = (head.step, head.stamp_ns);
        }
        // `Health` carries wall-clock time, so it is due with the message that was written before it.
        let ns = if bench_s(&heard).is_some() { head.stamp_ns } else { self.newest.1 };
        self.waiting.insert((self.run, ns, self.read), heard);
        self.read += 1;
    }
}

fn read(stream: &mut LogStream) -> Result<Option<BenchMessage>, ReadError> {
    while let Some(raw) = stream.next()? {
        if let Some(heard) = BenchMessage::decode(&raw)? {
            return Ok(Some(heard));
        }
    }
    Ok(None)
}

/// Bench time, s; `None` for `Health`, which carries wall-clock time.
fn bench_s(heard: &BenchMessage) -> Option<f64> {
    heard.bench_ns().map(|ns| ns as f64 * 1e-9)
}
