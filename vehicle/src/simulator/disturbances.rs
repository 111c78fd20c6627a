//! Disturbances of the states' derivatives: steps, pulses, sines, turbulence, and external ones.

use std::f64::consts::TAU;
use std::ops::Range;

use super::compile::Oscillator;
use super::inputs::split;
use super::schedule::{Moment, reached};
use super::switch::Switch;
use crate::effects::{Effect, Kind, Place};
use crate::normals::Normals;
use crate::random::Stream;

/// A constant between two times.
#[derive(Debug, Clone)]
struct Pulse {
    state: usize,
    magnitude: f64,
    from: Moment,
    until: Moment,
    switch: Switch,
}

/// First-order shaped noise: d' = -w d + std sqrt(2 w) white, w = 2 pi bandwidth, starting from its
/// stationary distribution.
///
/// Sampled exactly once per period and held, so that the published value is the acting one. Its spectrum is
/// that of the longitudinal Dryden gust (MIL-F-8785C).
#[derive(Debug, Clone)]
pub struct Turbulence {
    pub(super) decay: f64,
    pub(super) kick: f64,
    pub(super) value: f64,
    pub(super) normals: Normals,
}

impl Turbulence {
    pub fn new(std: f64, bandwidth_hz: f64, period_s: f64, stream: Stream) -> Self {
        let decay = libm::exp(-TAU * bandwidth_hz * period_s);
        let kick = std * libm::sqrt(-libm::expm1(-2.0 * TAU * bandwidth_hz * period_s));
        let mut normals = Normals::new(stream);
        Self { decay, kick, value: std * normals.next(), normals }
    }

    pub fn value(&self) -> f64 {
        self.value
    }

    pub fn advance(&mut self) {
        self.value = self.decay * self.value + self.kick * self.normals.next();
    }
}

/// All disturbances of a vehicle.
#[derive(Debug, Clone)]
pub struct Disturbances {
    period_s: f64,
    pulses: Vec<Pulse>,
    pub(super) turbulence: Vec<(usize, Turbulence, Switch)>,
    pub(super) oscillators: Vec<Oscillator>,
    external: Vec<f64>,
    /// True while there is no external disturbance.
    is_calm: bool,
    /// Disturbances at the beginning of the current step, sines included.
    acting: Vec<f64>,
}

impl Disturbances {
    /// Disturbances from the effects; `seed` is `None` for a simulation without randomness.
    pub fn new(
        effects: &[(Effect, Place)],
        oscillators: Vec<Oscillator>,
        n: usize,
        period_s: f64,
        seed: Option<u64>,
    ) -> Self {
        let mut pulses = Vec::new();
        let mut turbulence = Vec::new();
        for (index, (effect, place)) in effects.iter().enumerate() {
            let Place::State(state) = *place else { continue };
            match (effect.kind(), seed) {
                (Kind::StepDisturbance | Kind::PulseDisturbance, _) => {
                    let at_s = effect.get("at_s");
                    let until = effect.parameter("duration_s").map(|d| split(at_s + d, period_s));
                    pulses.push(Pulse {
                        state,
                        magnitude: effect.get("magnitude"),
                        from: split(at_s, period_s),
                        until: until.unwrap_or((u64::MAX, 0.0)),
                        switch: Switch::new(index, effect),
                    });
                }
                (Kind::Turbulence, Some(seed)) => {
                    let stream = Stream::new(seed, &consumer(effects, index));
                    let (std, bandwidth) = (effect.get("std"), effect.get("bandwidth_hz"));
                    let turbulent = Turbulence::new(std, bandwidth, period_s, stream);
                    turbulence.push((state, turbulent, Switch::new(index, effect)));
                }
                _ => {}
            }
        }
        let zeros = vec![0.0; n];
        let mut all = Self {
            period_s,
            pulses,
            turbulence,
            oscillators,
            external: zeros.clone(),
            is_calm: true,
            acting: zeros,
        };
        all.refresh(0);
        all
    }

    /// Times, as step and offset, at which a disturbance begins or ends.
    pub fn events(&self) -> Vec<Moment> {
        self.pulses.iter().flat_map(|p| [p.from, p.until]).filter(|m| m.0 < u64::MAX).collect()
    }

    /// True when no constant is added to any derivative: no step, pulse or turbulence, and no external
    /// disturbance.
    pub fn are_none(&self) -> bool {
        self.pulses.is_empty() && self.turbulence.is_empty() && self.is_calm
    }

    /// True when no disturbance begins or ends in these steps but at the beginning of the first.
    pub fn are_steady(&self, steps: &Range<u64>) -> bool {
        let edges = self.pulses.iter().flat_map(|pulse| [pulse.from, pulse.until]);
        let changes = |edge: Moment| steps.contains(&edge.0) && edge != (steps.start, 0.0);
        self.turbulence.is_empty() && !edges.into_iter().any(changes)
    }

    /// True when there are sines, which are states of the simulator.
    pub fn have_oscillators(&self) -> bool {
        !self.oscillators.is_empty()
    }

    /// The constant part over the substep that begins at this offset.
    pub fn held(&self, step: u64, start_s: f64, out: &mut [f64]) {
        self.held_without_turbulence(step, start_s, out);
        let t = self.middle(step);
        for (state, turbulence, _) in self.turbulence.iter().filter(|(.., switch)| switch.is_on(t)) {
            out[*state] += turbulence.value();
        }
    }

