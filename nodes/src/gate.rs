//! Decides which command is in force. The plant applies this rule, and the estimator reproduces it.
//!
//! Over `[t_j, t_j+1)` command j-1 is in force. When it does not arrive in time, the last one is held; after
//! a number of consecutive misses (one, when the caller requests it) the inputs go to neutral, until the
//! first command in time. Commands that are not finite, late, early, repeated or of the wrong size are
//! refused, and outputs never exceed the input limits.

use whirlstand_msgs::{Command, MAX_INPUTS, flags};

/// Limits of the inputs, in the vehicle's order, SI.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InputLimits {
    /// Number of inputs in use.
    pub count: usize,
    /// Lower limit of every input.
    pub lower: [f64; MAX_INPUTS],
    /// Upper limit of every input.
    pub upper: [f64; MAX_INPUTS],
}

impl InputLimits {
    /// Inputs without a command: zero, or the limit nearest to zero.
    pub fn neutral(&self) -> [f64; MAX_INPUTS] {
        let mut u = [0.0; MAX_INPUTS];
        self.limit(&mut u);
        u
    }

    /// True when every value is a number within the limits.
    pub fn allow(&self, u: &[f64; MAX_INPUTS]) -> bool {
        let mut within = u.iter().zip(self.lower.iter().zip(&self.upper)).take(self.count);
        u.iter().all(|value| value.is_finite()) && within.all(|(v, (lower, upper))| lower <= v && v <= upper)
    }

    /// Limits `u`; true when a value changed.
    #[inline]
    fn limit(&self, u: &mut [f64; MAX_INPUTS]) -> bool {
        let mut moved = false;
        for ((value, lower), upper) in u.iter_mut().zip(self.lower).zip(self.upper).take(self.count) {
            let limited = value.max(lower).min(upper);
            moved |= limited != *value;
            *value = limited;
        }
        moved
    }
}

/// Reason why a command was refused or changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// A value is NaN or infinite; refused.
    NotFinite,
    /// The command has another number of inputs than the vehicle; refused.
    WrongCount,
    /// The command belongs to a step before the awaited one; refused.
    Stale,
    /// The command belongs to a step that the plant has not reached; refused.
    Early,
    /// The step already has another command; refused.
    Repeated,
    /// The controller reports that it has no usable command for the awaited step.
    Withheld,
    /// A value is beyond the input limits; the limit is applied instead.
    OutOfRange,
}

/// Inputs in force over one period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Applied {
    /// Inputs in the vehicle's order, SI; unused ones are zero.
    pub u: [f64; MAX_INPUTS],
    /// [`flags::HELD`], [`flags::FAILSAFE`], [`flags::SATURATED`].
    pub flags: u32,
}

/// Decides step by step which inputs are in force.
#[derive(Debug, Clone)]
pub struct Gate {
    limits: InputLimits,
    misses_to_failsafe: u32,
    accepted: Option<Applied>,
    /// The newest accepted command.
    newest: Option<Command>,
    /// True when the answer to the awaited step has arrived but is unusable.
    unusable: bool,
    last: Applied,
    consecutive_misses: u32,
    misses: u64,
    rejected: u64,
    /// The latest step for which a command arrived.
    newest_step: Option<u64>,
}

impl Gate {
    /// A gate with neutral inputs in force.
    pub fn new(limits: InputLimits, misses_to_failsafe: u32) -> Self {
        Self {
            limits,
            misses_to_failsafe: misses_to_failsafe.max(1),
            accepted: None,
            unusable: false,
            last: Applied { u: limits.neutral(), flags: 0 },
            consecutive_misses: 0,
            misses: 0,
            rejected: 0,
            newest: None,
            newest_step: None,
        }
    }

    /// Offers a command while step `awaited` counts. Every fault counts as rejected except a late command,
    /// because its step was counted as a miss when it was closed, and a withheld command. A repetition of the
    /// newest accepted command answers a repeated measurement, and is no fault.
    ///
    /// # Errors
    /// The [`Fault`]; all but [`Fault::OutOfRange`] leave the gate as it was.
    #[inline]
    pub fn offer(&mut self, command: &Command, awaited: u64) -> Result<(), Fault> {
        if self.newest.as_ref() == Some(command) {
            return Ok(());
        }
        let result = self.check(command, awaited);
        let excused = match result {
            Ok(()) | Err(Fault::Withheld) => true,
            Err(Fault::Stale) => self.is_only_late(command.head.step),
            // The measurement of step 0 is repeated until it is answered, so its answer can arrive more than
            // once.
            Err(Fault::Repeated) => command.head.step == 0,
            Err(_) => false,
        };
        self.rejected += u64::from(!excused);
        self.unusable |= matches!(result, Err(Fault::Withheld | Fault::WrongCount | Fault::NotFinite));
        if matches!(result, Ok(()) | Err(Fault::OutOfRange)) {
            self.newest = Some(*command);
        }
        if result != Err(Fault::Early) {
            self.newest_step = self.newest_step.max(Some(command.head.step));
        }
        result
    }

