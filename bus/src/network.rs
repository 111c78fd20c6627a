//! Transport between machines: Zenoh, with the schema hash and the message in postcard.
//!
//! A node is a peer without scouting that listens on loopback, unless configured otherwise; a protected one
//! speaks TLS with members of its bench only, and accepts from each only what that member may publish.
//! Messages are reliable and in order on a link, and are sent at once instead of being batched. When a link
//! is congested, the sender waits once, at most for [`crate::WaitStrategy::congestion`], and then drops
//! messages until the link is free, so that a stopped peer never stops the loop; dropped messages appear at
//! the subscriber as a gap in the sequence numbers.

use std::rc::Rc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crossbeam_queue::ArrayQueue;
use serde_json::Value;
use whirlstand_msgs::{Message, decode, encode};
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Sample;

use crate::inproc::Queue;
use crate::launcher::LauncherToken;
use crate::lost::LostCounter;
use crate::network_keys::{key_expression, spoken_key};
use crate::network_settings::{fix_ports, has_tls, settings};
use crate::park::{Region, TopicBit};
use crate::port::{PublisherPort, SubscriberPort};
use crate::session::{SessionError, open_session};
use crate::{BusConfig, ONE_THREAD, OpenError, RecvError, Refusal, SendError, Transport};

/// Largest number of refused messages kept for [`crate::Subscriber::try_recv`]; further ones are not
/// reported.
const MAX_REFUSED: usize = 8;

/// Number of attempts to find a free port, each lost to another program that bound it in between.
const PORT_ATTEMPTS: usize = 8;

/// A node's membership in a bench.
pub(crate) struct Member {
    bench: String,
    node: String,
    session: zenoh::Session,
    locators: Vec<String>,
    /// True when the configuration requests links to others.
    has_links: bool,
    region: Arc<Region>,
}

impl Member {
    pub(crate) fn open(bus: &BusConfig) -> Result<Rc<Self>, OpenError> {
        let settings = settings(bus)?;
        // An explicit other value of the variable is respected.
        if has_tls(&settings) && std::env::var_os(ONE_THREAD.0).is_none() {
            return Err(OpenError::TwoThreads { bench: bus.bench.clone() });
        }
        let mut attempt = 1;
        let (session, locators) = loop {
            let mut settings = settings.clone();
            let (locators, chosen_here) = fix_ports(&mut settings)
                .map_err(|reason| transport_error(&bus.bench, "find a free port", reason))?;
            match open_session(&settings) {
                Ok(session) => break (session, locators),
                Err(SessionError::Settings(reason)) => {
                    return Err(OpenError::ZenohConfig { path: bus.zenoh.config.clone(), reason });
                }
                Err(_) if chosen_here && attempt < PORT_ATTEMPTS => attempt += 1,
                Err(e) => return Err(transport_error(&bus.bench, "open a session", e)),
            }
        };
        let region = Arc::new(Region::private());
        let (bench, node) = (bus.bench.clone(), bus.node.clone());
        let has_links = has_links(&settings);
        Ok(Rc::new(Self { bench, node, session, locators, has_links, region }))
    }

    pub(crate) fn locators(&self) -> &[String] {
        &self.locators
    }

    /// Announces that this process launches the bench.
    pub(crate) fn announce_launcher(&self) -> Result<LauncherToken, OpenError> {
        LauncherToken::announce(&self.session, &self.bench, self.has_links)
    }

    pub(crate) fn region(&self) -> &Region {
        &self.region
    }

    /// Zenoh's key for a topic of messages of type `M`, as published by `node`.
    fn key<M: Message>(&self, topic: &str, node: &str) -> String {
        match <M as Message>::zeroed().speaker() {
            Some(_) => spoken_key(&self.bench, topic, node),
            None => key_expression(&self.bench, topic),
        }
    }

    pub(crate) fn publisher<M: Message>(
        &self,
        topic: &str,
        speaker: Option<&str>,
    ) -> Result<Publisher, OpenError> {
        let port = self
            .session
            .declare_publisher(self.key::<M>(topic, speaker.unwrap_or(&self.node)))
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
            .declare_subscriber(self.key::<M>(topic, "*"))
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

/// Identifies a publisher of a topic, so that a subscriber can count its gaps.
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

impl<M: Message> PublisherPort<M> for Publisher {
    fn send(&mut self, topic: &str, message: &M, seq: u64) -> Result<(), SendError> {
        let mut message = *message;
        message.head_mut().seq = seq;
        let mut wire = Vec::with_capacity(2 * size_of::<M>());
        encode(&message, &mut wire);
        self.port
            .put(wire)
            .attachment(self.id.clone())
            .wait()
            .map_err(|e| SendError { topic: topic.into(), reason: e.to_string() })
    }

    fn has_subscribers(&self, topic: &str) -> Result<bool, SendError> {
        let status = self.port.matching_status().wait();
        status.map(|s| s.matching()).map_err(|e| SendError { topic: topic.into(), reason: e.to_string() })
    }
}

/// Received messages, filled by Zenoh's receiving thread.
struct Inbox<M> {
    queue: Queue<M>,
    refused: ArrayQueue<Refusal>,
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
        match read::<M>(sample) {
            Ok(message) => {
                // A foreign publisher need not identify itself; all such count as one.
                let publisher = sample
                    .attachment()
                    .map_or(0, |a| <[u8; 16]>::try_from(&a.to_bytes()[..]).map_or(0, u128::from_le_bytes));
                self.counter().note(publisher, message.head().seq);
                self.queue.push(message);
            }
            Err(error) => {
                // When the queue is full, the first errors suffice.
                let _ = self.refused.push(error);
            }
        }
    }

    fn counter(&self) -> std::sync::MutexGuard<'_, LostCounter> {
        self.counter.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Decodes the message of a sample, unless it claims another sender: the last part of its key names the
/// sender, and access control binds that key to the sender's certificate.
fn read<M: Message>(sample: &Sample) -> Result<M, Refusal> {
    let message = decode::<M>(&sample.payload().to_bytes())?;
    let said = message.speaker().unwrap_or("");
    let from = sample.key_expr().as_str().rsplit('/').next().unwrap_or("");
    if !said.is_empty() && said != from {
        return Err(Refusal::Speaker { said: said.into(), from: from.into() });
    }
    Ok(message)
}

pub(crate) struct Subscriber<M: Message> {
    inbox: Arc<Inbox<M>>,
    _port: zenoh::pubsub::Subscriber<()>,
}

impl<M: Message> SubscriberPort<M> for Subscriber<M> {
    fn try_recv(&mut self, topic: &str) -> Result<Option<M>, RecvError> {
        if let Some(message) = self.inbox.queue.pop() {
            return Ok(Some(message));
        }
        match self.inbox.refused.pop() {
            Some(source) => Err(RecvError::Refused { topic: topic.into(), source }),
            None => Ok(None),
        }
    }

    fn lost(&self) -> u64 {
        self.inbox.counter().lost().saturating_add(self.inbox.queue.displaced())
    }
}

/// True when the settings make this node connect to others instead of waiting for them.
fn has_links(settings: &Value) -> bool {
    let connects = settings["connect"]["endpoints"].as_array().is_some_and(|all| !all.is_empty());
    let scouts = |how: &str| settings["scouting"][how]["enabled"] == Value::Bool(true);
    connects || scouts("multicast") || scouts("gossip")
}

fn transport_error(bench: &str, action: &str, reason: impl ToString) -> OpenError {
    OpenError::Transport {
        action: action.into(),
        bench: bench.into(),
        transport: Transport::Zenoh,
        reason: reason.to_string(),
    }
}
