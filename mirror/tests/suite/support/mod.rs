//! Flights in closed loop, in process, for measurements and tests of the mirror.

mod law;
pub mod remote;

use law::law;
use whirlstand_control::{Controller, Estimator};
use whirlstand_mirror::Sample;
use whirlstand_vehicle::{Effect, Engine, Simulator, Stream, Vehicle, Window};

/// A flight under LQR with a setpoint that moves at random, as the bench flies it: command k acts from step k + 1 on.
pub struct Flight {
    simulator: Simulator,
    controller: Controller,
    estimator: Estimator,
    stream: Stream,
    reference: Vec<f64>,
    tracked: Vec<(usize, f64)>,
    next_setpoint: u64,
    period_s: f64,
    pub step: u64,
    command: Vec<f64>,
    acted: Vec<f64>,
    pub y: Vec<f64>,
    pub u: Vec<f64>,
    pub fresh: u64,
}

impl Flight {
    /// `effect` begins at a step.
    pub fn new(vehicle: &Vehicle, period_s: f64, seed: u64, effect: Option<(&Effect, u64)>) -> Self {
        let simulator = |vehicle: &Vehicle| {
            let mut simulator = Simulator::new(vehicle, period_s, seed).unwrap();
            simulator.set_engine(Engine::Flying);
            simulator
        };
        let (controller, estimator) = law(vehicle, period_s, Engine::Flying);
        let mut flown = vehicle.clone();
        if let Some((effect, step)) = effect {
            let window = Window { from_s: Some((step as f64 - 1e-6) * period_s), until_s: None };
            flown.add_effect(effect.clone().during(window).unwrap()).unwrap();
        }
        // Attitudes are asked for; a vehicle with positions is asked for these.
        let angles = ["roll", "pitch"].iter().filter_map(|name| vehicle.state_index(name));
        let neutral: Vec<f64> = vehicle.inputs.iter().map(|i| i.neutral()).collect();
        Self {
            simulator: simulator(&flown),
            controller,
            estimator,
            stream: Stream::new(seed, "setpoint"),
            reference: vec![0.0; vehicle.states.len()],
            tracked: angles.map(|i| (i, 0.09)).collect(),
            next_setpoint: 0,
            period_s,
            step: 0,
            command: neutral.clone(),
            acted: neutral.clone(),
            y: vec![0.0; vehicle.outputs.len()],
            u: neutral,
            fresh: 0,
        }
    }

    /// The next step.
    pub fn fly(&mut self) {
        if self.step == self.next_setpoint {
            for &(state, size) in &self.tracked {
                self.reference[state] = size * (2.0 * self.stream.uniform() - 1.0);
            }
            self.next_setpoint += ((1.0 + 2.0 * self.stream.uniform()) / self.period_s) as u64;
        }
        self.simulator.apply(&self.command);
        self.u.copy_from_slice(self.simulator.applied());
        self.y.copy_from_slice(self.simulator.measure());
        let fresh = self.simulator.fresh().iter().enumerate();
        self.fresh = fresh.fold(0, |bits, (i, f)| bits | u64::from(*f) << i);
        self.estimator.step(&self.y, self.fresh, &self.acted, &self.command);
        self.acted.copy_from_slice(&self.u);
        let tracked = self.tracked.iter().fold(0u64, |bits, (i, _)| bits | 1 << i);
        self.controller.step(self.estimator.x(), &self.reference, tracked, &mut self.command);
        self.simulator.advance();
        self.step += 1;
    }

    /// What was measured in the last step.
    pub fn sample(&self) -> Sample<'_> {
        Sample { step: self.step - 1, y: &self.y, fresh: self.fresh, u: &self.u }
    }
}
