//! Scores a diagnosis by comparing it with the truth of its trial.

use serde::{Deserialize, Serialize};
use whirlstand_vehicle::{Effect, Kind, Matrix, Place, Vehicle};

use super::detect::{Detector, kappa};
use super::diagnosis::{Cause, Diagnosis};
use super::draft::wrapped;
use super::error::BlindError;
use super::plan::Case;
use super::trial::{Answer, Trial, Truth};
use super::turbulence::Spectrum;

/// Similarity of two signatures above which their causes cannot be distinguished.
pub const CONFUSABLE: f64 = 0.95;
/// Detectability above which an effect counts for the goals.
pub const COUNTS_FROM: f64 = 30.0;

/// Outcome of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Correct: the right name and location first; both effects of a pair; no name on a clean record or for
    /// an effect outside the table.
    Right,
    /// An effect outside the table was named as effects of the table with nearly the same signature in this
    /// record: neither right nor wrong. The generator redraws the trials that it recognizes as such.
    Alike,
    /// Another cause is first, and the truth is rightly listed as indistinguishable from it.
    Listed,
    /// A wrong name or location first, a wrong name in a pair, or any name where no effect of the table is
    /// hidden.
    Wrong,
    /// One effect of a pair is named rightly, the other not at all.
    Half,
    /// No cause is named.
    Missed,
    /// The program gave no diagnosis.
    Failed,
}

/// A parameter of a correctly named effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScoredParameter {
    /// Effect and parameter, as `effect.parameter`.
    pub name: String,
    /// True value, SI.
    pub truth: f64,
    /// Value from the diagnosis, SI.
    pub value: f64,
    /// Whether the stated interval contains the truth; `None` without an interval.
    pub inside: Option<bool>,
    /// Relative error; `None` for times, phases and true values of zero.
    pub relative_error: Option<f64>,
}

/// A trial with its outcome.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scored {
    /// The hidden truth.
    pub answer: Answer,
    /// SHA-256 of the sealed answer.
    pub seal: String,
    /// Outcome of the trial.
    pub outcome: Outcome,
    /// Verdict of the diagnosis; empty when it failed.
    pub verdict: String,
    /// Named causes as `effect(where)`, in the order of the diagnosis.
    pub named: Vec<String>,
    /// Number of wrong names, at any position.
    pub wrong_names: usize,
    /// Confusability of a named cause with the truth, where it was computed.
    pub kappa: Option<f64>,
    /// Parameters of correctly named effects.
    pub parameters: Vec<ScoredParameter>,
    /// Held-out error relative to the noise floor, as a root mean square over the outputs.
    pub heldout: Option<f64>,
    /// Wall time of the diagnosis, s.
    pub seconds: f64,
    /// Reason why there is no diagnosis.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub failure: Option<String>,
}

impl Scored {
    /// Whether the trial counts for the goals, because everything hidden is detectable.
    pub fn counts(&self) -> bool {
        self.answer.effects.iter().all(|t| t.lambda > COUNTS_FROM)
    }

    /// Whether the outcome is right, or as good as the record allows.
    pub fn is_good(&self) -> bool {
        matches!(self.outcome, Outcome::Right | Outcome::Listed | Outcome::Alike)
    }

    /// A trial whose program gave no diagnosis.
    pub fn failed(trial: &Trial, seal: String, reason: String, seconds: f64) -> Self {
        Self {
            answer: trial.answer.clone(),
            seal,
            outcome: Outcome::Failed,
            verdict: String::new(),
            named: Vec::new(),
            wrong_names: 0,
            kappa: None,
            parameters: Vec::new(),
            heldout: None,
            seconds,
            failure: Some(reason),
        }
    }

