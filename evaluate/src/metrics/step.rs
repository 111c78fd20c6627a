//! Figures of the response to a step of the setpoint.

use serde::{Deserialize, Serialize};

use super::window::{Window, last_exit};

/// Response of one output to one step of its setpoint. Times count from the step; values are in the unit of the output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StepResponse {
    /// Time of the step, s.
    pub at_s: f64,
    /// End of the part that was judged: the next step, the next disturbance or the end of the run, s.
    pub until_s: f64,
    /// Value before the step: median over up to half a second before it.
    pub from: f64,
    /// New setpoint.
    pub to: f64,
    /// Time from 10 % to 90 % of the way, s (IEEE Std 181-2011); `None` when 90 % was not reached.
    pub rise_s: Option<f64>,
    /// Time until the output stays within `band` of the setpoint, s; `None` when it did not.
    pub settling_s: Option<f64>,
    /// Greatest excess beyond the setpoint, percent of the step; 0 when the noise could explain it.
    pub overshoot_percent: f64,
    /// Setpoint minus output, median over the last fifth of the part that was judged.
    pub steady_state_error: f64,
    /// Half-width of the settling band: 5 % of the step, or what the noise alone reaches if that is more.
    pub band: f64,
}

/// Judges the response to a step of the setpoint to `to` at `at_s`, until `until_s`. `t` ascends.
///
/// The way is counted from the measured value before the step to the setpoint, so a lasting error counts
/// against the response. Noise: the signal is smoothed only as far as its white noise makes it necessary, and
/// the band never is narrower than what that noise reaches (see `docs/metrics.md`).
///
/// `None` when fewer than eight samples lie in the part, or the step is smaller than the noise reaches.
pub fn step_response(t: &[f64], y: &[f64], at_s: f64, until_s: f64, to: f64) -> Option<StepResponse> {
    let window = Window::new(t, y, at_s, until_s)?;
    let rough = window.smoothed(0.0, 0.5);
    let wanted = 0.02 * (to - rough.quiet.level).abs();
    let part = window.smoothed(wanted, 0.5);
    let from = part.quiet.level;
    let way = to - from;
    if way.abs() <= part.reach {
        return None;
    }
    let progress: Vec<f64> = part.y.iter().map(|v| (v - from) / way).collect();
    let t10 = first_crossing(part.t, &progress, 0.1);
    let t90 = first_crossing(part.t, &progress, 0.9);
    let excess = progress.iter().fold(0.0f64, |m, p| m.max(p - 1.0));
    let band = (0.05 * way.abs()).max(part.reach);
    let error: Vec<f64> = part.y.iter().map(|v| v - to).collect();
    let tail = &error[error.len() - (error.len() / 5).max(1)..];
    Some(StepResponse {
        at_s,
        until_s: part.t[part.t.len() - 1],
        from,
        to,
        rise_s: t10.zip(t90).map(|(a, b)| b - a),
        settling_s: last_exit(part.t, &error, band).map(|exit| (exit - at_s).max(0.0)),
        overshoot_percent: if excess * way.abs() > part.reach { 100.0 * excess } else { 0.0 },
        steady_state_error: -whirlstand_logs::stats::median(tail),
        band,
    })
}

