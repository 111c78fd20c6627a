//! Quality of a fit: fit to the records, and whiteness of the residuals.

use super::answer::{OutputSeries, PartSeries, Quality, Role, Whiteness};
use super::ar::Ar;
use super::data::Segment;
use super::forces::with_forces;
use super::output_error::{evaluate, simulate};
use super::pem::{Fit, NoiseFit, no_nuisances, white};
use super::problem::{Nuisance, Problem};
use super::{filter_error, start};
use whirlstand_linalg::spectral_abscissa;
use whirlstand_logs::stats::chi_square_tail;

/// Simulations and predictions of a fitted model over parts of the data.
pub struct Runs {
    /// Nuisances of each part, SI.
    pub nuisances: Vec<Vec<f64>>,
    /// Free-running simulations of each part, steps x outputs, SI; `None` when one diverged.
    pub simulated: Option<Vec<Vec<f64>>>,
    /// One-step residuals, SI: for every output one vector per part.
    pub one_step: Vec<Vec<Vec<f64>>>,
}

/// Runs the fitted model over the identification data.
pub fn identification_runs(fit: &Fit, segments: &[Segment]) -> Runs {
    let free = free_run(fit, &fit.frozen(), segments, &fit.nuisances);
    runs(fit, segments, free, &fit.nuisances)
}

/// Runs the fitted model over held-out data: the initial state is fitted there (it is not an error of the
/// model), offsets stay those of the identification data.
pub fn control_runs(fit: &Fit, segments: &[Segment]) -> Runs {
    let p = fit.problem.p();
    let offsets: Vec<f64> = if fit.problem.nuisance.output_offsets {
        let count = fit.nuisances.len().max(1) as f64;
        (0..p).map(|i| fit.nuisances.iter().map(|n| n[n.len() - p + i]).sum::<f64>() / count).collect()
    } else {
        Vec::new()
    };
    let mut problem = fit.frozen();
    problem.nuisance = Nuisance { output_offsets: false, ..problem.nuisance };
    let shifted: Vec<Segment> = segments
        .iter()
        .map(|s| {
            let mut s = s.clone();
            if !offsets.is_empty() {
                s.outputs.iter_mut().enumerate().for_each(|(k, y)| *y -= offsets[k % p]);
            }
            s
        })
        .collect();
    let found = match &fit.noise {
        NoiseFit::Outputs(_) => {
            let first = no_nuisances(&problem, &shifted);
            evaluate(&problem, &shifted, &white(&problem), &[], &first).map_or(first, |e| e.nuisances)
        }
        NoiseFit::Kalman(structure, noise) => {
            let wide = with_forces(&problem, structure);
            let first = no_nuisances(&wide, &shifted);
            let found = filter_error::evaluate(&wide, structure, &shifted, noise, &first);
            found.map_or(first, |e| e.nuisances)
        }
    };
    let with_offsets = |nuisances: Vec<Vec<f64>>| -> Vec<Vec<f64>> {
        nuisances.into_iter().map(|n| n.into_iter().chain(offsets.iter().copied()).collect()).collect()
    };
    let free = free_run(fit, &problem, &shifted, &found);
    runs(fit, segments, with_offsets(free), &with_offsets(found))
}

/// Nuisances of free runs from those of the fit. The initial state of a free run fits the whole run; that of a filter
/// fits its first steps.
fn free_run(fit: &Fit, frozen: &Problem, segments: &[Segment], nuisances: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let NoiseFit::Kalman(structure, _) = &fit.noise else { return nuisances.to_vec() };
    let n = if frozen.nuisance.initial_state { frozen.n() } else { 0 };
    let forces = if frozen.nuisance.initial_state { structure.forces.len() } else { 0 };
    let own = |all: &Vec<f64>| all.iter().take(n).chain(all.iter().skip(n + forces)).copied().collect();
    let own: Vec<Vec<f64>> = nuisances.iter().map(own).collect();
    evaluate(frozen, segments, &white(frozen), &[], &own).map_or(own, |e| e.nuisances)
}

/// Runs the fitted model freely with the nuisances `free`, and its predictor with `followed`.
fn runs(fit: &Fit, segments: &[Segment], free: Vec<Vec<f64>>, followed: &[Vec<f64>]) -> Runs {
    let problem = fit.frozen();
    let p = problem.p();
    let simulated = simulate(&problem, segments, &[], &free);
    let one_step = match (&fit.noise, &simulated) {
        (NoiseFit::Outputs(models), Some(simulated)) => whitened(&problem, segments, simulated, models),
        (NoiseFit::Kalman(structure, noise), _) => {
            let wide = with_forces(&problem, structure);
            let predicted = filter_error::predict(&wide, structure, segments, noise, followed);
            let whites = vec![Ar::white(1.0); p];
            predicted.map_or(vec![Vec::new(); p], |y| whitened(&problem, segments, &y, &whites))
        }
        _ => vec![Vec::new(); p],
    };
    Runs { nuisances: free, simulated, one_step }
}

fn whitened(
    problem: &Problem,
    segments: &[Segment],
    outputs: &[Vec<f64>],
    models: &[Ar],
) -> Vec<Vec<Vec<f64>>> {
    let p = problem.p();
    (0..p)
        .map(|i| {
            segments
                .iter()
                .zip(outputs)
                .map(|(s, y)| {
                    let residual: Vec<f64> = (0..s.steps)
                        .map(|k| s.outputs[k * p + i] - y[k * p + i])
                        .filter(|r| r.is_finite())
                        .collect();
                    models[i].whiten(&residual)
                })
                .collect()
        })
        .collect()
}