    /// Opens the seal and scores a diagnosis against the truth of the trial.
    ///
    /// # Errors
    /// Fails when the true motion cannot be simulated again, which [`Trial::draw`] has done before.
    pub fn new(trial: &Trial, diagnosis: &Diagnosis, seal: String, seconds: f64) -> Result<Self, BlindError> {
        let vehicle = &trial.experiment.nominal.vehicle;
        let causes = &diagnosis.causes;
        let mut confusability = Confusability::new(trial);
        let mut parameters = Vec::new();
        // For each cause, the truth that it names (true), or rightly lists as indistinguishable (false).
        let mut meant: Vec<Option<(usize, bool)>> = Vec::new();
        for cause in causes {
            let open = |t: &usize| !meant.iter().flatten().any(|(taken, _)| taken == t);
            let truths = || trial.effects.iter().enumerate();
            let itself = truths().find(|(t, e)| open(t) && same(e, cause)).map(|(t, _)| t);
            let found = match itself {
                Some(t) => {
                    parameters.extend(compare(vehicle, &trial.effects[t], cause, trial));
                    Some((t, true))
                }
                None => truths()
                    .filter(|(t, _)| open(t))
                    .filter(|(_, e)| cause.indistinguishable.iter().any(|i| same(e, i)))
                    .find(|(t, _)| confusability.of(*t, cause).is_some_and(|k| k > CONFUSABLE))
                    .map(|(t, _)| (t, false)),
            };
            meant.push(found);
        }
        let mut wrong_names = meant.iter().filter(|m| m.is_none()).count();
        let found = meant.len() - wrong_names;
        let outcome = match trial.answer.case {
            Case::Clean | Case::Outside if causes.is_empty() => Outcome::Right,
            Case::Outside if confusability.outside(causes).is_some_and(|k| k > CONFUSABLE) => Outcome::Alike,
            Case::Clean | Case::Outside => Outcome::Wrong,
            _ if causes.is_empty() => Outcome::Missed,
            Case::Single => match meant[0] {
                Some((_, true)) => Outcome::Right,
                Some((_, false)) => Outcome::Listed,
                None => Outcome::Wrong,
            },
            Case::Pair if found == 2 => Outcome::Right,
            Case::Pair if wrong_names > 0 => Outcome::Wrong,
            Case::Pair => Outcome::Half,
        };
        if outcome == Outcome::Alike {
            wrong_names = 0;
        }
        if trial.answer.case == Case::Single && outcome == Outcome::Wrong {
            confusability.of(0, &causes[0]);
        }
        Ok(Self {
            answer: trial.answer.clone(),
            seal,
            outcome,
            verdict: diagnosis.verdict.clone(),
            named: causes.iter().map(|c| format!("{}({})", c.effect, c.place)).collect(),
            wrong_names,
            kappa: confusability.last,
            parameters,
            heldout: heldout(trial, diagnosis)?,
            seconds,
            failure: None,
        })
    }
}

/// A name without its spaces.
fn tight(text: &str) -> String {
    text.chars().filter(|c| !c.is_whitespace()).collect()
}

/// Whether a cause is the same effect at the same location as the truth. A misalignment of a pair equals one
/// of the pair in the other order.
fn same(truth: &Effect, named: &Cause) -> bool {
    if truth.kind().name() != named.effect {
        return false;
    }
    if truth.kind() == Kind::ModeTransition
        && let (Some(to), Some(named)) = (truth.text(), named.successor())
        && to != named
    {
        return false;
    }
    let (own, other) = (tight(truth.place()), tight(&named.place));
    own == other || truth.kind() == Kind::Misalignment && turned(&own, &other)
}

/// Whether two pairs of outputs are equal, up to order and to the suffix `_rate`.
fn turned(own: &str, other: &str) -> bool {
    let (Some((a, b)), Some((c, d))) = (own.split_once(','), other.split_once(',')) else { return false };
    let bare = |name: &str| name.strip_suffix("_rate").unwrap_or(name).to_string();
    let (a, b, c, d) = (bare(a), bare(b), bare(c), bare(d));
    a == d && b == c || a == c && b == d
}

