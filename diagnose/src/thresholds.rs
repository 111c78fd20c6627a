//! Thresholds of the diagnosis, each with its unit and its source.
//!
//! Three kinds have no reference, and are marked by a word:
//! - *calibrated*: an engineering choice, the value that did best on blind trials (`whirlstand blind --trials 2000
//!   --seed 8 --length 12:24 --rate 40,50`). A change is to be shown by the same with `--generator shifted`.
//! - *cost*: bounds the work; a larger value (a finer grid, more starts) gives the same result and takes longer.
//! - *definition*: defines a word of the answer.

mod noise;
mod samples;
mod screen;
mod search;

use whirlstand_ident::identify::search::Limits;

pub(crate) use noise::*;
pub(crate) use samples::*;
pub(crate) use screen::*;
pub(crate) use search::*;

// data: what a record shows by itself
/// A clock step this many times the usual one is a gap: two samples may be missing and the clock jitter by
/// half a step. As in `whirlstand_logs`.
pub(crate) const GAP_STEPS: f64 = whirlstand_logs::LONGEST_BRIDGED;
/// Fewest steps of a part between two gaps that counts: those that likelihoods leave out, and as many again.
pub(crate) const MIN_PART_STEPS: usize = 2 * MAX_AR_ORDER;
/// Fewest steps of a record. Fewer determine no dynamics: about three times the highest order of the noise
/// model, so that its estimate exists.
pub(crate) const MIN_STEPS: usize = 64;
/// Relative difference below which periods of parts are equal: clocks before and after a gap differ in the
/// last digits, and so small a difference affects no time constant. Definition.
pub(crate) const SAME_PERIOD_SHARE: f64 = 2e-3;
/// Share of an input's largest magnitude beyond which a first command is not rest. Calibrated.
pub(crate) const FIRST_COMMAND_SHARE: f64 = 0.1;
/// Largest number of steps analysed, unless the user says otherwise: ten minutes at 100 Hz. Cost.
pub(crate) const MAX_SEARCHED_STEPS: f64 = 60_000.0;
/// A channel that does not change for this share of the record is stuck. Calibrated.
pub(crate) const STUCK_SHARE: f64 = 0.05;
/// Fit above which two channels are taken to be the same signal, 0 to 1. More than half of the power of one channel
/// is that of the other.
pub(crate) const SAME_SIGNAL_FIT: f64 = 0.6;
/// A tone of up to this many times the declared amplitude is the declared one. Calibrated.
pub(crate) const DECLARED_AMPLITUDE_RATIO: f64 = 1.5;
/// How far the frequency of a rotor may be from the declared, in lines of the record's resolution, to either side.
/// The main lobe of a rectangular window reaches one line to either side; one more for a rotor that is governed.
pub(crate) const DECLARED_FREQUENCY_LINES: i32 = 2;
/// Difference in BIC from which the first commands of a record are taken to begin with it. Three times what
/// Kass and Raftery (1995) call very strong.
pub(crate) const REST_BEFORE_BIC: f64 = 30.0;
/// A disturbance before this time is one at the beginning, s. Calibrated.
pub(crate) const BEGINNING_S: f64 = 0.1;

