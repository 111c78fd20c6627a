//! Every threshold of the diagnosis: its name, its unit, and where it comes from.
//!
//! Three kinds have no paper behind them, and say so in a word:
//! - *calibrated*: the value that did best on blind trials, which anyone can fly again:
//!   `whirlstand blind --trials 2000 --seed 8 --length 12:24 --rate 40,50`. They are engineering choices, not theory;
//!   what a change of one does is to be shown by the same trials with `--generator shifted`.
//! - *cost*: bounds the work; a larger value (a finer grid, more starts) finds the same and takes longer.
//! - *definition*: what a word of the answer means.

mod screen;

use whirlstand_ident::identify::search::Limits;

pub(crate) use screen::*;

// data: what a record shows by itself
/// A step of the clock that is so many times the usual one is a gap: two samples may be missing and the clock jitter by
/// half a step. As in `whirlstand_logs`.
pub(crate) const GAP_STEPS: f64 = whirlstand_logs::LONGEST_BRIDGED;
/// Share of the fastest time constant for which commands may be unknown: what they do meanwhile is at most that share of
/// what they do in the end.
pub(crate) const BRIDGED_TIME_CONSTANT_SHARE: f64 = 0.1;
/// The same for a vehicle that integrates, as a share of the record. Calibrated.
pub(crate) const BRIDGED_RECORD_SHARE: f64 = 0.01;
/// Steps of a part between two gaps from which on it counts: those that likelihoods leave out, and as many again.
pub(crate) const MIN_PART_STEPS: usize = 2 * MAX_AR_ORDER;
/// Fewer steps than this tell nothing about dynamics. About three times the highest order of the noise model, so
/// that its estimate exists.
pub(crate) const MIN_STEPS: usize = 64;
/// Periods of parts that differ by less are one: clocks are not the same before and behind a gap to the last digit, and times
/// that are wrong by so little show in no time constant. Definition.
pub(crate) const SAME_PERIOD_SHARE: f64 = 2e-3;
/// Share of an input's largest magnitude beyond which a first command is not rest. Calibrated.
pub(crate) const FIRST_COMMAND_SHARE: f64 = 0.1;
/// Steps that are looked at, at most, where the user does not say otherwise: ten minutes at 100 Hz. Cost.
pub(crate) const MAX_SEARCHED_STEPS: f64 = 60_000.0;
/// A channel that does not change for this share of the record is stuck. Calibrated.
pub(crate) const STUCK_SHARE: f64 = 0.05;
/// Fit above which two channels are taken to be the same signal, 0 to 1. More than half of the power of one channel
/// is that of the other.
pub(crate) const SAME_SIGNAL_FIT: f64 = 0.6;
/// A rounding is worth naming from this share of the noise on. Sheppard (1898): rounding below half of the noise is
/// noise of step / sqrt(12).
pub(crate) const COARSE_STEP_SHARE: f64 = 0.5;
/// Fewer samples than this are no effect. Calibrated.
pub(crate) const MIN_HELD_SAMPLES: usize = 5;
/// Values of fewer levels may be switched, not rounded. Calibrated.
pub(crate) const MIN_LEVELS: usize = 3;
/// With fewer steps from the least to the greatest, a limit cannot be told from rounding. Calibrated.
pub(crate) const MIN_STEPS_OF_A_LIMIT: f64 = 8.0;
/// A sensor of whose values this share is new may lose some now and then; one of whose fewer are is a slower sensor. Calibrated.
pub(crate) const NEW_VALUE_SHARE: f64 = 0.25;
/// A value that repeats less often than this share of how often values usually do is no level of a rounded sensor. Calibrated.
pub(crate) const OFTEN_SHARE: f64 = 0.2;
/// Repeats are counted only where rounding makes fewer than this share of neighbours equal: a value that is lost would be
/// one among many elsewhere. Fisher's 5 %.
pub(crate) const RARE_REPEAT: f64 = 0.05;
/// Neighbours on each side to which a value is compared. Calibrated.
pub(crate) const NEIGHBOURS: usize = 4;
/// Fewer wild values than this may be anything. Calibrated.
pub(crate) const MIN_OUTLIERS: usize = 3;
/// One wild value alone counts if it stands this many times as far that limit. Calibrated.
pub(crate) const OUTLIER_SIZE_RATIO: f64 = 1.5;
/// Degrees of freedom of a noise of heavy tails that are tried. Cost.
pub(crate) const STUDENT_DEGREES: [f64; 8] = [1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0];
/// Rounds in which its scale is estimated. Cost.
pub(crate) const STUDENT_ROUNDS: usize = 20;
/// Rounds of expectation and maximisation for wild values beside normal ones. Cost.
pub(crate) const MIXTURE_ROUNDS: usize = 20;
/// A wild value stands this many standard deviations away from its neighbours. Two-sided Gaussian tail of 8e-11:
/// less than 1e-5 expected in 10 minutes at 100 Hz and two channels.
pub(crate) const OUTLIER_SIGMAS: f64 = 6.5;
/// A wild value stands this many times as far as half of the neighbours stand from their middle. Two-sided Gaussian tail of 6e-7.
pub(crate) const ISOLATED_SIGMAS: f64 = 5.0;
/// Of a channel that rounds, a wild value is off by so many steps. Calibrated.
pub(crate) const OUTLIER_STEP_RATIO: f64 = 2.5;
/// Rounds in which colour and wild values are told from each other. Cost.
pub(crate) const OUTLIER_ROUNDS: usize = 2;
/// Up to this many times the declared amplitude a tone is the declared one. Calibrated.
pub(crate) const DECLARED_AMPLITUDE_RATIO: f64 = 1.5;
/// How far the frequency of a rotor may be from the declared, in lines of the record's resolution, to either side.
/// The main lobe of a rectangular window reaches one line to either side; one more for a rotor that is governed.
pub(crate) const DECLARED_FREQUENCY_LINES: i32 = 2;
/// Difference in BIC from which on it is plain that the first commands of a record were not there before. Three
/// times what Kass and Raftery (1995) call very strong.
pub(crate) const REST_BEFORE_BIC: f64 = 30.0;
/// A push before this time is one at the beginning, s. Calibrated.
pub(crate) const BEGINNING_S: f64 = 0.1;

