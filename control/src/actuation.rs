//! From what a law wants of an input to the command: limits, trim, and the inverse of static effects.

use crate::sampled_plant::SampledPlant;

/// Farthest that a drifting gain is followed, to either side.
const FARTHEST_DRIFT: f64 = 2.0;

/// The factor on an input whose gain drifts by `drift` in a period, in the middle of the period that begins with step `step` of
/// the run; beyond a factor of two it is followed no more.
pub fn drifted(drift: f64, step: u64) -> f64 {
    if drift == 0.0 {
        1.0
    } else {
        (1.0 + drift * (step as f64 + 0.5)).clamp(1.0 / FARTHEST_DRIFT, FARTHEST_DRIFT)
    }
}

/// What flights side by side push against friction. It is added there as well, since -0 + 0 is 0.
pub const NO_FRICTION: f64 = 0.0;

/// What is taken back of the static effects on an input; sizes in commands counted from the trim.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inverse {
    /// What the gain drifts by in a period.
    pub drift: f64,
    /// Half-width of the dead zone, zero for none.
    pub dead_zone: f64,
    /// Half of the play, zero for none.
    pub half_play: f64,
    /// Part of the half-width over which either rises to its other side: a jump would chatter on noise.
    pub ramp: f64,
    /// What the input can do at all.
    pub lower: f64,
    /// See [`Self::lower`].
    pub upper: f64,
    /// Largest change of the input in a period.
    pub step: f64,
}

impl Inverse {
    /// Nothing is taken back.
    pub const NONE: Self = Self {
        drift: 0.0,
        dead_zone: 0.0,
        half_play: 0.0,
        ramp: 0.25,
        lower: f64::NEG_INFINITY,
        upper: f64::INFINITY,
        step: f64::INFINITY,
    };

    /// The smallest and largest value that a law may want of an input with these limits of its command, counted from the
    /// trim, and this factor on it.
    pub fn room(&self, (lower, upper): (f64, f64), trim: f64, factor: f64) -> (f64, f64) {
        let lower = (lower * factor - trim + self.dead_zone).max(self.lower) + self.half_play;
        let upper = (upper * factor - trim - self.dead_zone).min(self.upper) - self.half_play;
        (lower, upper)
    }
}

/// The smooth sign, of slope one over `width` at zero.
fn smooth_sign(x: f64, width: f64) -> f64 {
    x / x.hypot(width)
}

/// Feedforward against Coulomb friction.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrictionForward {
    /// State, level, asymmetry, and the width of the smooth sign.
    pub states: Vec<(usize, f64, f64, f64)>,
    /// What every input does against a unit of each state's friction, row after row.
    pub push: Vec<f64>,
}

/// Limits of the inputs as a law sees them, counted from the trim, and what is added behind the law.
#[derive(Debug, Clone)]
pub struct Actuation {
    /// Smallest values.
    pub lower: Vec<f64>,
    /// Largest values.
    pub upper: Vec<f64>,
    /// What stands for rest: zero, or the limit nearest to it.
    pub neutral: Vec<f64>,
    /// Largest change from one period to the next.
    pub step: Vec<f64>,
    /// The same of the command itself: smallest, largest, neutral, largest change.
    of_command: Vec<[f64; 4]>,
    /// The command at which an input does nothing.
    trim: Vec<f64>,
    /// Empty where nothing is taken back.
    inverses: Vec<Inverse>,
    friction: FrictionForward,
    /// Against friction, now and in force, in the law's units.
    against: Vec<f64>,
    against_before: Vec<f64>,
    /// Factor of the drift on the command that is computed now.
    factor: Vec<f64>,
    /// On which side of its play an input lies, from -1 to 1, and what was wanted of it last.
    side: Vec<f64>,
    last: Vec<f64>,
}

impl Actuation {
    /// That of a plant, which takes nothing back.
    pub fn new(plant: &SampledPlant) -> Self {
        let m = plant.input_count();
        let neutral = |i: &crate::InputLimits| 0f64.clamp(i.lower, i.upper);
        let of_command = plant.inputs().iter();
        let of_command: Vec<[f64; 4]> =
            of_command.map(|i| [i.lower, i.upper, neutral(i), i.rate * plant.period_s()]).collect();
        let counted = |end: usize| of_command.iter().zip(plant.trim()).map(|(c, t)| c[end] - t).collect();
        Self {
            lower: counted(0),
            upper: counted(1),
            neutral: counted(2),
            step: of_command.iter().map(|c| c[3]).collect(),
            trim: plant.trim().to_vec(),
            inverses: Vec::new(),
            friction: FrictionForward::default(),
            against: vec![0.0; m],
            against_before: vec![0.0; m],
            factor: vec![1.0; m],
            side: vec![0.0; m],
            last: vec![0.0; m],
            of_command,
        }
    }

