//! The links of an autopilot's protocol, by the protocol's own port numbers.

use std::os::fd::BorrowedFd;
use std::time::{Duration, Instant};

use whirlstand_bridge::autopilot::{Autopilot, AutopilotConfig, AutopilotKind};

use crate::bridge::link::{Link, LinkEvent, LinkSender, Received, wait_for_bytes};
use crate::error::NodeError;

/// Longest datagram, and the most that is read from a stream at once.
const BUFFER: usize = 65_536;

/// All links to the autopilot.
pub(in crate::bridge) struct Links {
    links: Vec<Link>,
    senders: Vec<LinkSender>,
    /// Why a link was lost since it was last asked.
    lost: Option<String>,
    buffer: Vec<u8>,
}

impl Links {
    /// Links that open as soon as they can.
    ///
    /// # Errors
    /// [`NodeError::Config`] for an address that is none.
    pub(in crate::bridge) fn new(options: &AutopilotConfig) -> Result<Self, NodeError> {
        let b = &options.betaflight;
        let addresses = match options.kind {
            AutopilotKind::Px4Hil => vec![("bridge.px4.link", options.px4.link.clone())],
            AutopilotKind::ArdupilotJson => vec![("bridge.ardupilot.link", options.ardupilot.link.clone())],
            AutopilotKind::BetaflightSitl => {
                let from = |port: u16| ("bridge.betaflight.bind", format!("udpin://{}:{port}", b.bind));
                let to = |port: u16| ("bridge.betaflight.host", format!("udpout://{}:{port}", b.host));
                let [raw, motors, state, channels] = b.ports;
                vec![from(raw), from(motors), to(state), to(channels)]
            }
        };
        let open =
            |(field, address): (&str, String)| {
                address.parse().map(Link::new).map_err(|e: crate::bridge::link::AddressError| {
                    NodeError::Config { field: field.into(), value: address, reason: e.to_string() }
                })
            };
        let links = addresses.into_iter().map(open).collect::<Result<Vec<_>, _>>()?;
        let senders = links.iter().map(Link::sender).collect();
        Ok(Self { links, senders, lost: None, buffer: vec![0; BUFFER] })
    }

    /// Opens what is closed, and hands everything that waits to the autopilot's protocol.
    pub(in crate::bridge) fn receive(&mut self, autopilot: &mut dyn Autopilot, now: Duration) {
        let Self { links, senders, lost, buffer } = self;
        for (port, link) in links.iter_mut().enumerate() {
            if !link.is_up() {
                match link.maintain(Instant::now()) {
                    Some(LinkEvent::Up) => tracing::info!("{} is open", link.address()),
                    Some(LinkEvent::Down(why)) => tracing::warn!("{why}"),
                    None => {}
                }
            }
            loop {
                match link.receive(buffer) {
                    Ok(Received::Nothing) => break,
                    Ok(Received::Stream(length) | Received::Datagram(length)) => {
                        autopilot.receive(port, &buffer[..length], now, &mut |to, bytes| {
                            if let Some(sender) = senders.get(to) {
                                sender.send(bytes);
                            }
                        });
                    }
                    Err(LinkEvent::Down(why)) => {
                        autopilot.disconnected(port);
                        *lost = Some(why);
                        break;
                    }
                    Err(LinkEvent::Up) => break,
                }
            }
        }
    }

    /// Why a link was lost since the last call, if one was.
    pub(in crate::bridge) fn take_lost(&mut self) -> Option<String> {
        self.lost.take()
    }

    /// Sends what can go out at once.
    pub(in crate::bridge) fn send(&mut self, port: usize, bytes: &[u8]) {
        if let Some(sender) = self.senders.get(port) {
            sender.send(bytes);
        }
    }

    /// Packets that could not be sent.
    pub(in crate::bridge) fn unsent(&self) -> u64 {
        self.senders.iter().map(LinkSender::dropped).sum()
    }

    /// What to poll for input.
    pub(in crate::bridge) fn fds(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        self.links.iter().filter_map(Link::fd)
    }

    /// Waits until something comes, or until `until`, awake for `look`; false when nothing came.
    pub(in crate::bridge) fn wait(&self, until: Instant, look: Duration) -> bool {
        wait_for_bytes(self.fds(), until, look)
    }
}
