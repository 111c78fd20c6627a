//! Thresholds of the search for causes.

/// Least gain in BIC. Kass and Raftery (1995): very strong evidence.
pub(crate) const MIN_BIC_GAIN: f64 = 10.0;
/// Largest probability by chance, corrected for all tests. The usual 1 % (Holm 1979).
pub(crate) const MAX_P_VALUE: f64 = 0.01;
/// Least gain on left-out data over its standard error. One-sided Gaussian tail of 2.3 %.
pub(crate) const MIN_HELD_OUT_SIGMAS: f64 = 2.0;
/// Largest relative standard error of a size. A size is then more than three standard errors from zero.
pub(crate) const MAX_RELATIVE_ERROR: f64 = 0.3;
/// Standard deviations of chance beyond which two filters disagree about a size. Two-sided Gaussian tail of 3e-3.
pub(crate) const DISAGREEMENT_SIGMAS: f64 = 3.0;
/// A cause that gains less than this share of the largest gain may only correct the latter's shape: a
/// response accurate to a seventh leaves a fiftieth of its energy. A cause whose residual has more, and is
/// not noise, only resembles the truth.
pub(crate) const RIDER_SHARE: f64 = 0.02;
/// Detectability below which an effect cannot be detected. Non-central chi-square of one degree: found with
/// 81 % at a level of 1 %.
pub(crate) const MIN_DETECTABILITY: f64 = 12.0;
/// Cosine from which on two signatures are one. Nine tenths of the energy of one signature is that of the other.
pub(crate) const SAME_SIGNATURE_COSINE: f64 = 0.95;
/// Cosine below which one signature is no rival of another: it shares less than a hundredth of its energy, so that either
/// explains what the other leaves, and both may be there.
pub(crate) const COMMON_COSINE: f64 = 0.1;
/// Difference in BIC up to which a rival is as good. Kass and Raftery (1995): the upper end of positive evidence.
pub(crate) const RIVAL_BIC: f64 = 6.0;
/// Largest number of causes named. Cost.
pub(crate) const MAX_CAUSES: usize = 5;
/// Largest number of pushes and periodic forces on one state: with the parameters of more of them, any force has an expansion
/// (Karhunen and Loève), which is turbulence with two. A record of 12 s had ten, after four minutes.
pub(crate) const MAX_GUSTS: usize = 3;
/// Difference in BIC from which a candidate is not credible beside a better one that was refused. Three times
/// what Kass and Raftery (1995) call very strong.
pub(crate) const OVERSHADOWED_BIC: f64 = 30.0;
/// Difference in BIC below which neither of two causes with different signatures can be excluded: odds of
/// about seven to one.
pub(crate) const UNDECIDED_BIC: f64 = 4.0;
/// Standard deviations below a cause's expected gain over its rival beyond which it is not the truth: the
/// normal distribution's quantile at a level of 1 %.
pub(crate) const COX_QUANTILE: f64 = 2.33;
/// Share of its earlier gain with which a term counts as found again. Calibrated.
pub(crate) const FOUND_AGAIN_SHARE: f64 = 0.5;
/// Largest number of final exchanges for better rivals. Cost.
pub(crate) const MAX_EXCHANGES: usize = 6;
/// Largest number of candidates fitted by a few steps. Cost.
pub(crate) const GLANCED: usize = 16;
/// Largest number of candidates fitted to their optimum, as a few steps under the noise model of the start
/// may still miss a share of what a strong effect gains. Cost.
pub(crate) const FITTED: usize = 5;
/// Difference in BIC to the best up to which a candidate is fitted to its optimum. Cost.
pub(crate) const FITTED_BEHIND_BIC: f64 = 40.0;
/// Difference in BIC to the best, as a share of the best gain, up to which a candidate is fitted to its
/// optimum. Cost.
pub(crate) const FITTED_BEHIND_SHARE: f64 = 0.25;
/// Difference in BIC up to which a candidate may be indistinguishable from the best: it is then always
/// fitted. Cost.
pub(crate) const FITTED_NEAR_BIC: f64 = 15.0;
/// Largest score of a transition whose time is still far off. Cost.
pub(crate) const DISTANT_TRANSITION_SCORE: f64 = 100.0;
/// Gain in BIC estimated in the survey, below which a candidate is not fitted, as it has no chance of being
/// accepted. Cost.
pub(crate) const HOPELESS_BIC: f64 = -20.0;
/// Candidates of each score test whose noise model is refitted before the choice of those to be fitted. Cost.
pub(crate) const PROFILED: usize = 40;
/// Candidates of each survey that may later replace another. Cost.
pub(crate) const REMEMBERED: usize = 30;
/// Difference in BIC up to which two causes are equivalent. Below what Kass and Raftery (1995) call worth a
/// mention.
pub(crate) const SAME_EFFECT_BIC: f64 = 0.5;
/// Difference in BIC up to which two causes are equivalent with one input and one output, where only the
/// first samples of a record distinguish them. Calibrated.
pub(crate) const SISO_SAME_BIC: f64 = 20.0;
/// Difference in BIC up to which two causes are equivalent with one input and one output, as a share of their
/// gain. Calibrated.
pub(crate) const SISO_SAME_SHARE: f64 = 0.02;
/// Difference in BIC up to which a tone of a force and one of a sensor are equivalent. Calibrated.
pub(crate) const SAME_TONE_BIC: f64 = 3.0;
/// Number of cross-validation blocks. Ten or so folds: Kohavi (1995).
pub(crate) const BLOCKS: usize = 12;
/// Share of a value's information below which the rest of a record cannot replace a block. Calibrated.
pub(crate) const MIN_REMAINING_INFORMATION: f64 = 0.05;
/// Largest counted gain of a block, relative to an equal share of the difference of the two predictions:
/// where a model without the cause diverges over one block, that block alone would be the gain, and its
/// standard error too. Calibrated.
pub(crate) const MAX_BLOCK_SHARE: f64 = 4.0;
