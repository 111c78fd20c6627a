//! An effect of any kind that begins in flight.

use whirlstand_vehicle::{Effect, EffectError, Kind, Simulator, Window};

use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::plant::simulation::simulated;
use crate::setup::Setup;

/// An effect and the step from which it acts.
#[derive(Debug, Clone, PartialEq)]
pub struct Onset {
    /// The effect, without a window.
    pub effect: Effect,
    /// First step with it.
    pub step: u64,
}

impl Onset {
    /// The effect with a window that begins at the step.
    fn switched(&self, period_s: f64) -> Result<Effect, EffectError> {
        // Slightly before the step, so that rounding does not delay the effect by a step.
        let at_s = ((self.step as f64 - 1e-6) * period_s).max(0.0);
        match (self.effect.kind(), self.effect.text()) {
            (Kind::StepDisturbance | Kind::PulseDisturbance, _) => {
                let mut moved = self.effect.clone();
                moved.set_parameter("at_s", at_s).map(|()| moved)
            }
            (Kind::ModeTransition, Some(to)) => Effect::mode_transition(at_s, to),
            _ => self.effect.clone().during(Window { from_s: Some(at_s), until_s: None }),
        }
    }
}

/// The simulated vehicle, with the effect that begins in flight.
///
/// # Errors
/// As [`simulated`].
pub(crate) fn airframe(
    config: &NodeConfig,
    setup: &Setup,
    onset: Option<&Onset>,
) -> Result<(Simulator, Vec<f64>), NodeError> {
    let Some(onset) = onset else { return simulated(config, setup) };
    let mut config = config.clone();
    let effect = onset.switched(Setup::period_s(&config)).map_err(|e| NodeError::Config {
        field: "effects".into(),
        value: onset.effect.kind().to_string(),
        reason: e.to_string(),
    })?;
    config.effects.push(effect);
    simulated(&config, setup)
}
