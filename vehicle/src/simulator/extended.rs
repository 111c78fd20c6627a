//! Dynamics of a vehicle with effects on its motion: static effects of inputs, substeps of a period,
//! nonlinear parts.

use std::ops::Range;

use super::combinations::Combinations;
use super::disturbances::Disturbances;
use super::inputs::{Chain, Delay};
use super::kernel::{Kernel, State, Work};
use super::nonlinear::Nonlinear;
use super::rows::{BLOCK, Rows};
use super::schedule::{self, Flows};
use super::sensors::Sensors;
use super::settings::Settings;
use crate::effects::{Effect, Place};
use crate::error::SimulatorError;

/// Dynamics of a vehicle whose effects need more than one matrix product.
#[derive(Debug, Clone)]
pub struct Extended {
    period_s: f64,
    chains: Vec<Chain>,
    delays: Vec<Delay>,
    settings: Settings,
    nonlinear: Option<Nonlinear>,
    /// Inputs of a period that is one matrix product: those at its end, then those that change within it as they were
    /// at its beginning, as many as act.
    period: Vec<f64>,
    /// Actuator lags: index of the effect and of its state.
    lags: Vec<(usize, usize)>,
}

impl Extended {
    /// The dynamics; `neutral` are the commands until now.
    pub fn new(
        effects: &[(Effect, Place)],
        combinations: &Combinations,
        neutral: &[f64],
        period_s: f64,
        sensors: &Sensors,
        disturbances: &Disturbances,
    ) -> Result<Self, SimulatorError> {
        let (mut chains, mut delays) = (Vec::new(), Vec::new());
        for (i, &neutral) in neutral.iter().enumerate() {
            let own = effects.iter().enumerate().filter(move |(_, (_, p))| *p == Place::Input(i));
            let own = own.map(|(index, (e, _))| (index, e));
            let (chain, delay) = Chain::with_delay(own, neutral, period_s);
            delays.push(delay);
            chains.push(chain);
        }
        let mut nonlinear = Nonlinear::new(effects, combinations.all[0].system.n, neutral.len());
        if let Some(nonlinear) = &mut nonlinear {
            for (a, _) in combinations.all.iter().flat_map(|one| &one.system.stages) {
                nonlinear.follow(a)?;
            }
        }
        let levels = nonlinear.as_ref().map_or(1, Nonlinear::levels);
        let cuts = (&disturbances.events()[..], levels);
        let settings = Settings::new(combinations, effects, period_s, sensors, cuts, neutral.len())?;
        let lags = combinations.all[0].system.lags.clone();
        let period = vec![0.0; 2 * neutral.len()];
        Ok(Self { period_s, chains, delays, settings, nonlinear, period, lags })
    }

    /// True when an effect that acts within a step, not only on commands or outputs, can be switched.
    pub fn has_windows(&self) -> bool {
        !self.settings.is_one() || self.nonlinear.as_ref().is_some_and(Nonlinear::has_windows)
    }

    /// Selects the effects that act in a step. To be called at its beginning, and after switching by hand.
    pub fn choose(&mut self, step: u64, sensors: &mut Sensors) {
        if let Some(nonlinear) = &mut self.nonlinear {
            nonlinear.choose((step as f64 + 0.5) * self.period_s);
        }
        if self.settings.is_one() {
            return;
        }
        self.settings.choose(step);
        sensors.choose(self.settings.index());
        for (delay, chosen) in self.delays.iter_mut().zip(&self.settings.now().delays) {
            delay.choose(*chosen);
        }
    }

    /// The kernel of all periods but the special ones, and these; `None` where a period needs more than a
    /// matrix product: static effects or delays of inputs, splits, nonlinear parts, mode transitions.
    pub fn one_kernel(&self) -> Option<(&Kernel, impl Iterator<Item = u64>)> {
        let direct = self.chains.iter().all(Chain::is_empty) && self.delays.iter().all(Delay::is_none);
        let one = direct && self.nonlinear.is_none() && self.settings.is_one();
        if one { self.settings.now().schedule.one_kernel() } else { None }
    }

    /// True when all these steps, at least one, are the same flow of the states, whatever the inputs: in the linear part a product with one
    /// kernel, or with one for each substep within which nothing changes.
    pub fn is_steady(&mut self, steps: &Range<u64>, disturbances: &Disturbances, forced: bool) -> bool {
        if self.has_windows() || !disturbances.are_steady(steps) {
            return false;
        }
        if !self.settings.schedule().is_steady(steps) {
            return false;
        }
        let pushed = forced || !disturbances.are_none();
        match self.settings.schedule().flows(steps.start) {
            Flows::Whole(_) => !pushed,
            Flows::Parts(_) => self.delays.iter().all(|delay| delay.fraction_s == 0.0),
        }
    }

    /// The one kernel of steady steps, or their substeps; and the nonlinear part.
    pub fn flows(&mut self, step: u64) -> (Flows<'_>, Option<&mut Nonlinear>) {
        (self.settings.schedule().flows(step), self.nonlinear.as_mut())
    }

    /// Number of inputs of a period that is one matrix product, those before their changes included.
    pub fn period_inputs(&self) -> usize {
        self.chains.len() + self.delays.iter().filter(|delay| delay.fraction_s > 0.0).count()
    }

