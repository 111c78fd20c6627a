//! Which senders are accepted on a link that is open to anyone, tested with whole processes: floods of malformed data,
//! second senders, a silent client that holds a port, replayed outputs.

use std::io::Read;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use crate::support::bridged::Bridged;
use crate::support::flight::{Flying, betaflight, fly, free_tcp, free_udp, take_off};
use crate::support::flood::{Flood, garbage};
use crate::support::{FAULTS_ALLOWED, Finished, Running, json, run, spawn, until, whirlstand};
use whirlstand_test_harness::{Outcome, python};

/// Longest gap between two overrides that the load of the machine can explain, s.
const GAP: f64 = 1.0;

/// Number of datagrams of a flood: three seconds at 10 kHz.
const FLOOD: u64 = 30_000;

/// A bench whose vehicle is connected over MAVLink, and the vehicle.
struct Place {
    python: PathBuf,
    dir: tempfile::TempDir,
    port: u16,
}

impl Place {
    fn vehicle(&self, report: &str, more: &[&str]) -> Running {
        let mut command = Command::new(&self.python);
        command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bridge/autopilot.py"));
        command.args(["--link", &format!("udpout:127.0.0.1:{}", self.port)]);
        command.arg("--report").arg(self.dir.path().join(report)).args(more);
        spawn(command)
    }

    /// The command line of the bench; `more` are keys of `[bridge.mavlink]`.
    fn bench(&self, more: &str) -> Command {
        let bridged = Bridged {
            bridge: "mavlink",
            vehicle: "quadrotor",
            rate_hz: 100,
            duration_s: 100,
            safety: "arm = \"autopilot\"\nstale_s = 1.0",
            link: format!("udpin://127.0.0.1:{}", self.port),
            more,
        };
        let file = bridged.write(self.dir.path());
        let (file, out) = (file.display().to_string(), self.dir.path().join("out").display().to_string());
        whirlstand(["run", &file, "--out", &out])
    }

    fn key(&self) -> String {
        let key = self.dir.path().join("key");
        std::fs::write(&key, "2a".repeat(32)).unwrap();
        format!("signing_key = {:?}", key.display().to_string())
    }
}

fn place() -> Result<Place, whirlstand_test_harness::Missing> {
    Ok(Place { python: python()?, dir: tempfile::tempdir().unwrap(), port: free_udp() })
}

fn end(bench: Running) -> Finished {
    bench.signal(libc::SIGINT);
    bench.finish()
}

/// Flies through a flood that begins in flight; the vehicle keeps receiving its overrides.
fn fly_through(place: &Place, keys: &str, vehicle: &[&str], datagrams: Vec<Vec<u8>>) {
    let vehicle = place.vehicle("vehicle.json", vehicle);
    let mut bench = spawn(place.bench(keys));
    bench.wait_for_stderr("the controller is in charge");
    let flood = Flood::start(&[place.port], datagrams);
    // Three seconds of the flood, measured by count instead of time.
    until("the flood does not go on", || flood.sent() >= FLOOD);
    drop(flood);
    let ended = end(bench);
    vehicle.signal(libc::SIGTERM);
    vehicle.finish().success();
    let seen = json(place.dir.path().join("vehicle.json"));
    assert!(seen["longest_gap_s"].as_f64().unwrap() < GAP, "{}\n{}", seen["longest_gap_s"], ended.stderr);
    assert!(!ended.stderr.contains("FAILSAFE"), "{}", ended.stderr);
    assert_eq!(
        ended.stderr.matches("sends as well and is refused").count(),
        1,
        "told once: {}",
        ended.stderr
    );
    assert_eq!(seen["faults"], serde_json::json!([]));
    let summary = json(place.dir.path().join("out/summary.json"));
    let rejected = summary["runs"][0]["timing"]["nodes"]["plant"]["rejected"].as_u64().unwrap();
    // The operating system drops part of a flood when the machine is busy.
    assert!(rejected > FLOOD / 4, "{rejected}\n{}", ended.stderr);
}

fn garbage_at_10_khz_steals_no_output_of_a_mavlink_vehicle() -> Outcome {
    let place = place()?;
    fly_through(&place, "", &[], garbage());
    Ok(())
}

