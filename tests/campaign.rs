//! Campaigns as whole processes: a flight in one thread equals the flight over processes, merged parts equal the whole,
//! and an interrupted campaign resumes.

use std::path::{Path, PathBuf};

use crate::support::{json, refused, run, spawn, until, whirlstand};
use serde_json::Value;

const GUSTS: &str = r#"
launch = "quadrotor"
flights = 24
method = "latin-hypercube"
seed = 3
set = ["duration_s=9"]

[[effects]]
effect = "input_gain"
where = "u_roll"
factor = 1.0

[[vary]]
key = "effects.0.magnitude"
uniform = ["100 deg/s^2", "400 deg/s^2"]

[[vary]]
key = "added.0.factor"
normal = { mean = 1.0, std = 0.1 }

[[vary]]
key = "seed"
integers = [1, 1000000]
"#;

struct Place {
    dir: tempfile::TempDir,
}

impl Place {
    fn new(text: &str) -> Self {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("gusts.toml"), text).unwrap();
        Self { dir }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// Runs `campaign` and returns its answer.
    fn answer(&self, args: &[&str]) -> Value {
        let ended = run(self.call(args)).success();
        serde_json::from_str(&ended.stdout).unwrap_or_else(|e| panic!("{e}: {}", ended.stdout))
    }

    /// `FILE` and `DIR/...` stand for the campaign file and paths beside it.
    fn call(&self, args: &[&str]) -> Vec<String> {
        let placed = |arg: &&str| match (*arg, arg.strip_prefix("DIR/")) {
            ("FILE", _) => self.path("gusts.toml").display().to_string(),
            (_, Some(name)) => self.path(name).display().to_string(),
            _ => (*arg).to_string(),
        };
        std::iter::once("campaign".to_string())
            .chain(args.iter().map(placed))
            .chain(["--json".into()])
            .collect()
    }
}

