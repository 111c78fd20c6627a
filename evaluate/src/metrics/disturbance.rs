//! Figures of the recovery from a disturbance.

use serde::{Deserialize, Serialize};

use super::window::{Smoothed, Window, last_exit};

/// Recovery of one output from one disturbance; values in the unit of the output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recovery {
    /// Onset, s.
    pub at_s: f64,
    /// End of the part that was judged: the next disturbance, the next step of the setpoint or the end of the
    /// run, s.
    pub until_s: f64,
    /// Value that distances are counted from, at the onset: the setpoint with the error that stood before the onset, or
    /// without a setpoint the median over up to one second before the onset.
    pub baseline: f64,
    /// Greatest distance from the baseline.
    pub peak: f64,
    /// Time of the peak, s after the onset.
    pub peak_after_s: f64,
    /// Time from the onset until the output stays within `band` of the baseline, s; 0 when it never left the band,
    /// `None` when it did not come back.
    pub recovery_s: Option<f64>,
    /// Half-width of the band: 5 % of the peak, or what the motion before the onset reaches if that is more.
    pub band: f64,
    /// Integral of the absolute distance from the baseline over the part, unit of the output times s.
    pub iae: f64,
}

/// Length of the time before the onset that says where the output was, s.
const BEFORE_S: f64 = 1.0;

