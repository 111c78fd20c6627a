//! The pages that commands leave, as a browser shows them: every plot is drawn, nothing is loaded, nothing overflows a phone.

mod support;

use std::path::Path;
use std::process::Command;

use support::{run, spawn};
use tempfile::TempDir;
use whirlstand_test_harness::{Outcome, browser};

/// The folder of a flight below `folder`.
fn flown(folder: &Path, launch: &str) -> String {
    let out = folder.join(launch).display().to_string();
    run(["run", launch, "--mode", "lockstep", "--transport", "inproc", "--out", &out]).success();
    out
}

/// The page's elements after its scripts have run.
fn drawn(page: &Path) -> Result<String, whirlstand_test_harness::Missing> {
    let profile = tempfile::tempdir().unwrap();
    let mut command = Command::new(browser()?);
    command
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"])
        .args(["--disable-background-networking", "--disable-component-update", "--disable-sync"])
        .args(["--virtual-time-budget=20000", "--dump-dom"])
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .arg(format!("file://{}", page.display()));
    Ok(spawn(command).finish().success().stdout)
}

/// How many plots the page has, all of which the browser must have drawn.
#[track_caller]
fn plots(dom: &str) -> usize {
    let wanted = dom.matches("id=\"plot-").count();
    assert_eq!(dom.matches("class=\"plot js-plotly-plot\"").count(), wanted, "plots that are drawn");
    let complaint = dom.split("id=\"undrawn\"").nth(1).and_then(|rest| rest.split('>').next()).unwrap();
    assert!(complaint.contains("hidden"), "the page says that its plots could not be drawn");
    wanted
}

fn before(page: &str, first: &str, second: &str) -> bool {
    matches!((page.find(first), page.find(second)), (Some(a), Some(b)) if a < b)
}

fn a_run_is_drawn_plots_first() -> Outcome {
    let dir = TempDir::new().unwrap();
    let out = flown(dir.path(), "quadrotor");
    let dom = drawn(&Path::new(&out).join("report.html"))?;
    // Four outputs, two inputs, four spectra and spectrograms of rates and inputs, the estimator's five; in one process nobody
    // waits for answers.
    assert_eq!(plots(&dom), 4 + 2 + 4 + 4 + 5);
    assert!(before(&dom, "id=\"plot-output-0\"", "<table"), "the first screen has a plot");
    assert!(dom.contains("class=\"heatmaplayer") && dom.contains("href=\"./log.mcap\""));
    assert!(dom.contains("disturbance of 150 deg/s² on roll_rate"), "events are listed with their units");
    Ok(())
}

fn runs_are_compared_and_the_best_is_named() -> Outcome {
    let dir = TempDir::new().unwrap();
    let [smc, lqr] = ["quadrotor", "quadrotor-lqr"].map(|launch| flown(dir.path(), launch));
    let out = dir.path().join("both").display().to_string();
    let said = run(["compare", &smc, &lqr, "--out", &out]).success().stdout;
    assert!(
        said.starts_with("quadrotor-lqr is best in ") && said.contains("moves its inputs least"),
        "{said}"
    );
    let dom = drawn(&dir.path().join("both/report.html"))?;
    assert_eq!(plots(&dom), 4 + 2 + 4 + 5, "no spectrogram of several runs");
    assert!(before(&dom, "quadrotor-lqr is best in ", "</header>"));
    let refused = run(["compare", &smc, &lqr, "--vehicle", "quadrotor"]);
    assert!(refused.code() == 2 && refused.stderr.contains("leave it out"), "{}", refused.stderr);
    let refused = run(["compare", &smc]);
    assert!(refused.code() == 2 && refused.stderr.contains("--vehicle V"), "{}", refused.stderr);
    Ok(())
}

fn a_design_is_drawn() -> Outcome {
    let dir = TempDir::new().unwrap();
    for law in ["smc", "ppc"] {
        let out = dir.path().join(law);
        run(["design", "helicopter-hover", "--law", law, "--out", out.to_str().unwrap()]).success();
        let dom = drawn(&out.join("report.html"))?;
        assert!(plots(&dom) >= 6, "steps, inputs, gain, phase, sensitivity and poles");
        assert!(dom.contains("peak sensitivity") && dom.contains("id=\"plot-poles\""));
    }
    Ok(())
}

fn a_run_that_failed_says_why_first_and_draws_nothing_empty() -> Outcome {
    let dir = TempDir::new().unwrap();
    let out = dir.path().join("out");
    let dead = "nodes.controller.exec=[\"false\"]";
    let end = run(["run", "quadrotor", "--set", dead, "--out", out.to_str().unwrap()]);
    assert_eq!(end.code(), 1, "{}", end.stderr);
    let dom = drawn(&out.join("report.html"))?;
    let header = dom.split("</header>").next().unwrap();
    assert!(header.contains("quadrotor failed: controller ended with exit code 1"), "{header}");
    assert_eq!(plots(&dom), 0);
    Ok(())
}

whirlstand_test_harness::tests!(
    a_run_is_drawn_plots_first,
    runs_are_compared_and_the_best_is_named,
    a_design_is_drawn,
    a_run_that_failed_says_why_first_and_draws_nothing_empty
);
