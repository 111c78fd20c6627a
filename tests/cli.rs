//! What the command line answers to what a user types, right or wrong.

use crate::support::{json, refused, run};

#[track_caller]
fn answer(args: &[&str]) -> serde_json::Value {
    let result = run(args).success();
    serde_json::from_str(&result.stdout).unwrap_or_else(|e| panic!("{args:?}: {e}\n{}", result.stdout))
}

fn help_and_version_are_there_for_every_call() {
    let help = run(["--help"]).success().stdout;
    for call in [
        "run", "node", "design", "simulate", "compare", "identify", "excite", "log", "vehicle", "launch",
        "doctor", "soak", "clean",
    ] {
        assert!(help.contains(call), "{call}");
        let own = run([call, "--help"]).success().stdout;
        assert!(own.contains("Usage: whirlstand"), "{own}");
    }
    assert!(run(["--version"]).success().stdout.starts_with("whirlstand "));
    assert_eq!(run::<&str>([]).code(), 2);
}

fn launch_files_with_mistakes_are_answered_with_line_and_nearest_key() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("wrong.toml");
    let file = path.to_str().unwrap();
    for (text, words) in [
        ("vehicle = 'quadrotor'\nduraton_s = 3\n[controller]\nlaw = 'smc'\n", ["line 2", "'duration_s'"]),
        ("vehicle = 'quadrotor'\n[controller]\nlaw = 'smcc'\n", ["line 3", "'smc'"]),
        ("vehicle = 'quadrotr'\n[controller]\nlaw = 'smc'\n", ["line 1", "'quadrotor'"]),
        (
            "vehicle = 'quadrotor'\n[controller]\nlaw = 'smc'\n[plant]\ninitial = { rol = 1 }\n",
            ["line 5", "'roll'"],
        ),
        (
            "vehicle = 'quadrotor'\n[controller]\nlaw = 'smc'\n[plant]\ninitial = { roll = '1 m' }\n",
            ["line 5", "rad is expected"],
        ),
        ("vehicle = 'quadrotor'\n[controller]\nlaw = 'smc'\n[[setpoint]]\nroll = 1\n", ["line 4", "'at_s'"]),
        (
            "vehicle = 'quadrotor'\n[controller]\nlaw = 'smc'\n[[effects]]\neffect = 'input_dely'\nwhere = 'u_roll'\n",
            ["line 4", "input_delay"],
        ),
        (
            "vehicle = 'quadrotor'\n[controller]\nlaw = 'smc'\n[[effects]]\neffect = 'input_delay'\nwhere = 'u_rol'\ndelay_s = 0.1\n",
            ["line 6", "u_roll"],
        ),
        (
            "vehicle = 'quadrotor'\n[controller]\nlaw = 'smc'\n[nodes.controler]\npriority = 3\n",
            ["line 4", "'controller'"],
        ),
        ("vehicle = 'quadrotor'\n[controller]\nlaw = 'smc'\n[expect]\nroll.peek = 1\n", ["line 5", "'peak'"]),
        ("vehicle = 'quadrotor'\nrate_hz = 0\n[controller]\nlaw = 'smc'\n", ["line 2", "above 0"]),
        ("vehicle = = 3\n", ["line 1", "TOML"]),
    ] {
        std::fs::write(&path, text).unwrap();
        refused(&["run", file], &[&["wrong.toml"], &words[..]].concat());
    }
}

fn overrides_are_checked_like_the_file() {
    refused(&["run", "quadrotor", "--set", "controller.lwa=lqr"], &["--set controller.lwa=lqr", "'law'"]);
    refused(&["run", "quadrotor", "--set", "duration_s=\"5 m\""], &["--set", "s is expected"]);
    refused(&["run", "quadrotor", "--set", "effects.9.at_s=1"], &["no entry '9'"]);
    refused(&["run", "quadrotor", "--set", "nonsense"], &["KEY=VALUE"]);
    refused(&["run", "quadroto"], &["'quadrotor'", "launch list"]);
    refused(&["run", "--mode", "fast"], &["realtime", "lockstep"]);
    refused(&["run", "--duration", "-3"], &["positive time"]);
}

