//! The supervisor with small shell programs as nodes: what happens to them, and what is left of them.

use std::time::{Duration, Instant};

use super::*;

/// No test may take longer than this.
const HUNG: Duration = Duration::from_secs(30);

struct Silent;

impl HealthSource for Silent {
    fn next(&mut self) -> Option<whirlstand_msgs::Health> {
        None
    }

    fn locators(&self) -> Vec<String> {
        Vec::new()
    }

    fn reachable(&mut self, _: &[String]) {}

    fn node_died(&mut self) {}
}

/// Remembers what happened; kills the launcher's own test when a run hangs.
struct Watch {
    events: Vec<Event>,
    lines: Vec<(String, String)>,
    since: Instant,
}

impl Watch {
    fn new() -> Self {
        Self { events: Vec::new(), lines: Vec::new(), since: Instant::now() }
    }

    fn starts(&self, name: &str) -> usize {
        self.events.iter().filter(|e| matches!(e, Event::Started { node, .. } if node == name)).count()
    }
}

impl Observer for Watch {
    fn line(&mut self, node: &str, line: &str) {
        self.lines.push((node.into(), line.into()));
    }

    fn event(&mut self, event: &Event) {
        self.events.push(event.clone());
    }

    fn tick(&mut self, now: Instant, _: &HealthTable) -> Continuation {
        assert!(now.duration_since(self.since) < HUNG, "hung: {:?}", self.events);
        Continuation::GoOn
    }
}

fn sh(name: &str, script: &str) -> NodeSpec {
    NodeSpec {
        name: name.into(),
        command: CommandLine {
            program: "sh".into(),
            arguments: vec!["-c".into(), script.into()],
            env: Vec::new(),
            stdin: None,
        },
        readiness: Readiness::Start,
        max_restarts: 0,
        hang_timeout: Duration::from_secs(5),
        publishes_health: false,
        stop_timeout: Duration::from_secs(5),
        stop_stage: StopStage::Second,
        ends_run: false,
        needed: true,
    }
}

/// Ends the run as a plant does, after `script`.
fn plant(script: &str) -> NodeSpec {
    NodeSpec { ends_run: true, stop_stage: StopStage::First, ..sh("plant", script) }
}

fn run(nodes: Vec<NodeSpec>) -> (Outcome, Watch) {
    run_with(nodes, &mut Silent)
}

fn run_with(nodes: Vec<NodeSpec>, health: &mut dyn HealthSource) -> (Outcome, Watch) {
    let folder = tempfile::tempdir().unwrap();
    let spec =
        BenchSpec { nodes, exchange_locators: false, external: Vec::new(), folder: folder.path().into() };
    let mut watch = Watch::new();
    let outcome = supervise(spec, None, health, &mut watch).unwrap();
    (outcome, watch)
}

/// Waits for a file that the script makes, so that the order of things does not hang on time.
fn when(path: &std::path::Path) -> String {
    format!("while [ ! -e {} ]; do sleep 0.01; done", path.display())
}

#[test]
fn the_end_of_the_plant_ends_the_run_and_the_recorder_goes_last() {
    let folder = tempfile::tempdir().unwrap();
    let said = folder.path().join("order");
    let polite = |name: &str| {
        format!(
            "trap 'echo {name} >> {}; exit 0' TERM; touch {name}.up; while :; do sleep 0.01; done",
            said.display()
        )
    };
    let cd = |script: String| format!("cd {}; {script}", folder.path().display());
    let up = |name: &str| when(&folder.path().join(format!("{name}.up")));
    let recorder = NodeSpec { stop_stage: StopStage::Last, ..sh("recorder", &cd(polite("recorder"))) };
    let controller = sh("controller", &cd(polite("controller")));
    let plant = plant(&format!("{}; {}", up("recorder"), up("controller")));
    let (outcome, _) = run(vec![recorder, controller, plant]);
    assert_eq!(outcome.ending, Ending::Complete);
    assert_eq!(std::fs::read_to_string(said).unwrap(), "controller\nrecorder\n");
    assert!(outcome.killed_at_end.is_empty() && outcome.restarts.is_empty());
}