    /// The constant part without turbulence, which changes only at [`Self::events`].
    pub fn held_without_turbulence(&self, step: u64, start_s: f64, out: &mut [f64]) {
        out.copy_from_slice(&self.external);
        let t = self.middle(step);
        for pulse in self.pulses.iter().filter(|pulse| pulse.switch.is_on(t)) {
            let reached = |moment| reached(moment, step, start_s, self.period_s);
            if reached(pulse.from) && !reached(pulse.until) {
                out[pulse.state] += pulse.magnitude;
            }
        }
    }

    /// Sets the oscillators' states at the beginning of a step, from the time itself, so that errors do not
    /// accumulate.
    pub fn set_oscillators(&self, step: u64, z: &mut [f64]) {
        for o in &self.oscillators {
            let (sine, cosine) = self.phase(o, step);
            let amplitude = self.amplitude(o, step);
            z[o.sine] = amplitude * sine;
            z[o.sine + 1] = amplitude * cosine;
        }
    }

    fn amplitude(&self, o: &Oscillator, step: u64) -> f64 {
        if o.switch.is_on(self.middle(step)) { o.amplitude } else { 0.0 }
    }

    /// Middle of a step, so that an effect with a window begins and ends at the nearest step boundary.
    fn middle(&self, step: u64) -> f64 {
        (step as f64 + 0.5) * self.period_s
    }

    /// Switches an effect; true if it is one of these.
    pub fn switch(&mut self, step: u64, effect: usize, on: bool) -> bool {
        let is_one = self.switches().any(|switch| switch.set(effect, on));
        if is_one {
            self.refresh(step);
        }
        is_one
    }

    fn switches(&mut self) -> impl Iterator<Item = &mut Switch> {
        let pulses = self.pulses.iter_mut().map(|p| &mut p.switch);
        let turbulence = self.turbulence.iter_mut().map(|(.., switch)| switch);
        pulses.chain(turbulence).chain(self.oscillators.iter_mut().map(|o| &mut o.switch))
    }

    /// True when a disturbance has a time window.
    pub fn have_windows(&self) -> bool {
        let pulses = self.pulses.iter().map(|p| &p.switch);
        let turbulence = self.turbulence.iter().map(|(.., switch)| switch);
        let mut all = pulses.chain(turbulence).chain(self.oscillators.iter().map(|o| &o.switch));
        all.any(|switch| !switch.is_always())
    }

    fn phase(&self, o: &Oscillator, step: u64) -> (f64, f64) {
        let turns = o.frequency_hz * (step as f64 * self.period_s);
        libm::sincos(TAU * (turns - turns.floor()) + o.phase_rad)
    }

    /// Advances to the next step.
    pub fn advance(&mut self, next: u64) {
        for (_, turbulence, _) in &mut self.turbulence {
            turbulence.advance();
        }
        if !(self.pulses.is_empty() && self.turbulence.is_empty() && self.oscillators.is_empty()) {
            self.refresh(next);
        }
    }

    /// Begins at a later step than 0.
    pub fn begin_at(&mut self, step: u64) {
        self.refresh(step);
    }

    /// Sets the external disturbance from now on.
    pub fn set_external(&mut self, step: u64, external: &[f64]) {
        self.external.copy_from_slice(external);
        self.is_calm = external.iter().all(|d| *d == 0.0);
        self.refresh(step);
    }

    /// Sets the external disturbance of one state's derivative; [`Self::acting`] contains it from the next
    /// step on.
    #[inline]
    pub fn force(&mut self, state: usize, value: f64) {
        self.external[state] = value;
        self.is_calm = false;
    }

    fn refresh(&mut self, step: u64) {
        let mut acting = std::mem::take(&mut self.acting);
        self.held(step, 0.0, &mut acting);
        for o in &self.oscillators {
            acting[o.state] += self.amplitude(o, step) * self.phase(o, step).0;
        }
        self.acting = acting;
    }

    /// Disturbances at the beginning of the current step.
    pub fn acting(&self) -> &[f64] {
        &self.acting
    }
}

/// Name of an effect's random stream: effect, place, and its number among equal ones.
pub fn consumer(effects: &[(Effect, Place)], index: usize) -> String {
    let (effect, _) = &effects[index];
    let same = |(e, _): &&(Effect, Place)| e.kind() == effect.kind() && e.place() == effect.place();
    format!("{}/{}/{}", effect.kind(), effect.place(), effects[..index].iter().filter(same).count())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turbulence_has_its_std_and_correlation() {
        let (std, bandwidth, period) = (2.0, 0.5, 0.01);
        let mut turbulence = Turbulence::new(std, bandwidth, period, Stream::new(3, "test"));
        let n = 400_000;
        let values: Vec<f64> = (0..n)
            .map(|_| {
                turbulence.advance();
                turbulence.value()
            })
            .collect();
        let covariance = |lag: usize| {
            values.iter().zip(&values[lag..]).map(|(a, b)| a * b).sum::<f64>() / (n - lag) as f64
        };
        // Correlation time 1/w = 0.318 s: about 6,300 independent samples, so 5 standard errors are 9 %.
        for lag in [0, 10, 32, 64] {
            let expected = std * std * (-TAU * bandwidth * period * lag as f64).exp();
            assert!(
                (covariance(lag) - expected).abs() < 0.09 * std * std,
                "{lag}: {} {expected}",
                covariance(lag)
            );
        }
    }
}