fn built_in_files_can_be_listed_shown_and_run_again_from_the_copy() {
    let list = answer(&["launch", "list", "--json"]);
    assert_eq!(list["schema"], "whirlstand.launch_files.v1");
    let files = list["launch_files"].as_array().unwrap();
    assert_eq!(files.iter().filter(|f| f["default"] == true).count(), 1);
    for name in ["quadrotor", "quadrotor-smc", "quadrotor-compare", "helicopter-hover-compare"] {
        assert!(files.iter().any(|f| f["name"] == name), "{name}");
    }
    let dir = tempfile::tempdir().unwrap();
    let copy = dir.path().join("mine.toml");
    std::fs::write(&copy, run(["launch", "show", "quadrotor-lqr"]).success().stdout).unwrap();
    let out = dir.path().join("out");
    let result =
        run(["run", copy.to_str().unwrap(), "--mode", "lockstep", "--duration", "2", "--set", "expect={}"]
            .into_iter()
            .chain(["--out", out.to_str().unwrap()]));
    result.success();
    let summary = json(out.join("summary.json"));
    assert_eq!((&summary["schema"], &summary["bench"]), (&"whirlstand.summary.v1".into(), &"mine".into()));
    assert_eq!(summary["runs"][0]["steps"], 400);
    assert!(out.join("log.mcap").is_file() && out.join("report.html").is_file());
}

fn vehicles_can_be_listed_shown_and_checked() {
    let list = answer(&["vehicle", "list", "--json"]);
    assert_eq!(list["vehicles"].as_array().unwrap().len(), 4);
    let check = answer(&["vehicle", "check", "quadrotor", "--json"]);
    assert_eq!(
        (check["schema"].as_str(), check["valid"].as_bool()),
        (Some("whirlstand.vehicle.v1"), Some(true))
    );
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("v.toml");
    let text = run(["vehicle", "show", "quadrotor"]).success().stdout;
    std::fs::write(&path, &text).unwrap();
    run(["vehicle", "check", path.to_str().unwrap()]).success();
    std::fs::write(&path, text.replace("noise", "nois")).unwrap();
    refused(&["vehicle", "check", path.to_str().unwrap()], &["v.toml", "line", "noise"]);
    refused(&["vehicle", "show", "quadcopter"], &["quadrotor"]);
}

fn every_law_is_designed_for_every_vehicle_and_closes_a_stable_loop() {
    for vehicle in ["quadrotor", "helicopter-hover", "helicopter-longitudinal", "helicopter-lateral"] {
        for law in ["lqr", "ppc", "smc"] {
            let design = answer(&["design", vehicle, "--law", law, "--json"]);
            assert_eq!(design["schema"], "whirlstand.design.v1");
            let poles = design["closed_loop_poles"].as_array().unwrap();
            for pole in poles {
                let z = &pole["discrete"];
                let size = z[0].as_f64().unwrap().hypot(z[1].as_f64().unwrap());
                assert!(size < 1.0, "{vehicle} {law}: {pole}");
            }
            let words = run(["design", vehicle, "--law", law]).success().stdout;
            assert!(words.contains("closed-loop poles") && words.contains("margins"), "{words}");
        }
    }
    refused(&["design", "quadrotor", "--law", "pid"], &["lqr", "ppc", "smc"]);
    refused(&["design", "quadrotor", "--law", "lqr", "--set", "gian=3"], &["gian"]);
}

