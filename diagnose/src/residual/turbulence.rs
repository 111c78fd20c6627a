//! Turbulence in a residual: random forces shaped by the vehicle's motion, beside sensor noise.

use crate::thresholds::{
    BANDWIDTH_STARTS, CLIMB_PROMISE, COMPLETE_ROWS_SHARE, FAR_ABOVE_NOISE, MAX_TURBULENCE_ERRORS,
    MIN_PERIODS, MIN_TURBULENCE_BIC, PARTIAL_CORRELATION_STARTS, RESONANT_STARTS, SIZE_STARTS,
    SLOW_TURBULENCE_BIC, SLOW_TURBULENCE_ERROR, STARTS_CLIMBED, TURBULENCE_SIZE_SHARES,
    TURBULENCE_STATES_REFINED, UNLIKELY_TURBULENCE_BIC,
};
use std::f64::consts::PI;

use rayon::prelude::*;
use whirlstand_vehicle::Vehicle;

use crate::data::record::Data;
use crate::model::climb::{Maximum, bandwidths_hz, climb};
use crate::model::driven::Driven;
use crate::model::fit::Model;
use crate::model::innovations::{Noises, Whitener};
use crate::model::noise::{Noise, Profile};
use crate::model::whittle::{C, Shaped, cross, responses, whittle};

/// Turbulence on a state, with standard errors.
#[derive(Debug, Clone, PartialEq)]
pub struct Turbulence {
    /// Index of the state.
    pub state: usize,
    /// Standard deviation of the force that it adds to the state's derivative, SI, and its relative standard
    /// error.
    pub std: (f64, f64),
    /// Bandwidth, Hz, and its relative standard error.
    pub bandwidth_hz: (f64, f64),
    /// Relative standard error of the best-determined combination of size and bandwidth.
    pub together: f64,
    /// Gain in BIC over independent coloured noise of every channel.
    pub delta_bic: f64,
    /// Gains in BIC of turbulence on other states: index of the state and gain.
    pub others: Vec<(usize, f64)>,
    /// Parameters of turbulence and channel noise, where the exact likelihood was computed.
    noises: Option<Noises>,
}

impl Turbulence {
    /// True when the record determines the turbulence.
    pub fn is_known(&self, data: &Data) -> bool {
        let (bandwidth, error) = self.bandwidth_hz;
        let periods = bandwidth * data.duration_s();
        let both =
            self.std.1 < MAX_TURBULENCE_ERRORS.0 && error < MAX_TURBULENCE_ERRORS.1 && periods > MIN_PERIODS;
        let together = self.delta_bic > SLOW_TURBULENCE_BIC
            && self.together < MAX_TURBULENCE_ERRORS.0
            && error < SLOW_TURBULENCE_ERROR
            && periods * (1.96 * error).exp() > MIN_PERIODS;
        self.delta_bic > MIN_TURBULENCE_BIC && (both || together) && bandwidth * data.period_s < 0.5
    }

    /// Noise model of turbulence and channel noise together; `None` where only Whittle's likelihood was
    /// computed.
    pub fn noise(&self, data: &Data, vehicle: &Vehicle, residual: &[f64]) -> Option<Noise> {
        let whitener = Whitener::new(data, vehicle, self.state, self.noises.as_ref()?)?;
        Some(Noise::fit(data, residual).noise.with_common(whitener))
    }
}

/// Searches for turbulence on any state in a residual under noise of single channels; returns the most likely
/// one, however small.
///
/// `None` when the record is too short, or the vehicle has no state that turbulence could drive.
pub fn turbulence(model: &Model<'_, '_>, values: &[f64], residual: &[f64]) -> Option<Turbulence> {
    // Values interpolated where one channel has no sample are smoother than measured ones: such rows do not
    // count.
    let data = &complete_rows(model.free_run.data)?;
    let profile = &Noise::fit(data, residual);
    let noise = &profile.noise.channels;
    let cross = cross(data, residual)?;
    let vehicle = model.vehicle(values).ok()?;
    let responses = responses(&vehicle, data, &cross)?;
    let rows = (2.0 * cross.averages.iter().sum::<f64>() * cross.channels.len() as f64).ln();
    let density = |band: usize, c: usize| noise[cross.channels[c]].density(cross.f[band], data.period_s);
    let alone = whittle(&cross, density, |_| 0.0, &[])?;
    let parameters: usize = cross.channels.iter().map(|c| noise[*c].parameters() + 1).sum();
    let alone = -2.0 * alone + parameters as f64 * rows;
    let fits: Vec<(usize, Shaped, f64)> = (0..vehicle.states.len())
        .into_par_iter()
        .filter_map(|state| {
            let shaped = {
                let h: Vec<Vec<C>> =
                    responses.iter().map(|r| r.column(state).iter().copied().collect()).collect();
                Shaped::fit(&cross, &h, data.period_s)?
            };
            let bic = -2.0 * shaped.likelihood + shaped.parameters() as f64 * rows;
            Some((state, shaped, alone - bic))
        })
        .collect();
    refined(data, &vehicle, residual, profile, fits)
}

