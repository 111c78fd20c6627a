//! Units are never guessed: user input without a unit is accepted or refused, and everything that is returned carries
//! one.

use crate::support::{json, refused, run};
use serde_json::Value;

fn a_number_without_a_unit_is_answered_with_both_readings() {
    let run = ["run", "quadrotor", "--mode", "lockstep", "--set"];
    let set = |assignment: &'static str| [&run[..], &[assignment]].concat();
    let write = "write the unit, as in";
    refused(&set("setpoint.0.roll=5"), &["setpoint.0.roll=5", "5 rad = 286 deg, or 5 deg", write]);
    refused(&set("plant.initial.roll=10"), &["10 rad = 573 deg, or 10 deg", write]);
    refused(&set("effects.0.magnitude=60"), &["60 rad/s^2 = 3438 deg/s^2, or 60 deg/s^2", write]);
    refused(&set("expect.roll.peak=10"), &["roll.peak is 10 without a unit", "573 deg", write]);
    refused(&set("plant.initial.roll=120 deg"), &["120 deg = 2.09 rad", "beyond 90 deg"]);
    refused(
        &set("effects=[{effect='input_delay', where='u_roll', delay_s=60}]"),
        &["60 s = 60000 ms", "the run lasts 12 s"],
    );
    let bias = set("estimator.bias_std=0.5");
    refused(
        &bias,
        &["bias_std is 0.5 without a unit", "0.5 rad/s = 28.6 deg/s, or 0.5 deg/s", "the bias of roll_rate"],
    );
    refused(
        &set("estimator.bias_walk=\"1 deg\""),
        &["estimator.bias_walk", "the bias of roll_rate, in deg/s"],
    );
    refused(&["excite", "quadrotor", "--limit", "roll=10"], &["10 rad = 573 deg, or 10 deg", write]);
    let px4 = ["run", "quadrotor-px4", "--set", "bridge.sensors.heading=90"];
    refused(&px4, &["90 rad = 5157 deg, or 90 deg", write]);
    let trim = ["run", "quadrotor-mavlink", "--set", "bridge.measured.roll.offset=2"];
    refused(&trim, &["offset is 2 without a unit: 2 rad = 115 deg, or 2 deg", write]);
}

/// The standard deviation of a bias may be given in any unit of its sensor.
fn a_bias_takes_the_unit_of_its_sensor() {
    let dir = tempfile::tempdir().unwrap();
    let fly = |name: &str, bias_std: &str| {
        let out = dir.path().join(name);
        let set = format!("estimator.bias_std={bias_std}");
        let args = ["run", "quadrotor", "--mode", "lockstep", "--transport", "inproc", "--set", &set];
        run(args.into_iter().chain(["--out", out.to_str().unwrap()])).success();
        json(out.join("summary.json"))["runs"][0]["outputs"].clone()
    };
    let [degrees, radians, wide] = [
        ("degrees", "\"1.8 deg/s\""),
        ("radians", "\"0.031415926535897934 rad/s\""),
        ("wide", "\"90 deg/s\""),
    ]
    .map(|(name, bias_std)| fly(name, bias_std));
    assert_eq!(degrees, radians);
    assert_ne!(degrees, wide, "it reaches the filter");
}

fn a_delay_that_a_record_is_too_short_for_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let late = "[[effects]]\neffect = \"input_delay\"\nwhere = \"u_roll\"\ndelay_s = 60\n";
    let quadrotor = run(["vehicle", "show", "quadrotor"]).success().stdout;
    std::fs::write(path("late.toml"), quadrotor + late).unwrap();
    let row = |k: i32| format!("{},0,0,0,0\n", f64::from(k) * 0.01);
    let rows: String = (0..500).map(row).collect();
    std::fs::write(path("short.csv"), format!("t[s],u_roll,u_pitch,roll[deg],pitch[deg]\n{rows}")).unwrap();
    let (csv, vehicle) = (path("short.csv"), path("late.toml"));
    let words = ["delay_s is 60 s = 60000 ms", "short.csv lasts 4.99 s"];
    for command in ["compare", "diagnose", "identify"] {
        refused(&[command, &csv, "--vehicle", &vehicle], &words);
    }
    let fitted = ["identify", &csv, "--vehicle", "quadrotor", "--delay", "roll=60"];
    refused(&fitted, &["60 s = 60000 ms", "short.csv lasts 4.99 s"]);
}

/// Numbers with rounding noise, that is with more than 14 digits, anywhere in a JSON text.
fn noisy(text: &str) -> Vec<&str> {
    let digits = |number: &str| number.bytes().filter(u8::is_ascii_digit).count();
    text.split(|c: char| !(c.is_ascii_digit() || matches!(c, '.' | '-' | 'e')))
        .filter(|number| number.contains('.') && digits(number.trim_start_matches(['-', '0', '.'])) > 14)
        .collect()
}

