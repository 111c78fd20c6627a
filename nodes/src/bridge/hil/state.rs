//! State of the autopilot's flight, and validity of its outputs: the last check before the bus.

use std::time::Duration;

use whirlstand_bridge::autopilot::{Begin, FlightOptions, Outputs};
use whirlstand_bridge::mixer::{FrameKind, Mixer};

use crate::gate::InputLimits;

/// Smallest motor output of an armed autopilot, where the protocol does not report it.
const TURNING: f64 = 0.005;

/// Reason for a missing or neutral command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fault {
    /// No outputs, or too old ones.
    Silent,
    /// The outputs are not finite.
    NotFinite,
    /// The autopilot is not armed.
    Disarmed,
}

impl Fault {
    /// Text for the log.
    pub(super) fn text(self) -> &'static str {
        match self {
            Self::Silent => "no fresh outputs: no command, the plant goes to its failsafe",
            Self::NotFinite => "its outputs are not numbers: no command",
            Self::Disarmed => "not armed: inputs at neutral",
        }
    }
}

/// The state of the flight.
#[derive(Debug, Clone)]
pub(in crate::bridge) struct Flight {
    begin: Begin,
    stale: Duration,
    motors: bool,
    outputs: Option<(Outputs, Duration)>,
    begun: bool,
    /// True after a loss in flight: the autopilot is then not armed again in this run.
    lost: bool,
    fault: Option<Fault>,
    change: Option<Option<Fault>>,
    refused: u64,
}

impl Flight {
    pub(in crate::bridge) fn new(options: &FlightOptions, frame: FrameKind) -> Self {
        Self {
            begin: options.begin,
            stale: Duration::from_secs_f64(options.stale_s),
            motors: frame != FrameKind::Ccpm,
            outputs: None,
            begun: false,
            lost: false,
            fault: None,
            change: None,
            refused: 0,
        }
    }

    /// Condition for the beginning of the run.
    pub(super) fn begin(&self) -> Begin {
        self.begin
    }

    /// Marks the beginning of the run.
    pub(super) fn start(&mut self) {
        self.begun = true;
    }

    pub(super) fn has_begun(&self) -> bool {
        self.begun
    }

    /// Stores new outputs.
    pub(in crate::bridge) fn take(&mut self, outputs: Outputs, now: Duration) {
        self.outputs = Some((outputs, now));
    }

    /// Discards the outputs, as the autopilot is lost or has restarted.
    pub(in crate::bridge) fn forget(&mut self) {
        self.outputs = None;
        self.lost |= self.begun;
    }

    /// True when the pilot's channels may arm the autopilot.
    pub(super) fn may_arm(&self) -> bool {
        !self.lost
    }

    /// Number of outputs that were not finite.
    pub(super) fn refused(&self) -> u64 {
        self.refused
    }

    /// True when there are outputs that are not too old.
    pub(in crate::bridge) fn is_fresh(&self, now: Duration) -> bool {
        self.fresh(now).is_some()
    }

    /// True when there are fresh outputs of an armed autopilot.
    pub(in crate::bridge) fn is_flying(&self, mixer: &Mixer, now: Duration) -> bool {
        self.fresh(now).is_some_and(|outputs| self.is_armed(&outputs, mixer))
    }

    /// The outputs, unless they are too old.
    pub(super) fn newest(&self, now: Duration) -> Option<Outputs> {
        self.fresh(now)
    }

    fn fresh(&self, now: Duration) -> Option<Outputs> {
        let (outputs, at) = self.outputs?;
        (now.saturating_sub(at) <= self.stale).then_some(outputs)
    }

    fn is_armed(&self, outputs: &Outputs, mixer: &Mixer) -> bool {
        match outputs.armed {
            Some(armed) => armed,
            None if self.motors => mixer.used(&outputs.values).any(|v| v > TURNING),
            // A swashplate moves whether or not the engine runs.
            None => true,
        }
    }

