//! Access to a bench over Zenoh for programs without its key, with the key of another role, with half of a key. These
//! tests verify what `docs/security.md` says.

mod support;

use std::env::set_var;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use serde_json::Value;
use support::{Finished, HUNG, Running, json, run, spawn, whirlstand};
use whirlstand_bus::{
    Authority, Bus, BusConfig, Member, ONE_THREAD, Protection, Publisher, Subscriber, Transport, Writes,
};
use whirlstand_msgs::{Command, Health, Message, NodeState, Truth};
use whirlstand_test_harness::{Test, run as run_tests};

/// A value that no bench produces by itself; it marks forged messages.
const FORGED: f64 = 777.125;

/// Pause between two attempts, so that the attack does not starve the bench.
const PAUSE: Duration = Duration::from_millis(2);

fn unique(name: &str) -> String {
    format!("test-{name}-{}", std::process::id())
}

/// A bench over Zenoh in real time.
fn start(bench: &str, out: &Path, more: &[&str]) -> Running {
    let args = ["run", "quadrotor", "--transport", "zenoh", "--duration", "4", "--set", "expect={}"];
    spawn(whirlstand(args.iter().chain(&["--bench", bench, "--out", out.to_str().unwrap()]).chain(more)))
}

/// Waits until all four nodes can be reached, and returns where the configuration for `name` is.
fn await_bench(bench: &str, name: &str) -> (PathBuf, Vec<String>) {
    let until = Instant::now() + HUNG;
    loop {
        let shown = run(["keys", "show", bench, "--node", name, "--path"]);
        if shown.code() == 0 {
            let path = PathBuf::from(shown.stdout.trim());
            let endpoints = json(&path)["connect"]["endpoints"].as_array().cloned().unwrap_or_default();
            let endpoints: Vec<_> = endpoints.iter().filter_map(|e| e.as_str().map(String::from)).collect();
            // Four nodes and the launcher.
            if endpoints.len() == 5 {
                return (path, endpoints);
            }
        }
        assert!(Instant::now() < until, "the bench does not begin: {}", shown.stderr);
    }
}

/// An attacker that publishes on topics of others.
struct Forger {
    bus: Bus,
    command: Publisher<Command>,
    truth: Publisher<Truth>,
    health: Publisher<Health>,
    heard: Subscriber<Truth>,
    hears: bool,
}

impl Forger {
    fn new(config: &BusConfig) -> Self {
        let bus = Bus::open(config).unwrap();
        Self {
            command: bus.publisher().unwrap(),
            truth: bus.publisher().unwrap(),
            health: bus.publisher_as("plant").unwrap(),
            heard: bus.subscriber(64).unwrap(),
            hears: false,
            bus,
        }
    }

    /// Publishes a command for the plant, a truth of the first step, and a health message in the plant's name.
    fn forge(&mut self, command: bool) {
        // A forger always receives its own messages as well.
        while let Ok(Some(truth)) = self.heard.try_recv() {
            self.hears |= truth.x[0] != FORGED;
        }
        let mut forged = Command { count: 2, ..Message::zeroed() };
        forged.u = [FORGED; 8];
        if command {
            self.command.send(&forged).unwrap();
        }
        let mut truth = Truth { states: 4, inputs: 2, ..Message::zeroed() };
        truth.x = [FORGED; 16];
        self.truth.send(&truth).unwrap();
        let count = FORGED.to_bits();
        let mut health =
            Health { steps: count, deadline_misses: u64::MAX - 484, pid: 1, ..Message::zeroed() };
        health.state = NodeState::Running as u32;
        health.set_node_name("plant");
        self.health.send(&health).unwrap();
    }
}

/// Attacks until the run has ended.
fn attack(mut running: Running, forgers: &mut [Forger], command: bool) -> Finished {
    let until = Instant::now() + HUNG;
    while running.is_alive() {
        assert!(Instant::now() < until, "the run does not end");
        forgers.iter_mut().for_each(|f| f.forge(command));
        let bus = &forgers[0].bus;
        bus.wait_until(Instant::now() + PAUSE, || Ok::<_, ()>(false)).unwrap();
    }
    running.finish()
}

fn logs(out: &Path) -> Vec<PathBuf> {
    let files = std::fs::read_dir(out).unwrap().flatten().map(|e| e.path());
    files.filter(|p| p.extension().is_some_and(|e| e == "mcap")).collect()
}

