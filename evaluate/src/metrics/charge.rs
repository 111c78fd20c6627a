//! Who was in charge of a bench with a bridge, step by step.

use whirlstand_msgs::{Autopilot, Sent, charge};

/// What a fault of an [`Autopilot`] message means that is not armed.
const NOT_ARMED: u32 = 3;

/// Steps of a run behind a bridge, from the first one that was not disarmed.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ChargeSteps {
    /// Number of all reported steps.
    told: u64,
    /// Number of steps from the first one that was not disarmed on: the controller, the pilot or failsafe was in charge.
    flown: u64,
    disarmed: u64,
    pilot: u64,
    /// Steps in failsafe, and those of them at the end.
    pub(crate) failsafe: u64,
    pub(crate) failsafe_at_end: u64,
}

impl ChargeSteps {
    pub(crate) fn take_sent(&mut self, m: &Sent) {
        self.take(m.in_charge, 1);
    }

    pub(crate) fn take_autopilot(&mut self, m: &Autopilot) {
        let in_charge = match m.fault {
            0 => charge::CONTROLLER,
            NOT_ARMED => charge::NOBODY,
            _ => charge::FAILSAFE,
        };
        self.take(in_charge, 1);
    }

    /// Counts consecutive steps with this source of the outputs, one of [`charge`].
    pub fn take(&mut self, in_charge: u32, steps: u64) {
        let add = |count: &mut u64| *count = count.saturating_add(steps);
        add(&mut self.told);
        if in_charge == charge::FAILSAFE {
            add(&mut self.failsafe_at_end);
        } else {
            self.failsafe_at_end = 0;
        }
        if self.flown == 0 && in_charge == charge::NOBODY {
            return;
        }
        add(&mut self.flown);
        match in_charge {
            charge::NOBODY => add(&mut self.disarmed),
            charge::PILOT => add(&mut self.pilot),
            charge::FAILSAFE => add(&mut self.failsafe),
            _ => {}
        }
    }

    /// Number of steps that count.
    pub(crate) fn of_steps(&self) -> u64 {
        self.flown
    }

    /// Shares of the counted steps that were disarmed, and in the pilot's hands. A run in which neither the controller nor the
    /// pilot was ever in charge, and which was disarmed at any time, was disarmed as a whole: what came late at times does
    /// not arm it. `None` when no step was reported.
    pub fn shares(&self) -> Option<(f64, f64)> {
        let share = |steps: u64| steps as f64 / self.flown.max(1) as f64;
        let in_charge = self.flown - self.disarmed - self.failsafe;
        let disarmed_ever = self.told > self.flown || self.disarmed > 0;
        let disarmed = if in_charge == 0 && disarmed_ever { 1.0 } else { share(self.disarmed) };
        (self.told > 0).then(|| (disarmed, share(self.pilot)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shares(of: &[u32]) -> (f64, f64, u64, u64) {
        let mut steps = ChargeSteps::default();
        of.iter().for_each(|c| steps.take(*c, 1));
        let (disarmed, pilot) = steps.shares().unwrap();
        (disarmed, pilot, steps.failsafe, steps.failsafe_at_end)
    }

    #[test]
    fn time_before_the_first_arm_counts_only_when_nothing_else_came() {
        use charge::{CONTROLLER as C, FAILSAFE as F, NOBODY as N, PILOT as P};
        assert_eq!(ChargeSteps::default().shares(), None, "nothing was reported");
        assert_eq!(shares(&[N, N, N]), (1.0, 0.0, 0, 0));
        assert_eq!(shares(&[N, N, C, C]), (0.0, 0.0, 0, 0));
        assert_eq!(shares(&[N, C, N, P, F, C, C, F]), (1.0 / 7.0, 1.0 / 7.0, 2, 1));
        assert_eq!(shares(&[F, N, N]), (1.0, 0.0, 1, 0), "one late message is no flight");
        assert_eq!(shares(&[N, N, F]), (1.0, 0.0, 1, 1));
        assert_eq!(shares(&[F, F]), (0.0, 0.0, 2, 2), "nobody said that it was not armed");
        let mut steps = ChargeSteps::default();
        for fault in [3, 0, 0, 3] {
            steps.take_autopilot(&Autopilot { fault, ..whirlstand_msgs::Message::zeroed() });
        }
        assert_eq!(steps.shares(), Some((1.0 / 3.0, 0.0)));
    }
}