fn one_byte_steals_no_output_of_a_signed_link() -> Outcome {
    let place = place()?;
    fly_through(&place, &place.key(), &["--key", &"2a".repeat(32)], vec![vec![0xFD], vec![0]]);
    Ok(())
}

fn a_second_vehicle_is_refused_until_the_first_is_silent() -> Outcome {
    let place = place()?;
    let first = place.vehicle("first.json", &[]);
    let mut bench = spawn(place.bench(""));
    bench.wait_for_stderr("the controller is in charge");
    let second = place.vehicle("second.json", &[]);
    bench.wait_for_stderr("sends as well and is refused");
    first.signal(libc::SIGTERM);
    first.finish().success();
    bench.wait_for_stderr("FAILSAFE");
    bench.wait_for_stderr("had sent nothing valid for 3 s");
    // A vehicle arms one second after its first override; the second vehicle received no outputs before the takeover.
    bench.wait_for_stderr("the controller is in charge");
    end(bench);
    second.signal(libc::SIGTERM);
    second.finish().success();
    for report in ["first.json", "second.json"] {
        let seen = json(place.dir.path().join(report));
        assert_eq!(seen["faults"], serde_json::json!([]), "{report}");
        assert_eq!(seen["moved_before_armed"], 0, "{report}");
    }
    Ok(())
}

fn a_pinned_address_refuses_all_others() -> Outcome {
    let place = place()?;
    let vehicle = place.vehicle("vehicle.json", &[]);
    let mut bench = place.bench("peer = \"127.0.0.2\"");
    bench.args(["--set", "plant.start_timeout_s=3"]);
    let ended = spawn(bench).finish();
    vehicle.signal(libc::SIGTERM);
    vehicle.finish().success();
    assert_eq!(ended.code(), 1, "{}", ended.stderr);
    assert!(ended.stderr.contains("is refused: only 127.0.0.2 is accepted here"), "{}", ended.stderr);
    let seen = json(place.dir.path().join("vehicle.json"));
    assert_eq!(seen["seen"], serde_json::json!({}), "it was never spoken to");
    // A `peer` that is not an address is an error in the file.
    for (key, words) in
        [("peer = \"here\"", "192.0.2.7:14550 is expected"), ("peer = 7", "expected a string")]
    {
        let mut bench = place.bench(key);
        bench.arg("--no-log");
        let ended = spawn(bench).finish();
        assert!(ended.code() == 2 && ended.stderr.contains(words), "{key}: {}", ended.stderr);
    }
    Ok(())
}

/// Flies through malformed data from the start and, once the autopilot is the peer, through forged outputs that look
/// valid but stop all motors except one.
fn hold_against(mut flying: Flying, ports: &[u16], forged: Vec<Vec<u8>>) {
    // Reported for the malformed data as soon as there is a peer.
    flying.wait_for("sends as well and is refused");
    let forged = Flood::start(ports, forged);
    let flight = flying.finish();
    assert!(forged.sent() > 1000);
    drop(forged);
    let flight = flight.well();
    assert!(flight.rejected() > 1000, "{}\n{}", flight.rejected(), flight.stderr);
}

fn ardupilot_is_flown_through_garbage_and_forged_packets() -> Outcome {
    let port = free_udp();
    let _garbage = Flood::start(&[port], garbage());
    let arguments = [port.to_string(), "REPORT".into()];
    let link = format!("bridge.ardupilot.link=udpin://127.0.0.1:{port}");
    let rest = ["--mode", "lockstep"];
    // The verdict also reports refused messages, unless the limits allow them.
    let options = [link, FAULTS_ALLOWED.into()];
    let flying = take_off("ardupilot-json", "ardupilot.py", &arguments, &options, &rest)?;
    let forged = (0..50u32).map(|n| {
        let mut packet = [18458u16.to_le_bytes(), 400u16.to_le_bytes()].concat();
        packet.extend((n * 100).to_le_bytes());
        packet.extend([2000u16, 1000, 1000, 1000].iter().chain(&[1500; 12]).flat_map(|p| p.to_le_bytes()));
        packet
    });
    hold_against(flying, &[port], forged.collect());
    Ok(())
}

