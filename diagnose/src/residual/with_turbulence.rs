//! Causes beside turbulence: separates what each of the two explains.
//!
//! Turbulence moves all channels that depend on its state, so that noise models of single channels count each
//! gust several times, and find events in it. Where a residual looks turbulent, the causes are therefore
//! selected again under a joint noise model of all channels, and the turbulence is re-estimated beside them.

use crate::thresholds::{
    CIRCULAR_SHIFTS, FORCE_SHARE_OF_TURBULENCE, MIN_TURBULENCE_BIC, RELATED_SIGMAS, SETTLED_SIZE_RATIO,
    TURBULENCE_PASSES,
};

use crate::candidates::library::Candidate;
use crate::data::record::Data;
use crate::model::fit::Model;
use crate::model::noise::Noise;
use crate::residual::axis::Axis;
use crate::residual::comparison::{Comparison, ForceOnSignal};
use crate::residual::out_of_library;
use crate::residual::turbulence::{Turbulence, turbulence};
use crate::search::alternative::SearchSpace;
use crate::search::select::select;
use crate::search::selection::Selection;
use whirlstand_logs::stats::{mean, rms};

/// The causes with turbulence beside them, where that is more likely than `selection` alone; else `None`, and
/// `selection` stands. Also a force that follows a signal, where it is more likely than turbulence, with its
/// gain over the causes.
pub(crate) fn with_turbulence<'r, 'd>(
    selection: &Selection<'r, 'd>,
    model: &Model<'r, 'd>,
    space: &SearchSpace<'_>,
) -> (Option<Selection<'r, 'd>>, Option<Turbulence>, Option<ForceOnSignal>) {
    let data = model.free_run.data;
    let alone = plain_bic(selection, data);
    let (chosen, found) = match in_turns(selection, model, space) {
        Sought::Nothing => return (None, None, None),
        Sought::Trace(chosen) => return (single(selection, chosen, alone), None, None),
        Sought::Beside(chosen, found) => (chosen, found),
    };
    let Some(mut chosen) = chosen else {
        // Where only an approximate likelihood is available, the causes are those found without turbulence.
        let known = found.is_known(data);
        return (None, known.then_some(found), None);
    };
    if !found.is_known(data) || plain_bic(&chosen, data) - found.delta_bic > alone - MIN_TURBULENCE_BIC {
        return (None, None, None);
    }
    let Some(noise) = noise_with(&found, &chosen) else { return (None, None, None) };
    let more = |by: ForceOnSignal| ForceOnSignal { gain: by.gain + alone - plain_bic(&chosen, data), ..by };
    let forced = out_of_library::on_state(&chosen.model, &chosen.fit, found.state, space);
    if let Some(by) = forced.filter(|by| by.gain > FORCE_SHARE_OF_TURBULENCE * found.delta_bic) {
        return (None, None, Some(more(by)).filter(|by| by.gain > MIN_TURBULENCE_BIC));
    }
    if let Some(by) =
        out_of_library::beyond_turbulence((&chosen.model, &chosen.fit), found.state, &noise, space)
    {
        let gain = by.gain + found.delta_bic;
        return (None, None, Some(more(ForceOnSignal { gain, ..by })));
    }
    if related(data, &noise, &chosen) || is_device_error(&chosen, &found, space) {
        return (None, None, None);
    }
    if let Ok(fit) = chosen.model.fit(chosen.fit.values.clone(), Some(&noise), None) {
        chosen.fit = fit;
    }
    (Some(chosen), Some(found), None)
}

/// What a search for causes and turbulence in turns comes to.
enum Sought<'r, 'd> {
    /// The residual does not look turbulent.
    Nothing,
    /// Beside these causes it no longer does.
    Trace(Selection<'r, 'd>),
    /// Turbulence, and the causes that were found beside it; `None` where none could be searched for.
    Beside(Option<Selection<'r, 'd>>, Turbulence),
}

/// Searches for causes beside turbulence, and for turbulence beside the causes, until both stay as they are.
fn in_turns<'r, 'd>(
    selection: &Selection<'r, 'd>,
    model: &Model<'r, 'd>,
    space: &SearchSpace<'_>,
) -> Sought<'r, 'd> {
    let look = |s: &Selection<'r, 'd>| {
        turbulence(&s.model, &s.fit.values, &s.fit.residual).filter(|t| t.delta_bic > MIN_TURBULENCE_BIC)
    };
    // Gusts that were taken for single events hide part of the turbulence.
    let calm = without_gusts(selection, None);
    let first = look(selection).or_else(|| calm.as_ref().and_then(look));
    let Some(mut found) = first else { return Sought::Nothing };
    let mut chosen: Option<Selection<'r, 'd>> = None;
    for _ in 0..TURBULENCE_PASSES {
        let last = chosen.as_ref().or(calm.as_ref()).unwrap_or(selection);
        let Some(noise) = noise_with(&found, last) else { break };
        let Ok(next) = select(model.clone(), space, Some(&noise), &[]) else { break };
        let next = without_gusts(&next, Some(found.state)).unwrap_or(next);
        // The same causes leave the same turbulence, whether or not the search for its size succeeds again.
        let names = |s: &Selection<'r, 'd>| s.model.terms.iter().map(Candidate::name).collect::<Vec<_>>();
        let alike = names(&next) == names(last);
        let again = look(&next);
        if again.is_none() && !alike {
            return Sought::Trace(next);
        }
        chosen = Some(next);
        let Some(again) = again else { break };
        let same =
            again.state == found.state && (again.std.0 / found.std.0).ln().abs() < SETTLED_SIZE_RATIO.ln();
        found = again;
        if same {
            break;
        }
    }
    Sought::Beside(chosen, found)
}

