//! Runs an identification from data to result: checks, search, figures.

use std::collections::BTreeMap;

use super::answer::{
    DataPart, FixedAnswer, IDENTIFICATION_SCHEMA, Identification, Log, OutputAnswer, ParameterAnswer, Pole,
    Role, SearchSummary,
};
use super::data::Segment;
use super::disturbed::disturbed;
use super::force_fit::{FORCES, WANDERING, fit_beside_likely_forces, pushed_states, was_found_beside_forces};
use super::options::{Method, Options};
use super::pem::{self, Fit, Noise, NoiseFit};
use super::prepare::{Levels, without_unknown_past};
use super::problem::{Problem, split};
use super::quality::{self, Runs};
use super::spread::correlation;
use super::{IdentifyError, ga, text};
use crate::watch::Watch;
use whirlstand_logs::shown::clean;
use whirlstand_vehicle::{SENSOR_NOISE, Vehicle};

/// A part of a log, used for the fit or for its validation.
#[derive(Debug, Clone, PartialEq)]
pub struct Source {
    /// The log and its checksum.
    pub log: Log,
    /// The data of the part.
    pub segment: Segment,
}

/// Fits the free parameters of `vehicle` to `fitted` and compares the result with `control`. The watch
/// receives the progress; if it stops the search, the answer is the best result so far.
///
/// # Errors
/// [`IdentifyError`]: nothing is free, no excitation, too few samples, no start from which a simulation stays finite, or ended
/// before there was one.
pub fn identify(
    vehicle: &Vehicle,
    fitted: &[Source],
    control: &[Source],
    options: &Options,
    watch: &Watch,
) -> Result<Identification, IdentifyError> {
    let begun = std::time::Instant::now();
    let segments: Vec<Segment> = fitted.iter().map(|s| s.segment.clone()).collect();
    let levels = options.detrend.then(|| Levels::of(vehicle, &segments)).transpose()?;
    let prepared = |sources: &[Source]| -> Vec<Source> {
        let mut sources = sources.to_vec();
        for Source { segment, .. } in &mut sources {
            levels.iter().for_each(|l| l.take_off(segment));
            without_unknown_past(vehicle, segment);
        }
        sources
    };
    let (fitted, control) = (&prepared(fitted), &prepared(control));
    let mut about = vehicle.clone();
    levels.iter().for_each(|l| l.shift(&mut about, -1.0));
    let mut answer = search(&about, fitted, control, options, watch, begun)?;
    if let (Some(levels), Some(vehicle)) = (levels, &mut answer.fitted) {
        levels.shift(vehicle, 1.0);
        vehicle.provenance.push(("about".into(), text::levels(vehicle, &levels)));
        answer.remarks.push(format!("The model is linear about {}.", text::levels(vehicle, &levels)));
    }
    Ok(answer)
}

/// Fits to data that have been prepared.
fn search(
    vehicle: &Vehicle,
    fitted: &[Source],
    control: &[Source],
    options: &Options,
    watch: &Watch,
    begun: std::time::Instant,
) -> Result<Identification, IdentifyError> {
    let segments: Vec<Segment> = fitted.iter().map(|s| s.segment.clone()).collect();
    let every: Vec<Segment> =
        segments.iter().cloned().chain(control.iter().map(|s| s.segment.clone())).collect();
    Problem::new(vehicle, &every, options.nuisance)?;
    let problem = Problem::new(vehicle, &segments, options.nuisance)?;
    check(&problem, &segments)?;
    let noise = options.noise.unwrap_or_else(|| choose(&problem, &segments, options.closed_loop));
    let found = by_method(&problem, &segments, options, noise, watch);
    let partial = watch.is_stopped();
    let (fit, noise, evaluations) = match found {
        // With more time the search might have found a stable start.
        Err(IdentifyError::UnstableStart { .. }) if partial => return Err(IdentifyError::EndedEarly),
        found => found?,
    };
    let effort = Effort { evaluations, begun, partial };
    answer(fit, fitted, control, options, noise, &effort)
}