/// First time at which `progress` reaches `level`, interpolated.
fn first_crossing(t: &[f64], progress: &[f64], level: f64) -> Option<f64> {
    let i = progress.iter().position(|&p| p >= level)?;
    if i == 0 {
        return Some(t[0]);
    }
    let (p0, p1) = (progress[i - 1], progress[i]);
    Some(t[i - 1] + (t[i] - t[i - 1]) * (level - p0) / (p1 - p0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_test_harness::noise;

    /// Unit step response of `w^2 / (s^2 + 2 z w s + w^2)` at time `t`.
    fn second_order(z: f64, w: f64, t: f64) -> f64 {
        if t <= 0.0 {
            return 0.0;
        }
        let wd = w * (1.0 - z * z).sqrt();
        1.0 - (-z * w * t).exp() * ((wd * t).cos() + z / (1.0 - z * z).sqrt() * (wd * t).sin())
    }

    fn sampled(z: f64, w: f64, size: f64, offset: f64, noise_std: f64) -> (Vec<f64>, Vec<f64>) {
        let t: Vec<f64> = (0..12_000).map(|i| i as f64 * 1e-3).collect();
        let e = noise(t.len(), 7);
        let y = t
            .iter()
            .zip(&e)
            .map(|(&t, e)| offset + size * second_order(z, w, t - 1.0) + noise_std * e)
            .collect();
        (t, y)
    }

    #[test]
    fn closed_form_of_a_second_order_system() {
        for (z, w) in [(0.2, 3.0), (0.5, 4.0), (0.7, 2.0), (0.9, 5.0)] {
            for size in [1.0, -0.3] {
                let (t, y) = sampled(z, w, size, 2.0, 0.0);
                let r = step_response(&t, &y, 1.0, 12.0, 2.0 + size).unwrap();
                let overshoot = 100.0 * (-std::f64::consts::PI * z / (1.0f64 - z * z).sqrt()).exp();
                assert!(
                    (r.overshoot_percent - overshoot).abs() < 0.01,
                    "{z}: {} {overshoot}",
                    r.overshoot_percent
                );
                // Rise and settling of the closed form, by bisection and by search on a grid of 10 us.
                let fine = |i: usize| second_order(z, w, i as f64 * 1e-5);
                let first = |level: f64| (0..).find(|&i| fine(i) >= level).unwrap() as f64 * 1e-5;
                assert!((r.rise_s.unwrap() - (first(0.9) - first(0.1))).abs() < 1e-4, "{z}");
                let settled =
                    (0..1_100_000).rev().find(|&i| (fine(i) - 1.0).abs() > 0.05).unwrap() as f64 * 1e-5;
                assert!((r.settling_s.unwrap() - settled).abs() < 2e-3, "{z} {:?} {settled}", r.settling_s);
                assert!(r.steady_state_error.abs() < 0.01 * size.abs() && (r.from - 2.0).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn noise_moves_the_figures_only_a_little() {
        let (t, clean) = sampled(0.4, 4.0, 1.0, 0.0, 0.0);
        let (_, noisy) = sampled(0.4, 4.0, 1.0, 0.0, 0.05);
        let a = step_response(&t, &clean, 1.0, 12.0, 1.0).unwrap();
        let b = step_response(&t, &noisy, 1.0, 12.0, 1.0).unwrap();
        assert!((a.rise_s.unwrap() - b.rise_s.unwrap()).abs() < 0.03, "{a:?} {b:?}");
        assert!((a.overshoot_percent - b.overshoot_percent).abs() < 4.0, "{a:?} {b:?}");
        // The band is wider than without noise, so settling can only look earlier, never "not at all".
        let s = b.settling_s.unwrap();
        assert!(s <= a.settling_s.unwrap() + 0.15 && s > 0.3, "{a:?} {b:?}");
    }

    #[test]
    fn what_never_arrives_has_no_rise_and_no_settling_time() {
        let (t, y) = sampled(0.7, 4.0, 0.5, 0.0, 0.0);
        let r = step_response(&t, &y, 1.0, 12.0, 1.0).unwrap();
        assert_eq!((r.rise_s, r.settling_s), (None, None));
        assert!((r.steady_state_error - 0.5).abs() < 1e-3);
        assert_eq!(r.overshoot_percent, 0.0);
    }

    #[test]
    fn a_step_below_the_noise_is_not_judged() {
        let (t, y) = sampled(0.7, 4.0, 0.01, 0.0, 0.05);
        assert!(step_response(&t, &y, 1.0, 12.0, 0.01).is_none());
        assert!(step_response(&t, &y, 11.999, 12.0, 1.0).is_none(), "too few samples");
    }
}
