//! Nonlinear effects on states: drag, cubic stiffness, Coulomb friction.
//!
//! The linear part is solved exactly by its exponential. Smooth nonlinearities are integrated around it with the
//! integrating-factor Runge-Kutta method of order 4 (Lawson, SIAM J. Numer. Anal. 4, 1967); the step is halved
//! until it is short against the nonlinearity and the linear part. Friction is a constant while a state keeps its
//! sign. Where a sign would change, the step is halved down to 1/4096 of a substep; there the friction force is
//! the one, within its limits, that ends the step at rest, so that sticking is sticking and nothing chatters.

use nalgebra::DMatrix;
use whirlstand_linalg::spectral_radius;

use super::kernel::{Kernel, State, Work};
use super::lawson::{Smooth, Stages, lawson};
use super::schedule::Substep;
use super::switch::Switch;
use crate::effects::{Effect, Kind, Place};
use crate::error::SimulatorError;

/// Largest number of halvings of a substep.
const DEEPEST: usize = 12;
/// Largest number of halvings for smooth nonlinearities.
const DEEPEST_SMOOTH: usize = 6;
/// Largest product of a step and a pole that no smooth force acts on: the force follows such a motion, as one through the
/// lag of an actuator, by its values at three times of a step (Simpson). Of the part that decays within a step, exp(-4) at
/// this one, the integral is wrong by 1.5 % of the step.
const UPSTREAM_SHARE: f64 = 4.0;

#[derive(Debug, Clone)]
struct Friction {
    state: usize,
    /// Largest force against positive and against negative motion.
    against: (f64, f64),
    /// Force over the current step.
    force: f64,
}

/// An effect that is part of the friction on a state.
#[derive(Debug, Clone)]
struct Part {
    switch: Switch,
    state: usize,
    against: (f64, f64),
}

/// The nonlinear part of a vehicle.
#[derive(Debug, Clone)]
pub struct Nonlinear {
    n: usize,
    m: usize,
    smooths: Vec<(Switch, Smooth)>,
    parts: Vec<Part>,
    /// Smooth effects, active ones first, and the number of active ones.
    smooth: Vec<Smooth>,
    smooth_acting: usize,
    /// Their stages within a step.
    stages: Vec<Stages>,
    /// Friction, combined per state, active ones first, and the number of active ones.
    friction: Vec<Friction>,
    friction_acting: usize,
    /// Largest magnitude of a pole of the states that smooth forces act on, 1/s, and of the states upstream of those.
    fastest: (f64, f64),
    /// Inputs including the friction forces.
    inputs: Vec<f64>,
}

impl Nonlinear {
    /// `None` when no effect is nonlinear.
    pub fn new(effects: &[(Effect, Place)], n: usize, m: usize) -> Option<Self> {
        let (mut smooths, mut parts) = (Vec::new(), Vec::new());
        for (index, (effect, place)) in effects.iter().enumerate() {
            let switch = Switch::new(index, effect);
            match (effect.kind(), *place) {
                (Kind::QuadraticDrag, Place::State(i)) => {
                    smooths.push((switch, Smooth::Drag(i, effect.get("coefficient"))));
                }
                (Kind::CubicStiffness, Place::StatePair(from, onto)) => {
                    smooths.push((switch, Smooth::Cubic(from, onto, effect.get("coefficient"))));
                }
                (Kind::CoulombFriction, Place::State(state)) => {
                    let (level, asymmetry) = (effect.get("level"), effect.get("asymmetry"));
                    parts.push(Part { switch, state, against: (level + asymmetry, level - asymmetry) });
                }
                _ => {}
            }
        }
        if smooths.is_empty() && parts.is_empty() {
            return None;
        }
        // Whatever their order in the file, forces of different kinds add in the same order.
        smooths.sort_by_key(|(_, smooth)| matches!(smooth, Smooth::Cubic(..)));
        parts.sort_by_key(|part| part.state);
        let none = |part: &Part| Friction { state: part.state, against: (0.0, 0.0), force: 0.0 };
        let mut all = Self {
            n,
            m,
            smooth: smooths.iter().map(|(_, smooth)| *smooth).collect(),
            smooth_acting: 0,
            stages: vec![Stages::default(); smooths.len()],
            friction: parts.iter().map(none).collect(),
            friction_acting: 0,
            smooths,
            parts,
            fastest: (0.0, 0.0),
            inputs: vec![0.0; m + n],
        };
        all.choose(0.0);
        Some(all)
    }

