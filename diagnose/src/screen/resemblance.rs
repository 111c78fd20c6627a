//! Resemblance of a record to the vehicle: whether some output is predicted better than by its mean and by
//! its last value.
//!
//! Predictions over several horizons follow the record until they begin, so that they are meaningful in a
//! closed loop and for an integrating vehicle; a free run is tested as well. Their squared errors are
//! compared with those of the better of mean and last value by block means (Diebold and Mariano 1995): a
//! block is twice as long as the horizon, over which errors are correlated. Where the commands matter,
//! predictions without future commands are tested too.

use whirlstand_logs::stats::mean;
use whirlstand_vehicle::{Effect, Kind, Vehicle};

use crate::answer::schema::{DataFinding, short};
use crate::data::record::{Channel, Data};
use crate::model::predictor::with_forces;
use crate::model::predictor::{default_horizon_s, memories};
use crate::screen::predictions::{Asked, Sample, Span, blocks, samples, told_by_commands};
use crate::thresholds::{
    EXCESS_NOISE_RATIO, HORIZON_RECORD_SHARE, LATENESSES_S, LEAST_HORIZON_STEPS, MEMORY_GROWTH,
    MIN_HELD_OUT_SIGMAS,
};

/// Comparison of a channel's predictions with its mean and its last value.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Compared {
    Better,
    Alike,
    Worse,
}

/// Result of comparing a vehicle's predictions with a record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Foresight {
    /// True when some output that is more than the integral of another is predicted better than by its mean
    /// and its last value.
    pub some: bool,
    /// Channels that were judged: those that show more than the integral of another.
    pub judged: Vec<usize>,
    /// Of these, the ones predicted clearly worse than by mean or last value over one horizon, and better over none.
    pub contradicted: Vec<usize>,
}

/// Tests what a vehicle predicts from a step on, over any horizon or by the free run, with future commands or
/// without, by a filter whose memory is the horizon or the most likely one. Where that part is too short, the
/// whole record is used. Unless `all` are asked for, one predicted channel suffices.
///
/// A filter that follows a disturbed vehicle may predict worse than the last value although the vehicle is
/// correct: a channel also counts as predicted where commands, with the gains of the vehicle, make
/// predictions better than everything known without them, with the disturbances held.
pub fn foresight(vehicle: &Vehicle, data: &Data, from: usize, all: bool) -> Foresight {
    let (judged, horizons) = (judged(vehicle, data), horizons(vehicle, data));
    let mut compared: Vec<Standing> = judged.iter().map(|_| Standing::default()).collect();
    let mut spans = Span::all(&horizons, data.period_s, None);
    if data.memory_s.is_none() {
        spans.reverse();
    }
    let is_enough = |compared: &[Standing]| {
        let mut better = compared.iter().map(Standing::is_better);
        if all { better.all(|b| b) } else { better.any(|b| b) }
    };
    let mut compare = |spans: &[Span]| {
        for span in spans {
            let Some(predicted) = span.predicted(vehicle, data) else { continue };
            for (standing, c) in compared.iter_mut().zip(&judged) {
                let channel = &data.channels[*c];
                standing.add(
                    channel,
                    samples(channel, data, &predicted[data.ranges()[*c].clone()], *span),
                    *span,
                    from,
                );
            }
            if is_enough(&compared) {
                return true;
            }
        }
        false
    };
    let mut likeliest = None;
    if !compare(&spans) {
        likeliest = memories(vehicle, data).first().map(|likeliest| likeliest.seconds);
        if let Some(memory_s) = likeliest {
            compare(&Span::all(&horizons, data.period_s, Some(memory_s)));
        }
    }
    let which = |is: &dyn Fn(&Standing) -> bool| -> Vec<usize> {
        judged.iter().zip(&compared).filter(|(_, s)| is(s)).map(|(c, _)| *c).collect()
    };
    let mut found = Foresight {
        some: compared.iter().any(Standing::is_better),
        contradicted: which(&|s| s.is_contradicted()),
        judged: judged.clone(),
    };
    let open = if found.some { found.contradicted.clone() } else { judged };
    if (!found.some || all) && !open.is_empty() {
        ask_the_commands(vehicle, data, (&open, likeliest, from), &mut found, all);
    }
    found
}

