//! Conversion of the law's demand on an input to the command: limits, trim, and the inverse of static
//! effects.

use crate::sampled_plant::SampledPlant;

/// Largest factor by which a drifting gain is compensated, in either direction.
const FARTHEST_DRIFT: f64 = 2.0;

/// Gain factor of an input that drifts by `drift` per period, at the middle of the period that begins with
/// step `step` of the run; limited to a factor of two.
pub fn drifted(drift: f64, step: u64) -> f64 {
    if drift == 0.0 {
        1.0
    } else {
        (1.0 + drift * (step as f64 + 0.5)).clamp(1.0 / FARTHEST_DRIFT, FARTHEST_DRIFT)
    }
}

/// Friction compensation of simultaneous flights, which have none. The zero is added nevertheless, since -0 +
/// 0 is 0.
pub const NO_FRICTION: f64 = 0.0;

/// Compensation of the static effects on an input; sizes in commands counted from the trim.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inverse {
    /// Relative drift of the gain per period.
    pub drift: f64,
    /// Half-width of the dead zone, zero for none.
    pub dead_zone: f64,
    /// Half of the backlash, zero for none.
    pub half_play: f64,
    /// Share of the half-width over which the inverse changes side smoothly: a jump would chatter on noise.
    pub ramp: f64,
    /// Smallest possible input.
    pub lower: f64,
    /// Largest possible input.
    pub upper: f64,
    /// Largest change of the input per period.
    pub step: f64,
}

impl Inverse {
    /// An inverse that compensates nothing.
    pub const NONE: Self = Self {
        drift: 0.0,
        dead_zone: 0.0,
        half_play: 0.0,
        ramp: 0.25,
        lower: f64::NEG_INFINITY,
        upper: f64::INFINITY,
        step: f64::INFINITY,
    };

    /// Smallest and largest demand of a law on an input with these command limits, counted from the trim, and
    /// with this gain factor.
    pub fn room(&self, (lower, upper): (f64, f64), trim: f64, factor: f64) -> (f64, f64) {
        let lower = (lower * factor - trim + self.dead_zone).max(self.lower) + self.half_play;
        let upper = (upper * factor - trim - self.dead_zone).min(self.upper) - self.half_play;
        (lower, upper)
    }
}

/// A smooth sign function with slope one over `width` at zero.
fn smooth_sign(x: f64, width: f64) -> f64 {
    x / x.hypot(width)
}

/// Feedforward against Coulomb friction.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrictionForward {
    /// For each state its index, level, asymmetry, and the width of the smooth sign.
    pub states: Vec<(usize, f64, f64, f64)>,
    /// Input per unit of each state's friction, inputs x states, row after row.
    pub push: Vec<f64>,
}

/// Limits of the inputs as a law sees them, counted from the trim, and the conversion of its demand to
/// commands.
#[derive(Debug, Clone)]
pub struct Actuation {
    /// Smallest values of the inputs.
    pub lower: Vec<f64>,
    /// Largest values of the inputs.
    pub upper: Vec<f64>,
    /// Rest values of the inputs: zero, or the limit nearest to it.
    pub neutral: Vec<f64>,
    /// Largest change of the inputs from one period to the next.
    pub step: Vec<f64>,
    /// Limits of each command itself: smallest, largest, neutral, largest change.
    of_command: Vec<[f64; 4]>,
    /// Command at which an input has no effect.
    trim: Vec<f64>,
    /// Inverses of the inputs; empty where nothing is compensated.
    inverses: Vec<Inverse>,
    friction: FrictionForward,
    /// Friction compensation of the new command and of the one in force, in the law's units.
    against: Vec<f64>,
    against_before: Vec<f64>,
    /// Drift factor of the command being computed.
    factor: Vec<f64>,
    /// Position of each input within its backlash, from -1 to 1, and its last demand.
    side: Vec<f64>,
    last: Vec<f64>,
}

impl Actuation {
    /// Conversion for a plant, without compensation.
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

    /// Enables the compensation of these effects, one inverse per input, and of this friction.
    pub fn compensate(&mut self, inverses: Vec<Inverse>, friction: FrictionForward) {
        (self.inverses, self.friction) = (inverses, friction);
        self.reset();
    }

    /// True when there is only limiting and trim.
    pub fn is_plain(&self) -> bool {
        self.inverses.is_empty() && self.friction.states.is_empty()
    }

    /// Resets to the start of a run.
    pub fn reset(&mut self) {
        for memory in [&mut self.against, &mut self.against_before, &mut self.side, &mut self.last] {
            memory.fill(0.0);
        }
        self.begin(0);
    }

    /// Begins the command that acts from step `step` of the run on.
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

    /// Computes the compensation of friction at the motion `x`.
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

    /// Sets the friction compensation to zero: without an estimate the direction of the friction is unknown.
    pub fn rest(&mut self) {
        self.against.fill(0.0);
    }

    /// Limits a demand to the possible commands, given the command in force; true when they differ.
    pub fn limit(&self, wanted: &[f64], in_force: &[f64], command: &mut [f64]) -> bool {
        let mut saturated = false;
        for (i, command) in command.iter_mut().enumerate() {
            let (wanted, before) = (wanted[i] + self.against[i], in_force[i] + self.against_before[i]);
            let reachable = wanted.max(before - self.step[i]).min(before + self.step[i]);
            // A command in force outside the limits can only have been set from outside; the limits have
            // priority.
            let limited = reachable.max(self.lower[i]).min(self.upper[i]);
            saturated |= limited != wanted;
            *command = if wanted.is_finite() { limited - self.against[i] } else { f64::NAN };
        }
        saturated
    }

    /// Converts a command that was set from outside to the law's demand.
    pub fn take_off(&mut self, u: &mut [f64]) {
        for (i, u) in u.iter_mut().enumerate() {
            *u = *u * self.factor[i] - self.trim[i];
        }
        self.against_before.fill(0.0);
    }

    /// Converts the law's demand, within the limits, to commands.
    pub fn apply(&mut self, u: &mut [f64]) {
        for (i, u) in u.iter_mut().enumerate() {
            *u += self.against[i];
            let Some(inverse) = self.inverses.get(i) else {
                *u += self.trim[i];
                continue;
            };
            if inverse.half_play > 0.0 {
                // The inverse of backlash is on the side to which the input moves (Tao and Kokotovic 1996).
                let moved = (*u - self.last[i]) / (inverse.ramp * inverse.half_play);
                self.side[i] = (self.side[i] + moved).clamp(-1.0, 1.0);
                self.last[i] = *u;
                *u += inverse.half_play * self.side[i];
            }
            if inverse.dead_zone > 0.0 {
                *u += inverse.dead_zone * (*u / (inverse.ramp * inverse.dead_zone)).clamp(-1.0, 1.0);
            }
            *u = (*u + self.trim[i]) / self.factor[i];
            // Rounding must not move the command across a limit.
            *u = u.max(self.of_command[i][0]).min(self.of_command[i][1]);
        }
        self.against_before.copy_from_slice(&self.against);
    }

    /// Converts demands as [`Self::apply`] for K flights, where nothing is compensated.
    #[inline(always)]
    pub fn apply_lanes<const K: usize>(&self, u: &mut [[f64; K]]) {
        u.iter_mut().zip(&self.trim).for_each(|(u, t)| *u = u.map(|u| u + NO_FRICTION + t));
    }
}