fn betaflight_is_flown_through_garbage_and_forged_packets() -> Outcome {
    let ports: [u16; 4] = std::array::from_fn(|_| free_udp());
    let _garbage = Flood::start(&ports[..2], garbage());
    let (arguments, options) = betaflight(ports);
    let rest = ["--mode", "realtime", "--set", "rate_hz=250"];
    let flying = take_off("betaflight-sitl", "betaflight.py", &arguments, &options, &rest)?;
    let mut packet = vec![4, 0, 0, 0];
    packet.extend([2000f32, 1000.0, 1000.0, 1000.0].iter().chain(&[0.0; 12]).flat_map(|p| p.to_le_bytes()));
    hold_against(flying, &ports[..1], vec![packet]);
    Ok(())
}

fn a_silent_client_loses_px4s_port_to_px4() -> Outcome {
    let (port, dir) = (free_tcp(), tempfile::tempdir().unwrap());
    let held = dir.path().join("held");
    let arguments = [port.to_string(), "REPORT".into(), "--wait-for".into(), held.display().to_string()];
    let options = [format!("bridge.px4.link=tcpin://127.0.0.1:{port}"), "plant.start_timeout_s=20".into()];
    let rest = ["--mode", "lockstep", "--set", "rate_hz=250"];
    let flying = take_off("px4-hil", "px4.py", &arguments, &options, &rest)?;
    let until = std::time::Instant::now() + crate::support::HUNG;
    let mut silent = loop {
        match TcpStream::connect(("127.0.0.1", port)) {
            Ok(client) => break client,
            Err(e) => assert!(std::time::Instant::now() < until, "nobody listens: {e}"),
        }
    };
    std::fs::write(&held, "").unwrap();
    let name = silent.local_addr().unwrap();
    let flight = flying.finish().well();
    let said = |words: String| assert!(flight.stderr.contains(&words), "{words}:\n{}", flight.stderr);
    said(format!("{name} has sent nothing valid for 1 s, and 127.0.0.1:"));
    // The bench closed this connection after sending it sensor messages.
    silent.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    let _ = silent.read_to_end(&mut Vec::new());
    Ok(())
}

fn outputs_that_are_played_again_are_stale_and_those_beyond_their_range_are_told() -> Outcome {
    let port = free_tcp();
    let arguments = [&port.to_string(), "REPORT", "--free", "--replay-after", "1200", "--beyond"];
    let link = format!("bridge.px4.link=tcpin://127.0.0.1:{port}");
    let rest = ["--mode", "realtime", "--set", "rate_hz=250"];
    let flight = fly("px4-hil", "px4.py", &arguments.map(Into::into), &[link], &rest)?;
    let said = |words: &str| assert!(flight.stderr.contains(words), "{words}:\n{}", flight.stderr);
    said("PX4 sent outputs with a repeated or older time or number");
    said("PX4: no fresh outputs: no command, the plant goes to its failsafe");
    said("PX4: output 3 is out of range and was limited");
    assert!(flight.rejected() > 500, "{}\n{}", flight.rejected(), flight.stderr);
    Ok(())
}

fn a_pin_is_for_links_that_anybody_can_reach() {
    let set = "bridge.px4.peer=127.0.0.1";
    let link = "bridge.px4.link=udpout://127.0.0.1:9";
    let bridge = "nodes.controller.bridge=px4-hil";
    let out = tempfile::tempdir().unwrap();
    let out = out.path().join("out").display().to_string();
    let ended = run(["run", "quadrotor", "--set", bridge, "--set", link, "--set", set, "--out", &out]);
    assert_eq!(ended.code(), 2, "{}", ended.stderr);
    assert!(
        ended.stderr.contains("bridge.px4.peer") && ended.stderr.contains("leave it out"),
        "{}",
        ended.stderr
    );
}

whirlstand_test_harness::listed!(
    garbage_at_10_khz_steals_no_output_of_a_mavlink_vehicle,
    one_byte_steals_no_output_of_a_signed_link,
    a_second_vehicle_is_refused_until_the_first_is_silent,
    a_pinned_address_refuses_all_others,
    ardupilot_is_flown_through_garbage_and_forged_packets,
    betaflight_is_flown_through_garbage_and_forged_packets,
    a_silent_client_loses_px4s_port_to_px4,
    outputs_that_are_played_again_are_stale_and_those_beyond_their_range_are_told,
    a_pin_is_for_links_that_anybody_can_reach
);
