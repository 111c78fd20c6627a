//! Thresholds of the noise models of a record.

/// Highest autoregressive order considered. Rows up to it are left out of every likelihood, whatever the
/// order, so that likelihoods can be compared. Twice the samples of the slowest noise that flight sensors
/// show at 100 Hz; the order itself is chosen by BIC.
pub(crate) const MAX_AR_ORDER: usize = 20;
/// Time constants of a sensor's zero that wanders, steps: from half of the highest order, below which free coefficients
/// follow it, to 32 s at 100 Hz, beyond which it is a random walk to most records.
pub(crate) const WANDER_TIMES: [f64; 6] = [10.0, 32.0, 100.0, 320.0, 1000.0, 3200.0];
/// Variances of that wander, relative to the white noise beside it: from where it is lost in the noise of a short record, to
/// where hardly any white noise is left.
pub(crate) const WANDER_RATIOS: [f64; 8] = [0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0];
/// Steps until the filter of such a zero counts as settled: twice the memory of the slowest of them.
pub(crate) const WANDER_START_STEPS: usize = 512;
/// Standard deviation of the logarithm of a declared noise: correct to a factor of two, the ratio from which
/// `noise` is a cause. Definition.
pub(crate) const DECLARED_NOISE_LOG_STD: f64 = std::f64::consts::LN_2;