// model: likelihood and simulation
/// Gain of the log-likelihood below which a fit has converged. A hundredth of the standard error of a
/// log-likelihood ratio of one parameter (Wilks 1938).
pub(crate) const FIT_TOLERANCE: f64 = 0.02;
/// Largest impulse of a smooth force's tangent over half a step, relative to the motion that it changes, up to which the
/// force is taken as kicks between steps: the frequency of an oscillation on that force is then wrong by less than 0.4 %
/// (leapfrog: (omega T)^2 / 24; Hairer, Lubich and Wanner, Geometric Numerical Integration, 2006, I.1).
pub(crate) const SHORT_KICK: f64 = 0.05;
/// Steps tried from one point, each with twice the growth of damping of the last: ten take it from 1e-12 to where a step
/// follows the gradient. Cost.
pub(crate) const MAX_DAMPED_STEPS: usize = 10;
/// Limits of the descent of a fit under one noise model, of which the fit sets the number of steps: it ends with a step that
/// gains less than the tolerance of a fit. The damping is small from the start, because it hides how far away the optimum is in
/// directions that the data hardly determine. Cost.
pub(crate) const DESCENT_LIMITS: Limits = Limits {
    iterations: 6,
    tolerance: 1e-3,
    gain: 0.5 * FIT_TOLERANCE,
    trials: MAX_DAMPED_STEPS,
    damping: 1e-4,
};
/// Half-width of a 95 % interval in standard errors, the root of the 95 % quantile of chi-square with one degree of
/// freedom (Wilks 1938).
pub(crate) const INTERVAL_SIGMAS: f64 = 1.959_963_984_540_054;
/// Relative error of an interval's half-width that is not worth another fit: a tenth, which moves the coverage of 95 % by
/// two to three hundredths.
pub(crate) const PARABOLA_TOLERANCE: f64 = 0.1;
/// Fits in the search for one end of an interval. Cost.
pub(crate) const INTERVAL_EVALUATIONS: usize = 10;
/// A run that exceeds the largest measured value by this factor has diverged: nonlinear effects far out cost
/// thousands of steps each. Cost.
pub(crate) const DIVERGED_RATIO: f64 = 1e3;
/// Perturbation of a state for a sensitivity. Forward difference of a response that is linear in the initial
/// state: rounding and curvature are both below 1e-6.
pub(crate) const INITIAL_STATE_STEP: f64 = 1e-3;
/// Steps after which a filter's covariance is taken as settled. Cost.
pub(crate) const MAX_TRANSIENT_STEPS: usize = 400;
/// Relative change of the gain in a step below which it is settled. Likelihoods err by its square. The covariance of a filter is
/// stationary about the optimal gain: an error enters squared (Anderson and Moore 1979).
pub(crate) const SETTLED_GAIN_CHANGE: f64 = 1e-6;
/// Difference of a noise's logarithm, or of a correlation's inverse hyperbolic tangent, for a derivative: rounding and
/// curvature are both below 1e-3 of a derivative, which only directs a step.
pub(crate) const NOISE_PARAMETER_STEP: f64 = 1e-3;
/// Rows of which the derivatives are held at a time. Cost.
pub(crate) const SCORED_ROWS: usize = 1024;
/// Limits of a climb: it ends where a step would gain, or has gained, as little as where a fit has converged. Cost.
pub(crate) const CLIMB_LIMITS: Limits =
    Limits { iterations: 15, tolerance: 0.2, gain: FIT_TOLERANCE, trials: MAX_DAMPED_STEPS, damping: 1e-3 };
/// Largest gain left to a climb: this many times what its next step promises, plus this many. Cost.
pub(crate) const CLIMB_OPTIMISM: f64 = 4.0;
/// Magnitude below which partial correlations are set to zero. Calibrated.
pub(crate) const WEAK_CORRELATION: f64 = 0.2;
/// Fewest samples of a channel for which spectra are estimated. Calibrated.
pub(crate) const MIN_SPECTRUM_SAMPLES: usize = 256;
/// The shortest memory of a predictor that follows the record, steps: shorter, a prediction is the last sample. Definition.
pub(crate) const SHORTEST_MEMORY_STEPS: f64 = 2.0;
/// Ratio of a memory to the next. The likelihood of a filter is flat about its optimum: a gain that is off by a factor
/// of two costs a few per cent of the innovations' variance (Anderson and Moore 1979). Cost.
pub(crate) const MEMORY_GROWTH: f64 = 4.0;
/// The longest memory, as a share of the record: a record contains too few longer ones to estimate it. Cost.
pub(crate) const MEMORY_RECORD_SHARE: f64 = 0.1;
/// The longest default horizon, as a share of the record. Ten independent predictions.
pub(crate) const HORIZON_RECORD_SHARE: f64 = 0.1;
/// The shortest default horizon, steps. Definition.
pub(crate) const LEAST_HORIZON_STEPS: f64 = 10.0;

// candidates: where effects are looked for
/// Times over which the fastest mean rates of an input are taken, s: a rate limit of that size leaves the actuator behind
/// for about as long. From one sample of a fast loop to a slow manoeuvre.
pub(crate) const LIMITED_TIMES_S: [f64; 5] = [0.02, 0.06, 0.2, 0.6, 2.0];
/// Stands for no limit in a parameter that must be finite.
pub(crate) const UNBOUNDED: f64 = 1e9;
/// Fewest times at which an event is tried. Cost.
pub(crate) const MIN_EVENT_TIMES: usize = 600;
/// Durations of a pulse, in steps of the grid of times: each about 1.6 times the last. Cost.
pub(crate) const DURATION_GROWTH: f64 = 1.6;
/// Largest number of tones followed up in every channel. Cost.
pub(crate) const TONES_FOLLOWED: usize = 2;
/// Smallest ratio of a tone's power to its surroundings; chance reaches this on one of 3000 frequencies. The
/// likelihood decides whether it is accepted. Periodogram ordinates are exponential (Priestley 1981, 6.1):
/// exp(-8) is one of 3000.
pub(crate) const TONE_POWER_RATIO: f64 = 8.0;
/// Ratio of an input's power at a frequency to the median around it from which it has a line there. Periodogram ordinates are
/// exponential (Priestley 1981, 6.1): noise reaches it on one of 1e30 frequencies.
pub(crate) const INPUT_LINE_RATIO: f64 = 100.0;
/// Largest amplitude of what a wrong response leaves, as a share of the response: a gain that is off by a third, or a phase by
/// 30 degrees, leaves half.
pub(crate) const WRONG_RESPONSE_SHARE: f64 = 0.5;
/// Times at which a transition is tried. Cost.
pub(crate) const TRANSITION_TIMES: usize = 24;

