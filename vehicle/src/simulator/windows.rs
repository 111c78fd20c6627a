//! Effects that begin and end, by their windows or by hand.

use super::{Dynamics, Simulator};

impl Simulator {
    /// Selects the effects that act in the current step.
    pub(super) fn choose(&mut self) {
        if let Dynamics::Extended(extended) = &mut self.dynamics {
            extended.choose(self.step, &mut self.sensors);
        }
    }

    /// Switches the effect with that index in the vehicle, overriding its window from now on; false for one
    /// that has no window.
    pub fn switch(&mut self, effect: usize, on: bool) -> bool {
        let on_motion = match &mut self.dynamics {
            Dynamics::Plain(_) => false,
            Dynamics::Extended(extended) => extended.switch(effect, on),
        };
        let is_one =
            on_motion || self.disturbances.switch(self.step, effect, on) || self.sensors.switch(effect, on);
        self.choose();
        is_one
    }

    /// Sets the stored value of the effect with that index in the vehicle, as at the current step: the output
    /// of an actuator lag, the position of a rate limit or backlash. False for an effect that does not store
    /// one value.
    pub fn put(&mut self, effect: usize, value: f64) -> bool {
        match &mut self.dynamics {
            Dynamics::Plain(_) => false,
            Dynamics::Extended(extended) => extended.put(effect, value, &mut self.z),
        }
    }

    /// True when an effect on the motion begins or ends with a step, so that steps must be simulated one by
    /// one.
    pub(super) fn has_windows(&self) -> bool {
        let extended = match &self.dynamics {
            Dynamics::Plain(_) => false,
            Dynamics::Extended(extended) => extended.has_windows(),
        };
        extended || self.disturbances.have_windows()
    }
}
