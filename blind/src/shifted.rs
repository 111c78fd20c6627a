//! The shifted ranges: they differ from the reference ranges wherever the diagnosis might have been fitted to
//! those.

use super::excitation::Excitation;
use super::out_of_library::OutOfLibrary;
use super::ranges::{
    ColourRange, EffectRanges, ExcitationRanges, Interval, NoiseRanges, OutOfLibraryRange, Ranges,
    VehicleRanges,
};

/// Ranges of the shifted generator.
pub(crate) const SHIFTED: Ranges = Ranges {
    lengths_s: (20.0, 100.0),
    rates_hz: &[40.0, 80.0, 125.0, 250.0],
    vehicles: VehicleRanges {
        helicopters: 0.2,
        quadrotors: 0.2,
        without_positions: 0.3,
        free: 0.35,
        noise_share: (0.002, 0.035),
        axis_rad_s: (0.5, 9.0),
        axis_damping: (0.12, 1.5),
        axis_coupling: 0.8,
        axis_gain: (0.2, 1.4),
        speed_damping: (0.1, 3.0),
        stability_margin: (0.2, 1.6),
        moving_start: 0.6,
        start_spread: 0.8,
    },
    excitation: ExcitationRanges {
        kinds: &[
            Excitation::Doublets,
            Excitation::Steps3211,
            Excitation::Multisteps,
            Excitation::Chirp,
            Excitation::Prbs,
            Excitation::Pilot,
        ],
        share: (0.04, 0.6),
        share_limits: (0.025, 0.8),
        input_share: (0.45, 1.0),
        rest_s: (0.5, 3.0),
        unit: (0.15, 1.8),
        level: (0.3, 1.0),
        pause: (1.0, 5.0),
        sweep_lowest: (0.015, 0.05),
        pilot_corner: 0.3,
    },
    noise: NoiseRanges {
        colours: &[
            ColourRange::White,
            ColourRange::StudentT { degrees: (4, 8) },
            ColourRange::Ar1(0.6),
            ColourRange::Ar1(0.97),
            ColourRange::Ar1(-0.55),
            ColourRange::SlowResonant { frequency_hz: (1.2, 2.0), radius: (0.96, 0.975) },
            ColourRange::Resonant { rate_share: (0.03, 0.47), radius: (0.5, 0.8) },
            ColourRange::Ar4 { rate_shares: [(0.03, 0.12), (0.2, 0.45)], radius: (0.75, 0.94) },
            ColourRange::Wandering { time_constant_s: (2.0, 20.0), white_share: (0.2, 0.7) },
        ],
        level: (0.65, 1.35),
        spread: (0.8, 1.2),
    },
    effects: EFFECTS,
    outside: &OUTSIDE,
};

const EFFECTS: EffectRanges = EffectRanges {
    input_delay_s: (0.012, 0.45),
    actuator_lag_s: (0.035, 0.9),
    input_gain: (0.04, 0.7),
    gain_drift: (0.08, 0.7),
    input_bias: (0.004, 0.8),
    dead_zone: (0.05, 0.75),
    input_saturation: (0.1, 0.8),
    saturation_lean: (0.6, 1.3),
    rate_limit_s: (0.1, 3.5),
    backlash: (0.05, 0.7),
    input_coupling: (0.05, 0.9),
    mode_period_s: (0.05, 2.0),
    mode_damping: (0.02, 1.0),
    mode_unit_gain: 0.3,
    mode_gain: (0.7, 1.4),
    parameter_change: (0.08, 0.95),
    quadratic_drag: (0.05, 1.6),
    coulomb_friction: (0.02, 0.7),
    lopsided_friction: 0.5,
    friction_asymmetry: (-0.7, 0.7),
    cubic_stiffness: (0.04, 1.6),
    hardening: 0.5,
    softening: 0.3,
    step_at: (0.08, 0.85),
    step: (2e-4, 3.0),
    pulse_at: (0.05, 0.85),
    pulse_s: (0.06, 8.0),
    pulse: (2e-3, 15.0),
    periodic_hz: (0.05, 6.0),
    periodic: (2e-4, 3.0),
    turbulence_hz: (0.05, 5.0),
    turbulence: (5e-3, 1.5),
    dryden: 0.5,
    mode_transition: (0.1, 0.8),
    sensor_bias: (0.02, 50.0),
    sensor_drift: (0.04, 90.0),
    sensor_scale: (0.03, 0.7),
    sensor_delay_s: (0.012, 0.45),
    sensor_lag_s: (0.035, 0.9),
    misalignment_rad: (0.03, 0.6),
    vibration_below_half: 0.7,
    vibration_low: (0.02, 0.48),
    vibration_high: (0.52, 2.4),
    vibration: (0.05, 8.0),
    noise: (2.6, 12.0),
    quantization: (2.0, 40.0),
    output_saturation: (0.1, 0.75),
    dropouts: (0.03, 0.5),
    outliers: (0.001, 0.06),
    outlier_magnitude: (5.0, 80.0),
};

const OUTSIDE: [OutOfLibraryRange; 16] = [
    outside(OutOfLibrary::SquareLawGain, (0.1, 0.9), NONE),
    outside(OutOfLibrary::StickingInput, (0.05, 0.6), NONE),
    outside(OutOfLibrary::InputRelay, (0.05, 0.7), (0.05, 0.5)),
    outside(OutOfLibrary::InputProduct, (0.05, 1.0), NONE),
    outside(OutOfLibrary::SwingingGain, (0.1, 0.8), (0.03, 0.07)),
    outside(OutOfLibrary::YieldingSpring, (0.05, 1.5), (0.3, 1.2)),
    outside(OutOfLibrary::StiffnessRamp, (0.05, 1.0), NONE),
    outside(OutOfLibrary::StateProduct, (0.05, 1.5), NONE),
    outside(OutOfLibrary::SelfExcitation, (0.02, 0.6), (0.2, 1.0)),
    outside(OutOfLibrary::LimitCycle, (0.05, 0.8), (0.03, 0.3)),
    outside(OutOfLibrary::Bilinear, (0.05, 1.2), NONE),
    outside(OutOfLibrary::SlewingSensor, (0.03, 1.0), (0.05, 0.4)),
    outside(OutOfLibrary::CubedSensor, (0.08, 0.8), NONE),
    outside(OutOfLibrary::SensorCreep, (0.08, 1.0), (0.5, 1.8)),
    outside(OutOfLibrary::SineSpring, (0.05, 0.8), (2.5, 4.5)),
    outside(OutOfLibrary::SweepingTone, (0.15, 8.0), (0.1, 0.45)),
];

/// The scale of an effect that uses no scale.
const NONE: Interval = (1.0, 1.0);

const fn outside(kind: OutOfLibrary, size: Interval, scale: Interval) -> OutOfLibraryRange {
    OutOfLibraryRange { kind, size, scale, dead_time_s: (0.12, 0.4) }
}
