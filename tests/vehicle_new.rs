//! `whirlstand vehicle new` on third-party flights: each log yields a model whose prediction of held-out data is
//! stated, and with which `identify` runs, or is refused for the right reason.

use std::path::Path;
use std::sync::OnceLock;

use crate::support::{json, run};
use serde_json::Value;
use whirlstand_test_harness::{Missing, Outcome, data, noise};

/// Drafts a vehicle, checks what every draft must have, and returns the findings.
fn drafted(log: &Path, folder: &Path) -> Value {
    let (file, found) = (folder.join("drafted.toml"), folder.join("draft.json"));
    let call = ["vehicle", "new", log.to_str().unwrap(), "--output", file.to_str().unwrap(), "--json"];
    let finished = run(call.into_iter().chain([found.to_str().unwrap()])).success();
    assert!(finished.stdout.contains("of held-out data: fit"), "{}", finished.stdout);
    let found = json(&found);
    assert_eq!(found["schema"], "whirlstand.vehicle_draft.v1");
    let text = std::fs::read_to_string(&file).unwrap();
    for axis in found["axes"].as_array().unwrap() {
        let (fit, own) = (&axis["heldout"]["completed_fit"], &axis["heldout"]["own_past_fit"]);
        assert!(fit.as_f64() > own.as_f64(), "{axis}");
        let named = format!("#   {} ", axis["output"].as_str().unwrap());
        assert!(text.contains(&named), "{named} is missing in\n{text}");
    }
    run(["vehicle", "check", file.to_str().unwrap()]).success();
    found
}

/// A flight of which several tests need the draft: it is made once.
struct Shared {
    log: &'static str,
    /// Text of the vehicle file, and the findings.
    draft: OnceLock<(String, Value)>,
}

static SETPOINTS_ONLY: Shared = Shared { log: "kd0aij_S250_1kHz_log1.ulg", draft: OnceLock::new() };
static WITH_A_GAP: Shared = Shared { log: "px4_AquaQuad.csv", draft: OnceLock::new() };

impl Shared {
    /// Paths of the log and of a copy of the vehicle file in a folder, and the findings.
    fn drafted(&'static self, folder: &Path) -> Result<(String, String, &'static Value), Missing> {
        let log = data()?.join("flights").join(self.log);
        let (text, found) = self.draft.get_or_init(|| {
            let dir = tempfile::tempdir().unwrap();
            let found = drafted(&log, dir.path());
            (std::fs::read_to_string(dir.path().join("drafted.toml")).unwrap(), found)
        });
        let file = folder.join("drafted.toml");
        std::fs::write(&file, text).unwrap();
        Ok((log.display().to_string(), file.display().to_string(), found))
    }
}

/// Delay and lag of an axis together, s. A second pole that is fast is a lag.
fn late_s(axis: &Value) -> f64 {
    let parameters = axis["parameters"].as_array().unwrap();
    let value = |start: &str| {
        let named = |p: &&Value| p["name"].as_str().unwrap().starts_with(start);
        parameters.iter().rfind(named).map(|p| p["value"].as_f64().unwrap())
    };
    value("input_delay").unwrap_or(0.0) + value("actuator_lag").unwrap_or_else(|| -1.0 / value("A[").unwrap())
}

/// A Crazyflie's motors, with a published lag of 0.072 s, of which a delay of some milliseconds is a part. It was flown by
/// a law, and its axes drift apart. Recorders of such flights lose samples, here 8 to 36 of every 150.
fn the_motors_of_a_crazyflie_are_drafted_also_where_samples_were_lost() -> Outcome {
    let log = data()?.join("crazyflie/roll_pitch.csv");
    let dir = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(&log).unwrap();
    let lost: Vec<usize> = noise(300, 5).iter().map(|v| (22.0 + 7.0 * v).clamp(8.0, 36.0) as usize).collect();
    let is_kept = |(k, _): &(usize, &str)| *k == 0 || k % 150 >= lost[k / 150];
    let kept: Vec<&str> = text.lines().enumerate().filter(is_kept).map(|(_, line)| line).collect();
    let gappy = dir.path().join("gappy.csv");
    std::fs::write(&gappy, kept.join("\n")).unwrap();
    for log in [log, gappy] {
        let found = drafted(&log, dir.path());
        for output in ["roll_rate", "pitch_rate"] {
            let late_s = late_s(axis(&found, output));
            assert!((0.05..0.085).contains(&late_s), "{}: {late_s} {found}", log.display());
        }
    }
    Ok(())
}

