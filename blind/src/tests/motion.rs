//! Tests of the generator against closed forms and against the simulator, an independent implementation of
//! the same definitions: where they differ, one is wrong.

use whirlstand_vehicle::{Effect, Kind, Simulator, Vehicle};

use crate::commands::Commands;
use crate::excitation::Excitation;
use crate::generator::Generator;
use crate::hidden::Hidden;
use crate::manoeuvres::{self, CommandFormat};
use crate::motion::fly;
use crate::random::RandomStream;
use crate::sense::sense;
use crate::truth_model::TruthModel;
use crate::turbulence::Spectrum;

const PERIOD: f64 = 0.01;

pub(super) fn commands(vehicle: &Vehicle, samples: usize, amplitude: f64) -> Commands {
    let mut stream = RandomStream::new(5, "test");
    let ranges = &Generator::Reference.ranges().excitation;
    let format = CommandFormat { inputs: vehicle.inputs.len(), samples, period_s: PERIOD, highest_hz: 1.0 };
    let mut inputs = manoeuvres::commands(Excitation::Steps3211, ranges, format, &mut stream);
    inputs.iter_mut().flatten().for_each(|u| *u *= amplitude);
    Commands { period_s: PERIOD, inputs }
}

/// The generator's record without noise (samples x outputs).
fn own(vehicle: &Vehicle, commands: &Commands, effects: &[Effect]) -> Vec<f64> {
    let hidden = Hidden { effects, outside: None, expected: true, spectrum: Spectrum::FirstOrder, trial: 1 };
    let model = TruthModel::new(vehicle, commands, hidden).unwrap();
    let x0 = vec![0.0; vehicle.states.len()];
    let motion = fly(&model, &x0, commands.period_s, commands.samples()).unwrap();
    sense(vehicle, &motion, None, commands.period_s, hidden).unwrap()
}

fn simulators(vehicle: &Vehicle, commands: &Commands, effects: &[Effect]) -> Vec<f64> {
    let mut vehicle = vehicle.clone();
    for effect in effects {
        vehicle.add_effect(effect.clone()).unwrap();
    }
    let mut simulator = Simulator::expected(&vehicle, commands.period_s).unwrap();
    let samples = commands.samples();
    let rows: Vec<f64> = (0..samples).flat_map(|k| commands.inputs.iter().map(move |u| u[k])).collect();
    let mut outputs = vec![0.0; samples * vehicle.outputs.len()];
    simulator.run(&rows, &mut outputs);
    outputs
}

/// Largest rms difference between generator and simulator relative to the rms change by the effect, and this
/// change relative to the rms of the record.
pub(super) fn difference(vehicle: &Vehicle, commands: &Commands, effects: &[Effect]) -> (f64, f64) {
    let (a, b) = (own(vehicle, commands, effects), simulators(vehicle, commands, effects));
    let nominal = own(vehicle, commands, &[]);
    let p = vehicle.outputs.len();
    let rms = |of: &dyn Fn(usize) -> f64, i: usize| -> f64 {
        let square: f64 = (i..a.len()).step_by(p).map(|k| of(k) * of(k)).sum();
        (square * p as f64 / a.len() as f64).sqrt()
    };
    let (mut worst, mut visible) = (0.0f64, 0.0f64);
    for i in 0..p {
        let record = rms(&|k| a[k], i).max(1e-12);
        worst = worst.max(rms(&|k| a[k] - b[k], i) / record);
        visible = visible.max(rms(&|k| a[k] - nominal[k], i) / record);
    }
    (worst / visible.max(1e-12), visible)
}

fn effect(kind: Kind, place: &str, parameters: &[(&str, f64)]) -> Effect {
    Effect::new(kind, place, parameters).unwrap()
}

