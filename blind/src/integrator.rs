//! Numerical integration: the classical Runge-Kutta method between discontinuities; the times at which dry
//! friction stops the motion are located.

use super::signal::Signal;
use super::truth_model::{Filter, Force, TruthModel};

/// A signal that is linear over the present interval.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Line {
    pub value: f64,
    pub slope: f64,
}

/// State of dry friction: moving in one direction, or stuck.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Contact {
    Forward,
    Backward,
    Stuck,
}

/// Integrates the state of a model over time.
pub(crate) struct Integrator<'a> {
    model: &'a TruthModel,
    /// Index of the model's active stage.
    pub stage: usize,
    /// Start of the present interval; `inputs` and `pushes` hold over it.
    pub start: f64,
    pub inputs: Vec<Line>,
    pub pushes: Vec<(usize, Line)>,
    contacts: Vec<Contact>,
    relay: RelayState,
    /// The vehicle's states, then those of the filters.
    pub z: Vec<f64>,
    result: Vec<f64>,
    slopes: [Vec<f64>; 4],
    trial: Vec<f64>,
    drive: Vec<f64>,
}

#[derive(Default)]
struct RelayState {
    wanted: f64,
    acting: f64,
    pending: std::collections::VecDeque<(f64, f64)>,
}

impl<'a> Integrator<'a> {
    pub fn new(model: &'a TruthModel, x0: &[f64]) -> Self {
        let mut z = vec![0.0; model.size];
        z[..model.n].copy_from_slice(x0);
        let zeros = || vec![0.0; model.size];
        Self {
            model,
            stage: 0,
            start: 0.0,
            inputs: vec![Line::default(); model.inputs.len()],
            pushes: model.pushes.iter().map(|(i, _)| (*i, Line::default())).collect(),
            contacts: vec![Contact::Stuck; model.frictions.len()],
            relay: RelayState::default(),
            result: zeros(),
            slopes: std::array::from_fn(|_| zeros()),
            trial: zeros(),
            drive: vec![0.0; model.inputs.len()],
            z,
        }
    }

    /// Sets filters to their steady state for the resting inputs and the initial state, and decides the state
    /// of each friction.
    pub fn settle(&mut self) {
        let model = self.model;
        let mut w: Vec<f64> = model.inputs.iter().map(Signal::rest).collect();
        for (from, onto, c) in &model.couplings {
            w[*onto] += c * model.inputs[*from].rest();
        }
        for filter in &model.filters {
            match *filter {
                Filter::Lag { input, state, .. } => self.z[state] = w[input],
                Filter::Mode { input, state, gain, .. } => {
                    w[input] *= gain;
                    self.z[state] = w[input];
                }
            }
        }
        for f in &model.sensor_filters {
            let mut y = model.c.dot(f.output, &self.z) + model.d.dot(f.output, &w);
            for earlier in model.sensor_filters.iter().filter(|e| e.output == f.output && e.state < f.state) {
                y = earlier.creep.map_or(self.z[earlier.state], |gain| y + gain * self.z[earlier.state]);
            }
            self.z[f.state] = if f.creep.is_some() { 0.0 } else { y };
        }
        for index in 0..self.contacts.len() {
            self.decide(index, 0.0);
        }
    }

    /// The value that the sensor of output `i` measures now.
    pub fn output(&mut self, i: usize) -> f64 {
        let t = self.start;
        self.actuate(t);
        let model = self.model;
        let mut y = model.c.dot(i, &self.z) + model.d.dot(i, &self.drive);
        for f in model.sensor_filters.iter().filter(|f| f.output == i) {
            y = f.creep.map_or(self.z[f.state], |gain| y + gain * self.z[f.state]);
        }
        y
    }

    /// Writes the inputs after couplings and filters at time `t` into `drive`.
    fn actuate(&mut self, t: f64) {
        drive(self.model, &self.inputs, t - self.start, &self.z, &mut self.drive, |_, _| {});
    }

    /// Integrates to the end of the interval, in equal steps.
    pub fn advance(&mut self, end: f64) {
        let length = end - self.start;
        let count = (length / self.model.step_s - 1e-6).ceil().max(1.0);
        let (start, h) = (self.start, length / count);
        for i in 0..count as usize {
            let t = start + i as f64 * h;
            self.switch(t);
            self.step(t, h);
        }
    }

