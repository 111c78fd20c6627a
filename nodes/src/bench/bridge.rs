//! Latency of the bridges, from the wire over the bus and back to the wire, compared with a bare echo on the
//! same kind of wire.
//!
//! This process is the other end of the wire: it sends an attitude and waits for the resulting channel value.
//! The bridge is the node as it runs on a bench; on the bus a thread answers each `Imu` with a `Command`. The
//! echo is a thread that returns what it receives. Both are measured at the same pace, one after the other.

use std::io::{Read, Write};
use std::net::UdpSocket;
use std::os::fd::OwnedFd;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use whirlstand_bridge::arming::ArmBy;
use whirlstand_bridge::config::{BridgeConfig, BridgeKind, BridgeOptions, CrsfConfig, Pace};
use whirlstand_bridge::crsf;
use whirlstand_bridge::mavlink::{Deframer, Encoder, Event, MavMessage, dialect};
use whirlstand_bus::{Bus, Transport};
use whirlstand_msgs::{Command, Imu, Message};
use whirlstand_vehicle::Vehicle;

use super::measured_bench::config;
use super::round_trips::{Exchange, PERIOD, RoundTrips};
use super::{BenchError, Figure, Options};
use crate::NodeError;
use crate::bridge::link::{Address, Link};
use crate::bridge::vehicle::run_vehicle;
use crate::config::{Mode, NodeConfig, Role};
use crate::os::StopFlag;
use crate::setup::Setup;

/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(5);
const PATIENCE_S: f64 = PATIENCE.as_secs() as f64;

pub(super) fn bridges(options: &Options) -> Result<Vec<Figure>, BenchError> {
    let mut figures = Vec::new();
    for measure in [mavlink, crsf_line] {
        figures.extend(measure(options.seconds)?);
    }
    Ok(figures)
}

fn mavlink(seconds: f64) -> Result<Vec<Figure>, BenchError> {
    let echo = udp_echo(seconds)?;
    let place = UdpSocket::bind("127.0.0.1:0").and_then(|s| s.local_addr()).map_err(failed("find a port"))?;
    let mavlink = serde_json::from_value(serde_json::json!({
        "link": format!("udpin://{place}"), "pace": "telemetry", "message_rate_hz": 0.0
    }))
    .map_err(|e| BenchError::Member { who: "the bridge".into(), why: e.to_string() })?;
    let options = BridgeOptions { mavlink: Some(mavlink), ..BridgeOptions::default() };
    let wire = UdpSocket::bind("127.0.0.1:0").map_err(failed("open a socket"))?;
    wire.connect(place).map_err(failed("open a socket"))?;
    wire.set_read_timeout(Some(PATIENCE)).map_err(failed("open a socket"))?;
    let (mut autopilot, mut deframer) = (Encoder::new(1, 1), Deframer::new());
    let began = Instant::now();
    let mut buffer = [0; 1024];
    let mut time_boot_ms = 0;
    let mut exchange = |i: u32| {
        let now = began.elapsed();
        let mut bytes = Vec::with_capacity(128);
        if i.is_multiple_of(20) {
            let beat = dialect::HEARTBEAT_DATA {
                autopilot: dialect::MavAutopilot::MAV_AUTOPILOT_GENERIC,
                base_mode: dialect::MavModeFlag::empty(),
                ..Default::default()
            };
            autopilot.encode(&MavMessage::HEARTBEAT(beat), now, &mut bytes);
        }
        let (roll, us) = asked(i);
        // A time stamp that is not newer than the last is refused.
        time_boot_ms = (now.as_millis() as u32).max(time_boot_ms + 1);
        let attitude = dialect::ATTITUDE_DATA { time_boot_ms, roll: roll as f32, ..Default::default() };
        autopilot.encode(&MavMessage::ATTITUDE(attitude), now, &mut bytes);
        wire.send(&bytes).map_err(failed("send"))?;
        let until = Instant::now() + PATIENCE;
        loop {
            in_time(until)?;
            let length = wire.recv(&mut buffer).map_err(failed("wait for the bridge"))?;
            deframer.push(&buffer[..length]);
            while let Some(event) = deframer.next(now) {
                if let Event::Message(_, MavMessage::RC_CHANNELS_OVERRIDE(m)) = event
                    && m.chan1_raw.abs_diff(us) <= 1
                {
                    return Ok(());
                }
            }
        }
    };
    let bridged = with_bridge(BridgeKind::Mavlink, options, seconds, &mut exchange)?;
    Ok(figures("mavlink", "UDP", &bridged, &echo))
}

