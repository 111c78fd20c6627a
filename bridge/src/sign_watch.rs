//! Notices a vehicle that turns the other way than it is commanded, before it has gone far.
//!
//! The vehicle file says which angular acceleration the inputs that act make, and which the vehicle makes by itself. Over
//! windows of a tenth of a second the first is held against the change of the measured rates less the second. When for a
//! second of commands that can be told from noise both move against each other, and the vehicle goes away from where it is
//! asked to go, a sign is wrong somewhere between the controller and the motors. A gust has neither the size nor the duration
//! that the commands would have with their sign turned.

use std::time::Duration;

use crate::channels::Input;
use crate::turning::OwnMotion;

/// Length of a window.
const WINDOW: Duration = Duration::from_millis(100);

/// Windows that are looked at: a second.
const WINDOWS: usize = 10;

/// A window counts as commanded when it has so much of the largest one's command, ...
const EXCITED: f64 = 0.25;

/// ... and so many must be.
const FEWEST_EXCITED: usize = 6;

/// Correlation from which commands and answers move together, or against each other: of what the vehicle does not do by
/// itself by its file, and of all that it does, which no error of the file can turn.
const CORRELATED: f64 = 0.6;
const CORRELATED_AT_ALL: f64 = 0.3;

/// The answer's size per command with the sign turned: what is far from -1 is something else, such as a gust. The file may be
/// wrong by a factor of three.
const TURNED: std::ops::RangeInclusive<f64> = -3.0..=-0.33;

/// A vehicle that was moved less is not judged, rad.
const LEAST_TURN: f64 = 0.035;

/// A pause after which windows do not belong together.
const PAUSE: Duration = Duration::from_millis(300);

/// What a window has about one axis, rad/s.
#[derive(Debug, Clone, Copy, Default)]
struct Answer {
    /// What the inputs are to add to the rate.
    commanded: f64,
    /// What the rate changed.
    measured: f64,
    /// Of that, what the vehicle does not do by itself.
    forced: f64,
}

/// One axis, and what it did in the last second.
#[derive(Debug, Clone, Copy, Default)]
struct AxisWatch {
    answers: [Answer; WINDOWS],
    angles: [f64; WINDOWS],
    count: usize,
    right: bool,
}

/// What a window has about every axis: the changes of the rate that the inputs and the vehicle itself make, rad/s, and the
/// means of angle and rate.
#[derive(Debug, Clone, Copy, Default)]
struct Window {
    commanded: [f64; 3],
    own: [f64; 3],
    angle: [f64; 3],
    rate: [f64; 3],
}

/// The window that is open: its sums, and the two before it.
#[derive(Debug, Clone, Copy, Default)]
struct Open {
    began: Duration,
    at: Duration,
    sums: Window,
    before: [Option<Window>; 2],
}

/// Watches the sign of each axis while the controller is in charge.
#[derive(Debug, Clone)]
pub struct SignWatch {
    turns: Vec<[f64; 3]>,
    own: OwnMotion,
    axes: [AxisWatch; 3],
    open: Option<Open>,
    wrong: Option<usize>,
}

impl SignWatch {
    /// A watch of a vehicle with these inputs.
    pub fn new(inputs: &[Input], own: OwnMotion) -> Self {
        let turns = inputs.iter().map(|i| i.turns).collect();
        Self { turns, own, axes: [AxisWatch::default(); 3], open: None, wrong: None }
    }

    /// Begins anew, because somebody took charge or gave it up.
    pub fn reset(&mut self) {
        (self.axes, self.open, self.wrong) = ([AxisWatch::default(); 3], None, None);
    }

    /// The axis, 0 to 2, that answers with the wrong sign.
    pub fn wrong(&self) -> Option<usize> {
        self.wrong
    }

