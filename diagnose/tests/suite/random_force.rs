//! Diagnoses of flights with several forces on one state.

use whirlstand_vehicle::{Effect, Kind, Vehicle};

use crate::support::{diagnosis, flight, named};

/// A quadrotor's file, with or without the noise of its sensors, and what is diagnosed of a flight with three pushes on it.
fn pushed(pushes: [(f64, f64, f64); 3], declared: bool) -> Vec<String> {
    let mut given = Vehicle::builtin("quadrotor").unwrap();
    let mut vehicle = given.clone();
    for (at_s, duration_s, magnitude) in pushes {
        let push = [("at_s", at_s), ("duration_s", duration_s), ("magnitude", magnitude)];
        vehicle.add_effect(Effect::new(Kind::PulseDisturbance, "roll_rate", &push).unwrap()).unwrap();
    }
    if !declared {
        given.outputs.iter_mut().for_each(|output| output.noise = 0.0);
    }
    named(&diagnosis(flight(&vehicle, 20.0, &[0.0; 4], 3.0, Some(1)), &given)).concat()
}

#[test]
fn three_pushes_are_events_one_after_another_and_where_they_explain_more_than_a_random_force() {
    let apart = pushed([(3.0, 1.0, 2.0), (8.0, 1.0, -2.0), (14.0, 2.0, 1.5)], true);
    let together = pushed([(2.0, 4.0, 0.05), (4.0, 6.0, -0.05), (14.0, 3.0, 0.05)], false);
    for names in [apart, together] {
        let pushes = names.iter().filter(|name| *name == "pulse_disturbance(roll_rate)");
        assert_eq!(pushes.count(), 3, "{names:?}");
    }
}

/// A slow force that three pushes describe badly is a random one.
#[test]
fn pushes_that_hardly_end_are_one_random_force() {
    let names = pushed([(2.0, 16.0, 0.2), (4.0, 3.0, -0.3), (10.0, 3.0, 0.25)], true);
    assert_eq!(names, ["turbulence(roll_rate)"]);
}