/// The record with only those rows counted that are complete; `None` when too few are. Channels sampled more
/// slowly than the record are left unchanged.
fn complete_rows(data: &Data) -> Option<Data> {
    let mut whole = data.clone();
    let every = |c: &crate::data::record::Channel| c.stride == 1 && c.first == 0;
    let rows = data.channels.iter().map(|c| c.good.len()).min()?;
    let good: Vec<bool> =
        (0..rows).map(|k| data.channels.iter().filter(|c| every(c)).all(|c| c.good[k])).collect();
    if (good.iter().filter(|g| **g).count() as f64) < COMPLETE_ROWS_SHARE * rows as f64 {
        return None;
    }
    for channel in whole.channels.iter_mut().filter(|c| every(c)) {
        channel.good.truncate(rows);
        channel.good.iter_mut().zip(&good).for_each(|(own, all)| *own &= all);
        channel.good.resize(channel.values.len(), false);
    }
    Some(whole)
}

/// Refines the most likely states by the exact likelihood.
fn refined(
    data: &Data,
    vehicle: &Vehicle,
    residual: &[f64],
    profile: &Profile,
    mut fits: Vec<(usize, Shaped, f64)>,
) -> Option<Turbulence> {
    fits.sort_by(|a, b| b.2.total_cmp(&a.2));
    if data.channels.iter().any(|c| c.stride != 1 || c.first != 0) || data.starts.len() > 1 {
        // With slow sensors or several records, only Whittle's likelihood is available.
        let others = fits.iter().skip(1).map(|f| (f.0, f.2)).collect();
        let (state, best, delta_bic) = fits.first()?;
        return Some(Turbulence {
            state: *state,
            std: (best.values[0].exp(), best.errors[0]),
            bandwidth_hz: (best.values[1].exp(), best.errors[1]),
            together: best.errors[0],
            delta_bic: *delta_bic,
            others,
            noises: None,
        });
    }
    // Whittle's likelihood can be trusted that there is no turbulence, except where the motion is far above
    // the noise.
    let far = data.channels.iter().enumerate().any(|(c, channel)| {
        let declared = vehicle.outputs[channel.output].noise;
        let floor = if declared > 0.0 { declared } else { profile.noise.channels[c].variance().sqrt() };
        profile.noise.total[c] > FAR_ABOVE_NOISE * floor
    });
    if !far {
        fits.retain(|f| f.2 > UNLIKELY_TURBULENCE_BIC);
    }
    let alone = profile.bic(0);
    let rows = (profile.rows as f64).ln();
    let mut exact: Vec<(usize, Maximum, f64)> = fits
        .par_iter()
        .take(TURBULENCE_STATES_REFINED)
        .enumerate()
        .filter_map(|(rank, (state, shaped, whittle))| {
            let driven = Driven { data, vehicle, state: *state, residual };
            let starts = starts(driven, profile, shaped, (*whittle > 0.0, rank == 0));
            let maxima = starts.into_iter().filter(|noises| far || promises(driven, noises));
            let maxima = maxima.filter_map(|noises| {
                let wanted = 0.5 * (noises.parameters() as f64 * rows + MIN_TURBULENCE_BIC - alone);
                let maximum = climb(driven, noises, wanted)?;
                let bic = -2.0 * maximum.likelihood + maximum.noises.parameters() as f64 * rows;
                Some((*state, maximum, alone - bic))
            });
            maxima.max_by(|a, b| a.2.total_cmp(&b.2))
        })
        .collect();
    exact.sort_by(|a, b| b.2.total_cmp(&a.2));
    let others = exact.iter().skip(1).map(|f| (f.0, f.2)).collect();
    if exact.is_empty() {
        return None;
    }
    let (state, Maximum { noises, errors, .. }, delta_bic) = exact.swap_remove(0);
    Some(Turbulence {
        state,
        std: (noises.common[0].exp(), errors[0]),
        bandwidth_hz: (noises.common[1].exp(), errors[1]),
        together: errors[2],
        delta_bic,
        others,
        noises: Some(noises),
    })
}