// model: likelihood and simulation
/// Highest order that is considered. Rows up to it are left out of every likelihood, whatever the order, so that
/// likelihoods can be compared. Twice the samples of the slowest noise that flight sensors show at 100 Hz; the
/// order itself is chosen by BIC. Rows up to it are left out of every likelihood.
pub(crate) const MAX_AR_ORDER: usize = 20;
/// Standard deviation of the logarithm of a declared noise's: right to a factor of two, the ratio from which on `noise` is a
/// cause. Definition.
pub(crate) const DECLARED_NOISE_LOG_STD: f64 = std::f64::consts::LN_2;
/// Gain of the log-likelihood below which a fit is done. A hundredth of the standard error of a log-likelihood
/// ratio of one parameter (Wilks 1938).
pub(crate) const FIT_TOLERANCE: f64 = 0.02;
/// Steps of Levenberg and Marquardt that are tried from one point, each with ten times the damping of the last. Cost.
pub(crate) const MAX_DAMPED_STEPS: usize = 6;
/// A run that leaves the largest measured value this many times behind is given up: nonlinear effects far out cost
/// thousands of steps each. Cost.
pub(crate) const DIVERGED_RATIO: f64 = 1e3;
/// By how much a state is moved for a sensitivity. Forward difference of a response that is linear in the initial
/// state: rounding and curvature are both below 1e-6.
pub(crate) const INITIAL_STATE_STEP: f64 = 1e-3;
/// Steps after which a filter's covariance is taken as settled. Cost.
pub(crate) const MAX_TRANSIENT_STEPS: usize = 400;
/// Relative change of the gain in a step below which it is settled. Likelihoods err by its square. The covariance of a filter is
/// stationary about the optimal gain: an error enters squared (Anderson and Moore 1979).
pub(crate) const SETTLED_GAIN_CHANGE: f64 = 1e-6;
/// Rounds of a climb, at most. Cost.
pub(crate) const MAX_CLIMB_ROUNDS: usize = 15;
/// A climb may gain so many times what its first steps promise, and so much more. Cost.
pub(crate) const CLIMB_OPTIMISM: f64 = 4.0;
/// Partial correlations below this are none. Calibrated.
pub(crate) const WEAK_CORRELATION: f64 = 0.2;
/// Samples of each channel from which on there are spectra. Calibrated.
pub(crate) const MIN_SPECTRUM_SAMPLES: usize = 256;
/// The shortest memory of a predictor that follows the record, steps: shorter, a prediction is the last sample. Definition.
pub(crate) const SHORTEST_MEMORY_STEPS: f64 = 2.0;
/// Ratio of a memory to the next. The likelihood of a filter is flat about its optimum: a gain that is off by a factor
/// of two costs a few per cent of the innovations' variance (Anderson and Moore 1979). Cost.
pub(crate) const MEMORY_GROWTH: f64 = 4.0;
/// The longest memory, as a share of the record: of a longer one too few are in it to size it. Cost.
pub(crate) const MEMORY_RECORD_SHARE: f64 = 0.1;
/// The longest horizon that is chosen by itself, as a share of the record. Ten independent predictions.
pub(crate) const HORIZON_RECORD_SHARE: f64 = 0.1;
/// The shortest horizon that is chosen by itself, steps. Definition.
pub(crate) const LEAST_HORIZON_STEPS: f64 = 10.0;

