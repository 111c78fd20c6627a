//! A bench for Foxglove and Lichtblick: its topics over Foxglove's WebSocket protocol, with messages that their
//! panels show without configuration: the vehicle's pose and shape, and events as log lines.
//!
//! The protocol and its types are those of Foxglove's own SDK. Each client has a queue that drops its oldest
//! message when it is full, so a client that does not read blocks nothing.

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

/// The port that is tried first where none is given: Foxglove's default.
pub const FOXGLOVE_PORT: u16 = 8765;

/// Queue length of a client: all topics of a bench at 1 kHz for two seconds.
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

/// A feed that sends a bench's messages to Foxglove clients.
#[derive(Clone)]
pub struct FoxgloveFeed(Arc<Mutex<Option<Channels>>>);

impl Foxglove {
    /// Serves a bench. `act` carries out the clients' controls, on a thread where it may block.
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
        // The protocol has no password, and any page in a browser can reach a port of this machine. Therefore the
        // control topic has a name that cannot be guessed.
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

    /// The URL to which a client connects.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// The topic on which a client publishes controls.
    pub fn control_topic(&self) -> &str {
        &self.control_topic
    }

    /// Begins a bench: its topics replace those of the bench before.
    ///
    /// # Errors
    /// [`ServerError::Start`] when the SDK refuses a topic.
    pub fn begin(&self, vehicle: &Vehicle, period_ns: u64) -> Result<FoxgloveFeed, ServerError> {
        let refused = |e: FoxgloveError| ServerError::Start(std::io::Error::other(e));
        let mut place = self.channels.lock().unwrap_or_else(PoisonError::into_inner);
        // The topics of the previous bench are removed first, because two of one name would exist side by
        // side.
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
    /// Sends a message to the clients.
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
            // Requests that are still open are not waited for.
            let _ = runtime.block_on(async { tokio::time::timeout(FAREWELL, stopped.wait()).await });
            runtime.shutdown_background();
        }
    }
}

/// Time in which clients are told of the end.
const FAREWELL: std::time::Duration = std::time::Duration::from_millis(500);
