//! A real vehicle at the end of a link: its own clock, its own steps, and messages that take their time.

use std::collections::VecDeque;

use super::law::law;
use whirlstand_control::{Controller, Estimator};
use whirlstand_mirror::Sample;
use whirlstand_vehicle::{Effect, Engine, Simulator, Stream, Vehicle, Window};

/// Steps of the vehicle's motion in one of its periods.
const FINE: u64 = 10;

/// A message with the bench time of its arrival, in periods.
type Message = (f64, Vec<f64>);

/// The next message that has arrived.
fn arrived(messages: &mut VecDeque<Message>, now: f64) -> Option<Vec<f64>> {
    if messages.front()?.0 > now {
        return None;
    }
    messages.pop_front().map(|(_, values)| values)
}

/// What the clocks and the link are like.
#[derive(Debug, Clone, Copy)]
pub struct Link {
    /// How much faster the vehicle's clock runs.
    pub drift: f64,
    /// Time of a message each way, in periods, and the largest that a single one takes beyond it.
    pub latency: f64,
    pub jitter: f64,
    /// Step to which each output is rounded, relative to its noise.
    pub rounding: f64,
}

/// A flight over a link under LQR with a setpoint that moves at random. A command is sent as soon as it is known.
pub struct Remote {
    simulator: Simulator,
    controller: Controller,
    estimator: Estimator,
    stream: Stream,
    link: Link,
    period_s: f64,
    reference: Vec<f64>,
    tracked: Vec<(usize, f64)>,
    next_setpoint: u64,
    /// Steps of the bench, and fine steps of the vehicle.
    pub step: u64,
    fine: u64,
    /// Step to which each output is rounded.
    quanta: Vec<f64>,
    /// Messages on their way.
    commands: VecDeque<Message>,
    measurements: VecDeque<Message>,
    acting: Vec<f64>,
    command: Vec<f64>,
    acted: Vec<f64>,
    y: Vec<f64>,
    u: Vec<f64>,
    fresh: u64,
}

impl Remote {
    /// `effect` begins at a step of the bench.
    pub fn new(
        vehicle: &Vehicle,
        period_s: f64,
        seed: u64,
        effect: Option<(&Effect, u64)>,
        link: Link,
    ) -> Self {
        let (controller, estimator) = law(vehicle, period_s, Engine::Off);
        let mut flown = vehicle.clone();
        if let Some((effect, step)) = effect {
            let window = Window { from_s: Some((step as f64 - 1e-6) * period_s), until_s: None };
            flown.add_effect(effect.clone().during(window).unwrap()).unwrap();
        }
        let mut simulator = Simulator::new(&flown, period_s / FINE as f64, seed).unwrap();
        simulator.set_engine(Engine::Flying);
        let angles = ["roll", "pitch"].iter().filter_map(|name| vehicle.state_index(name));
        let neutral: Vec<f64> = vehicle.inputs.iter().map(|i| i.neutral()).collect();
        Self {
            simulator,
            controller,
            estimator,
            stream: Stream::new(seed, "setpoint"),
            link,
            period_s,
            reference: vec![0.0; vehicle.states.len()],
            tracked: angles.map(|i| (i, 0.09)).collect(),
            next_setpoint: 0,
            step: 0,
            fine: 0,
            quanta: vehicle.outputs.iter().map(|o| link.rounding * o.noise).collect(),
            commands: VecDeque::new(),
            measurements: VecDeque::new(),
            acting: neutral.clone(),
            command: neutral.clone(),
            acted: neutral.clone(),
            y: vec![0.0; vehicle.outputs.len()],
            u: neutral,
            fresh: 0,
        }
    }

    /// When a message that is sent at `now` arrives, in periods: none overtakes another.
    fn arrival(&mut self, now: f64, last: Option<f64>) -> f64 {
        let takes = self.link.latency + self.link.jitter * self.stream.uniform();
        (now + takes).max(last.unwrap_or(0.0))
    }

    /// The next step.
    pub fn fly(&mut self) {
        let now = self.step as f64;
        while (self.fine as f64) < now * (1.0 + self.link.drift) * FINE as f64 {
            let at = self.fine as f64 / FINE as f64 / (1.0 + self.link.drift);
            while let Some(command) = arrived(&mut self.commands, at) {
                self.acting = command;
            }
            self.simulator.apply(&self.acting);
            let mut y = self.simulator.measure().to_vec();
            for (y, quantum) in y.iter_mut().zip(&self.quanta).filter(|(_, quantum)| **quantum > 0.0) {
                *y = (*y / quantum).round() * quantum;
            }
            if self.fine.is_multiple_of(FINE) {
                let last = self.measurements.back().map(|(arrival, _)| *arrival);
                let arrival = self.arrival(at, last);
                self.measurements.push_back((arrival, y));
            }
            self.simulator.advance();
            self.fine += 1;
        }
        if self.step == self.next_setpoint {
            for &(state, size) in &self.tracked {
                self.reference[state] = size * (2.0 * self.stream.uniform() - 1.0);
            }
            self.next_setpoint += ((1.0 + 2.0 * self.stream.uniform()) / self.period_s) as u64;
        }
        self.fresh = 0;
        while let Some(y) = arrived(&mut self.measurements, now) {
            self.y = y;
            self.fresh = (1 << self.y.len()) - 1;
        }
        // What was sent last counts as acting from this step on.
        self.u.copy_from_slice(&self.command);
        self.estimator.step(&self.y, self.fresh, &self.acted, &self.command);
        self.acted.copy_from_slice(&self.u);
        let tracked = self.tracked.iter().fold(0u64, |bits, (i, _)| bits | 1 << i);
        self.controller.step(self.estimator.x(), &self.reference, tracked, &mut self.command);
        let last = self.commands.back().map(|(arrival, _)| *arrival);
        let arrival = self.arrival(now, last);
        self.commands.push_back((arrival, self.command.clone()));
        self.step += 1;
    }

    /// What was measured in the last step.
    pub fn sample(&self) -> Sample<'_> {
        Sample { step: self.step - 1, y: &self.y, fresh: self.fresh, u: &self.u }
    }
}
