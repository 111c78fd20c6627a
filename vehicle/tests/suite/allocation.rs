//! A step allocates nothing, with any effect.

use allocation_counter::measure;
use whirlstand_vehicle::{Effect, Simulator, Vehicle, Window, builtin_names};

use crate::support::{EFFECTS, effect};

fn allocations(vehicle: &Vehicle) -> u64 {
    let mut simulator = Simulator::new(vehicle, 0.005, 1).unwrap();
    let u = vec![0.3; vehicle.inputs.len()];
    let push = vec![0.01; vehicle.states.len()];
    let counted = measure(|| {
        for k in 0..2000 {
            if k == 1000 {
                simulator.disturb(&push);
            }
            simulator.measure();
            simulator.step(&u);
        }
    });
    counted.count_total
}

#[test]
fn the_counter_counts() {
    let counted = measure(|| drop(std::hint::black_box(vec![1u8; 100])));
    assert_eq!(counted.count_total, 1);
}

#[test]
fn plain_steps_allocate_nothing() {
    for name in builtin_names() {
        assert_eq!(allocations(&Vehicle::builtin(name).unwrap()), 0, "{name}");
    }
}

#[test]
fn steps_with_every_effect_allocate_nothing() {
    let mut vehicle = Vehicle::builtin("helicopter-hover").unwrap();
    for text in EFFECTS {
        vehicle.add_effect(effect(text)).unwrap();
    }
    let used: std::collections::BTreeSet<_> = vehicle.effects.iter().map(Effect::kind).collect();
    assert_eq!(used.len(), whirlstand_vehicle::SPECS.len(), "every effect is used");
    assert_eq!(allocations(&vehicle), 0);
}

#[test]
fn effects_that_begin_and_end_allocate_nothing() {
    for text in EFFECTS {
        let mut vehicle = Vehicle::builtin("helicopter-hover").unwrap();
        let window = Window { from_s: Some(1.0), until_s: Some(4.0) };
        vehicle.add_effect(effect(text).during(window).unwrap()).unwrap();
        // One beside it that is switched by hand.
        vehicle.add_effect(effect(EFFECTS[1]).during(window).unwrap()).unwrap();
        let mut simulator = Simulator::new(&vehicle, 0.005, 1).unwrap().clone();
        let counted = measure(|| {
            for k in 0..1000 {
                if k == 500 {
                    assert!(simulator.switch(1, false));
                }
                simulator.measure();
                simulator.step(&[0.3, 0.3]);
            }
        });
        assert_eq!(counted.count_total, 0, "{text}");
    }
}
