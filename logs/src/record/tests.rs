use super::*;

fn record() -> Record {
    let mut record = Record::new("test.csv", vec![0.0, 0.5, 1.0, 1.5]).unwrap();
    record.push("roll", "rad", vec![1.0, 2.0, 3.0, 4.0]).unwrap();
    record.push("/imu.pitch", "rad", vec![0.0; 4]).unwrap();
    record
}

#[test]
fn a_missing_signal_names_what_there_is_and_what_was_meant() {
    let text = record().signal("rol").unwrap_err().to_string();
    assert_eq!(
        text,
        "test.csv has no signal 'rol' (did you mean 'roll'?). It has: roll, /imu.pitch. Use --map rol=NAME[unit] to say which one it is."
    );
    assert!(record().signal("pitch").unwrap_err().to_string().contains("mean '/imu.pitch'?"));
    assert!(!record().signal("u_thrust").unwrap_err().to_string().contains("did you mean"));
}

#[test]
fn a_part_keeps_its_time() {
    let part = record().between(0.4, 1.0);
    assert_eq!(part.time, [0.5, 1.0]);
    assert_eq!(part.signal("roll").unwrap().values, [2.0, 3.0]);
    assert!(record().between(7.0, 3.0).is_empty());
    assert_eq!(record().duration(), 1.5);
}

#[test]
fn mappings_rename_what_is_there() {
    let maps: Vec<Mapping> =
        ["pitch=-/imu.pitch", "heel=roll[deg]"].iter().map(|m| m.parse().unwrap()).collect();
    let mapped = record().mapped(&maps).unwrap();
    assert_eq!(mapped.names(), ["pitch", "heel"]);
    assert_eq!(mapped.signal("heel").unwrap().values[1], 2f64 * (std::f64::consts::PI / 180.0));
}

#[test]
fn a_length_is_no_angle() {
    let mut record = record();
    record.push("bare", "", vec![0.0; 4]).unwrap();
    let (rad, m): (Unit, Unit) = ("rad".parse().unwrap(), "m".parse().unwrap());
    let record = record.expecting([("roll", &m), ("/imu.pitch", &rad), ("bare", &m), ("absent", &m)]);
    assert_eq!(record.names(), ["/imu.pitch", "bare"]);
    let text = record.signal("roll").unwrap_err().to_string();
    assert!(text.starts_with("signal 'roll' of test.csv is in rad, but m is expected"), "{text}");
}

#[test]
fn inconsistent_signals_are_refused() {
    let mut record = record();
    assert!(matches!(record.push("roll", "", vec![0.0; 4]), Err(RecordError::Duplicate { .. })));
    assert!(matches!(record.push("yaw", "", vec![0.0; 3]), Err(RecordError::Length { found: 3, .. })));
    for time in [vec![0.0, 0.0], vec![0.0, 1.0, 0.5], vec![f64::NAN], vec![0.0, f64::INFINITY]] {
        assert!(matches!(Record::new("x", time), Err(RecordError::Time { .. })));
    }
}
