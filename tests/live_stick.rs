//! The stick on the live page, in a real browser. A separate test program, because a browser that shares the processors
//! with others occasionally falls silent and thus releases the stick.

use std::time::Instant;

use crate::support::HUNG;
use crate::support::bench::unique;
use crate::support::devtools::Page;
use crate::support::page::{control, live_bench};
use serde_json::json;
use tempfile::TempDir;
use whirlstand_test_harness::{Outcome, browser};

/// Simulates a browser's gamepad as seen by its page.
fn plug_in(page: &mut Page, axes: [f64; 4]) {
    page.value(&format!(
        "Object.defineProperty(navigator, 'getGamepads', {{ configurable: true, value: () => [null, {{ connected: true, axes: {axes:?} }}] }})"
    ));
}

/// A gamepad moves the stick, but not within its dead band; unplugging it releases the stick.
fn a_gamepad_flies_the_bench_until_it_is_unplugged() -> Outcome {
    let browser = browser()?;
    let dir = TempDir::new().unwrap();
    let (bench, url) = live_bench(&unique("live-gamepad"), dir.path());
    let mut page = Page::open(&browser, &url);
    page.wait_for("document.body.dataset.state === 'flying' && Number(document.body.dataset.rows) > 100");
    // The right stick is half way to the right, and as little down as a stick at rest.
    plug_in(&mut page, [0.0, 0.0, 0.5, 0.05]);
    let take = "controls.stick.hand !== null || (document.querySelector('#stick-armed').checked = true, controls.stick.takeOver())";
    // 20 * 0.25 * 0.5, and zero; on an overloaded machine the page may have fallen silent, and takes over again.
    let moved = "['u.u_roll', 'u.u_pitch'].every((u, i) => store.values.get(u).slice(-10).every((v) => Math.abs(v - [2.5, 0][i]) < 0.1))";
    let until = Instant::now() + HUNG;
    loop {
        page.value(take);
        if page.value(&format!("new Promise((done) => setTimeout(() => done({moved}), 300))")) == true {
            break;
        }
        assert!(Instant::now() < until, "the gamepad never moves the stick");
    }
    page.value(
        "Object.defineProperty(navigator, 'getGamepads', { configurable: true, value: () => [null] })",
    );
    page.wait_for("controls.stick.hand === null && !document.querySelector('#stick-armed').checked");
    page.wait_for("store.values.get('u.u_roll').slice(-10).every((v) => Math.abs(v - 2.5) > 0.1)");
    let (code, text) = control(&url, r#"{"do":"stop"}"#);
    assert_eq!(code, "200", "{text}");
    bench.finish().success();
    Ok(())
}

/// A pointer on the stick of one page flies the bench while another viewer watches; the page closes, and the law flies
/// again.
fn a_stick_is_taken_over_on_the_page_and_given_back_by_its_silence() -> Outcome {
    let browser = browser()?;
    let dir = TempDir::new().unwrap();
    let name = unique("live-stick");
    let (bench, url) = live_bench(&name, dir.path());
    let mut page = Page::open(&browser, &url);
    page.wait_for("document.body.dataset.state === 'flying' && Number(document.body.dataset.rows) > 100");
    let take = "document.querySelector('#form-stick button')";
    assert_eq!(page.value(&format!("{take}.disabled")), true, "it is armed first");
    page.value("document.querySelector('#stick-armed').click()");
    page.value(&format!("{take}.click()"));
    page.wait_for("document.querySelector('#answer.good').textContent.startsWith('you have the stick')");
    let (code, text) = control(&url, r#"{"do":"stick","hand":5,"at":{"u_roll":0.1}}"#);
    assert!(
        code == "422" && text.contains("you do not have the stick"),
        "another viewer has no stick: {code} {text}"
    );

    // A quarter of the way to the right, of 25 % of the input's range: 20 * 0.25 * 0.25.
    page.value("document.querySelector('#stick-pad').scrollIntoView({ block: 'center' })");
    let place = "[0.625, 0.5].map((part, i) => { const b = document.querySelector('#stick-pad').getBoundingClientRect(); \
                 return i ? b.top + b.height * part : b.left + b.width * part; })";
    let at = page.value(place);
    let (x, y) = (at[0].as_f64().expect("a number"), at[1].as_f64().expect("a number"));
    let until = Instant::now() + HUNG;
    loop {
        page.mouse("mousePressed", x, y);
        // The law never holds its command constant.
        let moved = "store.values.get('u.u_roll').slice(-10).every((u) => Math.abs(u - 1.25) < 0.1)";
        if page.value(&format!("new Promise((done) => setTimeout(() => done({moved}), 300))")) == true {
            break;
        }
        assert!(Instant::now() < until, "the stick never moves");
        // On an overloaded machine the page may have fallen silent, and the law flies: the page takes over again.
        page.mouse("mouseReleased", x, y);
        page.value(
            "controls.stick.hand !== null || (document.querySelector('#stick-armed').checked = true, controls.stick.takeOver())",
        );
    }
    page.wait_for("document.querySelector('#events').textContent.includes('stick taken over')");

    // The browser closes while it holds the stick, and sends nothing any more.
    drop(page);
    let is_free = |hand: u32| control(&url, &json!({ "do": "take", "hand": hand }).to_string()).0 == "200";
    let hand = (1000..).find(|hand| is_free(*hand)).expect("it is given back");
    let (code, text) = control(&url, &json!({ "do": "give", "hand": hand }).to_string());
    assert_eq!(code, "200", "{text}");
    let (code, text) = control(&url, r#"{"do":"stop"}"#);
    assert_eq!(code, "200", "{text}");
    bench.finish().success();
    let log = whirlstand_logs::Log::open(dir.path()).unwrap();
    let commands: Vec<_> = log.messages::<whirlstand_msgs::Command>().unwrap().map(Result::unwrap).collect();
    let by_hand = |c: &&whirlstand_msgs::Command| c.flags & whirlstand_msgs::flags::MANUAL != 0;
    let last = commands.iter().rfind(by_hand).expect("it flew by hand");
    let end = commands.last().unwrap().head.step;
    let moved = commands.iter().filter(by_hand).filter(|c| (c.u[0] - 1.25).abs() < 0.1).count();
    assert!(
        moved > 0 && last.head.step < end,
        "{moved} steps as the pointer was, by hand until {} of {end}",
        last.head.step
    );
    Ok(())
}

whirlstand_test_harness::listed_one_at_a_time!(
    "a browser that holds the stick":
    a_stick_is_taken_over_on_the_page_and_given_back_by_its_silence,
    a_gamepad_flies_the_bench_until_it_is_unplugged
);