// residual: what the causes leave
/// Largest number of states on which forces are tried. Cost.
pub(crate) const TESTED_STATES: usize = 3;
/// Largest number of states whose products are tried. Cost.
pub(crate) const PRODUCT_STATES: usize = 4;
/// Largest number of samples tested, over all channels. Cost.
pub(crate) const TESTED_SAMPLES: usize = 100_000;
/// Largest number of column values held together. Memory: 40 MB.
pub(crate) const TESTED_TOGETHER: usize = 5_000_000;
/// Rows of a block. Cost.
pub(crate) const GRAM_BLOCK_ROWS: usize = 2048;
/// Columns of a panel. Cost.
pub(crate) const GRAM_PANEL_COLUMNS: usize = 64;
/// All functions together are significant beyond this many standard deviations of chance. One-sided Gaussian
/// tail of 3e-7.
pub(crate) const LACK_SIGMAS: f64 = 5.0;
/// All functions together are significant from this energy on, about three times what a single effect needs
/// to be detected. Calibrated.
pub(crate) const LACK_ENERGY: f64 = 40.0;
/// Functions of one signal are significant below this probability of chance, over all tests. Calibrated.
pub(crate) const LACK_P_VALUE: f64 = 1e-3;
/// Beside turbulence, whose spectrum a short record hardly shows, functions of one signal are significant
/// below this probability. Calibrated.
pub(crate) const LACK_CERTAIN_P_VALUE: f64 = 1e-7;
/// Width of a smooth switch, as a share of a signal's largest magnitude. Calibrated.
pub(crate) const SWITCH_SHARE: f64 = 0.1;
/// Cycles over the record of a slowly varying gain: slower than those identified by their frequency. Cost.
pub(crate) const SLOW_TURNS: usize = 6;
/// Half waves of a force over the range of a state. Cost.
pub(crate) const HALF_WAVES: usize = 4;
/// Highest frequency of a modulated stiffness or gain that is searched for, Hz. Calibrated.
pub(crate) const FASTEST_MODULATION_HZ: f64 = 2.0;
/// Largest number of cycles of a modulated stiffness or gain over the record. Cost.
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
/// Shortest and longest time constant of a sensor's creep, as shares of the record. Where a share of them is longer, it is a
/// drift of the gain. Calibrated.
pub(crate) const CREEP_TIMES: (f64, f64) = (0.01, 0.5);
/// Smallest and largest limit of a sensor's rate, as shares of the fastest change from one sample to the next. Calibrated.
pub(crate) const SLEW_SHARES: (f64, f64) = (0.02, 0.8);
/// Smallest and largest width of an actuator's stiction, as shares of the largest command. Calibrated.
pub(crate) const STICTION_WIDTHS: (f64, f64) = (0.02, 0.5);
/// Numbers of a sensor's error that are tried, and between the neighbours of the best. Cost.
pub(crate) const SENSOR_TRIED: [usize; 4] = [16, 6, 6, 6];
/// Widths of stiction that are tried: one jump more or less changes all later ones, so that its likelihood has many maxima.
/// Cost.
pub(crate) const STICTION_TRIED: [usize; 1] = [96];
/// Bases of each score test whose noise model is fitted anew. Cost.
pub(crate) const BASES_REFITTED: usize = 6;
/// Bases that are looked at in all score tests. Cost.
pub(crate) const BASES_SORTED: usize = 16;
/// A force that follows a signal is significant below this probability of chance, over all tests. Calibrated.
pub(crate) const FORCE_P_VALUE: f64 = 1e-5;
/// Ratio of an error to the noise floor of the same record from which it is more than noise. Calibrated.
pub(crate) const LOUD_RATIO: f64 = 1.6;
/// A single cause is compared with forces that follow a signal when the probability of its residual by chance
/// is below this. Calibrated.
pub(crate) const RIVAL_FORCE_P_VALUE: f64 = 0.15;
/// Smallest gain in BIC with which turbulence is considered. Kass and Raftery (1995): very strong evidence.
pub(crate) const MIN_TURBULENCE_BIC: f64 = 10.0;
/// Largest relative standard errors of size and bandwidth with which turbulence is named. As the largest relative
/// error of an effect; a bandwidth within a factor of e.
pub(crate) const MAX_TURBULENCE_ERRORS: (f64, f64) = (0.3, 1.0);
/// Fewest periods of a motion in the record: a slower motion is a drift rather than turbulence, as no
/// spectrum can be told from one period.
pub(crate) const MIN_PERIODS: f64 = 2.0;
/// Gain in BIC from which slow turbulence is named by its best-determined combination, if it may be fast
/// enough: a short record determines neither its size nor its bandwidth alone, as for a short pulse.
/// Calibrated.
pub(crate) const SLOW_TURBULENCE_BIC: f64 = 50.0;
/// Largest standard error of the logarithm of slow turbulence's bandwidth. Calibrated.
pub(crate) const SLOW_TURBULENCE_ERROR: f64 = 1.5;
/// Smallest share of rows with all channels. Calibrated.
pub(crate) const COMPLETE_ROWS_SHARE: f64 = 0.7;
/// Limits of Fisher scoring on Whittle's likelihood: it ends where a step gains a hundredth, far below one standard error
/// of a log-likelihood ratio (Wilks 1938). Cost.
pub(crate) const SCORING_LIMITS: Limits =
    Limits { iterations: 60, tolerance: 1e-3, gain: 1e-2, trials: MAX_DAMPED_STEPS, damping: 1e-3 };