#[test]
fn a_node_that_fails_for_good_ends_the_run_with_its_last_words() {
    let (outcome, watch) =
        run(vec![plant("sleep 100"), sh("controller", "echo to stdout; echo no gain given >&2; exit 3")]);
    let Ending::Failed(failure) = &outcome.ending else { panic!("{:?}", outcome.ending) };
    assert_eq!((failure.node.as_str(), failure.how.as_str()), ("controller", "ended with exit code 3"));
    assert!(failure.last_lines.contains(&"no gain given".to_string()), "{failure:?}");
    assert!(failure.last_lines.contains(&"to stdout".to_string()), "{failure:?}");
    assert!(!failure.mendable);
    assert!(watch.lines.contains(&("controller".into(), "no gain given".into())));
}

#[test]
fn a_killed_node_is_started_again_as_often_as_its_policy_says() {
    let killed = NodeSpec { max_restarts: 2, ..sh("estimator", "kill -9 $$") };
    let (outcome, watch) = run(vec![plant("sleep 100"), killed]);
    let Ending::Failed(failure) = &outcome.ending else { panic!("{:?}", outcome.ending) };
    assert!(failure.how.contains("SIGKILL") && failure.how.contains("after 2 restarts"), "{}", failure.how);
    assert_eq!(watch.starts("estimator"), 3);
    assert_eq!(outcome.restarts, [("estimator".to_string(), 2)]);
}

#[test]
fn exit_code_2_is_not_tried_again() {
    let wrong = NodeSpec { max_restarts: 5, ..sh("estimator", "echo bad option; exit 2") };
    let (outcome, watch) = run(vec![plant("sleep 100"), wrong]);
    assert!(matches!(&outcome.ending, Ending::Failed(f) if f.mendable), "{:?}", outcome.ending);
    assert_eq!(watch.starts("estimator"), 1);
}

#[test]
fn a_program_that_cannot_be_started_is_named() {
    let mut missing = sh("controller", "");
    missing.command.program = "/no/such/program".into();
    let (outcome, _) = run(vec![plant("sleep 100"), missing]);
    let Ending::Failed(failure) = &outcome.ending else { panic!("{:?}", outcome.ending) };
    assert!(failure.how.contains("/no/such/program") && failure.mendable, "{failure:?}");
}

#[test]
fn whoever_does_not_become_ready_fails() {
    let silent = NodeSpec {
        readiness: Readiness::Notify(Duration::from_millis(50)),
        max_restarts: 5,
        ..sh("controller", "sleep 100")
    };
    let (outcome, watch) = run(vec![plant("sleep 100"), silent]);
    let Ending::Failed(failure) = &outcome.ending else { panic!("{:?}", outcome.ending) };
    assert!(
        failure.how.contains("not ready within 0.05 s") && failure.how.contains("READY=1"),
        "{failure:?}"
    );
    assert_eq!(watch.starts("controller"), 1, "a start that fails is not tried again");
}

#[test]
fn a_node_without_health_is_killed_as_hung() {
    let hung = NodeSpec {
        publishes_health: true,
        hang_timeout: Duration::from_millis(100),
        max_restarts: 1,
        ..sh("controller", "sleep 100")
    };
    let (outcome, watch) = run(vec![plant("sleep 100"), hung]);
    let Ending::Failed(failure) = &outcome.ending else { panic!("{:?}", outcome.ending) };
    assert!(failure.how.contains("no Health for 0.1 s"), "{failure:?}");
    assert_eq!(watch.starts("controller"), 2);
}

