//! Forces that switch with a state, and come late: what drives a limit cycle.

use super::families::Signal;
use super::forces::Forces;
use super::screen::Frame;

/// Thresholds of the switch, as shares of a state's largest magnitude.
const THRESHOLDS: [f64; 5] = [0.02, 0.05, 0.1, 0.2, 0.4];
/// Dead times from the switch to its force, s.
const LATE_S: [f64; 9] = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0];
/// Switches of the grid that are refined.
const REFINED: usize = 3;
/// First steps of the refinement, in the threshold's logarithm and in seconds; each round has half of the last.
const STEPS: (f64, f64) = (0.4, 0.04);
const ROUNDS: usize = 4;
/// Relays that are simulated together.
const TOGETHER: usize = 24;

/// Numbers of a relay beside its size.
pub const NUMBERS: usize = 2;

/// A switch, and what its force does.
#[derive(Debug, Clone)]
pub struct Relay {
    /// Index of the state that it follows.
    pub follows: usize,
    /// Threshold, as a share of the state's largest magnitude.
    pub threshold: f64,
    /// Dead time, s.
    pub late_s: f64,
    /// Score in the frame: the reduction of the whitened sum of squares.
    pub score: f64,
    /// Size of its force in that unit which `forces` have.
    pub size: f64,
}

impl Relay {
    /// What its force does: "switches with pitch 0.50 s later".
    pub fn words(&self, states: &[Signal]) -> String {
        format!("switches with {} {:.2} s later", states[self.follows].name, self.late_s)
    }

    /// What its force does to the samples (filled).
    pub fn response(&self, frame: &Frame<'_>, forces: &Forces<'_>, states: &[Signal]) -> Option<Vec<f64>> {
        let late = self.late_s / frame.data().period_s;
        let force = switched(&states[self.follows].values, self.threshold, late);
        let mut response = forces.each(&[&force], |_, _, response| response).pop()?;
        frame.data().fill(&mut response);
        response.iter_mut().for_each(|r| *r *= self.size);
        Some(response)
    }
}

/// How many relays are tried for each state, without the refinement.
pub fn looks() -> usize {
    THRESHOLDS.len() * LATE_S.len()
}

/// The relay that explains most of a frame's residual.
pub fn likeliest(frame: &Frame<'_>, forces: &Forces<'_>, states: &[Signal], refine: bool) -> Option<Relay> {
    let grid = |follows: usize| {
        let all = THRESHOLDS.iter().flat_map(|t| LATE_S.iter().map(move |d| (*t, *d)));
        all.map(move |(threshold, late_s)| (follows, threshold, late_s))
    };
    let mut best = weighed(frame, forces, states, (0..states.len()).flat_map(grid).collect());
    if refine {
        let (mut wider, mut later) = STEPS;
        for _ in 0..ROUNDS {
            best.truncate(REFINED);
            let around = [-1.0, 0.0, 1.0];
            let near = best.iter().flat_map(|r| {
                let pairs = around.into_iter().flat_map(|a| around.map(|b| (a, b)));
                pairs.map(|(a, b)| {
                    (r.follows, r.threshold * f64::exp(a * wider), (r.late_s + b * later).max(0.0))
                })
            });
            best = weighed(frame, forces, states, near.collect());
            (wider, later) = (0.5 * wider, 0.5 * later);
        }
    }
    best.into_iter().next()
}

/// Relays of the given states, thresholds and dead times; the likeliest come first.
fn weighed(
    frame: &Frame<'_>,
    forces: &Forces<'_>,
    states: &[Signal],
    tried: Vec<(usize, f64, f64)>,
) -> Vec<Relay> {
    let period = frame.data().period_s;
    let mut all = Vec::new();
    for tried in tried.chunks(TOGETHER) {
        let functions: Vec<Vec<f64>> = tried
            .iter()
            .map(|(follows, threshold, late_s)| {
                switched(&states[*follows].values, *threshold, late_s / period)
            })
            .collect();
        let functions: Vec<&[f64]> = functions.iter().map(Vec::as_slice).collect();
        all.extend(forces.each(&functions, |_, index, mut response| {
            frame.data().fill(&mut response);
            let look = frame.look(&response);
            let (follows, threshold, late_s) = tried[index];
            Relay { follows, threshold, late_s, score: look.score, size: look.amplitude }
        }));
    }
    all.retain(|r| r.score.is_finite());
    all.sort_by(|a, b| b.score.total_cmp(&a.score));
    all
}

/// Plus one from where a signal rises above a threshold until it falls below minus that, then minus one; so many steps
/// late, and the mean over each step.
fn switched(signal: &[f64], threshold: f64, late: f64) -> Vec<f64> {
    // Where the signal crosses, between samples, and to which side.
    let mut turns: Vec<(f64, f64)> = Vec::new();
    let mut now = 0.0;
    for (k, x) in signal.iter().enumerate() {
        let side = x.signum();
        if x.abs() > threshold && side != now {
            let last = if k > 0 { signal[k - 1] } else { *x };
            let share =
                if x == &last { 0.0 } else { ((side * threshold - last) / (x - last)).clamp(0.0, 1.0) };
            turns.push((k.saturating_sub(1) as f64 + share + late, side));
            now = side;
        }
    }
    let mut values = vec![0.0; signal.len()];
    for (i, (from, side)) in turns.iter().enumerate() {
        let until = turns.get(i + 1).map_or(signal.len() as f64, |t| t.0);
        let (first, last) = (*from as usize, (until.ceil() as usize).min(signal.len()));
        for (k, value) in values.iter_mut().enumerate().take(last).skip(first) {
            let (begin, end) = (from.max(k as f64), until.min(k as f64 + 1.0));
            *value += side * (end - begin).max(0.0);
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use super::switched;

    #[test]
    fn a_switch_turns_between_samples_and_comes_late() {
        let signal: Vec<f64> = (0..9).map(|k| 1.0 - 0.5 * f64::from(k)).collect();
        // Above 0.25 at once; below -0.25 at 2.5 steps.
        let at_once = switched(&signal, 0.25, 0.0);
        assert_eq!(at_once[..5], [1.0, 1.0, 0.0, -1.0, -1.0]);
        let late = switched(&signal, 0.25, 1.75);
        assert_eq!(late[..7], [0.0, 0.25, 1.0, 1.0, -0.5, -1.0, -1.0]);
        // Inside the thresholds nothing changes.
        let still = switched(&[0.5, 0.1, -0.1, 0.1, -0.1], 0.2, 0.0);
        assert_eq!(still, [1.0; 5]);
    }
}
