//! Identification from logs of other programs: PX4 ULog and MCAP in JSON, ROS 2 and protobuf; sensors with units, rates
//! and delays of their own, and a gap in the middle.

use std::path::{Path, PathBuf};

use crate::support::foreign::{Encoding, Topic, mcap, ulog};
use crate::support::{json, run};
use whirlstand_test_harness::{Outcome, python};

/// Delay of the logged attitude, s.
const LATE: f64 = 0.06;
/// Interval without any logged data, s.
const GAP: (f64, f64) = (30.0, 33.0);

/// Topics in which PX4 logs the signals of the flight: sticks, attitude, rates.
const ULOG_TOPICS: [&str; 3] = ["manual_control", "vehicle_attitude", "vehicle_angular_velocity"];

/// A simulated flight at 200 Hz with sensor noise, as columns.
struct Flight {
    t: Vec<f64>,
    columns: Vec<(String, Vec<f64>)>,
}

impl Flight {
    fn new(dir: &Path) -> Self {
        let (folder, response) = (dir.join("excite"), dir.join("response.csv"));
        let (folder, response) = (folder.to_str().unwrap(), response.to_str().unwrap());
        run(["excite", "quadrotor", "--duration", "90", "--rate", "200", "--out", folder]).success();
        let inputs = format!("{folder}/inputs.csv");
        run(["simulate", "quadrotor", "--input", &inputs, "--noise", "--seed", "4", "--output", response])
            .success();
        let text = std::fs::read_to_string(response).unwrap();
        let mut lines = text.lines();
        let names: Vec<String> =
            lines.next().unwrap().split(',').map(|n| n.split('[').next().unwrap().to_string()).collect();
        let rows: Vec<Vec<f64>> =
            lines.map(|l| l.split(',').map(|v| v.parse().unwrap_or(f64::NAN)).collect()).collect();
        let column = |i: usize| rows.iter().map(|r| r[i]).collect::<Vec<f64>>();
        Self { t: column(0), columns: (1..names.len()).map(|i| (names[i].clone(), column(i))).collect() }
    }

