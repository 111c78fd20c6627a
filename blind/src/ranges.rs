//! The ranges of a generator: every range that determines a trial, with its unit.

use super::excitation::Excitation;
use super::out_of_library::OutOfLibrary;

/// Least and greatest value of a drawn parameter.
pub(crate) type Interval = (f64, f64);

/// The ranges of a generator.
#[derive(Debug)]
pub(crate) struct Ranges {
    /// Shortest and longest record, s.
    pub lengths_s: Interval,
    /// Sampling rates, Hz, equally likely.
    pub rates_hz: &'static [f64],
    pub vehicles: VehicleRanges,
    pub excitation: ExcitationRanges,
    pub noise: NoiseRanges,
    pub effects: EffectRanges,
    /// Effects outside the table; trials use them in turn.
    pub outside: &'static [OutOfLibraryRange],
}

/// Ranges of the vehicles and their initial states.
#[derive(Debug)]
pub(crate) struct VehicleRanges {
    /// Share of the trials with a built-in helicopter.
    pub helicopters: f64,
    /// Share of the trials with the quadrotor.
    pub quadrotors: f64,
    /// Share of the helicopters whose positions are not measured.
    pub without_positions: f64,
    /// Share of the trials whose vehicle file has free parameters, where the vehicle has any.
    pub free: f64,
    /// Declared noise of a drawn vehicle's sensor relative to the root mean square of a large response.
    pub noise_share: Interval,
    /// Natural frequency of a drawn axis, rad/s.
    pub axis_rad_s: Interval,
    /// Damping ratio of a drawn axis.
    pub axis_damping: Interval,
    /// Largest coupling of one axis into another, relative to the stiffness of the axis.
    pub axis_coupling: f64,
    /// Gain of an axis's own input, relative to the stiffness of the axis.
    pub axis_gain: Interval,
    /// Damping rate of a drawn speed, 1/s.
    pub speed_damping: Interval,
    /// Distance of the slowest pole of a drawn matrix from the imaginary axis, 1/s.
    pub stability_margin: Interval,
    /// Share of the trials that do not start at rest.
    pub moving_start: f64,
    /// Standard deviation of a moving initial state relative to the root mean square of that state's motion.
    pub start_spread: f64,
}

/// Ranges of the excitation.
#[derive(Debug)]
pub(crate) struct ExcitationRanges {
    /// Kinds of excitation, equally likely.
    pub kinds: &'static [Excitation],
    /// Greatest command as a share of the input's limit.
    pub share: Interval,
    /// Limits of `share` when it is scaled for detectability; below the lower one, noise would mask the
    /// motion.
    pub share_limits: Interval,
    /// Greatest command of one input relative to `share`.
    pub input_share: Interval,
    /// Time at rest before the first step, s.
    pub rest_s: Interval,
    /// Time unit of steps, in periods of the highest frequency that the vehicle follows.
    pub unit: Interval,
    /// Height of steps relative to the greatest command.
    pub level: Interval,
    /// Pause between manoeuvres, in time units.
    pub pause: Interval,
    /// Lowest frequency of a sweep relative to the highest that the vehicle follows.
    pub sweep_lowest: Interval,
    /// Corner frequency of pilot-like commands relative to the highest frequency that the vehicle follows.
    pub pilot_corner: f64,
}

/// Ranges of the sensor noise.
#[derive(Debug)]
pub(crate) struct NoiseRanges {
    /// Kinds of noise, equally likely; clean records use them in turn.
    pub colours: &'static [ColourRange],
    /// Standard deviation relative to the declared one, common to all outputs.
    pub level: Interval,
    /// Additional factor on it, drawn for each output.
    pub spread: Interval,
}

/// A kind of noise with the ranges of its parameters.
#[derive(Debug)]
pub(crate) enum ColourRange {
    White,
    /// First-order autoregressive noise with this coefficient.
    Ar1(f64),
    /// A resonance whose frequency is a share of the sampling rate.
    Resonant {
        rate_share: Interval,
        radius: Interval,
    },
    /// A resonance at a frequency, Hz, that is independent of the sampling rate.
    SlowResonant {
        frequency_hz: Interval,
        radius: Interval,
    },
    /// Two resonances whose frequencies are shares of the sampling rate.
    Ar4 {
        rate_shares: [Interval; 2],
        radius: Interval,
    },
    /// White noise on a drifting zero, with the drift's time constant, s, and the share of the variance that
    /// is white.
    Wandering {
        time_constant_s: Interval,
        white_share: Interval,
    },
    /// White noise with Student's t distribution; the degrees of freedom are at least the first number and
    /// below the second.
    StudentT {
        degrees: (u32, u32),
    },
}

