//! Pole placement against SciPy's `place_poles`: `reference/place.json`.

use whirlstand_control::place::place;

use crate::support::{complex, distance, matrix, random_system};

fn table() -> serde_json::Value {
    serde_json::from_str(include_str!("../../reference/place.json")).expect("the reference table is JSON")
}

#[test]
fn named_cases_are_placed_as_closely_as_by_scipy() {
    let table = table();
    let mut failures = Vec::new();
    for case in table["cases"].as_array().expect("cases") {
        let name = case["name"].as_str().expect("name");
        let (a, b, poles) = (matrix(&case["a"]), matrix(&case["b"]), complex(&case["poles"]));
        let scipy = case["error"].as_f64().unwrap_or(f64::INFINITY);
        let condition = case["condition"].as_f64().unwrap_or(f64::INFINITY);
        match place(&a, &b, &poles) {
            Ok(placed) => {
                let error = distance(&placed.poles, &poles);
                println!(
                    "{name:40} error {error:.1e} scipy {scipy:.1e} condition {:.3e} scipy {condition:.3e} sweeps {}",
                    placed.condition, placed.sweeps
                );
                // Rounding decides below this, and the condition number says how much of it to expect.
                let rounding = 100.0 * f64::EPSILON * a.norm().max(1.0) * placed.condition;
                if error > (3.0 * scipy).max(rounding) || placed.condition > 1.05 * condition {
                    failures.push(format!("{name}: error {error:.1e}, condition {:.3e}", placed.condition));
                }
            }
            Err(e) => failures.push(format!("{name}: {e}")),
        }
    }
    assert!(failures.is_empty(), "{failures:#?}");
}

#[test]
fn two_hundred_random_systems() {
    let table = table();
    let (mut ours, mut theirs, mut better) = (Vec::new(), Vec::new(), 0);
    for (k, reference) in table["random"].as_array().expect("random").iter().enumerate() {
        let system = random_system(k);
        let placed = place(&system.a, &system.b, &system.poles).unwrap_or_else(|e| panic!("{k}: {e}"));
        let error = distance(&placed.poles, &system.poles);
        let scipy = reference[0].as_f64().unwrap_or(f64::INFINITY);
        let condition = reference[1].as_f64().unwrap_or(f64::INFINITY);
        ours.push(error);
        theirs.push(scipy);
        better += usize::from(placed.condition <= condition * 1.001);
        if placed.condition > 1.05 * condition {
            println!(
                "{k}: condition {:.4e} scipy {condition:.4e} sweeps {}",
                placed.condition, placed.sweeps
            );
        }
        if error > 10.0 * scipy && error > 1e-10 {
            println!("{k}: error {error:.1e} scipy {scipy:.1e} condition {:.2e}", placed.condition);
        }
    }
    let (mut o, mut t) = (ours.clone(), theirs.clone());
    o.sort_by(f64::total_cmp);
    t.sort_by(f64::total_cmp);
    println!(
        "error: median {:.1e} scipy {:.1e}, largest {:.1e} scipy {:.1e}",
        o[100], t[100], o[199], t[199]
    );
    println!("as robust or more: {better} of 200");
    assert!(o[199] <= 3.0 * t[199] && o[100] <= 3.0 * t[100]);
    assert!(better >= 180, "{better}");
}

#[test]
fn a_mode_that_no_input_moves_costs_no_gain_when_its_pole_is_asked_for_within_rounding() {
    let a = nalgebra::dmatrix![0.9, 0.005, 0.0; -0.005, 0.99, 0.0015; 0.0, 0.0, 0.9965];
    let b = nalgebra::dmatrix![0.0; 0.005; 0.0];
    for shift in [0.0, f64::EPSILON, -f64::EPSILON, 1e-12] {
        let poles = [0.8, 0.9, 0.9965 + shift].map(|p| nalgebra::Complex::new(p, 0.0));
        let gain = place(&a, &b, &poles).expect("the mode is asked for").gain;
        assert!(gain.amax() < 1e3, "{shift:e}: {gain}");
    }
}
