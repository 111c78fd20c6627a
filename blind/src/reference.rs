//! The ranges against which the diagnosis was developed.

use super::excitation::Excitation;
use super::out_of_library::OutOfLibrary;
use super::ranges::{
    ColourRange, EffectRanges, ExcitationRanges, Interval, NoiseRanges, OutOfLibraryRange, Ranges,
    VehicleRanges,
};

/// Ranges of the reference generator.
pub(crate) const REFERENCE: Ranges = Ranges {
    lengths_s: (30.0, 120.0),
    rates_hz: &[50.0, 100.0, 200.0],
    vehicles: VehicleRanges {
        helicopters: 0.25,
        quadrotors: 0.35,
        without_positions: 0.5,
        free: 0.25,
        noise_share: (0.003, 0.02),
        axis_rad_s: (0.8, 6.0),
        axis_damping: (0.2, 1.1),
        axis_coupling: 0.5,
        axis_gain: (0.3, 1.0),
        speed_damping: (0.2, 2.0),
        stability_margin: (0.3, 1.0),
        moving_start: 0.4,
        start_spread: 0.5,
    },
    excitation: ExcitationRanges {
        kinds: &[Excitation::Doublets, Excitation::Steps3211, Excitation::Sweep, Excitation::Pilot],
        share: (0.05, 0.5),
        share_limits: (0.03, 0.7),
        input_share: (0.7, 1.0),
        rest_s: (0.3, 1.5),
        unit: (0.25, 1.0),
        level: (0.5, 1.0),
        pause: (0.3, 2.0),
        sweep_lowest: (0.03, 0.08),
        pilot_corner: 0.5,
    },
    noise: NoiseRanges {
        colours: &[
            ColourRange::White,
            ColourRange::Ar1(0.9),
            ColourRange::Resonant { rate_share: (0.06, 0.35), radius: (0.88, 0.95) },
        ],
        level: (0.7, 1.2),
        spread: (0.9, 1.1),
    },
    effects: EFFECTS,
    outside: &OUTSIDE,
};

const EFFECTS: EffectRanges = EffectRanges {
    input_delay_s: (0.005, 0.3),
    actuator_lag_s: (0.02, 0.5),
    input_gain: (0.05, 0.5),
    gain_drift: (0.05, 0.5),
    input_bias: (0.002, 0.5),
    dead_zone: (0.03, 0.6),
    input_saturation: (0.05, 0.7),
    saturation_lean: (0.85, 1.15),
    rate_limit_s: (0.05, 2.0),
    backlash: (0.03, 0.5),
    input_coupling: (0.03, 0.6),
    mode_period_s: (0.08, 1.2),
    mode_damping: (0.05, 0.8),
    mode_unit_gain: 0.7,
    mode_gain: (0.8, 1.2),
    parameter_change: (0.05, 0.8),
    quadratic_drag: (0.03, 1.0),
    coulomb_friction: (0.01, 0.5),
    lopsided_friction: 0.3,
    friction_asymmetry: (-0.5, 0.5),
    cubic_stiffness: (0.02, 1.0),
    hardening: 0.75,
    softening: 0.2,
    step_at: (0.15, 0.7),
    step: (1e-4, 2.0),
    pulse_at: (0.1, 0.8),
    pulse_s: (0.1, 3.0),
    pulse: (1e-3, 10.0),
    periodic_hz: (0.1, 3.0),
    periodic: (1e-4, 2.0),
    turbulence_hz: (0.1, 2.0),
    turbulence: (3e-3, 1.0),
    dryden: 0.0,
    mode_transition: (0.15, 0.7),
    sensor_bias: (0.01, 30.0),
    sensor_drift: (0.02, 60.0),
    sensor_scale: (0.02, 0.5),
    sensor_delay_s: (0.005, 0.3),
    sensor_lag_s: (0.02, 0.5),
    misalignment_rad: (0.02, 0.35),
    vibration_below_half: 0.85,
    vibration_low: (0.05, 0.46),
    vibration_high: (0.54, 1.6),
    vibration: (0.03, 5.0),
    noise: (2.3, 8.0),
    quantization: (3.0, 25.0),
    output_saturation: (0.05, 0.6),
    dropouts: (0.02, 0.3),
    outliers: (0.002, 0.03),
    outlier_magnitude: (6.0, 40.0),
};

const OUTSIDE: [OutOfLibraryRange; 12] = [
    outside(OutOfLibrary::AsymmetricGain, (0.08, 0.6), NONE),
    outside(OutOfLibrary::SquaredInput, (0.08, 0.6), NONE),
    outside(OutOfLibrary::InputRelay, (0.05, 0.5), (0.2, 0.2)),
    outside(OutOfLibrary::SwingingGain, (0.08, 0.7), (0.08, 1.0)),
    outside(OutOfLibrary::StateProduct, (0.03, 1.0), NONE),
    outside(OutOfLibrary::SineSpring, (0.03, 0.6), (5.0, 10.0)),
    outside(OutOfLibrary::SwingingStiffness, (0.03, 0.8), (0.1, 1.5)),
    outside(OutOfLibrary::Bilinear, (0.03, 0.8), NONE),
    outside(OutOfLibrary::LimitCycle, (0.03, 0.6), (0.1, 0.1)),
    outside(OutOfLibrary::SensorCreep, (0.05, 0.8), (2.0, 10.0)),
    outside(OutOfLibrary::SquaredSensor, (0.05, 0.6), NONE),
    outside(OutOfLibrary::SweepingTone, (0.1, 5.0), (0.5, 3.0)),
];

/// The scale of an effect that uses no scale.
const NONE: Interval = (1.0, 1.0);

const fn outside(kind: OutOfLibrary, size: Interval, scale: Interval) -> OutOfLibraryRange {
    OutOfLibraryRange { kind, size, scale, dead_time_s: (0.5, 0.5) }
}