/// True when turbulence of some size beside the given noise is more likely than none.
fn promises(driven: Driven<'_>, noises: &Noises) -> bool {
    let at = |share: f64| {
        let mut sized = noises.clone();
        sized.common[0] += share.ln();
        driven.log_likelihood(&sized).unwrap_or(f64::NEG_INFINITY)
    };
    let [sizes @ .., none] = TURBULENCE_SIZE_SHARES.map(at);
    sizes.into_iter().fold(f64::NEG_INFINITY, f64::max) > none + CLIMB_PROMISE
}

/// Start values of the noises for the exact likelihood. Where the motion is far above the noise, Whittle's
/// likelihood is invalid and no start; for the best state it is not trusted alone: starts are then the
/// declared noise, white, of first order or resonant, and the most likely ones are followed, each with its
/// most likely size and bandwidth.
fn starts(
    driven: Driven<'_>,
    profile: &Profile,
    shaped: &Shaped,
    (trusted, best): (bool, bool),
) -> Vec<Noises> {
    let Driven { data, vehicle, .. } = driven;
    let p = data.channels.len();
    let values = if trusted { &shaped.values } else { &shaped.first };
    let common = [values[0], values[1].max(-4.6)];
    let noises = |own: &dyn Fn(usize) -> f64, partial: Vec<[f64; 2]>| {
        // The joint innovations of all channels are no larger than those of a single channel's own model: an
        // upper bound of the noise.
        let most = |c: usize| 0.5 * profile.noise.channels[c].variance().ln();
        Noises { common, own: (0..p).map(|c| own(c).min(most(c))).collect(), partial }
    };
    let whittle = noises(&|c| values[2 + c], (0..p).map(|c| shaped.partial(c)).collect());
    if trusted && !best {
        return vec![whittle];
    }
    let declared = |c: usize| vehicle.outputs[data.channels[c].output].noise;
    let first_order = PARTIAL_CORRELATION_STARTS.into_iter().map(|k| [k, 0.0]);
    let narrowest = PARTIAL_CORRELATION_STARTS.into_iter().fold(0.0, f64::min);
    let resonant = RESONANT_STARTS.into_iter().map(|share| [(PI * share).cos(), narrowest]);
    let mut starts: Vec<(f64, Noises)> = first_order
        .chain(resonant)
        .map(|partial: [f64; 2]| {
            let innovation: f64 = partial.iter().map(|k| 0.5 * (1.0 - k * k).ln()).sum();
            let own =
                |c: usize| if declared(c) > 0.0 { declared(c).ln() + innovation } else { values[2 + c] };
            noises(&own, vec![partial; p])
        })
        .chain(trusted.then_some(whittle))
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|noises| {
            let likelihood = driven.log_likelihood(&noises);
            (likelihood.unwrap_or(f64::NEG_INFINITY), noises)
        })
        .collect();
    starts.sort_by(|a, b| b.0.total_cmp(&a.0));
    starts.truncate(STARTS_CLIMBED);
    starts.into_iter().map(|(_, noises)| likeliest(driven, &noises)).collect()
}

/// The most likely bandwidth and size beside the given noise of the channels; unchanged when none is more
/// likely. The density at high frequencies is kept where the bandwidth changes.
fn likeliest(driven: Driven<'_>, own: &Noises) -> Noises {
    let [size, bandwidth] = own.common;
    let (lowest, highest) = bandwidths_hz(driven.data);
    let share = |i: usize| (i as f64 + 0.5) / BANDWIDTH_STARTS as f64;
    let bandwidths = (0..BANDWIDTH_STARTS).map(|i| lowest * (highest / lowest).powf(share(i)));
    let tried = bandwidths
        .flat_map(|b| SIZE_STARTS.map(|share| [size + share.ln() + 0.5 * (bandwidth - b.ln()), b.ln()]));
    let mut all: Vec<Noises> = tried.map(|common| Noises { common, ..own.clone() }).collect();
    all.push(own.clone());
    let likelihood = |noises: &Noises| driven.log_likelihood(noises).unwrap_or(f64::NEG_INFINITY);
    let values: Vec<f64> = all.par_iter().map(likelihood).collect();
    let best = values.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(i, _)| i);
    all.swap_remove(best)
}
