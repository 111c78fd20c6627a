//! Unsolicited datagrams to the UDP ports of a bench's bridge.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};

use whirlstand_bridge::config::{BridgeConfig, BridgeKind};
use whirlstand_nodes::bridge::link::Address;

use super::again::Again;

/// Datagrams in one burst; with the pause between bursts, 10,000 a second.
const BURST: usize = 20;

/// Number of ports on which datagrams of Betaflight arrive: one for pulses and one for motors.
const FROM_BETAFLIGHT: usize = 2;

/// The UDP ports on which a bridge listens; empty for a bridge without such a link.
pub(super) fn udp_ports(bridge: Option<&BridgeConfig>) -> Vec<SocketAddr> {
    let Some(BridgeConfig { kind, options }) = bridge else { return Vec::new() };
    let listening = |link: &str| match link.parse() {
        Ok(Address::UdpIn(address)) => Some(reachable(address)),
        _ => None,
    };
    match kind {
        BridgeKind::Px4Hil => listening(&options.px4.link).into_iter().collect(),
        BridgeKind::ArdupilotJson => listening(&options.ardupilot.link).into_iter().collect(),
        BridgeKind::BetaflightSitl => {
            let Ok(host) = options.betaflight.bind.parse() else { return Vec::new() };
            let ports = options.betaflight.ports.iter().take(FROM_BETAFLIGHT);
            ports.map(|&port| reachable(SocketAddr::new(host, port))).collect()
        }
        // These bridges have no simulated plant whose recovery could be observed.
        BridgeKind::Mavlink | BridgeKind::Crsf => Vec::new(),
    }
}

/// Address at which a socket that is bound to every address can be reached from here.
fn reachable(address: SocketAddr) -> SocketAddr {
    let host = if address.ip().is_unspecified() { IpAddr::V4(Ipv4Addr::LOCALHOST) } else { address.ip() };
    SocketAddr::new(host, address.port())
}

/// Sends datagrams from one socket to each of the ports in turn.
pub(super) fn send(ports: Vec<SocketAddr>, datagrams: Vec<Vec<u8>>) -> io::Result<Again> {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    Again::start(move || {
        let mut next = 0;
        move || {
            for _ in 0..BURST {
                let datagram = &datagrams[next / ports.len() % datagrams.len()];
                // No process has the port while the bridge is being restarted.
                let _ = socket.send_to(datagram, ports[next % ports.len()]);
                next += 1;
            }
            BURST as u64
        }
    })
}

/// Malformed datagrams: single bytes, beginnings of frames, and arbitrary bytes.
pub(super) fn garbage() -> Vec<Vec<u8>> {
    let mut noise = whirlstand_vehicle::Stream::new(1, "garbage");
    let mut bytes = |n: usize| (0..n).map(|_| (256.0 * noise.uniform()) as u8).collect::<Vec<_>>();
    let without_sense: Vec<_> = (0..40).map(|n| bytes(3 * n)).collect();
    let beginnings = [vec![0xFD], vec![0xFE], vec![0], vec![0xFD; 40], vec![0xFD, 255, 0, 0, 1]];
    beginnings.into_iter().chain(without_sense).collect()
}

/// Valid output packets in the protocols of the autopilots, with every output at its limit.
pub(super) fn forged_outputs(kind: BridgeKind) -> Vec<Vec<u8>> {
    let words = |words: &[u16]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
    match kind {
        // Magic number, rate, step number (two words), sixteen pulses in us.
        BridgeKind::ArdupilotJson => vec![words(&[&[18458, 400, 1, 0][..], &[2000; 16]].concat())],
        // Pulses in us after a count, and motors from 0 to 1.
        BridgeKind::BetaflightSitl => {
            let floats = |value: f32, n: usize| value.to_le_bytes().repeat(n);
            vec![[words(&[16, 0]), floats(2000.0, 16)].concat(), floats(1.0, 4)]
        }
        BridgeKind::Px4Hil | BridgeKind::Mavlink | BridgeKind::Crsf => Vec::new(),
    }
}
