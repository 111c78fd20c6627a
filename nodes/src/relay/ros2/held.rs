//! The newest ROS 2 command, which in real time is held for a while.

use std::time::{Duration, Instant};

use whirlstand_msgs::{Command, Head, MAX_INPUTS, Message, flags};

/// Longest time for which a ROS 2 command is held in real time.
const LONGEST: Duration = Duration::from_millis(200);

/// The newest command, with its time of arrival.
#[derive(Debug, Default)]
pub(super) struct Held(Option<(Vec<f64>, Instant)>);

impl Held {
    /// Replaces the command by one that arrived at `at`.
    pub(super) fn keep(&mut self, values: Vec<f64>, at: Instant) {
        self.0 = Some((values, at));
    }

    /// The answer to a step; withheld without a command, and in real time when the newest one is too old.
    pub(super) fn answer(&self, head: Head, realtime: bool, now: Instant) -> Command {
        let fresh =
            self.0.as_ref().filter(|(_, at)| !realtime || now.saturating_duration_since(*at) <= LONGEST);
        let Some((values, _)) = fresh else {
            return Command { head, flags: flags::WITHHELD, ..Command::zeroed() };
        };
        let mut command = Command { head, ..Command::zeroed() };
        let count = values.len().min(MAX_INPUTS);
        command.u[..count].copy_from_slice(&values[..count]);
        command.count = count as u32;
        command
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head(step: u64) -> Head {
        Head { seq: 0, step, stamp_ns: 7 }
    }

    #[test]
    fn a_command_is_held_for_a_fifth_of_a_second_and_then_withheld_until_the_next() {
        let at = Instant::now();
        let mut held = Held::default();
        assert_eq!(held.answer(head(1), true, at).flags, flags::WITHHELD, "nothing came yet");
        held.keep(vec![1.5, -2.0], at);
        for ms in [0, 100, 200] {
            let command = held.answer(head(2), true, at + Duration::from_millis(ms));
            assert_eq!((command.head.step, command.head.stamp_ns), (2, 7));
            assert_eq!((command.flags, command.count, &command.u[..2]), (0, 2, &[1.5, -2.0][..]), "{ms} ms");
        }
        let command = held.answer(head(3), true, at + Duration::from_millis(201));
        assert_eq!((command.flags, command.count, command.u[0]), (flags::WITHHELD, 0, 0.0));
        held.keep(vec![3.0], at + Duration::from_millis(500));
        let command = held.answer(head(4), true, at + Duration::from_millis(600));
        assert_eq!((command.flags, command.count, command.u[0]), (0, 1, 3.0));
    }

    #[test]
    fn a_command_in_lockstep_has_no_age() {
        let at = Instant::now();
        let mut held = Held::default();
        held.keep(vec![1.0], at);
        let command = held.answer(head(1), false, at + Duration::from_secs(3600));
        assert_eq!((command.flags, command.count, command.u[0]), (0, 1, 1.0));
    }

    #[test]
    fn values_beyond_the_inputs_of_the_bus_are_left_out() {
        let mut held = Held::default();
        held.keep(vec![2.0; MAX_INPUTS + 3], Instant::now());
        let command = held.answer(head(1), false, Instant::now());
        assert_eq!((command.count as usize, command.u), (MAX_INPUTS, [2.0; MAX_INPUTS]));
    }
}
