//! A bench is viewed in flight, and a log is played back, in a real browser, by programs that read what the page reads,
//! and by some that never read.

use std::io::Read;
use std::path::Path;

use crate::support::bench::{all_ready, unique};
use crate::support::devtools::Page;
use crate::support::page::{OPEN, control, frames_of, live_bench, page_of, read_until, request, status};
use crate::support::{refused, run, spawn, whirlstand};
use serde_json::{Value, json};
use tempfile::TempDir;
use whirlstand_test_harness::{Outcome, browser};

/// The plots of a quadrotor's page: four outputs, two inputs, four residuals and the innovations.
const PLOTS: usize = 4 + 2 + 4 + 1;

fn a_running_bench_is_shown_and_steered_from_two_browsers() -> Outcome {
    let browser = browser()?;
    let dir = TempDir::new().unwrap();
    let name = unique("live-page");
    let (bench, url) = live_bench(&name, dir.path());
    let mut page = Page::open(&browser, &url);
    page.wait_for("document.body.dataset.state === 'flying' && Number(document.body.dataset.rows) > 100");
    page.wait_for(&format!("document.querySelectorAll('.plot').length === {PLOTS}"));
    page.wait_for("document.querySelectorAll('#plot-output-roll path.js-line').length >= 3");
    page.wait_for("document.querySelectorAll('#nodes tr[data-node] .bars rect').length > 0");
    for node in ["plant", "estimator", "controller", "recorder"] {
        page.wait_for(&format!(
            "document.querySelector('tr[data-node={node}] td').textContent === 'running'"
        ));
    }

    // A gust from the page, and a setpoint beyond the limits of the vehicle.
    page.value("document.querySelector('#form-gust').requestSubmit()");
    page.wait_for("document.querySelector('#answer.good').textContent.startsWith('gust on roll_rate: 60')");
    page.wait_for("document.querySelector('#events').textContent.includes('gust on roll_rate: 60')");
    page.value("document.querySelector('#form-setpoint input').value = '1e9'");
    page.value("document.querySelector('#form-setpoint').requestSubmit()");
    page.wait_for("document.querySelector('#answer.bad').textContent.includes('beyond the limits')");

    // While paused, the plot shows the same interval and loses nothing; afterwards it continues.
    page.value("document.querySelector('#pause').click()");
    let shown = "document.querySelector('#plot-output-roll').layout.xaxis.range[1]";
    let (held, t) = (page.value(shown), page.value("Number(document.body.dataset.t)"));
    page.wait_for(&format!("Number(document.body.dataset.t) > {t} + 1"));
    let steps = "store.t.every((t, i) => i === 0 || t > store.t[i - 1])";
    assert_eq!((page.value(shown), page.value(steps)), (held.clone(), true.into()));
    page.value("document.querySelector('#follow').click()");
    page.wait_for(&format!("{shown} > {held}"));

    // A second viewer, on a phone in dark mode, sees the events from before it connected.
    let mut phone = Page::open(&browser, &url);
    let size = json!({ "width": 360, "height": 740, "deviceScaleFactor": 2, "mobile": true });
    phone.emulate("setDeviceMetricsOverride", size);
    let dark = json!({ "features": [{ "name": "prefers-color-scheme", "value": "dark" }] });
    phone.emulate("setEmulatedMedia", dark);
    phone.wait_for("document.querySelector('#events').textContent.includes('gust on roll_rate')");
    phone.wait_for("document.documentElement.scrollWidth <= 360");
    phone.wait_for("getComputedStyle(document.body).backgroundColor === 'rgb(17, 22, 29)'");
    phone.value("window.confirm = () => true");
    phone.value("document.querySelector('#form-run').requestSubmit()");
    for viewer in [&mut phone, &mut page] {
        viewer.wait_for("document.body.dataset.state === 'over'");
    }
    bench.finish().success();
    let info = run(["log", "info", dir.path().to_str().expect("utf-8 path")]).success();
    let adjusted = info.stdout.lines().find(|l| l.contains("/adjusted")).expect("answers are in the log");
    assert!(adjusted.contains(" 3 "), "the gust, the setpoint and the end: {adjusted}");
    Ok(())
}

