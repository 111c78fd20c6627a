//! Two hosts: network namespaces joined by a veth pair; the controller on one, the rest of the bench on the other.
//!
//! Making namespaces needs iproute2 and root; a machine whose kernel refuses them can never run these tests.

use std::net::UdpSocket;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use crate::support::{FAULTS_ALLOWED, Finished, Running, json, relay, run, spawn, whirlstand};
use whirlstand_test_harness::{Missing, Outcome, python_with};

/// Two joined namespaces with addresses 10.213.N.1 and 10.213.N.2; removed on drop.
struct TwoHosts {
    names: [String; 2],
    subnet: u8,
}

impl TwoHosts {
    fn new(subnet: u8) -> Result<Self, Missing> {
        let id = std::process::id();
        let names = [format!("whirl{id}a{subnet}"), format!("whirl{id}b{subnet}")];
        let hosts = Self { names, subnet };
        let [a, b] = &hosts.names;
        let (inner_a, inner_b) = (format!("wa{id}{subnet}"), format!("wb{id}{subnet}"));
        let (address_a, address_b) = (format!("{}/24", hosts.address(0)), format!("{}/24", hosts.address(1)));
        let steps: [&[&str]; 9] = [
            &["netns", "add", a],
            &["netns", "add", b],
            &["link", "add", &inner_a, "netns", a, "type", "veth", "peer", "name", &inner_b, "netns", b],
            &["-n", a, "addr", "add", &address_a, "dev", &inner_a],
            &["-n", b, "addr", "add", &address_b, "dev", &inner_b],
            &["-n", a, "link", "set", &inner_a, "up"],
            &["-n", b, "link", "set", &inner_b, "up"],
            &["-n", a, "link", "set", "lo", "up"],
            &["-n", b, "link", "set", "lo", "up"],
        ];
        for step in steps {
            configure("ip", step, "no network namespaces")?;
        }
        Ok(hosts)
    }

    fn address(&self, host: usize) -> String {
        format!("10.213.{}.{}", self.subnet, host + 1)
    }

    /// The same command, run on one of the hosts.
    fn on(&self, host: usize, command: &Command) -> Command {
        let mut there = Command::new("ip");
        there.args(["netns", "exec", &self.names[host]]).arg(command.get_program()).args(command.get_args());
        for (key, value) in command.get_envs() {
            if let Some(value) = value {
                there.env(key, value);
            }
        }
        there
    }

    /// Adds delay and loss in both directions.
    fn impair(&self, netem: &[&str]) -> Outcome {
        for (host, prefix) in ["wa", "wb"].iter().enumerate() {
            let device = format!("{prefix}{}{}", std::process::id(), self.subnet);
            let add = ["-n", &self.names[host], "qdisc", "add", "dev", &device, "root", "netem"];
            configure("tc", &[&add, netem].concat(), "no netem")?;
        }
        Ok(())
    }
}

/// Runs a command of iproute2. If it is not installed, it can be; if it is refused, the machine cannot run the test.
fn configure(program: &str, arguments: &[&str], lacking: &str) -> Outcome {
    match Command::new(program).args(arguments).output() {
        Ok(done) if done.status.success() => Ok(()),
        Ok(done) => {
            let said = String::from_utf8_lossy(&done.stderr);
            let why = format!("`{program} {}` says: {}", arguments.join(" "), said.trim());
            Err(Missing::beyond_this_machine(lacking, why))
        }
        Err(e) => Err(Missing::installable(format!("no {program} ({e})"), "install iproute2")),
    }
}

impl Drop for TwoHosts {
    fn drop(&mut self) {
        for name in &self.names {
            let _ = Command::new("ip").args(["netns", "del", name]).output();
        }
    }
}

/// Where the controller listens, how each of the other nodes reaches it, and on which hosts they run.
struct Link<'a> {
    hosts: Option<&'a TwoHosts>,
    listen: String,
    connect: [String; 3],
}

impl<'a> Link<'a> {
    fn between(hosts: &'a TwoHosts) -> Self {
        Self::over("tcp", hosts)
    }

    fn over(protocol: &str, hosts: &'a TwoHosts) -> Self {
        let endpoint = format!("{protocol}/{}:7447", hosts.address(1));
        Self { hosts: Some(hosts), listen: endpoint.clone(), connect: [(); 3].map(|()| endpoint.clone()) }
    }

    fn start(&self, host: usize, command: Command) -> Running {
        spawn(match self.hosts {
            Some(hosts) => hosts.on(host, &command),
            None => command,
        })
    }
}

