//! One law over several simultaneous flights with the same reference. Every number is bit-identical to that
//! of [`Controller`] over the single flight; where that branches on a number, all branches are computed and
//! one is selected.

#![expect(clippy::needless_range_loop, reason = "a loop over lanes indexes several rows alike")]

use super::{Controller, Sliding};
use crate::actuation::{Actuation, NO_FRICTION};
use crate::design::Switching;
use crate::options::AntiWindup;

/// A [`Controller`] over K simultaneous flights.
#[derive(Debug, Clone)]
pub struct ControllerLanes<const K: usize> {
    /// The law, with everything that is common to all flights.
    law: Controller,
    in_force: Vec<[f64; K]>,
    integrals: Vec<[f64; K]>,
    /// Estimated and known states of each flight.
    state: Vec<[f64; K]>,
    predicted: Vec<[f64; K]>,
    error: Vec<[f64; K]>,
    wanted: Vec<[f64; K]>,
    command: Vec<[f64; K]>,
    s: Vec<[f64; K]>,
    twist: Vec<[f64; K]>,
}

/// Result of one step for each flight besides the command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OutcomeLanes<const K: usize> {
    /// True for a flight with at least one input at a limit of value or rate.
    pub saturated: [bool; K],
    /// True for a flight with an unusable estimate or command, for which a single controller has rules; its
    /// lane is invalid from now on.
    pub lost: [bool; K],
}

impl<const K: usize> ControllerLanes<K> {
    /// All flights in the state of `law`; `None` for a law with compensation, whose state differs between
    /// flights.
    pub fn new(law: &Controller) -> Option<Self> {
        if !law.actuation.is_plain() {
            return None;
        }
        let all = |values: &[f64]| values.iter().map(|v| [*v; K]).collect::<Vec<_>>();
        let (size, m) = (law.size, law.m);
        Some(Self {
            in_force: all(&law.in_force),
            integrals: all(&law.integrals),
            state: [vec![[0.0; K]; law.n], all(&law.memory)].concat(),
            predicted: vec![[0.0; K]; size],
            error: vec![[0.0; K]; size],
            wanted: vec![[0.0; K]; m],
            command: all(&law.command),
            s: vec![[0.0; K]; if law.sliding.is_some() { m } else { 0 }],
            twist: law.sliding.as_ref().map_or_else(Vec::new, |s| all(&s.twist)),
            law: law.clone(),
        })
    }

    /// Sets a test input as [`Controller::set_test_input`], the same for all flights.
    pub fn set_test_input(&mut self, u: &[f64]) {
        self.law.set_test_input(u);
    }

    /// Computes the commands as [`Controller::step`] for each flight.
    #[inline(always)]
    pub fn step(
        &mut self,
        estimate: &[[f64; K]],
        reference: &[f64],
        tracked: u64,
        out: &mut [[f64; K]],
    ) -> OutcomeLanes<K> {
        self.law.follow(reference, tracked);
        self.predict(estimate);
        self.want();
        let saturated = self.limit();
        let mut sum = [0.0; K];
        for row in estimate.iter().chain(&self.command) {
            for l in 0..K {
                // Zero, or NaN.
                sum[l] += 0.0 * row[l];
            }
        }
        self.remember(&saturated);
        self.in_force.copy_from_slice(&self.command);
        let (n, size) = (self.law.n, self.law.size);
        self.state[n..size].copy_from_slice(&self.predicted[n..size]);
        out.copy_from_slice(&self.command);
        self.law.actuation.apply_lanes(out);
        OutcomeLanes { saturated, lost: sum.map(f64::is_nan) }
    }

    #[inline(always)]
    fn predict(&mut self, estimate: &[[f64; K]]) {
        let law = &self.law;
        self.state[..law.n].copy_from_slice(estimate);
        self.predicted.fill([0.0; K]);
        law.phi.add_lanes(&mut self.predicted, &self.state);
        law.gamma.add_lanes(&mut self.predicted, &self.in_force);
        let freed = law.target.freed();
        for (i, error) in self.error.iter_mut().enumerate() {
            *error = if freed.get(i).is_some_and(|f| *f) {
                [0.0; K]
            } else {
                self.predicted[i].map(|p| p - law.steady_x[i])
            };
        }
    }