/// Flies in lockstep with `viewers` clients that request frames and never read them; `page` is whether the page is
/// served.
#[track_caller]
fn flown_with_stalled_viewers(folder: &Path, viewers: usize, page: bool) -> String {
    let out = folder.join(format!("{viewers}-{page}")).display().to_string();
    let mut args = vec!["run", "quadrotor", "--mode", "lockstep", "--duration", "200", "--out", &out];
    if page {
        args.extend(["--live", "0"]);
    }
    let mut bench = spawn(whirlstand(args));
    let mut stalled = Vec::new();
    if page {
        let url = page_of(&mut bench);
        for _ in 0..viewers {
            let mut viewer = request(&frames_of(&url), "GET ", None);
            assert_eq!(status(&mut viewer), "200");
            stalled.push(viewer);
        }
    }
    bench.finish().success();
    let summary = crate::support::json(format!("{out}/summary.json"));
    assert_eq!(summary["runs"][0]["lost"].as_u64().unwrap_or(0), 0, "{summary}");
    out
}

fn viewers_that_never_read_change_nothing_in_the_log() {
    let dir = TempDir::new().unwrap();
    let alone = flown_with_stalled_viewers(dir.path(), 0, false);
    for viewers in [0, 1, 5] {
        let seen = flown_with_stalled_viewers(dir.path(), viewers, true);
        let diff = run(["log", "diff", &alone, &seen]);
        assert_eq!(diff.code(), 0, "{viewers} viewers: {}{}", diff.stdout, diff.stderr);
    }
}

