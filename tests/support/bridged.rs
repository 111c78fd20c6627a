//! The launch file of a vehicle behind a bridge.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{json, run};

/// The parts in which these launch files differ.
pub struct Bridged<'a> {
    /// `bridge` of the plant's node, and the table of its link.
    pub bridge: &'a str,
    pub vehicle: &'a str,
    pub rate_hz: u32,
    pub duration_s: u32,
    /// Keys of `[bridge.safety]`.
    pub safety: &'a str,
    pub link: String,
    /// Further keys of the bridge's table, and tables behind it.
    pub more: &'a str,
}

impl Bridged<'_> {
    /// Writes the launch file as `bridge.toml`. Keys of `more` begin in line 17.
    pub fn write(&self, dir: &Path) -> PathBuf {
        let Self { bridge, vehicle, rate_hz, duration_s, safety, link, more } = self;
        let text = format!(
            r#"vehicle = {vehicle:?}
rate_hz = {rate_hz}.0
duration_s = {duration_s}.0

[controller]
law = "lqr"

[nodes.plant]
bridge = "{bridge}"

[bridge.safety]
command_timeout_s = 5.0       # a busy test machine is not what is tested
max_innovation = 1e9          # most vehicles here fly a wave that obeys nobody, or are pushed
{safety}
[bridge.{bridge}]
link = "{link}"
{more}
"#
        );
        let path = dir.join("bridge.toml");
        std::fs::write(&path, text).unwrap();
        path
    }
}

/// Setpoint steps of both angles in turn, over a minute and a half.
pub fn setpoints() -> String {
    let step = |k: u32| {
        let (roll, pitch) = ([6, -4, 0, 5, -6][k as usize % 5], [0, 5, -6, 4][k as usize % 4]);
        format!(
            "[[setpoint]]\nat_s = {}\nroll = \"{roll} deg\"\npitch = \"{pitch} deg\"\n",
            1.3 * f64::from(k)
        )
    };
    (1..70).map(step).collect()
}

/// What is told of a record that was flown in parts by others. A moment in which a busy machine was late is a part too.
const NOTHING_ELSE: &str = "stretches; nothing else is used";

/// The record `out` of the paper's quadrotor has two stretches flown by the controller and one by a pilot in
/// between, in which the vehicle was pushed. The pilot's stretch is not used, and the user is told.
pub fn what_the_controller_flew_alone_is_learned_from(out: &str, vehicle: &str, structure: &str) {
    let answer = Path::new(out).with_extension("json");
    let told = ["--json", answer.to_str().unwrap()];
    let identified = run(["identify", out, "--vehicle", structure].iter().chain(&told)).success();
    assert!(identified.stderr.contains(NOTHING_ELSE), "{}", identified.stderr);
    let parameters = json(&answer)["parameters"].clone();
    let gain = parameters.as_array().unwrap().iter().find(|p| p["name"] == "B[2,1]").unwrap();
    let value = gain["value"].as_f64().unwrap();
    assert!((-1.5..-0.8).contains(&value), "-1.1045 in truth: {gain}\n{}", identified.stdout);

    // The simulation follows the first stretch under the inputs that acted; a free run does not survive the gap.
    let compared = run(["compare", out, "--vehicle", vehicle, "--to", "14"].iter().chain(&told)).success();
    assert!(compared.stderr.contains(NOTHING_ELSE), "{}", compared.stderr);
    println!("{}", compared.stdout);
    for axis in ["roll", "pitch"] {
        let fit = json(&answer)["outputs"][axis]["fit"].as_f64();
        assert!(fit.is_some_and(|percent| percent > 80.0), "{axis}: {fit:?}\n{}", compared.stdout);
    }

    // The results found by then are enough here.
    let diagnosed = run(["diagnose", out, "--vehicle", vehicle, "--budget", "30 s"].iter().chain(&told));
    assert!([0, 3].contains(&diagnosed.code()), "{}", diagnosed.stderr);
    assert!(diagnosed.stderr.contains(NOTHING_ELSE), "{}", diagnosed.stderr);
    println!("{}", diagnosed.stdout);
    let causes = json(&answer)["causes"].clone();
    // The push is a pulse. The delay of a busy machine's frames may be periodic, and that is in the record.
    let pushes = ["step_disturbance", "pulse_disturbance"];
    let pushed = |cause: &Value| pushes.contains(&cause["effect"].as_str().unwrap());
    assert!(!causes.as_array().unwrap().iter().any(pushed), "{}", diagnosed.stdout);
}
