//! Description of the residual that no effect of the table explains.

use std::collections::BTreeMap;

use crate::thresholds::{COHERENT_CORRELATION, NOISE_POWER_RATIO};
use whirlstand_vehicle::Vehicle;

use crate::answer::schema::{OutputGain, Unexplained};
use crate::data::record::Data;
use crate::model::columns::dot;
use crate::search::selection::Refused;
use crate::stages::findings::Findings;
use whirlstand_logs::shown::number;
use whirlstand_logs::spectrum::welch;
use whirlstand_logs::stats::{correlation, rms};

/// Power of a residual relative to the power of the noise, over all channels.
fn power(findings: &Findings<'_>, data: &Data, residual: &[f64]) -> f64 {
    data.ranges()
        .into_iter()
        .enumerate()
        .filter(|(c, _)| means_something(findings, *c))
        .map(|(c, range)| {
            let noise = findings.baseline.sizes.noise[data.channels[c].output].max(f64::MIN_POSITIVE);
            let r = &residual[range];
            let over = dot(r, r) / (noise * noise);
            if over > NOISE_POWER_RATIO * r.len() as f64 { over - r.len() as f64 } else { 0.0 }
        })
        .sum()
}

/// True for a channel whose free run is meaningful.
fn means_something(findings: &Findings<'_>, channel: usize) -> bool {
    findings.gains.channels[channel].free_run.is_some()
}

/// Text on outputs without a meaningful free run: "the free run of roll is not meaningful, as it accumulates
/// the effect of every gust".
fn lost(findings: &Findings<'_>, data: &Data, vehicle: &Vehicle) -> Option<String> {
    let lost = data.channels.iter().enumerate().filter(|(c, _)| !means_something(findings, *c));
    let names: Vec<&str> = lost.map(|(_, c)| vehicle.outputs[c.output].name.as_str()).collect();
    (!names.is_empty()).then(|| {
        format!(
            "the free run of {} is not meaningful, as it accumulates the effect of every gust",
            names.join(", ")
        )
    })
}

/// True when the final residual correlates with an input. For a predictor that follows the record this proves
/// nothing: in closed loop the controller responds to the process noise, so commands correlate with it.
pub(crate) fn structured(findings: &Findings<'_>, data: &Data) -> bool {
    if data.memory_s.is_some() {
        return false;
    }
    let left = power(findings, data, &findings.residual.selection.fit.residual);
    left > data.samples() as f64
        && coherent(findings, data, &findings.residual.selection.fit.residual).is_some()
}

/// The unexplained share of the original model error, and its description. Zero for a predictor that follows
/// the record: motion due to gusts is not an error of the model.
pub(crate) fn unexplained(findings: &Findings<'_>, data: &Data, vehicle: &Vehicle) -> Unexplained {
    if data.memory_s.is_some() {
        return Unexplained::default();
    }
    let selection = &findings.residual.selection;
    let residual = &selection.fit.residual;
    let (before, left) = (power(findings, data, &selection.null.residual), power(findings, data, residual));
    // A random cause is named separately and stays in every residual.
    let random = findings.residual.turbulence.is_some() || !findings.residual.noise.is_empty();
    let share = if before > 0.0 && !random { (left / before).clamp(0.0, 1.0) } else { 0.0 };
    let like = findings.residual.out_of_library.as_ref().map(|by| format!("it may be {}", by.description));
    let lost = lost(findings, data, vehicle);
    if left == 0.0 || random && share == 0.0 {
        return Unexplained { share, description: sentence(lost.into_iter().chain(like).collect()) };
    }
    let ranges = data.ranges();
    let loudness = |c: usize| {
        rms(&residual[ranges[c].clone()])
            / findings.baseline.sizes.noise[data.channels[c].output].max(f64::MIN_POSITIVE)
    };
    let meaningful = (0..data.channels.len()).filter(|c| means_something(findings, *c));
    let Some(worst) = meaningful.max_by(|a, b| loudness(*a).total_cmp(&loudness(*b))) else {
        return Unexplained { share, description: sentence(lost.into_iter().chain(like).collect()) };
    };
    let channel = &data.channels[worst];
    let r = &residual[ranges[worst].clone()];
    let period_s = data.period_s * channel.stride as f64;
    let mut parts = vec![format!(
        "the residual is largest in {}: {:.1} times the noise",
        vehicle.outputs[channel.output].name,
        loudness(worst)
    )];
    if let Some((low, high)) = band(r, period_s) {
        parts.push(format!("between {low:.2} and {high:.2} Hz"));
    }
    if let Some(at) = onset(r) {
        parts.push(format!("from {:.1} s on", data.start_s + at as f64 * period_s));
    }
    match coherent(findings, data, residual) {
        Some((j, strength, lag)) => {
            parts.push(format!(
                "it follows {} (correlation {strength:.2}, lag {:.2} s)",
                vehicle.inputs[j].name,
                lag as f64 * data.period_s
            ));
            parts.push(amplitude_dependence(data, worst, r, j));
        }
        None => parts.push("it is not correlated with any input".into()),
    }
    if let Some(memory) = memory(r) {
        parts.push(format!("its correlation time is {:.2} s", memory as f64 * period_s));
    }
    parts.extend(lost);
    parts.extend(like);
    let near: Vec<String> = selection
        .refused
        .iter()
        .filter(|t| t.values.is_some() && t.delta_bic > 0.0)
        .take(3)
        .map(|t| t.candidate.name())
        .collect();
    if !near.is_empty() {
        parts.push(format!("closest effects, rejected: {}", near.join(", ")));
    }
    Unexplained { share, description: sentence(parts) }
}

