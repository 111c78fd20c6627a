//! Thresholds of effects that show in single samples.

/// Smallest rounding step that is named, relative to the noise. Sheppard (1898): rounding below half of the
/// noise is noise of step / sqrt(12).
pub(crate) const COARSE_STEP_SHARE: f64 = 0.5;
/// Fewest samples of an effect. Calibrated.
pub(crate) const MIN_HELD_SAMPLES: usize = 5;
/// Quantile of the steps from sample to sample that is the speed of the motion: a motor may run steadily for most of a record.
/// Definition, without the largest steps, which may be outliers.
pub(crate) const FAST_SHARE: f64 = 0.999;
/// Share of the speed of the motion up to which a sensor comes to a value slowly. What a sensor hides at a
/// limit, it had shown at the speed of the motion. Definition: what is left of an exponential approach after 1.6 time constants.
pub(crate) const SLOW_ARRIVAL: f64 = 0.2;
/// Fewest rounding steps in a signal's range for which a limit can be told from rounding. Calibrated.
pub(crate) const MIN_STEPS_OF_A_LIMIT: f64 = 8.0;
/// Smallest share of new values with which a sensor counts as one that occasionally loses some; below it, the
/// sensor is a slower one. Calibrated.
pub(crate) const NEW_VALUE_SHARE: f64 = 0.25;
/// Values that repeat less often than this share of the usual number are no level of a rounded sensor.
/// Calibrated.
pub(crate) const OFTEN_SHARE: f64 = 0.2;
/// Repeats are counted only where rounding makes fewer than this share of neighbours equal: elsewhere a held
/// value would be one among many. Fisher's 5 %.
pub(crate) const RARE_REPEAT: f64 = 0.05;
/// Probability below which repeats go with a slow motion, and are no lost samples: three standard errors, which cost one true
/// dropout in a thousand.
pub(crate) const SLOW_REPEATS: f64 = 0.00135;
/// Neighbours on each side to which a value is compared. Calibrated.
pub(crate) const NEIGHBOURS: usize = 4;
/// Fewest outliers of a channel. Calibrated.
pub(crate) const MIN_OUTLIERS: usize = 3;
/// Fewer than [`MIN_OUTLIERS`] outliers count only if each exceeds the limit by this factor. Calibrated.
pub(crate) const OUTLIER_SIZE_RATIO: f64 = 1.5;
/// Degrees of freedom tried for heavy-tailed noise. Cost.
pub(crate) const STUDENT_DEGREES: [f64; 8] = [1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0];
/// Degrees of freedom from which on Student's t is normal, within a thousandth of its variance.
pub(crate) const NORMAL_DEGREES: f64 = 2000.0;
/// Rounds in which the scale of Student's t is estimated. Cost.
pub(crate) const STUDENT_ROUNDS: usize = 20;
/// Rounds of expectation maximisation for outliers beside normal values. Cost.
pub(crate) const MIXTURE_ROUNDS: usize = 20;
/// Gain in log-likelihood of one round below which they end. Cost.
pub(crate) const MIXTURE_SETTLED: f64 = 0.01;
/// Smallest distance of an outlier from its neighbours, in standard deviations. Two-sided Gaussian tail of
/// 8e-11: less than 1e-5 expected in 10 minutes at 100 Hz and two channels.
pub(crate) const OUTLIER_SIGMAS: f64 = 6.5;
/// Distance of an outlier relative to the median distance of its neighbours from their middle. Two-sided
/// Gaussian tail of 6e-7.
pub(crate) const ISOLATED_SIGMAS: f64 = 5.0;
/// Smallest outlier of a rounded channel, in rounding steps. Calibrated.
pub(crate) const OUTLIER_STEP_RATIO: f64 = 2.5;
/// Rounds in which coloured noise and outliers are separated. Cost.
pub(crate) const OUTLIER_ROUNDS: usize = 2;
