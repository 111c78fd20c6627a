//! Figures that compare one output with its simulation.

use super::comparison::{Interval, OutputComparison, OutputSeries};
use super::grid::Grid;
use whirlstand_logs::shown::ShownUnit;
use whirlstand_logs::spectrum::{Spectrum, peaks, welch};
use whirlstand_logs::stats::{correlation, mean, median, rms};

/// Computes the figures of one output from its signals.
pub fn figures(
    grid: &Grid,
    signals: &OutputSeries,
    diverged: bool,
    noise: f64,
    unit: ShownUnit,
) -> OutputComparison {
    let all: Vec<f64> = signals.measured.iter().zip(&signals.simulated).map(|(y, s)| y - s).collect();
    let known = |v: &[f64]| -> Vec<usize> { (0..v.len()).filter(|&k| v[k].is_finite()).collect() };
    let pick = |v: &[f64], at: &[usize]| -> Vec<f64> { at.iter().map(|&k| v[k]).collect() };

    let at = known(&signals.prediction_error);
    let predicted = pick(&signals.prediction_error, &at);
    let horizon_fit = fit(&pick(&signals.measured, &at), &predicted);
    let mut figures = OutputComparison {
        unit,
        fit: None,
        fit_bias_removed: None,
        rmse: None,
        bias: None,
        correlation: None,
        declared_noise: noise,
        horizon_fit,
        horizon_rmse: (!predicted.is_empty()).then(|| rms(&predicted)),
        worst: None,
        growth: None,
        lines: Vec::new(),
        quadratic_error: Vec::new(),
    };
    let at = known(&all);
    if diverged || at.is_empty() {
        return figures;
    }
    let (measured, simulated) = (pick(&signals.measured, &at), pick(&signals.simulated, &at));
    let residual = pick(&all, &at);
    let bias = mean(&residual);
    let centred: Vec<f64> = residual.iter().map(|e| e - bias).collect();
    figures.fit = fit(&measured, &residual);
    figures.fit_bias_removed = fit(&measured, &centred);
    figures.rmse = Some(rms(&residual));
    figures.bias = Some(bias);
    figures.correlation = Some(correlation(&measured, &simulated));
    let tenth = residual.len() - residual.len() / 10;
    let before = rms(&residual[..tenth]);
    figures.growth = (tenth < residual.len() && before > 0.0).then(|| rms(&residual[tenth..]) / before);
    let length = (grid.t.len() / 20).max((1.0 / grid.period_s) as usize).clamp(8, grid.t.len());
    let starts = (0..=grid.t.len() - length).step_by((length / 10).max(1));
    figures.worst = starts
        .filter_map(|start| interval(grid, &all, start, start + length))
        .reduce(|a, b| if b.mean_square > a.mean_square { b } else { a });
    figures.quadratic_error = (0..20)
        .filter_map(|i| interval(grid, &all, i * grid.t.len() / 20, (i + 1) * grid.t.len() / 20))
        .collect();
    figures.lines = peaks(&spectrum(&all, &signals.measured, grid.period_s), 3);
    figures
}

/// 100 (1 - norm(residual) / norm(measured - mean)); `None` when the measured signal never changes.
fn fit(measured: &[f64], residual: &[f64]) -> Option<f64> {
    let m = mean(measured);
    let spread: f64 = measured.iter().map(|y| (y - m) * (y - m)).sum();
    let error: f64 = residual.iter().map(|e| e * e).sum();
    // Rounding alone gives a constant signal a spread of this size.
    let rounding = (1e-13 * m).powi(2) * measured.len() as f64;
    (spread > rounding).then(|| 100.0 * (1.0 - (error / spread).sqrt()))
}

fn interval(grid: &Grid, residual: &[f64], from: usize, until: usize) -> Option<Interval> {
    let part: Vec<f64> = residual[from..until].iter().filter(|e| e.is_finite()).map(|e| e * e).collect();
    (!part.is_empty()).then(|| Interval {
        from_s: grid.t[from],
        until_s: grid.t[until - 1] + grid.period_s,
        mean_square: mean(&part),
    })
}

/// Spectrum of a residual at the sampling rate of its sensor: the steps of a held value have images at
/// multiples of that rate, which are not in the motion.
pub fn spectrum(residual: &[f64], measured: &[f64], period_s: f64) -> Spectrum {
    let mut fresh: Vec<usize> = Vec::new();
    for (k, y) in measured.iter().enumerate() {
        if y.is_finite() && fresh.last().is_none_or(|&last| measured[last] != *y) {
            fresh.push(k);
        }
    }
    let gaps: Vec<f64> = fresh.windows(2).map(|w| (w[1] - w[0]) as f64).collect();
    let every = median(&gaps).round().max(1.0);
    let regular = gaps.iter().filter(|gap| **gap == every).count() * 10 >= gaps.len() * 9;
    if every < 2.0 || !regular {
        return welch(&filled(residual), period_s);
    }
    let kept: Vec<f64> = residual.iter().skip(fresh[0]).step_by(every as usize).copied().collect();
    welch(&filled(&kept), every * period_s)
}

/// The residual with gaps interpolated linearly, as the spectrum needs it.
fn filled(residual: &[f64]) -> Vec<f64> {
    let mut out = residual.to_vec();
    let mut last: Option<usize> = None;
    for k in 0..out.len() {
        if !residual[k].is_finite() {
            continue;
        }
        let (start, from) = last.map_or((0, residual[k]), |l| (l + 1, residual[l]));
        let span = (k - start + 1) as f64;
        for (i, value) in out.iter_mut().enumerate().take(k).skip(start) {
            *value = from + (residual[k] - from) * (i - start + 1) as f64 / span;
        }
        last = Some(k);
    }
    if let Some(l) = last {
        let end = residual[l];
        out[l + 1..].iter_mut().for_each(|v| *v = end);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_test_harness::noise;

    #[test]
    fn a_slow_sensor_is_judged_at_its_own_rate() {
        // White noise at 10 Hz, held on a grid of 100 Hz: its spectrum has no line.
        for seed in 0..50 {
            let held: Vec<f64> = noise(1_200, seed).iter().flat_map(|e| [*e; 10]).collect();
            let s = spectrum(&held, &held, 0.01);
            assert!((s.frequency_hz.last().unwrap() - 5.0).abs() < 1e-9);
            assert!(peaks(&s, 3).is_empty(), "seed {seed}: {:?}", peaks(&s, 3));
        }
        // The same with values only where the sensor delivered a new one.
        let sparse: Vec<f64> =
            noise(1_200, 1).iter().flat_map(|e| [[*e; 1].as_slice(), &[f64::NAN; 9]].concat()).collect();
        assert!((spectrum(&sparse, &sparse, 0.01).frequency_hz.last().unwrap() - 5.0).abs() < 1e-9);
    }

    #[test]
    fn gaps_are_bridged_and_single_repetitions_change_nothing() {
        assert_eq!(filled(&[f64::NAN, 1.0, f64::NAN, 3.0, f64::NAN]), [1.0, 1.0, 2.0, 3.0, 3.0]);
        let y: Vec<f64> = noise(2_000, 4).iter().map(|e| (4.0 * e).round()).collect();
        assert_eq!(spectrum(&y, &y, 0.01), welch(&y, 0.01));
    }
}
