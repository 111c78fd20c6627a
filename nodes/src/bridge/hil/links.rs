//! Links of an autopilot's protocol, by the protocol's port numbers.

use std::ops::Add;
use std::os::fd::BorrowedFd;
use std::time::{Duration, Instant};

use whirlstand_bridge::autopilot::ardupilot::TELEMETRY as ARDUPILOT_MAVLINK;
use whirlstand_bridge::autopilot::betaflight::MSP;
use whirlstand_bridge::autopilot::px4::{STATION, TELEMETRY};
use whirlstand_bridge::autopilot::{Autopilot, AutopilotConfig, AutopilotKind};
use whirlstand_bridge::peer::{PeerCounts, SILENCE};

use crate::bridge::link::{
    Address, BUFFER, Decoder, Link, LinkEvent, LinkSender, configured, wait_for_bytes,
};
use crate::error::NodeError;

/// Silence after which a ground station may be replaced: its heartbeat is sent once per second, and a single
/// one may be lost.
const STATION_SILENCE: Duration = Duration::from_secs(3);

/// All links to the autopilot.
pub(in crate::bridge) struct Links {
    /// Links with the number of their port.
    links: Vec<(usize, Link)>,
    /// Number of links of the loop, which come first, before those of a ground station, of telemetry or of
    /// queries.
    loop_links: usize,
    /// True in flight, when connecting must not block.
    flies: bool,
    /// Bytes that the autopilot sends to a ground station, kept for a receiver in this process.
    overheard: Option<Vec<u8>>,
    senders: Vec<(usize, LinkSender)>,
    /// Reason for the loss of a link since the last query.
    lost: Option<String>,
    buffer: Vec<u8>,
}

impl Links {
    /// Links that open as soon as possible.
    ///
    /// # Errors
    /// [`NodeError::Config`] for an invalid address.
    pub(in crate::bridge) fn new(options: &AutopilotConfig) -> Result<Self, NodeError> {
        let (px4, ardupilot, b) = (&options.px4, &options.ardupilot, &options.betaflight);
        let links = match options.kind {
            AutopilotKind::Px4Hil => vec![configured("px4", "link", &px4.link, px4.peer, SILENCE)?],
            AutopilotKind::ArdupilotJson => {
                vec![configured("ardupilot", "link", &ardupilot.link, ardupilot.peer, SILENCE)?]
            }
            AutopilotKind::BetaflightSitl => {
                let from = |port: u16| {
                    configured("betaflight", "bind", &format!("udpin://{}:{port}", b.bind), b.peer, SILENCE)
                };
                let to = |port: u16| {
                    configured("betaflight", "host", &format!("udpout://{}:{port}", b.host), None, SILENCE)
                };
                let [raw, motors, state, channels] = b.ports;
                vec![from(raw)?, from(motors)?, to(state)?, to(channels)?]
            }
        };
        let loop_links = links.len();
        let mut links: Vec<_> = links.into_iter().enumerate().collect();
        let mut beside = |port: usize, table: &str, key: &str, place: &str| {
            debug_assert!(port >= loop_links);
            links.push((port, configured(table, key, place, None, STATION_SILENCE)?));
            Ok::<_, NodeError>(())
        };
        match options.kind {
            AutopilotKind::BetaflightSitl if !b.msp.is_empty() => beside(MSP, "betaflight", "msp", &b.msp)?,
            AutopilotKind::Px4Hil => {
                if let Some(forward) = &px4.forward {
                    beside(STATION, "px4", "forward", forward)?;
                }
                if let Some(telemetry) = px4.telemetry_place() {
                    beside(TELEMETRY, "px4", "telemetry", &telemetry)?;
                }
            }
            AutopilotKind::ArdupilotJson => {
                if let Some(telemetry) = ardupilot.telemetry_place() {
                    beside(ARDUPILOT_MAVLINK, "ardupilot", "telemetry", &telemetry)?;
                }
            }
            AutopilotKind::BetaflightSitl => {}
        }
        let senders = links.iter().map(|(port, link)| (*port, link.sender())).collect();
        Ok(Self {
            links,
            loop_links,
            flies: false,
            overheard: None,
            senders,
            lost: None,
            buffer: vec![0; BUFFER],
        })
    }

    /// Marks the beginning of the run.
    pub(in crate::bridge) fn begin(&mut self) {
        self.flies = true;
    }

    /// Keeps the bytes that the autopilot sends to a ground station, for [`Links::take_overheard`].
    pub(in crate::bridge) fn overhear(&mut self) {
        self.overheard.get_or_insert_default();
    }