/// Every deterministic effect of the table, with sizes that are visible in the record.
fn all() -> Vec<Effect> {
    vec![
        effect(Kind::InputDelay, "u_roll", &[("delay_s", 0.0837)]),
        effect(Kind::ActuatorLag, "u_pitch", &[("time_constant_s", 0.09)]),
        effect(Kind::InputGain, "u_roll", &[("factor", 0.8)]),
        effect(Kind::GainDrift, "u_roll", &[("rate_per_s", -0.01)]),
        effect(Kind::InputBias, "u_pitch", &[("offset", 0.7)]),
        effect(Kind::DeadZone, "u_roll", &[("width", 1.3)]),
        effect(Kind::InputSaturation, "u_pitch", &[("lower", -2.0), ("upper", 2.5)]),
        effect(Kind::RateLimit, "u_roll", &[("limit_per_s", 11.3)]),
        effect(Kind::Backlash, "u_roll", &[("width", 2.7)]),
        effect(Kind::InputCoupling, "u_roll->u_pitch", &[("coefficient", 0.25)]),
        effect(Kind::ParameterChange, "A[4,3]", &[("factor", 1.3)]),
        effect(Kind::ParameterChange, "B[2,1]", &[("value", -0.015)]),
        effect(Kind::QuadraticDrag, "roll_rate", &[("coefficient", 6.0)]),
        effect(Kind::CoulombFriction, "roll_rate", &[("level", 0.03), ("asymmetry", 0.008)]),
        effect(Kind::CubicStiffness, "roll->roll_rate", &[("coefficient", 90.0)]),
        effect(
            Kind::UnmodelledMode,
            "u_pitch",
            &[("frequency_hz", 4.3), ("damping_ratio", 0.1), ("gain", 1.1)],
        ),
        effect(Kind::StepDisturbance, "roll_rate", &[("at_s", 3.1234), ("magnitude", 0.05)]),
        effect(
            Kind::PulseDisturbance,
            "pitch_rate",
            &[("at_s", 4.003), ("duration_s", 0.2345), ("magnitude", 2.0)],
        ),
        effect(
            Kind::PeriodicDisturbance,
            "pitch_rate",
            &[("frequency_hz", 1.7), ("amplitude", 0.3), ("phase_rad", 0.4)],
        ),
        effect(Kind::SensorBias, "pitch", &[("offset", 0.02)]),
        effect(Kind::SensorDrift, "pitch", &[("rate_per_s", 0.003)]),
        effect(Kind::SensorScale, "roll_rate", &[("factor", 1.1)]),
        effect(Kind::SensorDelay, "roll", &[("delay_s", 0.0437)]),
        effect(Kind::SensorLag, "pitch_rate", &[("time_constant_s", 0.07)]),
        effect(Kind::Misalignment, "roll,pitch", &[("angle_rad", 0.1)]),
        effect(
            Kind::Vibration,
            "roll_rate",
            &[("frequency_hz", 17.3), ("amplitude", 0.02), ("phase_rad", 1.0)],
        ),
        effect(Kind::OutputSaturation, "pitch", &[("lower", -0.05), ("upper", 0.06)]),
    ]
}

#[test]
fn every_effect_is_what_the_simulator_makes_of_it() {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    let commands = commands(&vehicle, 2000, 5.0);
    let mut failed = Vec::new();
    for effect in all() {
        let (worst, visible) = difference(&vehicle, &commands, std::slice::from_ref(&effect));
        println!(
            "{:<22} {:<16} differs by {worst:.1e} of an effect of {visible:.3}",
            effect.kind().name(),
            effect.place()
        );
        if worst > 1e-3 || visible < 0.01 {
            failed.push(format!("{} {worst:.1e} {visible:.3}", effect.kind()));
        }
    }
    assert!(failed.is_empty(), "{failed:?}");
}

#[test]
fn pairs_of_effects_are_what_the_simulator_makes_of_them() {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    let commands = commands(&vehicle, 500, 5.0);
    let all = all();
    let mut failed = Vec::new();
    for (i, first) in all.iter().enumerate() {
        for second in all.iter().skip(i + 1).step_by(5) {
            let (worst, _) = difference(&vehicle, &commands, &[first.clone(), second.clone()]);
            if worst > 2e-3 {
                failed.push(format!("{} and {}: {worst:.1e}", first.kind(), second.kind()));
            }
        }
    }
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn a_mode_transition_changes_the_model_at_its_time() {
    let mut vehicle = Vehicle::builtin("helicopter-hover").unwrap();
    vehicle.outputs.iter_mut().for_each(|o| o.every = 1);
    let commands = commands(&vehicle, 1500, 1.0);
    let effect = Effect::mode_transition(7.0042, "helicopter-lateral").unwrap();
    let (worst, visible) = difference(&vehicle, &commands, &[effect]);
    assert!(worst < 1e-3 && visible > 0.05, "{worst:.1e} {visible:.2}");
}
