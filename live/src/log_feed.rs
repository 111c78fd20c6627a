//! Plays a finished log, at any speed, from any place.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::Serialize;
use whirlstand_logs::{Log, LogStream, ReadError};

use crate::collector::{Collector, FRAME};
use crate::heard::Heard;
use crate::hub::Hub;

/// Slowest and fastest playing.
const SPEEDS: (f64, f64) = (0.01, 1000.0);

/// What is shown before the place that was asked for, s.
const LEAD_S: f64 = 60.0;

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
    /// Read, and not yet due.
    next: Option<Heard>,
    collector: Collector,
    hub: Hub,
    playback: Playback,
    /// Bench time that was played, s.
    at_s: f64,
    end_s: f64,
    ended: bool,
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
            next: None,
            collector,
            hub,
            playback,
            at_s: 0.0,
            end_s: 0.0,
            ended: false,
            last: Instant::now(),
            told: None,
        };
        while let Some(heard) = feed.read()? {
            if let Some(t) = bench_s(&heard) {
                feed.end_s = feed.end_s.max(t);
            }
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
            let passed = now.saturating_duration_since(self.last).min(Duration::from_secs(1));
            let until = (self.at_s + passed.as_secs_f64() * state.speed).min(self.end_s);
            self.play_until(until, now)?;
            self.at_s = until;
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
        (self.next, self.ended) = (None, false);
        self.collector.begin_anew();
        let state = *self.playback.state();
        let now = Instant::now();
        // What lies before the place is read without being shown, but for what a viewer can look back on.
        let mut shown_until = (place - LEAD_S).max(0.0);
        self.skip_until(shown_until)?;
        while shown_until < place {
            shown_until = (shown_until + 0.5).min(place);
            self.play_until(shown_until, now)?;
            self.at_s = shown_until;
            self.show(now, &state);
        }
        self.at_s = place;
        Ok(())
    }

    fn skip_until(&mut self, until: f64) -> Result<(), ReadError> {
        while let Some(heard) = self.due(until)? {
            if !matches!(heard, Heard::Health(_)) && bench_s(&heard).is_some_and(|t| t >= until) {
                self.next = Some(heard);
                break;
            }
        }
        Ok(())
    }

    fn play_until(&mut self, until: f64, now: Instant) -> Result<(), ReadError> {
        while let Some(heard) = self.due(until)? {
            self.collector.hear(&heard, now);
        }
        Ok(())
    }

    /// The next message, if it is due.
    fn due(&mut self, until: f64) -> Result<Option<Heard>, ReadError> {
        if self.next.is_none() && !self.ended {
            self.next = self.read()?;
            self.ended = self.next.is_none();
        }
        let is_due = |heard: &Heard| bench_s(heard).is_none_or(|t| t <= until);
        Ok(self.next.take_if(|heard| is_due(heard)))
    }

    fn read(&mut self) -> Result<Option<Heard>, ReadError> {
        while let Some(raw) = self.stream.next()? {
            if let Some(heard) = Heard::decode(&raw)? {
                return Ok(Some(heard));
            }
        }
        Ok(None)
    }
}

/// Bench time, s; `None` for health, which has the wall clock's and is due when it is read.
fn bench_s(heard: &Heard) -> Option<f64> {
    match heard {
        Heard::Health(_) => None,
        other => Some(other.head().stamp_ns as f64 * 1e-9),
    }
}
