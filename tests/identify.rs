//! Identification from flown records alone: each of the paper's vehicles is flown as processes, recorded, and
//! recovered; also the answers of the command to data that it cannot use.

use crate::support::{json, run, spawn, whirlstand};

/// True values of the paper's tables by parameter name, in the file's units, as `vehicle show` prints them.
fn table(vehicle: &str) -> Vec<(String, f64)> {
    let text = run(["vehicle", "show", vehicle]).success().stdout;
    let file: toml::Table = text.parse().unwrap();
    let entry = |name: &str| -> f64 {
        let (matrix, rest) = name.split_once('[').unwrap();
        let (i, j) = rest.trim_end_matches(']').split_once(',').unwrap();
        let (i, j): (usize, usize) = (i.parse().unwrap(), j.parse().unwrap());
        file[matrix].as_array().unwrap()[i - 1].as_array().unwrap()[j - 1].as_float().unwrap()
    };
    let free = file["free"].as_array().unwrap();
    free.iter()
        .map(|f| f["entry"].as_str().unwrap().to_string())
        .map(|name| (name.clone(), entry(&name)))
        .collect()
}

/// Flies a test flight as processes and returns the folder of its log.
fn fly(dir: &std::path::Path, vehicle: &str, duration: &str, seed: &str) -> String {
    let folder = dir.join(format!("flight-{seed}"));
    let folder = folder.to_str().unwrap();
    run(["excite", vehicle, "--kind", "multistep", "--duration", duration, "--seed", seed, "--out", folder])
        .success();
    let log = format!("{folder}/log");
    run(["run", &format!("{folder}/flight.toml"), "--mode", "lockstep", "--seed", seed, "--out", &log])
        .success();
    log
}

fn recovers(vehicle: &str, structure: &str) {
    let dir = tempfile::tempdir().unwrap();
    let fitted = fly(dir.path(), vehicle, "120", "1");
    let control = fly(dir.path(), vehicle, "60", "2");
    let out = dir.path().join("identify");
    let fitted_vehicle = dir.path().join("fitted.toml");
    run([
        "identify",
        &fitted,
        "--vehicle",
        structure,
        "--noise",
        "coloured",
        "--validation",
        &control,
        "--out",
        out.to_str().unwrap(),
        "--json",
        out.join("identification.json").to_str().unwrap(),
        "--output",
        fitted_vehicle.to_str().unwrap(),
    ])
    .success();
    let answer = json(out.join("identification.json"));
    assert_eq!(answer["schema"], "whirlstand.identification.v1");
    assert!(out.join("report.html").is_file());

    parameters_are_within_their_errors(vehicle, &answer);
    poles_are_those_of(vehicle, &answer);
    control_data_are_predicted(vehicle, &answer, &control, dir.path());

    // The fitted file is a valid vehicle and states its origin.
    let text = std::fs::read_to_string(&fitted_vehicle).unwrap();
    assert!(text.contains("log_1_sha256") && text.contains("\"pem\""));
    run(["vehicle", "check", fitted_vehicle.to_str().unwrap()]).success();
}

fn parameters_are_within_their_errors(vehicle: &str, answer: &serde_json::Value) {
    let truth = table(vehicle);
    let parameters = answer["parameters"].as_array().unwrap();
    let mut outside = Vec::new();
    for p in parameters {
        let name = p["name"].as_str().unwrap();
        let value = p["value"].as_f64().unwrap();
        let error = p["standard_error"].as_f64().unwrap();
        let (_, wanted) = truth.iter().find(|(n, _)| n == name).unwrap();
        if (value - wanted).abs() > 3.0 * error {
            outside.push(format!("{name}: {value} +- {error}, true {wanted}"));
        }
    }
    println!(
        "{vehicle}: {} parameters, outside 3 standard errors: {outside:?}, fixed {}",
        parameters.len(),
        answer["fixed"]
    );
    assert_eq!(parameters.len(), truth.len(), "all are identifiable: {}", answer["fixed"]);
    // At most one in a hundred may lie outside: of 12 or 20, none is expected, and one is allowed for chance.
    assert!(outside.len() <= 1, "{outside:?}");
}

fn poles_are_those_of(vehicle: &str, answer: &serde_json::Value) {
    let poles = |answer: &serde_json::Value| -> Vec<(f64, f64)> {
        let all = answer["poles"].as_array().unwrap();
        all.iter().map(|p| (p["re"].as_f64().unwrap(), p["im"].as_f64().unwrap())).collect()
    };
    let check = run(["vehicle", "check", vehicle, "--json"]).success().stdout;
    let check: serde_json::Value = serde_json::from_str(&check).unwrap();
    for pole in check["poles"].as_array().unwrap() {
        let (re, im) = (pole[0].as_f64().unwrap(), pole[1].as_f64().unwrap());
        let size = re.hypot(im);
        let nearest =
            poles(answer).into_iter().map(|(a, b)| (a - re).hypot(b - im)).fold(f64::INFINITY, f64::min);
        println!("{vehicle}: pole {re:.3} {im:+.3}i off by {:.3} %", 100.0 * nearest / size.max(1e-9));
        assert!(nearest <= 0.02 * size.max(0.05), "{vehicle}: pole {re} {im}");
    }
}

