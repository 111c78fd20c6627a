//! The bench card: a file beside the sockets of a running bench with the data that programs of the same user
//! need to join it.

use std::path::Path;

use serde::{Deserialize, Serialize};
use whirlstand_bus::{Bus, BusConfig, Transport, WaitStrategy};
use whirlstand_live::SwitchedEffect;
use whirlstand_nodes::config::{Engine, Mode, Role, VehicleSource};
use whirlstand_vehicle::Vehicle;

use super::remote::Remote;
use crate::cli::{OverrideArgs, WhichBenchArgs};
use crate::error::Failure;
use crate::exclusive::{running_benches, sockets_of};
use crate::file::{Plan, jobs, unknown};
use crate::keys::{configuration, write_private};

const FILE: &str = "bench.json";

/// Description of a running bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct BenchCard {
    /// Name of the bench.
    pub bench: String,
    /// Transport of its messages.
    pub transport: Transport,
    /// Clock of the loop: lockstep or real time.
    pub mode: Mode,
    /// Period of the loop, ns.
    pub period_ns: u64,
    /// The vehicle that the bench flies.
    pub vehicle: VehicleSource,
    /// State of the engine when the bench starts.
    pub engine: Engine,
    /// Effects of the vehicle and the launch file that can be switched.
    pub effects: Vec<SwitchedEffect>,
    /// Reason why the plant accepts neither gusts nor an engine state; `None` when it accepts them.
    pub plant_closed: Option<String>,
    /// Reason why the controller accepts neither setpoints nor a gain; `None` when it accepts them.
    pub controller_closed: Option<String>,
    /// Whether this process runs the bench in its own address space.
    #[serde(skip)]
    pub is_own: bool,
    /// How to join the bench when it runs on another host.
    #[serde(skip)]
    pub remote: Option<Remote>,
}

impl BenchCard {
    /// The card of a planned bench with the name `bench`.
    pub fn new(plan: &Plan, bench: &str) -> Self {
        let config = &plan.config;
        let (is_vehicle, is_autopilot) = match &config.bridge {
            Some(bridge) => (bridge.kind.is_vehicle(), !bridge.kind.is_vehicle()),
            None => (false, false),
        };
        let is_foreign = |role: Role| {
            let node = plan.nodes.iter().find(|n| n.role == Some(role));
            node.is_some_and(|n| n.section.exec.is_some())
        };
        let closed = |bridged: Option<&str>, role: Role, is_open: bool, key: &str| match bridged {
            Some(why) => Some(why.to_string()),
            None if is_foreign(role) => Some(format!("the {role} is an external program")),
            None if !is_open => Some(format!("--set {key}=true enables them")),
            None => None,
        };
        let vehicle = is_vehicle.then_some("the plant is a real vehicle");
        let autopilot = is_autopilot.then_some("an autopilot flies it");
        Self {
            bench: bench.into(),
            transport: config.transport,
            mode: config.mode,
            period_ns: config.period_ns,
            vehicle: config.vehicle.clone(),
            engine: config.plant.engine,
            effects: SwitchedEffect::all(&plan.vehicle),
            plant_closed: closed(vehicle, Role::Plant, config.plant.inject, "plant.inject"),
            controller_closed: closed(
                autopilot,
                Role::Controller,
                config.controller.pilot,
                "controller.pilot",
            ),
            is_own: false,
            remote: None,
        }
    }

    /// The card of the bench that the user selected.
    ///
    /// # Errors
    /// As [`BenchCard::of`] and [`BenchCard::elsewhere`].
    pub fn find(which: &WhichBenchArgs) -> Result<Self, Failure> {
        match &which.launch {
            Some(launch) => Self::elsewhere(&which.name, launch, &which.overrides, &which.connect),
            None if which.overrides != OverrideArgs::default() => Err(Failure::Mend(
                "options that change a launch file require --launch, for a bench on another host".into(),
            )),
            None => Self::of(&which.name),
        }
    }