/// Number of messages of a log that contain the mark of a forgery.
fn forged_in(log: &Path) -> usize {
    let bytes = std::fs::read(log).unwrap();
    let mark = FORGED.to_le_bytes();
    let messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    messages.filter(|m| m.data.windows(8).any(|w| w == mark)).count()
}

fn first_run(out: &Path) -> Value {
    json(out.join("summary.json"))["runs"][0].clone()
}

fn with_file(bench: &str, file: &Path) -> BusConfig {
    let mut config = BusConfig::new(bench, "plant", Transport::Zenoh);
    config.zenoh.config = Some(file.into());
    config
}

fn nobody_else_can_fly_forge_or_kill_a_running_bench() {
    let dir = tempfile::tempdir().unwrap();
    let bench = unique("attacked");
    let running = start(&bench, dir.path(), &[]);
    let (observer, endpoints) = await_bench(&bench, "observer");
    let (guest, _) = await_bench(&bench, "guest");
    assert!(endpoints.iter().all(|e| e.starts_with("tls/127.0.0.1:")), "{endpoints:?}");

    let mut plain = BusConfig::new(&bench, "plant", Transport::Zenoh);
    plain.zenoh.connect = endpoints.iter().map(|e| e.replace("tls/", "tcp/")).collect();
    let mut foreign_key = BusConfig::new(&bench, "plant", Transport::Zenoh);
    foreign_key.zenoh.connect = endpoints;
    let identity = Authority::new("mine").unwrap().issue("plant", &["127.0.0.1".into()]).unwrap();
    let anything = Member { name: "plant".into(), writes: Writes::AllBut(Vec::new()) };
    foreign_key.zenoh.protection = Some(Protection { identity, members: vec![anything] });
    let who = [plain, foreign_key, with_file(&bench, &observer), with_file(&bench, &guest)]
        .map(|c| Forger::new(&c));
    let mut forgers = who;
    let ended = attack(running, &mut forgers, true);

    let hears = forgers.each_ref().map(|f| f.hears);
    assert_eq!(hears, [false, false, true, true], "strangers hear nothing, the user's own programs do");
    let flown = first_run(dir.path());
    assert_eq!(flown["ended"]["how"], "complete", "{}", ended.stderr);
    assert_eq!((&flown["steps"], &flown["ended"]["restarts"]), (&800.into(), &serde_json::json!({})));
    let misses = flown["timing"]["nodes"]["plant"]["deadline_misses"].as_u64().unwrap();
    assert!(misses <= 800, "{misses}");
    assert_eq!(logs(dir.path()), [dir.path().join("log.mcap")]);
    assert_eq!(forged_in(&dir.path().join("log.mcap")), 0);
}

/// The attack of the test above without protection, and the guarantees that hold even then.
fn on_an_open_bench_counts_saturate_files_are_bounded_and_no_node_is_killed() {
    let dir = tempfile::tempdir().unwrap();
    let bench = unique("open");
    let running = start(&bench, dir.path(), &["--set", "security.mode=open"]);
    let (_, endpoints) = await_bench(&bench, "observer");
    let mut config = BusConfig::new(&bench, "plant", Transport::Zenoh);
    config.zenoh.connect = endpoints;
    let mut forgers = [Forger::new(&config)];
    let ended = attack(running, &mut forgers, false);

    let flown = first_run(dir.path());
    assert_eq!(flown["ended"]["how"], "complete", "{}", ended.stderr);
    assert_eq!(flown["ended"]["restarts"], serde_json::json!({}), "{}", ended.stderr);
    let logs = logs(dir.path());
    assert!((2..=4).contains(&logs.len()), "one for each start that the plant may have: {logs:?}");
    assert!(logs.iter().map(|l| forged_in(l)).sum::<usize>() > 0, "the attack reaches an open bench");
    assert!(ended.stderr.contains("Truth restarts"), "{}", ended.stderr);
    assert!(ended.stderr.contains("a Health message named 'plant'"), "{}", ended.stderr);
}

