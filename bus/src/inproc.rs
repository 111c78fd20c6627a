//! Transport within one process, between threads or within one thread: a queue per subscriber, no system
//! call, no allocation.

use std::any::Any;
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use crossbeam_queue::ArrayQueue;
use whirlstand_msgs::Message;

use crate::OpenError;
use crate::park::Region;

/// A subscriber's queue: any number of publishers, one subscriber; the oldest message is dropped when it is
/// full.
pub(crate) struct Queue<M> {
    ring: ArrayQueue<M>,
    displaced: AtomicU64,
}

impl<M> Queue<M> {
    pub(crate) fn new(depth: usize) -> Self {
        Self { ring: ArrayQueue::new(depth), displaced: AtomicU64::new(0) }
    }

    /// Never waits and never allocates.
    #[inline]
    pub(crate) fn push(&self, message: M) {
        if self.ring.force_push(message).is_some() {
            self.displaced.fetch_add(1, Ordering::Relaxed);
        }
    }

    #[inline]
    pub(crate) fn pop(&self) -> Option<M> {
        self.ring.pop()
    }

    /// Number of messages dropped before they were received.
    pub(crate) fn displaced(&self) -> u64 {
        self.displaced.load(Ordering::Relaxed)
    }
}

/// A topic of a bench: the queues of its subscribers.
struct Topic<M> {
    queues: Mutex<Vec<Arc<Queue<M>>>>,
    /// Increased whenever `queues` changes; publishers keep a copy of the list until then.
    version: AtomicU64,
}

impl<M> Topic<M> {
    fn change(&self, change: impl FnOnce(&mut Vec<Arc<Queue<M>>>)) {
        change(&mut lock(&self.queues));
        self.version.fetch_add(1, Ordering::Release);
    }
}

struct AnyTopic {
    type_name: &'static str,
    hash: u64,
    topic: Arc<dyn Any + Send + Sync>,
}

/// A bench inside this process; exists while a node has it open.
pub(crate) struct Bench {
    name: String,
    topics: Mutex<HashMap<String, AnyTopic>>,
    region: Region,
}

static BENCHES: Mutex<Vec<Weak<Bench>>> = Mutex::new(Vec::new());

impl Bench {
    /// The bench of that name, created if it is not open.
    pub(crate) fn open(name: &str) -> Arc<Self> {
        let mut benches = lock(&BENCHES);
        benches.retain(|b| b.strong_count() > 0);
        if let Some(bench) = benches.iter().filter_map(Weak::upgrade).find(|b| b.name == name) {
            return bench;
        }
        let bench = Arc::new(Self {
            name: name.into(),
            topics: Mutex::new(HashMap::new()),
            region: Region::private(),
        });
        benches.push(Arc::downgrade(&bench));
        bench
    }

    pub(crate) fn region(&self) -> &Region {
        &self.region
    }

    pub(crate) fn publisher<M: Message>(&self, topic: &str) -> Result<Publisher<M>, OpenError> {
        Ok(Publisher { topic: self.topic(topic)?, seen: u64::MAX, queues: Vec::new() })
    }

    pub(crate) fn subscriber<M: Message>(
        &self,
        topic: &str,
        depth: usize,
    ) -> Result<Subscriber<M>, OpenError> {
        let topic = self.topic(topic)?;
        let queue = Arc::new(Queue::new(depth));
        topic.change(|queues| queues.push(queue.clone()));
        Ok(Subscriber { topic, queue })
    }

    fn topic<M: Message>(&self, name: &str) -> Result<Arc<Topic<M>>, OpenError> {
        let mut topics = lock(&self.topics);
        // An unused topic may change its type, like a shared-memory service.
        topics.retain(|_, t| Arc::strong_count(&t.topic) > 1);
        let any = topics.entry(name.into()).or_insert_with(|| AnyTopic {
            type_name: M::TYPE_NAME,
            hash: M::SCHEMA_HASH,
            topic: Arc::new(Topic::<M> { queues: Mutex::new(Vec::new()), version: AtomicU64::new(0) }),
        });
        any.topic.clone().downcast().map_err(|_| OpenError::Schema {
            bench: self.name.clone(),
            topic: name.into(),
            type_name: M::TYPE_NAME,
            expected: M::SCHEMA_HASH,
            found: format!("{:#018x} ({})", any.hash, any.type_name),
        })
    }
}

pub(crate) struct Publisher<M> {
    topic: Arc<Topic<M>>,
    seen: u64,
    queues: Vec<Arc<Queue<M>>>,
}

impl<M: Message> Publisher<M> {
    #[inline]
    pub(crate) fn send(&mut self, message: &M, seq: u64) {
        self.refresh();
        for queue in &self.queues {
            let mut message = *message;
            message.head_mut().seq = seq;
            queue.push(message);
        }
    }

    pub(crate) fn has_subscribers(&mut self) -> bool {
        self.refresh();
        !self.queues.is_empty()
    }

    #[inline]
    fn refresh(&mut self) {
        let version = self.topic.version.load(Ordering::Acquire);
        if version != self.seen {
            self.queues.clone_from(&lock(&self.topic.queues));
            self.seen = version;
        }
    }
}

pub(crate) struct Subscriber<M> {
    topic: Arc<Topic<M>>,
    queue: Arc<Queue<M>>,
}

impl<M: Message> Subscriber<M> {
    #[inline]
    pub(crate) fn try_recv(&mut self) -> Option<M> {
        self.queue.pop()
    }

    pub(crate) fn lost(&self) -> u64 {
        self.queue.displaced()
    }
}

impl<M> Drop for Subscriber<M> {
    fn drop(&mut self) {
        self.topic.change(|queues| queues.retain(|q| !Arc::ptr_eq(q, &self.queue)));
    }
}

/// The guarded lists are consistent after every statement, so a panic elsewhere leaves nothing half done.
fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