/// Flies the bench on host 0 with its controller on host 1.
fn fly(link: &Link, bench: &str, out: &Path, mode: &str, more: &[&str]) -> Finished {
    let bench = format!("{bench}-{}", std::process::id());
    let same = ["--transport", "zenoh", "--mode", mode, "--duration", "8", "--bench", &bench];
    // Traffic between hosts without keys is unprotected and must be requested explicitly.
    let open = ["--set", "security.mode=open"];
    let more: Vec<&str> = if more.iter().any(|m| m.starts_with("security.")) {
        more.to_vec()
    } else {
        open.iter().chain(more).copied().collect()
    };
    let there = ["node", "controller", "--launch", "quadrotor", "--listen", &link.listen];
    let there = whirlstand(there.into_iter().chain(same).chain(more.iter().copied()));
    let mut here = whirlstand(["run", "quadrotor", "--set", "nodes.controller.external=true", "--out"]);
    here.arg(out).args(same).args(&more);
    for (node, endpoint) in ["plant", "estimator", "recorder"].iter().zip(&link.connect) {
        here.args(["--set", &format!("nodes.{node}.connect=[\"{endpoint}\"]")]);
    }
    let _controller = link.start(1, there);
    link.start(0, here).finish()
}

fn controller_on_another_host_flies_the_same_flight() -> Outcome {
    let hosts = TwoHosts::new(11)?;
    let dir = tempfile::tempdir().unwrap();
    let apart = dir.path().join("apart");
    fly(&Link::between(&hosts), "two-hosts", &apart, "lockstep", &["--set", "expect={}"]).success();
    let together = dir.path().join("together");
    run([
        "run",
        "quadrotor",
        "--mode",
        "lockstep",
        "--duration",
        "8",
        "--set",
        "expect={}",
        "--out",
        together.to_str().unwrap(),
    ])
    .success();
    let diff = run([
        "log",
        "diff",
        apart.join("log.mcap").to_str().unwrap(),
        together.join("log.mcap").to_str().unwrap(),
    ]);
    assert_eq!(diff.code(), 0, "{}", diff.stdout);
    Ok(())
}

fn with_keys_the_link_between_hosts_is_mutual_tls() -> Outcome {
    let hosts = TwoHosts::new(13)?;
    let dir = tempfile::tempdir().unwrap();
    let keys = dir.path().join("keys");
    let keys = keys.to_str().unwrap();
    run(["keys", "new", keys, "--host", &hosts.address(0), "--host", &hosts.address(1)]).success();
    let folder = format!("security.keys={keys}");
    let protected = ["--set", "security.mode=tls", "--set", &folder, "--set", "expect={}"];
    let out = dir.path().join("out");
    fly(&Link::over("tls", &hosts), "keys", &out, "lockstep", &protected).success();
    assert_eq!(json(out.join("summary.json"))["runs"][0]["ended"]["how"], "complete");
    Ok(())
}