/// Text on how well the record is predicted, for a residual of which is only known that it is not noise.
pub(crate) fn beside(outputs: &BTreeMap<String, OutputGain>, horizon_s: f64) -> String {
    let left = "the prediction residuals are not noise".to_string();
    match fits(outputs, horizon_s) {
        Some(fits) => format!("Held-out data are predicted with a {fits}; {left}."),
        None => sentence(vec![left]),
    }
}

/// Text that the commands do not explain the outputs, although these may be well predicted.
pub(crate) fn untold(vehicle: &str, outputs: &BTreeMap<String, OutputGain>, horizon_s: f64) -> String {
    let text = format!("the commands of {vehicle} do not make the record more likely");
    // A fit of zero is that of the mean.
    let good = outputs.values().filter_map(|output| output.horizon_fit_after).all(|fit| fit > 0.0);
    match fits(outputs, horizon_s).filter(|_| good) {
        Some(fits) => format!("{text}; the {fits} comes from past measurements alone"),
        None => text,
    }
}

/// Text on a cause that was found and is not named, because another explains as much.
pub(crate) fn undecided(refused: &Refused) -> String {
    let Refused { candidate, delta_bic, why, .. } = refused;
    format!("{} on {} gains {delta_bic:.0} in BIC, but {why}.", candidate.kind.name(), candidate.place)
}

/// Text on states on which random forces act.
pub(crate) fn at_random(states: &[String]) -> Option<String> {
    (!states.is_empty()).then(|| format!("A force of unknown course acts on {}.", states.join(" and on ")))
}

/// Range of the outputs' fits over the horizon, as in "fit of 97.1 to 98.2 % over 0.500 s"; `None` where no
/// output changes.
fn fits(outputs: &BTreeMap<String, OutputGain>, horizon_s: f64) -> Option<String> {
    let fits = || outputs.values().filter_map(|output| output.horizon_fit_after);
    let (low, high) = (fits().reduce(f64::min)?, fits().reduce(f64::max)?);
    let range = if fits().count() == 1 { format!("{low:.1}") } else { format!("{low:.1} to {high:.1}") };
    Some(format!("fit of {range} % over {} s", number(horizon_s)))
}

/// Joins parts into one sentence; empty without parts.
fn sentence(parts: Vec<String>) -> String {
    let text = parts.join("; ");
    text.get(..1).map_or_else(String::new, |first| format!("{}{}.", first.to_uppercase(), &text[1..]))
}

/// The frequency band that holds the middle 80 % of the power.
fn band(r: &[f64], period_s: f64) -> Option<(f64, f64)> {
    let spectrum = welch(r, period_s);
    let total: f64 = spectrum.density.iter().sum();
    let mut sum = 0.0;
    let (mut low, mut high) = (None, None);
    for (f, d) in spectrum.frequency_hz.iter().zip(&spectrum.density) {
        sum += d;
        if low.is_none() && sum > 0.1 * total {
            low = Some(*f);
        }
        if high.is_none() && sum > 0.9 * total {
            high = Some(*f);
        }
    }
    Some((low?, high?))
}

/// Sample at which the power rises several times, by the maximum likelihood of a single change of variance.
fn onset(r: &[f64]) -> Option<usize> {
    let squares: Vec<f64> = r.iter().map(|v| v * v).collect();
    let total: f64 = squares.iter().sum();
    let n = r.len();
    let mut before = 0.0;
    let mut best = (0.0, 0);
    let whole = (total / n as f64).ln();
    for (k, square) in squares.iter().enumerate() {
        if k > n / 20 && k < n - n / 20 {
            let (a, b) = (k as f64, (n - k) as f64);
            let gain = n as f64 * whole - a * (before / a).ln() - b * ((total - before) / b).ln();
            if gain > best.0 && (total - before) / b > 4.0 * before / a {
                best = (gain, k);
            }
        }
        before += square;
    }
    (best.1 > 0).then_some(best.1)
}