    fn step(&mut self, t: f64, h: f64) {
        if self.contacts.is_empty() {
            self.runge_kutta(t, h);
            std::mem::swap(&mut self.z, &mut self.result);
            return;
        }
        let (mut done, mut tries) = (0.0, 0);
        while h - done > 1e-9 * h && tries < 16 {
            tries += 1;
            for index in 0..self.contacts.len() {
                if self.contacts[index] == Contact::Stuck {
                    self.decide(index, t + done);
                }
            }
            let rest = h - done;
            self.runge_kutta(t + done, rest);
            let Some((index, share)) = self.first_stop(t + done, rest) else {
                std::mem::swap(&mut self.z, &mut self.result);
                return;
            };
            // Integrate exactly to the time of the stop.
            self.runge_kutta(t + done, share * rest);
            std::mem::swap(&mut self.z, &mut self.result);
            self.z[self.model.frictions[index].state] = 0.0;
            done += share * rest;
            self.decide(index, t + done);
        }
        if done < h {
            self.runge_kutta(t + done, h - done);
            std::mem::swap(&mut self.z, &mut self.result);
        }
    }

    /// The friction whose state first reaches zero within the step just computed, and the share of the step
    /// at which it does.
    fn first_stop(&mut self, t: f64, h: f64) -> Option<(usize, f64)> {
        let mut first: Option<(usize, f64)> = None;
        let full = self.result.clone();
        for index in 0..self.contacts.len() {
            let side = match self.contacts[index] {
                Contact::Forward => 1.0,
                Contact::Backward => -1.0,
                Contact::Stuck => continue,
            };
            let state = self.model.frictions[index].state;
            if full[state] * side >= 0.0 {
                continue;
            }
            // A few iterations of regula falsi; the path is nearly straight over a millisecond.
            let (mut low, mut high, mut share) = (0.0, 1.0, 1.0);
            let (mut at_low, mut at_high) = (self.z[state] * side, full[state] * side);
            // A state that starts from rest is held to the end of the step.
            for _ in 0..if at_low > 0.0 { 12 } else { 0 } {
                share = (low + (high - low) * at_low / (at_low - at_high)).clamp(low, high);
                self.runge_kutta(t, share * h);
                let here = self.result[state] * side;
                if here >= 0.0 {
                    (low, at_low) = (share, here);
                } else {
                    (high, at_high) = (share, here);
                }
                if here.abs() < 1e-12 * (self.z[state].abs() + full[state].abs()) || high - low < 1e-9 {
                    break;
                }
            }
            if first.is_none_or(|(_, earliest)| share < earliest) {
                first = Some((index, share));
            }
        }
        if first.is_none() {
            self.result = full;
        }
        first
    }

    /// Decides whether friction holds its state or lets it move in the direction of the driving force.
    fn decide(&mut self, index: usize, t: f64) {
        let friction = &self.model.frictions[index];
        let x = self.z[friction.state];
        self.contacts[index] = if x > 0.0 {
            Contact::Forward
        } else if x < 0.0 {
            Contact::Backward
        } else {
            // The driving force is the slope without friction: set the contact to forward and add the forward
            // friction back.
            self.contacts[index] = Contact::Forward;
            let mut slope = std::mem::take(&mut self.slopes[0]);
            self.derivative(t, None, &mut slope);
            let drive = slope[friction.state] + friction.against.0;
            self.slopes[0] = slope;
            if drive > friction.against.0 {
                Contact::Forward
            } else if drive < -friction.against.1 {
                Contact::Backward
            } else {
                Contact::Stuck
            }
        };
    }

    fn switch(&mut self, t: f64) {
        let Some(relay) = &self.model.relay else { return };
        let x = self.z[relay.from];
        let wanted = match x {
            x if x > relay.threshold => -relay.size,
            x if x < -relay.threshold => relay.size,
            _ => self.relay.wanted,
        };
        if wanted != self.relay.wanted {
            self.relay.wanted = wanted;
            self.relay.pending.push_back((t + relay.dead_time_s, wanted));
        }
        while self.relay.pending.front().is_some_and(|(at, _)| *at <= t) {
            self.relay.acting = self.relay.pending.pop_front().map_or(0.0, |(_, force)| force);
        }
    }

