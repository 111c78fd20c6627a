//! Thresholds of the screening before the search: wrong units, and records of another vehicle.

/// Ratios of frequent unit errors: degrees in a radian, m/s^2 in a g, thousandths, km/h in a m/s. Definition.
pub(crate) const UNIT_RATIOS: [f64; 4] = [180.0 / std::f64::consts::PI, 9.80665, 1000.0, 3.6];
/// Ratio of a column whose axis points the other way. Definition.
pub(crate) const OPPOSITE_SIGN: f64 = -1.0;
/// Largest number of wrong units in one record. Cost.
pub(crate) const MAX_WRONG_UNITS: usize = 4;
/// Largest physical factor of a part: parts lose effectiveness, down to zero, or are up to twice as strong.
/// The definition of `noise` as a cause has the same ratio.
pub(crate) const GREATEST_PHYSICAL_FACTOR: f64 = 2.0;
/// Range of factors of inputs and sensors searched for as faults: well beyond physical factors, so that a
/// gross mistake of the file is still named. Definition.
pub(crate) const SEARCHED_FACTORS: std::ops::RangeInclusive<f64> = -5.0..=20.0;
/// Possible error of a vehicle file's gains, in their logarithm: with a Cramer-Rao bound above 20 % a
/// parameter is not kept (Tischler and Remple 2012, section 11.2).
pub(crate) const VEHICLE_GAIN_ERROR: f64 = 0.2;
/// Largest share of all physical factors that an interval may contain for a unit error to be reported: if all
/// are equally likely a priori, this is the probability that one comes so close to a unit's ratio. As
/// one-sided two standard deviations.
pub(crate) const CHANCE_FACTOR_SHARE: f64 = 0.023;
/// Half width of a factor's interval in standard deviations. Two-sided Gaussian tail of 0.3 %.
pub(crate) const FACTOR_SIGMAS: f64 = 3.0;
/// Largest factor besides a unit that is searched for: beyond all physical ones. Definition.
pub(crate) const GREATEST_FACTOR: f64 = 10.0;
/// Highest order of a noise model before the search: most of a filter's innovations are white. Cost.
pub(crate) const SCREENED_AR_ORDER: usize = 6;
/// Delays of commands with which a record may still be the vehicle's, s: dead times and lags of actuators.
/// Cost.
pub(crate) const LATENESSES_S: [f64; 4] = [0.03, 0.08, 0.2, 0.5];
/// Fewest blocks whose means are compared. With fewer, Student's t has tails that are far from normal.
pub(crate) const LEAST_COMPARED_BLOCKS: usize = 5;
/// Difference of log-likelihoods below which they are equal. Half of what Kass and Raftery (1995) call worth
/// a mention.
pub(crate) const SAME_LOG_LIKELIHOOD: f64 = 0.5;
/// Largest number of steps used in the screening. Cost.
pub(crate) const MAX_SCREENED_STEPS: f64 = 6_000.0;
/// Largest number of steps over which a record is compared with the vehicle in the screening. Cost.
pub(crate) const MAX_COMPARED_STEPS: f64 = 30_000.0;
/// The longest memory of a screening filter, as a share of the record: after three of them the initial state
/// has decayed, and most of the record is left. Cost.
pub(crate) const LONGEST_SCREEN_SHARE: f64 = 0.05;
