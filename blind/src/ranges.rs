//! The ranges of a generator: every range that determines a trial, with its unit.

use super::excitation::Excitation;
use super::out_of_library::OutOfLibrary;

/// Least and greatest value of a draw.
pub(crate) type Interval = (f64, f64);

/// The ranges of a generator.
#[derive(Debug)]
pub(crate) struct Ranges {
    /// Shortest and longest record, s.
    pub lengths_s: Interval,
    /// Sampling rates, Hz; each is as likely.
    pub rates_hz: &'static [f64],
    pub vehicles: VehicleRanges,
    pub excitation: ExcitationRanges,
    pub noise: NoiseRanges,
    pub effects: EffectRanges,
    /// Effects outside the table; trials take them in turn.
    pub outside: &'static [OutOfLibraryRange],
}

/// Which vehicles, and how they start.
#[derive(Debug)]
pub(crate) struct VehicleRanges {
    /// Share of the trials with a built-in helicopter.
    pub helicopters: f64,
    /// Share of the trials with the quadrotor.
    pub quadrotors: f64,
    /// Share of the helicopters whose positions are not measured.
    pub without_positions: f64,
    /// Share of the trials whose vehicle file has free parameters, where it knows some.
    pub free: f64,
    /// Declared noise of a drawn vehicle's sensor over the root mean square of a brisk response.
    pub noise_share: Interval,
    /// Natural frequency of a drawn axis, rad/s.
    pub axis_rad_s: Interval,
    /// Damping ratio of a drawn axis.
    pub axis_damping: Interval,
    /// Largest coupling of one axis into another, relative to the axis's own stiffness.
    pub axis_coupling: f64,
    /// Effect of an axis's own input, relative to its stiffness.
    pub axis_gain: Interval,
    /// Damping rate of a drawn speed, 1/s.
    pub speed_damping: Interval,
    /// Distance of the slowest pole of a drawn matrix from the imaginary axis, 1/s.
    pub stability_margin: Interval,
    /// Share of the trials that do not start at rest.
    pub moving_start: f64,
    /// Standard deviation of such an initial state over the root mean square of that state's motion.
    pub start_spread: f64,
}

/// How the vehicle is excited.
#[derive(Debug)]
pub(crate) struct ExcitationRanges {
    /// Kinds; each is as likely.
    pub kinds: &'static [Excitation],
    /// Greatest command as a share of the input's limit.
    pub share: Interval,
    /// How far that share may be moved for the sake of detectability: below, the motion drowns in noise.
    pub share_limits: Interval,
    /// What one input takes of that share.
    pub input_share: Interval,
    /// Rest before the first step, s.
    pub rest_s: Interval,
    /// Unit of time of steps, in periods of the highest frequency that the vehicle follows.
    pub unit: Interval,
    /// Height of steps over the greatest command.
    pub level: Interval,
    /// Pause between manoeuvres, in units of time.
    pub pause: Interval,
    /// Lowest frequency of a sweep over the highest that the vehicle follows.
    pub sweep_lowest: Interval,
    /// Corner frequency of pilot-like motion over the highest that the vehicle follows.
    pub pilot_corner: f64,
}

/// Sensor noise.
#[derive(Debug)]
pub(crate) struct NoiseRanges {
    /// Colours; each is as likely, and those of clean records take turns.
    pub colours: &'static [ColourRange],
    /// Size over the declared one, the same for all outputs.
    pub level: Interval,
    /// The same for each output by itself.
    pub spread: Interval,
}

/// A colour of noise with the ranges of its parameters.
#[derive(Debug)]
pub(crate) enum ColourRange {
    White,
    /// First-order autoregressive with this coefficient.
    Ar1(f64),
    /// A resonance at a share of the sampling rate.
    Resonant {
        rate_share: Interval,
        radius: Interval,
    },
    /// A resonance at a frequency that does not follow the sampling rate, Hz.
    SlowResonant {
        frequency_hz: Interval,
        radius: Interval,
    },
    /// Two resonances, each at a share of the sampling rate.
    Ar4 {
        rate_shares: [Interval; 2],
        radius: Interval,
    },
    /// White noise on a wandering zero: the time constant, s, and the share of the variance that is white.
    Wandering {
        time_constant_s: Interval,
        white_share: Interval,
    },
    /// White with the tails of Student's t: degrees of freedom from the first up to the second.
    StudentT {
        degrees: (u32, u32),
    },
}