fn a_simulation_answers_recorded_inputs_at_its_own_rate() {
    let dir = tempfile::tempdir().unwrap();
    let (input, output) = (dir.path().join("in.csv"), dir.path().join("out.csv"));
    let mut text = String::from("t[ms],stick,u_pitch\n");
    for i in 0..=100 {
        text.push_str(&format!("{},{},0\n", i * 10, if i >= 50 { 100.0 } else { 0.0 }));
    }
    std::fs::write(&input, text).unwrap();
    let args = |rate: &'static str| {
        let (input, output) = (input.to_str().unwrap().to_string(), output.to_str().unwrap().to_string());
        [
            "simulate",
            "quadrotor",
            "--input",
            &input,
            "--output",
            &output,
            "--map",
            "u_roll=stick[%]",
            "--rate",
            rate,
        ]
        .map(String::from)
    };
    run(args("200")).success();
    let written = std::fs::read_to_string(&output).unwrap();
    assert_eq!(written.lines().count(), 1 + 201, "1 s at 200 Hz");
    let head = written.lines().next().unwrap();
    for name in ["t", "u_roll", "roll[rad]", "pitch_rate[rad/s]"] {
        assert!(head.contains(name), "{head}");
    }
    refused(
        &["simulate", "quadrotor", "--input", input.to_str().unwrap(), "--output", "x.csv"],
        &["u_roll", "--map", "stick"],
    );
    assert_eq!(run(args("0")).code(), 2);
}

fn an_output_with_feedthrough_shows_the_input_of_its_own_step() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let vehicle = r#"
name = "feedthrough"
A = [[-1.0]]
B = [[0.0]]
C = [[1.0]]
D = [[2.0]]
states = [{ name = "roll", unit = "rad" }]
inputs = [{ name = "u_roll", lower = -10.0, upper = 10.0 }]
[[outputs]]
name = "roll"
unit = "rad"
"#;
    std::fs::write(path("vehicle.toml"), vehicle).unwrap();
    std::fs::write(path("in.csv"), "t,u_roll\n0,0\n0.01,1\n0.02,3\n0.03,-1\n").unwrap();
    run(["simulate", &path("vehicle.toml"), "--input", &path("in.csv"), "--output", &path("out.csv")])
        .success();
    let written = std::fs::read_to_string(path("out.csv")).unwrap();
    let roll: Vec<f64> =
        written.lines().skip(1).map(|line| line.rsplit(',').next().unwrap().parse().unwrap()).collect();
    assert_eq!(roll, [0.0, 2.0, 6.0, -2.0], "{written}");
}

fn files_that_are_not_there_are_named() {
    refused(&["log", "info", "/nowhere/log.mcap"], &["/nowhere/log.mcap"]);
    refused(&["log", "diff", "/nowhere/a", "/nowhere/b"], &["/nowhere/a"]);
    refused(&["compare", "/nowhere/x.csv", "--vehicle", "quadrotor"], &["/nowhere/x.csv"]);
    refused(&["node", "plnt"], &["'plant'"]);
    refused(
        &["bridge", "check", "plnt", "--launch", "quadrotor-mavlink"],
        &["'plnt' is not a bridge (did you mean 'plant'?)"],
    );
    refused(&["soak", "--rounds", "0"], &["--rounds"]);
}

fn the_doctor_says_what_to_change() {
    let report = answer(&["doctor", "--json"]);
    assert_eq!(report["schema"], "whirlstand.doctor.v1");
    let checks = report["checks"].as_array().unwrap();
    assert!(checks.len() >= 10);
    for check in checks {
        assert_eq!(check["grade"] == "warn", check["advice"].is_string(), "{check}");
    }
    assert!(report["wake_up"][0]["p50_us"].as_f64().unwrap() > 0.0);
}

whirlstand_test_harness::listed!(
    help_and_version_are_there_for_every_call,
    launch_files_with_mistakes_are_answered_with_line_and_nearest_key,
    overrides_are_checked_like_the_file,
    built_in_files_can_be_listed_shown_and_run_again_from_the_copy,
    vehicles_can_be_listed_shown_and_checked,
    every_law_is_designed_for_every_vehicle_and_closes_a_stable_loop,
    a_simulation_answers_recorded_inputs_at_its_own_rate,
    an_output_with_feedthrough_shows_the_input_of_its_own_step,
    files_that_are_not_there_are_named,
    the_doctor_says_what_to_change,
);