/// States whose fit is refined by the exact likelihood: the best of Whittle's. Cost.
pub(crate) const TURBULENCE_STATES_REFINED: usize = 3;
/// Relative error of a difference of sums of some thousand products in double precision.
pub(crate) const ROUNDING: f64 = 1e-12;
/// Gain in BIC by Whittle's likelihood below which the exact one is not computed. Cost.
pub(crate) const UNLIKELY_TURBULENCE_BIC: f64 = -30.0;
/// Ratio of a residual to the noise from which it is far above it. Calibrated.
pub(crate) const FAR_ABOVE_NOISE: f64 = 2.5;
/// Shares of a standard deviation at which turbulence is tried; the last is practically zero. Cost.
pub(crate) const TURBULENCE_SIZE_SHARES: [f64; 4] = [1.0, 0.3, 0.1, 1e-3];
/// Gain in the log-likelihood below which no climb is begun: an eighth of the final gain of the smallest
/// turbulence named. Cost.
pub(crate) const CLIMB_PROMISE: f64 = 2.0;
/// Partial correlations of a noise that are tried: equally spaced in the inverse hyperbolic tangent, in which
/// their estimates have one variance (Fisher 1921). Cost.
pub(crate) const PARTIAL_CORRELATION_STARTS: [f64; 5] = [0.0, 0.635, 0.905, -0.635, -0.905];
/// Frequencies of a resonant noise that are tried, as shares of half the sampling rate. Cost.
pub(crate) const RESONANT_STARTS: [f64; 5] = [0.16, 0.32, 0.5, 0.66, 0.84];
/// Starts of an untrusted spectrum that are followed. Cost.
pub(crate) const STARTS_CLIMBED: usize = 2;
/// Number of bandwidths from which the likelihood may be climbed, equally spaced in their logarithm over the
/// record's range. Cost.
pub(crate) const BANDWIDTH_STARTS: usize = 5;
/// Size ratios from which the likelihood may be climbed. Cost.
pub(crate) const SIZE_STARTS: [f64; 3] = [0.4, 1.0, 2.5];
/// Noise is named from this ratio to the declared noise on. The definition of `noise` as a cause.
pub(crate) const EXCESS_NOISE_RATIO: f64 = 2.0;
/// Noise makes changes from sample to sample oppose each other in a row. Where changes two to four steps apart do so too, by this
/// share of that covariance, they are those of an oscillation, and no noise is named. A convention; noise makes it 0.
pub(crate) const OPPOSED_AGAIN: f64 = 0.2;
/// Selections of causes, each under the turbulence of the last. Cost.
pub(crate) const TURBULENCE_PASSES: usize = 2;
/// Ratio below which two sizes of turbulence are the same. Calibrated.
pub(crate) const SETTLED_SIZE_RATIO: f64 = 1.3;
/// Correlation of turbulence with a command or an output, in standard deviations of chance, from which it is
/// not turbulence. Two-sided Gaussian tail of 5e-4.
pub(crate) const RELATED_SIGMAS: f64 = 3.5;
/// Share of turbulence's gain from which a force that follows a signal replaces it: the force has few
/// parameters, turbulence one value per step. Calibrated.
pub(crate) const FORCE_SHARE_OF_TURBULENCE: f64 = 0.5;
/// Number of circular shifts that estimate the distribution by chance. Cost.
pub(crate) const CIRCULAR_SHIFTS: usize = 200;
/// Half width of a spectral line, as a share of the sampling rate. Calibrated.
pub(crate) const LINE_REACH: f64 = 0.006;
/// Half width of a line's surroundings, as a share of the sampling rate. Calibrated.
pub(crate) const SURROUNDINGS_REACH: f64 = 0.03;
/// Standard deviations by which an envelope is steadier than that of noise. One-sided Gaussian tail of 1e-3.
pub(crate) const STEADY_SIGMAS: f64 = 3.1;
/// Smallest ratio of a line's peak density to the floor. Calibrated.
pub(crate) const LINE_HEIGHT: f64 = 15.0;
/// Smallest share of the residual's power of a line that is named. Calibrated.
pub(crate) const LINE_RESIDUAL_SHARE: f64 = 0.005;
/// Smallest ratio of a line's frequency to the vehicle's fastest pole: slower lines may be limit cycles.
/// Calibrated.
pub(crate) const ABOVE_VEHICLE_RATIO: f64 = 5.0;
/// Lines of a channel that are looked at. Cost.
pub(crate) const LINES_EXAMINED: usize = 3;
/// Relative difference in frequency below which lines of two channels are the same vibration. Calibrated.
pub(crate) const SAME_LINE_SHARE: f64 = 0.02;