    /// True when a command for a past step is the first one for it: the missing answer, too late.
    fn is_only_late(&self, step: u64) -> bool {
        step == 0 || self.newest_step.is_none_or(|newest| step > newest)
    }

    #[inline]
    fn check(&mut self, command: &Command, awaited: u64) -> Result<(), Fault> {
        let count = self.limits.count;
        match command.head.step.cmp(&awaited) {
            std::cmp::Ordering::Less => return Err(Fault::Stale),
            std::cmp::Ordering::Greater => return Err(Fault::Early),
            std::cmp::Ordering::Equal => {}
        }
        if self.accepted.is_some() {
            return Err(Fault::Repeated);
        }
        if command.flags & flags::WITHHELD != 0 {
            return Err(Fault::Withheld);
        }
        if command.count as usize != count {
            return Err(Fault::WrongCount);
        }
        let mut u = [0.0; MAX_INPUTS];
        u[..count].copy_from_slice(&command.u[..count]);
        if u.iter().any(|v| !v.is_finite()) {
            return Err(Fault::NotFinite);
        }
        let moved = self.limits.limit(&mut u);
        let saturated = (0..count).any(|i| u[i] <= self.limits.lower[i] || u[i] >= self.limits.upper[i]);
        self.accepted = Some(Applied { u, flags: if saturated { flags::SATURATED } else { 0 } });
        if moved { Err(Fault::OutOfRange) } else { Ok(()) }
    }

    /// True when the awaited command has arrived.
    #[inline]
    pub fn is_ready(&self) -> bool {
        self.accepted.is_some()
    }

    /// True when the awaited step was answered, with a usable or an unusable command.
    #[inline]
    pub fn is_answered(&self) -> bool {
        self.accepted.is_some() || self.unusable
    }

    /// The command that will come into force, within the limits.
    pub fn accepted(&self) -> Option<Applied> {
        self.accepted
    }

    /// Closes the step: the accepted command comes into force, or a miss is counted. With `failsafe_at_once`
    /// a single miss leads to the failsafe.
    #[inline]
    pub fn close(&mut self, failsafe_at_once: bool) -> Applied {
        self.unusable = false;
        self.last = match self.accepted.take() {
            Some(applied) => {
                self.consecutive_misses = 0;
                applied
            }
            None => {
                self.misses += 1;
                self.consecutive_misses = self.consecutive_misses.saturating_add(1);
                if failsafe_at_once || self.consecutive_misses >= self.misses_to_failsafe {
                    Applied { u: self.limits.neutral(), flags: flags::HELD | flags::FAILSAFE }
                } else {
                    // A miss does not end a failsafe, only a command does.
                    Applied { u: self.last.u, flags: self.last.flags | flags::HELD }
                }
            }
        };
        self.last
    }

    /// The inputs that are in force now.
    #[inline]
    pub fn applied(&self) -> Applied {
        self.last
    }

    /// True when the inputs are neutral because commands are missing.
    pub fn in_failsafe(&self) -> bool {
        self.last.flags & flags::FAILSAFE != 0
    }

    /// Number of steps without a usable command in time.
    pub fn misses(&self) -> u64 {
        self.misses
    }