    /// Bytes that the autopilot sent to a ground station since the last call.
    pub(in crate::bridge) fn take_overheard(&mut self) -> Vec<u8> {
        self.overheard.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// The serial link that PX4 uses both for its simulation and for its ground station.
    pub(in crate::bridge) fn shared_serial(&self) -> Option<&Address> {
        self.links
            .first()
            .map(|(_, link)| link.address())
            .filter(|address| matches!(address, Address::Serial { .. }))
    }

    /// Opens closed links, and passes waiting bytes, up to a limit, to the autopilot's protocol.
    pub(in crate::bridge) fn receive(&mut self, autopilot: &mut dyn Autopilot, now: Duration) {
        let Self { links, loop_links, flies, overheard, senders, lost, buffer } = self;
        let instant = Instant::now();
        for (port, link) in links {
            let port = *port;
            let connects = matches!(link.address(), Address::TcpOut(_)) && !link.is_up();
            if *flies && port >= *loop_links && connects {
                continue;
            }
            match link.maintain(instant) {
                Some(LinkEvent::Up) => tracing::info!("{} is open", link.address()),
                // Links outside the loop may be missing.
                Some(LinkEvent::Down(why)) if port >= *loop_links => tracing::info!("{why}"),
                Some(LinkEvent::Down(why)) => tracing::warn!("{why}"),
                Some(LinkEvent::Replaced(why)) => {
                    autopilot.disconnected(port);
                    tell_lost(lost, port < *loop_links, why);
                }
                None => {}
            }
            let is_loops = port < *loop_links;
            let mut protocol = Protocol {
                autopilot: &mut *autopilot,
                senders,
                overheard,
                port,
                is_loops,
                now,
                lost: &mut *lost,
            };
            if let Err(LinkEvent::Down(why)) = link.drain(buffer, instant, &mut protocol) {
                autopilot.disconnected(port);
                tell_lost(lost, is_loops, why);
            }
            while let Some((warn, text)) = link.take_note() {
                if warn {
                    tracing::warn!("{text}");
                } else {
                    tracing::info!("{text}");
                }
            }
        }
    }

    /// Endpoint on which the autopilot is awaited.
    pub(super) fn place(&self) -> String {
        let links = self.links.iter().take(self.loop_links);
        let places: Vec<_> =
            links.map(|(_, link)| link.address()).filter(|a| a.is_open()).map(Address::place).collect();
        match self.links.first() {
            Some((_, link)) if places.is_empty() => link.address().place(),
            _ => places.join(" and "),
        }
    }

    /// Number of datagrams and clients refused because of their sender.
    pub(in crate::bridge) fn refused(&self) -> PeerCounts {
        self.links.iter().map(|(_, link)| link.refused()).fold(PeerCounts::default(), PeerCounts::add)
    }

    /// Reason for the loss of a link since the last call, if any.
    pub(in crate::bridge) fn take_lost(&mut self) -> Option<String> {
        self.lost.take()
    }

    /// Sends as much as possible without waiting.
    pub(in crate::bridge) fn send(&mut self, port: usize, bytes: &[u8]) {
        send_to(&self.senders, port, bytes);
    }

    /// Number of packets that could not be sent.
    pub(in crate::bridge) fn unsent(&self) -> u64 {
        self.senders.iter().map(|(_, sender)| sender.dropped()).sum()
    }

    /// File descriptors to poll for input.
    pub(in crate::bridge) fn fds(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        self.links.iter().filter_map(|(_, link)| link.fd())
    }

    /// Waits for input until `until`, with busy polling for `look`; false when none came.
    pub(in crate::bridge) fn wait(&self, until: Instant, look: Duration) -> bool {
        wait_for_bytes(self.fds(), until, look)
    }
}

/// Sends as much as possible without waiting through a port, if it exists.
fn send_to(senders: &[(usize, LinkSender)], port: usize, bytes: &[u8]) {
    if let Some((_, sender)) = senders.iter().find(|(number, _)| *number == port) {
        sender.send(bytes);
    }
}

/// Handles a lost link: one of the loop ends the flight, another one is reported.
fn tell_lost(lost: &mut Option<String>, is_loops: bool, why: String) {
    if is_loops {
        *lost = Some(why);
    } else {
        tracing::info!("beside the loop: {why}");
    }
}

/// Decoder of the autopilot's protocol on one of its ports.
struct Protocol<'a> {
    autopilot: &'a mut dyn Autopilot,
    senders: &'a [(usize, LinkSender)],
    overheard: &'a mut Option<Vec<u8>>,
    port: usize,
    is_loops: bool,
    now: Duration,
    lost: &'a mut Option<String>,
}

impl Decoder for Protocol<'_> {
    fn recognises(&mut self, datagram: &[u8]) -> bool {
        self.autopilot.recognises(self.port, datagram, self.now)
    }

    fn peer_changed(&mut self) {
        self.autopilot.disconnected(self.port);
        tell_lost(self.lost, self.is_loops, "it restarted at another address, or is another program".into());
    }

    fn decode(&mut self, bytes: &[u8], is_datagram: bool) -> bool {
        let Self { senders, overheard, .. } = self;
        let valid = self.autopilot.receive(self.port, bytes, self.now, &mut |to, bytes| {
            send_to(senders, to, bytes);
            if let Some(heard) = overheard.as_mut().filter(|_| to == STATION) {
                heard.extend_from_slice(bytes);
            }
        });
        if is_datagram {
            self.autopilot.end_of_datagram(self.port);
        }
        valid
    }
}