/// Figures of output `i`; `None` when the data do not have it.
pub fn quality(problem: &Problem, segments: &[Segment], runs: &Runs, i: usize) -> Option<Quality> {
    let p = problem.p();
    let measured: Vec<Vec<f64>> = segments.iter().map(|s| s.output(i, p)).collect();
    let known: Vec<f64> = measured.iter().flatten().copied().filter(|v| v.is_finite()).collect();
    if known.is_empty() {
        return None;
    }
    let norm = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
    // Each part has its own mean, the trim.
    let spread = measured
        .iter()
        .map(|m| {
            let known: Vec<f64> = m.iter().copied().filter(|v| v.is_finite()).collect();
            let mean = whirlstand_logs::stats::mean(&known);
            known.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>()
        })
        .sum::<f64>()
        .sqrt();
    let fit = |error: f64| (spread > 0.0).then(|| 100.0 * (1.0 - error / spread));
    let residual = runs.simulated.as_ref().map(|outputs| {
        segments
            .iter()
            .zip(outputs)
            .flat_map(|(s, y)| (0..s.steps).map(move |k| s.outputs[k * p + i] - y[k * p + i]))
            .filter(|r| r.is_finite())
            .collect::<Vec<f64>>()
    });
    let bias_removed = residual.as_ref().map(|r| {
        let mean = whirlstand_logs::stats::mean(r);
        norm(&r.iter().map(|v| v - mean).collect::<Vec<_>>())
    });
    let one: Vec<f64> = runs.one_step[i].iter().flatten().copied().collect();
    let scale = (known.len() as f64 / one.len().max(1) as f64).sqrt();
    Some(Quality {
        free_run_fit: residual.as_ref().and_then(|r| fit(norm(r))),
        free_run_fit_bias_removed: bias_removed.and_then(fit),
        free_run_rmse: residual.as_ref().map(|r| whirlstand_logs::stats::rms(r)),
        one_step_fit: if one.is_empty() { None } else { fit(norm(&one) * scale) },
    })
}

/// Ljung-Box test (Biometrika 65, 1978) over runs of residuals, with lags up to the logarithm's rule of
/// thumb.
pub fn whiteness(runs: &[Vec<f64>]) -> Option<Whiteness> {
    let n: usize = runs.iter().map(Vec::len).sum();
    if n < 60 {
        return None;
    }
    let lags = ((10.0 * (n as f64).log10()) as usize).min(n / 5);
    let mean = runs.iter().flatten().sum::<f64>() / n as f64;
    let variance = runs.iter().flatten().map(|v| (v - mean) * (v - mean)).sum::<f64>();
    if variance.is_nan() || variance <= 0.0 {
        return None;
    }
    let (mut statistic, mut greatest) = (0.0, 0.0f64);
    let mut autocorrelation = Vec::with_capacity(lags);
    for lag in 1..=lags {
        let sum: f64 = runs
            .iter()
            .map(|r| (lag..r.len()).map(|k| (r[k] - mean) * (r[k - lag] - mean)).sum::<f64>())
            .sum();
        let r = sum / variance;
        autocorrelation.push(r);
        statistic += r * r / (n - lag) as f64;
        if r.abs() > greatest.abs() {
            greatest = r;
        }
    }
    statistic *= n as f64 * (n as f64 + 2.0);
    let p_value = chi_square_tail(statistic, lags as f64);
    let bound = 2.576 / (n as f64).sqrt();
    Some(Whiteness { lags, p_value, greatest, white: p_value > 0.01, autocorrelation, bound })
}

/// Measured and simulated signals of every part.
pub fn series(problem: &Problem, segments: &[Segment], runs: &Runs, role: Role) -> Vec<PartSeries> {
    let (m, p) = (problem.m(), problem.p());
    let vehicle = &problem.vehicle;
    segments
        .iter()
        .enumerate()
        .map(|(s, segment)| PartSeries {
            role,
            origin: segment.origin.clone(),
            t: (0..segment.steps).map(|k| segment.time(k)).collect(),
            period_s: segment.period_s,
            inputs: (0..m)
                .map(|j| {
                    let input = &vehicle.inputs[j];
                    let values = segment.inputs.iter().skip(j).step_by(m).copied().collect();
                    (input.name.clone(), input.unit.shown(), values)
                })
                .collect(),
            outputs: (0..p)
                .filter(|i| problem.weights[*i] > 0.0)
                .map(|i| OutputSeries {
                    name: vehicle.outputs[i].name.clone(),
                    unit: vehicle.outputs[i].unit.shown(),
                    measured: segment.output(i, p),
                    simulated: match &runs.simulated {
                        Some(outputs) => outputs[s].iter().skip(i).step_by(p).copied().collect(),
                        None => vec![f64::NAN; segment.steps],
                    },
                })
                .collect(),
        })
        .collect()
}

/// True when the start model from the data is stable by a margin: no pole in or on the right half plane.
pub fn stable_at_start(problem: &Problem, segments: &[Segment]) -> bool {
    let theta = start::candidates(problem, segments).pop().unwrap_or_else(|| start::given(problem));
    let rightmost = spectral_abscissa(&problem.vehicle_at(&theta).a);
    rightmost.is_ok_and(|rate| rate < -1e-3 / (problem.period_s * 1e3))
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Stream;

    #[test]
    fn white_noise_passes_and_coloured_does_not() {
        let mut stream = Stream::new(5, "white");
        let white: Vec<f64> = (0..2000).map(|_| stream.normal()).collect();
        assert!(whiteness(std::slice::from_ref(&white)).unwrap().white);
        let coloured: Vec<f64> = white.windows(2).map(|w| w[1] + 0.2 * w[0]).collect();
        assert!(!whiteness(&[coloured]).unwrap().white);
    }
}
