//! Credibility of the chosen causes: withdraws them where something simpler explains as much.

use crate::candidates::library::Candidate;
use crate::model::noise::Noise;
use crate::model::score_test::{ScoreTest, cosine};
use crate::residual::lack_of_fit::LackOfFit;
use crate::residual::out_of_library::{self, ForceOnSignal};
use crate::search::alternative::SearchSpace;
use crate::search::selection::Selection;
use crate::thresholds::{EXCESS_NOISE_RATIO, MIN_BIC_GAIN, RIVAL_FORCE_P_VALUE, SAME_SIGNATURE_COSINE};
use whirlstand_logs::stats::rms;

/// Withdraws causes that are not credible, with their gains in BIC. All are withdrawn where one force that
/// follows a signal does better (it is left in `like`) or where they leave more than they explain; else
/// those that are too small for the remaining lack of fit to be just their misfit. `start` are the values
/// without any cause. Turbulence explains part of what causes leave, and is weighed against forces where it
/// is sized. Where the noise is not known, a lack of fit may be the noise model's: then it withdraws only events,
/// which explain a part of anything. Where a filter follows the record, no test tells whether there is one.
pub fn withhold(
    selection: &mut Selection<'_, '_>,
    (lack, like): (&mut Option<LackOfFit>, &mut Option<ForceOnSignal>),
    turbulent: bool,
    start: Vec<f64>,
    space: &SearchSpace<'_>,
) -> Vec<(Candidate, f64)> {
    let Some(without) = selection.without_causes(start) else { return Vec::new() };
    let known = space.declared.iter().all(|d| *d > 0.0);
    let several = selection.model.terms.len() > without.model.terms.len() + 1;
    let chance = |lack: &LackOfFit| lack.one.chance.min(lack.all.chance);
    let asked = several || lack.as_ref().is_none_or(|lack| chance(lack) < RIVAL_FORCE_P_VALUE);
    let rival = if asked && !turbulent { rival(selection, &without, space, (several, known)) } else { None };
    let believed = match (rival, &lack) {
        (Some(rival), _) => {
            *lack = Some(LackOfFit::or_one(*lack, rival.gain));
            *like = Some(rival);
            Some(without)
        }
        (None, None) => None,
        (None, Some(_)) if !turbulent && known && drowned(selection, &without, space.declared) => {
            Some(without)
        }
        (None, Some(lack)) => selection.beyond(lack.left(), |c| known || c.is_event()),
    };
    let Some(believed) = believed else { return Vec::new() };
    let gains = selection.accepted.iter().map(|a| a.evidence.delta_bic);
    let all = selection.model.terms.iter().cloned().zip(gains);
    let taken = all.filter(|(c, _)| !believed.model.terms.contains(c)).collect();
    *selection = believed;
    taken
}

/// One force that follows a signal, where it explains as much as all causes together: several causes must do clearly better,
/// and a single one is preferred to it, because what is in the table is likelier than what is not. A force of the same
/// signature as a single cause is that cause with another shape: friction is a force that switches with a state. Where the
/// noise is not known, a force must gain more than several causes: orders of noise that are estimated beside each differ,
/// and each costs nearly as much as the lead.
fn rival(
    selection: &Selection<'_, '_>,
    without: &Selection<'_, '_>,
    space: &SearchSpace<'_>,
    (several, noise_known): (bool, bool),
) -> Option<ForceOnSignal> {
    let data = selection.model.free_run.data;
    let bic = |s: &Selection<'_, '_>| Noise::fit(data, &s.fit.residual).bic(s.model.parameters());
    let own = bic(without) - bic(selection);
    let lead = match (several, noise_known) {
        (true, true) => -MIN_BIC_GAIN,
        (true, false) => 0.0,
        (false, _) => MIN_BIC_GAIN,
    };
    let (rival, explained) =
        out_of_library::rival((&without.model, &without.fit), (&selection.model, &selection.fit), space)?;
    if rival.gain <= own + lead {
        return None;
    }
    let fit = &selection.fit;
    let score_test = ScoreTest::new(data, &fit.profile.noise, &fit.residual, &without.fit.columns);
    let cause: Vec<f64> = without.fit.residual.iter().zip(&fit.residual).map(|(w, s)| w - s).collect();
    let kappa = cosine(&score_test.project(&cause), &score_test.project(&explained));
    (several || kappa < SAME_SIGNATURE_COSINE).then_some(rival)
}

/// True when the causes leave more beyond the declared noise than they explain: they are then part of another
/// cause.
fn drowned(selection: &Selection<'_, '_>, without: &Selection<'_, '_>, declared: &[f64]) -> bool {
    let (mut left, mut explained) = (0.0, 0.0);
    let data = selection.model.free_run.data;
    for ((channel, range), declared) in data.channels.iter().zip(data.ranges()).zip(declared) {
        let power = |residual: &[f64]| {
            let good = residual[range.clone()].iter().zip(&channel.good).filter(|(_, good)| **good);
            (rms(&good.map(|(r, _)| *r).collect::<Vec<_>>()) / declared).powi(2)
        };
        let (before, after) = (power(&without.fit.residual), power(&selection.fit.residual));
        explained += before - after;
        // Declared noise is correct up to the ratio from which it is a cause of its own.
        left += if after > EXCESS_NOISE_RATIO * EXCESS_NOISE_RATIO { after - 1.0 } else { 0.0 };
    }
    left > explained.max(0.0)
}