/// Sizes and other parameters of the table's effects.
///
/// Where nothing else is said, a size is relative: to the peak of the input, to the root mean square of what drives the
/// state, or to the output's noise.
#[derive(Debug)]
pub(crate) struct EffectRanges {
    /// s
    pub input_delay_s: Interval,
    /// s
    pub actuator_lag_s: Interval,
    /// Distance of the factor from 1.
    pub input_gain: Interval,
    /// Change of the gain over the record.
    pub gain_drift: Interval,
    pub input_bias: Interval,
    pub dead_zone: Interval,
    /// Share that is cut from the peaks.
    pub input_saturation: Interval,
    /// What is cut at the lower side over what is cut at the upper.
    pub saturation_lean: Interval,
    /// Time from stop to stop, s.
    pub rate_limit_s: Interval,
    /// Gap over the whole range of the input.
    pub backlash: Interval,
    pub input_coupling: Interval,
    /// Period of the mode, s.
    pub mode_period_s: Interval,
    pub mode_damping: Interval,
    /// Share of the modes whose gain is 1.
    pub mode_unit_gain: f64,
    pub mode_gain: Interval,
    /// Distance of the factor from 1.
    pub parameter_change: Interval,
    pub quadratic_drag: Interval,
    pub coulomb_friction: Interval,
    /// Share of the frictions that are not the same to both sides.
    pub lopsided_friction: f64,
    /// Asymmetry over level.
    pub friction_asymmetry: Interval,
    pub cubic_stiffness: Interval,
    /// Share of the springs that harden.
    pub hardening: f64,
    /// Size of a spring that softens, over that of one that hardens.
    pub softening: f64,
    /// When, as a share of the record.
    pub step_at: Interval,
    pub step: Interval,
    /// When, as a share of the record.
    pub pulse_at: Interval,
    /// s
    pub pulse_s: Interval,
    pub pulse: Interval,
    /// Hz
    pub periodic_hz: Interval,
    pub periodic: Interval,
    /// Hz
    pub turbulence_hz: Interval,
    pub turbulence: Interval,
    /// Share of the trials whose turbulence has Dryden's second-order spectrum.
    pub dryden: f64,
    /// Share of the record that is left for the other mode.
    pub mode_transition: Interval,
    pub sensor_bias: Interval,
    /// Over the record.
    pub sensor_drift: Interval,
    /// Distance of the factor from 1.
    pub sensor_scale: Interval,
    /// s
    pub sensor_delay_s: Interval,
    /// s
    pub sensor_lag_s: Interval,
    /// rad
    pub misalignment_rad: Interval,
    /// Share of the vibrations below half the sampling rate.
    pub vibration_below_half: f64,
    /// Frequency of those, as a share of the sampling rate.
    pub vibration_low: Interval,
    /// Frequency of the others, as a share of the sampling rate.
    pub vibration_high: Interval,
    pub vibration: Interval,
    /// The whole noise over the declared one.
    pub noise: Interval,
    pub quantization: Interval,
    /// Share that is cut from the peaks.
    pub output_saturation: Interval,
    pub dropouts: Interval,
    pub outliers: Interval,
    pub outlier_magnitude: Interval,
}

/// An effect outside the table with its ranges; what size and scale are, the effect says.
#[derive(Debug)]
pub(crate) struct OutOfLibraryRange {
    pub kind: OutOfLibrary,
    /// Relative to the motion, as the draft says.
    pub size: Interval,
    /// In Hz or s where the effect says so, otherwise relative to the motion.
    pub scale: Interval,
    /// Dead time, s, where the effect has one.
    pub dead_time_s: Interval,
}
