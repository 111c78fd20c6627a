//! Thresholds of what is told before the search: wrong units, and records of another vehicle.

/// Ratios of units that columns are often mistaken in: degrees in a radian, m/s^2 in a g, thousandths, km/h in a m/s.
/// Definition.
pub(crate) const UNIT_RATIOS: [f64; 4] = [180.0 / std::f64::consts::PI, 9.80665, 1000.0, 3.6];
/// Wrong units that are looked for in one record. Cost.
pub(crate) const MAX_WRONG_UNITS: usize = 4;
/// The greatest factor that the parts of a vehicle have: they lose effectiveness, down to nothing, or are up to twice as
/// strong. The definition of `noise` as a cause has the same ratio.
pub(crate) const GREATEST_PHYSICAL_FACTOR: f64 = 2.0;
/// The factors of inputs and sensors that are looked for as faults: well beyond what parts have, so that a gross mistake of the file
/// is still named. Definition.
pub(crate) const SEARCHED_FACTORS: std::ops::RangeInclusive<f64> = -5.0..=20.0;
/// How far the gains of a vehicle file may be off, in their logarithm: with a Cramer-Rao bound above 20 % a parameter is not
/// kept (Tischler and Remple 2012, section 11.2).
pub(crate) const VEHICLE_GAIN_ERROR: f64 = 0.2;
/// Share of all physical factors that an interval may hold for a unit to be told in place of them: where any is as likely
/// beforehand, this is the probability that one comes so near a unit's ratio. As one-sided two standard deviations.
pub(crate) const CHANCE_FACTOR_SHARE: f64 = 0.023;
/// Standard deviations to either side of a factor. Two-sided Gaussian tail of 0.3 %.
pub(crate) const FACTOR_SIGMAS: f64 = 3.0;
/// The greatest factor beside a unit that is looked for: beyond all that parts of a vehicle have. Definition.
pub(crate) const GREATEST_FACTOR: f64 = 10.0;
/// Highest order of a noise model before the search: most of a filter's innovations are white. Cost.
pub(crate) const SCREENED_AR_ORDER: usize = 6;
/// How late commands may act in a record that is still the vehicle's, s: dead times and lags of actuators. Cost.
pub(crate) const LATENESSES_S: [f64; 4] = [0.03, 0.08, 0.2, 0.5];
/// Blocks from which on their means tell how predictions compare. Of fewer, Student's t has tails that are no longer normal.
pub(crate) const LEAST_COMPARED_BLOCKS: usize = 5;
/// Logarithms of likelihoods that differ by less are the same. Half of what Kass and Raftery (1995) call worth a mention.
pub(crate) const SAME_LOG_LIKELIHOOD: f64 = 0.5;
/// Steps that are looked at before the search, at most. Cost.
pub(crate) const MAX_SCREENED_STEPS: f64 = 6_000.0;
/// Steps over which a record is compared with the vehicle before the search, at most. Cost.
pub(crate) const MAX_COMPARED_STEPS: f64 = 30_000.0;
/// The longest memory of a filter before the search, as a share of the record: after three of them the initial state has died
/// away, and most of the record is left. Cost.
pub(crate) const LONGEST_SCREEN_SHARE: f64 = 0.05;
