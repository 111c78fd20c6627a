//! The web server: the page, the frames as server-sent events, and the controls.

use std::collections::{BTreeMap, VecDeque};
use std::convert::Infallible;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, State};
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use futures_util::{Stream, StreamExt, stream};
use serde::Deserialize;
use tokio::sync::broadcast::{Receiver, error::RecvError};

use crate::access::Access;
use crate::address::Address;
use crate::hub::{Hub, Sent};

/// Most simultaneous viewers; each has a queue of frames.
const MOST_VIEWERS: usize = 16;

/// Longest control request, bytes.
const LONGEST_CONTROL: usize = 4096;

/// Time in which viewers that read are told of the end.
const FAREWELL: Duration = Duration::from_millis(500);

/// Time between two checks whether the server is to end.
const LOOK: Duration = Duration::from_millis(20);

const TEMPLATE: &str = include_str!("../assets/live.html");
const STYLE: &str = include_str!("../assets/live.css");
const SCRIPTS: [&str; 6] = [
    include_str!("../assets/store.js"),
    include_str!("../assets/plots.js"),
    include_str!("../assets/horizon.js"),
    include_str!("../assets/stick.js"),
    include_str!("../assets/controls.js"),
    include_str!("../assets/live.js"),
];

/// A viewer's request.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
pub enum Control {
    /// A disturbance: `STATE=SIZE`, for a number of seconds.
    Inject {
        /// State and size with its unit.
        what: String,
        /// Duration, s.
        for_s: f64,
    },
    /// A setting: `KEY=VALUE`.
    Set {
        /// Key and value with its unit.
        what: String,
    },
    /// Takes the stick over.
    Take {
        /// A number chosen by the viewer, different for each takeover.
        hand: u64,
    },
    /// Position of the stick while the viewer holds it.
    Stick {
        /// The number under which the stick was taken over.
        hand: u64,
        /// Position by input, -1 to 1 from the input's least to its greatest value; inputs that are not
        /// listed are neutral.
        at: BTreeMap<String, f64>,
    },
    /// Gives the stick back to the law.
    Give {
        /// The number under which the stick was taken over.
        hand: u64,
    },
    /// Ends the run in order.
    Stop {},
    /// Changes how a log is played.
    Play {
        /// `speed`, `paused` or `place`.
        key: String,
        /// The new value.
        value: f64,
    },
}

/// Result of a request: a sentence, for success or refusal.
pub type Answer = Result<String, String>;

/// Why the page cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The address is not available.
    #[error("cannot serve on {socket}: {source}; choose another address")]
    Listen {
        /// The address.
        socket: SocketAddr,
        /// What the system says.
        source: std::io::Error,
    },
    /// The system provides no thread or poller.
    #[error("cannot serve: {0}")]
    Start(std::io::Error),
}

type Act = Arc<dyn Fn(&Control) -> Answer + Send + Sync>;

struct Shared {
    hub: Hub,
    access: Access,
    act: Act,
    page: String,
    /// Lets one control be carried out at a time.
    turn: tokio::sync::Mutex<()>,
}

/// A running web server, until dropped.
pub struct Server {
    url: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Serves the frames of a hub. `act` carries out the viewers' requests, on a thread where it may block.
    ///
    /// # Errors
    /// [`ServerError`].
    pub fn start(
        address: Address,
        hub: Hub,
        act: impl Fn(&Control) -> Answer + Send + Sync + 'static,
    ) -> Result<Self, ServerError> {
        let listener = listen(address)?;
        let token = address.token();
        let socket = reachable(listener.local_addr().map_err(ServerError::Start)?);
        let query = token.as_ref().map_or(String::new(), |token| format!("?token={token}"));
        let url = format!("http://{socket}/{query}");
        let shared = Arc::new(Shared {
            hub,
            access: Access { token },
            act: Arc::new(act),
            page: page(),
            turn: tokio::sync::Mutex::default(),
        });
        // A runtime with several threads: a bench over Zenoh cannot be joined from within a single-threaded
        // one.
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("live-page")
            .enable_io()
            .enable_time()
            .max_blocking_threads(2)
            .build()
            .map_err(ServerError::Start)?;
        let stop = Arc::new(AtomicBool::new(false));
        let thread = {
            let stop = stop.clone();
            let body = move || {
                runtime.block_on(serve(listener, shared, &stop));
                // Requests that still wait for the bench are not waited for.
                runtime.shutdown_background();
            };
            std::thread::Builder::new().name("live-page".into()).spawn(body).map_err(ServerError::Start)?
        };
        Ok(Self { url, stop, thread: Some(thread) })
    }

