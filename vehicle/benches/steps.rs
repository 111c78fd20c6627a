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

criterion_group!(benches, bench);
criterion_main!(benches);
