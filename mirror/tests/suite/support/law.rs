//! The law and the filter of the flights.

use whirlstand_control::{
    Controller, Design, Estimator, EstimatorOptions, InputLimits, LawOptions, LqrOptions, SampledPlant,
    Sensors,
};
use whirlstand_vehicle::{Engine, LinearModel, Vehicle};

/// LQR and the default filter for a vehicle, with the sensor noise of the engine's state.
pub fn law(vehicle: &Vehicle, period_s: f64, engine: Engine) -> (Controller, Estimator) {
    let linear = LinearModel::new(vehicle).unwrap();
    let plant = SampledPlant::of(&linear, period_s).unwrap();
    let limits = vehicle.inputs.iter();
    let limits = limits.map(|i| InputLimits { lower: i.lower, upper: i.upper, rate: i.rate_limit }).collect();
    let plant = plant.with_limits(limits).unwrap();
    let states = vehicle.states.iter().map(|s| s.name.clone()).collect();
    let inputs = vehicle.inputs.iter().map(|i| i.name.clone()).collect();
    let plant = plant.with_names(states, inputs).unwrap();
    let design = Design::new(&plant, &LawOptions::Lqr(LqrOptions::default())).unwrap();
    let sensors = Sensors {
        c: linear.c.columns(0, linear.own).into_owned(),
        d: linear.d.clone(),
        std: vehicle.outputs.iter().map(|o| o.sensor_std(engine, 0.0).max(1e-6)).collect(),
        names: vehicle.outputs.iter().map(|o| o.name.clone()).collect(),
    };
    let estimator = Estimator::of(&plant, &sensors, Some(&linear), &EstimatorOptions::default()).unwrap();
    (Controller::new(&design), estimator)
}
