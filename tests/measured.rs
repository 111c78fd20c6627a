//! Measured data goes in with its units, and comes out compared.

mod support;

use support::{data, json, run};

#[test]
fn a_real_stick_record_drives_the_helicopter_and_is_compared_with_what_was_measured() {
    let Some(data) = data() else { return };
    let record = data.join("trex550/hover.csv");
    let dir = tempfile::tempdir().unwrap();
    let simulated = dir.path().join("simulated.csv");
    let comparison = dir.path().join("comparison.json");
    let inputs = ["--map", "u_roll=in_lat", "--map", "u_pitch=in_lon"];
    let outputs = [
        "--map",
        "roll=phi",
        "--map",
        "pitch=theta",
        "--map",
        "roll_rate=p",
        "--map",
        "pitch_rate=q",
        "--map",
        "longitudinal_speed=u",
        "--map",
        "lateral_speed=v",
    ];
    run(["simulate", "helicopter-hover", "--input"]
        .into_iter()
        .chain([record.to_str().unwrap(), "--output", simulated.to_str().unwrap()])
        .chain(inputs))
    .success();
    let rows = std::fs::read_to_string(&simulated).unwrap().lines().count();
    assert!(rows > 8000, "85.9 s at 100 Hz give about 8590 rows, not {rows}");

    run([
        "compare",
        record.to_str().unwrap(),
        "--vehicle",
        "helicopter-hover",
        "--json",
        comparison.to_str().unwrap(),
    ]
    .into_iter()
    .chain(["--out", dir.path().to_str().unwrap()])
    .chain(inputs)
    .chain(outputs))
    .success();
    let comparison = json(comparison);
    assert_eq!(comparison["schema"], "whirlstand.comparison.v1");
    for output in ["roll", "pitch", "roll_rate", "pitch_rate", "longitudinal_speed", "lateral_speed"] {
        let fit = comparison["outputs"][output]["fit"].as_f64().expect("a fit for every measured output");
        assert!(fit.is_finite() && fit < 60.0, "{output}: another helicopter's model cannot fit {fit} %");
    }
    assert!(dir.path().join("report.html").is_file());
}

#[test]
fn a_signal_that_the_log_does_not_have_is_answered_with_those_it_has() {
    let Some(data) = data() else { return };
    let record = data.join("trex550/hover.csv");
    let result =
        run(["compare", record.to_str().unwrap(), "--vehicle", "helicopter-hover", "--map", "roll=phy"]);
    assert_eq!(result.code(), 2, "{}", result.stderr);
    for word in ["hover.csv", "phy", "phi", "theta"] {
        assert!(result.stderr.contains(word), "{word} is missing in: {}", result.stderr);
    }
}