fn bytes(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn parts_join_to_the_bytes_of_the_whole_and_a_flight_is_that_of_processes() {
    let place = Place::new(GUSTS);
    let whole = place.answer(&["FILE", "--out", "DIR/whole", "--jobs", "2"]);
    assert_eq!((&whole["flown"], &whole["partial"]), (&24.into(), &false.into()));
    let violated = &whole["findings"]["violated"];
    assert!(
        violated["count"].as_u64().unwrap() > 0 && violated["low"].as_f64() < violated["share"].as_f64(),
        "{whole}"
    );
    // The peak of roll depends more on the magnitude of its gust than on any other varied key.
    let figures = whole["findings"]["figures"].as_array().unwrap();
    let peak = figures.iter().find(|f| f["key"] == "roll.peak").unwrap();
    assert_eq!(peak["sensitivities"][0]["key"], "effects.0.magnitude");
    assert!(peak["sensitivities"][0]["rank_correlation"].as_f64().unwrap() > 0.9, "{peak}");
    let page = String::from_utf8(bytes(&place.path("whole/report.html"))).unwrap();
    assert!(page.contains("flights exceeded a limit"));

    for part in ["1/3", "2/3", "3/3"] {
        place.answer(&["FILE", "--out", "DIR/parts", "--shard", part, "--jobs", "1"]);
    }
    let parts: Vec<String> = (1..=3).map(|n| format!("DIR/parts/part-{n}-of-3.parquet")).collect();
    let merge = |chosen: &[&str], out: &str| place.call(&[&["merge"], chosen, &["--out", out]].concat());
    run(merge(&[&parts[2], &parts[0], &parts[1]], "DIR/joined")).success();
    assert_eq!(bytes(&place.path("joined/flights.parquet")), bytes(&place.path("whole/flights.parquet")));
    let ended = run(merge(&[&parts[0], &parts[1]], "DIR/less"));
    assert!(ended.code() == 2 && ended.stderr.contains("parts 3/3 are missing"), "{}", ended.stderr);

    // One of the worst flights is replayed as processes.
    let mut worst = whole["findings"]["worst"].as_array().unwrap().iter();
    let worst = worst.find(|w| w["of_limit"].is_number()).unwrap();
    let number = worst["flight"].as_u64().unwrap().to_string();
    let ended = run(place.call(&["replay", "FILE", "--flight", &number, "--out", "DIR/worst"]));
    assert_eq!(
        ended.code(),
        i32::from(worst["of_limit"].as_f64().unwrap() > 1.0),
        "{worst}: {}",
        ended.stderr
    );
    let summary = json(place.path("worst/summary.json"));
    let run = &summary["runs"][0];
    assert_eq!((&run["mode"], &run["transport"]), (&"lockstep".into(), &"iceoryx2".into()));
    let key = worst["key"].as_str().unwrap();
    let limit = run["expect"].as_array().unwrap().iter().find(|e| e["key"] == key).unwrap();
    let share = limit["found"].as_f64().unwrap() / limit["limit"].as_f64().unwrap();
    // JSON has twelve digits; `determinism.rs` shows that the logs are identical to the last bit.
    assert!((share / worst["of_limit"].as_f64().unwrap() - 1.0).abs() < 1e-11, "{limit} {worst}");
}

fn what_identify_found_varies_with_its_covariance() {
    let place = Place::new(
        "launch = \"quadrotor\"\nflights = 40\nset = [\"duration_s=9\"]\n[[vary]]\nfound = \"fit.json\"\nwiden = 20.0\n",
    );
    let at = |name: &str| place.path(name).display().to_string();
    run([
        "excite",
        "quadrotor",
        "--kind",
        "multistep",
        "--duration",
        "30",
        "--seed",
        "1",
        "--out",
        &at("excite"),
    ])
    .success();
    let flight = at("excite/flight.toml");
    run(["run", &flight, "--mode", "lockstep", "--set", "transport=inproc", "--out", &at("log")]).success();
    run(["identify", &at("log"), "--vehicle", "quadrotor-structure", "--json", &at("fit.json")]).success();

    let whole = place.answer(&["FILE", "--out", "DIR/whole"]);
    assert_eq!((&whole["flown"], &whole["findings"]["failed"]["count"]), (&40.into(), &0.into()), "{whole}");
    let figures = whole["findings"]["figures"].as_array().unwrap();
    let moved = figures.iter().find(|f| f["key"] == "roll.peak").unwrap();
    let key = moved["sensitivities"][0]["key"].as_str().unwrap();
    assert!(key.starts_with("A[") || key.starts_with("B["), "{moved}");

    // The parts still belong to the same campaign after the identification answer was removed before the merge.
    for part in ["1/2", "2/2"] {
        place.answer(&["FILE", "--out", "DIR/parts", "--shard", part]);
    }
    std::fs::remove_file(place.path("fit.json")).unwrap();
    let parts = ["DIR/parts/part-1-of-2.parquet", "DIR/parts/part-2-of-2.parquet"];
    run(place.call(&[&["merge"], &parts[..], &["--out", "DIR/joined"]].concat())).success();
    assert_eq!(bytes(&place.path("joined/flights.parquet")), bytes(&place.path("whole/flights.parquet")));
    let file = at("gusts.toml");
    refused(&["campaign", &file, "--out", &at("out")], &["found = \"fit.json\"", "cannot be read"]);
}

fn a_rare_failure_is_found_where_failures_are_frequent() {
    let gusts = |flights: u32, more: &str| {
        format!(
            "launch = \"quadrotor\"\nflights = {flights}\nmethod = \"importance\"\nset = [\"duration_s=9\"]\n{more}\n\
             [[vary]]\nkey = \"effects.0.magnitude\"\nnormal = {{ mean = \"150 deg/s^2\", std = \"15 deg/s^2\" }}\n"
        )
    };
    let place = Place::new(&gusts(400, "[importance]\nspread = 4.0"));
    let pilot = place.answer(&["FILE", "--out", "DIR/pilot"]);
    assert!(pilot["findings"]["violated"]["count"].as_u64().unwrap() >= 10, "{pilot}");
    std::fs::write(place.path("gusts.toml"), gusts(400, "[importance]\nafter = \"pilot/flights.parquet\""))
        .unwrap();
    let rare = place.answer(&["FILE", "--out", "DIR/rare"]);
    let [pilot, rare] = [pilot, rare].map(|answer| answer["findings"]["violated"].clone());
    let end = |p: &Value, key: &str| p[key].as_f64().unwrap();
    assert!(end(&rare, "share") < 0.02 && end(&rare, "low") > 0.0, "{rare}");
    // Two unbiased estimates of one probability, the second narrower.
    assert!(
        end(&rare, "low") < end(&pilot, "high") && end(&pilot, "low") < end(&rare, "high"),
        "{pilot} {rare}"
    );
    let width = |p: &Value| end(p, "high") - end(p, "low");
    assert!(width(&rare) < width(&pilot), "{pilot} {rare}");
    let file = place.path("gusts.toml").display().to_string();
    refused(&["campaign", &file, "--until-width", "0.1"], &["importance", "\"random\" or \"sobol\""]);
}

fn a_killed_campaign_goes_on_where_it_was_to_the_same_bytes() {
    // Long enough that it can be killed amid its flights.
    let long = GUSTS.replace("duration_s=9", "duration_s=1000").replace("flights = 24", "flights = 96");
    let place = Place::new(&long);
    place.answer(&["FILE", "--out", "DIR/whole"]);
    let mut killed = spawn(whirlstand(place.call(&["FILE", "--out", "DIR/cut", "--jobs", "1", "--resume"])));
    // Killed as soon as some flights are stored.
    let journal = place.path("cut/flights.jsonl");
    let kept = || std::fs::read_to_string(&journal).map_or(0, |text| text.lines().count());
    until("no flights are kept", || kept() >= 4 || !killed.is_alive());
    killed.signal(libc::SIGKILL);
    killed.finish();
    assert!(kept() >= 4 && !place.path("cut/flights.parquet").exists());
    // Another campaign file cannot resume with these flights.
    let other = place.path("other.toml");
    std::fs::write(&other, GUSTS.replace("seed = 3", "seed = 4")).unwrap();
    let file = other.display().to_string();
    let out = place.path("cut").display().to_string();
    refused(&["campaign", &file, "--out", &out, "--resume"], &["--resume", "another campaign"]);

    let rest = place.answer(&["FILE", "--out", "DIR/cut", "--resume"]);
    assert_eq!(rest["flown"], 96);
    assert_eq!(bytes(&place.path("cut/flights.parquet")), bytes(&place.path("whole/flights.parquet")));
    assert!(!journal.exists());
}

fn ctrl_c_keeps_what_is_done_and_enough_is_enough() {
    let place = Place::new(
        &GUSTS
            .replace("latin-hypercube", "sobol")
            .replace("flights = 24", "flights = 60000")
            .replace("duration_s=9", "duration_s=60"),
    );
    let mut bench = spawn(whirlstand(place.call(&["FILE", "--out", "DIR/cut"])));
    let journal = place.path("cut/flights.jsonl");
    let kept = || std::fs::read_to_string(&journal).map_or(0, |text| text.lines().count());
    until("no flights are kept", || kept() >= 3 || !bench.is_alive());
    bench.signal(libc::SIGINT);
    let ended = bench.finish();
    assert_eq!(ended.code(), 130, "{}", ended.stderr);
    let answer: Value = serde_json::from_str(&ended.stdout).unwrap();
    assert_eq!((&answer["partial"], &answer["planned"]), (&true.into(), &60_000.into()));
    assert!(journal.exists() && answer["flown"].as_u64().unwrap() >= 2, "{answer}");

    // After 64 flights the interval is narrower than 0.25, whatever their results.
    let enough = place.answer(&["FILE", "--out", "DIR/enough", "--until-width", "0.25"]);
    assert_eq!((&enough["ended_early"], &enough["flown"]), (&true.into(), &64.into()), "{enough}");
}

fn what_cannot_be_flown_is_told_with_its_place() {
    for (from, to, words) in [
        ("\"quadrotor\"", "\"quadroter\"", &["quadroter", "did you mean 'quadrotor'?"][..]),
        ("key = \"seed\"", "key = \"sed\"", &["flight 0 of the campaign", "--set sed=", "seed"]),
        ("key = \"seed\"", "key = \"vehicle\"", &["vehicle cannot vary"]),
        ("400 deg/s^2", "400 deg", &["line 13", "the same unit, not 'deg/s^2' and 'deg'"]),
        ("deg/s^2", "kg", &["flight 0 of the campaign", "effects.0.magnitude"]),
        ("launch = \"quadrotor\"", "launch = \"quadrotor-compare\"", &["quadrotor-compare has variants"]),
        (
            "launch = \"quadrotor\"",
            "launch = \"quadrotor-mavlink\"",
            &["node plant of quadrotor-mavlink", "hardware"],
        ),
    ] {
        let place = Place::new(&GUSTS.replace(from, to));
        let file = place.path("gusts.toml").display().to_string();
        let out = place.path("out").display().to_string();
        refused(&["campaign", &file, "--out", &out], words);
    }
    let place = Place::new(GUSTS);
    let file = place.path("gusts.toml").display().to_string();
    refused(&["campaign", &file, "--until-width", "0.1"], &["latin-hypercube", "\"random\" or \"sobol\""]);
    refused(&["campaign", "replay", &file, "--flight", "24"], &["has the flights 0 to 23"]);
}

whirlstand_test_harness::listed!(
    parts_join_to_the_bytes_of_the_whole_and_a_flight_is_that_of_processes,
    what_identify_found_varies_with_its_covariance,
    a_rare_failure_is_found_where_failures_are_frequent,
    a_killed_campaign_goes_on_where_it_was_to_the_same_bytes,
    ctrl_c_keeps_what_is_done_and_enough_is_enough,
    what_cannot_be_flown_is_told_with_its_place,
);
