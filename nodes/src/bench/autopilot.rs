//! Latency of the bridges to autopilots, from the bus to the wire and back, compared with a bare echo of the
//! same datagrams.
//!
//! This process is both the plant and the autopilot: it publishes a step, receives the sensors as the
//! autopilot, answers at once, and receives the command from the bus. The measured node is a separate
//! process, as is the echo.

use std::net::UdpSocket;
use std::time::{Duration, Instant};

use whirlstand_bridge::autopilot::{Begin, ardupilot, betaflight};
use whirlstand_bridge::config::{BridgeConfig, BridgeKind, BridgeOptions};
use whirlstand_bridge::mavlink::dialect::{
    HIL_ACTUATOR_CONTROLS_DATA, HilActuatorControlsFlags, MavModeFlag,
};
use whirlstand_bridge::mavlink::{Deframer, Encoder, Event, MavMessage};
use whirlstand_bus::{Bus, Publisher, Subscriber, Transport};
use whirlstand_msgs::{Command, Imu, Message, Truth, valid};

use super::fleet::Fleet;
use super::measured_bench::config;
use super::round_trips::{PERIOD, RoundTrips};
use super::{BenchError, Figure, Member, Options};
use crate::config::{Mode, Role};
use crate::setup::Setup;

/// Bytes of an echoed datagram: those of ArduPilot's servo packet.
const ECHO_BYTES: usize = 40;

/// Longest wait for any message.
const PATIENCE: Duration = Duration::from_secs(10);

/// Kinds of bridges that are measured.
const KINDS: [BridgeKind; 3] = [BridgeKind::Px4Hil, BridgeKind::ArdupilotJson, BridgeKind::BetaflightSitl];

/// Measures the echo, then each bridge.
pub(super) fn autopilots(options: &Options) -> Result<Vec<Figure>, BenchError> {
    let echo = echo(options)?;
    let mut figures = echo.figures("bare UDP echo between two processes", None);
    for kind in KINDS {
        figures.extend(bridge(options, kind)?.figures(&format!("{kind}: bus to wire and back"), Some(&echo)));
    }
    Ok(figures)
}

fn failed(why: &dyn std::fmt::Display) -> BenchError {
    BenchError::Member { who: "the bridge's other side".into(), why: why.to_string() }
}

fn process(what: &'static str) -> impl Fn(std::io::Error) -> BenchError {
    move |source| BenchError::Process { what: what.into(), source }
}

fn socket() -> Result<UdpSocket, BenchError> {
    let socket = UdpSocket::bind("127.0.0.1:0").map_err(process("bind a socket"))?;
    socket.set_read_timeout(Some(PATIENCE)).map_err(process("set a time limit"))?;
    Ok(socket)
}

/// A free port, for a process that is about to start.
fn free_port() -> Result<u16, BenchError> {
    socket()?.local_addr().map(|a| a.port()).map_err(process("ask for a port"))
}

fn echo(options: &Options) -> Result<RoundTrips, BenchError> {
    let port = free_port()?;
    let _fleet = Fleet::start(options, [("the echo".to_string(), Member::Echo { port })])?;
    let socket = socket()?;
    socket.connect(("127.0.0.1", port)).map_err(process("reach the echo"))?;
    socket.set_read_timeout(Some(Duration::from_millis(50))).map_err(process("set a time limit"))?;
    let mut buffer = [0; ECHO_BYTES];
    let until = Instant::now() + PATIENCE;
    // The child needs a moment to start; its port refuses until then.
    while socket.send(&buffer).is_err() || socket.recv(&mut buffer).is_err() {
        if Instant::now() > until {
            return Err(failed(&"the echo does not answer"));
        }
    }
    socket.set_read_timeout(Some(PATIENCE)).map_err(process("set a time limit"))?;
    RoundTrips::take(options.seconds, &mut |_| {
        socket.send(&buffer).and_then(|_| socket.recv(&mut buffer)).map_err(process("use the echo"))?;
        Ok(())
    })
}

/// Stand-in for the autopilot: receives sensors, sends outputs.
struct AutopilotStandIn {
    kind: BridgeKind,
    sensors: UdpSocket,
    peer: u16,
    encoder: Encoder,
    deframer: Deframer,
    number: u32,
    /// ArduPilot's last line, which may be repeated.
    line: Vec<u8>,
    buffer: Vec<u8>,
}

impl AutopilotStandIn {
    fn new(kind: BridgeKind) -> Result<(Self, BridgeOptions), BenchError> {
        let sensors = socket()?;
        let own = sensors.local_addr().map_err(process("ask for a port"))?.port();
        let peer = free_port()?;
        let mut options = BridgeOptions::default();
        options.flight.begin = Begin::Linked;
        options.flight.stale_s = 10.0;
        options.px4.link = format!("udpin://127.0.0.1:{peer}");
        options.ardupilot.link = format!("udpin://127.0.0.1:{peer}");
        options.betaflight.ports = [peer, free_port()?, own, free_port()?];
        let (encoder, deframer) = (Encoder::new(1, 1), Deframer::new());
        Ok((
            Self {
                kind,
                sensors,
                peer,
                encoder,
                deframer,
                number: 0,
                line: Vec::new(),
                buffer: vec![0; 2048],
            },
            options,
        ))
    }

    /// Sends the autopilot's first message.
    fn greet(&mut self) -> Result<(), BenchError> {
        match self.kind {
            BridgeKind::Px4Hil => self.controls(0),
            BridgeKind::ArdupilotJson => self.servos(),
            _ => Ok(()),
        }
    }

