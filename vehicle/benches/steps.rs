//! How long a step takes: `cargo bench -p whirlstand-vehicle`.

#![expect(missing_docs, reason = "criterion's macro makes a public function")]

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use whirlstand_vehicle::{Effect, Kind, Simulator, Vehicle};

const STEPS: u64 = 1000;

fn bench(c: &mut Criterion) {
    let mut group = c.benchmark_group("steps");
    group.throughput(Throughput::Elements(STEPS));
    let mut run = |name: &str, vehicle: &Vehicle, measure: bool| {
        let mut simulator = Simulator::new(vehicle, 0.005, 1).expect("a valid vehicle");
        group.bench_function(name, |b| {
            b.iter(|| {
                for k in 0..STEPS {
                    let stick = if k & 64 == 0 { 1.0 } else { -1.0 };
                    simulator.step(black_box(&[stick, -stick]));
                    if measure {
                        black_box(simulator.measure());
                    }
                }
                black_box(simulator.state()[0])
            });
        });
    };
    let quadrotor = Vehicle::builtin("quadrotor").expect("built in");
    let hover = Vehicle::builtin("helicopter-hover").expect("built in");
    run("4 states", &quadrotor, false);
    run("8 states", &hover, false);
    run("8 states, measured", &hover, true);
    let with = |kind, place, parameters: &[(&str, f64)]| {
        let mut vehicle = hover.clone();
        vehicle.add_effect(Effect::new(kind, place, parameters).expect("valid")).expect("fits");
        vehicle
    };
    run("8 states, input_delay", &with(Kind::InputDelay, "u_roll", &[("delay_s", 0.0823)]), false);
    run("8 states, actuator_lag", &with(Kind::ActuatorLag, "u_roll", &[("time_constant_s", 0.05)]), false);
    run(
        "8 states, quadratic_drag",
        &with(Kind::QuadraticDrag, "lateral_speed", &[("coefficient", 0.1)]),
        false,
    );
    run("8 states, coulomb_friction", &with(Kind::CoulombFriction, "roll_rate", &[("level", 0.1)]), false);
}

/// Whole records at once, as diagnosis simulates them by the thousand.
fn records(c: &mut Criterion) {
    let mut group = c.benchmark_group("record");
    let steps = 6000;
    group.throughput(Throughput::Elements(steps));
    let hover = Vehicle::builtin("helicopter-hover").expect("built in");
    let (m, p) = (hover.inputs.len(), hover.outputs.len());
    let inputs: Vec<f64> = (0..steps as usize * m).map(|at| if at & 128 == 0 { 0.1 } else { -0.1 }).collect();
    let mut outputs = vec![0.0; steps as usize * p];
    let mut run = |name: &str, effects: &[Effect]| {
        let mut vehicle = hover.clone();
        effects.iter().for_each(|effect| vehicle.add_effect(effect.clone()).expect("fits"));
        group.bench_function(name, |b| {
            b.iter(|| {
                let mut simulator = Simulator::expected(&vehicle, 0.01).expect("a valid vehicle");
                simulator.run(black_box(&inputs), &mut outputs);
                black_box(outputs[0])
            });
        });
    };
    let effect =
        |kind, place, parameters: &[(&str, f64)]| Effect::new(kind, place, parameters).expect("valid");
    let cubic = effect(Kind::CubicStiffness, "lateral_speed->lateral_speed", &[("coefficient", 0.01)]);
    let pulse = [("at_s", 20.004), ("duration_s", 1.0), ("magnitude", 0.1)];
    let pulse = effect(Kind::PulseDisturbance, "roll_rate", &pulse);
    let sine = [("frequency_hz", 8.0), ("amplitude", 0.1), ("phase_rad", 0.0)];
    let sine = effect(Kind::PeriodicDisturbance, "roll_rate", &sine);
    run("no effect", &[]);
    run("input_gain", &[effect(Kind::InputGain, "u_roll", &[("factor", 0.9)])]);
    run("actuator_lag", &[effect(Kind::ActuatorLag, "u_roll", &[("time_constant_s", 0.05)])]);
    run("sensor_delay", &[effect(Kind::SensorDelay, "roll_rate", &[("delay_s", 0.033)])]);
    run("quadratic_drag", &[effect(Kind::QuadraticDrag, "lateral_speed", &[("coefficient", 0.1)])]);
    run("pulse_disturbance", std::slice::from_ref(&pulse));
    run("cubic_stiffness", std::slice::from_ref(&cubic));
    run("cubic_stiffness, pulse_disturbance", &[cubic.clone(), pulse]);
    run("periodic_disturbance", std::slice::from_ref(&sine));
    run("cubic_stiffness, periodic_disturbance", &[cubic, sine]);
}

criterion_group!(benches, bench, records);
criterion_main!(benches);
