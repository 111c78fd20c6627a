//! A candidate: an effect at a place, with what is open about it.

use whirlstand_vehicle::{Effect, Kind};

/// A parameter of a candidate that is fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tunable {
    /// Name in the table.
    pub name: &'static str,
    /// Least value.
    pub lower: f64,
    /// Greatest value.
    pub upper: f64,
    /// A typical change, for differences.
    pub scale: f64,
    /// True for one that says how large the effect is: its interval must be narrow for the effect to be accepted.
    pub size: bool,
}

/// An effect at a place, with values still open.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Which effect.
    pub kind: Kind,
    /// Its place.
    pub place: String,
    /// What is fitted.
    pub tunables: Vec<Tunable>,
    /// Parameters that stay as they are.
    pub fixed: Vec<(&'static str, f64)>,
    /// The text parameter.
    pub text: Option<String>,
    /// Values to start from.
    pub starts: Vec<Vec<f64>>,
    /// The response is proportional to the distance of the last tunable from `null`, so that one start is enough.
    pub linear: bool,
    /// Value of the last tunable at which there is no effect.
    pub null: f64,
    /// How many independent looks the choice among starts amounts to.
    pub looks: f64,
}

impl Candidate {
    /// The effect at a place with nothing to fit, for tests.
    #[cfg(test)]
    pub(crate) fn bare(kind: Kind, place: &str) -> Self {
        Self {
            kind,
            place: place.into(),
            tunables: Vec::new(),
            fixed: Vec::new(),
            text: None,
            starts: Vec::new(),
            linear: false,
            null: 0.0,
            looks: 1.0,
        }
    }

    /// The effect with the given values; `None` when the table does not allow them.
    pub fn effect(&self, values: &[f64]) -> Option<Effect> {
        let effect = match &self.text {
            Some(to) if self.kind == Kind::ModeTransition => Effect::mode_transition(values[0], to).ok()?,
            _ => {
                let parameters = self.tunables.iter().zip(values).map(|(t, v)| (t.name, *v));
                let all: Vec<(&str, f64)> = parameters.chain(self.fixed.iter().copied()).collect();
                Effect::new(self.kind, &self.place, &all).ok()?
            }
        };
        if self.kind == Kind::InputSaturation {
            // A lower limit above the upper one is no saturation.
            let (lower, upper) = (effect.parameter("lower")?, effect.parameter("upper")?);
            (lower < upper).then_some(())?;
        }
        Some(effect)
    }

    /// True when the other is the same effect at the same place with the same values open: there are limits of one side
    /// and of both, dry friction with and without a preferred side.
    pub fn is_same(&self, other: &Candidate) -> bool {
        let open = |c: &Candidate| c.tunables.iter().map(|t| t.name).collect::<Vec<_>>();
        self.name() == other.name()
            && self.text == other.text
            && open(self) == open(other)
            && self.fixed.iter().map(|f| f.0).eq(other.fixed.iter().map(|f| f.0))
    }

    /// `effect(place)`.
    pub fn name(&self) -> String {
        format!("{}({})", self.kind, self.place)
    }
}

/// Sizes of what a record holds, from which the sizes of effects follow.
#[derive(Debug, Clone, PartialEq)]
pub struct Sizes {
    /// Largest magnitude of each input.
    pub inputs: Vec<f64>,
    /// Largest magnitude of each state in the free run.
    pub states: Vec<f64>,
    /// Root mean square of each state's derivative.
    pub slopes: Vec<f64>,
    /// Largest magnitude of each output.
    pub outputs: Vec<f64>,
    /// Standard deviation of each output's noise.
    pub noise: Vec<f64>,
    /// Length, s.
    pub duration_s: f64,
    /// First and last time, s, as effects count it.
    pub times_s: (f64, f64),
    /// Period, s.
    pub period_s: f64,
}

#[cfg(test)]
impl Sizes {
    /// All of size one.
    pub(crate) fn ones(vehicle: &whirlstand_vehicle::Vehicle, duration_s: f64, period_s: f64) -> Self {
        let (states, outputs) = (vec![1.0; vehicle.states.len()], vec![1.0; vehicle.outputs.len()]);
        Self {
            inputs: vec![1.0; vehicle.inputs.len()],
            slopes: states.clone(),
            states,
            noise: outputs.clone(),
            outputs,
            duration_s,
            times_s: (0.0, duration_s),
            period_s,
        }
    }
}