    /// URL of the page, with its token.
    pub fn url(&self) -> &str {
        &self.url
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn listen(address: Address) -> Result<TcpListener, ServerError> {
    let open = |socket: SocketAddr| {
        let listener = TcpListener::bind(socket)?;
        listener.set_nonblocking(true)?;
        Ok::<_, std::io::Error>(listener)
    };
    let error = |source| ServerError::Listen { socket: address.socket, source };
    match open(address.socket) {
        Err(e) if address.any_port && e.kind() == std::io::ErrorKind::AddrInUse => {
            open(SocketAddr::new(address.socket.ip(), 0)).map_err(error)
        }
        result => result.map_err(error),
    }
}

/// The address at which other machines reach a socket; the address of all interfaces is replaced by this
/// machine's own.
pub(crate) fn reachable(mut socket: SocketAddr) -> SocketAddr {
    if socket.ip().is_unspecified() && socket.is_ipv4() {
        socket.set_ip(own_address().unwrap_or(socket.ip()));
    }
    socket
}

/// The address of this machine in the network. Nothing is sent to find it.
fn own_address() -> Option<std::net::IpAddr> {
    let socket = std::net::UdpSocket::bind("0.0.0.0:0").ok()?;
    socket.connect("192.0.2.1:9").ok()?;
    Some(socket.local_addr().ok()?.ip())
}

async fn serve(listener: TcpListener, shared: Arc<Shared>, stop: &AtomicBool) {
    let hub = shared.hub.clone();
    let router = Router::new()
        .route("/", get(show_page))
        .route("/events", get(events))
        .route("/control", post(control))
        .layer(DefaultBodyLimit::max(LONGEST_CONTROL))
        .with_state(shared);
    let listener = match tokio::net::TcpListener::from_std(listener) {
        Ok(listener) => listener,
        Err(e) => return tracing::warn!("the live page cannot be served: {e}"),
    };
    let served = std::pin::pin!(async { axum::serve(listener, router).await });
    let ended = std::pin::pin!(async {
        while !stop.load(Ordering::Relaxed) {
            tokio::time::sleep(LOOK).await;
        }
        let until = Instant::now() + FAREWELL;
        while hub.viewers() > 0 && Instant::now() < until {
            tokio::time::sleep(LOOK).await;
        }
    });
    futures_util::future::select(served, ended).await;
}

/// The page with its styles and scripts; it loads nothing else.
fn page() -> String {
    TEMPLATE
        .replace("{{style}}", &[whirlstand_report::page::STYLE, STYLE].concat())
        .replace("{{plotly}}", whirlstand_report::page::PLOTLY)
        .replace("{{script}}", &SCRIPTS.concat())
}

fn refused() -> Response {
    let text = "Open this page at the address that whirlstand printed, including its token.\n";
    (StatusCode::FORBIDDEN, text).into_response()
}

async fn show_page(State(shared): State<Arc<Shared>>, uri: Uri, headers: HeaderMap) -> Response {
    if !shared.access.may_look(&uri, &headers) {
        return refused();
    }
    let policy = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; \
                  connect-src 'self'; frame-ancestors 'none'";
    let heads = [
        (header::CONTENT_TYPE, "text/html; charset=utf-8"),
        (header::CONTENT_SECURITY_POLICY, policy),
        (header::CACHE_CONTROL, "no-store"),
        (header::REFERRER_POLICY, "no-referrer"),
    ];
    (heads, shared.page.clone()).into_response()
}

async fn events(State(shared): State<Arc<Shared>>, uri: Uri, headers: HeaderMap) -> Response {
    if !shared.access.may_look(&uri, &headers) {
        return refused();
    }
    if shared.hub.viewers() >= MOST_VIEWERS {
        return (StatusCode::SERVICE_UNAVAILABLE, "The maximum number of viewers is connected.\n")
            .into_response();
    }
    Sse::new(frames(&shared.hub)).keep_alive(KeepAlive::default()).into_response()
}

/// The stream of frames for one viewer. It advances only when the viewer's connection asks for more, so a viewer
/// that does not read delays only itself.
fn frames(hub: &Hub) -> impl Stream<Item = Result<Event, Infallible>> + use<> {
    let (told, receiver, ended) = hub.join();
    let state = (told, Some(receiver).filter(|_| !ended));
    stream::unfold(state, |(mut told, mut receiver)| async move {
        let next = next_frame(&mut told, &mut receiver).await?;
        Some((next, (told, receiver)))
    })
    .map(|text| Ok(Event::default().data(text)))
}

async fn next_frame(told: &mut VecDeque<Arc<str>>, receiver: &mut Option<Receiver<Sent>>) -> Option<String> {
    if let Some(text) = told.pop_front() {
        return Some(text.to_string());
    }
    match receiver.as_mut()?.recv().await {
        Ok(Sent::Frame(text)) => Some(text.to_string()),
        Ok(Sent::End) | Err(RecvError::Closed) => None,
        Err(RecvError::Lagged(frames)) => Some(format!("{{\"missed\":{frames}}}")),
    }
}

async fn control(State(shared): State<Arc<Shared>>, uri: Uri, headers: HeaderMap, body: Bytes) -> Response {
    if !shared.access.may_control(&uri, &headers) {
        return refused();
    }
    let answer = match serde_json::from_slice::<Control>(&body) {
        Err(e) => Err(format!("this control cannot be parsed: {e}")),
        Ok(control) => {
            // A stick position does not wait for other controls, because it would be useless if late.
            let _turn = match control {
                Control::Stick { .. } => None,
                _ => Some(shared.turn.lock().await),
            };
            let act = shared.act.clone();
            let done = tokio::task::spawn_blocking(move || act(&control)).await;
            done.unwrap_or_else(|_| Err("the control failed inside the program".into()))
        }
    };
    let (status, text) = match answer {
        Ok(text) => (StatusCode::OK, text),
        Err(text) => (StatusCode::UNPROCESSABLE_ENTITY, text),
    };
    (status, [(header::CONTENT_TYPE, "text/plain; charset=utf-8")], text).into_response()
}
