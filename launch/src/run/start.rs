//! Makes the processes of one bench from a plan.

use std::ffi::OsString;
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use whirlstand_bus::{
    Bus, BusConfig, LauncherToken, Subscriber, Transport, WaitStrategy, ZenohConfig, over_tls,
    zenoh_configuration,
};
use whirlstand_msgs::Health;
use whirlstand_nodes::config::{Mode, Role};

use crate::error::Failure;
use crate::exclusive::{Claim, OutFolder};
use crate::file::{Plan, PlannedNode, Ready};
use crate::keys::{BenchFolder, BenchKeys, GUEST, LAUNCHER, OBSERVER, write_private};
use crate::supervisor::{BenchSpec, CommandLine, Guard, HealthSource, NodeSpec, Readiness, StopStage};

/// Most characters of the launch file's name that become part of a bench's name.
const LONGEST_NAME: usize = 24;

/// A bench name that is unique on this host at this time.
pub(crate) fn unique_bench(name: &str) -> String {
    let head: String = plain(name).take(LONGEST_NAME).collect();
    // Process numbers are unique within one PID namespace only, and containers may share /dev/shm.
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    format!("{head}-{}-{:05x}", std::process::id(), (now.as_nanos() >> 10) & 0xf_ffff)
}

/// The characters of a name that every file system and the bus accept.
fn plain(name: &str) -> impl Iterator<Item = char> {
    name.chars().map(|c| if c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.') { c } else { '-' })
}

/// The launcher's subscription to the health of the bench.
pub(crate) struct Listener {
    // Dropped before the bus on which it was announced.
    _token: LauncherToken,
    bus: Bus,
    health: Subscriber<Health>,
    bench: String,
    /// Folder with the data that outside programs need to join.
    folder: Option<BenchFolder>,
    refused: bool,
}

impl Listener {
    /// Joins the bench as the launcher.
    ///
    /// # Errors
    /// When the transport refuses.
    pub fn open(plan: &Plan, keys: &BenchKeys, claim: &Claim) -> Result<Self, Failure> {
        let config = &plan.config;
        let mut own = BusConfig::new(&config.bench, LAUNCHER, config.transport);
        own.zenoh = config.zenoh.clone();
        let mut folder = None;
        if config.transport == Transport::Zenoh {
            own.zenoh.protection = keys.protection(LAUNCHER)?;
            folder = Some(BenchFolder::create(claim.keys(), joiners(plan, keys))?);
        }
        let bus = Bus::open(&own).map_err(Failure::mend)?;
        let token = bus.announce_launcher().map_err(Failure::mend)?;
        let health = bus.subscriber::<Health>(256).map_err(Failure::mend)?;
        let listener =
            Self { _token: token, bus, health, bench: config.bench.clone(), folder, refused: false };
        if let Some(folder) = &listener.folder {
            folder.update(&listener.locators())?;
        }
        Ok(listener)
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

    fn reachable(&mut self, locators: &[String]) {
        if let Some(Err(e)) = self.folder.as_ref().map(|folder| folder.update(locators)) {
            tracing::warn!("external programs cannot join: {e}");
        }
    }

    fn node_died(&mut self) {
        // The bench is in use, so only resources of dead nodes are removed; the rest is removed at the end.
        if let Err(e) = whirlstand_bus::remove_residue(&self.bench) {
            tracing::warn!("{e}");
        }
    }
}

/// Bus configurations of the members that may join without being started by the launcher: observer, guest, and the
/// nodes that the launch file calls external. The keys of external nodes need not be on this host.
fn joiners(plan: &Plan, keys: &BenchKeys) -> Vec<BusConfig> {
    let external = plan.nodes.iter().filter(|n| n.section.external);
    let external = external.map(|n| (n.name.as_str(), zenoh_of(plan, n)));
    let others = [OBSERVER, GUEST].map(|name| (name, plan.config.zenoh.clone()));
    let joiner = |(name, zenoh): (&str, ZenohConfig)| {
        let protection = keys.protection(name).ok()?;
        let mut config = BusConfig::new(&plan.config.bench, name, Transport::Zenoh);
        config.wait = wait_of(plan.config.mode);
        config.zenoh = ZenohConfig { protection, ..zenoh };
        Some(config)
    };
    others.into_iter().chain(external).filter_map(joiner).collect()
}

/// Endpoints on which a node listens and to which it connects.
fn zenoh_of(plan: &Plan, node: &PlannedNode) -> ZenohConfig {
    let mut zenoh = plan.config.zenoh.clone();
    if !node.section.listen.is_empty() {
        zenoh.listen = node.section.listen.clone();
    }
    zenoh.connect.extend(node.section.connect.iter().cloned());
    zenoh
}

/// How long a node waits for a slow link, which depends on the bench's mode.
fn wait_of(mode: Mode) -> WaitStrategy {
    match mode {
        Mode::Lockstep => WaitStrategy::lockstep(),
        Mode::Realtime => WaitStrategy::realtime(),
    }
}

/// The data from which the nodes of a bench are started.
struct Start<'a> {
    plan: &'a Plan,
    keys: &'a BenchKeys,
    /// Path of this executable.
    own: PathBuf,
    /// Output folder of the run.
    out: &'a Path,
    /// Folder for sockets and keys, which only this user can read.
    private: &'a Path,
}

/// The specification that the supervisor starts for a plan; `private` is a folder that only this user can
/// read.
///
/// # Errors
/// When this executable cannot be found, a key is missing, or the configuration cannot be written.
pub(crate) fn bench_spec(
    plan: &Plan,
    keys: &BenchKeys,
    private: &Path,
    out: &Path,
) -> Result<BenchSpec, Failure> {
    let start = Start { plan, keys, own: own_executable()?, out, private };
    let (external, nodes): (Vec<_>, Vec<_>) = plan.nodes.iter().partition(|n| n.section.external);
    Ok(BenchSpec {
        nodes: nodes.into_iter().map(|node| start.node(node)).collect::<Result<_, _>>()?,
        exchange_locators: plan.config.transport == Transport::Zenoh,
        external: external.into_iter().map(|n| n.name.clone()).collect(),
        folder: private.to_path_buf(),
    })
}

fn own_executable() -> Result<PathBuf, Failure> {
    std::env::current_exe()
        .map_err(|e| Failure::Mend(format!("cannot find the whirlstand executable to start its nodes: {e}")))
}

/// Starts the guard process, which ends the nodes and removes their files if the launcher is killed.
///
/// # Errors
/// When it cannot be started.
pub(crate) fn start_guard(spec: &BenchSpec, claim: &Claim, folder: &OutFolder) -> Result<Guard, Failure> {
    let grace = spec.nodes.iter().map(|node| node.stop_timeout).max().unwrap_or_default();
    let mut arguments: Vec<OsString> = ["guard", "--bench", claim.bench()].map(Into::into).to_vec();
    arguments.extend(["--grace".into(), grace.as_secs_f64().to_string().into()]);
    arguments.extend(["--sockets".into(), claim.sockets().into()]);
    for path in [Some(claim.sockets()), Some(claim.keys()), folder.lock_path(), Some(claim.path())]
        .into_iter()
        .flatten()
    {
        arguments.extend(["--remove".into(), path.into()]);
    }
    let line = CommandLine { program: own_executable()?.into(), arguments, env: Vec::new(), stdin: None };
    let locks: Vec<_> = [Some(claim.as_fd()), folder.lock_fd()].into_iter().flatten().collect();
    Guard::start(&line, &locks)
        .map_err(|e| Failure::Run(format!("the guard of the bench cannot be started: {e}")))
}

impl Start<'_> {
    fn node(&self, node: &PlannedNode) -> Result<NodeSpec, Failure> {
        let section = &node.section;
        let command = match &section.exec {
            Some(exec) => self.foreign(node, exec)?,
            None => self.native(node)?,
        };
        Ok(NodeSpec {
            name: node.name.clone(),
            command,
            readiness: match section.ready {
                Ready::Notify => Readiness::Notify(Duration::from_secs_f64(section.ready_timeout_s.0)),
                Ready::Start => Readiness::Start,
            },
            max_restarts: section.starts() - 1,
            hang_timeout: Duration::from_secs_f64(section.hang_timeout_s.0),
            publishes_health: section.exec.is_none(),
            stop_timeout: Duration::from_secs_f64(section.stop_timeout_s(node.role)),
            stop_stage: match node.role {
                Some(Role::Plant) => StopStage::First,
                Some(Role::Recorder) => StopStage::Last,
                _ => StopStage::Second,
            },
            ends_run: node.role == Some(Role::Plant),
            needed: node.role.is_some(),
        })
    }

    /// Command line of a built-in node: this executable, with the node's configuration, including its key, on
    /// standard input.
    fn native(&self, node: &PlannedNode) -> Result<CommandLine, Failure> {
        let mut config = self.plan.config.clone();
        config.zenoh = zenoh_of(self.plan, node);
        if config.transport == Transport::Zenoh {
            config.zenoh.protection = self.keys.protection(&node.name)?;
        }
        let text = serde_json::to_string(&config).map_err(Failure::run)?;
        Ok(CommandLine {
            program: self.own.clone().into(),
            arguments: ["node", node.name.as_str(), "--config", "-"].map(Into::into).to_vec(),
            env: Vec::new(),
            stdin: Some(text),
        })
    }

    /// Command line of a foreign program, to which environment variables describe the bench.
    fn foreign(&self, node: &PlannedNode, exec: &[String]) -> Result<CommandLine, Failure> {
        let config = &self.plan.config;
        let mode = match config.mode {
            Mode::Realtime => "realtime",
            Mode::Lockstep => "lockstep",
        };
        let mut env = vec![
            ("WHIRLSTAND_BENCH".to_string(), config.bench.clone()),
            ("WHIRLSTAND_NODE".into(), node.name.clone()),
            ("WHIRLSTAND_TRANSPORT".into(), config.transport.to_string()),
            ("WHIRLSTAND_MODE".into(), mode.into()),
            ("WHIRLSTAND_RATE_HZ".into(), (1e9 / config.period_ns as f64).to_string()),
            ("WHIRLSTAND_VEHICLE".into(), config.vehicle.origin.clone()),
            ("WHIRLSTAND_OUT".into(), self.out.to_string_lossy().into_owned()),
        ];
        if config.transport == Transport::Zenoh {
            env.extend(self.zenoh_env(node)?);
        }
        env.extend(node.section.env.iter().map(|(k, v)| (k.clone(), v.clone())));
        let (program, arguments) = match node.section.realtime() {
            options if options == Default::default() => {
                let program = exec.first().cloned().unwrap_or_default();
                (program.into(), exec[1..].iter().map(Into::into).collect())
            }
            // This executable requests the real-time options, reports refused ones, and becomes the program.
            options => {
                let options = serde_json::to_string(&options).map_err(Failure::run)?;
                let mut arguments: Vec<_> = ["exec", "--realtime", &options, "--"].map(Into::into).to_vec();
                arguments.extend(exec.iter().map(Into::into));
                (self.own.clone().into(), arguments)
            }
        };
        Ok(CommandLine { program, arguments, env, stdin: None })
    }

    /// Environment of a foreign program over Zenoh: the addresses on which it listens and connects, and the path
    /// of Zenoh's configuration file, which contains its key. The key is kept in a file: an environment is
    /// readable by fewer processes than a command line, but is inherited by more than need the key.
    fn zenoh_env(&self, node: &PlannedNode) -> Result<Vec<(String, String)>, Failure> {
        let mut bus = BusConfig::new(&self.plan.config.bench, &node.name, Transport::Zenoh);
        bus.wait = wait_of(self.plan.config.mode);
        bus.zenoh = zenoh_of(self.plan, node);
        bus.zenoh.protection = self.keys.protection(&node.name)?;
        if bus.zenoh.listen.is_empty() {
            bus.zenoh.listen.push("tcp/127.0.0.1:0".into());
        }
        if bus.zenoh.protection.is_some() {
            for endpoint in bus.zenoh.listen.iter_mut().chain(&mut bus.zenoh.connect) {
                *endpoint = over_tls(endpoint).map_err(Failure::Mend)?;
            }
        }
        let text = zenoh_configuration(&bus).map_err(Failure::mend)?;
        let file = self.private.join(format!("{}.json5", node.name));
        write_private(&file, &text).map_err(|e| Failure::file("write", &file, &e))?;
        Ok(vec![
            ("WHIRLSTAND_ZENOH_CONFIG".into(), file.to_string_lossy().into_owned()),
            ("WHIRLSTAND_ZENOH_LISTEN".into(), bus.zenoh.listen.join(",")),
            ("WHIRLSTAND_ZENOH_CONNECT".into(), bus.zenoh.connect.join(",")),
        ])
    }
}

/// Name of a run's own folder, before its date. `name` may be that of a file, with any characters.
pub(crate) fn folder_name(name: &str) -> String {
    let name: String = plain(name).collect();
    name.trim_start_matches('.').into()
}

/// Removes the shared memory that killed processes of a bench left.
///
/// # Errors
/// When some of it cannot be removed.
pub(crate) fn sweep(bench: &str) -> Result<(), Failure> {
    whirlstand_bus::remove_residue(bench)
        .map(|_| ())
        .map_err(|e| Failure::Run(format!("shared memory of the bench {bench} could not be removed: {e}")))
}

/// A timer that is due once per period, to limit how often a line is printed.
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

    /// Whether the timer is due. If so, it is next due one period later.
    pub fn is_due(&mut self, now: Instant) -> bool {
        let due = now >= self.due;
        if due {
            self.due = now + self.period;
        }
        due
    }
}
