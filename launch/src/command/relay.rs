//! `whirlstand relay`: connects a controller that is not a program of the bench.

use std::env::{VarError, var};
use std::net::UdpSocket;
use std::process::ExitCode;
use std::time::Duration;

use whirlstand_bus::{Bus, BusConfig, Transport, WaitStrategy};
use whirlstand_nodes::config::{Mode, Role};
use whirlstand_nodes::os::StopFlag;
use whirlstand_nodes::relay::ros2::{Ros2Options, RosNode, run_ros2};
use whirlstand_nodes::relay::run_udp;

use crate::cli::{RelayCommand, RelayRos2Args, RelayUdpArgs};
use crate::error::Failure;

/// The relay's place on a bench, from the environment that the launcher sets.
struct Place {
    bus: Bus,
    mode: Mode,
    period: Duration,
    node: String,
}

/// Runs the command.
pub(crate) fn relay(command: &RelayCommand) -> Result<ExitCode, Failure> {
    let place = Place::from_environment()?;
    let stop = StopFlag::on_signals().map_err(|e| Failure::Run(format!("cannot handle signals: {e}")))?;
    match command {
        RelayCommand::Udp(args) => udp(&place, args, &stop)?,
        RelayCommand::Ros2(args) => ros2(&place, args, &stop)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn udp(place: &Place, args: &RelayUdpArgs, stop: &StopFlag) -> Result<(), Failure> {
    if place.node != Role::Controller.name() {
        return Err(Failure::Mend(format!(
            "a UDP relay replaces the controller, but this node is '{}': write it under [nodes.controller]",
            place.node
        )));
    }
    let socket = UdpSocket::bind(args.listen)
        .map_err(|e| Failure::Mend(format!("--listen {}: cannot listen there: {e}", args.listen)))?;
    socket.connect(args.peer).map_err(|e| {
        Failure::Mend(format!("--peer {}: cannot be reached from {}: {e}", args.peer, args.listen))
    })?;
    run_udp(&place.bus, &socket, stop).map_err(Failure::run)
}

fn ros2(place: &Place, args: &RelayRos2Args, stop: &StopFlag) -> Result<(), Failure> {
    let domain = match (args.domain, var("ROS_DOMAIN_ID")) {
        (Some(domain), _) => domain,
        (None, Ok(text)) => text.parse().map_err(|_| {
            Failure::Mend(format!("ROS_DOMAIN_ID is '{text}': a number of at least 0 is expected"))
        })?,
        (None, Err(_)) => 0,
    };
    let right = |part: &str| {
        !part.is_empty()
            && !part.starts_with(|c: char| c.is_ascii_digit())
            && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    let namespace = args.namespace.trim_end_matches('/');
    if !namespace.split('/').skip(1).all(right) || !(namespace.is_empty() || namespace.starts_with('/')) {
        return Err(Failure::Mend(format!(
            "--namespace {}: / or names of letters, digits and _ with a / before each are expected, such as /lab/one",
            args.namespace
        )));
    }
    let options = Ros2Options {
        mode: place.mode,
        period: place.period,
        controls: place.node == Role::Controller.name(),
        node: RosNode {
            domain,
            namespace: if namespace.is_empty() { "/".into() } else { namespace.into() },
            name: "whirlstand".into(),
        },
        connect: args.connect.clone(),
        listen: args.listen.clone(),
    };
    run_ros2(&place.bus, &options, stop).map_err(Failure::run)
}

/// The value of an environment variable that the launcher sets.
fn told(name: &str) -> Result<String, Failure> {
    var(name).map_err(|e| match e {
        VarError::NotPresent => Failure::Mend(format!(
            "{name} is not set: a relay is started by a launch file, with exec = [\"whirlstand\", \"relay\", ...] under \
             [nodes.controller]"
        )),
        VarError::NotUnicode(_) => Failure::Mend(format!("{name} is not valid text")),
    })
}

impl Place {
    fn from_environment() -> Result<Self, Failure> {
        let wrong = |name: &str, text: &str| {
            Failure::Mend(format!("{name} is '{text}', which a launcher never sets"))
        };
        let (bench, node) = (told("WHIRLSTAND_BENCH")?, told("WHIRLSTAND_NODE")?);
        let name = "WHIRLSTAND_TRANSPORT";
        let text = told(name)?;
        let transport = text.parse::<Transport>().map_err(|_| wrong(name, &text))?;
        let name = "WHIRLSTAND_MODE";
        let mode = match told(name)?.as_str() {
            "realtime" => Mode::Realtime,
            "lockstep" => Mode::Lockstep,
            other => return Err(wrong(name, other)),
        };
        let name = "WHIRLSTAND_RATE_HZ";
        let text = told(name)?;
        let rate = text.parse::<f64>().ok().filter(|rate| *rate > 0.0).ok_or_else(|| wrong(name, &text))?;
        let mut config = BusConfig::new(bench, node.as_str(), transport);
        if mode == Mode::Lockstep {
            config.wait = WaitStrategy::lockstep();
        }
        if transport == Transport::Zenoh {
            let list = |name: &str| -> Result<Vec<String>, Failure> {
                Ok(told(name)?.split(',').filter(|e| !e.is_empty()).map(String::from).collect())
            };
            config.zenoh.listen = list("WHIRLSTAND_ZENOH_LISTEN")?;
            config.zenoh.connect = list("WHIRLSTAND_ZENOH_CONNECT")?;
            config.zenoh.config = Some(told("WHIRLSTAND_ZENOH_CONFIG")?.into());
        }
        let bus = Bus::open(&config).map_err(Failure::mend)?;
        Ok(Self { bus, mode, period: Duration::from_secs_f64(1.0 / rate), node })
    }
}
