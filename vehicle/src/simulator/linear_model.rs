//! Continuous linear model of a vehicle with its linear effects, for laws and filters.

use nalgebra::DMatrix;

use super::beyond_linear::{Friction, InputEffects, frictions, input_effects};
use super::compile::System;
use crate::effects::{Effect, Kind, Place};
use crate::error::SimulatorError;
use crate::model::Vehicle;

/// A vehicle with its linear effects, before it is sampled.
///
/// `z' = a z + b v`, `v_i(t) = u_i(t - input_delays_s[i]) - trim_i`, `w = c z + d v`, and output j measures row j of
/// `mix [w_i(t - output_delays_s[i])] + offsets`. The states z are those of the vehicle, then those of lags and modes on its
/// inputs, then those of lags of its sensors. All in SI, in the order in which [`crate::Simulator`] lets effects act.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearModel {
    /// Number of the vehicle's own states.
    pub own: usize,
    /// Number of actuator states after them, which follow from the commands alone.
    pub actuators: usize,
    /// System matrix, 1/s.
    pub a: DMatrix<f64>,
    /// Input matrix, including the gains of the inputs.
    pub b: DMatrix<f64>,
    /// Output matrix before the delays, outputs x states.
    pub c: DMatrix<f64>,
    /// Feed-through matrix before the delays, outputs x inputs.
    pub d: DMatrix<f64>,
    /// Misalignment and scale after the delays, outputs x outputs.
    pub mix: DMatrix<f64>,
    /// Delay of each input, s.
    pub input_delays_s: Vec<f64>,
    /// Delay of each output, s.
    pub output_delays_s: Vec<f64>,
    /// Command at which an input has no effect, from `input_bias`; zero elsewhere.
    pub trim: Vec<f64>,
    /// Static effects on each input, which the linear model does not contain.
    pub on_inputs: Vec<InputEffects>,
    /// Coulomb friction, which the linear model does not contain.
    pub friction: Vec<Friction>,
    /// Offset of each output, from `sensor_bias`.
    pub offsets: Vec<f64>,
    /// Density of white noise on the derivative of each own state that is equivalent to `turbulence` below
    /// its bandwidth.
    pub turbulence: Vec<f64>,
    /// Variance that the effects `noise` and `quantization` add to each output's noise.
    pub variance: Vec<f64>,
    /// Tones that effects add to outputs: index of the output and frequency in Hz.
    pub tones: Vec<(usize, f64)>,
    /// Names of the states after the vehicle's own.
    pub names: Vec<String>,
    /// Effects that a linear model cannot contain, with the reason.
    pub left_out: Vec<(Effect, &'static str)>,
}

/// Reason why an effect is not in the linear model; `None` for those that are.
fn obstacle(effect: &Effect) -> Option<&'static str> {
    if !effect.window().is_always() {
        return Some("it acts only part of the time; the law is designed for the rest");
    }
    Some(match effect.kind() {
        Kind::GainDrift => {
            "it changes with time; the filter models it, the law only with [controller] compensate = [\"gain_drift\"]"
        }
        Kind::DeadZone => {
            "it is not linear; the filter models it, the law only with [controller] compensate = [\"dead_zone\"]"
        }
        Kind::Backlash => {
            "it is not linear; the filter models it, the law only with [controller] compensate = [\"backlash\"]"
        }
        Kind::InputSaturation => {
            "it is not linear; the filter models it, the law respects it only with [controller] compensate = \
             [\"input_saturation\"] or limits in [inputs]"
        }
        Kind::RateLimit => {
            "it is not linear; the filter models it, the law respects it only with [controller] compensate = \
             [\"rate_limit\"] or a rate_limit in [inputs]"
        }
        Kind::CoulombFriction => {
            "it is not linear; the law counteracts it only with [controller] compensate = [\"coulomb_friction\"]"
        }
        Kind::QuadraticDrag | Kind::CubicStiffness => {
            "it is not linear; the law is designed for the linearisation at rest, without it"
        }
        Kind::StepDisturbance | Kind::PulseDisturbance | Kind::PeriodicDisturbance => {
            "a disturbance; the law rejects it without modelling it"
        }
        Kind::ModeTransition => "the law is designed for the vehicle before the transition",
        Kind::SensorDrift => {
            "it grows with time since the start, which a filter that starts later does not know"
        }
        Kind::OutputSaturation => "it is not linear",
        Kind::Dropouts | Kind::Outliers => "the filter assumes that every sample is new and valid",
        _ => return None,
    })
}

