//! Figures and report of recorded runs, from log files.

use whirlstand_evaluate::{Figure, Run, RunSummary};
use whirlstand_msgs::units::ShownUnit;
use whirlstand_report::{Expected, Outcome, run_report};

use crate::support::bench_log;

#[test]
fn a_log_gives_the_figures_of_its_run() {
    let folder = tempfile::tempdir().unwrap();
    let run = Run::open(bench_log(folder.path(), "stiff", 0.001), "stiff", None).unwrap();
    let s = run.figures;
    assert_eq!((s.seed, s.mode.as_str(), s.period_s), (1, "lockstep", 0.005));
    assert_eq!(s.disturbances.len(), 1, "{:?}", s.disturbances);
    let event = &s.disturbances[0];
    assert!((event.at_s - 6.0).abs() < 1e-9 && (event.until_s - 6.2).abs() < 0.006, "{event:?}");
    assert_eq!((event.place.as_str(), event.magnitude), ("roll_rate", 3.0));

    let roll = &s.outputs["roll"];
    assert!(roll.tracked && !s.outputs["pitch"].tracked && roll.source == "truth");
    assert_eq!(roll.steps.len(), 1, "{:?}", roll.steps);
    let step = &roll.steps[0];
    assert!((step.at_s - 1.0).abs() < 1e-9 && (step.until_s - 6.0).abs() < 0.006, "{step:?}");
    assert!((step.to - 5f64.to_radians()).abs() < 1e-12);
    // The same loop without noise, integrated on its own (SciPy expm, LQR by solve_continuous_are, one step late):
    // its poles are -8.91, -1.28 and -0.62 +- 1.01i, so it settles as slowly as this.
    assert!((roll.rise_s.unwrap() - 1.535).abs() < 0.02, "{step:?}");
    assert!((roll.settling_s.unwrap() - 3.99).abs() < 0.05, "{step:?}");
    assert!((roll.overshoot_percent.unwrap() - 9.29).abs() < 0.5, "{step:?}");
    let recovery = &roll.disturbances[0];
    assert!(
        (recovery.peak - 0.2666).abs() < 0.003 && (recovery.peak_after_s - 1.11).abs() < 0.03,
        "{recovery:?}"
    );
    assert!((roll.recovery_s.unwrap() - 5.72).abs() < 0.05, "{recovery:?}");
    assert_eq!(s.figure("roll.peak"), Some(Figure::Value(recovery.peak)));
    assert_eq!(s.figure("pitch.rise_s"), Some(Figure::NoEvent));
    assert_eq!(s.figure("roll.nonsense"), None);

    assert_eq!((s.timing.held_steps, s.timing.deadline_misses), (3, 3));
    let latency = s.timing.nodes["plant"].latency.unwrap();
    assert!(latency.p50_us > 40.0 && latency.p50_us < 71.0 && latency.max_us < 80.0, "{latency:?}");
    let effort = &s.inputs["u_roll"];
    assert!(effort.rms > 3.0 && effort.travel_per_s > 0.0 && effort.saturated == 0.0, "{effort:?}");
    let json = serde_json::to_value(&s).unwrap();
    assert_eq!(serde_json::from_value::<RunSummary>(json).unwrap(), s);
}

#[test]
fn a_softer_loop_is_moved_further() {
    let folder = tempfile::tempdir().unwrap();
    let peak = |name: &str, effort: f64| {
        let run = Run::open(bench_log(folder.path(), name, effort), name, None).unwrap();
        run.figures.outputs["roll"].peak.unwrap()
    };
    assert!(peak("soft", 1.0) > 1.5 * peak("stiff", 1e-4));
}

#[test]
fn reports_of_one_and_of_several_runs_are_complete_and_small() {
    let folder = tempfile::tempdir().unwrap();
    let runs: Vec<Run> = [("stiff", 1e-4), ("medium", 1e-2), ("soft", 1.0)]
        .iter()
        .map(|(name, effort)| Run::open(bench_log(folder.path(), name, *effort), name, None).unwrap())
        .collect();
    let all: Vec<&Run> = runs.iter().collect();
    let outcome = Outcome {
        verdict: "All runs completed.".into(),
        ok: Some(false),
        problems: vec!["roll.peak is 15.3 deg, above 10 deg".into()],
        expected: vec![Expected {
            run: "stiff".into(),
            key: "roll.peak".into(),
            limit: 10f64.to_radians(),
            found: Some(0.2666),
            unit: ShownUnit::of("rad"),
            holds: false,
        }],
        files: vec![("log.mcap".into(), "log.mcap".into())],
    };
    for (file, part) in [("run.html", &all[..1]), ("variants.html", &all[..])] {
        let html = run_report("quadrotor", "State feedback, softer and stiffer.", &outcome, part).unwrap();
        assert!(html.contains("class=\"verdict bad\"") && html.contains("15.3 deg ✕"));
        assert!(html.len() < 8_000_000, "{}", html.len());
        for text in
            ["All runs completed.", "peak after disturbance", "launch.toml", "roll estimate error", "Spectra"]
        {
            assert!(html.contains(text), "{text}");
        }
        std::fs::write(std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join(file), html).unwrap();
    }
}
