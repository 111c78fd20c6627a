//! A control step does not allocate: counted by the allocator itself.

use allocation_counter::measure;
use nalgebra::DMatrix;
use whirlstand_control::{
    Controller, Design, Estimator, EstimatorKind, EstimatorOptions, LawOptions, SampledPlant, Sensors,
};
use whirlstand_vehicle::{Effect, Kind, LinearModel, Vehicle};

use crate::support::{ALL, plant};

/// The quadrotor with late inputs and sensors, a lag, a trim and a tone.
fn late() -> (&'static str, SampledPlant, Option<LinearModel>) {
    let mut vehicle = Vehicle::builtin("quadrotor").expect("built in");
    for (kind, place, name, value) in [
        (Kind::InputDelay, "u_roll", "delay_s", 0.1213),
        (Kind::ActuatorLag, "u_pitch", "time_constant_s", 0.05),
        (Kind::InputBias, "u_roll", "offset", 0.1),
        (Kind::SensorDelay, "roll", "delay_s", 0.0321),
        (Kind::SensorLag, "pitch", "time_constant_s", 0.02),
        (Kind::SensorBias, "roll", "offset", 0.01),
        (Kind::GainDrift, "u_roll", "rate_per_s", 0.001),
        (Kind::DeadZone, "u_roll", "width", 0.1),
        (Kind::RateLimit, "u_roll", "limit_per_s", 1000.0),
        (Kind::Backlash, "u_pitch", "width", 0.1),
    ] {
        vehicle.add_effect(Effect::new(kind, place, &[(name, value)]).expect("in range")).expect("fits");
    }
    let tone = [("frequency_hz", 33.0), ("amplitude", 0.1)];
    vehicle.add_effect(Effect::new(Kind::Vibration, "roll_rate", &tone).expect("in range")).expect("fits");
    let linear = LinearModel::new(&vehicle).expect("fits");
    let plant = SampledPlant::of(&linear, 0.005).expect("sound");
    ("late quadrotor", plant, Some(linear))
}

#[test]
fn controller_and_estimator_steps_allocate_nothing() {
    for (name, plant, linear) in [
        ("quadrotor", plant("quadrotor"), None),
        ("helicopter-hover", plant("helicopter-hover"), None),
        late(),
    ] {
        let n = plant.own_count();
        let sensors = Sensors {
            c: DMatrix::identity(n, n),
            d: DMatrix::zeros(n, 2),
            std: vec![0.01; n],
            names: plant.own_names().to_vec(),
        };
        let mut laws: Vec<Controller> = ["lqr", "ppc", "smc"]
            .iter()
            .map(|law| {
                let design = Design::new(&plant, &LawOptions::named(law).expect("known")).expect("ok");
                let mut controller = Controller::new(&design);
                if let Some(linear) = &linear {
                    // What a law had better leave alone it leaves alone: a step of what remains is looked at.
                    controller.compensate(&design, linear, &ALL);
                }
                controller
            })
            .collect();
        let mut filters: Vec<Estimator> = [EstimatorKind::Kinematic, EstimatorKind::Model]
            .iter()
            .map(|&kind| {
                let options = EstimatorOptions { kind, ..EstimatorOptions::default() };
                Estimator::of(&plant, &sensors, linear.as_ref(), &options).expect("observable")
            })
            .collect();
        let mut out = [0.0; 2];
        let mut reference = [0.0; 8];
        let counted = measure(|| {
            for k in 0..3000u64 {
                reference[0] = 0.01 * (k / 500) as f64;
                let measured = [0.001 * (k % 7) as f64; 8];
                // Dropouts and changes of the tracked set are part of the step.
                let mask = if k % 1000 == 999 { 0b11 } else { u64::MAX };
                for filter in &mut filters {
                    filter.step(&measured[..n], mask, &[0.1, 0.2], &[0.1, 0.2]);
                }
                let x = if k % 700 == 699 { &[f64::NAN; 8][..n] } else { filters[1].x() };
                for law in &mut laws {
                    law.step(x, &reference[..n], if k > 1500 { 0b101 } else { 0 }, &mut out);
                }
            }
        });
        assert_eq!(counted.count_total, 0, "{name}");
    }
}
