//! Nonlinear effects on states: drag, cubic stiffness, Coulomb friction.
//!
//! The linear part is solved exactly by its exponential. Smooth nonlinearities are integrated around it with the
//! integrating-factor Runge-Kutta method of order 4 (Lawson, SIAM J. Numer. Anal. 4, 1967); the step is halved
//! until it is short against the nonlinearity and the linear part. Friction is a constant while a state keeps its
//! sign. Where a sign would change, the step is halved down to 1/4096 of a substep; there the friction force is
//! the one, within its limits, that ends the step at rest, so that sticking is sticking and nothing chatters.

use super::kernel::Kernel;
use super::schedule::Substep;
use crate::effects::{Effect, Kind, Place};

/// Deepest halving of a substep.
const DEEPEST: usize = 12;
/// Deepest halving for the sake of smooth nonlinearities.
const DEEPEST_SMOOTH: usize = 6;
/// Halvings that a substep must offer: Lawson's method looks at half a step of the deepest.
pub const LEVELS: usize = DEEPEST + 2;

#[derive(Debug, Clone)]
enum Smooth {
    /// state, coefficient
    Drag(usize, f64),
    /// from, onto, coefficient
    Cubic(usize, usize, f64),
}

#[derive(Debug, Clone)]
struct Friction {
    state: usize,
    /// Largest force against positive and against negative motion.
    against: (f64, f64),
    /// Acting over the present step.
    force: f64,
}

/// The nonlinear part of a vehicle.
#[derive(Debug, Clone)]
pub struct Nonlinear {
    n: usize,
    m: usize,
    smooth: Vec<Smooth>,
    friction: Vec<Friction>,
    /// Largest magnitude of a pole of the linear part, 1/s.
    fastest: f64,
    slopes: [Vec<f64>; 3],
    stage: Vec<f64>,
    middle: Vec<f64>,
    result: Vec<f64>,
    scratch: Vec<f64>,
    inputs: Vec<f64>,
}

impl Nonlinear {
    /// `None` when no effect is a nonlinear one. `padded` is the length of state slices.
    pub fn new(effects: &[(Effect, Place)], n: usize, m: usize, padded: usize, fastest: f64) -> Option<Self> {
        let mut smooth = Vec::new();
        let mut friction = Vec::new();
        for (effect, place) in effects {
            match (effect.kind(), *place) {
                (Kind::QuadraticDrag, Place::State(i)) => {
                    smooth.push(Smooth::Drag(i, effect.get("coefficient")))
                }
                (Kind::CubicStiffness, Place::StatePair(from, onto)) => {
                    smooth.push(Smooth::Cubic(from, onto, effect.get("coefficient")));
                }
                (Kind::CoulombFriction, Place::State(state)) => {
                    let (level, asymmetry) = (effect.get("level"), effect.get("asymmetry"));
                    friction.push(Friction {
                        state,
                        against: (level + asymmetry, level - asymmetry),
                        force: 0.0,
                    });
                }
                _ => {}
            }
        }
        // Several frictions on one state are one friction: their limits add.
        friction.sort_by_key(|f| f.state);
        friction.dedup_by(|b, a| {
            let same = a.state == b.state;
            if same {
                a.against = (a.against.0 + b.against.0, a.against.1 + b.against.1);
            }
            same
        });
        if smooth.is_empty() && friction.is_empty() {
            return None;
        }
        let zeros = || vec![0.0; padded];
        Some(Self {
            n,
            m,
            smooth,
            friction,
            fastest,
            slopes: std::array::from_fn(|_| zeros()),
            stage: zeros(),
            middle: zeros(),
            result: zeros(),
            scratch: zeros(),
            inputs: vec![0.0; m + n],
        })
    }

    /// Advances z over a substep under constant inputs (v, then the derivatives' own).
    pub fn advance(&mut self, substep: &Substep, z: &mut [f64], inputs: &[f64]) {
        let mut done = 0usize;
        // Progress in units of the deepest step; a step of level l is 2^(DEEPEST - l) of them.
        while done < 1 << DEEPEST {
            let mut level = self.level(substep.length_s, z).max(alignment(done));
            while !self.attempt(substep, level, z, inputs) {
                level += 1;
            }
            z.copy_from_slice(&self.result);
            done += 1 << (DEEPEST - level);
        }
    }

    /// How often the substep must be halved for its smooth part.
    fn level(&self, length_s: f64, z: &[f64]) -> usize {
        let slope = self.smooth.iter().map(|s| match *s {
            Smooth::Drag(i, c) => 2.0 * (c * z[i]).abs(),
            Smooth::Cubic(from, onto, c) if from == onto => (3.0 * c * z[from] * z[from]).abs(),
            // Across two states it is a stiffness, whose root is a frequency.
            Smooth::Cubic(from, _, c) => (3.0 * c * z[from] * z[from]).abs().sqrt(),
        });
        // The method's error is of fourth order in both; at these shares it is about 1e-7 of the signal. Drag has a kink, about
        // which the order is lower (see `attempt`): its steps are shorter against the linear part.
        let drag = self.smooth.iter().any(|s| matches!(s, Smooth::Drag(..)));
        let share = if drag { 0.0625 } else { 0.25 };
        let needed = (slope.sum::<f64>() / 0.05).max(self.fastest / share) * length_s;
        if needed <= 1.0 || self.smooth.is_empty() {
            return 0;
        }
        let mut level = 1;
        while level < DEEPEST_SMOOTH && needed > (1u32 << level) as f64 {
            level += 1;
        }
        level
    }

