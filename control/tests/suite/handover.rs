//! One law takes over from another in flight: the command has no bump, whatever the laws, and the loop goes on.

use allocation_counter::measure;
use whirlstand_control::{Controller, Design, InputLimits, LawOptions, SampledPlant, Selector};
use whirlstand_vehicle::{Effect, Kind, LinearModel, Simulator, Vehicle};

const PERIOD: f64 = 0.005;

/// A steady moment about roll, so that something has to hold against it: integrals, or a steady error.
fn pushed(vehicle: &Vehicle) -> Vehicle {
    let mut pushed = vehicle.clone();
    let push = [("at_s", 0.5), ("magnitude", 0.1)];
    pushed.add_effect(Effect::new(Kind::StepDisturbance, "roll_rate", &push).expect("fits")).expect("fits");
    pushed
}

fn vehicle(effects: &[(Kind, &[(&str, f64)])]) -> Vehicle {
    let mut vehicle = Vehicle::builtin("quadrotor").expect("built in");
    for (kind, parameters) in effects {
        vehicle.add_effect(Effect::new(*kind, "u_roll", parameters).expect("fits")).expect("fits");
    }
    vehicle
}

fn design(vehicle: &Vehicle, law: &str, integral: bool) -> Design {
    let limits =
        vehicle.inputs.iter().map(|i| InputLimits { lower: i.lower, upper: i.upper, rate: i.rate_limit });
    let states = vehicle.states.iter().map(|s| s.name.clone()).collect();
    let inputs = vehicle.inputs.iter().map(|i| i.name.clone()).collect();
    let linear = LinearModel::new(vehicle).expect("fits");
    let plant = SampledPlant::of(&linear, PERIOD)
        .and_then(|p| p.with_limits(limits.collect()))
        .and_then(|p| p.with_names(states, inputs))
        .expect("sound");
    let mut options = LawOptions::named(law).expect("known");
    if integral {
        let roll = vec![Selector::Name("roll".into())];
        match &mut options {
            LawOptions::Lqr(o) => o.integral = roll,
            LawOptions::Ppc(o) => o.integral = roll,
            LawOptions::Smc(o) => o.integral = roll,
        }
    }
    Design::new(&plant, &options).expect("controllable")
}

/// What a change of law did to the command of roll.
#[derive(Debug)]
struct Change {
    /// From the last command of the old law to the first of the new one.
    jump: f64,
    /// The same where the new law begins at rest.
    cold: f64,
    /// Largest change from step to step before.
    usual: f64,
    /// Roll 6 s later.
    roll: f64,
}

/// Flies `truth` with `old`, and with `new` from 2 s on, which has flown along for so many steps.
fn change(truth: &Vehicle, old: &Design, new: &Design, along: u32) -> Change {
    let mut simulator = Simulator::expected(&pushed(truth), PERIOD).expect("slow enough");
    let (mut flying, mut coming) = (Controller::new(old), Controller::new(new));
    let mut cold = coming.clone();
    let reference = [0.03, 0.0, 0.0, 0.0];
    let (mut now, mut next) = ([0.0; 2], [0.0; 2]);
    let mut said = Change { jump: f64::NAN, cold: f64::NAN, usual: 0.0, roll: f64::NAN };
    for k in 0..1600u32 {
        now = std::mem::replace(&mut next, now);
        simulator.apply(&now);
        simulator.measure();
        let x = simulator.state()[..4].to_vec();
        if k == 400 {
            let mut other = [0.0; 2];
            cold.set_command_in_force(&now);
            cold.step(&x, &reference, 1, &mut other);
            said.cold = (other[0] - now[0]).abs();
            std::mem::swap(&mut flying, &mut coming);
        }
        let counted = measure(|| {
            flying.step(&x, &reference, 1, &mut next);
            if (400 - along..400).contains(&k) {
                assert!(coming.fly_along(&flying, &x, &reference, 1));
            }
        });
        assert_eq!(counted.count_total, 0, "step {k}");
        match k {
            380..400 => said.usual = said.usual.max((next[0] - now[0]).abs()),
            400 => said.jump = (next[0] - now[0]).abs(),
            _ => {}
        }
        simulator.advance();
    }
    said.roll = simulator.state()[0];
    said
}

