//! Resampling to a slower clock by a windowed sinc, without aliasing of frequencies above the new Nyquist frequency.

use std::f64::consts::PI;

use super::clock::{Clock, TOLERANCE};
use super::linear::interpolate;

/// Edges of the low-pass as shares of the new rate: flat up to the first, 60 dB down from the second on.
const PASS: f64 = 0.4;
const STOP: f64 = 0.5;
const ATTENUATION_DB: f64 = 60.0;

/// Filters a part of a signal on a grid that divides the clock's period, and then takes the points of the
/// clock.
pub(super) fn decimate(time: &[f64], values: &[f64], median: f64, clock: &Clock, out: &mut [f64]) {
    let ratio = (clock.period / median - TOLERANCE).ceil().max(2.0) as usize;
    let fine = clock.period / ratio as f64;
    let points = clock.within(time[0], time[time.len() - 1]);
    if points.is_empty() {
        return;
    }
    // The fine grid reaches to both ends of the part; point k of the clock is grid point `lead + (k - first) ratio`.
    let origin = clock.at(points.start);
    let lead = ((origin - time[0]) / fine + TOLERANCE).floor().max(0.0) as usize;
    let tail = ((time[time.len() - 1] - origin) / fine + TOLERANCE).floor().max(0.0) as usize;
    let grid: Vec<f64> = (0..=lead + tail)
        .map(|g| interpolate(time, values, origin + (g as f64 - lead as f64) * fine))
        .collect();
    let kernel = low_pass(ratio);
    let half = kernel.len() as isize / 2;
    for (n, k) in points.enumerate() {
        let centre = (lead + n * ratio) as isize;
        out[k] = kernel.iter().zip(-half..).map(|(h, d)| h * reflected(&grid, centre + d)).sum();
    }
}

/// A grid value; beyond an end, mirrored through the end point, so that a slope continues.
fn reflected(grid: &[f64], index: isize) -> f64 {
    let last = grid.len() as isize - 1;
    if index < 0 {
        2.0 * grid[0] - grid[(-index).min(last) as usize]
    } else if index > last {
        2.0 * grid[last as usize] - grid[(2 * last - index).max(0) as usize]
    } else {
        grid[index as usize]
    }
}

/// Filter taps of the low-pass for decimation by `ratio`; their sum is 1.
fn low_pass(ratio: usize) -> Vec<f64> {
    let ratio = ratio as f64;
    // Kaiser's formulas for length and shape.
    let transition = 2.0 * PI * (STOP - PASS) / ratio;
    let half = ((ATTENUATION_DB - 7.95) / (2.285 * transition) / 2.0).ceil();
    let beta = 0.1102 * (ATTENUATION_DB - 8.7);
    let cutoff = 0.5 * (PASS + STOP) / ratio;
    let taps: Vec<f64> = (-(half as isize)..=half as isize)
        .map(|n| {
            let n = n as f64;
            let x = 2.0 * PI * cutoff * n;
            let sinc = if n == 0.0 { 1.0 } else { x.sin() / x };
            sinc * bessel_i0(beta * (1.0 - (n / half).powi(2)).max(0.0).sqrt())
        })
        .collect();
    let sum: f64 = taps.iter().sum();
    taps.iter().map(|h| h / sum).collect()
}

/// Modified Bessel function of the first kind and order 0, by its power series.
fn bessel_i0(x: f64) -> f64 {
    let (mut term, mut sum) = (1.0, 1.0);
    for k in 1..60 {
        term *= (x / 2.0 / f64::from(k)).powi(2);
        sum += term;
        if term < 1e-17 * sum {
            break;
        }
    }
    sum
}