/// Compares a correctly named effect's parameters with the truth.
fn compare(vehicle: &Vehicle, truth: &Effect, named: &Cause, trial: &Trial) -> Vec<ScoredParameter> {
    let rate_hz = trial.answer.rate_hz;
    let folded = |hz: f64| (hz - (hz / rate_hz).round() * rate_hz).abs();
    let aliased = truth.kind() == Kind::Vibration
        && truth.parameter("frequency_hz").is_some_and(|hz| hz > 0.5 * rate_hz);
    let reversed = truth.kind() == Kind::Misalignment && {
        let first = |place: &str| tight(place).split(',').next().unwrap_or_default().to_string();
        first(truth.place()).trim_end_matches("_rate") != first(&named.place).trim_end_matches("_rate")
    };
    // A sine of negative amplitude equals one of positive amplitude, shifted by half a period.
    let flipped = ["amplitude"].iter().any(|n| named.estimate(n).is_some_and(|e| e.value < 0.0));
    let mut all = Vec::new();
    for (name, wanted) in truth.parameters() {
        let (mut wanted, mut name_there) = (wanted, name);
        if truth.kind() == Kind::ParameterChange && !named.parameters.contains_key(name) {
            let Some((converted, other)) = other_form(vehicle, truth, name, wanted) else { continue };
            (wanted, name_there) = (converted, other);
        }
        let Some(estimate) = named.estimate(name_there) else { continue };
        let (mut value, mut interval) = (estimate.value, estimate.interval);
        let mut map = |f: &dyn Fn(f64) -> f64| {
            value = f(value);
            interval = interval.map(|(a, b)| (f(a).min(f(b)), f(a).max(f(b))));
        };
        match name {
            "amplitude" if flipped => map(&|v| -v),
            // The sign of an outlier is random.
            "magnitude" if truth.kind() == Kind::Outliers => {
                map(&f64::abs);
                wanted = wanted.abs();
            }
            "angle_rad" if reversed => map(&|v| -v),
            "frequency_hz" if aliased => {
                map(&folded);
                wanted = folded(wanted);
            }
            "phase_rad" if aliased => continue,
            // The bandwidth of a different spectrum is a different quantity.
            "bandwidth_hz" if trial.answer.spectrum != Spectrum::FirstOrder => continue,
            "phase_rad" => {
                let turn = if flipped { std::f64::consts::PI } else { 0.0 };
                // Unwrap the phase next to the true one.
                let said = estimate.value;
                let shift = wrapped(said + turn - wanted) + wanted - said;
                map(&|v| v + shift);
            }
            _ => {}
        }
        let timing = matches!(name, "phase_rad" | "at_s" | "asymmetry");
        all.push(ScoredParameter {
            name: format!("{}.{name_there}", truth.kind().name()),
            truth: wanted,
            value,
            inside: interval.map(|(low, high)| low <= wanted && wanted <= high),
            relative_error: (!timing && wanted != 0.0).then(|| ((value - wanted) / wanted).abs()),
        });
    }
    all
}

/// The true size of a parameter change in its other form: as a value instead of a factor, or conversely.
fn other_form(vehicle: &Vehicle, truth: &Effect, name: &str, wanted: f64) -> Option<(f64, &'static str)> {
    let Ok(Place::Entry(matrix, i, j)) = truth.resolve(vehicle) else { return None };
    let entry = match matrix {
        Matrix::A => vehicle.a[(i, j)],
        Matrix::B => vehicle.b[(i, j)],
        Matrix::C => vehicle.c[(i, j)],
        Matrix::D => vehicle.d[(i, j)],
    };
    if name == "factor" { Some((wanted * entry, "value")) } else { Some((wanted / entry, "factor")) }
}

/// Confusabilities of named causes with the truth, computed from the truth model.
struct Confusability<'a> {
    trial: &'a Trial,
    detector: Option<Detector>,
    last: Option<f64>,
}

impl<'a> Confusability<'a> {
    fn new(trial: &'a Trial) -> Self {
        Self { trial, detector: None, last: None }
    }