fn a_node_by_hand_finds_the_secret_of_its_user() {
    let dir = tempfile::tempdir().unwrap();
    let bench = unique("by-hand");
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let same = ["--transport", "zenoh", "--mode", "lockstep", "--duration", "4", "--bench", &bench];
    let by_hand = ["node", "controller", "--launch", "quadrotor", "--listen", &endpoint];
    let _controller = spawn(whirlstand(by_hand.iter().chain(&same)));
    let mut here = whirlstand(["run", "quadrotor", "--set", "nodes.controller.external=true"]);
    here.args(same).args(["--set", "expect={}", "--out"]).arg(dir.path());
    for node in ["plant", "estimator", "recorder"] {
        here.args(["--set", &format!("nodes.{node}.connect=[\"{endpoint}\"]")]);
    }
    spawn(here).finish().success();
    assert_eq!(first_run(dir.path())["steps"], 800);
    let gone = run(["keys", "show", &bench]);
    assert_eq!(gone.code(), 2, "{}", gone.stdout);
    assert!(gone.stderr.contains("no bench"), "{}", gone.stderr);
}

/// Runs with settings that must be refused before anything is started.
#[track_caller]
fn refused(settings: &[&str], said: &[&str]) {
    let dir = tempfile::tempdir().unwrap();
    let settings = settings.iter().flat_map(|s| ["--set", *s]);
    let out = ["--out", dir.path().to_str().unwrap()];
    let ended = run(["run", "quadrotor", "--transport", "zenoh", "--duration", "1"]
        .into_iter()
        .chain(settings)
        .chain(out));
    assert_eq!(ended.code(), 2, "{}", ended.stderr);
    for word in said {
        assert!(ended.stderr.contains(word), "{word} is missing in {}", ended.stderr);
    }
}

fn protection_by_halves_is_refused_and_what_is_missing_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let keys = dir.path().join("keys");
    run(["keys", "new", keys.to_str().unwrap()]).success();
    let again = run(["keys", "new", keys.to_str().unwrap()]);
    assert!(again.code() == 2 && again.stderr.contains("not empty"), "{}", again.stderr);

    let file = dir.path().join("half.json5");
    let tls = format!(
        "transport: {{ link: {{ tls: {{ listen_certificate: '{0}/plant.pem', listen_private_key: '{0}/plant.key' }} }} }}",
        keys.display()
    );
    std::fs::write(&file, format!("{{ {tls} }}")).unwrap();
    let half = format!("zenoh.config={}", file.display());
    refused(&[&half], &["TLS is set up by halves", "listen.endpoints has 'tcp/127.0.0.1:0'", "half.json5"]);

    refused(&["security.mode=tls"], &["keys = \"FOLDER\"", "keys new"]);
    refused(&["security.keys=x"], &["mode = \"tls\""]);
    refused(&["zenoh.listen=[\"tcp/0.0.0.0:0\"]"], &["tcp/0.0.0.0:0", "mode = \"tls\"", "mode = \"open\""]);
    refused(
        &["nodes.plant.connect=[\"tcp/192.0.2.9:7447\"]", "security.mode=secret"],
        &["192.0.2.9", "mode = \"tls\""],
    );
    std::fs::remove_file(keys.join("controller.key")).unwrap();
    let folder = format!("security.keys={}", keys.display());
    refused(&["security.mode=tls", &folder], &["controller.key cannot be read", "keys new"]);
}

fn keys_made_before_protect_a_bench_as_well() {
    let dir = tempfile::tempdir().unwrap();
    let keys = dir.path().join("keys");
    run(["keys", "new", keys.to_str().unwrap(), "--host", "192.0.2.1", "--node", "viewer"]).success();
    assert!(keys.join("viewer.key").is_file());
    let out = dir.path().join("out");
    let set = format!("security.keys={}", keys.display());
    let bench = unique("made-before");
    let args = ["--mode", "lockstep", "--set", "security.mode=tls", "--set", &set];
    start(&bench, &out, &args).finish().success();
    assert_eq!(first_run(&out)["steps"], 800);
}

/// The names of these tests, and what they do.
macro_rules! named {
    ($($test:ident),+ $(,)?) => { vec![$(Test::new(stringify!($test), $test)),+] };
}

/// Sessions over TLS are opened here, in the process of the tests.
fn main() -> ExitCode {
    let (name, value) = ONE_THREAD;
    // SAFETY: no other thread runs yet.
    unsafe { set_var(name, value) };
    run_tests(named!(
        nobody_else_can_fly_forge_or_kill_a_running_bench,
        on_an_open_bench_counts_saturate_files_are_bounded_and_no_node_is_killed,
        a_node_by_hand_finds_the_secret_of_its_user,
        protection_by_halves_is_refused_and_what_is_missing_is_named,
        keys_made_before_protect_a_bench_as_well,
    ))
}
