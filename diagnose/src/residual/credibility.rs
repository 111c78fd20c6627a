//! Credibility of the chosen causes: withdraws them where something simpler explains as much.

use crate::candidates::library::Candidate;
use crate::model::noise::Noise;
use crate::model::score_test::{ScoreTest, cosine};
use crate::residual::axis::Axis;
use crate::residual::comparison::{Comparison, ForceOnSignal, likelier};
use crate::residual::lack_of_fit::{LackOfFit, lack_of_fit};
use crate::residual::random_force::random_forces;
use crate::screen::foresight;
use crate::search::alternative::SearchSpace;
use crate::search::selection::Selection;
use crate::thresholds::{
    EXCESS_NOISE_RATIO, MIN_BIC_GAIN, RIDER_SHARE, RIVAL_FORCE_P_VALUE, SAME_SIGNATURE_COSINE,
};
use whirlstand_logs::stats::rms;
use whirlstand_vehicle::Kind;

/// A cause that was found and is not believed.
#[derive(Debug, Clone, PartialEq)]
pub struct Withheld {
    /// The cause.
    pub candidate: Candidate,
    /// Its gain in BIC.
    pub delta_bic: f64,
    /// The reason.
    pub why: String,
}

/// Tests of causes against simpler explanations.
#[derive(Debug, Clone)]
pub struct Credibility<'s> {
    /// Inputs of the search.
    pub space: &'s SearchSpace<'s>,
    /// Initial states and free parameters without any cause.
    pub start: Vec<f64>,
    /// True where turbulence is sized: it explains part of what causes leave, and is weighed against forces there.
    pub turbulent: bool,
    /// Channels that have errors of their own, which say nothing of the causes.
    pub rounded: Vec<usize>,
}

