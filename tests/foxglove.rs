//! A bench is viewed and controlled by an independent client of Foxglove's protocol, and connected to by clients that
//! never read.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::Command;

use crate::support::bench::unique;
use crate::support::{FAULTS_ALLOWED, HUNG, Running, refused, run, spawn, whirlstand};
use serde_json::{Value, json};
use tempfile::TempDir;
use whirlstand_logs::LogStream;
use whirlstand_test_harness::{Outcome, python_with};

const OPEN: [&str; 4] = ["--set", "plant.inject=true", "--set", "controller.pilot=true"];

/// Address and topic of the controls that a command has reported.
#[track_caller]
fn served(command: &mut Running) -> (String, String) {
    let line = command.wait_for_stderr("Foxglove ws://");
    let word = |start: &str| {
        let found = line.split([' ', '(', ')']).find(|word| word.starts_with(start));
        found.unwrap_or_else(|| panic!("no {start} in {line}")).to_string()
    };
    (word("ws://"), word("/control/"))
}

fn a_client_sees_the_bench_by_name_and_steers_it() -> Outcome {
    let python = python_with("mcap_protobuf, websockets")?;
    let dir = TempDir::new().unwrap();
    let out = dir.path().to_str().expect("utf-8 path");
    let name = unique("foxglove");
    let args = ["run", "quadrotor", "--bench", &name, "--foxglove", "0", "--duration", "1 h", "--out", out];
    let mut bench = spawn(whirlstand(args.into_iter().chain(OPEN).chain(["--set", FAULTS_ALLOWED])));
    let (url, topic) = served(&mut bench);
    let mut client = Command::new(python);
    client.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foxglove/client.py")).args([&url, &topic]);
    let client = spawn(client).finish().success();
    bench.finish().success();
    let seen: Value = serde_json::from_str(&client.stdout).unwrap();
    assert_eq!(seen["subprotocol"], "foxglove.sdk.v1");
    assert_eq!(seen["topics"]["/imu"], "whirlstand/msg/Imu", "{seen}");
    assert_eq!(seen["topics"]["/tf"], "foxglove.FrameTransforms");
    assert_eq!(seen["topics"]["/log"], "foxglove.Log");
    assert_eq!(seen["topics"]["/scene"], "foxglove.SceneUpdate");
    assert_eq!(
        (&seen["frames"], &seen["parent"]),
        (&json!(["estimated", "measured", "vehicle"]), &json!("world"))
    );
    assert_eq!(seen["scene"], json!([[2, 4, "vehicle"], [2, 4, "estimated"]]), "a quadrotor has four rotors");
    let setpoint = seen["setpoint"].as_f64().unwrap();
    assert!((setpoint - 5f64.to_radians()).abs() < 1e-9, "{setpoint}");
    let times = seen["times_s"].as_array().unwrap();
    let span = times[1].as_f64().unwrap() - times[0].as_f64().unwrap();
    assert!((0.1..HUNG.as_secs_f64()).contains(&span), "all channels have bench time: {times:?}");
    let answers: Vec<_> = seen["answers"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
    let wanted = [
        "topic /control/guess is not accepted",
        "beyond the limits",
        "setpoint of roll",
        "gust on roll_rate",
        "end of the run",
    ];
    for (answer, wanted) in answers.iter().zip(wanted) {
        assert!(answer.contains(wanted), "{wanted}: {answers:?}");
    }
    let info = run(["log", "info", out]).success();
    let adjusted = info.stdout.lines().find(|l| l.contains("/adjusted")).expect("answers are in the log");
    assert!(adjusted.contains(" 4 "), "what was refused, the setpoint, the gust and the end: {adjusted}");
    let in_log = panels_of(python_with("mcap_protobuf")?, &dir.path().join("log.mcap"));
    let (seen, logged) = (texts(&seen["events"], None), texts(&in_log["events"], Some(1)));
    assert!(seen.iter().all(|text| logged.contains(text)), "live {seen:?}, in the log {logged:?}");
    Ok(())
}

/// What `tests/foxglove/log.py` reads from a log.
#[track_caller]
fn panels_of(python: impl AsRef<std::ffi::OsStr>, log: &Path) -> Value {
    let mut reader = Command::new(python);
    reader.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foxglove/log.py")).arg(log);
    serde_json::from_str(&spawn(reader).finish().success().stdout).unwrap()
}

fn texts(list: &Value, at: Option<usize>) -> Vec<String> {
    let text = |v: &Value| at.map_or(v, |i| &v[i]).as_str().map(String::from);
    list.as_array().unwrap().iter().filter_map(text).collect()
}

/// The log has the same panel data as the server, at the bench time of the data from which it is derived.
fn a_log_has_pose_shape_and_events_for_panels() -> Outcome {
    let python = python_with("mcap_protobuf, mcap_ros2")?;
    let dir = TempDir::new().unwrap();
    let out = dir.path().to_str().expect("utf-8 path");
    run(["run", "quadrotor", "--mode", "lockstep", "--duration", "12", "--out", out]).success();
    let seen = panels_of(python, &dir.path().join("log.mcap"));
    assert_eq!(seen["schemas"]["/tf"], "foxglove.FrameTransforms", "{seen}");
    assert_eq!(seen["schemas"]["/log"], "foxglove.Log");
    assert_eq!(seen["schemas"]["/scene"], "foxglove.SceneUpdate");
    // 2400 steps at 200 Hz, of which every fourth is published.
    assert_eq!(seen["frames"], json!({"vehicle": 600, "measured": 600, "estimated": 600}));
    assert_eq!(seen["misplaced"], 0, "the stamp in a message is its time in the log");
    assert!(
        seen["worst_angle"].as_f64().unwrap() < 1e-9,
        "it is turned as the truth of the same time: {seen}"
    );
    let scenes = seen["scenes"].as_array().unwrap();
    assert_eq!(scenes.len(), 12, "once a second");
    assert_eq!(scenes[0], json!([[2, 4, "vehicle"], [2, 4, "estimated"]]));
    let events = &seen["events"];
    let gust = "disturbance of 150 deg/s^2 on roll_rate and -80.0 deg/s^2 on pitch_rate";
    assert_eq!(events, &json!([[6.0, gust], [6.2, "disturbance over"]]));
    let info = run(["log", "info", out]).success().stdout;
    let line = info.lines().find(|l| l.contains("/tf")).expect("it is told");
    assert!(line.contains("foxglove.FrameTransforms") && !line.contains("lost"), "{line}");
    // Commands that read the loop's topics ignore these.
    run(["log", "export", out, "--output", &format!("{out}/flight.csv")]).success();
    run(["log", "diff", out, out]).success();
    Ok(())
}

/// A client that subscribes to everything and never reads.
#[track_caller]
fn stalled(url: &str) -> TcpStream {
    let mut stream = TcpStream::connect(url.trim_start_matches("ws://")).unwrap();
    stream.set_read_timeout(Some(HUNG)).unwrap();
    let head = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
                Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n";
    stream.write_all(head.as_bytes()).unwrap();
    let mut status = [0; 12];
    stream.read_exact(&mut status).unwrap();
    assert_eq!(&status, b"HTTP/1.1 101");
    let wanted: Vec<_> = (1..40).map(|id| json!({ "id": id, "channelId": id })).collect();
    let text = json!({ "op": "subscribe", "subscriptions": wanted }).to_string();
    let length = u16::try_from(text.len()).unwrap().to_be_bytes();
    // A final text frame, masked with zeros (RFC 6455, section 5.2).
    stream.write_all(&[&[0x81, 0x80 | 126], &length[..], &[0; 4], text.as_bytes()].concat()).unwrap();
    stream
}

fn clients_that_never_read_change_nothing_in_the_log() -> Outcome {
    let dir = TempDir::new().unwrap();
    let fly = |clients: usize| {
        let out = dir.path().join(clients.to_string()).display().to_string();
        let args =
            ["run", "quadrotor", "--mode", "lockstep", "--duration", "200", "--out", &out, "--foxglove", "0"];
        let mut bench = spawn(whirlstand(args));
        let (url, _) = served(&mut bench);
        let clients: Vec<_> = (0..clients).map(|_| stalled(&url)).collect();
        bench.finish().success();
        drop(clients);
        out
    };
    let (alone, looked_at) = (fly(0), fly(5));
    run(["log", "diff", &alone, &looked_at]).success();
    Ok(())
}

/// The paths that the plots of a layout request: topic, field, and any element of the field.
fn asked_for(layout: &str, field: char) -> Vec<Vec<String>> {
    let quoted =
        layout.split('"').filter(|text| text.starts_with('/') && !text.contains('<') && text.contains(field));
    let path = |text: &str| {
        text[1..].split(".@").next().unwrap_or_default().split(field).map(String::from).collect()
    };
    quoted.map(path).filter(|path: &Vec<String>| path.len() > 1 && !path[1].is_empty()).collect()
}

fn the_layouts_show_what_is_in_a_log() -> Outcome {
    let dir = TempDir::new().unwrap();
    let out = dir.path().display().to_string();
    let flight = ["run", "quadrotor", "--mode", "lockstep", "--duration", "1"];
    run(flight.into_iter().chain(["--out", &out, "--set", FAULTS_ALLOWED]));
    let mut stream = LogStream::open(dir.path()).unwrap();
    let mut schemas = BTreeMap::new();
    while let Some(message) = stream.next().unwrap() {
        if message.topic.schema_encoding != "ros2msg" {
            continue;
        }
        let schema = || String::from_utf8(message.topic.schema.clone()).unwrap();
        schemas.entry(message.topic.name.clone()).or_insert_with(schema);
    }
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    for (layout, field) in [("foxglove-layout.json", '.'), ("plotjuggler-layout.xml", '/')] {
        let asked = asked_for(&std::fs::read_to_string(docs.join(layout)).unwrap(), field);
        assert_eq!(asked.len(), 16, "{layout}: {asked:?}");
        for path in asked {
            let schema =
                schemas.get(&format!("/{}", path[0])).unwrap_or_else(|| panic!("{layout}: {path:?}"));
            // A nested element is listed in the type of its field, which has a section of its own.
            for name in &path[1..] {
                assert!(
                    schema.lines().any(|line| line.ends_with(&format!(" {name}"))),
                    "{layout}: {path:?} in\n{schema}"
                );
            }
        }
    }
    Ok(())
}

fn an_address_that_is_none_is_told() -> Outcome {
    refused(&["run", "--foxglove", "nowhere"], &["nowhere", "is not an address"]);
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    refused(&["run", "--foxglove", &port], &["cannot serve on", &port]);
    Ok(())
}

whirlstand_test_harness::listed!(
    a_client_sees_the_bench_by_name_and_steers_it,
    a_log_has_pose_shape_and_events_for_panels,
    clients_that_never_read_change_nothing_in_the_log,
    the_layouts_show_what_is_in_a_log,
    an_address_that_is_none_is_told
);
