//! Between processes of any machines: Zenoh, which carries the schema hash and the message in postcard.
//!
//! A node is a peer that scouts nothing and listens on loopback, unless configured otherwise. Messages are
//! reliable and in order on a link, and leave at once instead of being batched. When a link cannot keep up, the
//! sender waits once, at most as long as [`crate::WaitStrategy::congestion`] says, and then drops until it can, so that
//! a stopped peer never stops the loop; what was dropped shows at the subscriber as a gap in the sequence numbers.

use std::net::TcpListener;
use std::rc::Rc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crossbeam_queue::ArrayQueue;
use serde_json::{Value, json};
use whirlstand_msgs::{DecodeError, Message, decode, encode};
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Sample;

use crate::inproc::Queue;
use crate::lost::LostCounter;
use crate::park::{Region, TopicBit};
use crate::{BusConfig, OpenError, RecvError, SendError, Transport, ZenohConfig};

/// Refused messages kept for [`crate::Subscriber::try_recv`] to tell of; more are forgotten.
const MAX_REFUSED: usize = 8;

/// Attempts to find a free port, each lost to another program that took it in between.
const PORT_ATTEMPTS: usize = 8;

/// Zenoh's key expression of a topic.
pub fn key_expression(bench: &str, topic: &str) -> String {
    format!("whirlstand/{bench}/{topic}")
}

/// A node's membership in a bench.
pub(crate) struct Member {
    bench: String,
    session: zenoh::Session,
    locators: Vec<String>,
    region: Arc<Region>,
}

impl Member {
    pub(crate) fn open(bus: &BusConfig) -> Result<Rc<Self>, OpenError> {
        let settings = settings(&bus.zenoh, bus.wait.congestion)?;
        let mut attempt = 1;
        let (session, locators) = loop {
            let mut settings = settings.clone();
            let (locators, chosen_here) = fix_ports(&mut settings)
                .map_err(|reason| transport_error(&bus.bench, "find a free port", reason))?;
            let config = zenoh::Config::from_json5(&settings.to_string()).map_err(|e| {
                OpenError::ZenohConfig { path: bus.zenoh.config.clone(), reason: e.to_string() }
            })?;
            match zenoh::open(config).wait() {
                Ok(session) => break (session, locators),
                Err(_) if chosen_here && attempt < PORT_ATTEMPTS => attempt += 1,
                Err(e) => return Err(transport_error(&bus.bench, "open a session", e)),
            }
        };
        let region = Arc::new(Region::private());
        Ok(Rc::new(Self { bench: bus.bench.clone(), session, locators, region }))
    }

    pub(crate) fn locators(&self) -> &[String] {
        &self.locators
    }

    pub(crate) fn region(&self) -> &Region {
        &self.region
    }

    pub(crate) fn publisher(&self, topic: &str) -> Result<Publisher, OpenError> {
        let port = self
            .session
            .declare_publisher(key_expression(&self.bench, topic))
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::RealTime)
            .express(true)
            .wait()
            .map_err(|e| transport_error(&self.bench, &format!("publish on topic \"{topic}\""), e))?;
        Ok(Publisher { port, id: publisher_id(&self.session).into() })
    }

    pub(crate) fn subscriber<M: Message>(
        &self,
        topic: &str,
        depth: usize,
    ) -> Result<Subscriber<M>, OpenError> {
        let inbox = Arc::new(Inbox::<M>::new(depth));
        let region = self.region.clone();
        let bit = TopicBit::of(topic);
        let port = self
            .session
            .declare_subscriber(key_expression(&self.bench, topic))
            .callback({
                let inbox = inbox.clone();
                move |sample| {
                    inbox.take(&sample);
                    region.wake(bit);
                }
            })
            .wait()
            .map_err(|e| transport_error(&self.bench, &format!("subscribe to topic \"{topic}\""), e))?;
        Ok(Subscriber { inbox, _port: port })
    }
}

/// Tells the publishers of a topic apart, so that a subscriber can count the gaps of each.
fn publisher_id(session: &zenoh::Session) -> [u8; 16] {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let zid = session.zid().to_le_bytes();
    let own = COUNT.fetch_add(1, Ordering::Relaxed).to_le_bytes();
    std::array::from_fn(|i| if i < 8 { zid[i] ^ zid[i + 8] } else { own[i - 8] })
}

pub(crate) struct Publisher {
    port: zenoh::pubsub::Publisher<'static>,
    id: ZBytes,
}

impl Publisher {
    pub(crate) fn send<M: Message>(&mut self, topic: &str, message: &M) -> Result<(), SendError> {
        let mut wire = Vec::with_capacity(2 * size_of::<M>());
        encode(message, &mut wire);
        self.port
            .put(wire)
            .attachment(self.id.clone())
            .wait()
            .map_err(|e| SendError { topic: topic.into(), reason: e.to_string() })
    }

    pub(crate) fn has_subscribers(&self, topic: &str) -> Result<bool, SendError> {
        let status = self.port.matching_status().wait();
        status.map(|s| s.matching()).map_err(|e| SendError { topic: topic.into(), reason: e.to_string() })
    }
}

