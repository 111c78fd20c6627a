//! The effects that there are.

/// Which effect.
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

impl Kind {
    /// Whether it acts sample by sample on an input or a sensor, so that it can act for a part of the time.
    pub fn can_be_switched(self) -> bool {
        matches!(
            self,
            Self::InputGain
                | Self::GainDrift
                | Self::InputBias
                | Self::DeadZone
                | Self::InputSaturation
                | Self::RateLimit
                | Self::Backlash
                | Self::SensorBias
                | Self::SensorDrift
                | Self::SensorScale
                | Self::Vibration
                | Self::Noise
                | Self::Quantization
                | Self::OutputSaturation
                | Self::Dropouts
                | Self::Outliers
        )
    }
}