/// The message that refuses a log.
fn refused(log: &str) -> Result<String, Missing> {
    let path = data()?.join("flights").join(log);
    let finished = run(["vehicle", "new", path.to_str().unwrap()]);
    assert_eq!(finished.code(), 2, "{}\n{}", finished.stdout, finished.stderr);
    Ok(finished.stderr)
}

/// The axis of an output.
fn axis<'f>(found: &'f Value, output: &str) -> &'f Value {
    let axes = found["axes"].as_array().unwrap();
    axes.iter().find(|axis| axis["output"] == output).unwrap_or_else(|| panic!("no {output} in {found}"))
}

fn motors_that_are_off_are_refused() -> Outcome {
    let told = refused("pyulog_sample.ulg")?;
    assert!(told.contains("the motors are off"), "{told}");
    Ok(())
}

fn rest_is_refused() -> Outcome {
    let told = refused("pyulog_sample_log_small.ulg")?;
    assert!(told.contains("the vehicle is at rest"), "{told}");
    Ok(())
}

fn a_slow_log_is_refused_with_its_rates() -> Outcome {
    let told = refused("auterion_esc_status_log.ulg")?;
    assert!(told.contains("too slowly for a model of the motors") && told.contains("ms"), "{told}");
    Ok(())
}

fn a_pose_alone_is_refused_with_what_to_do() -> Outcome {
    let told = refused("cub_stabilize_2025_11_13.mcap")?;
    assert!(told.contains("as an output") && told.contains("--measure"), "{told}");
    Ok(())
}

fn without_actuators_the_rate_follows_its_setpoint() -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    let (log, vehicle, found) = SETPOINTS_ONLY.drafted(dir.path())?;
    for output in ["roll_rate", "pitch_rate"] {
        let fit = axis(found, output)["heldout"]["fit"].as_f64().unwrap();
        assert!(fit > 0.0, "{output}: {fit} %");
    }
    // A push of a fifth of a second is no explanation of what a free run gets wrong in 46 s.
    let answer = dir.path().join("diagnosis.json");
    run(["diagnose", &log, "--vehicle", &vehicle, "--json", answer.to_str().unwrap()]).success();
    assert_ne!(json(&answer)["verdict"], "explained", "{}", json(&answer)["summary"]);
    Ok(())
}

/// Each axis has an input with a gain above two standard errors.
fn assert_inputs_act(found: &Value) {
    for axis in found["axes"].as_array().unwrap() {
        let all = axis["parameters"].as_array().unwrap().iter();
        let mut gains = all.filter(|p| p["name"].as_str().unwrap().starts_with("B["));
        let known = |p: &Value| {
            p["value"].as_f64().unwrap().abs() > 2.0 * p["standard_error"].as_f64().unwrap_or(f64::INFINITY)
        };
        assert!(gains.any(known), "{}: {axis:#}", found["log"]);
    }
}

fn flights_end_in_models_whose_inputs_act() -> Outcome {
    let flights = data()?.join("flights");
    for log in ["px4_S250AQ.csv", "LOG00037.BFL", "btfl_002.bbl"] {
        let dir = tempfile::tempdir().unwrap();
        assert_inputs_act(&drafted(&flights.join(log), dir.path()));
    }
    let dir = tempfile::tempdir().unwrap();
    assert_inputs_act(WITH_A_GAP.drafted(dir.path())?.2);
    Ok(())
}

