//! Replay of the measurements: their prediction under another model.
//!
//! The replayed vehicle takes the states expected at the onset: an effect changes the motion from then on,
//! not the present state. Before the onset, for as long as a delay or a lag reaches back, the replayed
//! vehicle gets the recorded inputs and states, so that its delays hold the right values. The value that a
//! lag, a backlash or a rate limit holds at the onset is a separate parameter: it can change within a step as
//! much as the input does, so that the likelihoods of adjacent onsets would be unrelated.

use nalgebra::{DMatrix, DVector};
use whirlstand_vehicle::{Effect, Kind, Simulator, Vehicle, Window};

use crate::bank::Bank;
use crate::capture::Capture;
use crate::known::Knowledge;
use crate::predictor::Predictor;

/// Longest memory of a delay or lag, s: the longest delay that is searched for.
pub const REACH_S: f64 = 0.5;

/// The effect with its onset at a step.
pub fn from_step(effect: &Effect, step: u64, period_s: f64) -> Option<Effect> {
    let at_s = step as f64 * period_s;
    match effect.kind() {
        Kind::StepDisturbance | Kind::PulseDisturbance => {
            let mut moved = effect.clone();
            moved.set_parameter("at_s", at_s).ok()?;
            Some(moved)
        }
        Kind::ModeTransition => Effect::mode_transition(at_s, effect.text()?).ok(),
        // The onset is just before the step, so that the effect acts at the step itself despite rounding.
        _ => {
            let from_s = Some((at_s - 1e-9 * period_s).max(0.0));
            effect.clone().during(Window { from_s, until_s: None }).ok()
        }
    }
}

/// A hypothesis: an effect with its onset.
#[derive(Debug, Clone)]
pub struct Belief {
    pub effect: Effect,
    /// Step of the onset.
    pub since: u64,
    /// Value of its input that the effect holds at the onset; `None` for the input itself.
    pub stood: Option<f64>,
}

/// A predictor at the onset of an effect, with the effect in its model. `None` when the vehicle cannot have
/// the effect.
pub fn predictor(
    known: &Knowledge,
    like: &Predictor,
    capture: &Capture,
    belief: &Belief,
) -> Option<Predictor> {
    let Belief { effect, since, stood } = belief;
    let since = *since;
    let mut vehicle: Vehicle = known.vehicle.clone();
    vehicle.add_effect(from_step(effect, since, known.period_s)?).ok()?;
    let begin = since.saturating_sub((REACH_S / known.period_s) as u64).max(capture.first());
    let rest = capture.sample(begin);
    let mut simulator = Simulator::expected_from(&vehicle, known.period_s, rest.u).ok()?;
    simulator.begin_at(begin);
    simulator.set_engine(known.simulated_engine());
    simulator.set_state(capture.state(begin));
    let mut change = vec![0.0; known.scales.len()];
    let mut lateness = like.lateness().cloned();
    if let Some(lateness) = &mut lateness {
        lateness.begin(capture.age(since));
    }
    for step in begin..=since {
        for ((c, wanted), is) in change.iter_mut().zip(capture.state(step)).zip(simulator.state()) {
            *c = wanted - is;
        }
        simulator.correct(&change);
        if step < since {
            simulator.apply(capture.sample(step).u);
            if let Some(lateness) = &mut lateness {
                simulator.advance();
                lateness.expect(capture.sample(step).u, simulator.measure());
            } else {
                simulator.measure();
                simulator.advance();
            }
        }
    }
    if let Some(stood) = stood {
        simulator.put(known.vehicle.effects.len(), *stood);
    }
    Some(like.around(simulator, capture.errors(since), lateness))
}

/// Log-likelihood by which two hypotheses can be distinguished from the measurements until `end`.
pub fn distance(
    known: &Knowledge,
    like: &Predictor,
    capture: &Capture,
    (first, second): (&Belief, &Belief),
    end: u64,
) -> Option<f64> {
    let mut a = predictor(known, like, capture, first)?;
    let mut b = predictor(known, like, capture, second)?;
    let (from, other_from) = (first.since, second.since);
    let mut sum = 0.0;
    for step in from.min(other_from)..end {
        let sample = capture.sample(step);
        // Before its onset each hypothesis predicts without a change.
        let plain = capture.whitened(step);
        for (p, since) in [(&mut a, from), (&mut b, other_from)] {
            if step >= since {
                p.step_by(&sample, capture.gains(step));
            }
        }
        let of = |p: &Predictor, since: u64, i: usize| if step >= since { p.whitened()[i] } else { plain[i] };
        sum += (0..plain.len()).map(|i| (of(&a, from, i) - of(&b, other_from, i)).powi(2)).sum::<f64>();
    }
    Some(0.5 * sum)
}

