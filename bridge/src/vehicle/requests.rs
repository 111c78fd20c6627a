//! Requests an autopilot to send the messages that the loop needs, until it accepts, and again when they come
//! too rarely, because another station has asked for another rate.

use std::time::Duration;

use crate::mavlink::{MavMessage, dialect};

/// Time after which an unanswered request is repeated.
const AGAIN: Duration = Duration::from_millis(500);

/// Largest number of unanswered requests per message.
const TRIES: u32 = 10;

/// Time over which the rate of a message is measured.
const WINDOW: Duration = Duration::from_secs(2);

/// Longest time between two requests for a message that stays too rare: a vehicle may have accepted a rate that
/// it or its line does not reach.
const LONGEST_PAUSE: Duration = Duration::from_secs(64);

/// Answer of an autopilot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// The autopilot will send the message with this number.
    Accepted(u32),
    /// The autopilot will not send the message with this number; the flag is true when it refused and false when it did
    /// not answer.
    Refused(u32, bool),
}

#[derive(Debug, Clone)]
struct Request {
    id: u32,
    interval_us: f32,
    tries: u32,
    due: Duration,
    done: bool,
    accepted: bool,
    asked_at: Duration,
    /// Messages since the beginning of the window.
    heard: u32,
    since: Duration,
    /// Time after the last request until a message that is too rare is requested again.
    pause: Duration,
}

impl Request {
    fn new(id: u32, interval_us: f32) -> Self {
        Self {
            id,
            interval_us,
            tries: 0,
            due: Duration::ZERO,
            done: false,
            accepted: false,
            asked_at: Duration::ZERO,
            heard: 0,
            since: Duration::ZERO,
            pause: WINDOW,
        }
    }

    fn begin_window(&mut self, now: Duration) {
        (self.heard, self.since) = (0, now);
    }

    /// Rates that were accepted and are measured, Hz, at the end of a window in which the message came less
    /// than half as often as requested.
    fn too_rare(&mut self, now: Duration) -> Option<(f64, f64)> {
        let window = now.saturating_sub(self.since);
        if !self.accepted || !self.done || window < WINDOW {
            return None;
        }
        let (wanted, measured) =
            (1e6 / f64::from(self.interval_us), f64::from(self.heard) / window.as_secs_f64());
        self.begin_window(now);
        if 2.0 * measured >= wanted {
            self.pause = WINDOW;
            return None;
        }
        Some((wanted, measured)).filter(|_| now.saturating_sub(self.asked_at) >= self.pause)
    }
}

/// Requests of `SET_MESSAGE_INTERVAL`, one in flight at a time because an answer does not say which it answers.
#[derive(Debug, Clone, Default)]
pub struct Requests {
    list: Vec<Request>,
}

impl Requests {
    /// Requests for messages and their rates, Hz.
    pub fn new(wanted: &[(u32, f64)]) -> Self {
        let list = wanted.iter().map(|(id, rate_hz)| Request::new(*id, (1e6 / rate_hz) as f32)).collect();
        Self { list }
    }

    /// Requests another message in place of a refused one, at its rate; false when it is on the list already.
    pub fn ask_instead(&mut self, refused: u32, id: u32) -> bool {
        if self.list.iter().any(|r| r.id == id) {
            return false;
        }
        let like = self.list.iter().find(|r| r.id == refused).cloned();
        self.list.extend(like.map(|r| Request::new(id, r.interval_us)));
        true
    }

    /// True when a message with this number is on the list.
    pub fn asks_for(&self, id: f32) -> bool {
        self.list.iter().any(|r| r.id as f32 == id)
    }

    /// Requests everything again, after the autopilot restarted or reconnected.
    pub fn restart(&mut self) {
        for request in &mut self.list {
            *request = Request::new(request.id, request.interval_us);
        }
    }

    /// Counts a message of the autopilot.
    pub fn heard(&mut self, id: u32) {
        if let Some(request) = self.list.iter_mut().find(|r| r.id == id) {
            request.heard += 1;
        }
    }

    /// Begins to measure anew, because the autopilot is silent altogether.
    pub fn silent(&mut self, now: Duration) {
        self.list.iter_mut().for_each(|request| request.begin_window(now));
    }

    /// Requests a message again that has become too rare, and returns a text about it.
    pub fn renew(&mut self, now: Duration) -> Option<String> {
        self.list.iter_mut().find_map(|request| {
            let (wanted, measured) = request.too_rare(now)?;
            request.pause = (2 * request.pause).min(LONGEST_PAUSE);
            (request.tries, request.due, request.done) = (0, now, false);
            Some(format!(
                "message {} arrives {measured:.1} times a second instead of {wanted:.0}: its rate is asked for again",
                request.id
            ))
        })
    }

