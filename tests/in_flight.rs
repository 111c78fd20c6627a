//! A second terminal adjusts a running bench and listens to its topics, over both transports.

use crate::support::bench::{all_ready, unique};
use crate::support::{Running, run, spawn, whirlstand};
use whirlstand_bus::{Bus, BusConfig, Transport};
use whirlstand_msgs::{Adjustment, AdjustmentKind, AdjustmentVerdict, Message};

const OPEN: [&str; 4] = ["--set", "plant.inject=true", "--set", "controller.pilot=true"];

/// A bench in lockstep that flies until it is ended.
fn flight(name: &str, transport: &str, out: &str, more: &[&str]) -> Running {
    let args = ["run", "quadrotor", "--bench", name, "--transport", transport, "--out", out];
    let more = more.iter().copied().chain(["--mode", "lockstep", "--duration", "1000 h", "--no-log"]);
    spawn(whirlstand(args.into_iter().chain(more).chain(["--log-level", "debug"])))
}

fn end(bench: Running) {
    bench.signal(libc::SIGTERM);
    assert_eq!(bench.finish().code(), 143);
}

fn json_line(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

fn adjusts_and_listens(transport: &str) {
    let dir = tempfile::tempdir().unwrap();
    let name = unique(&format!("in-flight-{transport}"));
    let mut bench = flight(&name, transport, dir.path().to_str().expect("utf-8 path"), &OPEN);
    let line = bench.wait_for_stderr("open to gusts, engine");
    assert!(line.starts_with(&format!("bench {name} over {transport}: open to")), "{line}");
    all_ready(&mut bench, ["plant", "estimator", "controller"]);

    let set = run(["set", &name, "setpoint.roll=5deg", "gain=1.5", "engine=on"]).success();
    for said in ["setpoint of roll: 5.00 deg from t ", "gain 1.5 from t ", "engine on from t "] {
        assert!(set.stdout.contains(said), "{}", set.stdout);
    }
    let echo = run(["echo", &name, "setpoint", "--count", "1", "--json"]).success();
    let heard = json_line(&echo.stdout);
    assert_eq!((&heard["schema"], &heard["topic"]), (&"whirlstand.message.v1".into(), &"setpoint".into()));
    assert_eq!(heard["message"]["x"][0].as_f64(), Some(5f64.to_radians()));
    assert_eq!(heard["message"]["tracked"].as_u64().map(|bits| bits & 1), Some(1));
    let echo = run(["echo", &name, "truth", "--count", "2"]).success();
    assert_eq!(echo.stdout.lines().count(), 2);
    assert!(echo.stdout.contains("  roll ") && echo.stdout.contains(" deg  roll_rate "), "{}", echo.stdout);

    let file = dir.path().join("gust.json");
    let gust = ["inject", &name, "roll_rate=60 deg/s^2", "--for", "100 ms", "--json"];
    run(gust.into_iter().chain([file.to_str().expect("utf-8 path")])).success();
    let told = crate::support::json(&file);
    assert_eq!(told["schema"], "whirlstand.adjusted.v1");
    let became = &told["adjusted"][0];
    assert_eq!((became["refused"].is_null(), became["step"].is_u64()), (true, true), "{told}");

    let refused = run(["set", &name, "gain=50"]);
    assert_eq!(refused.code(), 2);
    assert!(refused.stdout.contains("gain 50 refused"), "{}", refused.stdout);
    bench.wait_for_stderr("a gain of 50 from outside is refused: it is beyond the limits");
    let wrong = run(["echo", &name, "imo"]);
    assert_eq!(wrong.code(), 2);
    assert!(wrong.stderr.contains("did you mean 'imu'?"), "{}", wrong.stderr);

    // A listener is notified of the end of the bench, and leaves nothing behind.
    let mut listener = spawn(whirlstand(["echo", &name, "health"]));
    assert!(listener.is_alive());
    end(bench);
    listener.finish().success();
    let late = run(["set", &name, "gain=1"]);
    assert_eq!(late.code(), 2);
    assert!(late.stderr.contains(&format!("no bench '{name}' of yours runs here")), "{}", late.stderr);
}

fn a_bench_over_shared_memory_is_adjusted_and_listened_to() {
    adjusts_and_listens("iceoryx2");
}

fn a_protected_bench_over_a_network_is_adjusted_and_listened_to() {
    adjusts_and_listens("zenoh");
}

fn a_bench_that_is_not_open_says_what_would_open_it_whoever_asks() {
    let dir = tempfile::tempdir().unwrap();
    let name = unique("in-flight-closed");
    let mut bench = flight(&name, "iceoryx2", dir.path().to_str().expect("utf-8 path"), &[]);
    bench.wait_for_stderr(&format!("bench {name} over iceoryx2: closed to"));
    all_ready(&mut bench, ["plant", "estimator", "controller"]);
    for (call, key) in [
        (["inject", &name, "roll_rate=1deg/s^2"], "plant.inject=true"),
        (["set", &name, "gain=2"], "controller.pilot=true"),
    ] {
        let refused = run(call);
        assert_eq!(refused.code(), 2);
        assert!(refused.stderr.contains(key), "{}", refused.stderr);
    }
    // A program that does not check first is answered by the node itself.
    let bus = Bus::open(&BusConfig::new(&name, "guest", Transport::Iceoryx2)).unwrap();
    let mut answers = bus.subscriber::<Adjustment>(16).unwrap();
    let what = AdjustmentKind::Gain as u32;
    let request = Adjustment { id: 1, what, value: 2.0, ..Adjustment::zeroed() };
    // A publisher that closes before it is discovered delivers nothing.
    let mut ask = bus.publisher_on("adjust").unwrap();
    ask.send(&request).unwrap();
    let mut answer = None;
    let until = std::time::Instant::now() + crate::support::HUNG;
    bus.wait_until(until, || {
        answer = answers.try_recv()?;
        Ok::<_, whirlstand_bus::RecvError>(answer.is_some())
    })
    .unwrap();
    assert_eq!(answer.map(|a| a.verdict), Some(AdjustmentVerdict::Closed as u32));
    bench.wait_for_stderr("start it with --set controller.pilot=true");
    end(bench);
}

fn what_was_asked_for_is_in_the_log() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().to_str().expect("utf-8 path");
    let name = unique("in-flight-logged");
    let args =
        ["run", "quadrotor", "--bench", &name, "--duration", "1 h", "--out", out, "--log-level", "debug"];
    let mut bench = spawn(whirlstand(args.into_iter().chain(OPEN)));
    all_ready(&mut bench, ["plant", "estimator", "controller", "recorder"]);
    run(["set", &name, "engine=off"]).success();
    end(bench);
    let info = run(["log", "info", out]).success();
    let line =
        info.stdout.lines().find(|l| l.contains("/adjusted")).unwrap_or_else(|| panic!("{}", info.stdout));
    assert!(line.contains(" 1 "), "{line}");
}

whirlstand_test_harness::listed!(
    a_bench_over_shared_memory_is_adjusted_and_listened_to,
    a_protected_bench_over_a_network_is_adjusted_and_listened_to,
    a_bench_that_is_not_open_says_what_would_open_it_whoever_asks,
    what_was_asked_for_is_in_the_log,
);