impl LinearModel {
    /// The linear model of `vehicle` with its own effects.
    ///
    /// # Errors
    /// [`SimulatorError`] when an effect does not fit the vehicle.
    pub fn new(vehicle: &Vehicle) -> Result<Self, SimulatorError> {
        let (mut linear, mut left_out) = (Vec::new(), Vec::new());
        for effect in &vehicle.effects {
            let place = effect.resolve(vehicle)?;
            match obstacle(effect) {
                Some(why) => left_out.push((effect.clone(), why)),
                None => linear.push((effect.clone(), place)),
            }
        }
        let system = System::new(vehicle, &linear, &vec![true; linear.len()])?;
        let (n, m) = vehicle.b.shape();
        let p = vehicle.outputs.len();
        let (a, b) = system.stages[0].clone();
        let nz = a.nrows();
        let (mut c, mut d) = (DMatrix::zeros(p, nz), DMatrix::zeros(p, m));
        for (i, (_, lagged)) in system.outputs.iter().enumerate() {
            lagged.spread(i, &mut c, &mut d);
        }
        let names = filter_names(vehicle, &linear);
        let mut model = Self {
            own: n,
            actuators: names.iter().filter(|(on_input, _)| *on_input).count(),
            a,
            b,
            c,
            d,
            mix: DMatrix::identity(p, p),
            input_delays_s: vec![0.0; m],
            output_delays_s: vec![0.0; p],
            trim: vec![0.0; m],
            on_inputs: input_effects(vehicle)?,
            friction: frictions(vehicle)?,
            offsets: vec![0.0; p],
            turbulence: vec![0.0; n],
            variance: vec![0.0; p],
            tones: Vec::new(),
            names: names.into_iter().map(|(_, name)| name).collect(),
            left_out,
        };
        model.take_inputs(&linear);
        model.take_outputs(vehicle, &linear);
        Ok(model)
    }

    /// True when the states depend only on the vehicle's own matrices: no delay, lag or mode on an input.
    pub fn is_prompt(&self) -> bool {
        self.actuators == 0 && self.input_delays_s.iter().all(|d| *d == 0.0)
    }

    /// True when a filter needs only the matrices of the motion and of the outputs.
    pub fn is_plain(&self) -> bool {
        let none = |values: &[f64]| values.iter().all(|v| *v == 0.0);
        self.is_prompt()
            && self.a.nrows() == self.own
            && none(&self.output_delays_s)
            && none(&self.trim)
            && self.on_inputs.iter().all(|i| *i == InputEffects::NONE)
            && none(&self.offsets)
            && none(&self.turbulence)
            && self.tones.is_empty()
            && self.mix.is_identity(0.0)
    }

    /// Adds gains, biases and delays of inputs, in the order in which they act.
    fn take_inputs(&mut self, effects: &[(Effect, Place)]) {
        let mut gains = vec![1.0; self.trim.len()];
        let mut biases = vec![0.0; self.trim.len()];
        for (effect, place) in effects {
            match (effect.kind(), *place) {
                (Kind::InputGain, Place::Input(i)) => gains[i] *= effect.get("factor"),
                (Kind::InputBias, Place::Input(i)) => biases[i] += effect.get("offset"),
                (Kind::InputDelay, Place::Input(i)) => self.input_delays_s[i] += effect.get("delay_s"),
                (Kind::Turbulence, Place::State(i)) => {
                    // A first-order shaped noise of variance s^2 and corner w has the density 2 s^2 / w at rest.
                    let corner = std::f64::consts::TAU * effect.get("bandwidth_hz");
                    let density = 2.0 * effect.get("std").powi(2) / corner;
                    self.turbulence[i] = (self.turbulence[i].powi(2) + density).sqrt();
                }
                _ => {}
            }
        }
        for (i, (gain, bias)) in gains.into_iter().zip(biases).enumerate() {
            if gain != 1.0 {
                self.b.column_mut(i).scale_mut(gain);
                self.d.column_mut(i).scale_mut(gain);
            }
            if bias != 0.0 && gain != 0.0 {
                self.trim[i] = -bias / gain;
            }
        }
    }

    /// Adds delays, misalignment, scale and offsets of outputs, in the order in which they act.
    fn take_outputs(&mut self, vehicle: &Vehicle, effects: &[(Effect, Place)]) {
        let mut scales = vec![1.0; self.offsets.len()];
        for (effect, place) in effects {
            match (effect.kind(), *place) {
                (_, Place::OutputPair(i, j)) => {
                    for (i, j) in vehicle.turned_outputs(i, j).into_iter().flatten() {
                        self.turn(i, j, effect.get("angle_rad"));
                    }
                }
                (Kind::SensorDelay, Place::Output(i)) => self.output_delays_s[i] += effect.get("delay_s"),
                (Kind::SensorScale, Place::Output(i)) => scales[i] *= effect.get("factor"),
                (Kind::SensorBias, Place::Output(i)) => self.offsets[i] += effect.get("offset"),
                (Kind::Noise, Place::Output(i)) => self.variance[i] += effect.get("std").powi(2),
                (Kind::Quantization, Place::Output(i)) => {
                    self.variance[i] += effect.get("step").powi(2) / 12.0;
                }
                (Kind::Vibration, Place::Output(i)) => self.tones.push((i, effect.get("frequency_hz"))),
                _ => {}
            }
        }
        for (i, scale) in scales.into_iter().enumerate() {
            self.mix.row_mut(i).scale_mut(scale);
        }
    }

