//! Acceptance of a candidate as a cause: its conditions, its detectability, and rivals that explain as much.

use nalgebra::DMatrix;

use crate::candidates::library::Candidate;
use crate::model::columns::dot;
use crate::model::fit::{Fit, Model};
use crate::model::noise::Noise;
use crate::model::optimum::Optimum;
use crate::model::score_test::{ScoreTest, cosine};
use crate::search::alternative::Alternative;
use crate::search::cross_validation::held_out_gain;
use crate::search::survey_cache::Surveyed;
use crate::thresholds::{
    COMMON_COSINE, COX_QUANTILE, MAX_P_VALUE, MAX_RELATIVE_ERROR, MIN_BIC_GAIN, MIN_HELD_OUT_SIGMAS,
    RIVAL_BIC, SAME_SIGNATURE_COSINE, UNDECIDED_BIC,
};
use whirlstand_logs::stats::chi_square_tail;

/// Evidence for a term.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TermEvidence {
    /// Gain in BIC over the model without it.
    pub delta_bic: f64,
    /// Gain on left-out data divided by its standard error.
    pub heldout: f64,
    /// Probability of the gain by chance, corrected for all hypotheses.
    pub p_value: f64,
    /// Squared norm of the whitened signature, nuisances projected out.
    pub detectability: f64,
}

/// Decision on a candidate.
#[derive(Debug, Clone, PartialEq)]
pub enum Decision {
    /// All conditions hold; the evidence.
    Accepted(TermEvidence),
    /// A condition fails; the reason.
    Refused(String),
    /// The record does not determine the parameters; the reason.
    Undetermined(String),
}

/// A rival: another candidate that might explain as much as an accepted cause.
#[derive(Debug, Clone, PartialEq)]
pub struct Rival {
    /// The rival candidate.
    pub candidate: Candidate,
    /// Fitted values of the rival.
    pub values: Vec<f64>,
    /// Gain in BIC of the accepted cause over the rival.
    pub gap: f64,
    /// Gain of the accepted cause over the rival in twice the log-likelihood, without a penalty for
    /// parameters.
    pub ratio: f64,
    /// Cosine of the angle between the two signatures.
    pub kappa: f64,
    /// Squared norms of the whitened signatures of the accepted cause and of the rival.
    pub detectabilities: [f64; 2],
}

/// Decides whether a fitted candidate passes all conditions.
pub fn decide(model: &Model<'_, '_>, fit: &Fit, alternative: &Alternative, hypotheses: usize) -> Decision {
    let refuse = |why: String| Decision::Refused(why);
    let k = alternative.candidate.tunables.len();
    let delta_bic = alternative.delta_bic;
    if delta_bic < MIN_BIC_GAIN {
        return refuse(match delta_bic {
            d if d <= 0.0 => "it does not improve BIC".into(),
            d => format!("it gains {d:.1} in BIC; at least {MIN_BIC_GAIN:.0} is required"),
        });
    }
    let Some(optimum) = &alternative.optimum else {
        return refuse("other candidates explain more".into());
    };
    // Where an effect was absorbed as coloured noise, the noise model has parameters that it does not need
    // beside the effect: their cost in BIC counts as it does in the choice of the model order.
    let worth = delta_bic + k as f64 * (fit.profile.rows as f64).ln();
    let chance = chi_square_tail(alternative.ratio.max(worth), k as f64);
    let p_value = (chance * alternative.candidate.looks * hypotheses as f64).min(1.0);
    if p_value >= MAX_P_VALUE {
        return refuse(format!("not significant: p = {p_value:.2} after correction for multiple tests"));
    }
    let Some((whole, extended)) = alternative.whole(model, fit) else {
        return Decision::Undetermined("no confidence interval: a sensitivity cannot be simulated".into());
    };
    let covariance = match whole.covariance(&extended) {
        Ok(covariance) => covariance,
        Err(why) => {
            return Decision::Undetermined(format!("no confidence interval: {why}"));
        }
    };
    if let Err(why) = is_determined(&alternative.candidate, optimum, &covariance) {
        return Decision::Undetermined(why);
    }
    let heldout = held_out_gain((model, fit), (&whole, &extended));
    if heldout <= MIN_HELD_OUT_SIGMAS {
        return refuse(format!(
            "on held-out data it gains {heldout:.1} standard errors; at least 2 is required"
        ));
    }
    if gain_if_zeros_wander(model, fit, &extended, k).is_some_and(|gain| gain < MIN_BIC_GAIN) {
        return Decision::Undetermined("a sensor whose zero wanders explains as much".into());
    }
    let detectability = detectability(model, fit, alternative).unwrap_or(0.0);
    Decision::Accepted(TermEvidence { delta_bic, heldout, p_value, detectability })
}