// answer: what is said and shown
/// Relative distance to an end of its range within which a value is at that end: its optimum lies beyond
/// (Self and Liang 1987). Rounding of the last step of a fit.
pub(crate) const AT_LIMIT_SHARE: f64 = 1e-3;
/// Growth of the errors of held-out predictions, all outputs together, above which causes are doubted: the share that
/// an input must explain to be one (`vehicle new`). Calibrated: no right name of the trials of docs/blind.md is doubted.
pub(crate) const WORSE_AHEAD_RATIO: f64 = 1.05;
/// Share of the model error below which causes explain it. The definition of `explained`.
pub(crate) const EXPLAINED_SHARE: f64 = 0.1;
/// Number of rejected effects reported. Length of a list.
pub(crate) const REJECTED_TOLD: usize = 12;
/// Smallest significant correlation with an input's past. Calibrated.
pub(crate) const COHERENT_CORRELATION: f64 = 0.15;
/// Ratio of a residual's power to its declared noise up to which it is noise and not unexplained: the
/// definition of `noise` as a cause, twice the declared standard deviation.
pub(crate) const NOISE_POWER_RATIO: f64 = 4.0;
/// The last part of a record, as a share, is held out. Definition: two thirds for estimation, one
/// for validation.
pub(crate) const HELD_OUT_SHARE: f64 = 1.0 / 3.0;
/// Largest relative difference of a rotor's speed between flight and ground. Calibrated.
pub(crate) const ROTOR_SPEED_SHARE: f64 = 0.1;
/// Smallest ratio of a tone's amplitude to its surroundings. The median of Rayleigh amplitudes exceeds four
/// times itself with 1.5e-5.
pub(crate) const LINE_AMPLITUDE_RATIO: f64 = 4.0;
/// Rounds of the Riccati recursion after which it is taken as settled. Cost.
pub(crate) const RICCATI_ROUNDS: usize = 1500;
/// Steps of the response to the unknown from which its scale is estimated. Cost.
pub(crate) const RESPONSE_STEPS: usize = 10;
/// Number of rejected candidates plotted beside the accepted ones. Length of a list.
pub(crate) const REJECTED_SHOWN: usize = 2;
/// Buckets of a histogram. Size of a plot.
pub(crate) const HISTOGRAM_BUCKETS: usize = 60;
/// Number of samples plotted around faulty ones. Size of a plot.
pub(crate) const SAMPLES_SHOWN: usize = 400;
/// Points of a cloud. Size of a plot.
pub(crate) const CLOUD_POINTS: usize = 1200;
/// Parts of an axis over which means are taken. Size of a plot.
pub(crate) const AXIS_PARTS: usize = 28;
/// Lags of a step response. Size of a plot.
pub(crate) const STEP_RESPONSE_LAGS: usize = 40;
/// Prior standard deviation of the change of a step response from one lag to the next. Calibrated.
pub(crate) const STEP_RESPONSE_MOVES: f64 = 0.3;