    /// Takes in the inputs that act from now on, and the attitude as it was measured last.
    pub fn observe(&mut self, inputs: &[f64], angles: [f64; 3], rates: Option<[f64; 3]>, now: Duration) {
        if self.wrong.is_some() || self.axes.iter().all(|a| a.right) {
            return;
        }
        let Some(open) = &mut self.open else {
            self.open = Some(Open { began: now, at: now, ..Open::default() });
            return;
        };
        if now.saturating_sub(open.at) > PAUSE {
            return self.reset();
        }
        let step = now.saturating_sub(open.at).as_secs_f64();
        open.at = now;
        // A link that tells no rates has those of the window before.
        let known = rates.unwrap_or_else(|| open.before[0].map_or([0.0; 3], |w| w.rate));
        for axis in 0..3 {
            let command = self.turns.iter().zip(inputs).map(|(turns, u)| turns[axis] * u);
            open.sums.commanded[axis] += command.sum::<f64>() * step;
            let state = angles.iter().chain(&known);
            open.sums.own[axis] += self.own[axis].iter().zip(state).map(|(a, x)| a * x).sum::<f64>() * step;
            open.sums.angle[axis] += angles[axis] * step;
            open.sums.rate[axis] += known[axis] * step;
        }
        if now.saturating_sub(open.began) >= WINDOW {
            self.close(rates.is_some(), now);
        }
    }

    fn close(&mut self, has_rates: bool, now: Duration) {
        let Some(Open { began, sums: mut window, before, .. }) = self.open.take() else { return };
        let span = now.saturating_sub(began).as_secs_f64();
        window.angle = window.angle.map(|sum| sum / span);
        window.rate = window.rate.map(|sum| sum / span);
        if let (false, Some(last)) = (has_rates, before[0]) {
            window.rate = std::array::from_fn(|i| (window.angle[i] - last.angle[i]) / span);
        }
        for (axis, watch) in self.axes.iter_mut().enumerate() {
            let Some(answer) = answer(axis, &window, before, has_rates) else { break };
            watch.take(answer, window.angle[axis]);
            if watch.is_turned() {
                self.wrong = Some(axis);
            }
        }
        self.open =
            Some(Open { began: now, at: now, sums: Window::default(), before: [Some(window), before[0]] });
    }
}

/// The newest answer about an axis. Between the means of two windows lies half of each; between the slopes of three, which
/// stand for rates where none are told, lies most of the one in the middle.
fn answer(axis: usize, window: &Window, before: [Option<Window>; 2], has_rates: bool) -> Option<Answer> {
    let last = before[0]?;
    let (oldest, weights) = match before[1] {
        _ if has_rates => (last, [0.5, 0.5, 0.0]),
        oldest => (oldest?, [1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0]),
    };
    let between = |of: fn(&Window) -> [f64; 3]| {
        weights.iter().zip([window, &last, &oldest]).map(|(weight, w)| weight * of(w)[axis]).sum::<f64>()
    };
    let measured = window.rate[axis] - last.rate[axis];
    Some(Answer { commanded: between(|w| w.commanded), measured, forced: measured - between(|w| w.own) })
}

impl AxisWatch {
    fn take(&mut self, answer: Answer, angle: f64) {
        self.answers.rotate_left(1);
        self.angles.rotate_left(1);
        (self.answers[WINDOWS - 1], self.angles[WINDOWS - 1]) = (answer, angle);
        self.count = (self.count + 1).min(WINDOWS);
        let (_, forced) = self.correlations();
        self.right |= self.is_excited() && forced > CORRELATED && TURNED.contains(&-self.size());
    }

    /// Whether enough of the windows are commanded.
    fn is_excited(&self) -> bool {
        let most = self.answers.iter().fold(0.0, |most: f64, a| most.max(a.commanded.abs()));
        let excited = self.answers.iter().filter(|a| a.commanded.abs() > EXCITED * most).count();
        most > 0.0 && self.count == WINDOWS && excited >= FEWEST_EXCITED
    }

    /// Correlation of the commands with the measured change, and with what of it the vehicle does not do by itself.
    fn correlations(&self) -> (f64, f64) {
        let sum = |f: fn(&Answer) -> f64| self.answers.iter().map(f).sum::<f64>();
        let commanded = sum(|a| a.commanded * a.commanded);
        let of = |cross: f64, own: f64| cross / (commanded * own).sqrt();
        (
            of(sum(|a| a.commanded * a.measured), sum(|a| a.measured * a.measured)),
            of(sum(|a| a.commanded * a.forced), sum(|a| a.forced * a.forced)),
        )
    }

    /// What the vehicle answers to one of the command: 1 where it is as its file says.
    fn size(&self) -> f64 {
        let sum = |f: fn(&Answer) -> f64| self.answers.iter().map(f).sum::<f64>();
        sum(|a| a.commanded * a.forced) / sum(|a| a.commanded * a.commanded)
    }