/// Whether the sizes of a candidate, the last of the values, are determined; the error says which is not.
fn is_determined(candidate: &Candidate, optimum: &Optimum, covariance: &DMatrix<f64>) -> Result<(), String> {
    let k = candidate.tunables.len();
    let from = optimum.values.len() - k;
    for (i, tunable) in candidate.tunables.iter().enumerate().filter(|(_, tunable)| tunable.size) {
        // A value at the end of its range is no optimum and has no interval (Self and Liang 1987): a mode at
        // the limit of damping is not accepted.
        let value = optimum.values[from + i];
        if value == tunable.lower || value == tunable.upper {
            return Err(format!("its {} is at the limit of its range", tunable.name));
        }
        let null = if i + 1 == k { candidate.null } else { 0.0 };
        let size = (value - null).abs();
        let mut variance = covariance[(from + i, from + i)];
        // A record determines the area of a short pulse; its height and duration are correlated.
        if let Some(d) = candidate.tunables.iter().position(|t| t.name == "duration_s") {
            let share = size / optimum.values[from + d].abs().max(f64::MIN_POSITIVE);
            let sign = (value - null).signum();
            let both = covariance[(from + i, from + d)];
            variance += share * share * covariance[(from + d, from + d)] + 2.0 * sign * share * both;
        }
        let error = variance.max(0.0).sqrt();
        if error > MAX_RELATIVE_ERROR * size {
            return Err(format!(
                "its {} has a relative standard error of {:.0} %",
                tunable.name,
                (100.0 * error / size.max(f64::MIN_POSITIVE)).min(999.0)
            ));
        }
    }
    Ok(())
}

/// Gain in BIC where the zeros of all sensors may wander, also of those whose noise is not declared: a cause is weighed
/// against the stochastic level beside which it would be seen (de Jong and Penzer, Diagnosing shocks in time series, 1998).
/// `None` where they may anyway, or the noise is given.
fn gain_if_zeros_wander(model: &Model<'_, '_>, fit: &Fit, extended: &Fit, parameters: usize) -> Option<f64> {
    if fit.profile.noise.given {
        return None;
    }
    let bic = |fit: &Fit, parameters| {
        Noise::fit_wandering(model.free_run.data, &fit.residual).map(|profile| profile.bic(parameters))
    };
    Some(bic(fit, 0)? - bic(extended, parameters)?)
}

/// Signature of a fitted candidate: change of the samples at its values, other values fixed.
fn signature(model: &Model<'_, '_>, candidate: &Candidate, values: &[f64]) -> Option<Vec<f64>> {
    let (others, own) = values.split_at(values.len() - candidate.tunables.len());
    model.change_of(None, others, (candidate, own)).ok()
}

fn detectability(model: &Model<'_, '_>, fit: &Fit, alternative: &Alternative) -> Option<f64> {
    let extended = alternative.optimum.as_ref()?;
    let zero = vec![0.0; fit.residual.len()];
    let score_test = ScoreTest::new(model.free_run.data, &extended.profile.noise, &zero, &fit.columns);
    let s = score_test.signature(&signature(model, &alternative.candidate, &extended.values)?);
    Some(dot(&s, &s))
}