/// Evaluation of an effect at given parameters, with the derivatives of the innovations with respect to each
/// of them.
pub struct Trial {
    /// A predictor at the parameters, and one more for each parameter with that parameter changed.
    predictors: Vec<Predictor>,
    moves: Vec<f64>,
    step: u64,
    end: u64,
    /// Sum of squared innovations without the effect; then with it (`with`), and its gradient and
    /// Gauss-Newton matrix.
    base: f64,
    with: f64,
    slope: DVector<f64>,
    curvature: DMatrix<f64>,
    samples: u64,
    /// Tests for a change that remains with the effect.
    check: Option<Bank>,
    /// Log-likelihood ratio of the clearest change that remains; 0 without one.
    pub left: f64,
}

impl Trial {
    /// `predictors`: one at the parameters, then one for each parameter, changed by its entry of `moves`.
    pub fn new(
        predictors: Vec<Predictor>,
        moves: Vec<f64>,
        since: u64,
        end: u64,
        check: Option<Bank>,
    ) -> Self {
        let count = moves.len();
        Self {
            predictors,
            moves,
            step: since,
            end,
            base: 0.0,
            with: 0.0,
            slope: DVector::zeros(count),
            curvature: DMatrix::zeros(count, count),
            samples: 0,
            check,
            left: 0.0,
        }
    }

    /// Cost of a step, in predictions.
    pub fn cost(&self) -> usize {
        self.predictors.len()
    }

    /// Advances by at most `steps` steps. Returns whether the end was reached.
    pub fn go_on(&mut self, capture: &Capture, steps: usize) -> bool {
        let until = self.end.min(self.step + steps as u64);
        let mut slopes = [[0.0; 64]; 3];
        while self.step < until {
            let sample = capture.sample(self.step);
            for predictor in &mut self.predictors {
                predictor.step_by(&sample, capture.gains(self.step));
            }
            let (first, moved) = self.predictors.split_at(1);
            let e = first[0].whitened();
            self.base += capture.whitened(self.step).iter().map(|v| v * v).sum::<f64>();
            self.with += e.iter().map(|v| v * v).sum::<f64>();
            for (k, predictor) in moved.iter().enumerate() {
                for ((s, a), b) in slopes[k].iter_mut().zip(predictor.whitened()).zip(e) {
                    *s = (a - b) / self.moves[k];
                }
                self.slope[k] += slopes[k].iter().zip(e).map(|(s, e)| s * e).sum::<f64>();
                for j in 0..=k {
                    let product =
                        slopes[k][..e.len()].iter().zip(&slopes[j]).map(|(a, b)| a * b).sum::<f64>();
                    self.curvature[(k, j)] += product;
                    self.curvature[(j, k)] = self.curvature[(k, j)];
                }
            }
            self.samples += u64::from(sample.fresh.count_ones());
            if let Some(bank) = &mut self.check {
                let alarm = bank.step(self.step, e, sample.y, sample.fresh);
                self.left = alarm.map_or(self.left, |alarm| self.left.max(alarm.evidence));
            }
            self.step += 1;
        }
        self.step >= self.end
    }

    /// Log-likelihood ratio against no change.
    pub fn evidence(&self) -> f64 {
        let evidence = 0.5 * (self.base - self.with);
        if evidence.is_finite() { evidence } else { f64::NEG_INFINITY }
    }

    /// Number of measurements used.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// The Gauss-Newton step from the present parameters, and the gain in evidence that it predicts. A
    /// parameter without any influence yet, such as a limit that is not reached, is left unchanged, so that
    /// the others are found.
    pub fn newton(&self) -> Option<(DVector<f64>, f64)> {
        let (mut curvature, mut slope) = (self.curvature.clone(), self.slope.clone());
        for k in self.unseen() {
            curvature[(k, k)] = 1.0;
            slope[k] = 0.0;
        }
        let step = curvature.cholesky()?.solve(&(-&slope));
        let gain = -0.5 * slope.dot(&step);
        step.iter().all(|v| v.is_finite()).then_some((step, gain))
    }

    /// Standard deviations of the parameters; infinite for a parameter without influence.
    pub fn spread(&self) -> Option<Vec<f64>> {
        let mut curvature = self.curvature.clone();
        self.unseen().for_each(|k| curvature[(k, k)] = 1.0);
        let inverse = curvature.cholesky()?.inverse();
        let mut spread: Vec<f64> = (0..self.moves.len()).map(|i| inverse[(i, i)].sqrt()).collect();
        self.unseen().for_each(|k| spread[k] = f64::INFINITY);
        Some(spread)
    }

    /// Indices of the parameters that change no prediction, whose rows are zero.
    fn unseen(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.moves.len()).filter(|k| self.curvature[(*k, *k)] == 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_that_is_not_reached_yet_does_not_keep_the_other_from_being_found() {
        let mut trial = Trial::new(Vec::new(), vec![0.1, 0.1], 0, 1, None);
        (trial.slope[0], trial.curvature[(0, 0)]) = (2.0, 4.0);
        let (step, gain) = trial.newton().expect("a step");
        assert_eq!((step.as_slice(), gain), (&[-0.5, 0.0][..], 0.5));
        assert_eq!(trial.spread().expect("a spread"), [0.5, f64::INFINITY]);
        // A step with a value that is not a number is rejected.
        trial.slope[0] = f64::NAN;
        assert!(trial.newton().is_none());
    }
}
