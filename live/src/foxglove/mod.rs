//! A bench for Foxglove and Lichtblick: its topics over Foxglove's WebSocket protocol, with what their panels understand by
//! themselves: the vehicle's pose and shape, and events as log lines.
//!
//! The protocol and its types are those of Foxglove's own SDK. Each client has a queue that loses its oldest message when it is
//! full, so one that does not read holds up nobody.

mod channels;
mod clients;

use std::sync::{Arc, Mutex, PoisonError};

use foxglove::websocket::Capability;
use foxglove::{Context, FoxgloveError, WebSocketServer, WebSocketServerHandle};
use whirlstand_logs::BenchMessage;
use whirlstand_vehicle::Vehicle;

use crate::address::Address;
use crate::scene::bench_info;
use crate::server::{Answer, Control, ServerError};
use channels::Channels;
use clients::Clients;

/// The port that is tried first where none is given: that which Foxglove proposes.
pub const FOXGLOVE_PORT: u16 = 8765;

/// Messages that a client may be behind: all topics of a bench at 1 kHz for two seconds.
const BEHIND: usize = 16384;

/// A running server, until dropped.
pub struct Foxglove {
    context: Arc<Context>,
    handle: Option<WebSocketServerHandle>,
    runtime: Option<tokio::runtime::Runtime>,
    url: String,
    control_topic: String,
    channels: Arc<Mutex<Option<Channels>>>,
}

/// What a bench says goes here.
#[derive(Clone)]
pub struct FoxgloveFeed(Arc<Mutex<Option<Channels>>>);

impl Foxglove {
    /// Serves a bench; `act` does what clients ask for, on a thread where it may wait.
    ///
    /// # Errors
    /// [`ServerError`].
    pub fn start(
        address: Address,
        act: impl Fn(&Control) -> Answer + Send + Sync + 'static,
    ) -> Result<Self, ServerError> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .max_blocking_threads(2)
            .thread_name("foxglove")
            .enable_all()
            .build()
            .map_err(ServerError::Start)?;
        // The protocol knows no password, and any page that a browser shows can reach a port of this machine: a topic that
        // nobody can guess says who may steer.
        let control_topic = format!("/control/{}", crate::address::secret());
        let context = Context::new();
        let clients = Arc::new(Clients::new(control_topic.clone(), runtime.handle().clone(), act));
        let serve = |port: u16| {
            let server = WebSocketServer::new()
                .name(concat!("whirlstand ", env!("CARGO_PKG_VERSION")))
                .bind(address.socket.ip().to_string(), port)
                .context(&context)
                .capabilities([Capability::ClientPublish])
                .supported_encodings(["json"])
                .message_backlog_size(BEHIND)
                .listener(clients.clone());
            runtime.block_on(server.start())
        };
        let wanted = address.socket.port();
        let handle = match serve(wanted) {
            Err(_) if address.any_port => serve(0),
            served => served,
        };
        let handle = handle.map_err(|error| match error {
            FoxgloveError::Bind(source) => ServerError::Listen { socket: address.socket, source },
            other => ServerError::Start(std::io::Error::other(other)),
        })?;
        let socket = std::net::SocketAddr::new(address.socket.ip(), handle.port());
        let url = format!("ws://{}", crate::server::reachable(socket));
        let channels = Arc::default();
        Ok(Self { context, handle: Some(handle), runtime: Some(runtime), url, control_topic, channels })
    }

    /// Where a client connects to.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// The topic on which it publishes controls.
    pub fn control_topic(&self) -> &str {
        &self.control_topic
    }

    /// A bench begins: its topics are offered in the place of those before.
    ///
    /// # Errors
    /// [`ServerError::Start`] when the SDK refuses a topic.
    pub fn begin(&self, vehicle: &Vehicle, period_ns: u64) -> Result<FoxgloveFeed, ServerError> {
        let refused = |e: FoxgloveError| ServerError::Start(std::io::Error::other(e));
        let mut place = self.channels.lock().unwrap_or_else(PoisonError::into_inner);
        // Those of the bench before go first, as two of one name would stay beside each other.
        place.take();
        let channels =
            Channels::open(&self.context, &bench_info(vehicle, period_ns), vehicle).map_err(refused)?;
        *place = Some(channels);
        if let Some(handle) = &self.handle {
            handle.clear_session(None);
        }
        Ok(FoxgloveFeed(self.channels.clone()))
    }
}

impl FoxgloveFeed {
    /// Hands on a message.
    pub(crate) fn hear(&self, message: &BenchMessage) {
        let mut place = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(channels) = place.as_mut() {
            channels.hear(message);
        }
    }
}

impl Drop for Foxglove {
    fn drop(&mut self) {
        self.channels.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let (Some(handle), Some(runtime)) = (self.handle.take(), self.runtime.take()) {
            let stopped = handle.stop();
            // Whoever still asks for something is not waited for.
            let _ = runtime.block_on(async { tokio::time::timeout(FAREWELL, stopped.wait()).await });
            runtime.shutdown_background();
        }
    }
}

/// How long clients have to be told of the end.
const FAREWELL: std::time::Duration = std::time::Duration::from_millis(500);