// candidates: where effects are looked for
/// Stands for no limit in a parameter that must be finite.
pub(crate) const UNBOUNDED: f64 = 1e9;
/// Times at which an event is tried, at least. Cost.
pub(crate) const MIN_EVENT_TIMES: usize = 600;
/// Durations of a pulse, in steps of the grid of times: each about 1.6 times the last. Cost.
pub(crate) const DURATION_GROWTH: f64 = 1.6;
/// Tones that are followed up, at most, in every channel. Cost.
pub(crate) const TONES_FOLLOWED: usize = 2;
/// A tone must stand this far above its surroundings in power to be followed up; chance reaches this on one of 3000
/// frequencies. Whether it is accepted, the likelihood decides. Periodogram ordinates are exponential (Priestley
/// 1981, 6.1): exp(-8) is one of 3000.
pub(crate) const TONE_POWER_RATIO: f64 = 8.0;
/// Times at which a transition is tried. Cost.
pub(crate) const TRANSITION_TIMES: usize = 24;

// search: which candidates are causes
/// Least gain in BIC. Kass and Raftery (1995): very strong evidence.
pub(crate) const MIN_BIC_GAIN: f64 = 10.0;
/// Largest probability of a chance, corrected. The usual 1 %, corrected for all looks (Holm 1979).
pub(crate) const MAX_P_VALUE: f64 = 0.01;
/// Least gain on left-out data over its standard error. One-sided Gaussian tail of 2.3 %.
pub(crate) const MIN_HELD_OUT_SIGMAS: f64 = 2.0;
/// Largest standard error of a size, as a share of it. A size is then more than three standard
/// errors from nothing.
pub(crate) const MAX_RELATIVE_ERROR: f64 = 0.3;
/// A response that is right to a seventh leaves a fiftieth of its energy. A cause that gains less than this share of what the
/// largest gains may only mend the largest one's shape, and one that leaves more, and no noise, is like the truth, not it.
pub(crate) const RIDER_SHARE: f64 = 0.02;
/// Detectability below which an effect cannot be told. Non-central chi-square of one degree: found with
/// 81 % at a level of 1 %.
pub(crate) const MIN_DETECTABILITY: f64 = 12.0;
/// Cosine from which on two signatures are one. Nine tenths of the energy of one signature is that of the other.
pub(crate) const SAME_SIGNATURE_COSINE: f64 = 0.95;
/// Difference in BIC up to which a rival is as good. Kass and Raftery (1995): the upper end of positive evidence.
pub(crate) const RIVAL_BIC: f64 = 6.0;
/// Causes that are named, at most. Cost.
pub(crate) const MAX_CAUSES: usize = 5;
/// Difference in BIC from which on a candidate is not believed beside a better one that was refused. Three times
/// what Kass and Raftery (1995) call very strong.
pub(crate) const OVERSHADOWED_BIC: f64 = 30.0;
/// Difference in BIC below which two causes that do not look alike cannot both be excluded: odds of about seven to
/// one.
pub(crate) const UNDECIDED_BIC: f64 = 4.0;
/// Standard deviations below what a cause would gain over its rival, from which on it is not the truth: the normal
/// distribution's quantile at a level of 1 %.
pub(crate) const COX_QUANTILE: f64 = 2.33;
/// A term is found again when it gains this share of what it gained in the model. Calibrated.
pub(crate) const FOUND_AGAIN_SHARE: f64 = 0.5;
/// Exchanges for better rivals in the end, at most. Cost.
pub(crate) const MAX_EXCHANGES: usize = 6;
/// Candidates that are fitted a few steps, at most. Cost.
pub(crate) const GLANCED: usize = 16;
/// Candidates that are fitted to their optimum, at most, and how far in BIC behind the best of them: a few steps
/// under the noise model of the start may still miss a share of what a strong effect gains. Cost.
pub(crate) const FITTED: usize = 5;
/// How far in BIC behind the best a candidate may be to be fitted to its optimum. Cost.
pub(crate) const FITTED_BEHIND_BIC: f64 = 40.0;
/// The same as a share of what the best gains. Cost.
pub(crate) const FITTED_BEHIND_SHARE: f64 = 0.25;
/// One that is so near in BIC may be what cannot be told from the best: then it is fitted, however many there are.
/// Cost.
pub(crate) const FITTED_NEAR_BIC: f64 = 15.0;
/// Score of a transition whose time is still far off, at most. Cost.
pub(crate) const DISTANT_TRANSITION_SCORE: f64 = 100.0;
/// Gain in BIC below which the first look leaves no hope that a fit would be accepted. Cost.
pub(crate) const HOPELESS_BIC: f64 = -20.0;
/// Candidates of each score test whose noise model is fitted anew before that choice. Cost.
pub(crate) const PROFILED: usize = 40;
/// Candidates of each survey that may take another's place later. Cost.
pub(crate) const REMEMBERED: usize = 30;
/// Difference in BIC up to which two causes are the same thing. Below what Kass and Raftery (1995) call worth a
/// mention.
pub(crate) const SAME_EFFECT_BIC: f64 = 0.5;
/// The same with one input and one output, where no record tells them apart but by its first samples. Calibrated.
pub(crate) const SISO_SAME_BIC: f64 = 20.0;
/// The same as a share of what the two explain. Calibrated.
pub(crate) const SISO_SAME_SHARE: f64 = 0.02;
/// Difference in BIC up to which two causes are the same thing, for a tone of a force and one of a sensor. Calibrated.
pub(crate) const SAME_TONE_BIC: f64 = 3.0;
/// Blocks that are left out, one after the other. Ten or so folds: Kohavi (1995).
pub(crate) const BLOCKS: usize = 12;
/// Share of what is known of a value below which the rest of a record cannot stand in for a block. Calibrated.
pub(crate) const MIN_REMAINING_INFORMATION: f64 = 0.05;
/// A block's gain counts up to so many times an equal share of what the two predictions differ by: where a model
/// without the cause runs away over one block, that block alone would be the gain, and its standard error too.
/// Calibrated.
pub(crate) const MAX_BLOCK_SHARE: f64 = 4.0;