/// Effort of a search besides that of its fit.
struct Effort {
    /// Number of simulations of the genetic algorithm.
    evaluations: usize,
    begun: std::time::Instant,
    /// True when the search was stopped early.
    partial: bool,
}

/// Fits by the selected method; returns the fit, its noise model, and the number of simulations of the
/// genetic algorithm.
fn by_method(
    problem: &Problem,
    segments: &[Segment],
    options: &Options,
    noise: Noise,
    watch: &Watch,
) -> Result<(Fit, Noise, usize), IdentifyError> {
    let fit = |extra: &[Vec<f64>]| match noise {
        Noise::Kalman if was_found_beside_forces(&problem.vehicle) => {
            fit_beside_likely_forces(problem, segments, extra, watch)
        }
        _ => pem::fit(problem, segments, noise, extra, watch),
    };
    if options.method == Method::Pem {
        return Ok((fit(&[])?, noise, 0));
    }
    let found = ga::search(problem, segments, options, watch)?;
    let evaluations = found.evaluations;
    if options.method == Method::Ga {
        let fit = ga::as_fit(problem, segments, &found)
            .ok_or(IdentifyError::UnstableStart { tried: evaluations })?;
        return Ok((fit, Noise::White, evaluations));
    }
    Ok((fit(&[found.theta])?, noise, evaluations))
}

/// Checks that the data contain information about the parameters.
fn check(problem: &Problem, segments: &[Segment]) -> Result<(), IdentifyError> {
    let m = problem.m();
    let moves = |s: &Segment| {
        (0..m).any(|j| {
            let mut u = s.inputs.iter().skip(j).step_by(m);
            let first = u.next().copied().unwrap_or(0.0);
            u.any(|v| (v - first).abs() > 1e-9 * first.abs().max(1e-9))
        })
    };
    if let (false, Some(first)) = (segments.iter().any(moves), segments.first()) {
        return Err(IdentifyError::NoExcitation {
            origin: first.origin.clone(),
            from_s: first.start_s,
            until_s: first.time(first.steps.saturating_sub(1)),
            inputs: problem.vehicle.inputs.iter().map(|u| u.name.clone()).collect::<Vec<_>>().join(", "),
        });
    }
    let samples = segments.iter().flat_map(|s| &s.outputs).filter(|y| y.is_finite()).count();
    let unknowns = problem.parameters.len() + problem.nuisances() * segments.len();
    if samples <= unknowns {
        return Err(IdentifyError::TooFew { samples, unknowns, parameters: problem.parameters.len() });
    }
    Ok(())
}

/// Selects the noise model for data and vehicle. A vehicle whose values were found beside process noise was
/// fitted to a flight in a closed loop or in gusts, where output errors give biased values (Ljung, System
/// Identification, 1999, section 13.4): it is fitted with process noise again.
fn choose(problem: &Problem, segments: &[Segment], closed_loop: bool) -> Noise {
    let provenance = &problem.vehicle.provenance;
    let followed =
        provenance.iter().any(|(key, value)| key == "noise" && value == text::noise(Noise::Kalman));
    if closed_loop || followed || !quality::stable_at_start(problem, segments) {
        Noise::Kalman
    } else {
        Noise::White
    }
}

