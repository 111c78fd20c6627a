//! Common interface of the three transports.

use std::cell::Cell;
use std::rc::Rc;
use std::sync::Arc;
use std::time::{Duration, Instant};

use whirlstand_msgs::Message;

use crate::carried::{Carried, Carrier, Place};
use crate::config::check_name;
use crate::park::{Region, TopicBit};
use crate::port::{PublisherPort, SubscriberPort};
use crate::{
    BusConfig, LauncherToken, MAX_DEPTH, OpenError, RecvError, SendError, Transport, WaitStrategy, inproc,
    network, shared_memory,
};

/// A node's membership in a bench. It and its ports stay on the thread that opened them; another thread opens
/// its own.
pub struct Bus {
    shared: Rc<Shared>,
    wait: WaitStrategy,
}

/// State shared by the bus and its ports.
struct Shared {
    medium: Medium,
    slot: usize,
    /// Topic words of all subscribers, as a bit set.
    notifying: Cell<u64>,
}

enum Medium {
    Iceoryx2(Rc<shared_memory::Member>),
    Zenoh(Rc<network::Member>),
    Inproc(Arc<inproc::Bench>),
}

impl Shared {
    fn region(&self) -> &Region {
        match &self.medium {
            Medium::Iceoryx2(member) => member.region(),
            Medium::Zenoh(member) => member.region(),
            Medium::Inproc(bench) => bench.region(),
        }
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        self.region().free_slot(self.slot);
    }
}

impl Bus {
    /// Joins a bench.
    ///
    /// # Errors
    /// [`OpenError`] for an invalid name, a bad Zenoh configuration or a transport that refuses.
    pub fn open(config: &BusConfig) -> Result<Self, OpenError> {
        check_name("bench", &config.bench)?;
        check_name("node", &config.node)?;
        let medium = match config.transport {
            Transport::Iceoryx2 => Medium::Iceoryx2(shared_memory::Member::open(config)?),
            Transport::Zenoh => Medium::Zenoh(network::Member::open(config)?),
            Transport::Inproc => Medium::Inproc(inproc::Bench::open(&config.bench)),
        };
        let mut shared = Shared { medium, slot: 0, notifying: Cell::new(0) };
        shared.slot = shared.region().take_slot();
        Ok(Self { shared: Rc::new(shared), wait: config.wait })
    }

    /// Endpoints on which this node listens; empty unless the transport is Zenoh.
    pub fn locators(&self) -> &[String] {
        match &self.shared.medium {
            Medium::Zenoh(member) => member.locators(),
            Medium::Iceoryx2(_) | Medium::Inproc(_) => &[],
        }
    }

    /// Announces to the network that this process launches the bench, until the token is dropped. On one
    /// machine the token has no effect: other means exclude a second launcher there.
    ///
    /// # Errors
    /// [`OpenError::Taken`] when another process has announced itself too.
    pub fn announce_launcher(&self) -> Result<LauncherToken, OpenError> {
        match &self.shared.medium {
            Medium::Zenoh(member) => member.announce_launcher(),
            Medium::Iceoryx2(_) | Medium::Inproc(_) => Ok(LauncherToken::local()),
        }
    }

    /// Publishes on the message's own topic.
    ///
    /// # Errors
    /// [`OpenError::Schema`] when the topic is in use with another version of the message.
    pub fn publisher<M: Carried>(&self) -> Result<Publisher<M>, OpenError> {
        self.publisher_on(M::TOPIC)
    }

    /// Publishes on another topic with the same message type.
    ///
    /// # Errors
    /// As [`Self::publisher`], and [`OpenError::Name`] for an invalid topic.
    pub fn publisher_on<M: Carried>(&self, topic: &str) -> Result<Publisher<M>, OpenError> {
        self.open_publisher(topic, None)
    }

    /// Publishes messages with the sender name `speaker`, on their own topic: for a process that runs several
    /// nodes.
    ///
    /// # Errors
    /// As [`Self::publisher`], and [`OpenError::Name`] for an invalid name.
    pub fn publisher_as<M: Carried>(&self, speaker: &str) -> Result<Publisher<M>, OpenError> {
        check_name("node", speaker)?;
        self.open_publisher(M::TOPIC, Some(speaker))
    }