/// The joint noise model of all channels with this turbulence, beside the causes of a selection.
fn noise_with(found: &Turbulence, selection: &Selection<'_, '_>) -> Option<Noise> {
    let vehicle = selection.model.vehicle(&selection.fit.values).ok()?;
    found.noise(selection.model.free_run.data, &vehicle, &selection.fit.residual)
}

/// The same causes without disturbances, on one state or on all, refitted; `None` when there are none. A gust
/// is part of the turbulence of its state.
fn without_gusts<'r, 'd>(selection: &Selection<'r, 'd>, state: Option<usize>) -> Option<Selection<'r, 'd>> {
    let place = state.map(|s| selection.model.free_run.vehicle.states[s].name.as_str());
    let gust = |c: &Candidate| c.is_gust() && place.is_none_or(|p| c.place == p);
    selection.model.terms.iter().any(gust).then_some(())?;
    let mut calm = selection.clone();
    calm.keep(|c| !gust(c));
    calm.fit = calm.model.fit(calm.fit.values.clone(), selection.fit.profile.noise.shared(), None).ok()?;
    Some(calm)
}

/// The causes found beside the turbulence, refitted without it, where they are more likely than `selection`:
/// the turbulence was then only their trace.
fn single<'r, 'd>(
    selection: &Selection<'r, 'd>,
    mut chosen: Selection<'r, 'd>,
    alone: f64,
) -> Option<Selection<'r, 'd>> {
    let fit = chosen.model.fit(chosen.fit.values.clone(), None, None).ok()?;
    let bic = fit.profile.bic(chosen.model.parameters());
    chosen.fit = fit;
    chosen.null = selection.null.clone();
    (bic < alone - MIN_TURBULENCE_BIC && !chosen.model.terms.is_empty()).then_some(chosen)
}

/// BIC with noise models of single channels.
fn plain_bic(selection: &Selection<'_, '_>, data: &Data) -> f64 {
    Noise::fit(data, &selection.fit.residual).bic(selection.model.parameters())
}

/// True where one error of an actuator or a sensor explains as much as turbulence and the causes on its part of the vehicle
/// together: what the causes leave of it looks random.
fn is_device_error(selection: &Selection<'_, '_>, found: &Turbulence, space: &SearchSpace<'_>) -> bool {
    let data = selection.model.free_run.data;
    let part = Axis::all(selection).into_iter().find(|axis| axis.states.contains(&found.state));
    let error = part.and_then(|axis| {
        let without = selection.without(&axis.terms, &[])?;
        let own = plain_bic(&without, data) - plain_bic(selection, data);
        let vehicle = without.model.vehicle(&without.fit.values).ok()?;
        let comparison = Comparison::new(&without.model, &without.fit, &vehicle, space);
        Some(comparison.error_of_device(&axis)?.0.gain - own)
    });
    error.is_some_and(|gain| gain > found.delta_bic)
}

/// True when the turbulence is larger where a command or an output is larger: it is then caused by the
/// vehicle.
fn related(data: &Data, noise: &Noise, selection: &Selection<'_, '_>) -> bool {
    let Some(common) = &noise.common else { return false };
    let states = selection.model.free_run.states();
    let gust: Vec<f64> = common.states(data, &selection.fit.residual, states).iter().map(|w| w * w).collect();
    let square = |v: &mut dyn Iterator<Item = f64>| v.map(|v| v * v).collect::<Vec<f64>>();
    let mut features: Vec<Vec<f64>> = (0..data.m).map(|j| square(&mut data.input(j))).collect();
    features
        .extend(data.ranges().into_iter().map(|r| square(&mut selection.fit.predicted[r].iter().copied())));
    features.iter().any(|f| correlation_in_sigmas(&gust, f) > RELATED_SIGMAS)
}

/// Correlation of two sequences in standard deviations of its values under circular time shifts.
fn correlation_in_sigmas(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    if n < 2 * CIRCULAR_SHIFTS {
        return 0.0;
    }
    let centred = |v: &[f64]| {
        let m = mean(&v[..n]);
        v[..n].iter().map(|x| x - m).collect::<Vec<f64>>()
    };
    let (a, b) = (centred(a), centred(b));
    let at = |shift: usize| -> f64 {
        let (head, tail) = b.split_at(shift);
        crate::model::columns::dot(&a[..n - shift], tail) + crate::model::columns::dot(&a[n - shift..], head)
    };
    let shifted: Vec<f64> = (1..=CIRCULAR_SHIFTS).map(|i| at(i * (n - 1) / (CIRCULAR_SHIFTS + 1))).collect();
    let spread = rms(&shifted);
    if spread > 0.0 { at(0) / spread } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::correlation_in_sigmas;
    use whirlstand_vehicle::Stream;

    fn slow(seed: u64, n: usize) -> Vec<f64> {
        let mut stream = Stream::new(seed, "slow");
        let mut x = 0.0;
        (0..n)
            .map(|_| {
                x = 0.98 * x + stream.normal();
                x
            })
            .collect()
    }

    #[test]
    fn sequences_of_their_own_are_not_related_however_slow() {
        let far = (0..20)
            .filter(|s| correlation_in_sigmas(&slow(*s, 6000), &slow(100 + s, 6000)).abs() > 4.0)
            .count();
        assert_eq!(far, 0, "of 20 pairs");
    }

    #[test]
    fn a_sequence_that_follows_another_is_related() {
        let (a, own) = (slow(1, 6000), slow(2, 6000));
        let b: Vec<f64> = a.iter().zip(&own).map(|(a, o)| a + o).collect();
        assert!(correlation_in_sigmas(&a, &b) > 4.5);
    }
}
