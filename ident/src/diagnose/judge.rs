//! Whether a candidate is a cause: all conditions, its detectability, and the rivals that explain as much.

use super::heldout::gain_in_sigmas;
use super::library::Candidate;
use super::model::{Fit, Model, dot};
use super::screen::{Frame, cosine};
use super::survey::Trial;
use super::surveys::Seen;
use crate::identify::quality::chi_square_tail;

/// Least gain in BIC.
pub const LEAST_BIC: f64 = 10.0;
/// Largest probability of a chance, corrected.
pub const LARGEST_P: f64 = 0.01;
/// Least gain on left-out data over its standard error.
pub const LEAST_GAIN: f64 = 2.0;
/// Largest standard error of a size, as a share of it.
pub const LARGEST_ERROR: f64 = 0.3;
/// Detectability below which an effect cannot be told.
pub const LEAST_DETECTABILITY: f64 = 12.0;
/// Cosine from which on two signatures are one.
pub const ALIKE: f64 = 0.95;
/// Difference in BIC up to which a rival is as good.
const AS_GOOD: f64 = 6.0;

/// Evidence for a term.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weight {
    /// Gain in BIC over the model without it.
    pub delta_bic: f64,
    /// Gain on left-out data over its standard error.
    pub heldout: f64,
    /// Probability by chance, corrected.
    pub p_value: f64,
    /// Squared norm of its whitened signature, nuisances projected out.
    pub detectability: f64,
}

/// Why a candidate was not accepted, or its evidence.
#[derive(Debug, Clone, PartialEq)]
pub enum Judgement {
    /// All conditions hold.
    Accepted(Weight),
    /// The first that does not.
    Refused(String),
}

/// A rival that explains as much.
#[derive(Debug, Clone, PartialEq)]
pub struct Rival {
    /// The effect.
    pub candidate: Candidate,
    /// Its values.
    pub values: Vec<f64>,
    /// By how much the accepted cause is better, in BIC.
    pub gap: f64,
    /// By how much it is better in twice the log-likelihood: what the record itself says, whatever the parameters cost.
    pub ratio: f64,
    /// Cosine of the angle between the signatures.
    pub kappa: f64,
}

/// Whether a fitted candidate passes all conditions.
pub fn judge(model: &Model<'_, '_>, fit: &Fit, trial: &Trial, hypotheses: usize) -> Judgement {
    let refuse = |why: String| Judgement::Refused(why);
    let k = trial.candidate.tunables.len();
    let delta_bic = trial.delta_bic;
    if delta_bic < LEAST_BIC {
        return refuse(match delta_bic {
            d if d <= 0.0 => "what it explains is not worth its parameters".into(),
            d => format!("it gains {d:.1} in BIC; {LEAST_BIC:.0} are asked"),
        });
    }
    let Some(extended) = &trial.fit else {
        return refuse("others explain more".into());
    };
    // Where an effect was taken for colour, the noise has numbers that it does without beside the effect: what these are
    // worth counts as it does in the choice of the colour.
    let worth = delta_bic + k as f64 * (fit.profile.rows as f64).ln();
    let chance = chi_square_tail(trial.ratio.max(worth), k as f64);
    let p_value = (chance * trial.candidate.looks * hypotheses as f64).min(1.0);
    if p_value >= LARGEST_P {
        return refuse(format!("chance alone does as well with probability {p_value:.2}, all looks counted"));
    }
    let mut whole = model.clone();
    whole.terms.push(trial.candidate.clone());
    let Some(covariance) = whole.covariance(extended) else {
        return refuse("its parameters are not determined".into());
    };
    let from = extended.values.len() - k;
    for (i, tunable) in trial.candidate.tunables.iter().enumerate() {
        if !tunable.size {
            continue;
        }
        let null = if i + 1 == k { trial.candidate.null } else { 0.0 };
        let size = (extended.values[from + i] - null).abs();
        let mut variance = covariance[(from + i, from + i)];
        // Of a short pulse a record shows the area; how high and how long it was go together.
        if let Some(d) = trial.candidate.tunables.iter().position(|t| t.name == "duration_s") {
            let share = size / extended.values[from + d].abs().max(f64::MIN_POSITIVE);
            let sign = (extended.values[from + i] - null).signum();
            let both = covariance[(from + i, from + d)];
            variance += share * share * covariance[(from + d, from + d)] + 2.0 * sign * share * both;
        }
        let error = variance.max(0.0).sqrt();
        if error > LARGEST_ERROR * size {
            return refuse(format!(
                "its {} is known to {:.0} % only",
                tunable.name,
                (100.0 * error / size.max(f64::MIN_POSITIVE)).min(999.0)
            ));
        }
    }
    let heldout = gain_in_sigmas((model, fit), (&whole, extended));
    if heldout <= LEAST_GAIN {
        return refuse(format!(
            "on data left out of the fit it gains {heldout:.1} standard errors; 2 are asked"
        ));
    }
    let detectability = detectability(model, fit, trial).unwrap_or(0.0);
    Judgement::Accepted(Weight { delta_bic, heldout, p_value, detectability })
}

/// The signature of a fitted candidate: what it changes at its values, the others as they are.
fn signature(model: &Model<'_, '_>, candidate: &Candidate, values: &[f64]) -> Option<Vec<f64>> {
    let mut whole = model.clone();
    whole.terms.push(candidate.clone());
    let others = &values[..values.len() - candidate.tunables.len()];
    let without = model.predict(others)?;
    Some(whole.predict(values)?.iter().zip(&without).map(|(a, b)| a - b).collect())
}

fn detectability(model: &Model<'_, '_>, fit: &Fit, trial: &Trial) -> Option<f64> {
    let extended = trial.fit.as_ref()?;
    let zero = vec![0.0; fit.residual.len()];
    let frame = Frame::new(model.runner.data, &extended.profile.noise, &zero, &fit.columns);
    let s = frame.signature(&signature(model, &trial.candidate, &extended.values)?);
    Some(dot(&s, &s))
}

/// Other fitted candidates, and how alike they look.
pub(super) fn rivals(model: &Model<'_, '_>, fit: &Fit, own: &Trial, trials: &[Seen]) -> Vec<Rival> {
    let Some(extended) = &own.fit else { return Vec::new() };
    let Some(mine) = signature(model, &own.candidate, &extended.values) else { return Vec::new() };
    let zero = vec![0.0; fit.residual.len()];
    let frame = Frame::new(model.runner.data, &extended.profile.noise, &zero, &fit.columns);
    let mine = frame.signature(&mine);
    let name = own.candidate.name();
    let others = trials.iter().filter(|t| t.candidate.name() != name);
    let mut rivals: Vec<Rival> = others
        .filter_map(|t| {
            let values = t.values.as_ref()?;
            let theirs = frame.signature(&signature(model, &t.candidate, values)?);
            Some(Rival {
                values: values[values.len() - t.candidate.tunables.len()..].to_vec(),
                candidate: t.candidate.clone(),
                gap: own.delta_bic - t.delta_bic,
                ratio: own.ratio - t.ratio,
                kappa: cosine(&mine, &theirs).abs(),
            })
        })
        .collect();
    rivals.sort_by(|a, b| a.gap.total_cmp(&b.gap));
    rivals
}

impl Rival {
    /// True when the record cannot tell it from the accepted cause; a simpler cause may be preferred, not proven.
    pub fn indistinguishable(&self) -> bool {
        self.kappa > ALIKE && self.gap.min(self.ratio) < AS_GOOD
    }
}
