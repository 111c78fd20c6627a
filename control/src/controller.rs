//! Runs a designed law, one call per period.

pub(crate) mod lanes;
mod takeover;

use nalgebra::DMatrix;
use whirlstand_vehicle::LinearModel;

use crate::actuation::Actuation;
use crate::compensation::{self, Compensation, Declined};
use crate::design::{Design, Switching};
use crate::handover::Handover;
use crate::kernel::{Block, Packed, blocks};
use crate::options::AntiWindup;
use crate::outcome::Outcome;
use crate::target::Target;

/// Consecutive unusable estimates during which the last command is held; after that, neutral.
const HOLD_STEPS: u32 = 5;

/// Time constant of back-calculation for an integrator at a limit, s.
const TRACKING_TIME_S: f64 = 0.1;

/// Runs a [`Design`]: prediction over the delay, tracking, the law, limits, anti-windup.
///
/// A step allocates nothing, cannot panic and always leaves a finite command within the limits.
///
/// ```
/// use nalgebra::dmatrix;
/// use whirlstand_control::{Controller, Design, LawOptions, SampledPlant};
///
/// let plant = SampledPlant::new(dmatrix![0.0, 1.0; 0.0, 0.0], dmatrix![0.0; 1.0], 0.005).unwrap();
/// let design = Design::new(&plant, &LawOptions::named("lqr").unwrap()).unwrap();
/// let mut controller = Controller::new(&design);
/// let mut command = [0.0];
/// controller.step(&[0.1, 0.0], &[0.0, 0.0], 0, &mut command);
/// assert!(command[0] < 0.0);
/// ```
#[derive(Debug, Clone)]
pub struct Controller {
    /// Number of the vehicle's own states, and of all states of the sampled plant.
    n: usize,
    size: usize,
    m: usize,
    period_s: f64,
    actuation: Actuation,
    /// Step of the run at which the next command is computed.
    at: u64,
    phi: Packed,
    gamma: Packed,
    /// Feedback gain on the error, m x n; for sliding mode, that of the equivalent control.
    gain: Packed,
    integral: Vec<usize>,
    /// Feedback gain on the integrals, m x q.
    integral_gain: Packed,
    /// The feedback gain on the integrals, to decide whether an integrator winds up.
    integral_matrix: DMatrix<f64>,
    /// Back-calculation gain from the excess of the limits to the integrals, q x m column after column.
    back: Vec<f64>,
    anti_windup: AntiWindup,
    sliding: Option<Sliding>,
    target: Target,
    reference: Vec<f64>,
    steady_x: Vec<f64>,
    steady_u: Vec<f64>,
    in_force: Vec<f64>,
    integrals: Vec<f64>,
    /// States after the vehicle's own that follow from the commands: actuator states and past commands.
    memory: Vec<f64>,
    memory_at_neutral: Vec<f64>,
    /// Number of past commands of each input, which are set from the steady input.
    past: Vec<usize>,
    /// Estimated and known states.
    state: Vec<f64>,
    predicted: Vec<Block>,
    error: Vec<f64>,
    wanted: Vec<Block>,
    /// Factor on all feedback.
    loop_gain: f64,
    /// Test input, added to the law's demand.
    added: Vec<f64>,
    command: Vec<f64>,
    refusals: u32,
    handover: Handover,
}

/// Nonlinear part of sliding mode.
#[derive(Debug, Clone)]
struct Sliding {
    /// Surface matrix on the error, m x n, and on the integrals, m x q.
    surface: Packed,
    surface_integral: Packed,
    switching: Switching,
    s: Vec<Block>,
    /// Integral part of super-twisting, and its limit.
    twist: Vec<f64>,
    twist_limit: Vec<f64>,
}