// residual: what the causes leave
/// Forces are tried on so many states at most. Cost.
pub(crate) const TESTED_STATES: usize = 3;
/// Products of states are tried up to so many states. Cost.
pub(crate) const PRODUCT_STATES: usize = 4;
/// Samples of all channels that are looked at, at most. Cost.
pub(crate) const TESTED_SAMPLES: usize = 100_000;
/// Values of all columns that are held together, at most. Memory: 40 MB.
pub(crate) const TESTED_TOGETHER: usize = 5_000_000;
/// Rows of a block. Cost.
pub(crate) const GRAM_BLOCK_ROWS: usize = 2048;
/// All functions together tell beyond so many standard deviations of chance. One-sided Gaussian tail of 3e-7.
pub(crate) const LACK_SIGMAS: f64 = 5.0;
/// All functions together tell from this energy on, about three times what a single effect needs to be told at all. Calibrated.
pub(crate) const LACK_ENERGY: f64 = 40.0;
/// One signal tells below this probability of chance, of all looks together. Calibrated.
pub(crate) const LACK_P_VALUE: f64 = 1e-3;
/// Beside turbulence, of whose spectrum a short record shows little, one signal tells below this probability.
/// Calibrated.
pub(crate) const LACK_CERTAIN_P_VALUE: f64 = 1e-7;
/// Share of a signal's largest magnitude from which on a smooth switch is through. Calibrated.
pub(crate) const SWITCH_SHARE: f64 = 0.1;
/// Turns over the record of what acts now more, now less: slower than what is told by its frequency. Cost.
pub(crate) const SLOW_TURNS: usize = 6;
/// Half waves of a force over the reach of a state. Cost.
pub(crate) const HALF_WAVES: usize = 4;
/// Fastest swing of a stiffness or a gain that is looked for, Hz. Calibrated.
pub(crate) const FASTEST_MODULATION_HZ: f64 = 2.0;
/// Turns of such a swing over the record, at most. Cost.
pub(crate) const MAX_MODULATION_TURNS: usize = 64;
/// Thresholds of the switch, as shares of a state's largest magnitude. Cost.
pub(crate) const RELAY_THRESHOLDS: [f64; 5] = [0.02, 0.05, 0.1, 0.2, 0.4];
/// Dead times from the switch to its force, s. Cost.
pub(crate) const RELAY_DEAD_TIMES_S: [f64; 9] = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0];
/// Switches of the grid that are refined. Cost.
pub(crate) const RELAYS_REFINED: usize = 3;
/// First steps of the refinement, in the threshold's logarithm and in seconds; each round has half of the last.
/// Cost.
pub(crate) const RELAY_STEPS: (f64, f64) = (0.4, 0.04);
/// Rounds of the refinement. Cost.
pub(crate) const RELAY_ROUNDS: usize = 4;
/// Relays that are simulated together. Cost.
pub(crate) const RELAYS_TOGETHER: usize = 24;
/// Numbers of a relay beside its size. Threshold and dead time.
pub(crate) const RELAY_PARAMETERS: usize = 2;
/// Bases of each score test whose noise model is fitted anew. Cost.
pub(crate) const BASES_REFITTED: usize = 6;
/// Bases that are looked at in all score tests. Cost.
pub(crate) const BASES_SORTED: usize = 16;
/// A force that follows a signal tells below this probability of chance, of all looks together. Calibrated.
pub(crate) const FORCE_P_VALUE: f64 = 1e-5;
/// A channel is louder than its sensor from this many times the declared noise on. Calibrated.
pub(crate) const LOUD_RATIO: f64 = 1.6;
/// A single cause is compared with forces that follow a signal when chance leaves as much as it does so rarely.
/// Calibrated.
pub(crate) const RIVAL_FORCE_P_VALUE: f64 = 0.15;
/// Gain in BIC below which turbulence is not thought of. Kass and Raftery (1995): very strong evidence.
pub(crate) const MIN_TURBULENCE_BIC: f64 = 10.0;
/// Largest relative standard errors of size and bandwidth with which turbulence is named. As the largest relative
/// error of an effect; a bandwidth within a factor of e.
pub(crate) const MAX_TURBULENCE_ERRORS: (f64, f64) = (0.3, 1.0);
/// A slower motion than this many periods in the record is a drift rather than turbulence. Fewer periods than two
/// are a drift: no spectrum can be told from one period.
pub(crate) const MIN_PERIODS: f64 = 2.0;
/// Of slow turbulence a short record shows what it adds up to, as it does of a short pulse; how large and how slow
/// it is go together. From this gain on that is enough, if it may be fast enough. Calibrated.
pub(crate) const SLOW_TURBULENCE_BIC: f64 = 50.0;
/// The largest standard error of its bandwidth's logarithm. Calibrated.
pub(crate) const SLOW_TURBULENCE_ERROR: f64 = 1.5;
/// Share of rows that must have all channels. Calibrated.
pub(crate) const COMPLETE_ROWS_SHARE: f64 = 0.7;
/// Limits of Fisher scoring on Whittle's likelihood: it ends where a step gains a hundredth, far below one standard error
/// of a log-likelihood ratio (Wilks 1938). Cost.
pub(crate) const SCORING_LIMITS: Limits =
    Limits { iterations: 60, tolerance: 1e-3, gain: 1e-2, trials: MAX_DAMPED_STEPS };
