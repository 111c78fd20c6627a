//! Vehicles as functional mock-up units: FMPy, an independent tool, finds them valid and gives the same flights as this
//! program.

use std::fmt::Write;
use std::path::Path;
use std::process::Command;

use crate::support::{refused, run, spawn};
use whirlstand_test_harness::{Outcome, python_with};

/// Seed of the sensors' noise.
const SEED: &str = "7";

/// Inputs that change every 20 ms; near the end all of them exceed any limit.
fn inputs(names: &[String]) -> String {
    let mut text = format!("t,{}\n", names.join(","));
    for k in 0..400 {
        let _ = write!(text, "{:?}", f64::from(k) * 0.005);
        for (i, _) in names.iter().enumerate() {
            let step = f64::from((k / 4 * (7 + 4 * i as i32)) % 13 - 6);
            let _ = write!(text, ",{}", if k > 350 { 100.0 * step } else { step });
        }
        text.push('\n');
    }
    text
}

/// Exports a vehicle and has FMPy compare its flight with that of `whirlstand simulate`.
fn flies_alike(python: &Path, vehicle: &str, folder: &Path) {
    let path = |name: &str| folder.join(name).display().to_string();
    let check = run(["vehicle", "check", vehicle, "--json"]).success().stdout;
    let check: serde_json::Value = serde_json::from_str(&check).unwrap();
    let names = check["inputs"].as_array().unwrap().iter();
    let names: Vec<String> = names.map(|u| u["name"].as_str().unwrap().to_string()).collect();
    std::fs::write(path("in.csv"), inputs(&names)).unwrap();
    let simulate = ["simulate", vehicle, "--input", &path("in.csv"), "--output", &path("out.csv")];
    run(simulate.into_iter().chain(["--noise", "--seed", SEED])).success();
    // The file has another seed: that of the importing tool takes precedence.
    let said = run(["vehicle", "fmu", vehicle, "--out", &path("v.fmu"), "--seed", "1"]).success();
    assert!(said.stderr.contains("with steps of 0.005 s") || said.stdout.contains("with steps of 0.005 s"));
    let mut fly = Command::new(python);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fmi/fly.py");
    fly.arg(script).args([path("v.fmu"), path("out.csv")]).args(["--seed", SEED]);
    let flown = spawn(fly).finish().success();
    assert!(flown.stdout.contains("400 steps"), "{vehicle}: {}", flown.stdout);
    assert!(flown.stdout.contains("simulated by FMPy"), "{vehicle}: {}", flown.stdout);
}

fn fmpy_flies_every_built_in_vehicle_bit_for_bit() -> Outcome {
    let python = python_with("fmpy")?;
    let dir = tempfile::tempdir().unwrap();
    for vehicle in ["quadrotor", "helicopter-hover", "helicopter-longitudinal", "helicopter-lateral"] {
        flies_alike(&python, vehicle, dir.path());
    }
    Ok(())
}

fn fmpy_flies_effects_and_the_files_they_lead_to() -> Outcome {
    let python = python_with("fmpy")?;
    let dir = tempfile::tempdir().unwrap();
    let quadrotor = run(["vehicle", "show", "quadrotor"]).success().stdout;
    // A vehicle without a `name`, only a file name.
    let quadrotor = quadrotor.replacen("name = \"quadrotor\"\n", "", 1);
    let file = dir.path().join("my own.toml");
    std::fs::create_dir(dir.path().join("later")).unwrap();
    std::fs::write(dir.path().join("later/slow.toml"), &quadrotor).unwrap();
    let effects = r#"
[[effects]]
effect = "input_delay"
where = "u_roll"
delay_s = 0.0123

[[effects]]
effect = "quadratic_drag"
where = "roll_rate"
coefficient = 0.4

[[effects]]
effect = "turbulence"
where = "pitch_rate"
std = "20 deg/s^2"
bandwidth_hz = 1.0

[[effects]]
effect = "dropouts"
where = "roll"
fraction = 0.2

[[effects]]
effect = "mode_transition"
where = "vehicle"
at_s = 1.0
to = "later/slow.toml"
"#;
    std::fs::write(&file, quadrotor + effects).unwrap();
    flies_alike(&python, &file.display().to_string(), dir.path());
    Ok(())
}

fn the_same_vehicle_gives_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str| {
        let path = dir.path().join(name).display().to_string();
        run(["vehicle", "fmu", "quadrotor", "--out", &path]).success();
        std::fs::read(&path).unwrap()
    };
    assert!(write("a.fmu") == write("b/c.fmu"));
}

fn what_cannot_become_an_fmu_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let vehicle = "A = [[-1.0]]\nB = [[1.0]]\nstates = [{ name = \"x\" }]\ninputs = [{ name = \"x\" }]\n";
    std::fs::write(path("same.toml"), vehicle).unwrap();
    let out = path("v.fmu");
    refused(&["vehicle", "fmu", &path("same.toml"), "--out", &out], &["the same name 'x'", "rename"]);
    std::fs::create_dir(path("inner")).unwrap();
    std::fs::write(
        path("there.toml"),
        vehicle.replace("inputs = [{ name = \"x\" }]", "inputs = [{ name = \"u\" }]"),
    )
    .unwrap();
    let leads =
        "[[effects]]\neffect = \"mode_transition\"\nwhere = \"vehicle\"\nat_s = 1\nto = \"../there.toml\"\n";
    let text = vehicle.replace("inputs = [{ name = \"x\" }]", "inputs = [{ name = \"u\" }]") + leads;
    std::fs::write(path("inner/out.toml"), text).unwrap();
    refused(
        &["vehicle", "fmu", &path("inner/out.toml"), "--out", &out],
        &["../there.toml", "beside the vehicle file"],
    );
    refused(&["vehicle", "fmu", "quadrotor", "--out", &out, "--rate", "0"], &["rate"]);
    assert!(!Path::new(&out).exists());
}

whirlstand_test_harness::listed!(
    fmpy_flies_every_built_in_vehicle_bit_for_bit,
    fmpy_flies_effects_and_the_files_they_lead_to,
    the_same_vehicle_gives_the_same_bytes,
    what_cannot_become_an_fmu_is_refused
);