    /// Confusability of a cause with the hidden effect number `index` that it replaces; `None` where the
    /// cause cannot be simulated as stated, or where either is random and has no signature.
    fn of(&mut self, index: usize, cause: &Cause) -> Option<f64> {
        let trial = self.trial;
        let named = effect(cause)?;
        if random(named.kind()) || random(trial.effects[index].kind()) {
            return None;
        }
        let experiment = &trial.experiment;
        let mut without = trial.effects.clone();
        without.remove(index);
        let with = |effect: Effect| -> Option<Vec<f64>> {
            let mut all = without.clone();
            all.push(effect);
            experiment.expected(&all, None).ok()
        };
        let rest = experiment.expected(&without, None).ok()?;
        let (named, truth) = (with(named)?, with(trial.effects[index].clone())?);
        self.between([&named, &truth], &rest)
    }

    /// Confusability of causes, flown together, with the trial's effect outside the table. Of disturbances, which have a
    /// course of their own, several could be made into anything: only a single one counts.
    fn outside(&mut self, causes: &[Cause]) -> Option<f64> {
        let experiment = &self.trial.experiment;
        let named: Vec<Effect> = causes.iter().map(effect).collect::<Option<_>>()?;
        let allowed = |e: &Effect| !random(e.kind()) && (causes.len() == 1 || !disturbance(e.kind()));
        named.iter().all(allowed).then_some(())?;
        let truth = experiment.expected(&[], self.trial.outside.as_ref()).ok()?;
        let named = experiment.expected(&named, None).ok()?;
        self.between([&named, &truth], &experiment.expected(&[], None).ok()?)
    }

    /// Confusability of two motions as changes of `rest`.
    fn between(&mut self, motions: [&[f64]; 2], rest: &[f64]) -> Option<f64> {
        let experiment = &self.trial.experiment;
        let detector = self.detector.get_or_insert_with(|| {
            Detector::new(
                &experiment.nominal.vehicle,
                &experiment.noise,
                &experiment.x0,
                &experiment.commands,
            )
        });
        let signature =
            |y: &[f64]| detector.signature(y.iter().zip(rest).map(|(y, rest)| y - rest).collect());
        let [named, truth] = motions.map(signature);
        let found = kappa(&named, &truth);
        self.last = Some(found);
        Some(found)
    }
}

fn random(kind: Kind) -> bool {
    matches!(kind, Kind::Turbulence | Kind::Noise | Kind::Quantization | Kind::Dropouts | Kind::Outliers)
}

/// Whether an effect is a force, or a sensor's error, with a course of its own.
fn disturbance(kind: Kind) -> bool {
    matches!(
        kind,
        Kind::StepDisturbance | Kind::PulseDisturbance | Kind::PeriodicDisturbance | Kind::Vibration
    )
}

/// Converts a named cause to an effect.
fn effect(cause: &Cause) -> Option<Effect> {
    let kind = Kind::from_name(&cause.effect).ok()?;
    if kind == Kind::ModeTransition {
        return Effect::mode_transition(cause.estimate("at_s")?.value, cause.successor()?).ok();
    }
    let numbers: Vec<(&str, f64)> = cause
        .parameters
        .keys()
        .filter_map(|name| Some((name.as_str(), cause.estimate(name)?.value)))
        .collect();
    Effect::new(kind, &cause.place, &numbers).ok()
}

/// Held-out error of the extended vehicle relative to the noise floor, as a root mean square over the
/// outputs.
fn heldout(trial: &Trial, diagnosis: &Diagnosis) -> Result<Option<f64>, BlindError> {
    let Some(part) = diagnosis.heldout else { return Ok(None) };
    let floor = trial.noise_floor(part.from_s, part.to_s)?;
    let outputs = trial.experiment.nominal.vehicle.outputs.iter().zip(&floor);
    let ratios: Vec<f64> = outputs
        .filter_map(|(y, floor)| Some(diagnosis.outputs.get(&y.name)?.rmse_after? / floor))
        .filter(|r| r.is_finite())
        .collect();
    let square: f64 = ratios.iter().map(|r| r * r).sum();
    Ok((!ratios.is_empty()).then(|| (square / ratios.len() as f64).sqrt()))
}

/// The name of a hidden effect, as in `input_delay(u_roll)`.
pub fn truth_name(truth: &Truth) -> String {
    format!("{}({})", truth.effect, truth.place)
}
