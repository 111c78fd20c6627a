//! Detects stretches of a record with an unmodelled disturbance.

use super::answer::Disturbed;
use super::data::Segment;
use super::problem::Problem;
use whirlstand_logs::stats::{median, rms};

/// Length of the window over which residuals are averaged, s.
const WINDOW_S: f64 = 0.25;
/// Ratio to the usual mean square from which a window is disturbed; it must also exceed what so few white
/// values reach.
const RATIO: f64 = 3.0;
const SIGMAS: f64 = 8.0;
/// Share of disturbed windows above which the model itself is wrong.
const LARGEST_SHARE: f64 = 0.25;

/// Finds the disturbed stretches of `segments`, in the order of time. `one_step[output][part]` are the
/// one-step residuals of the measured values of that output; where a filter used the first values of a part,
/// the residuals are those of its last values.
pub fn disturbed(problem: &Problem, segments: &[Segment], one_step: &[Vec<Vec<f64>>]) -> Vec<Disturbed> {
    let p = problem.p();
    let usual: Vec<f64> = one_step
        .iter()
        .map(|runs| 1.4826 * median(&runs.iter().flatten().map(|r| r.abs()).collect::<Vec<_>>()))
        .collect();
    let mut all = Vec::new();
    for (s, segment) in segments.iter().enumerate() {
        let length = ((WINDOW_S / segment.period_s).round() as usize).max(8);
        let windows = segment.steps / length;
        // The most unusual output of every window, with its ratio.
        let mut marks: Vec<Option<(usize, f64)>> = vec![None; windows];
        for i in (0..p).filter(|i| problem.weights[*i] > 0.0 && usual[*i] > 0.0) {
            let Some(run) = one_step[i].get(s) else { continue };
            let measured: Vec<usize> =
                (0..segment.steps).filter(|k| segment.outputs[k * p + i].is_finite()).collect();
            let steps = &measured[measured.len().saturating_sub(run.len())..];
            for (w, mark) in marks.iter_mut().enumerate() {
                let at = |step: usize| steps.partition_point(|k| *k < step);
                let values = run.get(at(w * length)..at((w + 1) * length)).unwrap_or_default();
                let square = (rms(values) / usual[i]).powi(2);
                let chance = 1.0 + SIGMAS * (2.0 / values.len().max(1) as f64).sqrt();
                if values.len() >= 4 && square > RATIO.max(chance) && mark.is_none_or(|m| square > m.1) {
                    *mark = Some((i, square));
                }
            }
        }
        if marks.iter().flatten().count() as f64 > LARGEST_SHARE * windows as f64 {
            return Vec::new();
        }
        let mut w = 0;
        while w < windows {
            let Some(mut worst) = marks[w] else {
                w += 1;
                continue;
            };
            let first = w;
            // A single quiet window does not end a stretch.
            while let Some(next) = (w + 1..(w + 3).min(windows)).find(|n| marks[*n].is_some()) {
                w = next;
                worst = marks[w].filter(|m| m.1 > worst.1).unwrap_or(worst);
            }
            all.push(Disturbed {
                from_s: segment.time(first * length),
                until_s: segment.time((w + 1) * length),
                output: problem.vehicle.outputs[worst.0].name.clone(),
                ratio: worst.1.sqrt(),
            });
            w += 1;
        }
    }
    all
}