    fn open_publisher<M: Carried>(
        &self,
        topic: &str,
        speaker: Option<&str>,
    ) -> Result<Publisher<M>, OpenError> {
        check_name("topic", topic)?;
        let place = |carrier| Place { carrier, topic, speaker };
        let port = match &self.shared.medium {
            Medium::Iceoryx2(member) => {
                Sending::Waking(M::open_publisher(&place(Carrier::Iceoryx2(member)))?.0)
            }
            Medium::Zenoh(member) => Sending::Far(M::open_publisher(&place(Carrier::Zenoh(member)))?.0),
            Medium::Inproc(bench) => Sending::Inproc(bench.publisher(topic)?),
        };
        Ok(Publisher {
            port,
            topic: topic.into(),
            bit: TopicBit::of(topic),
            seq: 0,
            shared: self.shared.clone(),
        })
    }

    /// Subscribes to the message's own topic: receives messages published from now on, none from before. The
    /// queue holds `depth` messages; when it is full the oldest is dropped, and counts as lost.
    ///
    /// # Errors
    /// [`OpenError::Schema`] when the topic is in use with another version of the message (over Zenoh that shows
    /// only when a message arrives, see [`RecvError::Refused`]), [`OpenError::Depth`] for a depth of 0 or above
    /// [`MAX_DEPTH`].
    pub fn subscriber<M: Carried>(&self, depth: usize) -> Result<Subscriber<M>, OpenError> {
        self.subscriber_on(M::TOPIC, depth)
    }

    /// Subscribes to another topic with the same message type.
    ///
    /// # Errors
    /// As [`Self::subscriber`], and [`OpenError::Name`] for an invalid topic.
    pub fn subscriber_on<M: Carried>(&self, topic: &str, depth: usize) -> Result<Subscriber<M>, OpenError> {
        check_name("topic", topic)?;
        if depth == 0 || depth > MAX_DEPTH {
            return Err(OpenError::Depth { topic: topic.into(), depth, max: MAX_DEPTH });
        }
        let process = |carrier| M::open_subscriber(&Place { carrier, topic, speaker: None }, depth);
        let port = match &self.shared.medium {
            Medium::Iceoryx2(member) => Receiving::Process(process(Carrier::Iceoryx2(member))?.0),
            Medium::Zenoh(member) => Receiving::Process(process(Carrier::Zenoh(member))?.0),
            Medium::Inproc(bench) => Receiving::Inproc(bench.subscriber(topic, depth)?),
        };
        let notifying = &self.shared.notifying;
        notifying.set(notifying.get() | TopicBit::of(topic).mask());
        Ok(Subscriber { port, topic: topic.into(), _shared: self.shared.clone() })
    }

    /// Waits until `ready` returns true: polls, yields, then sleeps as [`BusConfig::wait`] says, and polls
    /// again after every publication on a topic this node subscribes to. Polls at least once, even after the
    /// deadline. Returns whether `ready` returned true in time.
    ///
    /// # Errors
    /// What `ready` returns.
    pub fn wait_until<E>(
        &self,
        deadline: Instant,
        mut ready: impl FnMut() -> Result<bool, E>,
    ) -> Result<bool, E> {
        if self.wait.give_way {
            std::thread::yield_now();
        }
        for _ in 0..self.wait.spin {
            if ready()? {
                return Ok(true);
            }
            std::hint::spin_loop();
        }
        let mut start = None;
        loop {
            if ready()? {
                return Ok(true);
            }
            let now = Instant::now();
            if now >= deadline {
                return Ok(false);
            }
            if now - *start.get_or_insert(now) >= self.wait.yield_for {
                break;
            }
            std::thread::yield_now();
        }
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            if left == Duration::ZERO {
                return ready();
            }
            let timeout = left.min(self.wait.sleep);
            if self.shared.region().sleep(
                self.shared.slot,
                self.shared.notifying.get(),
                timeout,
                &mut ready,
            )? {
                return Ok(true);
            }
            if ready()? {
                return Ok(true);
            }
        }
    }
}

