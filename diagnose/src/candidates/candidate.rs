//! A candidate cause: an effect at a place, with its free parameters.

use whirlstand_vehicle::{Effect, Kind};

/// A parameter of a candidate that is fitted, with its range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tunable {
    /// Name of the parameter in the table.
    pub name: &'static str,
    /// Lower limit.
    pub lower: f64,
    /// Upper limit.
    pub upper: f64,
    /// Typical change, used as the step of finite differences.
    pub scale: f64,
    /// True for a size of the effect: its interval must be narrow for the effect to be accepted.
    pub size: bool,
}

/// An effect at a place, with parameters still to be fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Kind of the effect.
    pub kind: Kind,
    /// Place of the effect.
    pub place: String,
    /// Parameters that are fitted.
    pub tunables: Vec<Tunable>,
    /// Parameters that keep their values: of limits, the one that the record does not reach; of a mode, a gain of one.
    pub fixed: Vec<(Tunable, f64)>,
    /// The text parameter, if the effect has one.
    pub text: Option<String>,
    /// Start values of the tunables, one vector per start.
    pub starts: Vec<Vec<f64>>,
    /// The response is proportional to the distance of the last tunable from `null`, so that one start is enough.
    pub linear: bool,
    /// Value of the last tunable at which there is no effect.
    pub null: f64,
    /// Number of independent trials to which the choice among the starts amounts.
    pub looks: f64,
}

impl Candidate {
    /// The effect at a place without tunables, for tests.
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

    /// True for a force on one state that no input, state or output causes: each gust of turbulence is one.
    pub fn is_gust(&self) -> bool {
        self.is_event() || self.kind == Kind::PeriodicDisturbance
    }

    /// True for a force on one state that happens once.
    pub fn is_event(&self) -> bool {
        matches!(self.kind, Kind::StepDisturbance | Kind::PulseDisturbance)
    }

    /// The effect with the given values; `None` when the table does not allow them.
    pub fn effect(&self, values: &[f64]) -> Option<Effect> {
        let tuned = self.tunables.iter().zip(values).map(|(t, v)| (t.name, *v));
        let all: Vec<(&str, f64)> = tuned.chain(self.fixed.iter().map(|(t, v)| (t.name, *v))).collect();
        let effect = match &self.text {
            Some(to) if self.kind == Kind::ModeTransition => {
                let at_s = all.iter().find(|(name, _)| *name == "at_s")?.1;
                Effect::mode_transition(at_s, to).ok()?
            }
            _ => Effect::new(self.kind, &self.place, &all).ok()?,
        };
        if self.kind == Kind::InputSaturation {
            // A lower limit above the upper one is not a saturation.
            let (lower, upper) = (effect.parameter("lower")?, effect.parameter("upper")?);
            (lower < upper).then_some(())?;
        }
        Some(effect)
    }

    /// True for the same effect at the same place with the same parameters free: variants exist with
    /// one-sided and two-sided limits, and with dry friction with and without a bias.
    pub fn is_same(&self, other: &Candidate) -> bool {
        let open = |c: &Candidate| c.tunables.iter().map(|t| t.name).collect::<Vec<_>>();
        self.name() == other.name()
            && self.text == other.text
            && open(self) == open(other)
            && self.fixed.iter().map(|f| f.0.name).eq(other.fixed.iter().map(|f| f.0.name))
    }

    /// Name of the candidate, as in `effect(place)`.
    pub fn name(&self) -> String {
        format!("{}({})", self.kind, self.place)
    }
}

/// Magnitudes of a record's signals, from which typical sizes of effects follow.
#[derive(Debug, Clone, PartialEq)]
pub struct Sizes {
    /// Largest magnitude of each input.
    pub inputs: Vec<f64>,
    /// Lowest and highest value of each input.
    pub input_ranges: Vec<(f64, f64)>,
    /// Fastest mean rate of each input over the times of [`crate::thresholds::LIMITED_TIMES_S`].
    pub input_rates: Vec<Vec<f64>>,
    /// Largest magnitude of each state in the free run.
    pub states: Vec<f64>,
    /// Root mean square of each state derivative.
    pub slopes: Vec<f64>,
    /// Largest magnitude of each output.
    pub outputs: Vec<f64>,
    /// Standard deviation of each output's noise.
    pub noise: Vec<f64>,
    /// Length of the record, s.
    pub duration_s: f64,
    /// First and last time of the record, s, on the clock of the effects.
    pub times_s: (f64, f64),
    /// Sampling period, s.
    pub period_s: f64,
}

#[cfg(test)]
impl Sizes {
    /// All magnitudes equal to one.
    pub(crate) fn ones(vehicle: &whirlstand_vehicle::Vehicle, duration_s: f64, period_s: f64) -> Self {
        let (states, outputs) = (vec![1.0; vehicle.states.len()], vec![1.0; vehicle.outputs.len()]);
        Self {
            inputs: vec![1.0; vehicle.inputs.len()],
            input_ranges: vec![(-1.0, 1.0); vehicle.inputs.len()],
            input_rates: vec![vec![1.0]; vehicle.inputs.len()],
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