    /// Takes back these effects, one inverse an input, and pushes against this friction.
    pub fn compensate(&mut self, inverses: Vec<Inverse>, friction: FrictionForward) {
        (self.inverses, self.friction) = (inverses, friction);
        self.reset();
    }

    /// True when it does no more than limit and trim.
    pub fn is_plain(&self) -> bool {
        self.inverses.is_empty() && self.friction.states.is_empty()
    }

    /// Back to the start of a run.
    pub fn reset(&mut self) {
        for memory in [&mut self.against, &mut self.against_before, &mut self.side, &mut self.last] {
            memory.fill(0.0);
        }
        self.begin(0);
    }

    /// Begins with the command that acts from step `step` of the run on.
    pub fn begin(&mut self, step: u64) {
        for (i, inverse) in self.inverses.iter().enumerate() {
            let factor = drifted(inverse.drift, step);
            let [lower, upper, neutral, change] = self.of_command[i];
            (self.lower[i], self.upper[i]) = inverse.room((lower, upper), self.trim[i], factor);
            self.neutral[i] = (neutral * factor - self.trim[i]).max(self.lower[i]).min(self.upper[i]);
            self.step[i] = (change * factor).min(inverse.step);
            self.factor[i] = factor;
        }
    }

    /// What friction will take of the motion `x`.
    pub fn meet_friction(&mut self, x: &[f64]) {
        let count = self.friction.states.len();
        if count == 0 {
            return;
        }
        self.against.fill(0.0);
        for (k, &(state, level, asymmetry, width)) in self.friction.states.iter().enumerate() {
            let force = level * smooth_sign(x[state], width) + asymmetry;
            for (i, against) in self.against.iter_mut().enumerate() {
                *against += self.friction.push[i * count + k] * force;
            }
        }
    }

    /// Pushes against no friction: without an estimate nobody knows where it pulls.
    pub fn rest(&mut self) {
        self.against.fill(0.0);
    }

    /// From what is wanted to what the actuators can do, given what is in force; true when these differ.
    pub fn limit(&self, wanted: &[f64], in_force: &[f64], command: &mut [f64]) -> bool {
        let mut saturated = false;
        for (i, command) in command.iter_mut().enumerate() {
            let (wanted, before) = (wanted[i] + self.against[i], in_force[i] + self.against_before[i]);
            let reachable = wanted.max(before - self.step[i]).min(before + self.step[i]);
            // A command in force outside the limits can only have been set from outside; the limits win.
            let limited = reachable.max(self.lower[i]).min(self.upper[i]);
            saturated |= limited != wanted;
            *command = if wanted.is_finite() { limited - self.against[i] } else { f64::NAN };
        }
        saturated
    }

    /// From a command that was set from outside to what the law takes it for.
    pub fn take_off(&mut self, u: &mut [f64]) {
        for (i, u) in u.iter_mut().enumerate() {
            *u = *u * self.factor[i] - self.trim[i];
        }
        self.against_before.fill(0.0);
    }

    /// From what the law wants, within the limits, to commands.
    pub fn apply(&mut self, u: &mut [f64]) {
        for (i, u) in u.iter_mut().enumerate() {
            *u += self.against[i];
            let Some(inverse) = self.inverses.get(i) else {
                *u += self.trim[i];
                continue;
            };
            if inverse.half_play > 0.0 {
                // The inverse of a play lies on the side to which the input moves (Tao and Kokotovic 1996).
                let moved = (*u - self.last[i]) / (inverse.ramp * inverse.half_play);
                self.side[i] = (self.side[i] + moved).clamp(-1.0, 1.0);
                self.last[i] = *u;
                *u += inverse.half_play * self.side[i];
            }
            if inverse.dead_zone > 0.0 {
                *u += inverse.dead_zone * (*u / (inverse.ramp * inverse.dead_zone)).clamp(-1.0, 1.0);
            }
            *u = (*u + self.trim[i]) / self.factor[i];
            // Rounding must not carry it across a limit.
            *u = u.max(self.of_command[i][0]).min(self.of_command[i][1]);
        }
        self.against_before.copy_from_slice(&self.against);
    }

    /// As [`Self::apply`] for K flights, where it is plain.
    #[inline(always)]
    pub fn apply_lanes<const K: usize>(&self, u: &mut [[f64; K]]) {
        u.iter_mut().zip(&self.trim).for_each(|(u, t)| *u = u.map(|u| u + NO_FRICTION + t));
    }
}