    /// Number of commands with a [`Fault`], without those that were only late.
    pub fn rejected(&self) -> u64 {
        self.rejected
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use whirlstand_msgs::Message;

    fn limits() -> InputLimits {
        let mut limits = InputLimits { count: 2, lower: [0.0; MAX_INPUTS], upper: [0.0; MAX_INPUTS] };
        limits.lower[..2].copy_from_slice(&[-1.0, 0.2]);
        limits.upper[..2].copy_from_slice(&[1.0, 0.8]);
        limits
    }

    fn command(step: u64, a: f64, b: f64) -> Command {
        let mut c = Command { count: 2, ..Command::zeroed() };
        c.head.step = step;
        c.u[..2].copy_from_slice(&[a, b]);
        c
    }

    #[test]
    fn a_command_on_time_is_applied_once() {
        let mut gate = Gate::new(limits(), 3);
        assert_eq!(gate.applied().u[..2], [0.0, 0.2], "neutral is the limit nearest to zero");
        gate.offer(&command(4, 0.5, 0.6), 4).unwrap();
        assert_eq!(gate.offer(&command(4, 0.1, 0.6), 4), Err(Fault::Repeated));
        assert_eq!(gate.close(false), Applied { u: [0.5, 0.6, 0., 0., 0., 0., 0., 0.], flags: 0 });
        assert_eq!(gate.offer(&command(4, 0.1, 0.6), 5), Err(Fault::Stale));
        assert_eq!(gate.offer(&command(6, 0.1, 0.6), 5), Err(Fault::Early));
        let held = gate.close(false);
        assert_eq!((held.u[0], held.flags), (0.5, flags::HELD));
        assert_eq!((gate.misses(), gate.rejected()), (1, 3));
    }

    #[test]
    fn an_answer_that_is_only_late_is_a_miss_and_no_fault() {
        let mut gate = Gate::new(limits(), 3);
        gate.offer(&command(0, 0.5, 0.6), 0).unwrap();
        assert_eq!(gate.offer(&command(0, 0.5, 0.6), 0), Ok(()), "the same answer once more");
        assert_eq!(gate.offer(&command(0, 0.4, 0.6), 0), Err(Fault::Repeated), "step 0 was asked for twice");
        for _ in 0..4 {
            gate.close(false);
        }
        for step in 1..3 {
            assert_eq!(gate.offer(&command(step, 0.5, 0.6), 4), Err(Fault::Stale));
        }
        assert_eq!((gate.misses(), gate.rejected()), (3, 0));
        assert_eq!(gate.offer(&command(2, 0.5, 0.6), 4), Err(Fault::Stale), "the second for its step");
        assert_eq!(gate.offer(&command(1, 0.5, 0.6), 4), Err(Fault::Stale), "out of order");
        assert_eq!(gate.rejected(), 2);
    }

    #[test]
    fn misses_lead_to_the_failsafe_and_a_command_leads_back() {
        let mut gate = Gate::new(limits(), 3);
        gate.offer(&command(0, 0.5, 0.6), 0).unwrap();
        gate.close(false);
        assert_eq!(gate.close(false).u[0], 0.5);
        assert_eq!(gate.close(false).u[0], 0.5);
        assert!(!gate.in_failsafe());
        let failsafe = gate.close(false);
        assert_eq!(failsafe.u[..2], [0.0, 0.2]);
        assert_eq!(failsafe.flags, flags::HELD | flags::FAILSAFE);
        assert!(gate.close(false).flags & flags::FAILSAFE != 0, "it stays until a command comes");
        gate.offer(&command(5, 0.3, 0.6), 5).unwrap();
        assert_eq!(gate.close(false).flags, 0);
        gate.offer(&command(6, 0.4, 0.6), 6).unwrap();
        gate.close(true);
        assert!(gate.close(true).flags & flags::FAILSAFE != 0, "one lockstep timeout is enough");
        assert!(gate.close(false).flags & flags::FAILSAFE != 0);
    }

    #[test]
    fn what_is_not_a_command_for_this_vehicle_is_refused() {
        let mut gate = Gate::new(limits(), 3);
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(gate.offer(&command(0, 0.0, bad), 0), Err(Fault::NotFinite));
        }
        let three = Command { count: 3, ..command(0, 0.0, 0.5) };
        assert_eq!(gate.offer(&three, 0), Err(Fault::WrongCount));
        assert_eq!(gate.offer(&command(0, 7.0, 0.5), 0), Err(Fault::OutOfRange));
        assert_eq!(gate.rejected(), 5);
        assert!(gate.is_answered() && gate.is_ready());
        let applied = gate.close(false);
        assert_eq!((applied.u[0], applied.flags), (1.0, flags::SATURATED));
    }

    #[test]
    fn what_a_repeated_measurement_brings_is_no_fault() {
        let mut gate = Gate::new(limits(), 3);
        let first = command(0, 0.5, 0.6);
        for _ in 0..3 {
            gate.offer(&first, 0).unwrap();
        }
        gate.close(true);
        gate.offer(&first, 1).unwrap();
        assert!(!gate.is_answered(), "the answer to the step before answers nothing else");
        let mut withheld = Command { count: 0, flags: flags::WITHHELD, ..command(1, 0.0, 0.0) };
        withheld.head.seq = 1;
        assert_eq!(gate.offer(&withheld, 1), Err(Fault::Withheld));
        assert!(gate.is_answered() && !gate.is_ready());
        assert_eq!(gate.close(true).flags, flags::HELD | flags::FAILSAFE);
        assert!(!gate.is_answered());
        assert_eq!((gate.rejected(), gate.misses()), (0, 1));
    }

    proptest! {
        #[test]
        fn nothing_passes_the_limits(
            offers in prop::collection::vec((0u64..6, 0u32..4, any::<f64>(), any::<f64>(), any::<bool>()), 1..60)
        ) {
            let mut gate = Gate::new(limits(), 3);
            let mut awaited = 0;
            for (step, count, a, b, close) in offers {
                let _ = gate.offer(&Command { count, ..command(step, a, b) }, awaited);
                if close {
                    let u = gate.close(false).u;
                    prop_assert!((-1.0..=1.0).contains(&u[0]) && (0.2..=0.8).contains(&u[1]), "{:?}", u);
                    prop_assert!(u[2..].iter().all(|v| *v == 0.0));
                    awaited += 1;
                }
            }
        }
    }
}
