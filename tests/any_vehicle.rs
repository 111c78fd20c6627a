//! A vehicle with arbitrary signal names flies: its outputs are transmitted, estimated, recorded, judged, exported and
//! identified.

use std::path::Path;

use crate::support::{json, run};

/// Position control of a DC motor; the program knows none of its signal names.
const MOTOR: &str = r#"
name = "motor"
A = [[0.0, 1.0, 0.0], [0.0, -2.0, 20.0], [0.0, -0.5, -40.0]]
B = [[0.0], [0.0], [50.0]]
C = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
states = [{ name = "angle", unit = "rad" }, { name = "speed", unit = "rad/s" }, { name = "current", unit = "A" }]
inputs = [{ name = "voltage", unit = "V", lower = -12.0, upper = 12.0 }]
outputs = [
    { name = "encoder", unit = "rad", noise = 0.001 },
    { name = "shunt", unit = "A", noise = 0.01, every = 3 },
]
"#;

/// The complete example of the documentation.
fn documented() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/vehicle-file.md");
    let text = std::fs::read_to_string(path).expect("the documentation");
    let block = text.split("```toml\n").nth(1).expect("an example");
    block.split("```").next().expect("its end").to_string()
}

#[track_caller]
fn flies(vehicle: &str, law: &str, outputs: &[&str]) {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().expect("utf-8 path").to_string();
    let file = path("vehicle.toml");
    std::fs::write(&file, vehicle).unwrap();
    let check = run(["vehicle", "check", &file]).success();
    assert!(!check.stdout.contains("cannot fly"), "{}", check.stdout);
    let launch = format!(
        "vehicle = {file:?}\nrate_hz = 200.0\nduration_s = 3.0\nmode = \"lockstep\"\n[controller]\n{law}\n"
    );
    std::fs::write(path("launch.toml"), launch).unwrap();
    let mut logs = Vec::new();
    for transport in ["iceoryx2", "zenoh", "inproc"] {
        let out = path(transport);
        run(["run", &path("launch.toml"), "--transport", transport, "--out", &out]).success();
        let summary = json(Path::new(&out).join("summary.json"));
        assert_eq!(summary["timing"]["deadline_misses"], 0, "{summary}");
        assert!(Path::new(&out).join("report.html").exists());
        logs.push(Path::new(&out).join("log.mcap"));
    }
    for log in &logs[1..] {
        run(["log".as_ref(), "diff".as_ref(), logs[0].as_os_str(), log.as_os_str()]).success();
    }
    let csv = path("log.csv");
    run(["log", "export", logs[0].to_str().unwrap(), "--output", &csv]).success();
    let text = std::fs::read_to_string(&csv).unwrap();
    let header: Vec<&str> = text.lines().next().expect("a header").split(',').collect();
    for name in outputs {
        let column = header.iter().position(|c| c.split('[').next() == Some(*name));
        let column = column.unwrap_or_else(|| panic!("no {name} in {header:?}"));
        let values = text.lines().skip(1).filter_map(|l| l.split(',').nth(column)?.parse::<f64>().ok());
        assert!(values.filter(|v| *v != 0.0).count() > 100, "{name} was measured");
    }
}

fn a_motor_flies() {
    flies(MOTOR, "law = \"lqr\"\nq = { angle = 100.0 }", &["encoder", "shunt"]);
}

/// Parameters and figures carry the units that follow from the units of their signals.
fn what_is_said_of_a_motor_carries_its_units() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().expect("utf-8 path").to_string();
    let speed = "free = [{ entry = \"A[1,1]\", lower = -9.0, upper = 0.0 }, { entry = \"B[2,1]\", lower = 1.0, upper = 999.0 }]\n\
                 name = \"motor\"\nA = [[-4.0, 30.0], [-2.0, -50.0]]\nB = [[0.0], [200.0]]\nC = [[0.0, 1.0]]\n\
                 states = [{ name = \"spin\", unit = \"rad/s\" }, { name = \"current\", unit = \"A\" }]\n\
                 inputs = [{ name = \"voltage\", unit = \"V\", lower = -12.0, upper = 12.0 }]\n\
                 outputs = [{ name = \"shunt\", unit = \"A\", noise = 0.01 }]\n";
    std::fs::write(path("motor.toml"), speed).unwrap();
    let designed = run(["design", &path("motor.toml"), "--law", "lqr"]).success().stdout;
    assert!(designed.contains("2 states and 1 input,"), "{designed}");
    let excited =
        run(["excite", &path("motor.toml"), "--duration", "1 min", "--out", &path("test")]).success();
    let unit = |name: &str| excited.stdout.lines().find(|l| l.starts_with(name)).map(str::to_string);
    assert!(unit("A[1,1]").is_some_and(|l| l.ends_with(" 1/s")), "{}", excited.stdout);
    assert!(unit("B[2,1]").is_some_and(|l| l.ends_with(" A/s per V")), "{}", excited.stdout);
    let flight = path("test/flight.toml");
    let more = ["--mode", "lockstep", "--transport", "inproc", "--out", &path("log")];
    run(["run", &flight].into_iter().chain(more)).success();
    let page = std::fs::read_to_string(path("log/report.html")).unwrap();
    assert!(page.contains("shunt, A") && page.contains("voltage, V"), "units in both tables of figures");
}

fn the_documented_example_flies() {
    flies(&documented(), "law = \"ppc\"\nbandwidth = 4.0", &["position"]);
}

fn what_a_bench_cannot_carry_is_told_before_anything_starts() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().expect("utf-8 path").to_string();
    let n = 33;
    let states: Vec<_> = (0..n).map(|i| format!("{{ name = \"x{i}\" }}")).collect();
    let row = |i: usize| {
        format!("[{}]", (0..n).map(|j| if i == j { "-1.0" } else { "0.0" }).collect::<Vec<_>>().join(","))
    };
    let a: Vec<_> = (0..n).map(row).collect();
    let b = vec!["[1.0]"; n].join(",");
    let outputs: Vec<_> = (0..n).map(|i| format!("[[outputs]]\nname = \"x{i}\"\n")).collect();
    let text = format!(
        "A = [{}]\nB = [{b}]\nstates = [{}]\ninputs = [{{ name = \"u\" }}]\n{}",
        a.join(","),
        states.join(","),
        outputs.concat()
    );
    let file = path("large.toml");
    std::fs::write(&file, text).unwrap();
    let check = run(["vehicle", "check", &file]).success();
    assert!(check.stdout.contains("valid") && check.stdout.contains("at most 32"), "{}", check.stdout);
    std::fs::write(path("launch.toml"), format!("vehicle = {file:?}\n[controller]\nlaw = \"lqr\"\n"))
        .unwrap();
    let out = path("out");
    let end = run(["run", &path("launch.toml"), "--out", &out]);
    assert_eq!(end.code(), 2, "{}", end.stderr);
    assert!(
        end.stderr.contains("cannot fly on a bench") && !end.stderr.contains("summary"),
        "{}",
        end.stderr
    );
    assert!(!Path::new(&out).exists(), "nothing was started");
}

whirlstand_test_harness::listed!(
    a_motor_flies,
    what_is_said_of_a_motor_carries_its_units,
    the_documented_example_flies,
    what_a_bench_cannot_carry_is_told_before_anything_starts,
);
