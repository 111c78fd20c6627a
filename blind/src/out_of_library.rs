//! Effects outside the table, which a diagnosis must describe without a name from the table.

use serde::{Deserialize, Serialize};

/// An effect outside the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OutOfLibrary {
    /// The gain of an input depends on the sign: u + size abs(u).
    AsymmetricGain,
    /// The square of an input is added to it: u + size u^2 / scale.
    SquaredInput,
    /// A relay with hysteresis is added to an input: +size after u rose above scale, -size after it fell
    /// below -scale.
    InputRelay,
    /// The gain of an input oscillates: u (1 + size sin(2 pi scale t)).
    SwingingGain,
    /// -size x1 x2 is added to the derivative of a state.
    StateProduct,
    /// The periodic spring -size sin(scale x1) is added to the derivative of a state; unlike a hardening
    /// spring it has several wells.
    SineSpring,
    /// The oscillating stiffness -size x1 sin(2 pi scale t) is added to the derivative of a state.
    SwingingStiffness,
    /// size u x1 is added to the derivative of a state.
    Bilinear,
    /// A relay with hysteresis and a dead time, which runs in a limit cycle, acts on the derivative of a
    /// state: +size after x1 fell below -scale, -size after it rose above scale.
    LimitCycle,
    /// A sensor with creep: y + size (y after a first-order lag of scale seconds).
    SensorCreep,
    /// A sensor with a quadratic error: y + size y^2.
    SquaredSensor,
    /// A tone whose frequency sweeps over the record, from scale Hz to three times that, is added to an
    /// output with the amplitude size.
    SweepingTone,
    /// The signed square of an input is added to it: u + size u abs(u) / scale.
    SquareLawGain,
    /// An actuator with stiction: it holds its position until the command is size away from it, then jumps to
    /// the command.
    StickingInput,
    /// size times the product of two inputs is added to the derivative of a state.
    InputProduct,
    /// A spring that first hardens, then yields, is added to the derivative of a state: -size r^3 / (1 + r^4)
    /// with r = x1 / scale.
    YieldingSpring,
    /// A stiffness that grows with time, -size x1 (2 t / T - 1) with the record's length T, is added to the
    /// derivative of a state.
    StiffnessRamp,
    /// Self-excitation as in a van der Pol oscillator: size x (1 - (x / scale)^2) is added to the state's own
    /// derivative.
    SelfExcitation,
    /// A sensor with a lag of size seconds and a rate limit of scale per size seconds.
    SlewingSensor,
    /// A sensor with a cubic error: y + size y^3.
    CubedSensor,
}

impl OutOfLibrary {
    /// All effects outside the table.
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

    /// The effect with the name `name`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|s| s.name() == name)
    }
}

/// An effect outside the table with its place and parameters.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct OutOfLibraryEffect {
    pub kind: OutOfLibrary,
    /// Index of the input, where the effect depends on one.
    pub input: usize,
    /// Index of the second input, where the effect depends on two.
    pub other_input: usize,
    /// Index of the output, where the effect acts on one.
    pub output: usize,
    /// The two states on which the effect depends.
    pub states: (usize, usize),
    /// Index of the state whose derivative is changed.
    pub onto: usize,
    /// Size as defined by the kind, SI.
    pub size: f64,
    /// Scale as defined by the kind, SI.
    pub scale: f64,
    /// Dead time of a relay, s.
    pub dead_time_s: f64,
}
