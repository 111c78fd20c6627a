//! From a plan to the processes of one bench.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use whirlstand_bus::{Bus, BusConfig, Subscriber, Transport};
use whirlstand_msgs::Health;
use whirlstand_nodes::config::{NodeConfig, Role};

use crate::error::Failure;
use crate::file::{Plan, PlannedNode, Ready, Restart};
use crate::supervisor::{BenchSpec, CommandLine, HealthSource, NodeSpec, Readiness, StopStage};

/// Longest part of a bench's name that is taken from the launch file's name.
const LONGEST_NAME: usize = 24;

/// A bench name that no other bench on this host has at this time.
pub(crate) fn unique_bench(name: &str) -> String {
    let head: String = plain(name).take(LONGEST_NAME).collect();
    // Process numbers are unique within one PID namespace only, and containers may share /dev/shm.
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    format!("{head}-{}-{:05x}", std::process::id(), (now.as_nanos() >> 10) & 0xf_ffff)
}

/// A name in letters that every file system and the bus take.
fn plain(name: &str) -> impl Iterator<Item = char> {
    name.chars().map(|c| if c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.') { c } else { '-' })
}

/// The launcher's subscription to the health of the bench.
pub(crate) struct Listener {
    bus: Bus,
    health: Subscriber<Health>,
    bench: String,
    refused: bool,
}

impl Listener {
    /// Joins the bench.
    ///
    /// # Errors
    /// When the transport refuses.
    pub fn open(config: &NodeConfig) -> Result<Self, Failure> {
        let mut own = BusConfig::new(&config.bench, "launcher", config.transport);
        own.zenoh = config.zenoh.clone();
        let bus = Bus::open(&own).map_err(Failure::mend)?;
        let health = bus.subscriber::<Health>(256).map_err(Failure::mend)?;
        Ok(Self { bus, health, bench: config.bench.clone(), refused: false })
    }

    /// The launcher's membership in the bench.
    pub fn bus(&self) -> &Bus {
        &self.bus
    }
}

impl HealthSource for Listener {
    fn next(&mut self) -> Option<Health> {
        match self.health.try_recv() {
            Ok(health) => health,
            Err(e) => {
                if !std::mem::replace(&mut self.refused, true) {
                    tracing::warn!("{e}");
                }
                None
            }
        }
    }

    fn locators(&self) -> Vec<String> {
        self.bus.locators().to_vec()
    }

    fn node_died(&mut self) {
        // The bench is in use, so only what dead nodes hold is taken away; what stays is swept at the end.
        if let Err(e) = whirlstand_bus::remove_residue(&self.bench) {
            tracing::warn!("{e}");
        }
    }
}

/// What the supervisor starts for a plan.
///
/// # Errors
/// When this executable cannot be found or the configuration cannot be written.
pub(crate) fn bench_spec(plan: &Plan, sockets: &Path, out: &Path) -> Result<BenchSpec, Failure> {
    let own = std::env::current_exe().map_err(|e| {
        Failure::Mend(format!("cannot find the whirlstand executable to start its nodes: {e}"))
    })?;
    let nodes = plan.nodes.iter().filter(|n| !n.section.external);
    let nodes = nodes.map(|node| node_spec(plan, node, &own, out)).collect::<Result<Vec<_>, _>>()?;
    Ok(BenchSpec {
        nodes,
        exchange_locators: plan.config.transport == Transport::Zenoh,
        folder: sockets.to_path_buf(),
    })
}

fn node_spec(plan: &Plan, node: &PlannedNode, own: &Path, out: &Path) -> Result<NodeSpec, Failure> {
    let section = &node.section;
    let command = match &section.exec {
        Some(exec) => foreign(plan, node, exec, own, out)?,
        None => native(plan, node, own)?,
    };
    Ok(NodeSpec {
        name: node.name.clone(),
        command,
        readiness: match section.ready {
            Ready::Notify => Readiness::Notify(Duration::from_secs_f64(section.ready_timeout_s.0)),
            Ready::Start => Readiness::Start,
        },
        max_restarts: match section.restart {
            Restart::Never => 0,
            Restart::OnFailure => section.max_restarts,
        },
        hang_timeout: Duration::from_secs_f64(section.hang_timeout_s.0),
        publishes_health: section.exec.is_none(),
        stop_timeout: Duration::from_secs_f64(section.stop_timeout_s.0),
        stop_stage: match node.role {
            Some(Role::Plant) => StopStage::First,
            Some(Role::Recorder) => StopStage::Last,
            _ => StopStage::Second,
        },
        ends_run: node.role == Some(Role::Plant),
        needed: node.role.is_some(),
    })
}

/// One of our own nodes: this executable again, with its configuration on standard input.
fn native(plan: &Plan, node: &PlannedNode, own: &Path) -> Result<CommandLine, Failure> {
    let mut config = plan.config.clone();
    if !node.section.listen.is_empty() {
        config.zenoh.listen = node.section.listen.clone();
    }
    config.zenoh.connect.extend(node.section.connect.iter().cloned());
    let text = serde_json::to_string(&config).map_err(Failure::run)?;
    Ok(CommandLine {
        program: own.into(),
        arguments: ["node", node.name.as_str(), "--config", "-"].map(Into::into).to_vec(),
        env: Vec::new(),
        stdin: Some(text),
    })
}

/// Any other program, told of the bench by its environment.
fn foreign(
    plan: &Plan,
    node: &PlannedNode,
    exec: &[String],
    own: &Path,
    out: &Path,
) -> Result<CommandLine, Failure> {
    let config = &plan.config;
    let listen = if node.section.listen.is_empty() { &config.zenoh.listen } else { &node.section.listen };
    let listen = if listen.is_empty() { "tcp/127.0.0.1:0".to_string() } else { listen.join(",") };
    let connect: Vec<_> = config.zenoh.connect.iter().chain(&node.section.connect).cloned().collect();
    let mut env = vec![
        ("WHIRLSTAND_BENCH".to_string(), config.bench.clone()),
        ("WHIRLSTAND_NODE".into(), node.name.clone()),
        ("WHIRLSTAND_TRANSPORT".into(), config.transport.to_string()),
        ("WHIRLSTAND_RATE_HZ".into(), (1e9 / config.period_ns as f64).to_string()),
        ("WHIRLSTAND_VEHICLE".into(), config.vehicle.origin.clone()),
        ("WHIRLSTAND_OUT".into(), out.to_string_lossy().into_owned()),
    ];
    if config.transport == Transport::Zenoh {
        env.push(("WHIRLSTAND_ZENOH_LISTEN".into(), listen));
        env.push(("WHIRLSTAND_ZENOH_CONNECT".into(), connect.join(",")));
    }
    env.extend(node.section.env.iter().map(|(k, v)| (k.clone(), v.clone())));
    let (program, arguments) = match node.section.realtime() {
        options if options == Default::default() => {
            let program = exec.first().cloned().unwrap_or_default();
            (program.into(), exec[1..].iter().map(Into::into).collect())
        }
        // This executable asks for the real-time options, says what is refused, and becomes the program.
        options => {
            let options = serde_json::to_string(&options).map_err(Failure::run)?;
            let mut arguments: Vec<_> = ["exec", "--realtime", &options, "--"].map(Into::into).to_vec();
            arguments.extend(exec.iter().map(Into::into));
            (own.into(), arguments)
        }
    };
    Ok(CommandLine { program, arguments, env, stdin: None })
}

/// Default folder of a run: `out/NAME-DATE-TIME`, in UTC. The name may be that of a file, in any letters.
pub(crate) fn default_out(name: &str) -> PathBuf {
    let stamp = humantime::format_rfc3339_seconds(SystemTime::now()).to_string();
    let stamp: String = stamp.trim_end_matches('Z').replace('T', "-").replace(':', "");
    let name: String = plain(name).collect();
    PathBuf::from("out").join(format!("{}-{stamp}", name.trim_start_matches('.')))
}

/// Removes what killed processes left of a bench in shared memory.
///
/// # Errors
/// When something is left that cannot be removed.
pub(crate) fn sweep(bench: &str) -> Result<(), Failure> {
    whirlstand_bus::remove_residue(bench)
        .map(|_| ())
        .map_err(|e| Failure::Run(format!("shared memory of the bench {bench} is left behind: {e}")))
}

/// A timer that is due once a period, for lines that shall not come too often.
#[derive(Debug)]
pub(crate) struct PeriodicTimer {
    period: Duration,
    due: Instant,
}

impl PeriodicTimer {
    /// First due one period from now.
    pub fn new(period: Duration, now: Instant) -> Self {
        Self { period, due: now + period }
    }

    /// Whether the timer is due; if so, the next time is one period later.
    pub fn is_due(&mut self, now: Instant) -> bool {
        let due = now >= self.due;
        if due {
            self.due = now + self.period;
        }
        due
    }
}