/// Judges one output from the onset of a disturbance at `at_s` until `until_s`. `t` ascends.
///
/// With a setpoint (`wanted`, one value a sample) the distance is counted from it: an output that was still on its
/// way there does not have to come back to where the disturbance met it. An error that stood before the onset
/// is not the disturbance's and is taken off; it stands when its median over the last half second before the
/// onset differs from that of the half second before by no more than a tenth, or than noise explains. Without a setpoint the
/// distance is counted from where the output was. Noise is treated as in [`super::step_response`].
///
/// `None` when fewer than eight samples lie in the part.
pub fn recovery(t: &[f64], y: &[f64], wanted: Option<&[f64]>, at_s: f64, until_s: f64) -> Option<Recovery> {
    // With a setpoint everything is judged on the error, so that a setpoint that moves is followed.
    let error: Option<Vec<f64>> = wanted.map(|w| y.iter().zip(w).map(|(y, w)| y - w).collect());
    let judged = error.as_deref().unwrap_or(y);
    let window = Window::new(t, judged, at_s, until_s)?;
    let rest = |part: &Smoothed<'_>| match wanted {
        Some(_) if !part.quiet.stands => 0.0,
        _ => part.quiet.level,
    };
    let level = rest(&window.smoothed(0.0, BEFORE_S));
    let raw_peak = window.values().iter().fold(0.0f64, |m, v| m.max((v - level).abs()));
    let part = window.smoothed(0.02 * raw_peak, BEFORE_S);
    let level = rest(&part);
    let distance: Vec<f64> = part.y.iter().map(|v| v - level).collect();
    let (mut peak, mut peak_at) = (0.0f64, 0);
    for (i, d) in distance.iter().enumerate() {
        if d.abs() > peak {
            (peak, peak_at) = (d.abs(), i);
        }
    }
    let band = (0.05 * peak).max(part.reach);
    let recovery_s = if peak <= part.reach {
        Some(0.0)
    } else {
        last_exit(part.t, &distance, band).map(|exit| (exit - at_s).max(0.0))
    };
    let onset = t.partition_point(|v| *v < at_s - 1e-9);
    Some(Recovery {
        at_s,
        until_s: part.t[part.t.len() - 1],
        baseline: level + wanted.and_then(|w| w.get(onset)).copied().unwrap_or(0.0),
        peak,
        peak_after_s: part.t[peak_at] - at_s,
        recovery_s,
        band,
        iae: super::integral(part.t, &distance, f64::abs),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_test_harness::noise;

    /// Impulse response of `1 / (s^2 + 2 z w s + w^2)`.
    fn impulse(z: f64, w: f64, t: f64) -> f64 {
        let wd = w * (1.0 - z * z).sqrt();
        if t < 0.0 { 0.0 } else { (-z * w * t).exp() * (wd * t).sin() / wd }
    }

    fn record(z: f64, w: f64, noise_std: f64) -> (Vec<f64>, Vec<f64>) {
        let t: Vec<f64> = (0..12_000).map(|i| i as f64 * 1e-3).collect();
        let e = noise(t.len(), 11);
        let y = t.iter().zip(&e).map(|(&t, e)| 0.4 + impulse(z, w, t - 6.0) + noise_std * e).collect();
        (t, y)
    }

    #[test]
    fn closed_form_of_an_impulse() {
        for (z, w) in [(0.2f64, 3.0), (0.6, 4.0), (0.9, 2.0)] {
            let (t, y) = record(z, w, 0.0);
            let r = recovery(&t, &y, None, 6.0, 12.0).unwrap();
            // The derivative vanishes where tan(wd t) = sqrt(1 - z^2) / z.
            let s = (1.0 - z * z).sqrt();
            let at = (s / z).atan() / (w * s);
            assert!(
                (r.peak_after_s - at).abs() < 1.1e-3 && (r.peak - impulse(z, w, at)).abs() < 1e-6,
                "{r:?}"
            );
            let band = 0.05 * impulse(z, w, at);
            let back = (0..600_000).rev().find(|&i| impulse(z, w, i as f64 * 1e-5).abs() > band).unwrap()
                as f64
                * 1e-5;
            assert!((r.recovery_s.unwrap() - back).abs() < 2e-3, "{r:?} {back}");
            assert!((r.baseline - 0.4).abs() < 1e-12);
        }
    }

    #[test]
    fn noise_neither_hides_nor_invents_a_recovery() {
        let (t, clean) = record(0.6, 4.0, 0.0);
        let (_, noisy) = record(0.6, 4.0, 0.005);
        let (a, b) =
            (recovery(&t, &clean, None, 6.0, 12.0).unwrap(), recovery(&t, &noisy, None, 6.0, 12.0).unwrap());
        assert!((a.peak - b.peak).abs() < 0.1 * a.peak, "{a:?} {b:?}");
        let back = b.recovery_s.unwrap();
        assert!(back > 0.4 && back <= a.recovery_s.unwrap() + 0.1, "{a:?} {b:?}");
    }

    #[test]
    fn an_output_that_only_carries_noise_never_left() {
        let t: Vec<f64> = (0..6_000).map(|i| i as f64 * 2e-3).collect();
        // The band is drawn for 5 % of the records to leave it, seldom, by chance.
        let left = (0..100)
            .filter(|&seed| {
                let y: Vec<f64> = noise(t.len(), seed).iter().map(|e| 0.1 * e).collect();
                recovery(&t, &y, None, 6.0, 12.0).unwrap().recovery_s != Some(0.0)
            })
            .count();
        assert!(left <= 5, "{left} of 100");
    }

    #[test]
    fn a_lasting_change_is_not_a_recovery() {
        let t: Vec<f64> = (0..1_200).map(|i| i as f64 * 1e-2).collect();
        let y: Vec<f64> = t.iter().map(|&t| if t < 6.0 { 0.0 } else { 1.0 - (6.0 - t).exp() }).collect();
        let r = recovery(&t, &y, None, 6.0, 12.0).unwrap();
        assert_eq!(r.recovery_s, None);
        assert!(r.peak > 0.99);
    }

    #[test]
    fn an_output_on_its_way_to_the_setpoint_comes_back_to_the_setpoint() {
        // Half a second before the gust the setpoint fell from 0.1 to 0; the output follows with 0.4 s.
        let t: Vec<f64> = (0..12_000).map(|i| i as f64 * 1e-3).collect();
        let wanted: Vec<f64> = t.iter().map(|&t| if t < 5.5 { 0.1 } else { 0.0 }).collect();
        let way = |t: f64| if t < 5.5 { 0.1 } else { 0.1 * ((5.5 - t) / 0.4).exp() };
        let y: Vec<f64> = t.iter().map(|&t| way(t) + impulse(0.6, 4.0, t - 6.0)).collect();
        assert_eq!(recovery(&t, &y, None, 6.0, 12.0).unwrap().recovery_s, None, "it never goes back there");
        let r = recovery(&t, &y, Some(&wanted), 6.0, 12.0).unwrap();
        assert_eq!(r.baseline, 0.0);
        let back = t.iter().zip(&y).rfind(|(_, y)| y.abs() > r.band).unwrap().0 - 6.0;
        assert!((r.recovery_s.unwrap() - back).abs() < 2e-3 && back < 2.5, "{r:?} {back}");
    }

    #[test]
    fn an_error_that_stood_before_is_not_the_disturbances() {
        let (t, y) = record(0.6, 4.0, 0.001);
        let wanted = vec![0.3; t.len()];
        let (a, b) =
            (recovery(&t, &y, None, 6.0, 12.0).unwrap(), recovery(&t, &y, Some(&wanted), 6.0, 12.0).unwrap());
        assert!((a.baseline - b.baseline).abs() < 1e-9 && (a.peak - b.peak).abs() < 1e-9, "{a:?} {b:?}");
        assert!((a.recovery_s.unwrap() - b.recovery_s.unwrap()).abs() < 1e-6, "{a:?} {b:?}");
    }

    #[test]
    fn a_setpoint_that_moves_is_followed() {
        let (t, y) = record(0.6, 4.0, 0.0);
        let ramp: Vec<f64> = t.iter().map(|t| 0.1 * t).collect();
        let moved: Vec<f64> = y.iter().zip(&ramp).map(|(y, w)| y - 0.4 + w).collect();
        let still = recovery(&t, &y, None, 6.0, 12.0).unwrap();
        let r = recovery(&t, &moved, Some(&ramp), 6.0, 12.0).unwrap();
        assert!((r.peak - still.peak).abs() < 1e-9 && (r.baseline - 0.6).abs() < 1e-9, "{r:?}");
        assert!((r.recovery_s.unwrap() - still.recovery_s.unwrap()).abs() < 1e-6, "{r:?} {still:?}");
    }
}