impl Credibility<'_> {
    /// Withdraws causes that are not credible; also gives the force that replaces most of them, if one does. In each
    /// decoupled part of the vehicle, all are withdrawn where one force that follows a signal does better or where they
    /// leave more than they explain; else those that are too small for the remaining lack of fit to be just their misfit.
    /// Where the noise is not known, a lack of fit may be the noise model's: then it withdraws only events, which explain a
    /// part of anything. Where a filter follows the record, no test tells whether there is one. `lack` is that of the whole.
    pub fn withhold(
        &self,
        selection: &mut Selection<'_, '_>,
        lack: Option<LackOfFit>,
    ) -> (Vec<Withheld>, Option<ForceOnSignal>) {
        let (mut dropped, mut rivals) = (Vec::new(), Vec::new());
        for axis in Axis::all(selection) {
            let left = lack.and_then(|lack| self.left_in(selection, &axis, lack));
            let without = selection.without(&axis.terms, &self.start);
            let of_all = || {
                (!axis.tones.is_empty()).then_some(())?;
                let all = [axis.terms.as_slice(), &axis.tones].concat();
                let rival = self.rival(selection, &selection.without(&all, &self.start)?, &axis, left)?;
                Some((all, rival))
            };
            let of_causes =
                || Some((axis.terms.clone(), self.rival(selection, without.as_ref()?, &axis, left)?));
            if let Some((terms, rival)) = of_all().or_else(of_causes) {
                let why = format!("{} explains as much", rival.description);
                dropped.extend(terms.into_iter().map(|term| (term, why.clone())));
                rivals.push(rival);
            } else if let Some((left, without)) = left.zip(without) {
                let why = "the remaining residual is not noise, so it is only part of another effect";
                let part = self.partial(selection, &without, axis, left);
                dropped.extend(part.into_iter().map(|term| (term, why.to_owned())));
            }
        }
        let rival = rivals.into_iter().max_by(|a, b| a.gain.total_cmp(&b.gain));
        (self.withdraw(selection, dropped), rival)
    }

    /// Withdraws the causes of each decoupled part of which every output is predicted, with them, worse than by its mean
    /// over the held-out part, and better over no horizon: where a model has no skill, anything that shrinks its predictions
    /// makes it likelier, such as a small gain or a small sensor scale. `fits` are the channels' held-out fits, %.
    pub fn without_skill(&self, selection: &mut Selection<'_, '_>, fits: &[Option<f64>]) -> Vec<Withheld> {
        let data = selection.model.free_run.data;
        let worse = |c: &usize| fits[*c].is_some_and(|fit| fit < 0.0);
        let axes: Vec<Axis> =
            Axis::all(selection).into_iter().filter(|axis| axis.channels.iter().any(worse)).collect();
        let Ok(vehicle) = selection.model.vehicle(&selection.fit.values) else { return Vec::new() };
        if axes.is_empty() {
            return Vec::new();
        }
        let found = foresight(&vehicle, data, data.held_out_from(), true);
        let mut dropped = Vec::new();
        for axis in axes {
            let judged: Vec<usize> = axis.channels.into_iter().filter(|c| found.judged.contains(c)).collect();
            let without_skill = |c: &usize| worse(c) && found.contradicted.contains(c);
            if judged.is_empty() || !judged.iter().all(without_skill) {
                continue;
            }
            let name = |c: &usize| vehicle.outputs[data.channels[*c].output].name.as_str();
            let why = format!(
                "with it as well, held-out {} is predicted worse than by the mean",
                judged.iter().map(name).collect::<Vec<_>>().join(", ")
            );
            dropped.extend(axis.terms.into_iter().map(|term| (term, why.clone())));
        }
        self.withdraw(selection, dropped)
    }

    /// Withdraws pushes and periodic forces that are terms of a random force; also gives the states on which such act.
    pub fn without_random_forces(&self, selection: &mut Selection<'_, '_>) -> (Vec<Withheld>, Vec<String>) {
        let forces = random_forces(selection);
        let why = |state: &str| {
            format!("with others on {state} that act at the same time, it is no likelier than a random force")
        };
        let dropped =
            forces.iter().flat_map(|force| force.terms.iter().map(|term| (*term, why(&force.state))));
        let withheld = self.withdraw(selection, dropped.collect());
        if withheld.is_empty() {
            return (withheld, Vec::new());
        }
        (withheld, forces.into_iter().map(|force| force.state).collect())
    }

    /// The selection without some terms; they, with the reasons. None where it cannot be fitted without them.
    fn withdraw(&self, selection: &mut Selection<'_, '_>, dropped: Vec<(usize, String)>) -> Vec<Withheld> {
        let (terms, whys): (Vec<usize>, Vec<String>) = dropped.into_iter().unzip();
        let causes = selection.model.terms.iter().filter(|term| term.kind != Kind::Vibration).count();
        let start = if terms.len() == causes { self.start.as_slice() } else { &[] };
        let Some(kept) = selection.without(&terms, start) else { return Vec::new() };
        let withheld = |(term, why): (usize, String)| Withheld {
            candidate: selection.model.terms[term].clone(),
            delta_bic: selection.accepted[term].evidence.delta_bic,
            why,
        };
        let all = terms.into_iter().zip(whys).map(withheld).collect();
        *selection = kept;
        all
    }

    /// The lack of fit of one part of the vehicle, where that of the whole is significant.
    fn left_in(&self, selection: &Selection<'_, '_>, axis: &Axis, lack: LackOfFit) -> Option<LackOfFit> {
        let channels = selection.model.free_run.data.channels.len();
        if axis.channels.len() == channels || !lack.is_significant() {
            return Some(lack);
        }
        let elsewhere = (0..channels).filter(|c| !axis.channels.contains(c) || self.rounded.contains(c));
        lack_of_fit(&selection.model, &selection.fit, self.space.sizes, &elsewhere.collect::<Vec<_>>())
    }

    /// The causes of a part that only explain some of another effect.
    fn partial(
        &self,
        selection: &Selection<'_, '_>,
        without: &Selection<'_, '_>,
        axis: Axis,
        lack: LackOfFit,
    ) -> Vec<usize> {
        let known = self.noise_is_known();
        if !self.turbulent && known && drowned(selection, without, &axis.channels, self.space.declared) {
            return axis.terms;
        }
        let enough =
            |term: usize| RIDER_SHARE * selection.accepted[term].evidence.detectability >= lack.left();
        let asked = |term: usize| known || selection.model.terms[term].is_event();
        axis.terms.into_iter().filter(|term| asked(*term) && !enough(*term)).collect()
    }

    fn noise_is_known(&self) -> bool {
        self.space.declared.iter().all(|declared| *declared > 0.0)
    }

    /// One force that follows a signal, where it explains as much as all causes of a part together: several causes must do
    /// clearly better, and a single one is preferred to it, because what is in the table is likelier than what is not. A
    /// force of the same signature as a single cause is that cause with another shape: friction is a force that switches
    /// with a state. Where the noise is not known, a force must gain more than several causes: orders of noise that are
    /// estimated beside each differ, and each costs nearly as much as the lead.
    fn rival(
        &self,
        selection: &Selection<'_, '_>,
        without: &Selection<'_, '_>,
        axis: &Axis,
        lack: Option<LackOfFit>,
    ) -> Option<ForceOnSignal> {
        let several = selection.model.terms.len() - without.model.terms.len() > 1;
        // Where causes leave nothing but noise, a force outside the table is called for only if it might be what several of
        // them imitate together: those that act on one state, or pushes and periodic forces, of which any force can be made.
        let gust = |term: &usize| selection.model.terms[*term].is_gust();
        let imitates = several && (axis.is_shared || axis.terms.iter().any(gust));
        let chance = |lack: LackOfFit| lack.one.chance.min(lack.all.chance);
        let asked = imitates || lack.is_none_or(|lack| chance(lack) < RIVAL_FORCE_P_VALUE);
        if self.turbulent {
            return None;
        }
        let data = selection.model.free_run.data;
        let bic = |s: &Selection<'_, '_>| Noise::fit(data, &s.fit.residual).bic(s.model.parameters());
        let own = bic(without) - bic(selection);
        let lead = match (several, self.noise_is_known()) {
            (true, true) => -MIN_BIC_GAIN,
            (true, false) => 0.0,
            (false, _) => MIN_BIC_GAIN,
        };
        let vehicle = without.model.vehicle(&without.fit.values).ok()?;
        let comparison = Comparison::new(&without.model, &without.fit, &vehicle, self.space);
        let rivals = if asked {
            let force = comparison.force((&selection.model, &selection.fit), axis);
            [force, comparison.error_of_device(axis)]
        } else {
            [None, comparison.error_of_sensor(&axis.channels)]
        };
        let (rival, explained) = likelier(rivals.into_iter().flatten())?;
        if rival.gain <= own + lead {
            return None;
        }
        let fit = &selection.fit;
        let score_test = ScoreTest::new(data, &fit.profile.noise, &fit.residual, &without.fit.columns);
        let cause: Vec<f64> = without.fit.residual.iter().zip(&fit.residual).map(|(w, s)| w - s).collect();
        let kappa = cosine(&score_test.project(&cause), &score_test.project(&explained));
        (several || kappa < SAME_SIGNATURE_COSINE).then_some(rival)
    }
}