/// What arrived, filled by Zenoh's receiving thread.
struct Inbox<M> {
    queue: Queue<M>,
    refused: ArrayQueue<DecodeError>,
    counter: Mutex<LostCounter>,
}

impl<M: Message> Inbox<M> {
    fn new(depth: usize) -> Self {
        Self {
            queue: Queue::new(depth),
            refused: ArrayQueue::new(MAX_REFUSED),
            counter: Mutex::new(LostCounter::default()),
        }
    }

    fn take(&self, sample: &Sample) {
        match decode::<M>(&sample.payload().to_bytes()) {
            Ok(message) => {
                // A foreign publisher need not say who it is; all such count as one.
                let publisher = sample
                    .attachment()
                    .map_or(0, |a| <[u8; 16]>::try_from(&a.to_bytes()[..]).map_or(0, u128::from_le_bytes));
                self.counter().note(publisher, message.head().seq);
                self.queue.push(message);
            }
            Err(error) => {
                // When full, what came first says it all.
                let _ = self.refused.push(error);
            }
        }
    }

    fn counter(&self) -> std::sync::MutexGuard<'_, LostCounter> {
        self.counter.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

pub(crate) struct Subscriber<M: Message> {
    inbox: Arc<Inbox<M>>,
    _port: zenoh::pubsub::Subscriber<()>,
}

impl<M: Message> Subscriber<M> {
    pub(crate) fn try_recv(&mut self, topic: &str) -> Result<Option<M>, RecvError> {
        if let Some(message) = self.inbox.queue.pop() {
            return Ok(Some(message));
        }
        match self.inbox.refused.pop() {
            Some(source) => Err(RecvError::Refused { topic: topic.into(), source }),
            None => Ok(None),
        }
    }

    pub(crate) fn lost(&self) -> u64 {
        self.inbox.counter().lost() + self.inbox.queue.displaced()
    }
}

/// Whirlstand's settings, with the user's file merged over them and the endpoints given in the launch file on top.
fn settings(zenoh: &ZenohConfig, congestion: Duration) -> Result<Value, OpenError> {
    let mut settings = json!({
        "mode": "peer",
        "listen": { "endpoints": ["tcp/127.0.0.1:0"] },
        "connect": {
            "timeout_ms": -1,
            "exit_on_failure": false,
            "retry": { "period_init_ms": 20, "period_max_ms": 500, "period_increase_factor": 2 },
        },
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": false } },
        "transport": { "link": { "tx": { "queue": {
            "size": { "real_time": 16 },
            "congestion_control": { "drop": { "wait_before_drop": congestion.as_micros() as u64 } },
        } } } },
    });
    if let Some(path) = &zenoh.config {
        let text =
            std::fs::read_to_string(path).map_err(|source| OpenError::File { path: path.clone(), source })?;
        let bad = |reason: String| OpenError::ZenohConfig { path: Some(path.clone()), reason };
        let user: Value = json5::from_str(&text).map_err(|e| bad(e.to_string()))?;
        if !user.is_object() {
            return Err(bad("it must be an object, { ... }".into()));
        }
        merge(&mut settings, user);
    }
    if !zenoh.listen.is_empty() {
        settings["listen"]["endpoints"] = json!(zenoh.listen);
    }
    if !zenoh.connect.is_empty() {
        settings["connect"]["endpoints"] = json!(zenoh.connect);
    }
    Ok(settings)
}

/// Objects are merged key by key; anything else is replaced.
fn merge(into: &mut Value, from: Value) {
    match (into, from) {
        (Value::Object(into), Value::Object(from)) => {
            for (key, value) in from {
                merge(into.entry(key).or_insert(Value::Null), value);
            }
        }
        (into, from) => *into = from,
    }
}

/// Replaces port 0 of TCP endpoints by a free port, so that this node can say where it listens. Returns
/// all endpoints, and whether a port was chosen here.
fn fix_ports(settings: &mut Value) -> Result<(Vec<String>, bool), std::io::Error> {
    let mut chosen = false;
    let mut endpoints = Vec::new();
    let Some(list) = settings["listen"]["endpoints"].as_array_mut() else { return Ok((endpoints, chosen)) };
    // Held until all are chosen, so that no port is chosen twice.
    let mut held = Vec::new();
    for endpoint in list {
        let Some(text) = endpoint.as_str() else { continue };
        let (address, options) = text.split_at(text.find(['?', '#']).unwrap_or(text.len()));
        let host = ["tcp/", "tls/"].iter().find_map(|p| address.strip_prefix(p)?.strip_suffix(":0"));
        let fixed = match host {
            Some(host) => {
                let listener = TcpListener::bind(format!("{host}:0"))?;
                let port = listener.local_addr()?.port();
                held.push(listener);
                chosen = true;
                format!("{}:{port}{options}", &address[..address.len() - ":0".len()])
            }
            None => text.to_string(),
        };
        *endpoint = Value::String(fixed.clone());
        endpoints.push(fixed);
    }
    Ok((endpoints, chosen))
}

fn transport_error(bench: &str, action: &str, reason: impl ToString) -> OpenError {
    OpenError::Transport {
        action: action.into(),
        bench: bench.into(),
        transport: Transport::Zenoh,
        reason: reason.to_string(),
    }
}
