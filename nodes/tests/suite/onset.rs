//! An effect of whatever kind begins in flight: until then nothing is different, from then on it acts.

use whirlstand_nodes::config::NodeConfig;
use whirlstand_nodes::flight::{Onset, Pilot};
use whirlstand_vehicle::{Effect, Kind, Window};

use crate::common;

/// States and measurements of every step.
fn flown(pilot: &Pilot, config: &NodeConfig, onset: Option<&Onset>) -> Vec<Vec<u64>> {
    let mut rows = Vec::new();
    let each = |s: &whirlstand_nodes::flight::Step<'_>| {
        rows.push(s.x.iter().chain(s.y).map(|v| v.to_bits()).collect());
    };
    pilot.fly_changed(config, onset, each).unwrap();
    rows
}

fn config() -> NodeConfig {
    let mut config = common::config("onset", 600);
    config.plant.initial = [("roll".to_string(), 0.2), ("pitch_rate".to_string(), -0.5)].into();
    config
}

#[test]
fn until_it_begins_the_flight_is_the_one_without_it_and_then_another() {
    let config = config();
    let pilot = Pilot::new(&config).unwrap();
    let clean = flown(&pilot, &config, None);
    for (kind, place, parameter, value) in [
        (Kind::InputDelay, "u_roll", "delay_s", 0.05),
        (Kind::ActuatorLag, "u_roll", "time_constant_s", 0.1),
        (Kind::CoulombFriction, "roll_rate", "level", 0.1),
    ] {
        let onset = Onset { effect: Effect::new(kind, place, &[(parameter, value)]).unwrap(), step: 200 };
        let changed = flown(&pilot, &config, Some(&onset));
        assert_eq!(changed[..200], clean[..200], "{kind}: before its begin");
        assert!(changed[200..230] != clean[200..230], "{kind}: it does nothing");
    }
}

#[test]
fn what_the_plant_switches_begins_with_its_window() {
    let mut config = config();
    let pilot = Pilot::new(&config).unwrap();
    let gain = Effect::new(Kind::InputGain, "u_roll", &[("factor", 0.5)]).unwrap();
    let changed = flown(&pilot, &config, Some(&Onset { effect: gain.clone(), step: 200 }));
    let from_s = Some(200.0 * 1e-9 * config.period_ns as f64);
    config.effects.push(gain.during(Window { from_s, until_s: None }).unwrap());
    assert!(changed == flown(&pilot, &config, None));
}
