//! Table of effects: names, places and parameters, from which everything else about them is derived.

use super::kind::Kind;

/// Kind of place that an effect's `where` names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlaceKind {
    /// One input.
    Input,
    /// `"u_roll->u_pitch"`: one input onto another.
    InputPair,
    /// One output.
    Output,
    /// `"roll,pitch"`: two outputs that turn into each other.
    OutputPair,
    /// One state.
    State,
    /// `"roll->roll_rate"`: one state onto the derivative of another.
    StatePair,
    /// `"A[2,1]"`, `"B[4,2]"`: a matrix entry, one-based.
    Entry,
    /// The word `"vehicle"`.
    Vehicle,
}

/// Dimension of a parameter as a function of its place, to check a value written with a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// A dimensionless number.
    One,
    /// Seconds.
    Time,
    /// 1/s.
    Frequency,
    /// rad.
    Angle,
    /// The unit of the signal or state at the place.
    Signal,
    /// The unit of the signal or state at the place, per second.
    SignalRate,
    /// 1/(unit s), so that coefficient x abs(x) is a derivative.
    Drag,
    /// (unit of the second state / s) / (unit of the first)^3.
    Cubic,
    /// The unit of the matrix entry.
    Entry,
    /// Unit of the second input over the unit of the first.
    Coupling,
}

/// Whether a parameter must be given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Requirement {
    /// The parameter must be given.
    Required,
    /// The parameter is optional, with this default.
    Default(f64),
    /// Exactly one of the effect's parameters of this kind must be given.
    OneOf,
}

/// A numeric parameter of an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Name of the parameter in files.
    pub name: &'static str,
    /// Dimension of the parameter.
    pub scale: Scale,
    /// Smallest valid value.
    pub lower: f64,
    /// Largest valid value.
    pub upper: f64,
    /// Whether the parameter must be given.
    pub requirement: Requirement,
}

impl Parameter {
    /// Fixed unit of the parameter independent of the place, as of `delay_s`; empty for a dimensionless
    /// number, `None` where the place determines it.
    pub fn own_unit(&self) -> Option<&'static str> {
        match self.scale {
            Scale::One => Some(""),
            Scale::Time => Some("s"),
            Scale::Frequency if self.name.ends_with("_hz") => Some("Hz"),
            Scale::Frequency => Some("1/s"),
            Scale::Angle => Some("rad"),
            _ => None,
        }
    }
}

/// One row of the table: an effect with its place and parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spec {
    /// Kind of the effect.
    pub kind: Kind,
    /// Name of the effect in files.
    pub name: &'static str,
    /// Short description of the effect.
    pub summary: &'static str,
    /// Kind of place that `where` names.
    pub place: PlaceKind,
    /// Numeric parameters.
    pub parameters: &'static [Parameter],
    /// Name of the text parameter, if any, and whether it is required.
    pub text: Option<(&'static str, bool)>,
}

const INF: f64 = f64::INFINITY;
/// Longest simulated delay, s; the memory of a delay is proportional to it.
const LONGEST_DELAY: f64 = 60.0;

const fn p(name: &'static str, scale: Scale, lower: f64, upper: f64) -> Parameter {
    Parameter { name, scale, lower, upper, requirement: Requirement::Required }
}

const fn optional(name: &'static str, scale: Scale, lower: f64, upper: f64, default: f64) -> Parameter {
    Parameter { name, scale, lower, upper, requirement: Requirement::Default(default) }
}

const fn one_of(name: &'static str, scale: Scale) -> Parameter {
    Parameter { name, scale, lower: -INF, upper: INF, requirement: Requirement::OneOf }
}

const fn row(
    kind: Kind,
    name: &'static str,
    summary: &'static str,
    place: PlaceKind,
    parameters: &'static [Parameter],
) -> Spec {
    Spec { kind, name, summary, place, parameters, text: None }
}

const fn with_text(spec: Spec, name: &'static str, required: bool) -> Spec {
    Spec { text: Some((name, required)), ..spec }
}