impl Controller {
    /// A controller in its initial state: neutral command in force, zero integrals.
    pub fn new(design: &Design) -> Self {
        let plant = &design.plant;
        let (n, m, q) = (plant.own_count(), plant.input_count(), design.integral.len());
        let (motion, size) = (plant.state_count(), plant.size());
        let dt = plant.period_s();
        let actuation = Actuation::new(plant);
        let neutral = actuation.neutral.clone();
        let memory_at_neutral = plant.memory_at_rest(&neutral);
        let integral_gain = design.linear.memory_gain.columns(0, q).into_owned();
        let back_rate = (dt / TRACKING_TIME_S).min(1.0);
        let back = (&design.integral_tracking * back_rate).as_slice().to_vec();
        let (gain, integral_feedback, sliding) = match &design.sliding {
            None => (design.linear.gain.clone(), integral_gain, None),
            Some(law) => (
                law.equivalent.columns(0, size).into_owned(),
                law.equivalent.columns(size, q).into_owned(),
                Some(Sliding {
                    surface: Packed::new(&law.surface.columns(0, size).into_owned()),
                    surface_integral: Packed::new(&law.surface.columns(size, q).into_owned()),
                    switching: law.switching.clone(),
                    s: vec![[0.0; 4]; blocks(m)],
                    twist: vec![0.0; m],
                    twist_limit: plant.inputs().iter().map(|i| i.authority()).collect(),
                }),
            ),
        };
        let mut controller = Self {
            n,
            size,
            m,
            period_s: dt,
            at: 0,
            phi: Packed::new(plant.transition()),
            gamma: Packed::new(plant.drive()),
            gain: Packed::new(&gain),
            integral: design.integral.clone(),
            integral_gain: Packed::new(&integral_feedback),
            integral_matrix: integral_feedback,
            back,
            anti_windup: design.anti_windup,
            sliding,
            target: Target::new(plant),
            reference: vec![0.0; motion],
            steady_x: vec![0.0; size],
            steady_u: vec![0.0; m],
            in_force: neutral.clone(),
            integrals: vec![0.0; q],
            memory: memory_at_neutral.clone(),
            memory_at_neutral,
            past: plant.delayed().map_or_else(Vec::new, |model| model.layout.commands.clone()),
            state: vec![0.0; size],
            predicted: vec![[0.0; 4]; blocks(size)],
            error: vec![0.0; size],
            wanted: vec![[0.0; 4]; blocks(m)],
            loop_gain: 1.0,
            added: vec![0.0; m],
            command: neutral.clone(),
            refusals: 0,
            handover: Handover::new(design),
            actuation,
        };
        controller.reset();
        controller
    }

    /// Resets to the initial state: neutral command in force, zero integrals and reference.
    pub fn reset(&mut self) {
        self.at = 0;
        self.actuation.reset();
        self.in_force.copy_from_slice(&self.actuation.neutral);
        self.memory.copy_from_slice(&self.memory_at_neutral);
        self.integrals.fill(0.0);
        self.added.fill(0.0);
        self.loop_gain = 1.0;
        self.reference.fill(0.0);
        self.target.track(0);
        self.refusals = 0;
        self.handover.reset();
        if let Some(sliding) = &mut self.sliding {
            sliding.twist.fill(0.0);
        }
        self.aim();
    }

    /// Computes the steady states, input and past commands of the reference.
    fn aim(&mut self) {
        let motion = self.reference.len();
        let (states, past) = self.steady_x.split_at_mut(motion);
        self.target.evaluate(&self.reference, states, &mut self.steady_u);
        let commands =
            self.past.iter().zip(&self.steady_u).flat_map(|(count, u)| std::iter::repeat_n(*u, *count));
        past.iter_mut().zip(commands).for_each(|(p, u)| *p = u);
    }

    /// Enables compensation of nonlinear effects of `linear`: those requested, except those that are unsafe
    /// to compensate, which are returned.
    pub fn compensate(
        &mut self,
        design: &Design,
        linear: &LinearModel,
        asked: &[Compensation],
    ) -> Vec<Declined> {
        let judged = compensation::judge(design, linear, asked);
        self.actuation.compensate(judged.inverses, judged.friction);
        self.reset();
        judged.declined
    }

    /// Sets the step of the run at which the next command is computed, where it does not follow the last one.
    pub fn set_step(&mut self, step: u64) {
        self.at = step;
    }