#[test]
fn a_law_takes_over_without_a_bump_whatever_the_laws() {
    let plain = vehicle(&[]);
    let weak = vehicle(&[(Kind::InputGain, &[("factor", 0.5)])]);
    let late = vehicle(&[(Kind::InputDelay, &[("delay_s", 0.06)])]);
    let slow = vehicle(&[(Kind::ActuatorLag, &[("time_constant_s", 0.15)])]);
    for truth in [&weak, &late, &slow] {
        for integral in [false, true] {
            for (from, to) in [("lqr", "lqr"), ("lqr", "ppc"), ("ppc", "smc"), ("smc", "lqr")] {
                let (old, new) = (design(&plain, from, integral), design(truth, to, integral));
                let said = change(truth, &old, &new, 60);
                let what = format!("{} with {integral}, {from} to {to}: {said:?}", truth.effects[0].kind());
                // Beside what the command does anyhow, within half a per cent of what the input can do: a sliding law moves by so
                // much within its layer.
                assert!(said.jump < 2.0 * said.usual + 0.005 * plain.inputs[0].upper, "{what}");
                assert!(said.cold > 3.0 * said.jump && said.cold > 0.1, "{what}");
                // A steady error is left where there is no integral.
                assert!((said.roll - 0.03).abs() < if integral { 0.003 } else { 0.1 }, "{what}");
            }
        }
    }
}

/// The hand of a pilot flies for a second in the place of the law, with a deflection that no law would have; then the law goes on.
#[test]
fn a_law_goes_on_from_where_a_hand_has_left_the_command() {
    let late = vehicle(&[(Kind::InputDelay, &[("delay_s", 0.03)])]);
    for integral in [false, true] {
        for law in ["lqr", "ppc", "smc"] {
            let designed = design(&late, law, integral);
            let mut simulator = Simulator::expected(&pushed(&late), PERIOD).expect("slow enough");
            let (mut flying, mut pilot) =
                (Controller::new(&designed), Controller::new(&design(&late, "lqr", false)));
            let mut cold = Controller::new(&designed);
            let reference = [0.03, 0.0, 0.0, 0.0];
            let (mut now, mut next, mut shadow) = ([0.0; 2], [0.0; 2], [0.0; 2]);
            let (mut jump, mut cold_jump, mut usual) = (f64::NAN, f64::NAN, 0f64);
            for k in 0..1600u32 {
                now = std::mem::replace(&mut next, now);
                simulator.apply(&now);
                simulator.measure();
                let x = simulator.state()[..4].to_vec();
                pilot.step(&x, &reference, 1, &mut shadow);
                let by_hand = [shadow[0] + 0.05 * late.inputs[0].upper, shadow[1]];
                let counted = measure(|| {
                    if (200..400).contains(&k) {
                        next = by_hand;
                        assert!(flying.fly_along_by_hand(&next, &x, &reference, 1));
                    } else {
                        flying.step(&x, &reference, 1, &mut next);
                    }
                });
                assert_eq!(counted.count_total, 0, "step {k}");
                match k {
                    380..400 => usual = usual.max((next[0] - now[0]).abs()),
                    400 => {
                        jump = (next[0] - now[0]).abs();
                        let mut other = [0.0; 2];
                        cold.set_command_in_force(&now);
                        cold.step(&x, &reference, 1, &mut other);
                        cold_jump = (other[0] - now[0]).abs();
                    }
                    _ => {}
                }
                simulator.advance();
            }
            let what = format!("{law}, integral {integral}: {jump} after {usual}, from rest {cold_jump}");
            assert!(jump < 2.0 * usual + 0.005 * late.inputs[0].upper, "{what}");
            assert!(cold_jump > 3.0 * jump, "{what}");
            let roll = simulator.state()[0];
            assert!((roll - 0.03).abs() < if integral { 0.003 } else { 0.1 }, "{what}: roll {roll}");
        }
    }
    let mut law = Controller::new(&design(&late, "lqr", false));
    assert!(!law.fly_along_by_hand(&[f64::NAN, 0.0], &[0.0; 4], &[0.0; 4], 0), "no number");
    assert!(!law.fly_along_by_hand(&[0.0], &[0.0; 4], &[0.0; 4], 0), "too few");
}

#[test]
fn a_law_of_another_vehicle_does_not_take_over() {
    let other = Vehicle::builtin("helicopter-hover").expect("built in");
    let linear = LinearModel::new(&other).expect("fits");
    let plant = SampledPlant::of(&linear, PERIOD).expect("sound");
    let lqr = LawOptions::named("lqr").expect("known");
    let flying = Controller::new(&Design::new(&plant, &lqr).expect("controllable"));
    let mut coming = Controller::new(&design(&vehicle(&[]), "lqr", false));
    assert!(!coming.fly_along(&flying, &[0.0; 4], &[0.0; 4], 0));
}