/// What `identify` makes of a draft on its own record is the draft again, though all axes are fitted together there: a
/// vehicle flown in closed loop, whose inputs mostly answer forces that nobody measured. What it makes of its own file is
/// no less likely than that file.
fn identify_finds_a_draft_again() -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    let (log, vehicle, draft) = WITH_A_GAP.drafted(dir.path())?;
    let identified = |vehicle: &str, name: &str| {
        let path = |end: &str| dir.path().join(format!("{name}.{end}")).display().to_string();
        let (found, file) = (path("json"), path("toml"));
        run(["identify", &log, "--vehicle", vehicle, "--json", &found, "--output", &file]).success();
        (json(found), file)
    };
    let (fitted, file) = identified(&vehicle, "fitted");
    let (again, _) = identified(&file, "again");
    let cost = |answer: &Value| answer["search"]["cost"].as_f64().unwrap();
    assert!(cost(&again) < cost(&fitted) + 0.5, "{} {}", fitted["search"], again["search"]);
    let value = |all: &Value, name: &Value| {
        let of = all.as_array().unwrap().iter().find(|p| p["name"] == *name);
        of.unwrap_or_else(|| panic!("{name} in {all}"))["value"].as_f64().unwrap()
    };
    for axis in draft["axes"].as_array().unwrap() {
        let parameters = axis["parameters"].as_array().unwrap().iter();
        for own in parameters.filter(|p| p["name"].as_str().unwrap().starts_with("B[")) {
            let ratio = value(&fitted["parameters"], &own["name"]) / own["value"].as_f64().unwrap();
            assert!((0.5..2.0).contains(&ratio), "{} is {ratio} times the draft's", own["name"]);
        }
    }
    assert_eq!(fitted["search"]["converged"], true, "{}", fitted["search"]);
    let poles = fitted["poles"].as_array().unwrap().iter();
    let growth = poles.map(|pole| pole["re"].as_f64().unwrap()).fold(f64::NEG_INFINITY, f64::max);
    assert!(growth < 0.5, "{}", fitted["poles"]);
    assert!(!fitted["wandering_forces"].as_array().unwrap().is_empty(), "{fitted}");
    assert!(fitted["verdict"].as_str().unwrap().contains("only predictions"), "{}", fitted["verdict"]);
    Ok(())
}

/// Noise estimated from the changes between samples in flight is not a data sheet value: the diagnosis fits the noise,
/// also of a file from `identify`, and the extended vehicle keeps what the draft says. Both take the draft's steps, which
/// are longer than the log's.
fn what_a_draft_knows_of_its_log_is_kept() -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    let (log, vehicle, draft) = SETPOINTS_ONLY.drafted(dir.path())?;
    let path = |name: &str| dir.path().join(name).display().to_string();
    let fitted = ["identify", &log, "--vehicle", &vehicle, "--to", "20", "--noise", "kalman"];
    // A vehicle that flies in closed loop need not be stable in open loop.
    run(fitted.into_iter().chain(["--output", &path("fitted.toml")])).success();
    for vehicle in [vehicle, path("fitted.toml")] {
        let (found, out) = (path("diagnosis.json"), path("out"));
        let call = ["diagnose", &log, "--vehicle", &vehicle, "--json", &found, "--out", &out];
        run(call.into_iter().chain(["--from", "10", "--to", "20"])).success();
        let found = json(&found);
        let period_s = |answer: &Value| answer["period_s"].as_f64().unwrap();
        assert!((period_s(&found) - period_s(draft)).abs() < 1e-6, "{vehicle}: {}", found["period_s"]);
        for (name, output) in found["outputs"].as_object().unwrap() {
            assert!(output["noise_model_share"].is_number(), "{vehicle}, {name}: {output}");
        }
        if let Some(extended) = found["extended_vehicle"].as_str() {
            let noise = |file: &str| {
                let text = std::fs::read_to_string(file).unwrap();
                text.lines().filter(|line| line.starts_with("noise = ")).count()
            };
            assert_eq!(noise(extended), noise(&vehicle), "{vehicle}");
        }
    }
    Ok(())
}

