//! Plays a finished log, at any speed, from any place.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::Serialize;
use whirlstand_logs::{BenchMessage, Log, LogStream, ReadError};

use crate::collector::{Collector, FRAME, MOST_ROWS};
use crate::hub::Hub;

/// Slowest and fastest playing.
const SPEEDS: (f64, f64) = (0.01, 1000.0);

/// What is shown before the place that was asked for, s.
const LEAD_S: f64 = 60.0;

/// Messages that are read ahead: a queue full of every topic, and some.
const AHEAD: usize = 10 * whirlstand_bus::MAX_DEPTH;

/// Most frames at once: those of a turn, and those up to a place that somebody goes to. A viewer can be behind by more.
const FRAMES_OF_A_TURN: usize = 16;
const FRAMES_OF_A_PLACE: usize = 128;

/// Longest time that counts as one turn.
const LONGEST_TURN: Duration = Duration::from_millis(100);

/// Longest time between two frames.
const HEARTBEAT: Duration = Duration::from_secs(1);

/// How a log is played; shared by the player and all viewers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct State {
    /// Bench seconds in a second.
    speed: f64,
    paused: bool,
    /// A place to go to, s of bench time.
    #[serde(skip)]
    go_to: Option<f64>,
}

/// How a log is played.
#[derive(Debug, Clone)]
pub struct Playback(Arc<Mutex<State>>);

impl Playback {
    /// Plays at a speed.
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
    /// A sentence, for another key or a value beyond its limits.
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
        // Three numbers that are right whatever happened.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A frame, and how the log is played.
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
    /// Bench time that was played, s.
    at_s: f64,
    end_s: f64,
    last: Instant,
    /// What was told last, and when.
    told: Option<((State, f64), Instant)>,
}

impl LogFeed {
    /// Opens a log; all of it is read once, for its end.
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

    /// Plays what is due and hands on a frame; says when the next is due.
    ///
    /// # Errors
    /// The log cannot be read.
    pub fn turn(&mut self, now: Instant) -> Result<Instant, ReadError> {
        let place = self.playback.state().go_to.take();
        let state = *self.playback.state();
        if let Some(place) = place {
            self.go_to(place.min(self.end_s))?;
        } else if !state.paused {
            // A player that was held up goes on from where it was.
            let passed = now.saturating_duration_since(self.last).min(LONGEST_TURN);
            let until = (self.at_s + passed.as_secs_f64() * state.speed).min(self.end_s);
            self.show_until(until, FRAMES_OF_A_TURN, now, &state)?;
        }
        self.last = now;
        // While nothing moves a frame now and then says that somebody is there.
        let told = (state, self.at_s);
        if self.told.is_none_or(|(before, at)| before != told || now.duration_since(at) >= HEARTBEAT) {
            self.told = Some((told, now));
            self.show(now, &state);
        }
        Ok(now + FRAME)
    }

    /// Whether all was played.
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
        // What lies before the place is read without being shown, but for what a viewer can look back on.
        self.at_s = (place - LEAD_S).max(0.0);
        self.skip_until(self.at_s)?;
        self.show_until(place, FRAMES_OF_A_PLACE, now, &state)
    }

    /// Plays until a time, in as many frames as show every step, but no more than so many.
    fn show_until(&mut self, until: f64, most: usize, now: Instant, state: &State) -> Result<(), ReadError> {
        let (from, steps) = (self.at_s, (until - self.at_s) / self.collector.period_s());
        // Both ends of a piece may have a row.
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

/// Messages that were read before they are due. A recorder writes a queue full of one topic after the other, so that those
/// of a step stand far from each other in the file.
#[derive(Default)]
struct Ahead {
    /// By the run of the plant, bench time in ns, and the order in the file.
    waiting: BTreeMap<(u32, u64, u64), BenchMessage>,
    run: u32,
    /// Step and time of the last truth or measurement.
    newest: (u64, u64),
    read: u64,
    ended: bool,
}

impl Ahead {
    /// The next message in the order of bench time, if `is_due` says so of its time in s.
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
        // Health has the wall clock's time: it is due with what was written before it.
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

/// Bench time, s; `None` for health, which has the wall clock's.
fn bench_s(heard: &BenchMessage) -> Option<f64> {
    heard.bench_ns().map(|ns| ns as f64 * 1e-9)
}