    /// Makes the steps short against the poles of a linear part.
    ///
    /// # Errors
    /// Where the poles cannot be computed.
    pub fn follow(&mut self, a: &DMatrix<f64>) -> Result<(), SimulatorError> {
        let mut acted_on = vec![false; a.nrows()];
        for (_, smooth) in &self.smooths {
            let (Smooth::Drag(onto, _) | Smooth::Cubic(_, onto, _)) = *smooth;
            acted_on[onto] = true;
        }
        // As far as one state moves another.
        for _ in 0..a.nrows() {
            for i in 0..a.nrows() {
                acted_on[i] |= (0..a.ncols()).any(|j| acted_on[j] && a[(i, j)] != 0.0);
            }
        }
        let fastest_of = |among: bool| -> Result<f64, SimulatorError> {
            let states: Vec<usize> = (0..a.nrows()).filter(|i| acted_on[*i] == among).collect();
            let part = a.select_rows(&states).select_columns(&states);
            Ok(if states.is_empty() { 0.0 } else { spectral_radius(&part)? })
        };
        self.fastest = (self.fastest.0.max(fastest_of(true)?), self.fastest.1.max(fastest_of(false)?));
        Ok(())
    }

    /// True when an effect has a time window.
    pub fn has_windows(&self) -> bool {
        let parts = self.parts.iter().map(|part| &part.switch);
        self.smooths.iter().map(|(switch, _)| switch).chain(parts).any(|switch| !switch.is_always())
    }

    /// Selects the effects that act at `t`.
    pub fn choose(&mut self, t: f64) {
        self.smooth_acting = 0;
        for (_, smooth) in self.smooths.iter().filter(|(switch, _)| switch.is_on(t)) {
            self.smooth[self.smooth_acting] = *smooth;
            self.smooth_acting += 1;
        }
        self.friction_acting = 0;
        for part in self.parts.iter().filter(|part| part.switch.is_on(t)) {
            let (positive, negative) = part.against;
            match self.friction[..self.friction_acting].last_mut().filter(|f| f.state == part.state) {
                Some(f) => f.against = (f.against.0 + positive, f.against.1 + negative),
                None => {
                    let one = Friction { state: part.state, against: part.against, force: 0.0 };
                    self.friction[self.friction_acting] = one;
                    self.friction_acting += 1;
                }
            }
        }
    }

    /// Switches an effect; true if it is one of these.
    pub fn switch(&mut self, effect: usize, on: bool) -> bool {
        let parts = self.parts.iter_mut().map(|part| &mut part.switch);
        self.smooths.iter_mut().map(|(switch, _)| switch).chain(parts).any(|switch| switch.set(effect, on))
    }

    fn smooth(&self) -> &[Smooth] {
        &self.smooth[..self.smooth_acting]
    }

    fn friction(&self) -> &[Friction] {
        &self.friction[..self.friction_acting]
    }

    /// Number of halvings that a substep must provide: Lawson's method uses half a step of the deepest.
    pub fn levels(&self) -> usize {
        if self.parts.is_empty() { DEEPEST_SMOOTH + 2 } else { DEEPEST + 2 }
    }

    /// Advances z over a substep under constant inputs (v, then the derivatives' own).
    #[inline(always)]
    pub fn advance<V: State>(&mut self, substep: &Substep, z: &mut V, inputs: &[f64], work: &mut Work<V>) {
        // Progress in units of the deepest step; a step of level l is 2^(DEEPEST - l) of them.
        let mut done = 0usize;
        while done < 1 << DEEPEST {
            let mut level = self.level(substep.length_s, z.as_ref()).max(alignment(done));
            while !self.attempt(substep, level, z, inputs, work) {
                level += 1;
            }
            z.as_mut().copy_from_slice(work.result.as_ref());
            done += 1 << (DEEPEST - level);
        }
    }

    /// Number of halvings that the smooth part of a substep needs.
    #[inline(always)]
    fn level(&self, length_s: f64, z: &[f64]) -> usize {
        let slope = self.smooth().iter().map(|s| match *s {
            Smooth::Drag(i, c) => 2.0 * (c * z[i]).abs(),
            Smooth::Cubic(from, onto, c) if from == onto => (3.0 * c * z[from] * z[from]).abs(),
            // Between two states it is a stiffness, whose square root is a frequency.
            Smooth::Cubic(from, _, c) => (3.0 * c * z[from] * z[from]).abs().sqrt(),
        });
        // The method's error is of fourth order in both; at these shares it is about 1e-7 of the signal. Drag
        // has a kink, at which the order is lower (see `attempt`): its steps are shorter relative to the
        // linear part.
        let drag = self.smooth().iter().any(|s| matches!(s, Smooth::Drag(..)));
        let share = if drag { 0.0625 } else { 0.25 };
        let (own, upstream) = self.fastest;
        let needed = (slope.sum::<f64>() / 0.05).max(own / share).max(upstream / UPSTREAM_SHARE) * length_s;
        if needed <= 1.0 || self.smooth().is_empty() {
            return 0;
        }
        let mut level = 1;
        while level < DEEPEST_SMOOTH && needed > (1u32 << level) as f64 {
            level += 1;
        }
        level
    }