/// Counts open channels whose predictions improve with the commands as predicted, and removes them from
/// `contradicted`.
fn ask_the_commands(
    vehicle: &Vehicle,
    data: &Data,
    (open, likeliest, from): (&[usize], Option<f64>, usize),
    found: &mut Foresight,
    all: bool,
) {
    // The time scale of the response to commands does not follow from the poles alone: integrators have no
    // time constant.
    let longest = HORIZON_RECORD_SHARE * data.duration_s() / data.period_s;
    let horizons = up_to(longest as usize);
    let mut spans = Span::all(&horizons, data.period_s, None);
    spans.extend(likeliest.into_iter().flat_map(|s| Span::all(&horizons, data.period_s, Some(s))));
    let asked = (Asked::Improves, from, (spans.len() * open.len()) as f64);
    let forced = with_forces(vehicle);
    for span in &spans {
        let told = told_by_commands(&forced, data, open, *span, asked);
        found.some |= !told.is_empty();
        found.contradicted.retain(|c| !told.contains(c));
        if found.some && (!all || found.contradicted.is_empty()) {
            return;
        }
    }
}

/// Comparisons of a channel's predictions with its mean and its last value, over all spans.
#[derive(Debug, Clone, Copy, Default)]
struct Standing {
    /// On the judged part: better over some span, worse over some span.
    late: (bool, bool),
    /// On the whole record, which counts where the judged part is too short.
    whole: (bool, bool),
    is_told: bool,
}

impl Standing {
    fn add(&mut self, channel: &Channel, all: Vec<Sample>, span: Span, from: usize) {
        let late: Vec<Sample> = all.iter().copied().filter(|s| s.step >= from).collect();
        let take = |(better, worse): &mut (bool, bool), gain: f64| {
            *better |= gain > MIN_HELD_OUT_SIGMAS;
            *worse |= gain < -MIN_HELD_OUT_SIGMAS;
        };
        if let Some(gain) = gain(channel, late, span) {
            self.is_told = true;
            take(&mut self.late, gain);
        }
        if let Some(gain) = gain(channel, all, span) {
            take(&mut self.whole, gain);
        }
    }

    fn counts(&self) -> (bool, bool) {
        if self.is_told { self.late } else { self.whole }
    }

    fn is_better(&self) -> bool {
        self.counts().0
    }

    fn is_contradicted(&self) -> bool {
        !self.counts().0 && self.counts().1
    }
}

/// Finding that the record is not of the vehicle: every output that is more than the integral of another is
/// predicted no better than by its mean or its last value, over any horizon and by the free run, and clearly
/// worse over one of them. A cause may have this effect on a record of the vehicle: it is refused only where
/// the commands explain none of it, and clearly less than the vehicle's response, with any delay and in any
/// of the `modes`.
pub(super) fn stranger(vehicle: &Vehicle, modes: &[Vehicle], data: &Data) -> Option<DataFinding> {
    let judged = judged(vehicle, data);
    let (horizons, spans) = spans(vehicle, data);
    let mut worse = vec![false; data.channels.len()];
    for span in &spans {
        for (c, compared) in compare(vehicle, data, &judged, *span) {
            match compared {
                Compared::Better => return None,
                Compared::Worse => worse[c] = true,
                Compared::Alike => {}
            }
        }
    }
    if judged.is_empty() || !judged.iter().all(|c| worse[*c]) {
        return None;
    }
    let late = LATENESSES_S.iter().filter_map(|delay_s| {
        let mut late = vehicle.clone();
        for input in &vehicle.inputs {
            let effect = Effect::new(Kind::InputDelay, &input.name, &[("delay_s", *delay_s)]);
            late.add_effect(effect.ok()?).ok()?;
        }
        Some(late)
    });
    let others: Vec<Vehicle> =
        std::iter::once(vehicle.clone()).chain(modes.iter().cloned()).chain(late).collect();
    let looks = (others.len() * spans.len() * judged.len()) as f64;
    let told = |asked: Asked, other: &Vehicle, span: &Span| {
        !told_by_commands(other, data, &judged, *span, (asked, 0, looks)).is_empty()
    };
    let reach = (horizons[0], horizons[horizons.len() - 1]);
    // In a closed loop the commands oppose the disturbances: these are estimated and held as well.
    let lacks = |other: &Vehicle| {
        let forced = with_forces(other);
        spans.iter().any(|span| span.is_foresight() && told(Asked::Lacks, &forced, span))
    };
    let is_foreign =
        |other: &Vehicle| !spans.iter().any(|span| told(Asked::Tells, other, span)) && lacks(other);
    others.iter().all(is_foreign).then(|| finding(vehicle, data, &judged, reach))
}

/// Horizons over which predictions are compared, steps, the longest last, and the predictions to make.
fn spans(vehicle: &Vehicle, data: &Data) -> (Vec<usize>, Vec<Span>) {
    let horizons = horizons(vehicle, data);
    let spans = Span::all(&horizons, data.period_s, None);
    (horizons, spans)
}