/// States whose fit is refined by the exact likelihood: the best of Whittle's. Cost.
pub(crate) const TURBULENCE_STATES_REFINED: usize = 3;
/// A gain in BIC by Whittle's likelihood below which the exact one is not asked. Cost.
pub(crate) const UNLIKELY_TURBULENCE_BIC: f64 = -30.0;
/// A residual this many times the noise is far above it. Calibrated.
pub(crate) const FAR_ABOVE_NOISE: f64 = 2.5;
/// Shares of a standard deviation at which a turbulence is tried; the last is as good as none. Cost.
pub(crate) const TURBULENCE_SIZE_SHARES: [f64; 4] = [1.0, 0.3, 0.1, 1e-3];
/// Gain in the logarithm of the likelihood below which no climb is begun: an eighth of what the least turbulence
/// that is named has in the end. Cost.
pub(crate) const CLIMB_PROMISE: f64 = 2.0;
/// Partial correlations of a noise that are tried: equally spaced in the inverse hyperbolic tangent, in which their
/// estimates have one variance (Fisher 1921). Cost.
pub(crate) const PARTIAL_CORRELATION_STARTS: [f64; 5] = [0.0, 0.635, 0.905, -0.635, -0.905];
/// Frequencies of a resonant noise that are tried, as shares of half the sampling rate. Cost.
pub(crate) const RESONANT_STARTS: [f64; 5] = [0.16, 0.32, 0.5, 0.66, 0.84];
/// Starts of an untrusted spectrum that are followed. Cost.
pub(crate) const STARTS_CLIMBED: usize = 2;
/// Bandwidths from which the likelihood may be climbed, equally spaced in their logarithm over what the record shows.
/// Cost.
pub(crate) const BANDWIDTH_STARTS: usize = 5;
/// Sizes from which the likelihood may be climbed, as shares. Cost.
pub(crate) const SIZE_STARTS: [f64; 3] = [0.4, 1.0, 2.5];
/// Noise is named from this many times the declared on. The definition of `noise` as a cause.
pub(crate) const EXCESS_NOISE_RATIO: f64 = 2.0;
/// Choices of causes, each under the turbulence that the last left. Cost.
pub(crate) const TURBULENCE_PASSES: usize = 2;
/// Sizes that differ by less are the same. Calibrated.
pub(crate) const SETTLED_SIZE_RATIO: f64 = 1.3;
/// A turbulence that grows with a command, by so many standard deviations of chance, is none. Two-sided Gaussian
/// tail of 5e-4.
pub(crate) const RELATED_SIGMAS: f64 = 3.5;
/// A force that follows a signal has a few values, turbulence one a step: where the few gain so large a share of
/// what turbulence does, it follows the signal. Calibrated.
pub(crate) const FORCE_SHARE_OF_TURBULENCE: f64 = 0.5;
/// Shifts in time that show what chance does. Cost.
pub(crate) const CIRCULAR_SHIFTS: usize = 200;
/// Reach of a line to either side, as a share of the sampling rate. Calibrated.
pub(crate) const LINE_REACH: f64 = 0.006;
/// Reach of a line's surroundings to either side, as a share of the sampling rate. Calibrated.
pub(crate) const SURROUNDINGS_REACH: f64 = 0.03;
/// An envelope is steadier than noise's from so many standard deviations on. One-sided Gaussian tail of 1e-3.
pub(crate) const STEADY_SIGMAS: f64 = 3.1;
/// Height over the floor. Calibrated.
pub(crate) const LINE_HEIGHT: f64 = 15.0;
/// Share of the residual's power from which on a line is named. Calibrated.
pub(crate) const LINE_RESIDUAL_SHARE: f64 = 0.005;
/// How much faster than the vehicle's fastest own motion it must be: slower lines may be limit cycles. Calibrated.
pub(crate) const ABOVE_VEHICLE_RATIO: f64 = 5.0;
/// Lines of a channel that are looked at. Cost.
pub(crate) const LINES_EXAMINED: usize = 3;
/// Lines of two channels that are nearer, as a share, are the same vibration. Calibrated.
pub(crate) const SAME_LINE_SHARE: f64 = 0.02;