#[test]
fn whoever_ignores_the_end_is_killed_with_everything_it_started() {
    let folder = tempfile::tempdir().unwrap();
    let pid = folder.path().join("pid");
    // The grandchild ignores SIGTERM too, and would outlive its parent.
    let script = format!(
        "trap '' TERM; sh -c 'trap \"\" TERM; sleep 1000' & echo $! > {0}.new; mv {0}.new {0}; sleep 1000",
        pid.display()
    );
    let stubborn = NodeSpec { stop_timeout: Duration::from_millis(50), ..sh("controller", &script) };
    let (outcome, _) = run(vec![stubborn, plant(&when(&pid))]);
    assert_eq!(outcome.ending, Ending::Complete);
    assert_eq!(outcome.killed_at_end, ["controller"]);
    let pid: i32 = std::fs::read_to_string(&pid).unwrap().trim().parse().unwrap();
    let until = Instant::now() + HUNG;
    while is_alive(pid) {
        assert!(Instant::now() < until, "process {pid} is left behind");
        std::thread::yield_now();
    }
}

/// A zombie whose new parent has not yet collected it does nothing any more.
fn is_alive(pid: i32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit(')').next().and_then(|s| s.split_whitespace().next()).is_some_and(|state| state != "Z")
}

#[test]
fn a_further_program_may_end_before_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let done = folder.path().join("done");
    let helper = NodeSpec { needed: false, ..sh("helper", &format!("touch {}", done.display())) };
    let (outcome, _) = run(vec![plant(&when(&done)), helper]);
    assert_eq!(outcome.ending, Ending::Complete);
}

#[test]
fn standard_input_and_environment_reach_the_node() {
    let mut node = sh("echo", "cat; echo $GREETING; test -n \"$NOTIFY_SOCKET\"");
    node.command.stdin = Some("from the launcher\n".into());
    node.command.env = vec![("GREETING".into(), "hello".into())];
    node.ends_run = true;
    let (outcome, watch) = run(vec![node]);
    assert_eq!(outcome.ending, Ending::Complete);
    let lines: Vec<_> = watch.lines.iter().map(|(_, l)| l.as_str()).collect();
    assert_eq!(lines, ["from the launcher", "hello"]);
}

/// What the plant says of itself, and after each of its reports one in its name by somebody else.
struct Forged {
    pid: std::path::PathBuf,
    queue: Vec<whirlstand_msgs::Health>,
    last: Instant,
}

impl HealthSource for Forged {
    fn next(&mut self) -> Option<whirlstand_msgs::Health> {
        if self.queue.is_empty() && self.last.elapsed() > Duration::from_millis(20) {
            self.last = Instant::now();
            let pid = std::fs::read_to_string(&self.pid).ok().and_then(|pid| pid.trim().parse().ok());
            let report = |pid, deadline_misses| {
                let mut health =
                    whirlstand_msgs::Health { pid, deadline_misses, ..whirlstand_msgs::Message::zeroed() };
                health.set_node_name("plant");
                health
            };
            // The queue is taken from its end.
            self.queue.push(report(1, u64::MAX - 484));
            self.queue.extend(pid.map(|pid| report(pid, 3)));
        }
        self.queue.pop()
    }

    fn locators(&self) -> Vec<String> {
        Vec::new()
    }

    fn reachable(&mut self, _: &[String]) {}

    fn node_died(&mut self) {}
}

#[test]
fn a_health_in_the_name_of_a_node_neither_has_it_killed_nor_counts() {
    let folder = tempfile::tempdir().unwrap();
    let pid = folder.path().join("pid");
    let script = format!(
        "echo $$ > {0}.new; mv {0}.new {0}; i=0; while [ $i -lt 150 ]; do sleep 0.01; i=$((i+1)); done",
        pid.display()
    );
    let talking =
        NodeSpec { publishes_health: true, hang_timeout: Duration::from_millis(900), ..plant(&script) };
    let mut source = Forged { pid, queue: Vec::new(), last: Instant::now() };
    let (outcome, _) = run_with(vec![talking], &mut source);
    assert_eq!(outcome.ending, Ending::Complete);
    assert_eq!(outcome.health.get("plant").unwrap().counts().deadline_misses, 3);
}