    /// Receives the sensors of a step and answers them.
    fn answer(&mut self) -> Result<(), BenchError> {
        loop {
            let length = self.sensors.recv(&mut self.buffer).map_err(process("receive sensors"))?;
            match self.kind {
                BridgeKind::Px4Hil => {
                    self.deframer.push(&self.buffer[..length]);
                    let mut time = None;
                    while let Some(event) = self.deframer.next(Duration::ZERO) {
                        if let Event::Message(_, MavMessage::HIL_SENSOR(sensor)) = event {
                            time = Some(sensor.time_usec);
                        }
                    }
                    if let Some(time) = time {
                        return self.controls(time);
                    }
                }
                BridgeKind::ArdupilotJson if self.line != self.buffer[..length] => {
                    self.line = self.buffer[..length].to_vec();
                    self.number += 1;
                    return self.servos();
                }
                BridgeKind::ArdupilotJson => {}
                _ if length == betaflight::FDM_BYTES => return self.pulses(),
                _ => {}
            }
        }
    }

    fn send(&self, bytes: &[u8]) -> Result<(), BenchError> {
        // Until the bridge's port is open, datagrams are lost, which is reported with the next one.
        let _ = self.sensors.send_to(bytes, ("127.0.0.1", self.peer));
        Ok(())
    }

    fn controls(&mut self, time_usec: u64) -> Result<(), BenchError> {
        let message = MavMessage::HIL_ACTUATOR_CONTROLS(HIL_ACTUATOR_CONTROLS_DATA {
            time_usec,
            flags: HilActuatorControlsFlags::empty(),
            controls: [0.5; 16],
            mode: MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED,
        });
        let mut bytes = Vec::new();
        self.encoder.encode(&message, Duration::ZERO, &mut bytes);
        self.send(&bytes)
    }

    fn servos(&self) -> Result<(), BenchError> {
        self.send(&ardupilot::ServoPacket::bytes(400, self.number, &[1500; 16]))
    }

    fn pulses(&self) -> Result<(), BenchError> {
        self.send(&betaflight::raw_bytes(4, &[1500.0; 16]))
    }
}

/// Stand-in for the plant: a vehicle at rest.
struct Standing {
    bus: Bus,
    truth: Publisher<Truth>,
    imu: Publisher<Imu>,
    commands: Subscriber<Command>,
}

impl Standing {
    fn publish(&mut self, step: u64) -> Result<(), BenchError> {
        let head = whirlstand_msgs::Head { seq: 0, step, stamp_ns: step * PERIOD.as_nanos() as u64 };
        let truth = Truth { head, states: 4, inputs: 2, ..Truth::zeroed() };
        let imu = Imu { head, valid: valid::FIRST | valid::SECOND, ..Imu::zeroed() };
        self.truth.send(&truth).map_err(crate::NodeError::from)?;
        Ok(self.imu.send(&imu).map_err(crate::NodeError::from)?)
    }

    /// Waits for the command of a step; false when it does not arrive in time.
    fn command(&mut self, step: u64, patience: Duration) -> Result<bool, BenchError> {
        let commands = &mut self.commands;
        let came = self.bus.wait_until(Instant::now() + patience, || {
            while let Some(command) = commands.try_recv().map_err(crate::NodeError::from)? {
                if command.head.step == step {
                    return Ok(true);
                }
            }
            Ok::<_, crate::NodeError>(false)
        })?;
        Ok(came)
    }
}

fn bridge(options: &Options, kind: BridgeKind) -> Result<RoundTrips, BenchError> {
    let (mut autopilot, bridge) = AutopilotStandIn::new(kind)?;
    let mut config = config(kind.name(), Transport::Iceoryx2, Mode::Realtime, u64::MAX)?;
    config.period_ns = PERIOD.as_nanos() as u64;
    config.bridge = Some(BridgeConfig { kind, options: bridge });
    let bus = Bus::open(&Setup::bus_config(&config, Role::Plant)).map_err(crate::NodeError::from)?;
    let mut plant = Standing {
        truth: bus.publisher().map_err(crate::NodeError::from)?,
        imu: bus.publisher().map_err(crate::NodeError::from)?,
        commands: bus.subscriber(64).map_err(crate::NodeError::from)?,
        bus,
    };
    let bench = config.bench.clone();
    let node = Member::Node { role: Role::Controller, config: Box::new(config) };
    let mut fleet = Fleet::start(options, [(kind.name().to_string(), node)])?;
    let until = Instant::now() + PATIENCE;
    // The first step is repeated, as by a plant, until the node is running and has answered.
    autopilot
        .sensors
        .set_read_timeout(Some(Duration::from_millis(20)))
        .map_err(process("set a time limit"))?;
    loop {
        autopilot.greet()?;
        plant.publish(0)?;
        let _ = autopilot.answer();
        if plant.command(0, Duration::from_millis(20))? {
            break;
        }
        if Instant::now() > until {
            return Err(failed(&format!("{kind} does not begin")));
        }
    }
    // Sensors streamed before the run are discarded.
    while autopilot.answer().is_ok() {}
    autopilot.sensors.set_read_timeout(Some(PATIENCE)).map_err(process("set a time limit"))?;
    let latencies = RoundTrips::take(options.seconds, &mut |i| {
        let step = u64::from(i) + 1;
        plant.publish(step)?;
        autopilot.answer()?;
        if plant.command(step, PATIENCE)? {
            return Ok(());
        }
        Err(failed(&format!("{kind} gave no command for step {step}")))
    })?;
    fleet.stop(kind.name());
    fleet.finish(kind.name())?;
    whirlstand_bus::remove_residue(&bench).map_err(|e| failed(&e))?;
    Ok(latencies)
}
