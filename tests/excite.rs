//! Test flights with the controller on: designed, flown as processes, recorded, identified from the log alone.

use crate::support::{json, run};

const UNSTABLE: &str = r#"
A = [[0.0, 1.0], [6.0, -0.8]]
B = [[0.0], [30.0]]
states = [{ name = "roll", unit = "rad" }, { name = "roll_rate", unit = "rad/s" }]
inputs = [{ name = "u_roll", lower = -1.0, upper = 1.0 }]
outputs = [
    { name = "roll", unit = "deg", noise = 0.1 },
    { name = "roll_rate", unit = "deg/s", noise = 0.5 },
]
free = [
    { entry = "A[2,1]", lower = -30.0, upper = 30.0 },
    { entry = "A[2,2]", lower = -10.0, upper = 10.0 },
    { entry = "B[2,1]", lower = 1.0, upper = 90.0 },
]
"#;

/// The expectations of `excite`, and the answer of `identify` for the log of the flight.
fn flown(vehicle: &str, structure: &str, more: &[&str]) -> (serde_json::Value, serde_json::Value) {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().to_str().unwrap();
    let (expected, answer, log) =
        (format!("{folder}/expected.json"), format!("{folder}/answer.json"), format!("{folder}/log"));
    let args = ["excite", vehicle, "--duration", "60", "--out", folder, "--json", &expected];
    run(args.iter().chain(more)).success();
    run(["run", &format!("{folder}/flight.toml"), "--mode", "lockstep", "--out", &log]).success();
    run(["identify", &log, "--vehicle", structure, "--json", &answer]).success();
    (json(&expected), json(&answer))
}

/// The true values are those of the file for which the flight was designed.
fn agrees(expected: &serde_json::Value, answer: &serde_json::Value) {
    assert_eq!(answer["closed_loop"], true);
    assert_eq!(answer["noise"], "kalman", "the default of closed loops");
    let found = answer["parameters"].as_array().unwrap();
    let known = expected["parameters"].as_array().unwrap();
    assert_eq!(found.len(), known.len(), "fixed: {}", answer["fixed"]);
    let mut outside = 0;
    for (p, e) in found.iter().zip(known) {
        assert_eq!(p["name"], e["name"]);
        let number = |v: &serde_json::Value| v.as_f64().unwrap();
        let (error, bound) = (number(&p["standard_error"]), number(&e["standard_error"]));
        let off = (number(&p["value"]) - number(&e["value"])) / error;
        println!(
            "{} {} true {}: {off:+.2} standard errors of {error:.4}, expected {bound:.4}",
            p["name"], p["value"], e["value"]
        );
        outside += usize::from(off.abs() > 3.0);
        // The bound holds for the declared noise; vibration adds to it, by less than the same amount again.
        assert!(error > 0.8 * bound && error < 2.5 * bound, "{} {error} {bound}", p["name"]);
    }
    assert!(outside <= 1, "{outside} outside three standard errors");
    for pair in expected["peaks"].as_array().unwrap() {
        let (unit, peak) = (pair[1].as_str().unwrap(), pair[2].as_f64().unwrap());
        assert!(unit != "rad" || peak <= 20f64.to_radians(), "{pair}");
    }
}

fn a_test_input_is_flown_on_top_of_an_lqr() {
    let (expected, answer) = flown("quadrotor", "quadrotor-structure", &["--controller", "lqr"]);
    assert_eq!((&expected["controller"], &expected["through"]), (&"lqr".into(), &"stick".into()));
    agrees(&expected, &answer);
}

fn the_setpoint_is_moved_under_a_sliding_mode_controller() {
    let more = ["--controller", "smc", "--setpoint", "roll", "--setpoint", "pitch", "--kind", "doublets"];
    let (expected, answer) = flown("quadrotor", "quadrotor-structure", &more);
    assert_eq!(expected["through"], "setpoint");
    agrees(&expected, &answer);
}

fn an_unstable_vehicle_is_identified_in_its_loop() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("unstable.toml");
    std::fs::write(&file, UNSTABLE).unwrap();
    let file = file.to_str().unwrap();
    let refused = run(["excite", file, "--duration", "60"]);
    assert_eq!(refused.code(), 2);
    assert!(
        refused.stderr.contains("unstable") && refused.stderr.contains("--controller"),
        "{}",
        refused.stderr
    );
    let more = ["--controller", "ppc", "--set", "bandwidth=5", "--kind", "multisine", "--highest", "3"];
    let (expected, answer) = flown(file, file, &more);
    agrees(&expected, &answer);
}

/// A position that integrates a speed drifts under random steps, but that does not make the vehicle unstable.
fn a_vehicle_that_integrates_is_excited_and_comes_back() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("motor.toml");
    let motor = "name = \"motor\"\nA = [[0.0, 1.0, 0.0], [0.0, -2.0, 20.0], [0.0, -0.5, -40.0]]\n\
                 B = [[0.0], [0.0], [50.0]]\nC = [[1.0, 0.0, 0.0]]\n\
                 states = [{ name = \"angle\", unit = \"rad\" }, { name = \"speed\", unit = \"rad/s\" }, \
                 { name = \"current\", unit = \"A\" }]\n\
                 inputs = [{ name = \"voltage\", unit = \"V\", lower = -12.0, upper = 12.0 }]\n\
                 outputs = [{ name = \"encoder\", unit = \"rad\", noise = 0.001 }]\n";
    std::fs::write(&file, motor).unwrap();
    let file = file.to_str().unwrap();
    for kind in ["doublets", "3-2-1-1", "multistep", "multisine", "sweep"] {
        let flight = run(["excite", file, "--kind", kind, "--duration", "60 s"]).success();
        assert!(!flight.stderr.contains("unstable"), "{kind}: {}", flight.stderr);
        let told = flight.stdout.contains("'motor' integrates its inputs: every step is followed");
        assert_eq!(told, kind == "multistep", "{kind}: {}", flight.stdout);
        assert!(flight.stdout.contains("encoder 0.") && flight.stdout.contains(" rad"), "{}", flight.stdout);
    }
    let refused = run(["excite", file, "--limit", "encoder=0.00001 rad", "--duration", "60 s"]);
    assert_eq!(refused.code(), 2);
    assert!(
        refused.stderr.contains("integrates") && !refused.stderr.contains("unstable"),
        "{}",
        refused.stderr
    );
}

fn what_does_not_fit_is_refused() {
    for (args, words) in [
        (&["--setpoint", "roll"][..], &["--setpoint roll", "--controller"][..]),
        (&["--controller", "lqr", "--setpoint", "rol"], &["--setpoint rol", "roll_rate"]),
        (&["--controller", "pid"], &["pid", "lqr"]),
        (&["--controller", "manual"], &["manual", "leave it out"]),
        (&["--controller", "lqr", "--setpoint", "roll_rate"], &["roll_rate", "--limit 'roll_rate=2 deg/s'"]),
        (&["--controller", "lqr", "--set", "bandwith=4"], &["bandwith", "bandwidth"]),
    ] {
        let result = run(["excite", "quadrotor"].iter().chain(args));
        assert_eq!(result.code(), 2, "{args:?}: {}", result.stderr);
        for word in words {
            assert!(result.stderr.contains(word), "{word} in {}", result.stderr);
        }
    }
}

whirlstand_test_harness::listed!(
    a_test_input_is_flown_on_top_of_an_lqr,
    the_setpoint_is_moved_under_a_sliding_mode_controller,
    an_unstable_vehicle_is_identified_in_its_loop,
    a_vehicle_that_integrates_is_excited_and_comes_back,
    what_does_not_fit_is_refused,
);
