//! The pages that commands write, as a browser shows them: every plot is drawn, nothing is loaded, nothing overflows a
//! phone.

use std::path::Path;
use std::process::Command;

use crate::support::devtools::Page;
use crate::support::{run, spawn};
use tempfile::TempDir;
use whirlstand_test_harness::{Outcome, browser};

/// Flies a launch file; returns the run's folder.
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

/// Number of plots of the page, all of which the browser must have drawn.
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
    // Four outputs, two inputs, four spectra and spectrograms of rates and inputs, and five plots of the estimator; a
    // bench in one process has no waiting times.
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
    assert!(refused.code() == 2 && refused.stderr.contains("omit it"), "{}", refused.stderr);
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

fn a_campaign_is_drawn_in_the_units_of_its_vehicle() -> Outcome {
    let dir = TempDir::new().unwrap();
    let (file, out) = (dir.path().join("gusts.toml"), dir.path().join("out"));
    let text = "launch = 'quadrotor'\nflights = 8\nmethod = 'random'\n[[vary]]\nkey = 'effects.0.magnitude'\n\
                uniform = ['100 deg/s^2', '200 deg/s^2']\n";
    std::fs::write(&file, text).unwrap();
    run(["campaign", file.to_str().unwrap(), "--out", out.to_str().unwrap()]).success();
    let dom = drawn(&out.join("report.html"))?;
    assert!(plots(&dom) >= 3, "the share, a figure with a limit, and what moves it");
    assert!(dom.contains(">roll.peak, deg<") && !dom.contains(">roll.peak, rad<"), "the axis has the unit");
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

/// Width of a phone held upright, px.
const PHONE: u32 = 390;

/// Loads a page on a phone: returns its width, and the elements that extend beyond the screen, except those in
/// scrolling boxes and in plots.
fn on_a_phone(page: &mut Page, place: &str) -> (u64, String) {
    page.visit(&format!("file://{place}"));
    page.wait_for(&format!(
        "location.pathname == '{place}' && document.readyState == 'complete' && \
         document.querySelectorAll('[id^=plot-]').length == document.querySelectorAll('.js-plotly-plot').length"
    ));
    let wide = format!(
        "[...document.querySelectorAll('body *')].filter((e) => e.getBoundingClientRect().right > {PHONE} + 1 && \
         !e.parentElement.closest('.scroll, pre, .plot')).map((e) => e.tagName + ' ' + e.className).join()"
    );
    let width = page.value("document.documentElement.scrollWidth").as_u64().unwrap();
    (width, page.value(&wide).as_str().unwrap().into())
}

/// Uses names that are wider than any phone.
fn every_page_fits_a_phone() -> Outcome {
    let browser = browser()?;
    let dir = TempDir::new().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let long = "a_name_that_is_much_longer_than_any_phone_is_wide";
    let quadrotor = run(["vehicle", "show", "quadrotor"]).success().stdout;
    let (vehicle, launch, campaign) =
        (path("vehicle.toml"), path(&format!("{long}.toml")), path(&format!("campaign_{long}.toml")));
    let named = quadrotor.replace("name = \"quadrotor\"", &format!("name = \"{long}\""));
    assert!(named.contains(long));
    std::fs::write(&vehicle, named).unwrap();
    let bench = "vehicle = 'vehicle.toml'\nmode = 'lockstep'\nrate_hz = 100\nduration_s = 12\n[controller]\nlaw = 'lqr'\n\
                 [[effects]]\neffect = 'pulse_disturbance'\nwhere = 'roll_rate'\nat_s = 4\nduration_s = 0.5\n\
                 magnitude = '100 deg/s^2'\n";
    std::fs::write(&launch, bench).unwrap();
    let varied = "flights = 8\nmethod = 'random'\n[[vary]]\nkey = 'effects.0.magnitude'\n\
                  uniform = ['100 deg/s^2', '200 deg/s^2']\n";
    std::fs::write(&campaign, format!("launch = '{long}.toml'\n{varied}")).unwrap();
    let (flown, other) = (path("run"), path("other"));
    for (out, law) in [(&flown, "lqr"), (&other, "ppc")] {
        let law = format!("controller.law='{law}'");
        run(["run", &launch, "--transport", "inproc", "--set", &law, "--out", out]).success();
    }
    for (page, args) in [
        ("compared", &["compare", &flown, &other][..]),
        ("against", &["compare", &flown, "--vehicle", &vehicle]),
        ("identified", &["identify", &flown, "--vehicle", &vehicle]),
        ("diagnosed", &["diagnose", &flown, "--vehicle", &vehicle]),
        ("tuned", &["tune", &flown, "--launch", &launch, "--draws", "20"]),
        ("campaign", &["campaign", &campaign]),
        ("designed", &["design", &vehicle, "--law", "smc"]),
    ] {
        run(args.iter().chain(&["--out", &path(page)])).success();
    }
    let mut phone = Page::open(&browser, "about:blank");
    let size = serde_json::json!({ "width": PHONE, "height": 844, "deviceScaleFactor": 2, "mobile": true });
    phone.emulate("setDeviceMetricsOverride", size);
    let pages = ["run", "compared", "against", "identified", "diagnosed", "tuned", "campaign", "designed"];
    for page in pages {
        let (width, wide) = on_a_phone(&mut phone, &path(&format!("{page}/report.html")));
        assert!(width <= PHONE.into() && wide.is_empty(), "{page} is {width} px wide: {wide}");
    }
    Ok(())
}

whirlstand_test_harness::listed!(
    a_campaign_is_drawn_in_the_units_of_its_vehicle,
    every_page_fits_a_phone,
    a_run_is_drawn_plots_first,
    runs_are_compared_and_the_best_is_named,
    a_design_is_drawn,
    a_run_that_failed_says_why_first_and_draws_nothing_empty
);
