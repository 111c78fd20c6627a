//! Flights with a mirror behind a link.

use serde_json::Value;

/// Asserts that half of the input is named, and that nothing is named before `earliest_s`. If a busy machine stops a
/// process, a prediction can be wrong before, without a name.
pub fn half_of_the_input_is_named(findings: &[Value], earliest_s: f64, said: &str) {
    let cause = "input_gain on u_roll: factor ";
    let named = |f: &&Value| {
        let text = f["text"].as_str().unwrap();
        !text.ends_with("looking for the cause") && !text.contains("right again")
    };
    let first = findings.iter().find(named).unwrap_or_else(|| panic!("nothing was named: {said}"));
    assert!(first["at_s"].as_f64().unwrap() > earliest_s, "{findings:?}\n{said}");
    let text = |f: &Value| f["text"].as_str().unwrap().to_owned();
    let size = findings.iter().map(text).find_map(|t| t.split(cause).nth(1).map(str::to_string));
    let factor: f64 = size.and_then(|t| t.split(' ').next()?.parse().ok()).unwrap_or(f64::NAN);
    assert!((0.4..0.6).contains(&factor), "{findings:?}");
}