/// A bench with keys on one host is watched from another host, which has only the observer's and the guest's keys,
/// using only the bench's launch file. The requests of the page take effect on the bench.
fn a_bench_is_watched_from_another_host() -> Outcome {
    let hosts = TwoHosts::new(14)?;
    let dir = tempfile::tempdir().unwrap();
    let (here, there) = (dir.path().join("keys"), dir.path().join("keys-there"));
    let keys = here.to_str().unwrap();
    run(["keys", "new", keys, "--host", &hosts.address(0), "--host", &hosts.address(1)]).success();
    std::fs::create_dir(&there).unwrap();
    for file in ["ca.pem", "observer.pem", "observer.key", "guest.pem", "guest.key"] {
        std::fs::copy(here.join(file), there.join(file)).unwrap();
    }
    let bench = format!("watched-from-afar-{}", std::process::id());
    let out = dir.path().join("out").display().to_string();
    let mut same: Vec<String> =
        ["--transport", "zenoh", "--mode", "realtime", "--duration", "1 h", "--set", "security.mode=tls"]
            .map(String::from)
            .into();
    for (i, node) in ["plant", "estimator", "controller", "recorder"].iter().enumerate() {
        let endpoint = format!("tls/{}:{}", hosts.address(0), 7450 + i);
        same.extend(["--set".to_string(), format!("nodes.{node}.listen=[\"{endpoint}\"]")]);
    }
    let with = |keys: &Path| format!("security.keys={}", keys.display());
    let flight = whirlstand(["run", "quadrotor", "--bench", &bench, "--out", &out, "--set", &with(&here)]);
    let open = ["plant.inject=true", "controller.pilot=true", FAULTS_ALLOWED].map(|key| ["--set", key]);
    let mut flight = flight;
    flight.args(&same).args(open.as_flattened());
    let bench_here = spawn(hosts.on(0, &flight));

    let mut watch =
        whirlstand(["watch", &bench, "--launch", "quadrotor", "--listen", "0", "--set", &with(&there)]);
    watch.args(&same).args(open.as_flattened());
    let mut watch = spawn(hosts.on(1, &watch));
    let line = watch.wait_for_stderr("live page http");
    let url = line.split_whitespace().find(|word| word.starts_with("http")).expect("an address").to_string();
    // The page is on the other host's loopback interface.
    let python = python_with("urllib.request")?;
    let on_page = |what: &str, text: &str| {
        let mut client = Command::new(&python);
        client
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/hosts/page.py"))
            .args([&url, what, text]);
        spawn(hosts.on(1, &client)).finish().success().stdout
    };
    // Each link carries one node: messages that the plant sends before its own link is up are not received.
    for wanted in ["\"rows\":{\"step\":[", "\"node\":\"plant\"", "\"node\":\"recorder\""] {
        on_page("see", wanted);
    }
    let told = on_page("ask", r#"{"do":"inject","what":"roll_rate=60deg/s^2","for_s":0.2}"#);
    assert!(told.contains("gust on roll_rate: 60"), "{told}");
    on_page("see", "gust on roll_rate");
    // The same requests from a terminal there.
    let terminal = |words: &[&str]| {
        let mut command = whirlstand(words);
        command.args(["--launch", "quadrotor", "--set", &with(&there)]).args(&same).args(open.as_flattened());
        spawn(hosts.on(1, &command)).finish().success().stdout
    };
    let told = terminal(&["set", &bench, "setpoint.roll=3 deg"]);
    assert!(told.contains("setpoint of roll: 3.00 deg from t "), "{told}");
    let told = terminal(&["echo", &bench, "command", "--count", "2", "--json"]);
    assert_eq!(told.lines().count(), 2, "{told}");
    let told = terminal(&["inject", &bench, "pitch_rate=30deg/s^2"]);
    assert!(told.contains("gust on pitch_rate: 30"), "{told}");
    let told = on_page("ask", r#"{"do":"stop"}"#);
    assert!(told.contains("end of the run"), "{told}");
    bench_here.finish().success();
    let over = watch.finish().success();
    assert!(over.stderr.contains(&format!("bench {bench} is over")), "{}", over.stderr);
    let info = run(["log", "info", &out]).success();
    assert!(info.stdout.lines().any(|l| l.contains("/adjusted") && l.contains(" 4 ")), "{}", info.stdout);
    Ok(())
}

/// A delay of 5 ms each way exceeds a 200 Hz period; at 50 Hz the answer arrives in time unless a message is lost.
const SLOW: [&str; 4] = ["--set", "rate_hz=50", "--set", FAULTS_ALLOWED];

/// Asserts that the delay shows in the command latency and that lost steps are counted.
fn assert_bad_link_was_seen(out: &Path) {
    let summary = json(out.join("summary.json"));
    let timing = &summary["runs"][0]["timing"];
    let p50 = timing["nodes"]["plant"]["latency"]["p50_us"].as_f64().expect("a median");
    assert!((8_000.0..20_000.0).contains(&p50), "two ways of 5 ms: {timing}");
    assert!(timing["deadline_misses"].as_u64().is_some_and(|n| n > 0), "lost messages cost steps: {timing}");
}

fn a_bad_link_between_hosts_is_flown_counted_and_reported() -> Outcome {
    let hosts = TwoHosts::new(12)?;
    hosts.impair(&["delay", "5ms", "loss", "1%"])?;
    let dir = tempfile::tempdir().unwrap();
    fly(&Link::between(&hosts), "bad-link", dir.path(), "realtime", &SLOW).success();
    assert_bad_link_was_seen(dir.path());
    Ok(())
}

/// The same in user space, for machines without netem: Zenoh's datagrams pass through a relay that delays them and
/// loses one in a hundred.
fn a_link_that_delays_and_loses_datagrams_is_flown_counted_and_reported() {
    let server = UdpSocket::bind("127.0.0.1:0").and_then(|s| s.local_addr()).expect("a free port");
    let connect = [(); 3].map(|()| format!("udp/{}", relay::udp(server, Duration::from_millis(5), 0.01)));
    let link = Link { hosts: None, listen: format!("udp/{server}"), connect };
    let dir = tempfile::tempdir().unwrap();
    fly(&link, "relayed", dir.path(), "realtime", &SLOW).success();
    assert_bad_link_was_seen(dir.path());
}

whirlstand_test_harness::listed!(
    controller_on_another_host_flies_the_same_flight,
    with_keys_the_link_between_hosts_is_mutual_tls,
    a_bench_is_watched_from_another_host,
    a_bad_link_between_hosts_is_flown_counted_and_reported,
    a_link_that_delays_and_loses_datagrams_is_flown_counted_and_reported
);