    fn turn(&mut self, i: usize, j: usize, angle_rad: f64) {
        let (sine, cosine) = libm::sincos(angle_rad);
        let (first, second) = (self.mix.row(i).into_owned(), self.mix.row(j).into_owned());
        self.mix.set_row(i, &(&first * cosine + &second * sine));
        self.mix.set_row(j, &(second * cosine - first * sine));
    }
}

/// Names of the states that lags and modes add, in the order of [`System`], and whether they are on an input.
fn filter_names(vehicle: &Vehicle, effects: &[(Effect, Place)]) -> Vec<(bool, String)> {
    let at = |kind: Kind, wanted: Place| {
        effects.iter().filter(move |(e, p)| e.kind() == kind && *p == wanted).map(|(e, _)| e)
    };
    let lags = |e: &&Effect| e.get("time_constant_s") > 0.0;
    let mut names = Vec::new();
    for kind in [Kind::ActuatorLag, Kind::UnmodelledMode] {
        for (i, input) in vehicle.inputs.iter().enumerate() {
            for _ in at(kind, Place::Input(i)).filter(|e| kind == Kind::UnmodelledMode || lags(e)) {
                if kind == Kind::ActuatorLag {
                    names.push((true, format!("{} lag", input.name)));
                } else {
                    names.push((true, format!("{} mode", input.name)));
                    names.push((true, format!("{} mode rate", input.name)));
                }
            }
        }
    }
    for (i, output) in vehicle.outputs.iter().enumerate() {
        let count = at(Kind::SensorLag, Place::Output(i)).filter(lags).count();
        names.extend((0..count).map(|_| (false, format!("{} lag", output.name))));
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::Window;

    #[test]
    fn a_plain_vehicle_is_its_own_matrices_bit_for_bit() {
        for name in crate::builtin_names() {
            let vehicle = Vehicle::builtin(name).unwrap();
            let model = LinearModel::new(&vehicle).unwrap();
            assert_eq!((&model.a, &model.b, &model.c), (&vehicle.a, &vehicle.b, &vehicle.c), "{name}");
            assert!(model.is_prompt() && model.left_out.is_empty() && model.mix.is_identity(0.0));
        }
    }

    #[test]
    fn every_effect_either_enters_or_is_told() {
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        for (kind, place, parameters) in [
            (Kind::InputGain, "u_roll", vec![("factor", 0.5)]),
            (Kind::InputBias, "u_roll", vec![("offset", 0.1)]),
            (Kind::InputDelay, "u_roll", vec![("delay_s", 0.12)]),
            (Kind::ActuatorLag, "u_pitch", vec![("time_constant_s", 0.05)]),
            (Kind::SensorLag, "pitch", vec![("time_constant_s", 0.02)]),
            (Kind::SensorScale, "roll", vec![("factor", 1.1)]),
            (Kind::Misalignment, "roll,pitch", vec![("angle_rad", 0.1)]),
            (Kind::DeadZone, "u_roll", vec![("width", 0.1)]),
        ] {
            vehicle.add_effect(Effect::new(kind, place, &parameters).unwrap()).unwrap();
        }
        let model = LinearModel::new(&vehicle).unwrap();
        assert_eq!((model.own, model.actuators, model.a.nrows()), (4, 1, 6));
        assert_eq!(model.names, ["u_pitch lag", "pitch lag"]);
        let roll = vehicle.input_index("u_roll").unwrap();
        assert_eq!((model.trim[roll], model.input_delays_s[roll]), (-0.2, 0.12));
        assert_eq!(model.left_out.len(), 1);
        let (i, j) = (vehicle.output_index("roll").unwrap(), vehicle.output_index("pitch").unwrap());
        assert!((model.mix[(i, j)] - 1.1 * 0.1f64.sin()).abs() < 1e-15);
        assert!((model.mix[(j, i)] + 0.1f64.sin()).abs() < 1e-15);
    }

    #[test]
    fn what_acts_for_a_part_of_the_time_is_left_out() {
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        for (kind, key, value) in [(Kind::InputGain, "factor", 0.5), (Kind::DeadZone, "width", 0.1)] {
            let late = Window { from_s: Some(3.0), until_s: None };
            let effect = Effect::new(kind, "u_roll", &[(key, value)]).unwrap().during(late).unwrap();
            vehicle.add_effect(effect).unwrap();
        }
        let model = LinearModel::new(&vehicle).unwrap();
        assert_eq!((&model.b, model.on_inputs[0]), (&vehicle.b, InputEffects::NONE));
        assert!(
            model.left_out.iter().all(|(_, why)| why.contains("part of the time"))
                && model.left_out.len() == 2
        );
    }
}