    /// A topic with the named signals: every `every`-th sample, delayed by `late`, multiplied by `factor`.
    fn topic(
        &self,
        name: &'static str,
        fields: &[(&'static str, &str)],
        (every, late, factor): (usize, f64, f64),
    ) -> Topic {
        let columns: Vec<&Vec<f64>> =
            fields.iter().map(|(_, s)| &self.columns.iter().find(|(n, _)| n == s).unwrap().1).collect();
        let rows = self.t.iter().enumerate().step_by(every);
        let rows = rows.filter(|(_, t)| !(GAP.0..GAP.1).contains(*t));
        Topic {
            name,
            fields: fields.iter().map(|(f, _)| *f).collect(),
            rows: rows.map(|(k, t)| (t + late, columns.iter().map(|c| factor * c[k]).collect())).collect(),
        }
    }

    /// Sticks in percent, attitude at 50 Hz in degrees and delayed, rates in degrees per second.
    fn topics(&self, [sticks, attitude, rates]: [&'static str; 3]) -> [Topic; 3] {
        let degrees = 180.0 / std::f64::consts::PI;
        [
            self.topic(sticks, &[("lateral", "u_roll"), ("forward", "u_pitch")], (1, 0.0, 100.0)),
            self.topic(attitude, &[("phi", "roll"), ("theta", "pitch")], (4, LATE, degrees)),
            self.topic(rates, &[("p", "roll_rate"), ("q", "pitch_rate")], (1, 0.0, degrees)),
        ]
    }
}

/// The true parameters of the quadrotor, by name.
const TRUTH: [(&str, f64); 12] = [
    ("A[2,1]", -1.1132),
    ("A[2,2]", -0.7118),
    ("A[2,3]", 0.0001),
    ("A[2,4]", 0.0),
    ("A[4,1]", 7.2721),
    ("A[4,2]", 6.1794),
    ("A[4,3]", -7.9908),
    ("A[4,4]", -5.2474),
    ("B[2,1]", -1.1045),
    ("B[2,2]", 0.0),
    ("B[4,1]", -4.5267),
    ("B[4,2]", -14.4146),
];

/// Identifies the log with its mapping and compares the answer with the truth.
fn finds_the_quadrotor(log: &Path, names: [&str; 3]) {
    let [sticks, attitude, rates] = names;
    let out = log.with_extension("json");
    let maps = [
        format!("u_roll={sticks}.lateral[%]"),
        format!("u_pitch={sticks}.forward[%]"),
        format!("roll={attitude}.phi[deg]"),
        format!("pitch={attitude}.theta[deg]"),
        format!("roll_rate={rates}.p[deg/s]"),
        format!("pitch_rate={rates}.q[deg/s]"),
    ];
    let call = |more: &[&str]| {
        let mut args = vec!["identify", log.to_str().unwrap(), "--vehicle", "quadrotor-structure"];
        maps.iter().for_each(|m| args.extend(["--map", m]));
        args.extend(["--period", "0.02", "--noise", "coloured", "--hold-out", "60:90"]);
        args.extend(["--json", out.to_str().unwrap()]);
        args.extend(more);
        let finished = run(args).success();
        (finished.stderr, json(&out))
    };
    // Without `--align` the delay is reported, and the answer is affected by the delayed attitude.
    let (told, late) = call(&[]);
    assert!(told.contains("roll lags roll_rate, its derivative, by") && told.contains("--align"), "{told}");
    let (told, answer) = call(&["--align"]);
    let moved: Vec<f64> = told
        .lines()
        .filter(|l| l.contains(": shifted"))
        .map(|l| l.split("by ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap())
        .collect();
    assert_eq!(moved.len(), 2, "{told}");
    assert!(moved.iter().all(|ms| (ms - 1e3 * LATE).abs() < 5.0), "{told}");

    let parts: Vec<(f64, f64)> = answer["data"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|d| d["role"] == "identification")
        .map(|d| (d["from_s"].as_f64().unwrap(), d["until_s"].as_f64().unwrap()))
        .collect();
    assert_eq!(parts.len(), 2, "cut at the gap: {parts:?}");
    assert!(parts[0].1 < GAP.0 + 0.1 && parts[1].0 > GAP.1 - 0.1, "{parts:?}");

    let parameters = answer["parameters"].as_array().unwrap();
    assert_eq!(parameters.len(), TRUTH.len(), "fixed: {}", answer["fixed"]);
    for p in parameters {
        let (name, value) = (p["name"].as_str().unwrap(), p["value"].as_f64().unwrap());
        let (_, truth) = TRUTH.iter().find(|(n, _)| *n == name).unwrap();
        println!("{name} {value} true {truth} +- {}", p["standard_error"]);
        assert!((value - truth).abs() < 0.02 * truth.abs().max(1.0), "{name} {value} {truth}");
    }
    for output in ["roll", "pitch"] {
        let fit = |answer: &serde_json::Value| {
            answer["outputs"][output]["control"]["free_run_fit"].as_f64().unwrap()
        };
        println!("{output} {:.2} %, late {:.2} %", fit(&answer), fit(&late));
        assert!(fit(&answer) > 95.0 && fit(&answer) > 1.0 + fit(&late), "{} {}", fit(&answer), fit(&late));
    }
}

fn a_ulog_is_identified() {
    let dir = tempfile::tempdir().unwrap();
    let flight = Flight::new(dir.path());
    let log = dir.path().join("flight.ulg");
    std::fs::write(&log, ulog(&flight.topics(ULOG_TOPICS))).unwrap();
    finds_the_quadrotor(&log, ULOG_TOPICS);

    let wrong = ["identify", log.to_str().unwrap(), "--vehicle", "quadrotor-structure", "--map"];
    let refused = run(wrong.into_iter().chain(["roll=vehicle_attitude.phy[deg]"]));
    assert_eq!(refused.code(), 2);
    for word in
        ["no signal 'vehicle_attitude.phy'", "did you mean 'vehicle_attitude.phi'", "manual_control.forward"]
    {
        assert!(refused.stderr.contains(word), "{word} in {}", refused.stderr);
    }
    // A valid mapping that does not cover the whole vehicle.
    let refused = run(wrong.into_iter().chain(["roll=vehicle_attitude.phi[deg]"]));
    assert_eq!(refused.code(), 2);
    assert!(refused.stderr.contains("no signal 'u_roll'"), "{}", refused.stderr);
}

fn an_mcap_log_of_three_encodings_is_identified() {
    let dir = tempfile::tempdir().unwrap();
    let flight = Flight::new(dir.path());
    let names = ["/sticks", "/camera/attitude", "/imu/rates"];
    let log: PathBuf = dir.path().join("flight.mcap");
    let topics = flight.topics(names);
    let encodings = [Encoding::Json, Encoding::Ros2, Encoding::Protobuf];
    mcap(&log, &topics.into_iter().zip(encodings).collect::<Vec<_>>());
    finds_the_quadrotor(&log, names);
}

/// The PX4 project's own reader accepts the log that is identified here.
fn pyulog_reads_the_ulog() -> Outcome {
    let python = python()?;
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("flight.ulg");
    std::fs::write(&log, ulog(&Flight::new(dir.path()).topics(ULOG_TOPICS))).unwrap();
    let script = "import sys, pyulog\n\
        log = pyulog.ULog(sys.argv[1])\n\
        d = {d.name: d.data for d in log.data_list}\n\
        a = d['vehicle_attitude']\n\
        assert len(d) == 3 and not log.file_corruption, d.keys()\n\
        assert abs(a['timestamp'][1] - a['timestamp'][0] - 20000) <= 1, a['timestamp'][:2]\n\
        assert 1.0 < max(abs(a['phi'])) < 25.0, max(abs(a['phi']))\n\
        assert len(d['manual_control']['forward']) == len(d['vehicle_angular_velocity']['p'])\n";
    let output = std::process::Command::new(python).args(["-c", script]).arg(&log).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Ok(())
}

whirlstand_test_harness::listed!(
    a_ulog_is_identified,
    an_mcap_log_of_three_encodings_is_identified,
    pyulog_reads_the_ulog
);
