//! Tests of closed-loop trials.

use crate::{Case, Generator, Loops, Plan, Setting, Trial};

fn short() -> Setting {
    Setting { lengths_s: Some((8.0, 14.0)), rates_hz: Some(vec![50.0]), ..Setting::default() }
}

#[test]
fn the_record_holds_what_the_law_gave_for_what_the_sensors_said() {
    let mut checked = 0;
    for generator in [Generator::Reference, Generator::Shifted] {
        for number in 6_000_000..6_000_050 {
            let plan = Plan::new(number, generator, Loops::Closed);
            let Some(trial) = Trial::draw(&plan, &short()).unwrap() else { continue };
            let (control, commands) =
                (trial.experiment.control.as_ref().unwrap(), &trial.experiment.commands);
            let largest = commands.inputs.iter().flatten().fold(0.0f64, |peak, u| peak.max(u.abs()));
            let p = trial.answer.noise_std.len();
            let mut law = control.law.clone();
            for (k, row) in trial.record.chunks_exact(p).enumerate() {
                let reference: Vec<f64> = control.reference.inputs.iter().map(|u| u[k]).collect();
                let given: Vec<f64> = commands.inputs.iter().map(|u| u[k]).collect();
                for (u, said) in given.iter().zip(law.command(&reference)) {
                    // The record is simulated again from the commands, on another grid of steps: rounding
                    // errors remain.
                    assert!(
                        (u - said).abs() < 1e-5 * largest,
                        "{number} {:?} at {k}: {u} {said}",
                        trial.answer.effects
                    );
                }
                law.measure(&given, row);
            }
            checked += 1;
        }
    }
    assert!(checked > 80, "{checked}");
}

#[test]
fn half_of_the_vehicle_files_do_not_say_how_noisy_the_sensors_are() {
    let mut declared = [0, 0];
    for number in (6_000_000..).take(100) {
        let plan = Plan::new(number, Generator::Reference, Loops::Closed);
        if plan.case != Case::Clean && plan.case != Case::Single {
            continue;
        }
        let Some(trial) = Trial::draw(&plan, &short()).unwrap() else { continue };
        assert!(trial.answer.closed_loop && trial.answer.noise_std.iter().all(|std| *std > 0.0));
        assert_eq!(trial.vehicle_file().contains("noise"), trial.answer.noise_declared);
        declared[usize::from(trial.answer.noise_declared)] += 1;
    }
    // There are at least 60 trials; the standard deviation of the count is below 4.
    assert!(declared.iter().all(|count| *count > 15), "{declared:?}");
}

#[test]
fn both_kinds_of_loop_take_turns() {
    let closed = (0..50).filter(|n| Plan::new(*n, Generator::Shifted, Loops::Both).closed_loop).count();
    assert_eq!(closed, 25);
}