/// Predicts control data as well as the true parameters do.
fn control_data_are_predicted(
    vehicle: &str,
    answer: &serde_json::Value,
    control: &str,
    dir: &std::path::Path,
) {
    let comparison = dir.join("comparison.json");
    run(["compare", control, "--vehicle", vehicle, "--json", comparison.to_str().unwrap()]).success();
    let comparison = json(comparison);
    for (name, output) in answer["outputs"].as_object().unwrap() {
        let own = output["control"]["free_run_fit"].as_f64().unwrap();
        let best = comparison["outputs"][name]["fit"].as_f64().unwrap();
        println!("{vehicle}: {name} validation data {own:.3} %, true parameters {best:.3} %");
        assert!(own >= 0.98 * best, "{vehicle}: {name} {own} {best}");
    }
}

fn the_quadrotor_is_found_again() {
    recovers("quadrotor", "quadrotor-structure");
}

fn the_hovering_helicopter_is_found_again() {
    recovers("helicopter-hover", "helicopter-structure");
}

fn the_longitudinal_helicopter_is_found_again() {
    recovers("helicopter-longitudinal", "helicopter-structure");
}

fn the_lateral_helicopter_is_found_again() {
    recovers("helicopter-lateral", "helicopter-structure");
}

/// A search that takes long: the genetic algorithm on a whole flight.
fn long_search<'a>(log: &'a str, answer: &'a str) -> [&'a str; 10] {
    [
        "identify",
        log,
        "--vehicle",
        "quadrotor-structure",
        "--method",
        "ga+pem",
        "--evaluations",
        "10000000",
        "--json",
        answer,
    ]
}

fn ctrl_c_ends_an_identification_with_the_best_so_far() {
    let dir = tempfile::tempdir().unwrap();
    let log = fly(dir.path(), "quadrotor", "20", "1");
    let path = dir.path().join("answer.json");
    let search = spawn(whirlstand(long_search(&log, path.to_str().unwrap())));
    search.wait_for_handlers();
    search.signal(libc::SIGINT);
    let ended = search.finish();
    assert_eq!(ended.code(), 130, "{}\n{}", ended.stdout, ended.stderr);
    assert!(ended.stderr.contains("interrupted"), "{}", ended.stderr);
    assert!(ended.stdout.starts_with("Partial"), "{}", ended.stdout);
    let answer = json(&path);
    assert_eq!(
        (&answer["partial"], &answer["standard_errors_hold"]),
        (&true.into(), &false.into()),
        "{answer}"
    );
    assert_eq!(answer["parameters"].as_array().map(Vec::len), Some(12), "{answer}");
    assert!(answer["remarks"].to_string().contains("ended early"), "{answer}");
}

fn a_budget_of_time_ends_every_method_with_the_best_so_far() {
    let dir = tempfile::tempdir().unwrap();
    let log = fly(dir.path(), "quadrotor", "20", "1");
    let (path, file) = (dir.path().join("answer.json"), dir.path().join("fitted.toml"));
    let (out, file) = (dir.path().join("out").display().to_string(), file.display().to_string());
    let call = ["identify", &log, "--vehicle", "quadrotor-structure", "--json", path.to_str().unwrap()];
    let end = ["--budget", "1 ms", "--output", &file, "--out", &out];
    for how in [
        ["--method", "ga"],
        ["--method", "ga+pem"],
        ["--noise", "white"],
        ["--noise", "coloured"],
        ["--noise", "kalman"],
    ] {
        let ended = run(call.into_iter().chain(how).chain(end));
        assert_eq!(ended.code(), 3, "{how:?} {}\n{}", ended.stdout, ended.stderr);
        assert!(ended.stdout.starts_with("Partial") && ended.stderr.contains("budget"), "{}", ended.stderr);
        let answer = json(&path);
        assert_eq!(
            (&answer["partial"], &answer["search"]["converged"]),
            (&true.into(), &false.into()),
            "{answer}"
        );
        assert_eq!(answer["parameters"].as_array().map(Vec::len), Some(12), "{answer}");
        assert!(std::fs::read_to_string(&file).unwrap().contains("ended early"), "its file says so");
        assert!(
            std::fs::read_to_string(format!("{out}/report.html")).unwrap().contains("Partial, as the search")
        );
    }
    // With enough time, it is complete.
    let whole = run(call.into_iter().chain(["--budget", "10 min"])).success();
    assert!(whole.stdout.starts_with("12 parameters"), "{}", whole.stdout);
    assert_eq!(json(&path)["partial"], false);
    let wrong = run(call.into_iter().chain(["--budget", "5 m"]));
    assert_eq!(wrong.code(), 2, "{}", wrong.stderr);
}

