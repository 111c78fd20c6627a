//! Riccati solvers against slycot, SciPy and exact solutions: `reference/riccati.json`.

use nalgebra::DMatrix;
use whirlstand_control::riccati::{Riccati, care, dare};

use crate::support::{matrix, random_system};

fn table() -> serde_json::Value {
    serde_json::from_str(include_str!("../../reference/riccati.json")).expect("the reference table is JSON")
}

/// What slycot reaches, this has to reach; what slycot does not, is shown but not asked for.
const GOAL: f64 = 1e-10;

#[test]
fn hard_cases_reach_what_slycot_reaches() {
    let table = table();
    let mut failures = Vec::new();
    for case in table["cases"].as_array().expect("cases") {
        let name = case["name"].as_str().expect("name");
        let [a, b, q, r] = ["a", "b", "q", "r"].map(|key| matrix(&case[key]));
        let s = case.get("s").map(matrix);
        let solve = if case["kind"] == "care" { care } else { dare };
        let slycot = case["slycot"].as_f64().unwrap_or(f64::INFINITY);
        let scipy = case["scipy"].as_f64().unwrap_or(f64::INFINITY);
        match solve(&a, &b, &q, &r, s.as_ref()) {
            Ok(Riccati { x, relative_residual, .. }) => {
                let exact = case.get("exact").map(|e| {
                    let e = matrix(e);
                    (&x - &e).norm() / e.norm()
                });
                println!(
                    "{name:32} residual {relative_residual:.1e} slycot {slycot:.1e} scipy {scipy:.1e} error {:.1e}",
                    exact.unwrap_or(f64::NAN)
                );
                if slycot.min(scipy) <= GOAL && relative_residual > GOAL {
                    failures.push(format!("{name}: {relative_residual:.1e}"));
                }
            }
            Err(error) => {
                println!("{name:32} {error}");
                failures.push(format!("{name}: {error}"));
            }
        }
    }
    assert!(failures.is_empty(), "{failures:#?}");
}

#[test]
fn two_hundred_random_systems() {
    let table = table();
    let random = table["random"].as_array().expect("random");
    assert_eq!(random.len(), 200);
    let mut worst = [0f64; 4];
    for (k, reference) in random.iter().enumerate() {
        let system = random_system(k);
        for (i, (kind, solve)) in
            [("care", care as fn(&DMatrix<f64>, &_, &_, &_, Option<&_>) -> _), ("dare", dare)]
                .iter()
                .enumerate()
        {
            let solution: Riccati = solve(&system.a, &system.b, &system.q, &system.r, None)
                .unwrap_or_else(|e| panic!("{kind} {k}: {e}"));
            let slycot = reference[*kind].as_f64().unwrap_or(f64::INFINITY);
            if slycot <= GOAL {
                assert!(solution.relative_residual <= GOAL, "{kind} {k}: {}", solution.relative_residual);
            }
            worst[i] = worst[i].max(solution.relative_residual);
            worst[2 + i] = worst[2 + i].max(slycot);
            let trace = reference[format!("{kind}_trace")].as_f64().expect("trace");
            assert!((solution.x.trace() - trace).abs() <= 1e-6 * trace.abs(), "{kind} {k}: trace");
        }
    }
    println!(
        "largest residual: care {:.1e} dare {:.1e}; slycot {:.1e} {:.1e}",
        worst[0], worst[1], worst[2], worst[3]
    );
}