    /// Sets the command that the plant actually applies when it is not the last one (a failsafe, a restart).
    pub fn set_command_in_force(&mut self, u: &[f64]) {
        if u.len() == self.m && u.iter().all(|v| v.is_finite()) {
            self.in_force.copy_from_slice(u);
            self.actuation.take_off(&mut self.in_force);
        }
    }

    /// Sets a test input that is added to the law's demand before the limits, until it is changed: excites a
    /// vehicle in closed loop. Refused when it is not finite or not as long as the plant has inputs.
    pub fn set_test_input(&mut self, u: &[f64]) {
        if u.len() == self.m && u.iter().all(|v| v.is_finite()) {
            self.added.copy_from_slice(u);
        }
    }

    /// Multiplies all feedback of the law before the limits, until it is changed or reset, to show the
    /// remaining gain margin. The steady input of the reference is not multiplied. Refused when it is not
    /// finite.
    pub fn set_loop_gain(&mut self, factor: f64) {
        if factor.is_finite() {
            self.loop_gain = factor;
        }
    }

    /// The state predicted by the last step for the time at which its command begins to act.
    pub fn predicted(&self) -> &[f64] {
        &self.predicted.as_flattened()[..self.n]
    }

    /// The last step's sliding variables, one per surface, input units times s; empty for the other laws.
    pub fn sliding_variables(&self) -> &[f64] {
        self.sliding.as_ref().map_or(&[], |s| &s.s.as_flattened()[..self.m])
    }

    /// Computes the command for the next period from the estimate of this one.
    ///
    /// `estimate` and `reference` have n entries, `out` m; bit i of `tracked` means that state i follows its
    /// reference. With no tracked state the law regulates to the reference of the states that can rest
    /// anywhere (positions) and to zero. The command of the previous step is taken as the one in force.
    pub fn step(&mut self, estimate: &[f64], reference: &[f64], tracked: u64, out: &mut [f64]) -> Outcome {
        let mut outcome =
            Outcome { reference_refused: !self.follow(reference, tracked), ..Outcome::default() };
        // The command being computed acts from the next step on.
        self.at = self.at.saturating_add(1);
        self.actuation.begin(self.at);
        if estimate.len() != self.n || estimate.iter().any(|v| !v.is_finite()) {
            outcome.estimate_refused = true;
            self.predict(&[]);
            self.hold();
        } else {
            self.predict(estimate);
            self.law();
            if self.loop_gain != 1.0 {
                let wanted = self.wanted.as_flattened_mut().iter_mut();
                wanted.zip(&self.steady_u).for_each(|(w, u)| *w = u + self.loop_gain * (*w - u));
            }
            self.wanted.as_flattened_mut().iter_mut().zip(&self.added).for_each(|(w, a)| *w += a);
            self.handover.add(self.wanted.as_flattened_mut());
            self.actuation.meet_friction(&self.predicted.as_flattened()[..self.n]);
            let wanted = self.wanted.as_flattened();
            outcome.saturated = self.actuation.limit(wanted, &self.in_force, &mut self.command);
            if self.command.iter().all(|v| v.is_finite()) {
                self.refusals = 0;
                self.remember(outcome.saturated);
            } else {
                // Finite but huge estimates can overflow inside the law.
                outcome.estimate_refused = true;
                self.hold();
            }
        }
        self.in_force.copy_from_slice(&self.command);
        let known = &self.predicted.as_flattened()[self.n..self.size];
        self.memory.copy_from_slice(known);
        out.iter_mut().zip(&self.command).for_each(|(o, c)| *o = *c);
        self.actuation.apply(out);
        outcome
    }

    fn hold(&mut self) {
        self.actuation.rest();
        self.refusals = self.refusals.saturating_add(1);
        let source = if self.refusals <= HOLD_STEPS { &self.in_force } else { &self.actuation.neutral };
        for (i, (c, v)) in self.command.iter_mut().zip(source).enumerate() {
            *c = v.max(self.actuation.lower[i]).min(self.actuation.upper[i]);
        }
    }

