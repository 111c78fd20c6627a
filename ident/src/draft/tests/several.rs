//! Drafts from several logs of one vehicle.

use super::*;

/// Manoeuvres of 1.5 s, each in a file of its own whose time begins anew: one is too short, all together are a record. Were
/// they taken for one flight, the rate would jump between them.
#[test]
fn short_flights_in_files_of_their_own_count_together() {
    const ROWS: usize = 150;
    let dir = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(flight(&dir, FIRST, true)).unwrap();
    let rows: Vec<&str> = text.lines().skip(1).collect();
    let write = |(k, part): (usize, &[&str])| {
        let path = dir.path().join(format!("part_{k}.csv"));
        let row = |(i, row): (usize, &&str)| {
            format!("{},{}\n", i as f64 * PERIOD_S, row.split_once(',').unwrap().1)
        };
        let body: String = part.iter().enumerate().map(row).collect();
        std::fs::write(&path, format!("t,u_roll,roll_rate[rad/s]\n{body}")).unwrap();
        path
    };
    let paths: Vec<PathBuf> = rows.chunks(ROWS).enumerate().map(write).collect();
    // Every second one: no piece continues in the next.
    let paths: Vec<&PathBuf> = paths.iter().step_by(2).collect();
    let names = Names { sha256: vec!["1f".into(); paths.len()], ..Names::default() };
    let alone = draft(&paths[..1], &names, (None, None), &|_| ()).unwrap_err();
    assert!(matches!(alone, DraftError::TooShort { .. }), "{alone}");
    let found = draft(&paths, &names, (None, None), &|_| ()).unwrap();
    assert_eq!(found.axes[0].words, "first order", "{}", found.text());
    assert!((parameter(&found, "A[1,1]") + 8.0).abs() < 1.5, "{}", found.text());
    assert!((parameter(&found, "B[1,1]") - 24.0).abs() < 3.0, "{}", found.text());
    assert_eq!(found.vehicle, "part_0");
    assert!(found.log.ends_with(&paths.last().unwrap().display().to_string()), "{}", found.log);
    let vehicle = Vehicle::parse(&found.toml, "several.toml").unwrap();
    let known = |key: &str| vehicle.provenance.iter().any(|(k, _)| k == key);
    assert!(known("log_20") && known("log_20_sha256") && !known("log_21"), "{}", found.toml);
}

#[test]
fn a_log_without_a_signal_of_the_first_is_refused_by_its_name() {
    let dir = tempfile::tempdir().unwrap();
    let whole = flight(&dir, FIRST, true);
    let other = dir.path().join("other.csv");
    std::fs::write(&other, "t,u_roll,height\n0,0,1\n0.01,1,1\n0.02,0,1\n").unwrap();
    let error = draft(&[&whole, &other], &Names::default(), (None, None), &|_| ()).unwrap_err().to_string();
    assert!(error.contains("other.csv") && error.contains("roll_rate"), "{error}");
}