    /// One step of this level from `z` into `result`; false when it must be halved first.
    fn attempt(&mut self, substep: &Substep, level: usize, z: &[f64], inputs: &[f64]) -> bool {
        let levels = &substep.levels[level..];
        self.inputs.copy_from_slice(inputs);
        for f in &mut self.friction {
            let (positive, negative) = f.against;
            f.force = match z[f.state] {
                x if x > 0.0 => -positive,
                x if x < 0.0 => negative,
                _ => 0.0,
            };
            self.inputs[self.m + f.state] += f.force;
        }
        self.lawson(levels, substep.length_s * 0.5f64.powi(level as i32), z);
        // The second derivative of x abs(x) jumps at zero: the step that crosses it is made short.
        let kinked = |s: &Smooth| matches!(*s, Smooth::Drag(i, _) if self.result[i] * z[i] < 0.0);
        if level < DEEPEST_SMOOTH && self.smooth.iter().any(kinked) {
            return false;
        }
        self.friction.is_empty() || self.settle(&levels[0], z, level == DEEPEST)
    }

    /// Gives the friction of states at rest, or about to cross zero, the force that ends the step at rest.
    fn settle(&mut self, kernel: &Kernel, z: &[f64], deepest: bool) -> bool {
        let crosses = |result: &[f64], i: usize| z[i] != 0.0 && result[i] * z[i] <= 0.0;
        if !deepest && self.friction.iter().any(|f| crosses(&self.result, f.state)) {
            return false;
        }
        // The forces couple weakly through the other states within so short a time: a few sweeps suffice.
        let free = Set::of(self.friction.iter().map(|f| z[f.state] == 0.0 || crosses(&self.result, f.state)));
        let mut breaks_away = false;
        for sweep in 0..4 {
            let last = sweep == 3;
            for (index, f) in self.friction.iter_mut().enumerate() {
                if !free.contains(index) {
                    continue;
                }
                let own = kernel.gamma(f.state, self.m + f.state);
                if own <= 0.0 {
                    continue;
                }
                let wanted = f.force - self.result[f.state] / own;
                let force = wanted.max(-f.against.0).min(f.against.1);
                let change = force - f.force;
                f.force = force;
                for i in 0..self.n {
                    self.result[i] += kernel.gamma(i, self.m + f.state) * change;
                }
                if last && force == wanted {
                    self.result[f.state] = 0.0;
                }
                breaks_away |= last && force != wanted && z[f.state] == 0.0;
            }
        }
        deepest || !breaks_away
    }

    fn nonlinear(smooth: &[Smooth], z: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        for s in smooth {
            match *s {
                Smooth::Drag(i, c) => out[i] -= c * z[i] * z[i].abs(),
                Smooth::Cubic(from, onto, c) => out[onto] -= c * z[from] * z[from] * z[from],
            }
        }
    }

    /// Lawson's method of order 4 over a step h: levels[0] is the exact flow over h, levels[1] over h/2.
    ///
    /// Written with the flow F of half a step alone, which is affine: F(z + d) = F(z) + Phi d.
    fn lawson(&mut self, levels: &[Kernel], h: f64, z: &[f64]) {
        let Self { smooth, slopes: [k1, k2, k3], stage, middle, result, scratch, inputs, .. } = self;
        result.copy_from_slice(z);
        if smooth.is_empty() {
            levels[0].advance(result, inputs, scratch);
            return;
        }
        let mut flow = |z: &mut [f64]| levels[1].advance(z, inputs, scratch);
        middle.copy_from_slice(z);
        flow(middle);
        Self::nonlinear(smooth, z, k1);
        add(stage, z, 0.5 * h, k1);
        flow(stage);
        Self::nonlinear(smooth, stage, k2);
        // F(z + h/6 k1) lies a third of the way from F(z) to F(z + h/2 k1).
        for ((r, m), s) in result.iter_mut().zip(&*middle).zip(&*stage) {
            *r = m + (s - m) / 3.0;
        }
        add(stage, middle, 0.5 * h, k2);
        Self::nonlinear(smooth, stage, k3);
        add(stage, middle, h, k3);
        flow(stage);
        for ((r, a), b) in result.iter_mut().zip(&*k2).zip(&*k3) {
            *r += h / 3.0 * (a + b);
        }
        flow(result);
        Self::nonlinear(smooth, stage, k1);
        for (r, k) in result.iter_mut().zip(&*k1) {
            *r += h / 6.0 * k;
        }
    }
}

/// sum = z + h k
fn add(sum: &mut [f64], z: &[f64], h: f64, k: &[f64]) {
    for ((s, z), k) in sum.iter_mut().zip(z).zip(k) {
        *s = z + h * k;
    }
}

/// The coarsest level whose steps begin at this position.
fn alignment(done: usize) -> usize {
    if done == 0 { 0 } else { DEEPEST - (done.trailing_zeros() as usize).min(DEEPEST) }
}

/// A set of small indices without allocation.
struct Set(u64);

impl Set {
    fn of(flags: impl Iterator<Item = bool>) -> Self {
        Self(flags.take(64).enumerate().fold(0, |set, (i, flag)| set | u64::from(flag) << i))
    }

    fn contains(&self, index: usize) -> bool {
        index >= 64 || self.0 >> index & 1 == 1
    }
}