    /// Adopts a new reference; false when it is not usable.
    fn follow(&mut self, reference: &[f64], tracked: u64) -> bool {
        if reference.len() != self.n || reference.iter().any(|v| !v.is_finite()) {
            return false;
        }
        if tracked != self.target.tracked() || reference != &self.reference[..self.n] {
            self.target.track(tracked);
            self.reference[..self.n].copy_from_slice(reference);
            self.aim();
        }
        true
    }

    fn predict(&mut self, estimate: &[f64]) {
        // Without an estimate only the states that follow from the commands are meaningful and are updated.
        self.state[..self.n].fill(0.0);
        self.state.iter_mut().zip(estimate).for_each(|(s, e)| *s = *e);
        self.state[self.n..].copy_from_slice(&self.memory);
        self.predicted.fill([0.0; 4]);
        self.phi.add(&mut self.predicted, &self.state);
        self.gamma.add(&mut self.predicted, &self.in_force);
        let predicted = self.predicted.as_flattened();
        let (steady, freed) = (&self.steady_x, self.target.freed());
        for (i, error) in self.error.iter_mut().enumerate() {
            *error = if freed.get(i).is_some_and(|f| *f) { 0.0 } else { predicted[i] - steady[i] };
        }
    }

    fn law(&mut self) {
        self.wanted.as_flattened_mut()[..self.m].copy_from_slice(&self.steady_u);
        self.gain.subtract(&mut self.wanted, &self.error);
        self.integral_gain.subtract(&mut self.wanted, &self.integrals);
        let Some(sliding) = &mut self.sliding else { return };
        sliding.s.fill([0.0; 4]);
        sliding.surface.add(&mut sliding.s, &self.error);
        sliding.surface_integral.add(&mut sliding.s, &self.integrals);
        let wanted = self.wanted.as_flattened_mut();
        for (i, s) in sliding.s.as_flattened().iter().enumerate().take(self.m) {
            wanted[i] -= match &sliding.switching {
                Switching::ConstantPlusProportional { rate, gain, layer } => {
                    rate * s + gain[i] * (s / layer[i]).clamp(-1.0, 1.0)
                }
                Switching::SuperTwisting { k1, layer, .. } => {
                    k1[i] * s / s.abs().max(layer[i]).sqrt() - sliding.twist[i]
                }
            };
        }
    }

    /// Updates integrals and super-twisting state for the next step.
    fn remember(&mut self, saturated: bool) {
        let q = self.integrals.len();
        let frozen = saturated && self.anti_windup == AntiWindup::Conditional && self.winds_up();
        if !frozen {
            for k in 0..q {
                self.integrals[k] += self.period_s * self.error[self.integral[k]];
            }
        }
        if saturated && self.anti_windup == AntiWindup::BackCalculation {
            for j in 0..self.m {
                let excess = self.wanted.as_flattened()[j] - self.command[j];
                for k in 0..q {
                    self.integrals[k] += self.back[j * q + k] * excess;
                }
            }
        }
        if let Some(sliding) = &mut self.sliding
            && let Switching::SuperTwisting { k2, layer, .. } = &sliding.switching
        {
            for i in 0..self.m {
                let step = -self.period_s * k2[i] * (sliding.s.as_flattened()[i] / layer[i]).clamp(-1.0, 1.0);
                let excess = self.wanted.as_flattened()[i] - self.command[i];
                if excess * step <= 0.0 {
                    let limit = sliding.twist_limit[i];
                    sliding.twist[i] = (sliding.twist[i] + step).clamp(-limit, limit);
                }
            }
        }
    }

    /// True when integrating this error would demand more beyond the limits.
    fn winds_up(&self) -> bool {
        let q = self.integrals.len();
        let mut push = 0.0;
        for k in 0..q {
            for i in 0..self.m {
                let excess = self.wanted.as_flattened()[i] - self.command[i];
                push -= self.integral_matrix[(i, k)] * self.error[self.integral[k]] * excess;
            }
        }
        push > 0.0
    }
}