/// True when the causes leave more beyond the declared noise of their channels than they explain: they are then part of
/// another cause.
fn drowned(
    selection: &Selection<'_, '_>,
    without: &Selection<'_, '_>,
    channels: &[usize],
    declared: &[f64],
) -> bool {
    let (mut left, mut explained) = (0.0, 0.0);
    let data = selection.model.free_run.data;
    let ranges = data.ranges();
    for c in channels {
        let (channel, range, declared) = (&data.channels[*c], &ranges[*c], declared[*c]);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidates::library::{Sizes, library};
    use crate::data::flown::flown;
    use crate::model::fit::Model;
    use crate::model::free_run::FreeRun;
    use crate::model::optimum::Optimum;
    use crate::search::acceptance::TermEvidence;
    use crate::search::selection::Accepted;
    use whirlstand_ident::watch::Watch;
    use whirlstand_vehicle::{Effect, Stream, Vehicle};

    /// A vehicle with a roll and a yaw axis of their own.
    fn two_axes() -> Vehicle {
        let text = "A = [[-1.0, 0.0], [0.0, -1.0]]\nB = [[5.0, 0.0], [0.0, 5.0]]\n\
                    states = [{ name = \"roll_rate\" }, { name = \"yaw_rate\" }]\n\
                    inputs = [{ name = \"u_roll\" }, { name = \"u_yaw\" }]\n\
                    outputs = [{ name = \"roll_rate\" }, { name = \"yaw_rate\" }]\n";
        let mut vehicle = Vehicle::parse(text, "axes.toml").unwrap();
        vehicle.outputs.iter_mut().for_each(|output| output.noise = 0.02);
        vehicle
    }

    /// A sensor scale that shrinks predictions makes an axis likelier of which the vehicle predicts nothing: it is not
    /// believed. The gain of the other axis is.
    #[test]
    fn a_cause_with_which_nothing_is_predicted_is_not_believed() {
        let vehicle = two_axes();
        let mut weaker = vehicle.clone();
        weaker.add_effect(Effect::new(Kind::InputGain, "u_yaw", &[("factor", 0.8)]).unwrap()).unwrap();
        let input = |k: usize, j: usize| if k % (70 + 30 * j) < 35 { 0.3 } else { -0.3 };
        let mut data = flown(&weaker, (0..4000).map(|at| input(at / 2, at % 2)).collect(), 5);
        let mut stream = Stream::new(3, "roll_rate");
        data.channels[0].values.iter_mut().for_each(|value| *value = stream.normal());
        let sizes = Sizes::ones(&vehicle, 40.0, 0.02);
        let candidates = library(&vehicle, &sizes, &[0, 1]);
        let term = |kind: Kind, place: &str| {
            candidates.iter().find(|c| c.kind == kind && c.place == place).unwrap().clone()
        };
        let terms = vec![term(Kind::SensorScale, "roll_rate"), term(Kind::InputGain, "u_yaw")];
        let free_run = FreeRun::new(&vehicle, &data);
        let nothing = Model { free_run: &free_run, free: &[], terms: Vec::new() };
        let mut selection = Selection::nothing(nothing, vec![0.0; 2]).unwrap();
        selection.model.terms = terms.clone();
        let optimum = Optimum { values: vec![0.0, 0.0, 0.5, 0.8], profile: selection.fit.profile.clone() };
        selection.fit = selection.model.at(&optimum, &selection.null.columns).unwrap();
        let evidence = TermEvidence { delta_bic: 99.0, heldout: 9.0, p_value: 0.0, detectability: 99.0 };
        selection.accepted = vec![Accepted { evidence, rivals: Vec::new() }; 2];
        let watch = Watch::default();
        let space =
            SearchSpace { library: &candidates, sizes: &sizes, most: 5, declared: &[0.02; 2], watch: &watch };
        let credibility =
            Credibility { space: &space, start: vec![0.0; 2], turbulent: false, rounded: Vec::new() };
        let withheld = credibility.without_skill(&mut selection, &[Some(1.0), Some(90.0)]);
        assert_eq!(withheld, [], "better than the mean");
        let withheld = credibility.without_skill(&mut selection, &[Some(-1.0), Some(90.0)]);
        assert_eq!(withheld.len(), 1, "{withheld:?}");
        assert_eq!((&withheld[0].candidate, &selection.model.terms[..]), (&terms[0], &terms[1..]));
        assert!(withheld[0].why.contains("held-out roll_rate is predicted worse"), "{}", withheld[0].why);
    }
}
