//! An effect that begins in flight, of whatever kind.
//!
//! What the plant can switch has a window. For everything else the vehicle that has the effect goes along from the start, with
//! the same inputs and kept at the same states, so that its delays and lags hold what they would, and takes over at the step.

use whirlstand_vehicle::{Effect, Kind, Simulator, Window};

use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::plant::simulation::simulated;
use crate::setup::Setup;

/// An effect and the step from which on it acts.
#[derive(Debug, Clone, PartialEq)]
pub struct Onset {
    /// The effect, without a window.
    pub effect: Effect,
    /// First step with it.
    pub step: u64,
}

impl Onset {
    /// The effect with its begin, where the simulator knows one.
    fn switched(&self, period_s: f64) -> Option<Effect> {
        // A rounding error before the step, so that it acts at the step itself.
        let at_s = ((self.step as f64 - 1e-6) * period_s).max(0.0);
        match self.effect.kind() {
            Kind::StepDisturbance | Kind::PulseDisturbance => {
                let mut moved = self.effect.clone();
                moved.set_parameter("at_s", at_s).ok().map(|_| moved)
            }
            Kind::ModeTransition => Effect::mode_transition(at_s, self.effect.text()?).ok(),
            _ => self.effect.clone().during(Window { from_s: Some(at_s), until_s: None }).ok(),
        }
    }
}

/// The vehicle that flies, and the one that takes over.
pub(crate) struct Airframe {
    now: Simulator,
    later: Option<(u64, Simulator)>,
    change: Vec<f64>,
    /// Beyond them a state means nothing any more.
    pub bounds: Vec<f64>,
}

impl Airframe {
    /// As [`simulated`].
    pub fn new(config: &NodeConfig, setup: &Setup, onset: Option<&Onset>) -> Result<Self, NodeError> {
        let with = |effect: Effect| {
            let mut config = config.clone();
            config.effects.push(effect);
            simulated(&config, setup)
        };
        let (now, later, bounds) = match onset {
            None => {
                let (now, bounds) = simulated(config, setup)?;
                (now, None, bounds)
            }
            Some(onset) => match onset.switched(Setup::period_s(config)) {
                Some(effect) => {
                    let (now, bounds) = with(effect)?;
                    (now, None, bounds)
                }
                None => {
                    let (now, bounds) = simulated(config, setup)?;
                    (now, Some((onset.step, with(onset.effect.clone())?.0)), bounds)
                }
            },
        };
        Ok(Self { change: vec![0.0; now.state().len()], now, later, bounds })
    }

    /// The vehicle that flies.
    pub fn now(&self) -> &Simulator {
        &self.now
    }

    /// Sets the command of this step.
    pub fn apply(&mut self, u: &[f64]) {
        if let Some((step, later)) = &mut self.later {
            for ((c, a), b) in self.change.iter_mut().zip(self.now.state()).zip(later.state()) {
                *c = a - b;
            }
            later.correct(&self.change);
            if self.now.step_index() >= *step {
                std::mem::swap(&mut self.now, later);
                self.later = None;
            } else {
                later.apply(u);
                later.measure();
                later.advance();
            }
        }
        self.now.apply(u);
    }

    /// Measures at the present step.
    pub fn measure(&mut self) -> &[f64] {
        self.now.measure()
    }

    /// Advances by one period.
    pub fn advance(&mut self) {
        self.now.advance();
    }
}