fn watched(transport: &str) {
    let name = unique(&format!("live-watch-{transport}"));
    let args = ["run", "quadrotor", "--bench", &name, "--transport", transport, "--mode", "lockstep"];
    let dir = TempDir::new().unwrap();
    let out = ["--out", dir.path().to_str().expect("utf-8 path")];
    let more = ["--duration", "1000 h", "--no-log", "--log-level", "debug"];
    let mut bench = spawn(whirlstand(args.into_iter().chain(more).chain(out)));
    all_ready(&mut bench, ["plant", "estimator", "controller"]);
    let mut watch = spawn(whirlstand(["watch", &name, "--listen", "0"]));
    let url = page_of(&mut watch);
    let mut frames = request(&frames_of(&url), "GET ", None);
    let greeting = read_until(&mut frames, |frame| !frame["scene"].is_null());
    let columns = greeting["columns"].as_array().expect("names").clone();
    for name in ["y.roll", "e.roll", "s.roll", "u.u_roll", "nis"] {
        let column = columns.iter().position(|c| c == name).unwrap_or_else(|| panic!("{name}: {columns:?}"));
        let known = |frame: &Value| {
            let values = frame["rows"]["values"][column].as_array();
            values.is_some_and(|values| values.iter().any(Value::is_number))
        };
        read_until(&mut frames, known);
    }
    read_until(&mut frames, |frame| frame["nodes"].as_array().is_some_and(|nodes| nodes.len() >= 3));
    let (code, text) = control(&url, r#"{"do":"set","what":"gain=1.5"}"#);
    assert!(code == "422" && text.contains("controller.pilot=true"), "{code} {text}");
    bench.signal(libc::SIGTERM);
    assert_eq!(bench.finish().code(), 143);
    let over = read_until(&mut frames, |frame| !frame["over"].is_null());
    assert_eq!(over["over"], format!("bench {name} is over"));
    watch.finish().success();
}

fn a_bench_over_shared_memory_is_watched() {
    watched("iceoryx2");
}

fn a_bench_over_a_network_is_watched() {
    watched("zenoh");
}

fn a_bench_in_one_process_is_shown_by_that_process() {
    let dir = TempDir::new().unwrap();
    let out = dir.path().to_str().expect("utf-8 path");
    let args =
        ["run", "quadrotor", "--transport", "inproc", "--duration", "1 h", "--live", "0", "--out", out];
    let mut bench = spawn(whirlstand(args.into_iter().chain(OPEN)));
    let url = page_of(&mut bench);
    let mut frames = request(&frames_of(&url), "GET ", None);
    read_until(&mut frames, |frame| frame["rows"]["step"].as_array().is_some_and(|steps| steps.len() > 3));
    let (code, text) = control(&url, r#"{"do":"stop"}"#);
    assert_eq!(code, "200", "{text}");
    read_until(&mut frames, |frame| !frame["over"].is_null());
    let ended = bench.finish();
    assert!(ended.code() < 2, "{}", ended.stderr);
}

fn a_log_is_played_at_any_speed_and_from_any_place() -> Outcome {
    let browser = browser()?;
    let dir = TempDir::new().unwrap();
    let out = dir.path().to_str().expect("utf-8 path");
    run(["run", "quadrotor", "--mode", "lockstep", "--transport", "inproc", "--out", out]).success();
    let mut player = spawn(whirlstand(["play", out, "--listen", "0", "--speed", "20"]));
    let url = page_of(&mut player);
    let mut page = Page::open(&browser, &url);
    page.wait_for("store.last > 11.9");
    page.wait_for(
        "document.querySelector('#events').textContent.includes('disturbance of 150 deg/s^2 on roll_rate')",
    );
    assert_eq!(page.value("store.t.length"), 2400, "every step of 12 s at 200 Hz");
    let inside = "store.values.get('r.roll').filter((r, i) => Math.abs(r) < store.values.get('b.roll')[i]).length / 2400";
    let share = page.value(inside).as_f64().expect("a share");
    assert!((0.88..0.99).contains(&share), "{share} of the residual lies in the band of 95 %");
    page.value("controls.ask({ do: 'play', key: 'paused', value: 1 })");
    page.value("controls.ask({ do: 'play', key: 'place', value: 3 })");
    page.wait_for("Math.abs(store.last - 3) < 0.02 && store.t.length === 601");
    page.value("controls.ask({ do: 'play', key: 'speed', value: 1e9 })");
    page.wait_for("document.querySelector('#answer.bad').textContent.includes('0.01 to 1000')");
    player.signal(libc::SIGTERM);
    player.finish().success();
    page.wait_for("document.body.dataset.state === 'over'");
    Ok(())
}

fn only_who_knows_the_token_looks_from_another_machine() {
    let dir = TempDir::new().unwrap();
    let out = dir.path().to_str().expect("utf-8 path");
    let flight = ["run", "quadrotor", "--mode", "lockstep", "--duration", "1000 h", "--no-log", "--out", out];
    let mut bench = spawn(whirlstand(flight.into_iter().chain(["--live", "0.0.0.0:0"])));
    let url = page_of(&mut bench);
    let (base, token) = url.split_once("?token=").expect("a token");
    assert!(token.len() > 20, "{url}");
    let mut with = request(&url, "GET ", None);
    assert_eq!(status(&mut with), "200");
    let mut text = String::new();
    with.read_to_string(&mut text).unwrap();
    for loaded in ["src=", "href=", "url(", "@import", "https:"] {
        assert!(!text.contains(loaded), "the page loads nothing: {loaded}");
    }
    for address in [base.to_string(), format!("{base}?token=x"), format!("{base}events")] {
        assert_eq!(status(&mut request(&address, "GET ", None)), "403", "{address}");
    }
    bench.signal(libc::SIGTERM);
    assert_eq!(bench.finish().code(), 143);

    let mut bench = spawn(whirlstand(flight.into_iter().chain(["--live", "0"])));
    let url = page_of(&mut bench);
    assert_eq!(status(&mut request(&url, "GET ", None)), "200");
    assert_eq!(status(&mut request(&url, "GET ", Some("example.com"))), "403", "a borrowed name");
    let foreign =
        "POST Origin: http://example.com\r\nContent-Type: application/json\r\nContent-Length: 2\r\n\r\n{}";
    assert_eq!(status(&mut request(&format!("{url}control"), foreign, None)), "403", "another page");
    bench.signal(libc::SIGTERM);
    assert_eq!(bench.finish().code(), 143);
    refused(&["run", "--live", "nowhere"], &["nowhere", "192.0.2.2:8480"]);
    refused(&["watch", "no-such-bench"], &["no bench 'no-such-bench' of yours runs here"]);
    refused(&["play", "no-such-log.mcap"], &["no-such-log.mcap"]);
}

whirlstand_test_harness::listed!(
    a_running_bench_is_shown_and_steered_from_two_browsers,
    viewers_that_never_read_change_nothing_in_the_log,
    a_bench_over_shared_memory_is_watched,
    a_bench_over_a_network_is_watched,
    a_bench_in_one_process_is_shown_by_that_process,
    a_log_is_played_at_any_speed_and_from_any_place,
    only_who_knows_the_token_looks_from_another_machine
);