fn crsf_line(seconds: f64) -> Result<Vec<Figure>, BenchError> {
    let echo = pty_echo(seconds)?;
    let (wire, path) = pty()?;
    let link = format!("serial://{path}:{}", crsf::BAUD);
    let own = CrsfConfig { link, output_rate_hz: None, pace: Pace::Telemetry };
    let options = BridgeOptions { crsf: Some(own), ..BridgeOptions::default() };
    let mut parser = crsf::Parser::new();
    let mut exchange = |i: u32| {
        let (roll, us) = asked(i);
        let mut bytes = Vec::with_capacity(16);
        crsf::write_attitude(&crsf::Attitude { roll, pitch: 0.0, yaw: 0.0 }, &mut bytes);
        rustix::io::write(&wire, &bytes).map_err(|e| failed("send")(e.into()))?;
        let mut buffer = [0; 256];
        let until = Instant::now() + PATIENCE;
        loop {
            in_time(until)?;
            let length = read_line(&wire, &mut buffer)?;
            parser.push(&buffer[..length]);
            while let Some(event) = parser.next_event() {
                if let crsf::Event::Channels(c) = event
                    && (crsf::us_of_ticks(c.0[0]) - f64::from(us)).abs() <= 1.5
                {
                    return Ok(());
                }
            }
        }
    };
    let bridged = with_bridge(BridgeKind::Crsf, options, seconds, &mut exchange)?;
    Ok(figures("crsf", "a pseudo-terminal", &bridged, &echo))
}

/// Periodic outputs arrive without an attitude as well.
fn in_time(until: Instant) -> Result<(), BenchError> {
    let late = || failed("wait for the bridge's answer")(std::io::ErrorKind::TimedOut.into());
    (Instant::now() < until).then_some(()).ok_or_else(late)
}

/// Roll angle of an exchange, rad, and the resulting channel, us.
fn asked(i: u32) -> (f64, u16) {
    let us = 1300 + (i * 37 % 401) as u16;
    ((f64::from(us) - 1500.0) / 500.0, us)
}

/// Runs the bridge, and a program on the bus that answers it, while the other end of the wire makes its
/// exchanges.
fn with_bridge(
    kind: BridgeKind,
    mut options: BridgeOptions,
    seconds: f64,
    exchange: &mut Exchange<'_>,
) -> Result<RoundTrips, BenchError> {
    options.safety.arm = ArmBy::Start;
    options.safety.recover_after_s = Some(0.05);
    // A pause of a busy machine counts as a long latency here, not as a failure.
    let safety = &mut options.safety;
    (safety.stale_s, safety.command_timeout_s, safety.link_timeout_s) = (PATIENCE_S, PATIENCE_S, PATIENCE_S);
    let mut bench = config("bridge", Transport::Iceoryx2, Mode::Realtime, u64::MAX / 2)?;
    bench.period_ns = PERIOD.as_nanos() as u64;
    bench.peers = Vec::new();
    let bridge = BridgeConfig { kind, options };
    bench.bridge = Some(bridge.clone());
    let stop = StopFlag::default();
    std::thread::scope(|scope| {
        let answering = scope.spawn(|| answer(&bench, &stop));
        let bridging = scope.spawn(|| run_vehicle(&bench, &bridge, &stop));
        let result = begin(exchange, || answering.is_finished() || bridging.is_finished())
            .and_then(|()| RoundTrips::take(seconds, exchange));
        stop.set();
        for (who, ended) in [
            ("the program on the bus", answering.join().map(|r| r.err())),
            ("the bridge", bridging.join().map(|r| r.err())),
        ] {
            let why = match ended {
                Ok(None) => continue,
                Ok(Some(e)) => e.to_string(),
                Err(_) => "it panicked".into(),
            };
            return Err(BenchError::Member { who: who.into(), why });
        }
        result
    })
}

/// The first exchanges fail until all parts are connected.
fn begin(exchange: &mut Exchange<'_>, ended: impl Fn() -> bool) -> Result<(), BenchError> {
    let until = Instant::now() + 4 * PATIENCE;
    loop {
        match exchange(0) {
            Ok(()) => return Ok(()),
            Err(e) if ended() || Instant::now() > until => return Err(e),
            Err(_) => {}
        }
    }
}