fn what_a_run_says_carries_units_and_no_noise_of_arithmetic() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let args = ["run", "quadrotor", "--mode", "lockstep", "--transport", "inproc", "--set", "rate_hz=130"];
    let args =
        args.into_iter().chain(["--duration", "7.1", "--set", "expect={}", "--out", out.to_str().unwrap()]);
    let result = run(args).success();
    assert!(result.stderr.contains("at 130 Hz for 7.1 s"), "{}", result.stderr);
    let text = std::fs::read_to_string(out.join("summary.json")).unwrap();
    assert_eq!(noisy(&text), Vec::<&str>::new());
    let summary = json(out.join("summary.json"));
    let run = &summary["runs"][0];
    assert_eq!(run["outputs"]["roll"]["unit"], "rad");
    assert_eq!(run["inputs"]["u_roll"]["unit"], "");
    assert_eq!(run["estimator"]["states"]["roll_rate"]["unit"], "rad/s");
    assert_eq!(run["disturbances"][0]["unit"], "rad/s^2");
}

fn a_checked_vehicle_is_read_back_with_units() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("v.toml");
    let quadrotor = run(["vehicle", "show", "quadrotor"]).success().stdout;
    let gust = "[[effects]]\neffect = \"pulse_disturbance\"\nwhere = \"roll_rate\"\nat_s = 6\nduration_s = \"200 ms\"\n\
                magnitude = \"150 deg/s^2\"\n";
    std::fs::write(&path, quadrotor + gust).unwrap();
    let check = ["vehicle", "check", path.to_str().unwrap()];
    let text = run(check).success().stdout;
    for words in [
        "roll  noise 0.08 deg, every step",
        "at_s = 6 s, duration_s = 0.2 s, magnitude = 150 deg/s^2",
        "-2.6237-1.0522i 1/s",
    ] {
        assert!(text.contains(words), "{words}\n{text}");
    }
    let json: Value =
        serde_json::from_str(&run([&check[..], &["--json"]].concat()).success().stdout).unwrap();
    let roll = &json["outputs"][0];
    assert_eq!((&roll["unit"], &roll["si_unit"]), (&"deg".into(), &"rad".into()));
    assert_eq!(json["effects"][0]["units"]["magnitude"], "rad/s^2");
}

fn a_designed_flight_is_written_with_units_and_flies() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let (folder, expected, log) = (path("designed"), path("expected.json"), path("log"));
    let args = ["excite", "quadrotor", "--controller", "lqr", "--setpoint", "roll", "--kind", "doublets"];
    let more = ["--duration", "20", "--out", &folder, "--json", &expected];
    let text = run(args.iter().chain(&more)).success().stdout;
    let row = |name: &str| text.lines().find(|l| l.starts_with(name)).map(str::to_string).unwrap_or_default();
    assert!(row("A[2,1]").ends_with("1/s^2") && row("B[2,1]").ends_with("deg/s^2"), "{text}");
    assert!(row("sensor_bias").contains("offset 0.") && row("sensor_bias").ends_with(" deg"), "{text}");
    let launch = std::fs::read_to_string(format!("{folder}/flight.toml")).unwrap();
    assert!(launch.contains(" rad\" }"), "{launch}");
    let expected = json(&expected);
    assert_eq!((&expected["units"]["roll"], &expected["units"]["u_roll"]), (&"rad".into(), &"".into()));
    assert_eq!(expected["effects"][0]["unit"], "s");
    let flight = format!("{folder}/flight.toml");
    let run_args = ["run", &flight, "--mode", "lockstep", "--transport", "inproc", "--out", &log];
    run(run_args).success();
    let fitted = path("fitted.json");
    let text = run(["identify", &log, "--vehicle", "quadrotor", "--json", &fitted]).success().stdout;
    assert!(text.contains("unit"), "{text}");
    let fitted = json(&fitted);
    assert_eq!(
        (&fitted["parameters"][0]["unit"], &fitted["parameters"][0]["unit_si"]),
        (&"1/s^2".into(), &"1/s^2".into())
    );
    let gain = fitted["parameters"].as_array().unwrap().iter().find(|p| p["name"] == "B[2,1]").unwrap();
    assert_eq!((&gain["unit"], &gain["unit_si"]), (&"deg/s^2".into(), &"rad/s^2".into()));
}

