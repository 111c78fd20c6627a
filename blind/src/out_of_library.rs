//! Effects outside the table: diagnosis must describe them without a name from the table.

use serde::{Deserialize, Serialize};

/// An effect outside the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OutOfLibrary {
    /// An input acts more strongly to one side: u + size abs(u).
    AsymmetricGain,
    /// An input's square is added to it: u + size u^2 / scale.
    SquaredInput,
    /// A relay with hysteresis is added to an input: plus size while u was last above scale, minus size while it was
    /// last below -scale.
    InputRelay,
    /// An input's gain swings: u (1 + size sin(2 pi scale t)).
    SwingingGain,
    /// -size x1 x2 is added to the derivative of a state.
    StateProduct,
    /// -size sin(scale x1) is added to the derivative of a state: wells, not a hardening spring.
    SineSpring,
    /// -size x1 sin(2 pi scale t) is added to the derivative of a state: a stiffness that swings.
    SwingingStiffness,
    /// size u x1 is added to the derivative of a state.
    Bilinear,
    /// A relay with hysteresis pushes a state: plus size after x1 fell below -scale, minus size after it rose above
    /// scale, late by its dead time. It runs in a limit cycle of its own.
    LimitCycle,
    /// A sensor creeps: y + size (y behind a lag of scale seconds).
    SensorCreep,
    /// A sensor bends: y + size y^2.
    SquaredSensor,
    /// A tone whose frequency sweeps over the record is added to an output: amplitude size, from scale Hz to three
    /// times that.
    SweepingTone,
    /// An input acts by its square, to its side: u + size u abs(u) / scale.
    SquareLawGain,
    /// An actuator sticks: it stands still until the command is size away from it, then jumps to the command.
    StickingInput,
    /// size times the product of two inputs is added to the derivative of a state.
    InputProduct,
    /// -size r^3 / (1 + r^4) with r = x1 / scale is added to the derivative of a state: it hardens, then yields.
    YieldingSpring,
    /// -size x1 (2 t / T - 1) is added to the derivative of a state, T the record's length: a stiffness that grows.
    StiffnessRamp,
    /// size x (1 - (x / scale)^2) is added to a state's own derivative: it swings by itself, as van der Pol's
    /// oscillator does.
    SelfExcitation,
    /// A sensor follows with a lag of size seconds, but no faster than scale per lag.
    SlewingSensor,
    /// A sensor bends to both sides: y + size y^3.
    CubedSensor,
}

impl OutOfLibrary {
    /// All of them.
    pub const ALL: [Self; 20] = [
        Self::AsymmetricGain,
        Self::SquaredInput,
        Self::InputRelay,
        Self::SwingingGain,
        Self::StateProduct,
        Self::SineSpring,
        Self::SwingingStiffness,
        Self::Bilinear,
        Self::LimitCycle,
        Self::SensorCreep,
        Self::SquaredSensor,
        Self::SweepingTone,
        Self::SquareLawGain,
        Self::StickingInput,
        Self::InputProduct,
        Self::YieldingSpring,
        Self::StiffnessRamp,
        Self::SelfExcitation,
        Self::SlewingSensor,
        Self::CubedSensor,
    ];

    /// Name in answers, for example `state_product`.
    pub fn name(self) -> &'static str {
        match self {
            Self::AsymmetricGain => "asymmetric_gain",
            Self::SquaredInput => "squared_input",
            Self::InputRelay => "input_relay",
            Self::SwingingGain => "swinging_gain",
            Self::StateProduct => "state_product",
            Self::SineSpring => "sine_spring",
            Self::SwingingStiffness => "swinging_stiffness",
            Self::Bilinear => "bilinear",
            Self::LimitCycle => "limit_cycle",
            Self::SensorCreep => "sensor_creep",
            Self::SquaredSensor => "squared_sensor",
            Self::SweepingTone => "sweeping_tone",
            Self::SquareLawGain => "square_law_gain",
            Self::StickingInput => "sticking_input",
            Self::InputProduct => "input_product",
            Self::YieldingSpring => "yielding_spring",
            Self::StiffnessRamp => "stiffness_ramp",
            Self::SelfExcitation => "self_excitation",
            Self::SlewingSensor => "slewing_sensor",
            Self::CubedSensor => "cubed_sensor",
        }
    }

    /// The effect of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|s| s.name() == name)
    }
}

/// An effect outside the table, at its place.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct OutOfLibraryEffect {
    pub kind: OutOfLibrary,
    /// Input, where one is concerned.
    pub input: usize,
    /// Second input, where two are concerned.
    pub other_input: usize,
    /// Output, where one is concerned.
    pub output: usize,
    /// First and second state that enter.
    pub states: (usize, usize),
    /// State whose derivative is changed.
    pub onto: usize,
    /// As the effect says, SI.
    pub size: f64,
    /// As the effect says, SI.
    pub scale: f64,
    /// Dead time of a relay, s.
    pub dead_time_s: f64,
}