/// All effects, in the order in which [`Kind`] declares them.
pub static SPECS: &[Spec] = &[
    row(
        Kind::InputDelay,
        "input_delay",
        "the input is delayed",
        PlaceKind::Input,
        &[p("delay_s", Scale::Time, 0.0, LONGEST_DELAY)],
    ),
    row(
        Kind::ActuatorLag,
        "actuator_lag",
        "the input follows as a first-order lag",
        PlaceKind::Input,
        &[p("time_constant_s", Scale::Time, 0.0, INF)],
    ),
    row(
        Kind::InputGain,
        "input_gain",
        "the input is scaled by a factor; 1 is nominal",
        PlaceKind::Input,
        &[p("factor", Scale::One, -INF, INF)],
    ),
    row(
        Kind::GainDrift,
        "gain_drift",
        "the input's effect changes with time: u (1 + rate t)",
        PlaceKind::Input,
        &[p("rate_per_s", Scale::Frequency, -INF, INF)],
    ),
    row(
        Kind::InputBias,
        "input_bias",
        "a constant is added to the input",
        PlaceKind::Input,
        &[p("offset", Scale::Signal, -INF, INF)],
    ),
    row(
        Kind::DeadZone,
        "dead_zone",
        "sign(u) max(abs(u) - width, 0)",
        PlaceKind::Input,
        &[p("width", Scale::Signal, 0.0, INF)],
    ),
    row(
        Kind::InputSaturation,
        "input_saturation",
        "the input is limited",
        PlaceKind::Input,
        &[p("lower", Scale::Signal, -INF, INF), p("upper", Scale::Signal, -INF, INF)],
    ),
    row(
        Kind::RateLimit,
        "rate_limit",
        "the rate of the input is limited",
        PlaceKind::Input,
        &[p("limit_per_s", Scale::SignalRate, 0.0, INF)],
    ),
    row(
        Kind::Backlash,
        "backlash",
        "backlash: the input moves only after the gap is taken up",
        PlaceKind::Input,
        &[p("width", Scale::Signal, 0.0, INF)],
    ),
    row(
        Kind::InputCoupling,
        "input_coupling",
        "one input is added to another",
        PlaceKind::InputPair,
        &[p("coefficient", Scale::Coupling, -INF, INF)],
    ),
    row(
        Kind::ParameterChange,
        "parameter_change",
        "a matrix entry has a different value",
        PlaceKind::Entry,
        &[one_of("value", Scale::Entry), one_of("factor", Scale::One)],
    ),
    row(
        Kind::QuadraticDrag,
        "quadratic_drag",
        "-c x abs(x) is added to the state's derivative",
        PlaceKind::State,
        &[p("coefficient", Scale::Drag, -INF, INF)],
    ),
    row(
        Kind::CoulombFriction,
        "coulomb_friction",
        "-level sign(x) - asymmetry is added to the state's derivative",
        PlaceKind::State,
        &[p("level", Scale::SignalRate, 0.0, INF), optional("asymmetry", Scale::SignalRate, -INF, INF, 0.0)],
    ),
    row(
        Kind::CubicStiffness,
        "cubic_stiffness",
        "-c x^3 of one state is added to the derivative of another",
        PlaceKind::StatePair,
        &[p("coefficient", Scale::Cubic, -INF, INF)],
    ),
    row(
        Kind::UnmodelledMode,
        "unmodelled_mode",
        "a second-order mode in series with the input",
        PlaceKind::Input,
        &[
            p("frequency_hz", Scale::Frequency, 1e-6, INF),
            p("damping_ratio", Scale::One, 0.0, INF),
            optional("gain", Scale::One, -INF, INF, 1.0),
        ],
    ),
    row(
        Kind::StepDisturbance,
        "step_disturbance",
        "a constant is added to the state's derivative from a time on",
        PlaceKind::State,
        &[p("at_s", Scale::Time, 0.0, INF), p("magnitude", Scale::SignalRate, -INF, INF)],
    ),
    row(
        Kind::PulseDisturbance,
        "pulse_disturbance",
        "a constant is added to the state's derivative for a while",
        PlaceKind::State,
        &[
            p("at_s", Scale::Time, 0.0, INF),
            p("duration_s", Scale::Time, 0.0, INF),
            p("magnitude", Scale::SignalRate, -INF, INF),
        ],
    ),
    row(
        Kind::PeriodicDisturbance,
        "periodic_disturbance",
        "a sine is added to the state's derivative",
        PlaceKind::State,
        &[
            p("frequency_hz", Scale::Frequency, 0.0, INF),
            p("amplitude", Scale::SignalRate, -INF, INF),
            optional("phase_rad", Scale::Angle, -INF, INF, 0.0),
        ],
    ),
    row(
        Kind::Turbulence,
        "turbulence",
        "first-order shaped noise is added to the state's derivative",
        PlaceKind::State,
        &[p("std", Scale::SignalRate, 0.0, INF), p("bandwidth_hz", Scale::Frequency, 1e-6, INF)],
    ),
    with_text(
        row(
            Kind::ModeTransition,
            "mode_transition",
            "from a time on the vehicle flies with the A and B of another",
            PlaceKind::Vehicle,
            &[p("at_s", Scale::Time, 0.0, INF)],
        ),
        "to",
        true,
    ),
    row(
        Kind::SensorBias,
        "sensor_bias",
        "a constant is added to the output",
        PlaceKind::Output,
        &[p("offset", Scale::Signal, -INF, INF)],
    ),
    row(
        Kind::SensorDrift,
        "sensor_drift",
        "rate t is added to the output",
        PlaceKind::Output,
        &[p("rate_per_s", Scale::SignalRate, -INF, INF)],
    ),
    row(
        Kind::SensorScale,
        "sensor_scale",
        "the output is scaled by a factor; 1 is nominal",
        PlaceKind::Output,
        &[p("factor", Scale::One, -INF, INF)],
    ),
    row(
        Kind::SensorDelay,
        "sensor_delay",
        "the output is delayed",
        PlaceKind::Output,
        &[p("delay_s", Scale::Time, 0.0, LONGEST_DELAY)],
    ),
    row(
        Kind::SensorLag,
        "sensor_lag",
        "the output follows as a first-order lag",
        PlaceKind::Output,
        &[p("time_constant_s", Scale::Time, 0.0, INF)],
    ),
    row(
        Kind::Misalignment,
        "misalignment",
        "the sensor is turned about its vertical axis: two outputs mix, and their rates with them",
        PlaceKind::OutputPair,
        &[p("angle_rad", Scale::Angle, -INF, INF)],
    ),
    with_text(
        row(
            Kind::Vibration,
            "vibration",
            "a sine is added to the output",
            PlaceKind::Output,
            &[
                p("frequency_hz", Scale::Frequency, 0.0, INF),
                p("amplitude", Scale::Signal, -INF, INF),
                optional("phase_rad", Scale::Angle, -INF, INF, 0.0),
            ],
        ),
        "source",
        false,
    ),
    row(
        Kind::Noise,
        "noise",
        "white Gaussian noise is added to the output, in addition to the declared noise",
        PlaceKind::Output,
        &[p("std", Scale::Signal, 0.0, INF)],
    ),
    row(
        Kind::Quantization,
        "quantization",
        "the output is rounded to a multiple of the step",
        PlaceKind::Output,
        &[p("step", Scale::Signal, 0.0, INF)],
    ),
    row(
        Kind::OutputSaturation,
        "output_saturation",
        "the output is limited",
        PlaceKind::Output,
        &[p("lower", Scale::Signal, -INF, INF), p("upper", Scale::Signal, -INF, INF)],
    ),
    row(
        Kind::Dropouts,
        "dropouts",
        "a fraction of the samples repeats the previous one",
        PlaceKind::Output,
        &[p("fraction", Scale::One, 0.0, 1.0)],
    ),
    row(
        Kind::Outliers,
        "outliers",
        "a fraction of the samples is off by plus or minus the magnitude",
        PlaceKind::Output,
        &[p("fraction", Scale::One, 0.0, 1.0), p("magnitude", Scale::Signal, -INF, INF)],
    ),
];