    /// Whether the vehicle answers against its commands, and goes away.
    fn is_turned(&self) -> bool {
        if self.right || !self.is_excited() {
            return false;
        }
        let (measured, forced) = self.correlations();
        let sum = |f: fn(&Answer) -> f64| self.answers.iter().map(f).sum::<f64>();
        let turn = self.angles[WINDOWS - 1] - self.angles[0];
        measured < -CORRELATED_AT_ALL
            && forced < -CORRELATED
            && TURNED.contains(&self.size())
            && turn.abs() > LEAST_TURN
            && turn * sum(|a| a.commanded) < 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::turning::{inputs_of, own_motion_of};
    use whirlstand_vehicle::{Stream, Vehicle};

    const STEP: Duration = Duration::from_millis(4);

    /// A flight of the quadrotor under a feedback of its attitude: when the watch was sure, and the greatest angle, rad.
    struct Flight {
        /// -1 for a motor order or a reversed channel.
        signs: [f64; 2],
        has_rates: bool,
        gust: f64,
        seed: u64,
    }

    impl Flight {
        fn fly(&self) -> (Option<f64>, f64) {
            let vehicle = Vehicle::builtin("quadrotor").unwrap();
            let (mut watch, mut noise) = (
                SignWatch::new(&inputs_of(&vehicle), own_motion_of(&vehicle)),
                Stream::new(self.seed, "flight"),
            );
            let (a, b) = (&vehicle.a, &vehicle.b);
            let mut x = nalgebra::DVector::from_element(4, 0.0);
            // It is not level when somebody arms.
            (x[0], x[2]) = (0.03 * noise.normal(), 0.03 * noise.normal());
            let (deg, mut most) = (1f64.to_radians(), 0.0f64);
            for k in 0..2500 {
                let now = STEP * (k + 1);
                let measured: Vec<f64> = x
                    .iter()
                    .zip([0.08, 0.4, 0.08, 0.4])
                    .map(|(x, sigma)| x + sigma * deg * noise.normal())
                    .collect();
                let asked = |i: usize| -(4.0 * measured[i] + 3.0 * measured[i + 1]);
                let roll = (asked(0) / b[(1, 0)]).clamp(-8.0, 8.0);
                let coupled = a[(3, 0)] * measured[0] + a[(3, 1)] * measured[1] + b[(3, 0)] * roll;
                let pitch = ((asked(2) - coupled) / b[(3, 1)]).clamp(-8.0, 8.0);
                let rates = self.has_rates.then_some([measured[1], measured[3], 0.0]);
                watch.observe(&[roll, pitch], [measured[0], measured[2], 0.0], rates, now);
                if watch.wrong().is_some() {
                    return (Some(now.as_secs_f64()), most);
                }
                let acts = nalgebra::DVector::from_vec(vec![roll * self.signs[0], pitch * self.signs[1]]);
                let mut dx = a * &x + b * acts;
                if (4.0..4.2).contains(&now.as_secs_f64()) {
                    dx[1] += self.gust;
                    dx[3] -= 0.5 * self.gust;
                }
                x += dx * STEP.as_secs_f64();
                most = most.max(x[0].abs()).max(x[2].abs());
            }
            (None, most)
        }
    }

    #[test]
    fn a_vehicle_that_obeys_is_let_fly_in_noise_and_gusts() {
        for seed in 0..100 {
            for has_rates in [true, false] {
                for gust in [0.0, 2.6, -2.6] {
                    let (at, _) = Flight { signs: [1.0; 2], has_rates, gust, seed }.fly();
                    assert_eq!(at, None, "seed {seed}, rates {has_rates}, gust {gust}");
                }
            }
        }
    }

    #[test]
    fn a_turned_sign_is_noticed_before_the_vehicle_is_far() {
        let (mut latest, mut farthest) = (0.0f64, 0.0f64);
        for seed in 0..50 {
            for signs in [[-1.0, 1.0], [-1.0, -1.0]] {
                let (at, most) = Flight { signs, has_rates: true, gust: 0.0, seed }.fly();
                let at = at.unwrap_or(f64::INFINITY);
                (latest, farthest) = (latest.max(at), farthest.max(most.to_degrees()));
                assert!(at < 10.0, "seed {seed}, {signs:?}: {:.1} deg", most.to_degrees());
            }
        }
        eprintln!("noticed after {latest:.1} s at the latest, at {farthest:.1} deg at most");
        assert!(latest < 3.0 && farthest < 25.0, "{latest} s, {farthest} deg");
    }
}
