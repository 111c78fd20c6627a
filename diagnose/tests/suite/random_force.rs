//! Diagnoses of flights with several forces at a time on one state.

use whirlstand_vehicle::{Effect, Kind, Vehicle};

use crate::support::{diagnosis, flight, named};

/// A sum of pushes at the same time describes any force: it is one force, random or of unknown course, and no list of events.
/// Pushes one after another are.
#[test]
fn pushes_at_the_same_time_are_told_as_one_force() {
    let given = Vehicle::builtin("quadrotor").unwrap();
    let fly = |pushes: [(f64, f64, f64); 3]| {
        let mut vehicle = given.clone();
        for (at_s, duration_s, magnitude) in pushes {
            let push = [("at_s", at_s), ("duration_s", duration_s), ("magnitude", magnitude)];
            vehicle.add_effect(Effect::new(Kind::PulseDisturbance, "roll_rate", &push).unwrap()).unwrap();
        }
        diagnosis(flight(&vehicle, 20.0, &[0.0; 4], 3.0, Some(1)), &given)
    };
    let together = fly([(3.0, 9.0, 1.0), (5.0, 2.0, -1.5), (9.0, 6.0, 1.0)]);
    let one = ["turbulence on roll_rate", "orce of unknown course acts on roll_rate"];
    assert!(one.iter().any(|one| together.summary.contains(one)), "{}", together.summary);
    let events = named(&together).concat();
    assert!(events.iter().all(|name| !name.contains("_disturbance")), "{}", together.summary);
    let apart = fly([(3.0, 1.0, 2.0), (8.0, 1.0, -2.0), (14.0, 2.0, 1.5)]);
    let pushes = named(&apart).concat();
    let pushes = pushes.iter().filter(|name| *name == "pulse_disturbance(roll_rate)");
    assert_eq!(pushes.count(), 3, "{}", apart.summary);
}