/// A measured input goes straight from one sample to the next, and the file says so to whatever reads a record with it.
fn an_input_between_its_samples_is_the_same_for_every_command() -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let (period_s, fine, sensor) = (0.03, 50, noise(1200, 17));
    let (mut rate, mut csv) = (0.0, "t,u_roll,p[rad/s]\n".to_string());
    for (k, noise) in sensor.iter().enumerate() {
        let t = k as f64 * period_s;
        let motion = |t: f64| (1.7 * t).sin() + (4.1 * t + 1.0).sin() + (9.3 * t + 2.0).sin();
        csv.push_str(&format!("{t},{},{}\n", motion(t), rate + 0.02 * noise));
        for part in 0..fine {
            let dt = period_s / f64::from(fine);
            rate += dt * (-4.0 * rate + 12.0 * motion(t + (f64::from(part) + 0.5) * dt));
        }
    }
    std::fs::write(path("log.csv"), csv).unwrap();
    let text = |input: &str| {
        format!(
            "A = [[-5.0]]\nB = [[10.0]]\ninputs = [{{ name = \"u_roll\"{input} }}]\n\
             outputs = [{{ name = \"p\", unit = \"rad/s\" }}]\nstates = [{{ name = \"p\", unit = \"rad/s\" }}]\n\
             free = [{{ entry = \"A[1,1]\", lower = -50.0, upper = 1.0 }}, {{ entry = \"B[1,1]\", lower = -99.0, upper = 99.0 }}]\n"
        )
    };
    let pole = |input: &str| {
        std::fs::write(path("v.toml"), text(input)).unwrap();
        let call =
            ["identify", &path("log.csv"), "--vehicle", &path("v.toml"), "--output", &path("fitted.toml")];
        run(call.into_iter().chain(["--json", &path("fit.json")])).success();
        let found = json(dir.path().join("fit.json"));
        let entry = found["parameters"].as_array().unwrap().iter().find(|p| p["name"] == "A[1,1]").unwrap();
        entry["value"].as_f64().unwrap()
    };
    let (held, straight) = (pole(""), pole(", intersample = \"foh\""));
    assert!((straight + 4.0).abs() < 0.1 && (held + 4.0).abs() > 0.2, "{held} {straight}");
    let fitted = std::fs::read_to_string(path("fitted.toml")).unwrap();
    assert!(fitted.contains("intersample = \"foh\""), "{fitted}");
    let call = ["diagnose", &path("log.csv"), "--vehicle", &path("fitted.toml"), "--json", &path("d.json")];
    run(call.into_iter().chain(["--out", &path("out")])).success();
    assert_eq!(json(dir.path().join("d.json"))["verdict"], "consistent");
    Ok(())
}

/// A program that writes -999 where a sensor gave no value.
fn numbers_that_stand_for_missing_values_are_told_and_not_used() -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let random = noise(6000, 3);
    let (mut rate, mut u) = (0.0, 0.0);
    let mut csv = "t[s],u_roll,roll_rate[deg/s]\n".to_string();
    for k in 0..6000 {
        if k % 40 == 0 {
            u = 20.0 * random[(k + 17) % 6000];
        }
        let cell = if k % 97 == 5 { "-999".into() } else { format!("{:.4}", rate + 0.01 * random[k]) };
        csv += &format!("{:.2},{u:.4},{cell}\n", 0.01 * k as f64);
        rate += 0.01 * (u - 4.0 * rate);
    }
    std::fs::write(path("marked.csv"), csv).unwrap();
    let told = "roll_rate: 62 values of -999 stand for missing ones and are not used";
    let draft = run(["vehicle", "new", &path("marked.csv"), "--output", &path("v.toml")]).success();
    assert!(draft.stdout.contains(told), "{}", draft.stdout);
    assert!(draft.stdout.contains("roll_rate from u_roll: first order"), "{}", draft.stdout);
    let diagnosis = run(["diagnose", &path("marked.csv"), "--vehicle", &path("v.toml")]).success();
    assert!(diagnosis.stderr.contains(told), "{}", diagnosis.stderr);
    assert!(diagnosis.stdout.contains("Consistent"), "{}", diagnosis.stdout);
    Ok(())
}

whirlstand_test_harness::listed!(
    numbers_that_stand_for_missing_values_are_told_and_not_used,
    an_input_between_its_samples_is_the_same_for_every_command,
    what_a_draft_knows_of_its_log_is_kept,
    identify_finds_a_draft_again,
    motors_that_are_off_are_refused,
    rest_is_refused,
    a_slow_log_is_refused_with_its_rates,
    a_pose_alone_is_refused_with_what_to_do,
    without_actuators_the_rate_follows_its_setpoint,
    flights_end_in_models_whose_inputs_act,
    the_motors_of_a_crazyflie_are_drafted_also_where_samples_were_lost,
);