/// A refused call: exit code 2, all of `words` on standard error, and nothing written.
#[track_caller]
fn refused(record: &str, vehicle: &str, more: &[&str], words: &[&str]) {
    let dir = tempfile::tempdir().unwrap();
    let (log, file) = (dir.path().join("record.csv"), dir.path().join("vehicle.toml"));
    std::fs::write(&log, record).unwrap();
    std::fs::write(&file, vehicle).unwrap();
    let out = dir.path().join("out.toml");
    let (page, answer) = (dir.path().join("page"), dir.path().join("answer.json"));
    let args = [
        "identify",
        log.to_str().unwrap(),
        "--vehicle",
        file.to_str().unwrap(),
        "--output",
        out.to_str().unwrap(),
        "--out",
        page.to_str().unwrap(),
        "--json",
        answer.to_str().unwrap(),
    ];
    let result = run(args.iter().copied().chain(more.iter().copied()));
    assert_eq!(result.code(), 2, "{}\n{}", result.stdout, result.stderr);
    for word in words {
        assert!(result.stderr.contains(word), "{word:?} is missing in:\n{}", result.stderr);
    }
    assert!(!result.stderr.contains("panicked"), "{}", result.stderr);
    assert!(!out.exists() && !page.exists() && !answer.exists(), "nothing is written");
}

fn cart(free: &str) -> String {
    format!(
        "A = [[0.0, 1.0], [-4.0, -0.5]]\nB = [[0.0], [2.0]]\nstates = [{{ name = \"x\" }}, {{ name = \"v\" }}]\n\
         inputs = [{{ name = \"u\" }}]\noutputs = [{{ name = \"x\" }}]\n{free}\n"
    )
}

fn series(steps: usize, u: impl Fn(usize) -> f64, y: impl Fn(usize) -> f64) -> String {
    let rows = (0..steps).map(|k| format!("{},{},{}\n", k as f64 * 0.01, u(k), y(k)));
    std::iter::once("t,u,x\n".to_string()).chain(rows).collect()
}

fn what_cannot_be_identified_is_refused_with_the_reason() {
    let bounded = "free = [{ entry = \"A[2,1]\", lower = -10.0, upper = 0.0 }]";
    let moving = series(500, |k| f64::from(k as u32 / 50 % 2), |k| (k as f64 * 0.02).sin());
    refused(&moving, &cart(""), &[], &["has no free parameter", "add free ="]);
    refused(
        &moving,
        &cart("free = [{ entry = \"A[2,1]\", lower = -10.0 }]"),
        &[],
        &["vehicle.toml, line", "upper is missing", "needs bounds"],
    );
    refused(
        &series(500, |_| 0.0, |_| 0.1),
        &cart(bounded),
        &[],
        &["no input of the vehicle changes", "excite"],
    );
    let many = "free = [{ entry = \"A[2,1]\", lower = -10.0, upper = 0.0 }, { entry = \"A[2,2]\", lower = -10.0, upper = 0.0 }, \
                { entry = \"A[1,1]\", lower = -1.0, upper = 1.0 }, { entry = \"B[2,1]\", lower = 0.0, upper = 9.0 }, \
                { entry = \"B[1,1]\", lower = 0.0, upper = 9.0 }]";
    let sparse: String = std::iter::once("t,u,x\n".to_string())
        .chain(
            (0..40)
                .map(|k| format!("{},{},{}\n", k as f64 * 0.01, k % 3, if k % 10 == 0 { "1.0" } else { "" })),
        )
        .collect();
    refused(&sparse, &cart(many), &[], &["4 measured values cannot determine 7 unknowns"]);
    let unstable = "free = [{ entry = \"A[2,2]\", lower = 20.0, upper = 90.0, start = 50.0 }]";
    refused(&moving, &cart(unstable), &["--noise", "white"], &["diverges", "start values", "stable"]);
    refused(
        &moving.replace("t,u,x", "t,force,x"),
        &cart(bounded),
        &[],
        &["no signal 'u'", "It has: force, x"],
    );
}

whirlstand_test_harness::listed!(
    the_quadrotor_is_found_again,
    the_hovering_helicopter_is_found_again,
    the_longitudinal_helicopter_is_found_again,
    the_lateral_helicopter_is_found_again,
    ctrl_c_ends_an_identification_with_the_best_so_far,
    a_budget_of_time_ends_every_method_with_the_best_so_far,
    what_cannot_be_identified_is_refused_with_the_reason,
);