/// Rivals of a candidate among other fitted candidates, with the similarity of their signatures.
pub(crate) fn rivals(
    model: &Model<'_, '_>,
    fit: &Fit,
    own: &Alternative,
    alternatives: &[Surveyed],
) -> Vec<Rival> {
    let Some(extended) = &own.optimum else { return Vec::new() };
    let Some(mine) = signature(model, &own.candidate, &extended.values) else { return Vec::new() };
    let zero = vec![0.0; fit.residual.len()];
    let score_test = ScoreTest::new(model.free_run.data, &extended.profile.noise, &zero, &fit.columns);
    let mine = score_test.signature(&mine);
    let name = own.candidate.name();
    let others = alternatives.iter().filter(|t| t.candidate.name() != name);
    let mut rivals: Vec<Rival> = others
        .filter_map(|t| {
            let values = t.values.as_ref()?;
            let theirs = score_test.signature(&signature(model, &t.candidate, values)?);
            Some(Rival {
                values: values[values.len() - t.candidate.tunables.len()..].to_vec(),
                candidate: t.candidate.clone(),
                gap: own.delta_bic - t.delta_bic,
                ratio: own.ratio - t.ratio,
                kappa: cosine(&mine, &theirs).abs(),
                detectabilities: [dot(&mine, &mine), dot(&theirs, &theirs)],
            })
        })
        .collect();
    rivals.sort_by(|a, b| a.gap.total_cmp(&b.gap));
    rivals
}

impl Rival {
    /// True when the rival explains as much, has another signature, and the record would have shown the
    /// accepted cause to be better if it were the truth: then neither is accepted.
    pub fn excludes(&self) -> bool {
        self.is_as_good() && self.cox(self.ratio, self.detectabilities[0]) < -COX_QUANTILE
    }

    /// True when the record cannot distinguish the rival from the accepted cause; the simpler one is
    /// preferred, not proven.
    pub fn indistinguishable(&self) -> bool {
        let same = self.kappa > SAME_SIGNATURE_COSINE && self.gap.min(self.ratio) < RIVAL_BIC;
        let shown = self.cox(-self.ratio, self.detectabilities[1]) < -COX_QUANTILE;
        same || self.is_as_good() && !self.excludes() && !shown
    }

    /// True when the rival explains as much of the same and has another signature. What has nothing in common with the
    /// cause explains something else.
    pub fn is_as_good(&self) -> bool {
        self.gap < UNDECIDED_BIC && (COMMON_COSINE..=SAME_SIGNATURE_COSINE).contains(&self.kappa)
    }

    /// Cox's test of separate families (1961): excess of twice the log-likelihood ratio of one of the two
    /// over the other beyond its mean under the first, in standard deviations. For signatures at an angle and
    /// Gaussian noise, the mean is the squared distance of the one signature from the other's direction, and
    /// the variance four times that.
    fn cox(&self, ratio: f64, detectability: f64) -> f64 {
        let apart = (1.0 - self.kappa * self.kappa) * detectability;
        (ratio - apart) / (2.0 * apart.sqrt()).max(f64::MIN_POSITIVE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Kind;

    fn rival(detectability: f64, kappa: f64, ratio: f64) -> Rival {
        let candidate = Candidate::bare(Kind::InputDelay, "u");
        Rival { candidate, values: Vec::new(), gap: ratio, ratio, kappa, detectabilities: [detectability; 2] }
    }

    #[test]
    fn of_two_that_explain_the_same_a_short_record_tells_neither_and_a_long_one_excludes_both() {
        let short = rival(40.0, 0.8, 1.0);
        assert!(!short.excludes() && short.indistinguishable());
        let long = rival(4000.0, 0.8, 1.0);
        assert!(long.excludes() && !long.indistinguishable());
    }

    /// A mode on roll and one on pitch excluded each other: "similarity of signatures 0.00".
    #[test]
    fn what_explains_something_else_is_no_rival() {
        let elsewhere = rival(4000.0, 0.05, 1.0);
        assert!(!elsewhere.is_as_good() && !elsewhere.excludes() && !elsewhere.indistinguishable());
        assert!(rival(4000.0, 0.15, 1.0).is_as_good());
    }

    #[test]
    fn a_rival_that_explains_less_is_told_apart() {
        let less = rival(400.0, 0.8, 140.0);
        assert!(!less.excludes() && !less.indistinguishable());
    }
}
