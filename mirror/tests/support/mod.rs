//! Flights in closed loop, in process, for measurements and tests of the mirror.

use whirlstand_control::{
    Controller, Design, Estimator, EstimatorOptions, LawOptions, LqrOptions, SampledPlant, Sensors,
};
use whirlstand_mirror::Sample;
use whirlstand_vehicle::{Effect, Engine, LinearModel, Simulator, Stream, Vehicle, Window};

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
        let linear = LinearModel::new(vehicle).unwrap();
        let plant = SampledPlant::of(&linear, period_s).unwrap();
        let limits = vehicle.inputs.iter();
        let limits = limits
            .map(|i| whirlstand_control::InputLimits { lower: i.lower, upper: i.upper, rate: i.rate_limit })
            .collect();
        let plant = plant.with_limits(limits).unwrap();
        let states = vehicle.states.iter().map(|s| s.name.clone()).collect();
        let inputs = vehicle.inputs.iter().map(|i| i.name.clone()).collect();
        let plant = plant.with_names(states, inputs).unwrap();
        let design = Design::new(&plant, &LawOptions::Lqr(LqrOptions::default())).unwrap();
        let std = vehicle.outputs.iter().map(|o| o.sensor_std(Engine::Flying, 0.0).max(1e-6)).collect();
        let sensors = Sensors {
            c: linear.c.columns(0, linear.own).into_owned(),
            d: linear.d.clone(),
            std,
            names: vehicle.outputs.iter().map(|o| o.name.clone()).collect(),
        };
        let estimator = Estimator::of(&plant, &sensors, Some(&linear), &EstimatorOptions::default()).unwrap();
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
            controller: Controller::new(&design),
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
