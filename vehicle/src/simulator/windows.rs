//! Effects that begin and end, by their windows or by hand.

use super::{Dynamics, Simulator};

impl Simulator {
    /// Lets act what does in the present step.
    pub(super) fn choose(&mut self) {
        if let Dynamics::Extended(extended) = &mut self.dynamics {
            extended.choose(self.step, &mut self.sensors);
        }
    }

    /// Switches the effect of that index in the vehicle, from now on whatever its window says; false for one that has no
    /// window.
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

    /// Puts what the effect of that index in the vehicle remembers of its input: the output of an actuator lag, the position of a
    /// rate limit or of play, as the present step finds it. False for an effect that does not remember one value.
    pub fn put(&mut self, effect: usize, value: f64) -> bool {
        match &mut self.dynamics {
            Dynamics::Plain(_) => false,
            Dynamics::Extended(extended) => extended.put(effect, value, &mut self.z),
        }
    }

    /// Whether something in the motion begins or ends with a step, so that steps are to be taken one by one.
    pub(super) fn has_windows(&self) -> bool {
        let extended = match &self.dynamics {
            Dynamics::Plain(_) => false,
            Dynamics::Extended(extended) => extended.has_windows(),
        };
        extended || self.disturbances.have_windows()
    }
}