/// Comparison of the judged channels' predictions; empty where the vehicle has no prediction.
fn compare(vehicle: &Vehicle, data: &Data, judged: &[usize], span: Span) -> Vec<(usize, Compared)> {
    let Some(predicted) = span.predicted(vehicle, data) else { return Vec::new() };
    let ranges = data.ranges().into_iter().enumerate().filter(|(c, _)| judged.contains(c));
    let of = |(c, range): (usize, std::ops::Range<usize>)| {
        let channel = &data.channels[c];
        Some((c, compared(channel, samples(channel, data, &predicted[range], span), span)?))
    };
    ranges.filter_map(of).collect()
}

fn finding(vehicle: &Vehicle, data: &Data, judged: &[usize], horizons: (usize, usize)) -> DataFinding {
    let name = |c: &usize| vehicle.outputs[data.channels[*c].output].name.as_str();
    let names: Vec<&str> = judged.iter().map(name).collect();
    let seconds = |steps: usize| short(steps as f64 * data.period_s);
    let text = format!(
        "the record does not match {}: predictions {} to {} s ahead, from the commands and past measurements, are no better than the mean or the last value for any output ({}). Check that the vehicle file and the input columns belong to this flight; if they do, identify the vehicle from the record first (whirlstand identify)",
        vehicle.name,
        seconds(horizons.0),
        seconds(horizons.1),
        names.join(", ")
    );
    DataFinding { kind: "vehicle".into(), place: names.join(","), text, blocking: true }
}

/// Channels that show more than the integral of what another one shows, which any vehicle predicts; all channels,
/// where there are no others. A rate whose derivative nothing measures is no such integral.
fn judged(vehicle: &Vehicle, data: &Data) -> Vec<usize> {
    let all = 0..data.channels.len();
    let is_integral = |c: usize| all.clone().any(|of| integrates(vehicle, data, (c, of)));
    let forces: Vec<usize> = all.clone().filter(|c| !is_integral(*c)).collect();
    if forces.is_empty() { all.collect() } else { forces }
}

/// True when a channel shows nothing but the integral of a state that the other one shows.
pub(super) fn integrates(vehicle: &Vehicle, data: &Data, (channel, of): (usize, usize)) -> bool {
    let shows = |c: usize, state: usize| vehicle.c[(data.channels[c].output, state)] != 0.0;
    let mut shown = (0..vehicle.states.len()).filter(|state| shows(channel, *state));
    let derivative = shown.next().and_then(|state| vehicle.kinematic_row(state));
    derivative.is_some_and(|(state, _)| shows(of, state)) && shown.next().is_none()
}

/// Horizons up to the default horizon, steps.
fn horizons(vehicle: &Vehicle, data: &Data) -> Vec<usize> {
    let longest = ((default_horizon_s(vehicle, data, None) / data.period_s).round() as usize).max(1);
    up_to(longest)
}

/// Horizons up to the longest, steps.
fn up_to(longest: usize) -> Vec<usize> {
    let horizons =
        std::iter::successors(Some(LEAST_HORIZON_STEPS as usize), |h| Some(MEMORY_GROWTH as usize * h));
    horizons.take_while(|h| *h < longest).chain([longest.max(1)]).collect()
}

/// Compares predictions of a channel with its mean and its last value; `None` for too few samples.
fn compared(channel: &Channel, samples: Vec<Sample>, span: Span) -> Option<Compared> {
    Some(match gain(channel, samples, span)? {
        t if t > MIN_HELD_OUT_SIGMAS => Compared::Better,
        t if t < -MIN_HELD_OUT_SIGMAS => Compared::Worse,
        _ => Compared::Alike,
    })
}

/// Improvement of a channel's predictions over the better of its mean and its last value, in standard errors;
/// infinite where errors stay within the declared noise; `None` for too few samples.
fn gain(channel: &Channel, samples: Vec<Sample>, span: Span) -> Option<f64> {
    let level = mean(&samples.iter().map(|s| s.measured).collect::<Vec<_>>());
    let power = |error: &dyn Fn(&Sample) -> f64| samples.iter().map(|s| error(s).powi(2)).sum::<f64>();
    // Errors within the declared noise are as small as possible.
    if power(&|s| s.measured - s.predicted)
        <= samples.len() as f64 * (EXCESS_NOISE_RATIO * channel.declared).powi(2)
        && !samples.is_empty()
    {
        return Some(f64::INFINITY);
    }
    let last_is_better =
        span.horizon.is_some() && power(&|s| s.measured - s.last) < power(&|s| s.measured - level);
    let base = |s: &Sample| if last_is_better { s.last } else { level };
    // A free run may have a constant offset.
    let predicted = mean(&samples.iter().map(|s| s.predicted).collect::<Vec<_>>());
    let offset = if span.horizon.is_none() { level - predicted } else { 0.0 };
    let gain = |s: &Sample| (s.measured - base(s)).powi(2) - (s.measured - s.predicted - offset).powi(2);
    Some(blocks(&samples, span, gain)?.0)
}
