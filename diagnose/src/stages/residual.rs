//! Residual stage: analyses the residual that the causes leave, and whether the causes are credible.

use super::select::Selected;
use crate::data::outliers::still_wild;
use crate::data::sample_effect::SampleEffect;
use crate::model::fit::{Fit, Model};
use crate::residual::comparison::ForceOnSignal;
use crate::residual::credibility::{Credibility, Withheld};
use crate::residual::excess_noise::{ExcessNoise, beside_a_motion, excess_noise, louder_than_declared};
use crate::residual::lack_of_fit::{LackOfFit, lack_of_fit};
use crate::residual::narrow_band::{NarrowBand, narrow_band};
use crate::residual::out_of_library;
use crate::residual::turbulence::Turbulence;
use crate::residual::with_turbulence::with_turbulence;
use crate::search::alternative::SearchSpace;
use crate::search::selection::Selection;
use crate::stages::baseline::Baseline;
use crate::stages::select::rest_before;
use whirlstand_vehicle::Kind;

/// The credible causes, and random or unexplained components beside them.
#[derive(Debug)]
pub(crate) struct Residual<'r> {
    pub selection: Selection<'r, 'r>,
    pub samples: Vec<SampleEffect>,
    pub turbulence: Option<Turbulence>,
    pub noise: Vec<(usize, ExcessNoise)>,
    /// Spectral lines of varying frequency, which no tone explains.
    pub narrow_band: Vec<NarrowBand>,
    /// Lack of fit of the final residual, compared with chance.
    pub lack: Option<LackOfFit>,
    /// A force that would explain the final residual, or as much as the withdrawn causes.
    pub out_of_library: Option<ForceOnSignal>,
    /// Causes that were found and withdrawn.
    pub withheld: Vec<Withheld>,
    /// States on which a random force acts that is no turbulence.
    pub random_forces: Vec<String>,
    /// True when the causes are likelier with inputs that were at rest before the records.
    pub rest_before: bool,
}

impl<'r> Residual<'r> {
    pub fn new(selected: Selected<'r>) -> Self {
        let Selected { baseline, model, selection: mut alone } = selected;
        let space = baseline.space();
        let (mut beside, mut turbulence, mut force) = (None, None, None);
        let (mut withheld, mut random_forces) = (Vec::new(), Vec::new());
        // A predictor that follows the record already has process noise.
        let follows = baseline.data().memory_s.is_some();
        let watch = space.watch;
        if !baseline.blocked && !follows && !watch.is_stopped() {
            watch.tell("testing for turbulence");
            (withheld, random_forces) =
                credibility(baseline, &space, false).without_random_forces(&mut alone);
            (beside, turbulence, force) = with_turbulence(&alone, &model, &space);
        }
        let chosen = beside.as_ref().unwrap_or(&alone);
        let (mut noise, mut lack) = tested(baseline, chosen, turbulence.is_some());
        if turbulence.is_some() && lack.is_some_and(|lack| lack.is_certain()) {
            // The turbulence was the trace of something else, and the causes chosen beside it depend on it.
            (beside, turbulence) = (None, None);
            (noise, lack) = tested(baseline, &alone, false);
        }
        let mut selection = beside.unwrap_or(alone);
        if let Some(force) = &force {
            lack = lack.map(|lack| LackOfFit::or_one(Some(lack), force.gain));
        }
        let rest_before = baseline.data().held && rest_before(&selection);
        let asked = lack.is_some() || (follows || noise.is_empty()) && !baseline.blocked;
        if asked && !watch.is_stopped() {
            watch.tell("analysing the remaining residual");
            let credibility = credibility(baseline, &space, turbulence.is_some());
            let (incredible, rival) = credibility.withhold(&mut selection, lack);
            withheld.extend(incredible);
            if let Some(rival) = rival {
                lack = Some(LackOfFit::or_one(lack, rival.gain));
                force = Some(rival);
            }
            let fit = &selection.fit;
            let more = lack.is_some_and(|lack| lack.is_significant())
                || !louder_than_declared(baseline.data(), fit, &baseline.sizes.noise).is_empty();
            if selection.model.terms.is_empty() && turbulence.is_none() && more {
                force = force.or_else(|| out_of_library::anywhere(&selection.model, fit, &space));
            }
        }
        let mut samples = baseline.checked.samples.clone();
        still_wild(&mut samples, baseline.data(), baseline.good.clone(), &selection.fit.predicted);
        let narrow_band = if baseline.blocked {
            Vec::new()
        } else {
            narrow_band(&selection.model, &selection.fit.residual)
        };
        let states = &baseline.vehicle().states;
        random_forces.retain(|state| turbulence.as_ref().is_none_or(|t| states[t.state].name != *state));
        let named = !selection.model.terms.is_empty();
        let out_of_library = force.filter(|_| !named || lack.is_some_and(|lack| lack.is_significant()));
        Self {
            selection,
            samples,
            turbulence,
            noise,
            narrow_band,
            lack,
            out_of_library,
            withheld,
            random_forces,
            rest_before,
        }
    }

