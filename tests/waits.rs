//! A bench that is blocked reports what it waits for.

use std::net::{TcpListener, UdpSocket};

use crate::support::{spawn, whirlstand};

/// A TCP port that nobody uses.
fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("its address").port()
}

fn a_bench_without_its_autopilot_says_what_it_waits_for_and_where() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().to_str().expect("utf-8 path");
    let port = free_port();
    let link = format!("bridge.px4.link=\"tcpin://127.0.0.1:{port}\"");
    let args = ["run", "quadrotor-px4", "--no-log", "--out", out, "--set", &link];
    let mut bench = spawn(whirlstand(args));
    let line = bench.wait_for_stderr("waiting for");
    let said = format!("t    0.00 s  waiting for PX4 on tcp {port} (");
    assert!(line.starts_with(&said) && line.ends_with(" s)"), "{line}");
    bench.signal(libc::SIGTERM);
    assert_eq!(bench.finish().code(), 143);
}

fn a_bench_whose_vehicle_never_speaks_says_what_it_waits_for_and_where() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().to_str().expect("utf-8 path");
    let port = UdpSocket::bind("127.0.0.1:0").and_then(|s| s.local_addr()).expect("a free port").port();
    let link = format!("bridge.mavlink.link=\"udpin://127.0.0.1:{port}\"");
    let args = ["run", "quadrotor-mavlink", "--no-log", "--out", out, "--set", &link];
    let mut bench = spawn(whirlstand(args));
    let line = bench.wait_for_stderr("waiting for");
    let said = format!("t    0.00 s  waiting for the vehicle's attitude on udp {port} (");
    assert!(line.starts_with(&said) && line.ends_with(" s)"), "{line}");
    bench.signal(libc::SIGTERM);
    let ended = bench.finish();
    assert_eq!(ended.code(), 143, "{}", ended.stderr);
    assert!(
        ended.stdout.contains("ended early by SIGTERM") && ended.stdout.contains("0 steps"),
        "{}",
        ended.stdout
    );
}

whirlstand_test_harness::listed!(
    a_bench_without_its_autopilot_says_what_it_waits_for_and_where,
    a_bench_whose_vehicle_never_speaks_says_what_it_waits_for_and_where,
);
