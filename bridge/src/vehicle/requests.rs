//! Requests an autopilot to send the messages that the loop needs, until it accepts.

use std::time::Duration;

use crate::mavlink::{MavMessage, dialect};

/// Time after which an unanswered request is repeated.
const AGAIN: Duration = Duration::from_millis(500);

/// Largest number of unanswered requests per message.
const TRIES: u32 = 10;

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
}

/// Requests of `SET_MESSAGE_INTERVAL`, one in flight at a time because an answer does not say which it answers.
#[derive(Debug, Clone, Default)]
pub struct Requests {
    list: Vec<Request>,
}

impl Requests {
    /// Requests for messages and their rates, Hz.
    pub fn new(wanted: &[(u32, f64)]) -> Self {
        let list = wanted
            .iter()
            .map(|(id, rate_hz)| Request {
                id: *id,
                interval_us: (1e6 / rate_hz) as f32,
                tries: 0,
                due: Duration::ZERO,
                done: false,
            })
            .collect();
        Self { list }
    }

    /// Requests another message in place of a refused one, at its rate; false when it is on the list already.
    pub fn ask_instead(&mut self, refused: u32, id: u32) -> bool {
        if self.list.iter().any(|r| r.id == id) {
            return false;
        }
        let like = self.list.iter().find(|r| r.id == refused).cloned();
        self.list.extend(like.map(|r| Request { id, tries: 0, due: Duration::ZERO, done: false, ..r }));
        true
    }

    /// True when a message with this number is on the list.
    pub fn asks_for(&self, id: f32) -> bool {
        self.list.iter().any(|r| r.id as f32 == id)
    }

    /// Requests everything again, after the autopilot restarted or reconnected.
    pub fn restart(&mut self) {
        for request in &mut self.list {
            (request.tries, request.due, request.done) = (0, Duration::ZERO, false);
        }
    }

    /// The next request to this system and component, if one is due.
    pub fn next(&mut self, target: (u8, u8), now: Duration) -> Result<Option<MavMessage>, Answer> {
        let Some(request) = self.list.iter_mut().find(|r| !r.done) else { return Ok(None) };
        if now < request.due {
            return Ok(None);
        }
        if request.tries == TRIES {
            request.done = true;
            return Err(Answer::Refused(request.id, false));
        }
        request.tries += 1;
        request.due = now + AGAIN;
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
    pub fn acknowledged(&mut self, ack: &dialect::COMMAND_ACK_DATA) -> Option<Answer> {
        if ack.command != dialect::MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL {
            return None;
        }
        let request = self.list.iter_mut().find(|r| !r.done && r.tries > 0)?;
        match ack.result {
            dialect::MavResult::MAV_RESULT_ACCEPTED => {
                request.done = true;
                Some(Answer::Accepted(request.id))
            }
            dialect::MavResult::MAV_RESULT_TEMPORARILY_REJECTED
            | dialect::MavResult::MAV_RESULT_IN_PROGRESS => None,
            _ => {
                request.done = true;
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
        assert_eq!(r.acknowledged(&ack(dialect::MavResult::MAV_RESULT_ACCEPTED)), Some(Answer::Accepted(30)));
        assert_eq!(id(r.next((1, 1), at(510)).unwrap()), Some(32.0));
        assert_eq!(
            r.acknowledged(&ack(dialect::MavResult::MAV_RESULT_DENIED)),
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
            r.acknowledged(&ack(dialect::MavResult::MAV_RESULT_UNSUPPORTED)),
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
}