    #[inline(always)]
    fn want(&mut self) {
        let law = &self.law;
        self.wanted.iter_mut().zip(&law.steady_u).for_each(|(w, u)| *w = [*u; K]);
        law.gain.subtract_lanes(&mut self.wanted, &self.error);
        law.integral_gain.subtract_lanes(&mut self.wanted, &self.integrals);
        if let Some(sliding) = &law.sliding {
            self.s.fill([0.0; K]);
            sliding.surface.add_lanes(&mut self.s, &self.error);
            sliding.surface_integral.add_lanes(&mut self.s, &self.integrals);
            switch(sliding, &self.s, &self.twist, &mut self.wanted);
        }
        let factor = law.loop_gain;
        if factor != 1.0 {
            for (wanted, u) in self.wanted.iter_mut().zip(&law.steady_u) {
                *wanted = wanted.map(|w| u + factor * (w - u));
            }
        }
        for (wanted, added) in self.wanted.iter_mut().zip(&law.added) {
            *wanted = wanted.map(|w| w + added);
        }
    }

    #[inline(always)]
    fn limit(&mut self) -> [bool; K] {
        let law = &self.law;
        let mut saturated = [false; K];
        for i in 0..law.m {
            let Actuation { lower, upper, step, .. } = &law.actuation;
            let (step, lower, upper) = (step[i], lower[i], upper[i]);
            for l in 0..K {
                let wanted = self.wanted[i][l] + NO_FRICTION;
                let before = self.in_force[i][l] + NO_FRICTION;
                let reachable = wanted.max(before - step).min(before + step);
                let limited = reachable.max(lower).min(upper);
                saturated[l] |= limited != wanted;
                self.command[i][l] = if wanted.is_finite() { limited } else { f64::NAN };
            }
        }
        saturated
    }

    /// Updates integrals and super-twisting state for the next step.
    #[inline(always)]
    fn remember(&mut self, saturated: &[bool; K]) {
        let law = &self.law;
        let any = saturated.iter().fold(false, |any, s| any | s);
        let mut frozen = [false; K];
        if any && law.anti_windup == AntiWindup::Conditional {
            frozen = self.winds_up();
            frozen.iter_mut().zip(saturated).for_each(|(f, s)| *f &= s);
        }
        for (integral, state) in self.integrals.iter_mut().zip(&law.integral) {
            for l in 0..K {
                let next = integral[l] + law.period_s * self.error[*state][l];
                integral[l] = if frozen[l] { integral[l] } else { next };
            }
        }
        if any && law.anti_windup == AntiWindup::BackCalculation {
            let q = self.integrals.len();
            for j in 0..law.m {
                for k in 0..q {
                    for l in 0..K {
                        let excess = self.wanted[j][l] - self.command[j][l];
                        let next = self.integrals[k][l] + law.back[j * q + k] * excess;
                        self.integrals[k][l] = if saturated[l] { next } else { self.integrals[k][l] };
                    }
                }
            }
        }
        if let Some(sliding) = &law.sliding
            && let Switching::SuperTwisting { k2, layer, .. } = &sliding.switching
        {
            for i in 0..law.m {
                let limit = sliding.twist_limit[i];
                for l in 0..K {
                    let step = -law.period_s * k2[i] * (self.s[i][l] / layer[i]).clamp(-1.0, 1.0);
                    let excess = self.wanted[i][l] - self.command[i][l];
                    let next = (self.twist[i][l] + step).clamp(-limit, limit);
                    self.twist[i][l] = if excess * step <= 0.0 { next } else { self.twist[i][l] };
                }
            }
        }
    }

    /// Anti-windup condition as in [`Controller`].
    #[inline(always)]
    fn winds_up(&self) -> [bool; K] {
        let law = &self.law;
        let mut push = [0.0; K];
        for (k, state) in law.integral.iter().enumerate() {
            for i in 0..law.m {
                for l in 0..K {
                    let excess = self.wanted[i][l] - self.command[i][l];
                    push[l] -= law.integral_matrix[(i, k)] * self.error[*state][l] * excess;
                }
            }
        }
        push.map(|p| p > 0.0)
    }
}

/// Subtracts the switching part from the demand.
#[inline(always)]
fn switch<const K: usize>(sliding: &Sliding, s: &[[f64; K]], twist: &[[f64; K]], wanted: &mut [[f64; K]]) {
    for (i, (wanted, s)) in wanted.iter_mut().zip(s).enumerate() {
        match &sliding.switching {
            Switching::ConstantPlusProportional { rate, gain, layer } => {
                for l in 0..K {
                    wanted[l] -= rate * s[l] + gain[i] * (s[l] / layer[i]).clamp(-1.0, 1.0);
                }
            }
            Switching::SuperTwisting { k1, layer, .. } => {
                for l in 0..K {
                    wanted[l] -= k1[i] * s[l] / s[l].abs().max(layer[i]).sqrt() - twist[i][l];
                }
            }
        }
    }
}