    /// The next request to this system and component, if one is due.
    pub fn next(&mut self, target: (u8, u8), now: Duration) -> Result<Option<MavMessage>, Answer> {
        let Some(request) = self.list.iter_mut().find(|r| !r.done) else { return Ok(None) };
        if now < request.due {
            return Ok(None);
        }
        if request.tries == TRIES {
            request.done = true;
            // An autopilot that answered before is measured on.
            return if request.accepted { Ok(None) } else { Err(Answer::Refused(request.id, false)) };
        }
        request.tries += 1;
        (request.asked_at, request.due) = (now, now + AGAIN);
        Ok(Some(MavMessage::COMMAND_LONG(dialect::COMMAND_LONG_DATA {
            command: dialect::MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
            param1: request.id as f32,
            param2: request.interval_us,
            confirmation: (request.tries - 1) as u8,
            target_system: target.0,
            target_component: target.1,
            ..Default::default()
        })))
    }

    /// Processes an answer.
    pub fn acknowledged(&mut self, ack: &dialect::COMMAND_ACK_DATA, now: Duration) -> Option<Answer> {
        if ack.command != dialect::MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL {
            return None;
        }
        let request = self.list.iter_mut().find(|r| !r.done && r.tries > 0)?;
        match ack.result {
            dialect::MavResult::MAV_RESULT_ACCEPTED => {
                (request.done, request.accepted) = (true, true);
                request.begin_window(now);
                Some(Answer::Accepted(request.id))
            }
            dialect::MavResult::MAV_RESULT_TEMPORARILY_REJECTED
            | dialect::MavResult::MAV_RESULT_IN_PROGRESS => None,
            _ => {
                (request.done, request.accepted) = (true, false);
                Some(Answer::Refused(request.id, true))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ack(result: dialect::MavResult) -> dialect::COMMAND_ACK_DATA {
        let command = dialect::MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL;
        dialect::COMMAND_ACK_DATA { command, result, ..Default::default() }
    }

    fn id(message: Option<MavMessage>) -> Option<f32> {
        match message {
            Some(MavMessage::COMMAND_LONG(c)) => Some(c.param1),
            _ => None,
        }
    }

    #[test]
    fn every_message_is_asked_for_until_it_is_answered() {
        let mut r = Requests::new(&[(30, 200.0), (32, 50.0)]);
        let at = |ms| Duration::from_millis(ms);
        let Ok(Some(MavMessage::COMMAND_LONG(first))) = r.next((1, 1), at(0)) else { panic!() };
        assert_eq!((first.param1, first.param2, first.target_system), (30.0, 5000.0, 1));
        assert_eq!(r.next((1, 1), at(100)), Ok(None));
        assert_eq!(id(r.next((1, 1), at(500)).unwrap()), Some(30.0));
        assert_eq!(
            r.acknowledged(&ack(dialect::MavResult::MAV_RESULT_ACCEPTED), at(505)),
            Some(Answer::Accepted(30))
        );
        assert_eq!(id(r.next((1, 1), at(510)).unwrap()), Some(32.0));
        assert_eq!(
            r.acknowledged(&ack(dialect::MavResult::MAV_RESULT_DENIED), at(515)),
            Some(Answer::Refused(32, true))
        );
        assert_eq!(r.next((1, 1), at(9000)), Ok(None));
        r.restart();
        assert_eq!(id(r.next((1, 1), at(9001)).unwrap()), Some(30.0));
    }

    #[test]
    fn another_message_takes_the_place_of_one_that_is_refused() {
        let mut r = Requests::new(&[(105, 200.0)]);
        let _ = r.next((1, 1), Duration::ZERO);
        assert_eq!(
            r.acknowledged(&ack(dialect::MavResult::MAV_RESULT_UNSUPPORTED), Duration::ZERO),
            Some(Answer::Refused(105, true))
        );
        assert!(r.ask_instead(105, 26));
        let Ok(Some(MavMessage::COMMAND_LONG(second))) = r.next((1, 1), Duration::ZERO) else { panic!() };
        assert_eq!((second.param1, second.param2), (26.0, 5000.0));
        assert!(!r.ask_instead(105, 26), "once");
    }

    #[test]
    fn silence_is_reported_after_a_while() {
        let mut r = Requests::new(&[(30, 200.0)]);
        let answer = (0..20).find_map(|i| r.next((1, 1), Duration::from_secs(i)).err());
        assert_eq!(answer, Some(Answer::Refused(30, false)));
    }

    #[test]
    fn a_rate_that_is_never_reached_is_asked_for_ever_more_rarely() {
        let mut r = Requests::new(&[(30, 200.0)]);
        let mut asked = Vec::new();
        for k in 0..2000 {
            let now = Duration::from_millis(100 * k);
            r.heard(30);
            if r.next((1, 1), now).unwrap().is_some() {
                asked.push(now.as_secs());
                r.acknowledged(&ack(dialect::MavResult::MAV_RESULT_ACCEPTED), now);
            }
            let _ = r.renew(now);
        }
        assert_eq!(asked, [0, 2, 6, 14, 30, 62, 126, 190]);
    }
}