/// Answers each `Imu` with the command that moves the channel in proportion to its roll.
fn answer(bench: &NodeConfig, stop: &StopFlag) -> Result<(), NodeError> {
    let full = Vehicle::builtin("quadrotor").map_or(1.0, |v| v.inputs[0].upper);
    let bus = Bus::open(&Setup::bus_config(bench, Role::Controller))?;
    let mut imus = bus.subscriber::<Imu>(64)?;
    let mut commands = bus.publisher::<Command>()?;
    while !stop.is_set() {
        bus.wait_until(Instant::now() + Duration::from_millis(50), || {
            while let Some(imu) = imus.try_recv()? {
                let mut command = Command { head: imu.head, count: 2, ..Command::zeroed() };
                command.u[0] = imu.roll * full;
                commands.send(&command)?;
            }
            Ok::<_, NodeError>(false)
        })?;
    }
    Ok(())
}

fn udp_echo(seconds: f64) -> Result<RoundTrips, BenchError> {
    let open = || UdpSocket::bind("127.0.0.1:0").map_err(failed("open a socket"));
    let (here, there) = (open()?, open()?);
    let place = there.local_addr().map_err(failed("open a socket"))?;
    here.connect(place).map_err(failed("open a socket"))?;
    here.set_read_timeout(Some(PATIENCE)).map_err(failed("open a socket"))?;
    std::thread::scope(|scope| {
        scope.spawn(move || {
            let mut buffer = [0; 1024];
            // An empty datagram ends it.
            while let Ok((length @ 1.., from)) = there.recv_from(&mut buffer) {
                let _ = there.send_to(&buffer[..length], from);
            }
        });
        let mut buffer = [0; 1024];
        let result = RoundTrips::take(seconds, &mut |i| {
            here.send(&[i as u8 | 1; 40]).map_err(failed("send"))?;
            here.recv(&mut buffer).map(drop).map_err(failed("wait for the echo"))
        });
        let _ = here.send(&[]);
        result
    })
}

fn pty_echo(seconds: f64) -> Result<RoundTrips, BenchError> {
    let (wire, path) = pty()?;
    // The serial settings of a link, without its management.
    let address: Address = format!("serial://{path}:{}", crsf::BAUD)
        .parse()
        .map_err(|e| BenchError::Member { who: "the echo".into(), why: format!("{e}") })?;
    let mut link = Link::new(address);
    link.maintain(Instant::now());
    let there =
        std::fs::OpenOptions::new().read(true).write(true).open(&path).map_err(failed("open a pty"))?;
    std::thread::scope(|scope| {
        scope.spawn(move || {
            let mut there = there;
            let mut buffer = [0; 256];
            // A single zero byte ends it.
            while let Ok(length @ 1..) = there.read(&mut buffer) {
                if buffer[..length] == [0] || there.write_all(&buffer[..length]).is_err() {
                    break;
                }
            }
        });
        let mut buffer = [0; 256];
        let result = RoundTrips::take(seconds, &mut |_| {
            let mut left = rustix::io::write(&wire, &[0x55; 26]).map_err(|e| failed("send")(e.into()))?;
            while left > 0 {
                left = left.saturating_sub(read_line(&wire, &mut buffer)?);
            }
            Ok(())
        });
        let _ = rustix::io::write(&wire, &[0]);
        result
    })
}

/// A pseudo-terminal: this end, and the path of the other end.
fn pty() -> Result<(OwnedFd, String), BenchError> {
    let open = || -> rustix::io::Result<(OwnedFd, String)> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let path = ptsname(&master, Vec::new())?;
        Ok((master, path.to_string_lossy().into_owned()))
    };
    open().map_err(|e| failed("open a pseudo-terminal")(e.into()))
}

/// Reads available bytes within the longest wait. While the other end is not open a read fails, and is
/// repeated.
fn read_line(wire: &OwnedFd, buffer: &mut [u8]) -> Result<usize, BenchError> {
    let mut polled = [PollFd::new(wire, PollFlags::IN)];
    let patience = Timespec { tv_sec: PATIENCE.as_secs() as i64, tv_nsec: 0 };
    match poll(&mut polled, Some(&patience)) {
        Ok(0) => Err(failed("wait for the other end")(std::io::ErrorKind::TimedOut.into())),
        Ok(_) => rustix::io::read(wire, buffer).map_err(|e| failed("read the line")(e.into())),
        Err(e) => Err(failed("read the line")(e.into())),
    }
}

fn failed(what: &'static str) -> impl Fn(std::io::Error) -> BenchError {
    move |source| BenchError::Process { what: what.into(), source }
}

fn figures(name: &str, wire: &str, bridged: &RoundTrips, echo: &RoundTrips) -> Vec<Figure> {
    let mut figures = echo.figures(&format!("bare echo over {wire}"), None);
    figures.extend(bridged.figures(&format!("{name}: {wire} to bus and back"), Some(echo)));
    figures
}
