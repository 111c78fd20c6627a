//! Effects outside the linear model that a law or filter can still model: static effects on inputs, and
//! friction.

use crate::effects::{Effect, Kind, Place};
use crate::error::SimulatorError;
use crate::model::Vehicle;

/// Static effects on a command, in the order in which they act. All values are in commands counted from the
/// trim, divided by the gain of the input; effects with a time window are left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InputEffects {
    /// The command is multiplied by `1 + drift_per_s t`, t since the start of the run, before the trim is counted.
    pub drift_per_s: f64,
    /// Half-width of the dead zone.
    pub dead_zone: f64,
    /// Lower saturation limit.
    pub lower: f64,
    /// Upper saturation limit.
    pub upper: f64,
    /// Largest rate of change, per second.
    pub rate_per_s: f64,
    /// Full width of the backlash.
    pub backlash: f64,
}

impl InputEffects {
    /// An input without static effects.
    pub const NONE: Self = Self {
        drift_per_s: 0.0,
        dead_zone: 0.0,
        lower: f64::NEG_INFINITY,
        upper: f64::INFINITY,
        rate_per_s: f64::INFINITY,
        backlash: 0.0,
    };

    /// Adds one effect of an input with this gain, which is not zero. Effects of one kind are combined: dead
    /// zones, backlashes and (to first order) drifts add, the narrowest limit holds.
    fn take(&mut self, effect: &Effect, gain: f64) {
        let size = gain.abs();
        match effect.kind() {
            Kind::GainDrift => self.drift_per_s += effect.get("rate_per_s"),
            Kind::DeadZone => self.dead_zone += effect.get("width") / size,
            Kind::InputSaturation => {
                let ends = [effect.get("lower") / gain, effect.get("upper") / gain];
                self.lower = self.lower.max(ends[0].min(ends[1]));
                self.upper = self.upper.min(ends[0].max(ends[1]));
            }
            Kind::RateLimit => self.rate_per_s = self.rate_per_s.min(effect.get("limit_per_s") / size),
            Kind::Backlash => self.backlash += effect.get("width") / size,
            _ => {}
        }
    }
}

/// Coulomb friction on a state: `-level sign(x) - asymmetry` on its derivative.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Friction {
    /// Index of the state.
    pub state: usize,
    /// Magnitude of the part that opposes the motion, the state's unit per second.
    pub level: f64,
    /// Constant part, the state's unit per second.
    pub asymmetry: f64,
}

/// The static effects on each input.
///
/// # Errors
/// [`SimulatorError`] when an effect does not fit the vehicle.
pub fn input_effects(vehicle: &Vehicle) -> Result<Vec<InputEffects>, SimulatorError> {
    let mut found = vec![InputEffects::NONE; vehicle.inputs.len()];
    let always = || vehicle.effects.iter().filter(|e| e.window().is_always());
    for effect in always() {
        let Place::Input(i) = effect.resolve(vehicle)? else { continue };
        let gains = always().filter(|e| e.kind() == Kind::InputGain && e.place() == effect.place());
        let gain: f64 = gains.map(|e| e.get("factor")).product();
        if gain != 0.0 {
            found[i].take(effect, gain);
        }
    }
    Ok(found)
}

/// Coulomb friction of every state that has it.
///
/// # Errors
/// [`SimulatorError`] when an effect does not fit the vehicle.
pub fn frictions(vehicle: &Vehicle) -> Result<Vec<Friction>, SimulatorError> {
    let mut found: Vec<Friction> = Vec::new();
    for effect in vehicle.effects.iter().filter(|e| e.kind() == Kind::CoulombFriction) {
        let Place::State(state) = effect.resolve(vehicle)? else { continue };
        if !effect.window().is_always() {
            continue;
        }
        let (level, asymmetry) = (effect.get("level"), effect.get("asymmetry"));
        match found.iter_mut().find(|f| f.state == state) {
            Some(f) => (f.level, f.asymmetry) = (f.level + level, f.asymmetry + asymmetry),
            None => found.push(Friction { state, level, asymmetry }),
        }
    }
    Ok(found)
}