    /// One step of the classical Runge-Kutta method of order 4 from `z` into `result`.
    fn runge_kutta(&mut self, t: f64, h: f64) {
        let [mut k1, mut k2, mut k3, mut k4] = std::mem::take(&mut self.slopes);
        let mut trial = std::mem::take(&mut self.trial);
        let to = |trial: &mut [f64], z: &[f64], k: &[f64], h: f64| {
            for ((s, z), k) in trial.iter_mut().zip(z).zip(k) {
                *s = z + h * k;
            }
        };
        self.derivative(t, None, &mut k1);
        to(&mut trial, &self.z, &k1, 0.5 * h);
        self.derivative(t + 0.5 * h, Some(&trial), &mut k2);
        to(&mut trial, &self.z, &k2, 0.5 * h);
        self.derivative(t + 0.5 * h, Some(&trial), &mut k3);
        to(&mut trial, &self.z, &k3, h);
        self.derivative(t + h, Some(&trial), &mut k4);
        for (i, r) in self.result.iter_mut().enumerate() {
            *r = self.z[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
        }
        self.slopes = [k1, k2, k3, k4];
        self.trial = trial;
    }

    /// The derivative dz/dt at `z`; `None` is the present state.
    #[inline]
    fn derivative(&mut self, t: f64, z: Option<&[f64]>, out: &mut [f64]) {
        let Self { model, stage, start, inputs, pushes, contacts, relay, drive: w, .. } = self;
        let z = z.unwrap_or(&self.z);
        let after = t - *start;
        drive(model, inputs, after, z, w, |state, slope| out[state] = slope);
        let (_, a, b) = &model.stages[*stage];
        for (i, slope) in out[..model.n].iter_mut().enumerate() {
            *slope = a.dot(i, z) + b.dot(i, w);
        }
        for (state, line) in pushes.iter() {
            out[*state] += line.value + line.slope * after;
        }
        for force in &model.forces {
            push(force, t, z, w, out);
        }
        if let Some(r) = &model.relay {
            out[r.onto] += relay.acting;
        }
        for (index, f) in model.sensor_filters.iter().enumerate() {
            let mut y = model.c.dot(f.output, z) + model.d.dot(f.output, w);
            for earlier in model.sensor_filters[..index].iter().filter(|e| e.output == f.output) {
                y = earlier.creep.map_or(z[earlier.state], |gain| y + gain * z[earlier.state]);
            }
            let gap = y - z[f.state];
            out[f.state] = f.rate * f.slew.map_or(gap, |most| gap.clamp(-most, most));
        }
        for (contact, friction) in contacts.iter().zip(&model.frictions) {
            match contact {
                Contact::Forward => out[friction.state] -= friction.against.0,
                Contact::Backward => out[friction.state] += friction.against.1,
                Contact::Stuck => out[friction.state] = 0.0,
            }
        }
    }
}

/// Writes the inputs after couplings and filters into `w`; `slope` receives the derivatives of the filter
/// states.
#[inline]
fn drive(
    model: &TruthModel,
    inputs: &[Line],
    after: f64,
    z: &[f64],
    w: &mut [f64],
    mut slope: impl FnMut(usize, f64),
) {
    let raw = |line: &Line| line.value + line.slope * after;
    for (w, line) in w.iter_mut().zip(inputs) {
        *w = raw(line);
    }
    for (from, onto, c) in &model.couplings {
        w[*onto] += c * raw(&inputs[*from]);
    }
    for filter in &model.filters {
        match *filter {
            Filter::Lag { input, state, rate } => {
                slope(state, rate * (w[input] - z[state]));
                w[input] = z[state];
            }
            Filter::Mode { input, state, w: own, damping, gain } => {
                let (position, velocity) = (z[state], z[state + 1]);
                slope(state, velocity);
                slope(state + 1, own * own * (gain * w[input] - position) - 2.0 * damping * own * velocity);
                w[input] = position;
            }
        }
    }
}

#[inline]
fn push(force: &Force, t: f64, z: &[f64], w: &[f64], out: &mut [f64]) {
    match *force {
        Force::Drag { state, c } => out[state] -= c * z[state] * z[state].abs(),
        Force::Cubic { from, onto, c } => out[onto] -= c * z[from].powi(3),
        Force::Sine { state, amplitude, w, phase } => out[state] += amplitude * (w * t + phase).sin(),
        Force::Product { states: (i, j), onto, c } => out[onto] -= c * z[i] * z[j],
        Force::SineSpring { from, onto, size, scale } => out[onto] -= size * (scale * z[from]).sin(),
        Force::Swinging { from, onto, size, w } => out[onto] -= size * z[from] * (w * t).sin(),
        Force::Bilinear { input, from, onto, size } => out[onto] += size * w[input] * z[from],
        Force::InputProduct { inputs: (i, j), onto, size } => out[onto] += size * w[i] * w[j],
        Force::YieldingSpring { from, onto, size, scale } => {
            let r = z[from] / scale;
            out[onto] -= size * r.powi(3) / (1.0 + r.powi(4));
        }
        Force::StiffnessRamp { from, onto, size, length_s } => {
            out[onto] -= size * z[from] * (2.0 * t / length_s - 1.0);
        }
        Force::SelfExcitation { state, size, scale } => {
            out[state] += size * z[state] * (1.0 - (z[state] / scale).powi(2));
        }
    }
}
