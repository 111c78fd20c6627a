//! The Kalman filter with its connection to the vehicle's sensors.

use whirlstand_control::{
    Estimator, EstimatorError, EstimatorKind, EstimatorOptions, SampledPlant, Sensors, VibrationModel,
};
use whirlstand_msgs::{Estimate, Head, MAX_INPUTS, MAX_OUTPUTS, Message, flags};
use whirlstand_vehicle::{Engine, LinearModel, Output, Vehicle};

use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::setup::Setup;
use crate::signals::{Measurement, OutputMap};

/// Noise that the filter assumes for a sensor without declared noise, in SI units: small compared with every
/// flight sensor, and large enough for the arithmetic.
const LEAST_NOISE: f64 = 1e-6;

/// Smallest amplitude of a modelled tone relative to its sensor's noise.
const LEAST_TONE: f64 = 0.3;

/// Smallest difference of sampled frequencies, in cycles per sample, that can be distinguished; tones whose
/// frequencies differ by no more than this share are one.
const LEAST_TURNS: f64 = 0.004;
const SAME_TONE: f64 = 0.01;

/// Outputs whose bias is in `Estimate`, in its order.
const BIASES: [&str; 4] = ["roll", "pitch", "roll_rate", "pitch_rate"];

pub(crate) struct Filter {
    estimator: Estimator,
    new: Estimator,
    map: OutputMap,
    outputs: usize,
    states: usize,
    inputs: usize,
    /// Output index of each of [`BIASES`].
    biases: [Option<usize>; BIASES.len()],
    feedthrough: bool,
}

impl Filter {
    pub(crate) fn new(config: &NodeConfig, setup: &Setup) -> Result<Self, NodeError> {
        let vehicle = &setup.model;
        let what = match config.estimator.kind {
            EstimatorKind::Kinematic => "a kinematic estimator",
            EstimatorKind::Model => "a model-based estimator",
        };
        let plant = setup.control_plant(config)?;
        let estimator = filter_of(vehicle, &plant, &config.estimator, config.plant.engine.into())
            .map_err(|e| setup.refuse(what, &e))?;
        Ok(Self {
            new: estimator.clone(),
            estimator,
            map: setup.map.clone(),
            outputs: vehicle.outputs.len(),
            states: vehicle.states.len(),
            inputs: vehicle.inputs.len(),
            biases: BIASES.map(|name| vehicle.output_index(name)),
            feedthrough: vehicle.d.iter().any(|v| *v != 0.0),
        })
    }

    /// The estimator alone, before its first step.
    pub(crate) fn into_estimator(self) -> Estimator {
        self.new
    }

    /// True when a measurement contains the input of the same time.
    pub(super) fn has_feedthrough(&self) -> bool {
        self.feedthrough
    }

    /// Restarts the filter.
    pub(super) fn restart(&mut self) {
        self.estimator = self.new.clone();
    }

    /// A step without a measurement.
    pub(super) fn predict(&mut self, u_before: &[f64; MAX_INPUTS]) {
        let y = [0.0; MAX_OUTPUTS];
        let u = &u_before[..self.inputs];
        self.estimator.step(&y[..self.outputs], 0, u, u);
    }

    /// A step with a measurement; false when a value in it was unusable.
    pub(super) fn step(
        &mut self,
        measurement: &Measurement,
        u_before: &[f64; MAX_INPUTS],
        u_now: &[f64; MAX_INPUTS],
    ) -> bool {
        let mut y = [0.0; MAX_OUTPUTS];
        let mut fresh = [false; MAX_OUTPUTS];
        let (y, fresh) = (&mut y[..self.outputs], &mut fresh[..self.outputs]);
        let clean = self.map.read(measurement, y, fresh);
        let valid = fresh.iter().enumerate().fold(0, |bits, (i, f)| bits | u64::from(*f) << i);
        self.estimator.set_step(measurement.imu.head.step);
        self.estimator.step(y, valid, &u_before[..self.inputs], &u_now[..self.inputs]);
        clean
    }

    /// Current estimate of the filter.
    pub(super) fn estimate(&self, head: Head) -> Estimate {
        let e = &self.estimator;
        let mut estimate = Estimate {
            head,
            nis: e.nis(),
            dof: e.dof(),
            count: self.states as u32,
            flags: if e.converged() { flags::CONVERGED } else { 0 },
            ..Estimate::zeroed()
        };
        estimate.x[..self.states].copy_from_slice(e.x());
        estimate.std[..self.states].copy_from_slice(e.std());
        for (bias, output) in estimate.bias.iter_mut().zip(self.biases) {
            *bias = output.map_or(0.0, |i| e.bias()[i]);
        }
        estimate
    }
}

/// The filter of the estimator for a vehicle in the given state of the engine.
///
/// # Errors
/// [`EstimatorError`].
pub fn filter_of(
    vehicle: &Vehicle,
    plant: &SampledPlant,
    options: &EstimatorOptions,
    engine: Engine,
) -> Result<Estimator, EstimatorError> {
    let mut linear = LinearModel::new(vehicle).map_err(|e| EstimatorError::Sensors(e.to_string()))?;
    let outputs = vehicle.outputs.iter().zip(&linear.variance);
    let mut std: Vec<f64> = outputs.map(|(o, added)| o.sensor_std(engine, *added)).collect();
    if options.vibration == VibrationModel::Oscillator {
        let first = linear.tones.len();
        for (i, output) in vehicle.outputs.iter().enumerate() {
            for tone in tones(output, engine, plant.period_s()) {
                linear.tones.push((i, tone.0));
                std[i] = (std[i].powi(2) - 0.5 * tone.1.powi(2)).max(0.0).sqrt();
            }
        }
        // A tone identified from a record is not declared twice.
        let found: Vec<(usize, f64)> = linear.tones[..first].to_vec();
        let same = |a: &(usize, f64), b: &(usize, f64)| a.0 == b.0 && (a.1 - b.1).abs() < SAME_TONE * a.1;
        let mut at = 0;
        linear.tones.retain(|tone| {
            at += 1;
            at <= first || !found.iter().any(|f| same(f, tone))
        });
    }
    let sensors = Sensors {
        c: linear.c.columns(0, linear.own).into_owned(),
        d: linear.d.clone(),
        std: std.into_iter().map(|s| s.max(LEAST_NOISE)).collect(),
        names: vehicle.outputs.iter().map(|o| o.name.clone()).collect(),
    };
    Estimator::of(plant, &sensors, Some(&linear), options)
}