/// Publishes messages of one type on one topic.
pub struct Publisher<M: Message> {
    port: Sending<M>,
    topic: String,
    bit: TopicBit,
    seq: u64,
    shared: Rc<Shared>,
}

enum Sending<M: Message> {
    /// To processes that sleep on the shared region, which the sender wakes.
    Waking(Box<dyn PublisherPort<M>>),
    /// Over a network, whose receiving side wakes its own process.
    Far(Box<dyn PublisherPort<M>>),
    Inproc(inproc::Publisher<M>),
}

impl<M: Message> Publisher<M> {
    /// Publishes a copy of the message whose `head.seq` counts this publisher's messages, from 0; the rest
    /// of the message travels as it is.
    ///
    /// Does not wait for subscribers. Over shared memory and in-process it neither waits nor allocates; over Zenoh
    /// it can wait once, up to [`WaitStrategy::congestion`], when a link becomes congested, and then drops until the
    /// link is free again.
    ///
    /// # Errors
    /// [`SendError`] when the transport fails. The sequence number is used up nevertheless.
    #[inline]
    pub fn send(&mut self, message: &M) -> Result<(), SendError> {
        let seq = self.seq;
        self.seq += 1;
        self.send_as(message, seq)
    }

    /// Publishes the last message again with the same sequence number, for a subscriber that may have missed
    /// it. Other subscribers see the number go back, which does not count as a loss.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub fn send_again(&mut self, message: &M) -> Result<(), SendError> {
        self.send_as(message, self.seq.saturating_sub(1))
    }

    #[inline]
    fn send_as(&mut self, message: &M, seq: u64) -> Result<(), SendError> {
        match &mut self.port {
            Sending::Waking(port) => port.send(&self.topic, message, seq)?,
            Sending::Inproc(port) => port.send(message, seq),
            Sending::Far(port) => return port.send(&self.topic, message, seq),
        }
        self.shared.region().wake(self.bit);
        Ok(())
    }

    /// True when the topic has a subscriber now. Over shared memory a killed subscriber counts until its
    /// files are cleaned up.
    ///
    /// # Errors
    /// [`SendError`] when the transport cannot tell.
    pub fn has_subscribers(&mut self) -> Result<bool, SendError> {
        match &mut self.port {
            Sending::Waking(port) | Sending::Far(port) => port.has_subscribers(&self.topic),
            Sending::Inproc(port) => Ok(port.has_subscribers()),
        }
    }

    /// Name of the topic.
    pub fn topic(&self) -> &str {
        &self.topic
    }
}

/// Receives the messages of one type on one topic.
pub struct Subscriber<M: Message> {
    port: Receiving<M>,
    topic: String,
    _shared: Rc<Shared>,
}

enum Receiving<M: Message> {
    Process(Box<dyn SubscriberPort<M>>),
    Inproc(inproc::Subscriber<M>),
}

impl<M: Message> Subscriber<M> {
    /// Takes the oldest waiting message, `None` when there is none. Never waits. The messages of one publisher come
    /// in the order in which they were sent.
    ///
    /// # Errors
    /// [`RecvError::Refused`] once for each message of another version or with damaged content: the message
    /// is dropped and the next call continues. [`RecvError::Transport`] when the transport fails.
    #[inline]
    pub fn try_recv(&mut self) -> Result<Option<M>, RecvError> {
        match &mut self.port {
            Receiving::Process(port) => port.try_recv(&self.topic),
            Receiving::Inproc(port) => Ok(port.try_recv()),
        }
    }

    /// Number of messages published since this subscriber was opened that it will never receive. A loss is
    /// counted at the latest when a later message of the same publisher is received.
    pub fn lost(&self) -> u64 {
        match &self.port {
            Receiving::Process(port) => port.lost(),
            Receiving::Inproc(port) => port.lost(),
        }
    }

    /// Name of the topic.
    pub fn topic(&self) -> &str {
        &self.topic
    }
}
