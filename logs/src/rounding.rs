//! Rounding of a sensor's values.

use crate::stats::median;

/// Values whose difference is at most this share of the largest are equal up to rounding of the arithmetic.
pub const SAME_VALUE: f64 = 1e-9;
/// Fewest levels of a rounded signal; fewer may be a switched one. Calibrated.
pub const MIN_LEVELS: usize = 3;

/// The step of which nearly all of some sorted values are multiples, if it is not finer than `least`; `None` where they are
/// not rounded, or too many to tell.
pub fn rounding_step(values: &[f64], least: f64) -> Option<f64> {
    let tiny = SAME_VALUE * values.last()?.abs().max(values.first()?.abs());
    let gaps: Vec<f64> = values.windows(2).map(|w| w[1] - w[0]).filter(|g| *g > tiny).collect();
    if gaps.len() < MIN_LEVELS - 1 || gaps.len() * 2 > values.len() {
        return None;
    }
    let smallest = gaps.iter().copied().fold(f64::INFINITY, f64::min);
    if smallest < least {
        return None;
    }
    // Gaps are multiples of the step; the value farthest from zero determines more digits.
    let singles: Vec<f64> = gaps.iter().copied().filter(|g| *g < 1.5 * smallest).collect();
    let mut step = median(&singles);
    let far =
        if values[0].abs() > values[values.len() - 1].abs() { values[0] } else { values[values.len() - 1] };
    let multiple = (far / step).round();
    if multiple != 0.0 && multiple.abs() < 1e4 {
        let refined = far / multiple;
        if (refined / step - 1.0).abs() < 0.01 {
            step = refined;
        }
    }
    let on = values.iter().filter(|v| (*v / step - (*v / step).round()).abs() < 0.02).count();
    (on * 10 >= values.len() * 9).then_some(step)
}