    /// Takes back the refit of the free parameters of a selection without causes; `false` where the vehicle as given cannot
    /// be fitted.
    pub fn keep_given_values(&mut self, baseline: &Baseline<'_>) -> bool {
        let (model, null) = (&self.selection.model, &self.selection.null);
        let free = model.states()..model.base();
        let given = Model { free: &[], ..model.clone() };
        let Ok(kept) = Selection::nothing(given, null.values[..free.start].to_vec()) else {
            return false;
        };
        let mut refused = std::mem::take(&mut self.selection.refused);
        for values in refused.iter_mut().filter_map(|refused| refused.values.as_mut()) {
            values.drain(free.clone());
        }
        self.selection = Selection { refused, ..kept };
        (self.noise, self.lack) = tested(baseline, &self.selection, self.turbulence.is_some());
        true
    }

    /// Withdraws causes with which the vehicle still predicts nothing, by the held-out fit of each channel, %; `true` when
    /// there are such.
    pub fn withdraw_without_skill(&mut self, baseline: &Baseline<'_>, fits: &[Option<f64>]) -> bool {
        let space = baseline.space();
        let credibility = credibility(baseline, &space, self.turbulence.is_some());
        let withdrawn = credibility.without_skill(&mut self.selection, fits);
        let any = !withdrawn.is_empty();
        self.withheld.extend(withdrawn);
        any
    }
}

/// Tests of the credibility of causes, which start from the baseline.
fn credibility<'s>(baseline: &Baseline<'_>, space: &'s SearchSpace<'s>, turbulent: bool) -> Credibility<'s> {
    Credibility { space, start: baseline.start(), turbulent, rounded: rounded(baseline) }
}

/// Excess noise, and the lack-of-fit test: made only where no noise is in excess. Also the residual under a noise model
/// that is fitted to it must not follow signals (Ljung 1999, 16.6: independence of residuals and past inputs).
fn tested(
    baseline: &Baseline<'_>,
    selection: &Selection<'_, '_>,
    turbulent: bool,
) -> (Vec<(usize, ExcessNoise)>, Option<LackOfFit>) {
    let noise = excess(baseline, &selection.fit, turbulent);
    let follows = baseline.data().memory_s.is_some();
    if baseline.blocked || follows || !noise.is_empty() {
        return (noise, None);
    }
    let lack = lack_of_fit(&selection.model, &selection.fit, &baseline.sizes, &rounded(baseline));
    (noise, lack)
}

/// Channels with rounding errors, which no function of a signal describes.
fn rounded(baseline: &Baseline<'_>) -> Vec<usize> {
    let rounded = baseline.checked.samples.iter().filter(|e| e.kind == Kind::Quantization);
    rounded.map(|e| e.channel).collect()
}

/// Noise beyond the declared one, without coloured noise that turbulence explains. A filter that follows the record leaves
/// motions in the residual.
fn excess(baseline: &Baseline<'_>, fit: &Fit, turbulent: bool) -> Vec<(usize, ExcessNoise)> {
    if turbulent {
        return Vec::new();
    }
    let data = baseline.data();
    let channels = fit.profile.noise.channels.iter().zip(&baseline.declared).enumerate();
    channels
        .filter_map(|(c, (noise, declared))| {
            let found = if data.memory_s.is_some() {
                let own = data.ranges()[c].clone();
                beside_a_motion(&fit.residual[own], &data.channels[c], *declared)
            } else {
                excess_noise(data, &fit.residual, noise, c, *declared)
            };
            Some((c, found?))
        })
        .collect()
}