/// Values of a file that declares rad are shown in rad: on the terminal, on pages, in the log and in error messages.
fn what_is_shown_is_in_the_unit_that_the_file_declares() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let (vehicle, out, launch) = (path("v.toml"), path("out"), path("launch.toml"));
    let declared = "name = \"platform\"\nA = [[0.0, 1000.0], [-0.004, -2.0]]\nB = [[0.0], [0.03]]\nC = [[1.0, 0.0], [0.0, 1.0]]\n\
                    states = [{ name = \"tilt\", unit = \"mrad\" }, { name = \"rate\", unit = \"rad/s\" }]\n\
                    inputs = [{ name = \"drive\", unit = \"%\", lower = -100, upper = 100 }]\n\
                    outputs = [{ name = \"tilt\", unit = \"mrad\", noise = 1 }, { name = \"rate\", unit = \"rad/s\", noise = 0.002 }]\n";
    std::fs::write(&vehicle, declared).unwrap();
    let bench = format!(
        "vehicle = {vehicle:?}\nrate_hz = 100.0\nduration_s = 10.0\nmode = \"lockstep\"\n[controller]\nlaw = \"lqr\"\n\
         [[effects]]\neffect = \"pulse_disturbance\"\nwhere = \"rate\"\nat_s = 4\nduration_s = 0.5\nmagnitude = 2\n\
         [expect.tilt]\npeak = \"1 mrad\"\n"
    );
    std::fs::write(&launch, bench).unwrap();
    let flown = run(["run", &launch, "--transport", "inproc", "--out", &out]);
    let said = format!("{}{}", flown.stdout, flown.stderr);
    assert!(said.contains("tilt by ") && said.contains(" mrad, recovered"), "{said}");
    assert!(said.contains("above the limit 1.00 mrad"), "{said}");
    let page = std::fs::read_to_string(format!("{out}/report.html")).unwrap().replace("&#x2f;", "/");
    for words in ["tilt, mrad", "rate, rad/s", "drive, %", "disturbance of 2.00 rad/s² on rate"] {
        assert!(page.contains(words), "{words}");
    }
    let log = format!("{out}/log.mcap");
    let compared = run(["compare", &log, "--vehicle", &vehicle, "--out", &path("compared")]).success();
    let page = std::fs::read_to_string(path("compared/report.html")).unwrap();
    assert!(page.contains("tilt, mrad"), "the page of a comparison");
    let excited = run(["excite", &vehicle, "--duration", "30 s"]).success().stdout;
    let diagnosed = run(["diagnose", &log, "--vehicle", &vehicle, "--out", &path("diagnosed")]);
    let told = format!("{}{}{}{}", compared.stdout, excited, diagnosed.stdout, diagnosed.stderr);
    assert!(excited.contains(" mrad, rate "), "{excited}");
    assert!(!format!("{said}{told}").contains("deg"), "{said}{told}");
    let summary = json(format!("{out}/summary.json"));
    assert_eq!(summary["runs"][0]["outputs"]["tilt"]["unit"], "rad", "programs read SI");

    let (campaign, flown) = (path("gusts.toml"), path("flown"));
    let text = format!(
        "launch = {launch:?}\nmethod = \"random\"\nflights = 12\n\
                [[vary]]\nkey = \"effects.0.magnitude\"\nuniform = [\"1 rad/s^2\", \"3 rad/s^2\"]\n"
    );
    std::fs::write(&campaign, text).unwrap();
    let said =
        run(["campaign", &campaign, "--out", &flown, "--json", &path("campaign.json")]).success().stdout;
    let told = said.lines().find(|line| line.contains("tilt.peak <= ")).unwrap_or_default();
    assert!(told.contains("1.00 mrad"), "{said}");
    let page = std::fs::read_to_string(format!("{flown}/report.html")).unwrap().replace("&#x2f;", "/");
    assert!(page.contains("tilt.peak &lt;= 1.00 mrad") && page.contains(" mrad</td>"));
    assert!(page.contains(" mrad*s</td>") && !page.contains(" deg"), "{said}");
    let table = std::fs::read(format!("{flown}/flights.parquet")).unwrap();
    let units = String::from_utf8_lossy(&table);
    assert!(units.contains(r#""tilt.peak":"rad""#), "programs find the SI unit: {units}");
    let answer = json(path("campaign.json"));
    let figures = answer["findings"]["figures"].as_array().unwrap();
    let peak = figures.iter().find(|figure| figure["key"] == "tilt.peak").unwrap();
    assert_eq!(peak["unit"], "rad");
    assert!(!said.contains("deg"), "{said}");
}

whirlstand_test_harness::listed!(
    a_number_without_a_unit_is_answered_with_both_readings,
    a_bias_takes_the_unit_of_its_sensor,
    a_delay_that_a_record_is_too_short_for_is_refused,
    what_a_run_says_carries_units_and_no_noise_of_arithmetic,
    a_checked_vehicle_is_read_back_with_units,
    a_designed_flight_is_written_with_units_and_flies,
    what_is_shown_is_in_the_unit_that_the_file_declares,
);