// answer: what is said and shown
/// A value that is nearer to an end of its range, as a share of it, is at that end: its optimum lies beyond (Self and Liang
/// 1987). Rounding of the last step of a fit.
pub(crate) const AT_LIMIT_SHARE: f64 = 1e-3;
/// Causes that leave less than this share of what was wrong explain it. The definition of `explained`.
pub(crate) const EXPLAINED_SHARE: f64 = 0.1;
/// Rejected effects that are told. Length of a list.
pub(crate) const REJECTED_TOLD: usize = 12;
/// Correlation with an input's past that is no chance. Calibrated.
pub(crate) const COHERENT_CORRELATION: f64 = 0.15;
/// Up to so many times its declared power a residual is noise, not something left to explain: `noise` as a cause
/// means more than twice the declared standard deviation. The definition of `noise` as a cause: twice the standard
/// deviation.
pub(crate) const NOISE_POWER_RATIO: f64 = 4.0;
/// The last part of a record, as a share, is held out. Definition: two thirds for estimation, one
/// for validation.
pub(crate) const HELD_OUT_SHARE: f64 = 1.0 / 3.0;
/// How far a rotor's speed may differ between flight and ground, as a share. Calibrated.
pub(crate) const ROTOR_SPEED_SHARE: f64 = 0.1;
/// A tone stands out of its surroundings by this factor in amplitude. The median of Rayleigh amplitudes exceeds
/// four times itself with 1.5e-5.
pub(crate) const LINE_AMPLITUDE_RATIO: f64 = 4.0;
/// Rounds of Riccati's recursion before it is taken as settled. Cost.
pub(crate) const RICCATI_ROUNDS: usize = 1500;
/// Steps over which the response to the unknown is looked at, to get its scale. Cost.
pub(crate) const RESPONSE_STEPS: usize = 10;
/// Rejected candidates that are shown beside the accepted ones. Length of a list.
pub(crate) const REJECTED_SHOWN: usize = 2;
/// Buckets of a histogram. Size of a plot.
pub(crate) const HISTOGRAM_BUCKETS: usize = 60;
/// Samples of a record that are shown about those that went wrong. Size of a plot.
pub(crate) const SAMPLES_SHOWN: usize = 400;
/// Points of a cloud. Size of a plot.
pub(crate) const CLOUD_POINTS: usize = 1200;
/// Parts of an axis over which means are taken. Size of a plot.
pub(crate) const AXIS_PARTS: usize = 28;
/// Lags of a step response. Size of a plot.
pub(crate) const STEP_RESPONSE_LAGS: usize = 40;
/// Standard deviation of how much the arrived share moves from one lag to the next, before the record is asked.
/// Calibrated.
pub(crate) const STEP_RESPONSE_MOVES: f64 = 0.3;