    /// Takes the commands of an input over the steps of a block, as [`Self::command`] those of all inputs.
    #[inline(always)]
    pub fn put_inputs(
        &mut self,
        input: usize,
        first: u64,
        mut next: impl FnMut(usize) -> f64,
        rows: &mut Rows,
    ) {
        let before = self.delays[..input].iter().filter(|delay| delay.fraction_s > 0.0).count();
        let before = self.chains.len() + before;
        let (chain, delay) = (&mut self.chains[input], &mut self.delays[input]);
        let changes = delay.fraction_s > 0.0;
        for row in 0..rows.length {
            let t = ((first + row as u64) as f64 + 0.5) * self.period_s;
            delay.push(chain.next(next(row), t));
            let period = &mut rows.periods[row * rows.width..][..rows.width];
            period[input] = delay.newer();
            if changes {
                period[before] = delay.older();
            }
            rows.inputs[input * BLOCK + row] = delay.first();
        }
    }

    /// Sets what has a memory of commands to where it is after these were held.
    pub fn rest_at(&mut self, commands: &[f64]) {
        for ((chain, delay), command) in self.chains.iter_mut().zip(&mut self.delays).zip(commands) {
            delay.rest_at(chain.rest_at(*command));
        }
    }

    /// Sets the resting inputs, and filters to their steady state.
    pub fn rest(&self, z: &mut [f64], drive: &mut [f64]) {
        for (value, delay) in drive.iter_mut().zip(&self.delays) {
            *value = delay.newer();
        }
        for rest in &self.settings.now().rests {
            z[rest.state] = rest.gain * rest.signal.value(z, drive);
        }
    }

    /// Sets the sensors' lags to their steady state for the vehicle's states. Actuator filters do not depend
    /// on these states.
    pub fn settle_sensors(&self, z: &mut [f64], drive: &[f64]) {
        for rest in self.settings.now().rests.iter().filter(|r| r.gain != 0.0) {
            z[rest.state] = rest.gain * rest.signal.value(z, drive);
        }
    }

    /// Takes the commands of the step whose middle is at `t`, and computes the inputs acting from its
    /// beginning.
    #[inline(always)]
    pub fn command(&mut self, applied: &[f64], t: f64, drive: &mut [f64]) {
        let links = self.chains.iter_mut().zip(&mut self.delays);
        for (((chain, delay), drive), applied) in links.zip(drive).zip(applied) {
            delay.push(chain.next(*applied, t));
            *drive = delay.first();
        }
    }

    /// Switches an effect; true if it exists. [`Self::choose`] applies the change.
    pub fn switch(&mut self, effect: usize, on: bool) -> bool {
        self.settings.switch(effect, on)
            || self.nonlinear.as_mut().is_some_and(|nonlinear| nonlinear.switch(effect, on))
            || self.chains.iter_mut().any(|chain| chain.switch(effect, on))
    }

    /// Sets the stored value of an effect on an input; true if it stores a single value.
    pub fn put(&mut self, effect: usize, value: f64, z: &mut [f64]) -> bool {
        match self.lags.iter().find(|(own, _)| *own == effect) {
            Some((_, state)) => z[*state] = value,
            None => return self.chains.iter_mut().any(|chain| chain.put(effect, value)),
        }
        true
    }

    /// Keeps the states of inactive filters equal to their signals, so that nothing jumps when they begin.
    fn follow(&self, z: &mut [f64], drive: &[f64]) {
        for rest in self.settings.now().rests.iter().filter(|rest| rest.follows) {
            z[rest.state] = rest.gain * rest.signal.value(z, drive);
        }
    }

    /// Advances z over one period, at once or substep by substep; `drive` holds the inputs, then the disturbances of the
    /// derivatives.
    #[inline(always)]
    pub fn advance<V: State>(
        &mut self,
        step: u64,
        z: &mut V,
        drive: &mut [f64],
        (disturbances, sensors): (&Disturbances, &mut Sensors),
        work: &mut Work<V>,
    ) {
        disturbances.set_oscillators(step, z.as_mut());
        let inputs = self.chains.len();
        // Without disturbances of the derivatives, only the inputs act.
        let acting = if disturbances.are_none() { inputs } else { drive.len() };
        let linear = acting == inputs && self.nonlinear.is_none();
        if linear && let Flows::Whole(kernel) = self.settings.schedule().flows(step) {
            let v = &mut drive[..inputs];
            sensors.remember(0.0, z.as_ref(), v);
            let changing = self.delays.iter().filter(|delay| delay.fraction_s > 0.0);
            let (after, before) = self.period.split_at_mut(inputs);
            before.iter_mut().zip(changing).for_each(|(before, delay)| *before = delay.older());
            v.iter_mut().zip(&self.delays).for_each(|(value, delay)| *value = delay.newer());
            after.copy_from_slice(v);
            z.flow(kernel, &self.period, &mut work.scratch);
        } else {
            self.advance_in_parts(step, z, drive, acting, (disturbances, sensors), work);
        }
        if self.has_windows() {
            self.follow(z.as_mut(), drive);
            self.choose(step + 1, sensors);
        }
    }

    #[inline(always)]
    fn advance_in_parts<V: State>(
        &mut self,
        step: u64,
        z: &mut V,
        drive: &mut [f64],
        acting: usize,
        (disturbances, sensors): (&Disturbances, &mut Sensors),
        work: &mut Work<V>,
    ) {
        let inputs = self.chains.len();
        for substep in self.settings.schedule().substeps(step) {
            let (v, held) = drive.split_at_mut(inputs);
            for (value, delay) in v.iter_mut().zip(&self.delays) {
                let changed = schedule::reached((0, delay.fraction_s), 0, substep.start_s, self.period_s);
                *value = if changed { delay.newer() } else { delay.older() };
            }
            if acting > inputs {
                disturbances.held(step, substep.start_s, held);
            }
            sensors.remember(substep.start_s, z.as_ref(), v);
            match &mut self.nonlinear {
                Some(nonlinear) => nonlinear.advance(substep, z, &drive[..acting], work),
                None => z.flow(&substep.levels[0], &drive[..acting], &mut work.scratch),
            }
        }
    }
}