fn answer(
    fit: Fit,
    fitted: &[Source],
    control: &[Source],
    options: &Options,
    noise: Noise,
    effort: &Effort,
) -> Result<Identification, IdentifyError> {
    let segments: Vec<Segment> = fitted.iter().map(|s| s.segment.clone()).collect();
    let held: Vec<Segment> = control.iter().map(|s| s.segment.clone()).collect();
    let own = quality::identification_runs(&fit, &segments);
    let other = quality::control_runs(&fit, &held);
    let problem = &fit.problem;
    let mut vehicle = problem.vehicle_at(&fit.theta);
    let sensors = vehicle.provenance.iter().find(|(key, _)| key == SENSOR_NOISE).cloned();
    vehicle.provenance = provenance(options, noise, fitted);
    vehicle.provenance.extend(sensors);
    if was_found_beside_forces(&problem.vehicle) {
        vehicle.provenance.push((FORCES.into(), WANDERING.into()));
    }
    if effort.partial {
        vehicle.provenance.push(("partial".into(), "the search was ended early".into()));
    }
    let mut answer = Identification {
        schema: IDENTIFICATION_SCHEMA.into(),
        verdict: String::new(),
        partial: effort.partial,
        vehicle: vehicle.name.clone(),
        method: options.method,
        noise,
        wandering_forces: pushed_states(&fit),
        closed_loop: options.closed_loop,
        seed: options.seed,
        version: env!("CARGO_PKG_VERSION").into(),
        data: parts(problem, fitted, &own, Role::Identification)
            .chain(parts(problem, control, &other, Role::Control))
            .collect(),
        period_s: problem.period_s,
        search: SearchSummary {
            converged: fit.outcome.converged,
            iterations: fit.outcome.iterations,
            evaluations: fit.outcome.evaluations + effort.evaluations,
            cost: fit.cost,
            seconds: effort.begun.elapsed().as_secs_f64(),
        },
        parameters: parameters(&fit, options.method != Method::Ga),
        correlations: correlations(&fit),
        fixed: fixed(&fit),
        poles: poles(&vehicle)?,
        outputs: outputs(&fit, &segments, &own, &held, &other),
        standard_errors_hold: true,
        disturbed: disturbed(problem, &segments, &own.one_step),
        remarks: Vec::new(),
        fitted_vehicle: None,
        series: quality::series(problem, &segments, &own, Role::Identification),
        fitted: Some(Box::new(vehicle)),
    };
    answer.series.extend(quality::series(problem, &held, &other, Role::Control));
    answer.standard_errors_hold = text::standard_errors_hold(&answer);
    answer.remarks = text::remarks(&answer);
    answer.verdict = text::verdict(&answer);
    Ok(answer)
}

fn provenance(options: &Options, noise: Noise, fitted: &[Source]) -> Vec<(String, String)> {
    let mut all = vec![
        ("program".into(), format!("whirlstand {}", env!("CARGO_PKG_VERSION"))),
        ("method".into(), options.method.word().into()),
        ("noise".into(), text::noise(noise).into()),
        ("seed".into(), options.seed.to_string()),
    ];
    for (i, source) in fitted.iter().enumerate() {
        let s = &source.segment;
        let part = format!(
            "{} from {} s to {} s",
            source.log.file,
            clean(s.start_s),
            clean(s.time(s.steps.saturating_sub(1)))
        );
        all.push((format!("log_{}", i + 1), part));
        if !source.log.sha256.is_empty() {
            all.push((format!("log_{}_sha256", i + 1), source.log.sha256.clone()));
        }
    }
    all
}

fn parts<'a>(
    problem: &'a Problem,
    sources: &'a [Source],
    runs: &'a Runs,
    role: Role,
) -> impl Iterator<Item = DataPart> + 'a {
    let vehicle = &problem.vehicle;
    sources.iter().zip(&runs.nuisances).map(move |(source, nuisance)| {
        let (initial, offsets) = split(problem, nuisance);
        let states = vehicle.states.iter().zip(initial).map(|(s, v)| (s.name.clone(), *v));
        let fitted = vehicle.outputs.iter().zip(offsets).zip(&problem.weights).filter(|(_, w)| **w > 0.0);
        DataPart {
            log: source.log.clone(),
            from_s: source.segment.start_s,
            until_s: source.segment.time(source.segment.steps.saturating_sub(1)),
            samples: source.segment.steps,
            role,
            initial_state: states.collect(),
            offsets: fitted.map(|((o, v), _)| (o.name.clone(), *v)).collect(),
        }
    })
}

/// Distance from an end of the range of a parameter, as a share of it, within which an estimate lies at that end.
pub const AT_BOUND: f64 = 1e-6;

