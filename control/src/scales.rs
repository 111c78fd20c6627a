//! Default scales of the states, from their response to full input.

use nalgebra::DMatrix;

use crate::input_limits::InputLimits;

/// A tenth of the largest excursion that full steps on the inputs cause within two seconds; a thirtieth of
/// that within ten for a state on which no other depends, such as a position, because a slower outer loop
/// controls it.
pub fn default_scales(
    a: &DMatrix<f64>,
    phi: &DMatrix<f64>,
    gamma: &DMatrix<f64>,
    inputs: &[InputLimits],
    period_s: f64,
) -> Vec<f64> {
    let n = phi.nrows();
    let steps = |time: f64| (time / period_s).ceil().clamp(1.0, 20_000.0) as usize;
    let until: Vec<usize> = (0..n)
        .map(|j| if a.column(j).iter().all(|v| *v == 0.0) { steps(10.0) } else { steps(2.0) })
        .collect();
    let last = until.iter().copied().max().unwrap_or(0);
    let mut reach = vec![0f64; n];
    for (j, limits) in inputs.iter().enumerate() {
        let drive = gamma.column(j) * limits.authority();
        let mut x = nalgebra::DVector::<f64>::zeros(n);
        for k in 0..last {
            x = phi * x + &drive;
            for i in (0..n).filter(|&i| k < until[i]) {
                reach[i] = reach[i].max(x[i].abs());
            }
        }
    }
    let largest = reach.iter().copied().filter(|r| r.is_finite()).fold(0.0, f64::max);
    // A state that the inputs hardly move has the largest scale of the others: its own response is
    // practically zero, and dividing by it would leave only rounding of the others.
    let sized = |r: f64| match r {
        _ if largest == 0.0 => 1.0,
        r if r < 1e-6 * largest => largest,
        r => r,
    };
    let share = |i: usize| if until[i] == last && last > steps(2.0) { 1.0 / 30.0 } else { 0.1 };
    reach.iter().enumerate().map(|(i, r)| if r.is_finite() { share(i) * sized(*r) } else { 1.0 }).collect()
}
