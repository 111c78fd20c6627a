//! What is outside the library: tests whether apparent turbulence is a force that is a function of inputs and states of a
//! shape that the table does not name, and what such a force, or error of a device, explains where no cause is named.
//!
//! Turbulence explains any slow force, as it has one value per step, and several causes together can imitate
//! a force that is none of them. A force that follows a signal has few parameters: where these explain as
//! much in BIC, the causes are not credible.

use crate::thresholds::{FORCE_P_VALUE, MIN_BIC_GAIN};

use crate::model::fit::{Fit, Model};
use crate::model::forced_response::Forces;
use crate::model::input_reconstruction::Entry;
use crate::model::noise::Noise;
use crate::model::score_test::ScoreTest;
use crate::residual::axis::Axis;
use crate::residual::basis::Signals;
use crate::residual::comparison::{Comparison, ForceOnSignal, explained, likelier, on};
use crate::residual::hysteresis_relay;
use crate::search::alternative::SearchSpace;
use whirlstand_logs::stats::chi_square_tail;

/// The most likely force on a state, relative to a fit under noise models of single channels.
///
/// `None` when no basis could be tested.
pub fn on_state(
    model: &Model<'_, '_>,
    fit: &Fit,
    state: usize,
    space: &SearchSpace<'_>,
) -> Option<ForceOnSignal> {
    let vehicle = model.vehicle(&fit.values).ok()?;
    let signals =
        Signals::new(model, model.free_run.run_states(&vehicle, &fit.values[..model.states()]).ok()?);
    Comparison::new(model, fit, &vehicle, space)
        .best(Entry::State(state), signals.all())
        .map(|(force, _)| force)
}

/// A force on the state that turbulence drives, where it follows a state so closely that no turbulence does:
/// it switches with a state, or is a periodic function of one. Its gain is the score in excess of that of
/// turbulence alone.
///
/// The states are those that the turbulence's filter predicts from earlier samples, so that a function of
/// them is independent of later innovations: under turbulence alone the score is chi-square.
pub fn beyond_turbulence(
    (model, fit): (&Model<'_, '_>, &Fit),
    state: usize,
    noise: &Noise,
    space: &SearchSpace<'_>,
) -> Option<ForceOnSignal> {
    let data = model.free_run.data;
    let common = noise.common.as_ref()?;
    let vehicle = model.vehicle(&fit.values).ok()?;
    let mut states = model.free_run.run_states(&vehicle, &fit.values[..model.states()]).ok()?;
    for (i, x) in states.iter_mut().enumerate() {
        let foretold = common.states(data, &fit.residual, i);
        x.iter_mut().skip(1).zip(foretold).for_each(|(x, moved)| *x += moved);
    }
    let signals = Signals::new(model, states);
    let score_test = ScoreTest::new(data, noise, &fit.residual, &fit.columns);
    let pushed = [(state, space.sizes.slopes[state])];
    let forces = Forces::new(model, fit, &vehicle, &pushed);
    let relay = hysteresis_relay::likeliest(&score_test, &forces, &signals.states, false)?;
    let ripples = signals.ripples();
    let functions: Vec<&[f64]> = ripples.iter().flat_map(|f| &f.functions).map(Vec::as_slice).collect();
    let mut responses = forces.each(&functions, |_, index, mut response| {
        data.fill(&mut response);
        (index, response)
    });
    responses.sort_by_key(|(index, _)| *index);
    // Two functions (sine and cosine) form one sinusoid.
    let pairs = responses.chunk_by(|(a, _), (b, _)| a / 2 == b / 2).filter(|pair| pair.len() == 2);
    let waves = pairs.filter_map(|pair| {
        let columns: Vec<Vec<f64>> = pair.iter().map(|(_, response)| response.clone()).collect();
        Some((explained(&score_test, &columns)?.0, &ripples[pair[0].0 / 2].description))
    });
    let wave = waves.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let looks = (signals.states.len() * hysteresis_relay::looks() + ripples.len()) as f64;
    let (switched, waved) = (chi_square_tail(relay.score, 1.0), chi_square_tail(wave.0, 2.0));
    let (score, description) = if switched < waved {
        (relay.score, relay.description(&signals.states))
    } else {
        (wave.0, wave.1.clone())
    };
    (looks * switched.min(waved) < FORCE_P_VALUE)
        .then(|| ForceOnSignal { gain: score, description: on(&vehicle, Entry::State(state), &description) })
}

/// The most likely force on any state or error of any device, relative to a fit without causes; `None` where none gains.
pub fn anywhere(model: &Model<'_, '_>, fit: &Fit, space: &SearchSpace<'_>) -> Option<ForceOnSignal> {
    let vehicle = model.vehicle(&fit.values).ok()?;
    let comparison = Comparison::new(model, fit, &vehicle, space);
    let whole = Axis::whole(&vehicle, model.free_run.data);
    let all = comparison.force((model, fit), &whole).into_iter().chain(comparison.error_of_device(&whole));
    likelier(all).map(|(by, _)| by).filter(|by| by.gain > MIN_BIC_GAIN)
}