    /// The card of a bench on another host, made from the launch file that it flies there; `connect` are endpoints
    /// of nodes that are not in that file.
    ///
    /// # Errors
    /// When the file cannot be read, and for a bench that cannot be reached from another host.
    fn elsewhere(
        bench: &str,
        launch: &str,
        overrides: &OverrideArgs,
        connect: &[String],
    ) -> Result<Self, Failure> {
        let run = jobs(launch, overrides, false)?.runs.into_iter().next();
        let mut plan = run.ok_or_else(|| Failure::Run("the launch file has no run".into()))?.plan;
        plan.config.bench = bench.into();
        let mut card = Self::new(&plan, bench);
        card.remote = Some(Remote::new(&plan, connect)?);
        Ok(card)
    }

    /// Writes the card into the folder of a bench's sockets, with which it is removed.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn leave_in(&self, sockets: &Path) -> Result<(), Failure> {
        let path = sockets.join(FILE);
        let text = serde_json::to_string(self).map_err(Failure::run)?;
        write_private(&path, &text).map_err(|e| Failure::file("write", &path, &e))
    }

    /// The card of a running bench of this user on this machine.
    ///
    /// # Errors
    /// When no such bench runs.
    fn of(bench: &str) -> Result<Self, Failure> {
        let absent = || {
            let running = running_benches().unwrap_or_default();
            let hint = match running.is_empty() {
                true => "no bench of yours runs on this machine".to_string(),
                false => unknown("bench", bench, running.iter().map(String::as_str)),
            };
            Failure::Mend(format!("no bench '{bench}' of yours runs here: {hint}"))
        };
        let sockets = sockets_of(bench)?.ok_or_else(absent)?;
        let text = std::fs::read_to_string(sockets.join(FILE)).map_err(|_| absent())?;
        serde_json::from_str(&text).map_err(|e| {
            Failure::Mend(format!("bench '{bench}' is run by another version of whirlstand: {e}"))
        })
    }

    /// Whether the bench is over.
    pub fn is_over(&self) -> bool {
        // For a bench on another host, only its plant can report the end.
        self.remote.is_none() && !matches!(sockets_of(&self.bench), Ok(Some(_)))
    }

    /// The vehicle of the bench.
    ///
    /// # Errors
    /// When its text cannot be read, although the bench could read it.
    pub fn vehicle(&self) -> Result<Vehicle, Failure> {
        Vehicle::parse(&self.vehicle.text, &self.vehicle.origin).map_err(Failure::mend)
    }

    /// Joins the bench as the outside member `guest` or `observer`.
    ///
    /// # Errors
    /// When the transport refuses, or the bench has no such member.
    pub fn join(&self, member: &str) -> Result<Bus, Failure> {
        if self.transport == Transport::Inproc && !self.is_own {
            let bench = &self.bench;
            return Err(Failure::Mend(format!(
                "bench '{bench}' runs in one process and cannot be reached from outside: start it with --transport \
                 iceoryx2 or zenoh"
            )));
        }
        let mut config = BusConfig::new(&self.bench, member, self.transport);
        match &self.remote {
            Some(remote) => remote.fill(member, &mut config)?,
            None if self.transport == Transport::Zenoh => {
                config.zenoh.config = Some(configuration(&self.bench, member)?);
            }
            None => {}
        }
        // A viewer must not take the processor from the nodes of the loop.
        config.wait = WaitStrategy::realtime();
        Bus::open(&config).map_err(Failure::mend)
    }

    /// The addresses at which `member` finds the other nodes. Over a network they change as nodes come and
    /// go.
    pub fn addresses(&self, member: &str) -> Option<String> {
        let changes = self.transport == Transport::Zenoh && self.remote.is_none();
        let path = changes.then(|| configuration(&self.bench, member).ok()).flatten();
        path.and_then(|path| std::fs::read_to_string(path).ok())
    }

    /// A line such as "bench lab over iceoryx2: open to ...", for the user who starts the bench.
    pub fn line(&self) -> String {
        let plant = ("gusts, engine", "inject, adjust", &self.plant_closed);
        let controller = ("setpoints, gain, stick", "pilot, adjust, stick", &self.controller_closed);
        let (open, closed): (Vec<_>, Vec<_>) =
            [plant, controller].into_iter().partition(|(_, _, closed)| closed.is_none());
        let open: Vec<_> = open.iter().map(|(what, topics, _)| format!("{what} (topics {topics})")).collect();
        let closed: Vec<_> = closed
            .iter()
            .map(|(what, _, why)| format!("{what} ({})", why.as_deref().unwrap_or_default()))
            .collect();
        let all = [("open to ", open), ("closed to ", closed)];
        let all = all.iter().filter(|(_, what)| !what.is_empty());
        let all: Vec<_> = all.map(|(how, what)| format!("{how}{}", what.join(" and "))).collect();
        format!("bench {} over {}: {}", self.bench, self.transport, all.join("; "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::keys::OBSERVER;

    fn card(launch: &str, set: &[&str]) -> BenchCard {
        let set = set.iter().map(|s| s.to_string()).collect();
        let jobs = jobs(launch, &OverrideArgs { set, ..Default::default() }, false).unwrap();
        BenchCard::new(&jobs.runs[0].plan, "lab")
    }

    #[test]
    fn a_card_says_what_can_be_asked_for_and_what_would_open_the_rest() {
        let closed = card("quadrotor", &[]);
        assert_eq!(
            closed.line(),
            "bench lab over iceoryx2: closed to gusts, engine (--set plant.inject=true enables them) and setpoints, gain, \
             stick (--set controller.pilot=true enables them)"
        );
        let open = card("quadrotor", &["plant.inject=true", "controller.pilot=true"]);
        assert_eq!(
            open.line(),
            "bench lab over iceoryx2: open to gusts, engine (topics inject, adjust) and setpoints, gain, stick (topics pilot, \
             adjust, stick)"
        );
        let px4 = card("quadrotor-px4", &["plant.inject=true", "controller.pilot=true"]);
        assert_eq!(px4.controller_closed.as_deref(), Some("an autopilot flies it"));
        assert_eq!(
            card("quadrotor-mavlink", &[]).plant_closed.as_deref(),
            Some("the plant is a real vehicle")
        );
    }

    #[test]
    fn a_bench_that_does_not_run_is_told_and_changes_nothing() {
        let error = BenchCard::of("no-such-bench-runs-here").unwrap_err().to_string();
        assert!(error.starts_with("no bench 'no-such-bench-runs-here' of yours runs here"), "{error}");
    }

    fn refused(set: &[&str], connect: &[&str]) -> String {
        let overrides =
            OverrideArgs { set: set.iter().map(|s| s.to_string()).collect(), ..Default::default() };
        let connect: Vec<_> = connect.iter().map(|s| s.to_string()).collect();
        BenchCard::elsewhere("lab", "quadrotor", &overrides, &connect).unwrap_err().to_string()
    }

    #[test]
    fn what_is_missing_to_reach_a_bench_elsewhere_is_told() {
        assert!(refused(&[], &["tcp/192.0.2.1:7447"]).contains("needs transport = \"zenoh\""));
        let zenoh = "transport=zenoh";
        assert!(refused(&[zenoh], &["tcp/192.0.2.1:7447"]).contains("mode = \"tls\" with keys"));
        assert!(refused(&[zenoh, "security.mode=open"], &[]).contains("--connect ENDPOINT"));
        let keys = ["transport=zenoh", "security.mode=tls", "security.keys=/no/such/keys"];
        assert!(refused(&keys, &["tls/192.0.2.1:7447"]).contains("observer.pem"));
    }

    #[test]
    fn the_launch_file_says_where_the_nodes_are() {
        let set = ["transport=zenoh", "security.mode=open", "nodes.plant.listen=[\"tcp/192.0.2.1:7447\"]"];
        let overrides = OverrideArgs { set: set.map(String::from).into(), ..Default::default() };
        let more = ["tcp/192.0.2.1:7448".to_string()];
        let card = BenchCard::elsewhere("lab", "quadrotor", &overrides, &more).unwrap();
        let mut config = BusConfig::new("lab", OBSERVER, Transport::Zenoh);
        card.remote.unwrap().fill(OBSERVER, &mut config).unwrap();
        assert_eq!(config.zenoh.connect, ["tcp/192.0.2.1:7447", "tcp/192.0.2.1:7448"]);
    }
}