/// Sizes and other parameters of the table's effects.
///
/// Unless stated otherwise, a size is relative to the peak of the input, to the root mean square of the terms
/// of the state's derivative, or to the output's noise.
#[derive(Debug)]
pub(crate) struct EffectRanges {
    /// Delay of an input, s.
    pub input_delay_s: Interval,
    /// Time constant of an actuator lag, s.
    pub actuator_lag_s: Interval,
    /// Deviation of the gain factor from 1.
    pub input_gain: Interval,
    /// Change of the gain over the record.
    pub gain_drift: Interval,
    pub input_bias: Interval,
    pub dead_zone: Interval,
    /// Share of the peaks that is cut off.
    pub input_saturation: Interval,
    /// Share that is cut off at the lower side relative to that at the upper side.
    pub saturation_lean: Interval,
    /// Time of a move over the whole command range, s.
    pub rate_limit_s: Interval,
    /// Gap relative to the whole range of the input.
    pub backlash: Interval,
    pub input_coupling: Interval,
    /// Period of the mode, s.
    pub mode_period_s: Interval,
    pub mode_damping: Interval,
    /// Share of the modes whose gain is 1.
    pub mode_unit_gain: f64,
    pub mode_gain: Interval,
    /// Deviation of the factor from 1.
    pub parameter_change: Interval,
    pub quadratic_drag: Interval,
    pub coulomb_friction: Interval,
    /// Share of the frictions whose level depends on the direction.
    pub lopsided_friction: f64,
    /// Asymmetry relative to the level.
    pub friction_asymmetry: Interval,
    pub cubic_stiffness: Interval,
    /// Share of the springs that harden.
    pub hardening: f64,
    /// Size of a softening spring relative to that of a hardening one.
    pub softening: f64,
    /// Time of the step, as a share of the record.
    pub step_at: Interval,
    pub step: Interval,
    /// Start of the pulse, as a share of the record.
    pub pulse_at: Interval,
    /// Duration of the pulse, s.
    pub pulse_s: Interval,
    pub pulse: Interval,
    /// Frequency of the periodic disturbance, Hz.
    pub periodic_hz: Interval,
    pub periodic: Interval,
    /// Bandwidth of the turbulence, Hz.
    pub turbulence_hz: Interval,
    pub turbulence: Interval,
    /// Share of the trials whose turbulence has the second-order Dryden spectrum.
    pub dryden: f64,
    /// Share of the record after the transition to the other mode.
    pub mode_transition: Interval,
    pub sensor_bias: Interval,
    /// Drift over the whole record.
    pub sensor_drift: Interval,
    /// Deviation of the scale factor from 1.
    pub sensor_scale: Interval,
    /// Delay of a sensor, s.
    pub sensor_delay_s: Interval,
    /// Time constant of a sensor lag, s.
    pub sensor_lag_s: Interval,
    /// Angle of a misalignment, rad.
    pub misalignment_rad: Interval,
    /// Share of the vibrations below half the sampling rate.
    pub vibration_below_half: f64,
    /// Frequency of the low vibrations, as a share of the sampling rate.
    pub vibration_low: Interval,
    /// Frequency of the other vibrations, as a share of the sampling rate.
    pub vibration_high: Interval,
    pub vibration: Interval,
    /// Total noise relative to the declared noise.
    pub noise: Interval,
    pub quantization: Interval,
    /// Share of the peaks that is cut off.
    pub output_saturation: Interval,
    pub dropouts: Interval,
    pub outliers: Interval,
    pub outlier_magnitude: Interval,
}

/// An effect outside the table with its ranges; its kind defines size and scale.
#[derive(Debug)]
pub(crate) struct OutOfLibraryRange {
    pub kind: OutOfLibrary,
    /// Size relative to the motion, as defined in the draft.
    pub size: Interval,
    /// Scale in Hz or s where the effect defines it so, otherwise relative to the motion.
    pub scale: Interval,
    /// Dead time, s, where the effect has one.
    pub dead_time_s: Interval,
}
