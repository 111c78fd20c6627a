//! The kinds of effects.

/// Kind of an effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[expect(missing_docs, reason = "each is described in the table")]
pub enum Kind {
    InputDelay,
    ActuatorLag,
    InputGain,
    GainDrift,
    InputBias,
    DeadZone,
    InputSaturation,
    RateLimit,
    Backlash,
    InputCoupling,
    ParameterChange,
    QuadraticDrag,
    CoulombFriction,
    CubicStiffness,
    UnmodelledMode,
    StepDisturbance,
    PulseDisturbance,
    PeriodicDisturbance,
    Turbulence,
    ModeTransition,
    SensorBias,
    SensorDrift,
    SensorScale,
    SensorDelay,
    SensorLag,
    Misalignment,
    Vibration,
    Noise,
    Quantization,
    OutputSaturation,
    Dropouts,
    Outliers,
}