fn parameters(fit: &Fit, errors: bool) -> Vec<ParameterAnswer> {
    let all = fit.problem.parameters.iter().zip(&fit.theta).enumerate();
    all.map(|(i, (p, value))| {
        let edge = AT_BOUND * (p.upper - p.lower);
        ParameterAnswer {
            name: p.name.clone(),
            value: value / p.factor,
            standard_error: errors.then(|| fit.covariance[(i, i)].max(0.0).sqrt() / p.factor),
            lower: p.lower / p.factor,
            upper: p.upper / p.factor,
            at_bound: *value <= p.lower + edge || *value >= p.upper - edge,
            unit: fit.problem.vehicle.free_unit(&p.target),
            value_si: *value,
            unit_si: fit.problem.vehicle.free_unit_si(&p.target),
        }
    })
    .collect()
}

fn correlations(fit: &Fit) -> Vec<Vec<f64>> {
    let n = fit.theta.len();
    (0..n).map(|i| (0..n).map(|j| correlation(&fit.covariance, i, j)).collect()).collect()
}

fn fixed(fit: &Fit) -> Vec<FixedAnswer> {
    fit.fixed
        .iter()
        .map(|f| FixedAnswer {
            name: f.parameter.name.clone(),
            value: f.value / f.parameter.factor,
            unit: fit.problem.vehicle.free_unit(&f.parameter.target),
            why: f.why.clone(),
        })
        .collect()
}

fn poles(vehicle: &Vehicle) -> Result<Vec<Pole>, IdentifyError> {
    let mut poles: Vec<Pole> = vehicle
        .poles()?
        .iter()
        .map(|p| {
            let size = p.norm();
            Pole {
                re: p.re,
                im: p.im,
                frequency_hz: size / std::f64::consts::TAU,
                damping_ratio: if size > 0.0 { -p.re / size } else { 1.0 },
            }
        })
        .collect();
    poles.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz).then(b.im.total_cmp(&a.im)));
    Ok(poles)
}

fn outputs(
    fit: &Fit,
    segments: &[Segment],
    own: &Runs,
    held: &[Segment],
    other: &Runs,
) -> BTreeMap<String, OutputAnswer> {
    let problem = &fit.problem;
    let all = problem.vehicle.outputs.iter().enumerate().filter(|(i, _)| problem.weights[*i] > 0.0);
    all.map(|(i, output)| {
        let residuals: Vec<f64> = own.one_step[i].iter().flatten().copied().collect();
        let answer = OutputAnswer {
            unit: output.unit.shown(),
            identification: quality::quality(problem, segments, own, i),
            control: quality::quality(problem, held, other, i),
            noise_std: whirlstand_logs::stats::rms(&residuals),
            noise_order: match &fit.noise {
                NoiseFit::Outputs(models) => models[i].order(),
                NoiseFit::Kalman(..) => 0,
            },
            whiteness: quality::whiteness(&own.one_step[i]),
        };
        (output.name.clone(), answer)
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use whirlstand_vehicle::Vehicle;

    use super::*;

    #[test]
    fn a_vehicle_that_was_fitted_beside_process_noise_is_fitted_beside_it_again() {
        let text = r#"
            A = [[-8.0]]
            B = [[24.0]]
            states = [{ name = "p" }]
            inputs = [{ name = "u" }]
            free = [{ entry = "A[1,1]", lower = -20.0, upper = -1.0, start = -8.0 }]
        "#;
        let mut vehicle = Vehicle::parse(text, "axis.toml").unwrap();
        let steps = 50;
        let segments = [Segment {
            origin: "steps".into(),
            start_s: 0.0,
            first_step: 0,
            period_s: 0.01,
            inputs: (0..steps).map(|k| f64::from(k as u32 / 10 % 2)).collect(),
            outputs: vec![0.0; steps],
            steps,
        }];
        let chosen = |vehicle: &Vehicle| {
            let problem = Problem::new(vehicle, &segments, super::super::Nuisance::default()).unwrap();
            choose(&problem, &segments, false)
        };
        assert_eq!(chosen(&vehicle), Noise::White);
        vehicle.provenance.push(("noise".into(), "kalman".into()));
        assert_eq!(chosen(&vehicle), Noise::Kalman);
    }
}