/// The input whose past correlates most with a residual: index of the input, correlation, lag in steps.
fn coherent(findings: &Findings<'_>, data: &Data, residual: &[f64]) -> Option<(usize, f64, usize)> {
    let mut best: Option<(usize, f64, usize)> = None;
    let longest = (2.0 / data.period_s).min(data.steps as f64 / 8.0) as usize;
    for (c, (channel, range)) in data.channels.iter().zip(data.ranges()).enumerate() {
        let noise = findings.baseline.sizes.noise[channel.output];
        let r = &residual[range];
        if channel.stride != 1 || rms(r) < 1.2 * noise || !means_something(findings, c) {
            continue;
        }
        for j in 0..data.m {
            let u: Vec<f64> = data.input(j).collect();
            for lag in (0..longest).step_by((longest / 64).max(1)) {
                let n = r.len().min(u.len().saturating_sub(channel.first)).saturating_sub(lag);
                let c = correlation(&r[lag..lag + n], &u[channel.first..channel.first + n]);
                if c.abs() > COHERENT_CORRELATION && best.is_none_or(|b| c.abs() > b.1.abs()) {
                    best = Some((j, c, lag));
                }
            }
        }
    }
    best
}

/// Amplitude dependence of a residual (odd, even or neither): its correlation with the input, the input's
/// magnitude and its cube.
fn amplitude_dependence(data: &Data, worst: usize, r: &[f64], j: usize) -> String {
    let channel = &data.channels[worst];
    let u: Vec<f64> = (0..r.len()).map(|k| data.inputs[channel.step(k) * data.m + j]).collect();
    let magnitude: Vec<f64> = u.iter().map(|u| u.abs()).collect();
    let (odd, even) = (correlation(r, &u).abs(), correlation(r, &magnitude).abs());
    if even > 1.5 * odd {
        "even in its amplitude".into()
    } else if odd > 1.5 * even {
        "odd in its amplitude".into()
    } else {
        "neither odd nor even in its amplitude".into()
    }
}

/// Lag in samples at which the autocorrelation falls below 1/e.
fn memory(r: &[f64]) -> Option<usize> {
    let power = dot(r, r);
    (1..r.len() / 4)
        .find(|k| dot(&r[*k..], &r[..r.len() - k]) < power / std::f64::consts::E)
        .filter(|k| *k > 1)
}

#[cfg(test)]
mod tests {
    use whirlstand_logs::shown::ShownUnit;

    use super::*;

    fn outputs(fits: &[Option<f64>]) -> BTreeMap<String, OutputGain> {
        let output = |fit: &Option<f64>| OutputGain {
            unit: ShownUnit::of("rad/s"),
            fit_before: None,
            fit_after: None,
            rmse_before: None,
            rmse_after: None,
            horizon_fit_before: None,
            horizon_fit_after: *fit,
            horizon_rmse_before: None,
            horizon_rmse_after: None,
            noise_floor: 0.01,
            noise_model_share: None,
        };
        fits.iter().enumerate().map(|(i, fit)| (format!("output {i}"), output(fit))).collect()
    }

    #[test]
    fn a_good_prediction_is_told_beside_what_it_leaves() {
        assert_eq!(
            beside(&outputs(&[Some(98.21), None, Some(97.06)]), 0.5),
            "Held-out data are predicted with a fit of 97.1 to 98.2 % over 0.500 s; the prediction residuals are not noise."
        );
        assert_eq!(fits(&outputs(&[Some(-3.0)]), 2.0).unwrap(), "fit of -3.0 % over 2.00 s");
        assert_eq!(beside(&outputs(&[None]), 0.5), "The prediction residuals are not noise.");
    }
    #[test]
    fn what_the_commands_do_not_tell_may_be_well_predicted() {
        let told = |fits: &[Option<f64>]| untold("quadrotor", &outputs(fits), 0.5);
        let nothing = "the commands of quadrotor do not make the record more likely";
        assert_eq!(
            told(&[Some(97.0)]),
            format!("{nothing}; the fit of 97.0 % over 0.500 s comes from past measurements alone")
        );
        assert_eq!(told(&[Some(97.0), Some(-1.0)]), nothing);
        assert_eq!(told(&[None]), nothing);
    }
}