    /// One step of this level from `z` into the work's result; false when it must be halved first.
    #[inline(always)]
    fn attempt<V: State>(
        &mut self,
        substep: &Substep,
        level: usize,
        z: &V,
        inputs: &[f64],
        work: &mut Work<V>,
    ) -> bool {
        let levels = &substep.levels[level..];
        let h = substep.length_s / (1u32 << level) as f64;
        let rubs = self.friction_acting > 0;
        if rubs {
            self.rub(z.as_ref(), inputs);
        }
        let inputs = if rubs { &self.inputs } else { inputs };
        lawson(&self.smooth[..self.smooth_acting], &mut self.stages, levels, h, z, inputs, work);
        // The second derivative of x abs(x) jumps at zero: a step that crosses it must be short.
        let (result, z) = (work.result.as_mut(), z.as_ref());
        let kinked = |s: &Smooth| matches!(*s, Smooth::Drag(i, _) if result[i] * z[i] < 0.0);
        if level < DEEPEST_SMOOTH && self.smooth().iter().any(kinked) {
            return false;
        }
        self.friction().is_empty() || self.settle(&levels[0], z, result, level == DEEPEST)
    }

    /// Adds the friction forces, against each state's motion, to the inputs.
    fn rub(&mut self, z: &[f64], inputs: &[f64]) {
        let (given, rest) = self.inputs.split_at_mut(inputs.len());
        given.copy_from_slice(inputs);
        rest.fill(0.0);
        for f in &mut self.friction[..self.friction_acting] {
            let (positive, negative) = f.against;
            f.force = match z[f.state] {
                x if x > 0.0 => -positive,
                x if x < 0.0 => negative,
                _ => 0.0,
            };
            self.inputs[self.m + f.state] += f.force;
        }
    }

    /// Gives the friction of states at rest, or about to cross zero, the force that ends the step at rest.
    fn settle(&mut self, kernel: &Kernel, z: &[f64], result: &mut [f64], deepest: bool) -> bool {
        let crosses = |result: &[f64], i: usize| z[i] != 0.0 && result[i] * z[i] <= 0.0;
        if !deepest && self.friction().iter().any(|f| crosses(result, f.state)) {
            return false;
        }
        // The forces are weakly coupled through the other states within so short a time: a few sweeps
        // suffice, and one where there is only one.
        let is_free = |f: &Friction| z[f.state] == 0.0 || crosses(result, f.state);
        if !self.friction().iter().any(is_free) {
            return true;
        }
        let free = Set::of(self.friction().iter().map(is_free));
        let sweeps = if free.is_of_one() { 1 } else { 4 };
        let mut breaks_away = false;
        for sweep in 1..=sweeps {
            let last = sweep == sweeps;
            for (index, f) in self.friction[..self.friction_acting].iter_mut().enumerate() {
                if !free.contains(index) {
                    continue;
                }
                let own = kernel.gamma(f.state, self.m + f.state);
                if own <= 0.0 {
                    continue;
                }
                let wanted = f.force - result[f.state] / own;
                let force = wanted.max(-f.against.0).min(f.against.1);
                let change = force - f.force;
                f.force = force;
                for (i, r) in result[..self.n].iter_mut().enumerate() {
                    *r += kernel.gamma(i, self.m + f.state) * change;
                }
                if last && force == wanted {
                    result[f.state] = 0.0;
                }
                breaks_away |= last && force != wanted && z[f.state] == 0.0;
            }
        }
        deepest || !breaks_away
    }
}

/// The coarsest level whose steps can begin at this position.
fn alignment(done: usize) -> usize {
    if done == 0 { 0 } else { DEEPEST - (done.trailing_zeros() as usize).min(DEEPEST) }
}

/// A set of small indices without allocation.
struct Set(u64);

impl Set {
    fn of(flags: impl Iterator<Item = bool>) -> Self {
        Self(flags.take(64).enumerate().fold(0, |set, (i, flag)| set | u64::from(flag) << i))
    }

    fn is_of_one(&self) -> bool {
        self.0.count_ones() == 1
    }

    fn contains(&self, index: usize) -> bool {
        index >= 64 || self.0 >> index & 1 == 1
    }
}