    /// Writes the inputs of the next period into `u`: within the vehicle's limits, and neutral when disarmed.
    ///
    /// # Errors
    /// The [`Fault`]; on all but [`Fault::Disarmed`] there is no command.
    pub(super) fn inputs(
        &mut self,
        mixer: &Mixer,
        limits: &InputLimits,
        now: Duration,
        u: &mut [f64],
    ) -> Result<(), Fault> {
        let verdict = match self.fresh(now) {
            None => {
                self.lost |= self.begun;
                Err(Fault::Silent)
            }
            Some(outputs) if !self.is_armed(&outputs, mixer) => {
                u.copy_from_slice(mixer.neutral());
                Err(Fault::Disarmed)
            }
            Some(outputs) => {
                mixer.mix(&outputs.values, u);
                if u.iter().all(|v| v.is_finite()) { Ok(()) } else { Err(Fault::NotFinite) }
            }
        };
        self.refused += u64::from(verdict == Err(Fault::NotFinite));
        for ((value, lower), upper) in u.iter_mut().zip(limits.lower).zip(limits.upper) {
            *value = value.max(lower).min(upper);
        }
        let fault = verdict.err();
        if fault != self.fault {
            self.fault = fault;
            self.change = Some(fault);
        }
        verdict
    }

    /// Change of the fault since the last call: a new fault, or none any more.
    pub(super) fn take_change(&mut self) -> Option<Option<Fault>> {
        self.change.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_bridge::mixer::{MAX_OUTPUTS, MixerOptions};
    use whirlstand_vehicle::Vehicle;

    fn outputs(motors: [f64; 4], armed: Option<bool>) -> Outputs {
        let mut values = [0.0; MAX_OUTPUTS];
        values[..4].copy_from_slice(&motors);
        Outputs { values, beyond: 0, armed }
    }

    #[test]
    fn only_fresh_finite_armed_outputs_move_the_inputs() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let mixer = Mixer::new(&MixerOptions::default(), &[1, 2, 3, 4], &vehicle).unwrap();
        let limits = crate::signals::input_limits(&vehicle).unwrap();
        let mut flight = Flight::new(&FlightOptions::default(), FrameKind::QuadX);
        let mut u = [f64::NAN; 2];
        let ms = Duration::from_millis;
        let mut inputs = |flight: &mut Flight, now| {
            let verdict = flight.inputs(&mixer, &limits, now, &mut u);
            (verdict, u)
        };
        assert_eq!(inputs(&mut flight, ms(0)).0, Err(Fault::Silent));
        assert_eq!(flight.take_change(), Some(Some(Fault::Silent)));
        flight.take(outputs([0.0, 1.0, 1.0, 0.0], Some(false)), ms(0));
        assert_eq!(inputs(&mut flight, ms(1)), (Err(Fault::Disarmed), [0.0, 0.0]));
        flight.take(outputs([0.0, 1.0, 1.0, 0.0], Some(true)), ms(2));
        assert_eq!(inputs(&mut flight, ms(3)), (Ok(()), [-20.0, 0.0]));
        assert_eq!(flight.take_change(), Some(None));
        assert_eq!(inputs(&mut flight, ms(300)).0, Err(Fault::Silent), "a quarter of a second");
        flight.take(outputs([f64::NAN, 1.0, 1.0, 0.0], Some(true)), ms(301));
        assert_eq!(inputs(&mut flight, ms(302)).0, Err(Fault::NotFinite));
        assert_eq!(flight.refused(), 1);
        flight.take(outputs([0.0, 3.0, 3.0, 0.0], None), ms(303));
        assert_eq!(inputs(&mut flight, ms(304)), (Ok(()), [-20.0, 0.0]), "never beyond the limits");
        flight.take(outputs([0.0; 4], None), ms(305));
        assert_eq!(inputs(&mut flight, ms(306)).0, Err(Fault::Disarmed), "motors that stand still");
        flight.start();
        flight.forget();
        assert!(!flight.may_arm() && !flight.is_fresh(ms(306)));
    }
}