/// Tones of a sensor that are worth their states and distinguishable by the filter: not far below the
/// sensor's noise, and, as sampled, neither at zero nor at half the rate nor aliased onto each other.
/// Frequency in Hz and amplitude.
fn tones(output: &Output, engine: Engine, period_s: f64) -> Vec<(f64, f64)> {
    let noise = (output.noise.powi(2) + output.quantization.powi(2) / 12.0).sqrt();
    let every_s = period_s * f64::from(output.every.max(1));
    let turns = |frequency_hz: f64| {
        let turns = (frequency_hz * every_s).fract();
        turns.min(1.0 - turns)
    };
    let mut kept: Vec<(f64, f64)> = Vec::new();
    for (frequency_hz, amplitude) in output.vibration.iter().flat_map(|v| v.tones(engine)) {
        let at = turns(frequency_hz);
        let apart = |other: &(f64, f64)| (turns(other.0) - at).abs() > LEAST_TURNS;
        if amplitude > LEAST_TONE * noise
            && at > LEAST_TURNS
            && at < 0.5 - LEAST_TURNS
            && kept.iter().all(apart)
        {
            kept.push((frequency_hz, amplitude));
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use whirlstand_vehicle::{Effect, Kind, Simulator};

    use super::*;

    const PERIOD_S: f64 = 0.005;

    /// Root mean square errors of both rates of the quadrotor in flight, with moving inputs and turbulence as
    /// the filter assumes. The rotors' vibration is `times` that of the file; rad/s.
    fn errors(vibration: VibrationModel, times: f64) -> [f64; 2] {
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        for declared in vehicle.outputs.iter_mut().filter_map(|o| o.vibration.as_mut()) {
            declared.flying *= times;
        }
        let plant = Setup::plant_of(&vehicle, PERIOD_S).unwrap();
        let options = EstimatorOptions { vibration, ..EstimatorOptions::default() };
        let mut estimator = filter_of(&vehicle, &plant, &options, Engine::Flying).unwrap();
        // An unmodelled effect. Without it a filter that distrusts its gyros does best, as its model is then
        // perfect.
        let mut flown = vehicle.clone();
        for (place, std) in [("roll_rate", 0.1), ("pitch_rate", 0.27)] {
            let air = Effect::new(Kind::Turbulence, place, &[("std", std), ("bandwidth_hz", 5.0)]).unwrap();
            flown.add_effect(air).unwrap();
        }
        let mut simulator = Simulator::new(&flown, PERIOD_S, 1).unwrap();
        simulator.set_engine(Engine::Flying);
        let rates = ["roll_rate", "pitch_rate"].map(|name| vehicle.state_index(name).unwrap());
        let (mut sums, mut before) = ([0.0; 2], [0.0; 2]);
        for k in 0..4000u32 {
            let now = [4.0 * f64::from(k / 200 % 2), -2.0 * f64::from(k / 300 % 2)];
            simulator.apply(&now);
            let y = simulator.measure().to_vec();
            let fresh = simulator.fresh().iter().enumerate().fold(0, |b, (i, f)| b | u64::from(*f) << i);
            estimator.step(&y, fresh, &before, &now);
            if k >= 1000 {
                for (sum, i) in sums.iter_mut().zip(rates) {
                    *sum += (estimator.x()[i] - simulator.state()[i]).powi(2) / 3000.0;
                }
            }
            before = now;
            simulator.advance();
        }
        sums.map(f64::sqrt)
    }

    #[test]
    fn rates_are_freed_of_declared_vibration() {
        for (times, most) in [(1.0, 1.0), (5.0, 0.6), (20.0, 0.35)] {
            let [noise, oscillator] =
                [VibrationModel::Noise, VibrationModel::Oscillator].map(|model| errors(model, times));
            println!("{times} times: rms errors of roll and pitch rate {noise:?} -> {oscillator:?} rad/s");
            for (before, after) in noise.iter().zip(oscillator) {
                assert!(after < most * before, "{times} times: {noise:?} -> {oscillator:?}");
            }
        }
    }

    #[test]
    fn a_tone_that_a_filter_cannot_tell_stays_noise() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let rate = &vehicle.outputs[vehicle.output_index("roll_rate").unwrap()];
        let frequencies = |period_s: f64| -> Vec<f64> {
            tones(rate, Engine::Flying, period_s).into_iter().map(|t| t.0).collect()
        };
        assert_eq!(frequencies(PERIOD_S), [33.0, 66.0]);
        // Sampled at 66 Hz the first aliases to half the rate and the second to zero; at 99 Hz both alias to
        // the same frequency.
        assert_eq!(frequencies(1.0 / 66.0), [0.0; 0]);
        assert_eq!(frequencies(1.0 / 99.0), [33.0]);
        // Nor a tone that is far below the noise, or absent.
        assert!(tones(rate, Engine::Off, PERIOD_S).is_empty());
        let mut noisy = rate.clone();
        noisy.noise *= 5.0;
        assert!(tones(&noisy, Engine::Flying, PERIOD_S).is_empty());
    }
}
