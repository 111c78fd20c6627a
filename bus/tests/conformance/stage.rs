//! A bench for one test: nodes in this process, peers in others.

use std::cell::RefCell;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use whirlstand_bus::{
    Bus, BusConfig, Publisher, RecvError, Subscriber, Transport, WaitStrategy, remove_residue,
};
use whirlstand_msgs::Message;

/// Nothing on a bench takes this long; a test that waits longer has failed.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// The environment variable that turns this test program into a peer, and names its role.
pub const PEER: &str = "WHIRLSTAND_TEST_PEER";

/// A bench of its own name; its remains are removed at the end.
pub struct Stage {
    pub name: String,
    pub transport: Transport,
    pub wait: WaitStrategy,
    /// Where the nodes opened so far listen.
    endpoints: RefCell<Vec<String>>,
}

impl Stage {
    pub fn new(transport: Transport, test: &str) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("{test}-{}-{count}", std::process::id());
        // A busy machine holds a link up for longer than real time waits; what then is dropped is no loss of the bus.
        let congestion = WaitStrategy::lockstep().congestion;
        let wait = WaitStrategy { congestion, ..WaitStrategy::default() };
        Self { name, transport, wait, endpoints: RefCell::new(Vec::new()) }
    }

    /// The configuration of the next node: over Zenoh it connects to all nodes before it.
    pub fn config(&self, node: &str) -> BusConfig {
        let mut config = BusConfig::new(&self.name, node, self.transport);
        config.wait = self.wait;
        config.zenoh.connect = self.endpoints.borrow().clone();
        config
    }

    pub fn join(&self, node: &str) -> Bus {
        self.join_as(&self.config(node))
    }

    /// Joins with a configuration made from [`Self::config`].
    pub fn join_as(&self, config: &BusConfig) -> Bus {
        let bus = Bus::open(config).unwrap();
        self.endpoints.borrow_mut().extend_from_slice(bus.locators());
        bus
    }

    /// Another bench that could reach this one over the network.
    pub fn neighbour(&self, test: &str) -> Self {
        let other = Self::new(self.transport, test);
        other.endpoints.replace(self.endpoints.borrow().clone());
        other
    }

    /// Starts a peer: a process, or for in-process a thread.
    pub fn spawn(&self, role: &'static str, body: fn(&BusConfig, &AtomicBool)) -> Peer {
        let config = self.config(role);
        if self.transport == Transport::Inproc {
            let stop = Arc::new(AtomicBool::new(false));
            let seen = stop.clone();
            return Peer::Thread(Some(std::thread::spawn(move || body(&config, &seen))), stop);
        }
        let child = Command::new(std::env::current_exe().unwrap())
            .env(PEER, role)
            .env("WHIRLSTAND_TEST_CONFIG", serde_json::to_string(&config).unwrap())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        Peer::Process(child)
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        if self.transport == Transport::Iceoryx2 {
            let removed = remove_residue(&self.name);
            if !std::thread::panicking() {
                removed.unwrap();
                assert_eq!(leftovers(&self.name), Vec::<String>::new());
            }
        }
    }
}

/// What carries the bench's name in shared memory and in the temporary folder.
pub fn leftovers(bench: &str) -> Vec<String> {
    ["/dev/shm", "/tmp"]
        .iter()
        .flat_map(|folder| std::fs::read_dir(folder).unwrap().flatten())
        .map(|entry| entry.path().display().to_string())
        .filter(|path| path.contains(bench))
        .collect()
}

/// Another participant that can die at any moment.
pub enum Peer {
    Process(Child),
    Thread(Option<JoinHandle<()>>, Arc<AtomicBool>),
}

impl Peer {
    /// kill -9; a thread ends without a word.
    pub fn kill(&mut self) {
        match self {
            Self::Process(child) => {
                let _ = child.kill();
                let _ = child.wait();
            }
            Self::Thread(thread, stop) => {
                stop.store(true, Ordering::Relaxed);
                if let Some(thread) = thread.take() {
                    let _ = thread.join();
                }
            }
        }
    }

    /// Sends a signal to a process; a thread has no such thing.
    pub fn signal(&self, signal: i32) {
        if let Self::Process(child) = self {
            // SAFETY: the child is ours and not yet reaped, so the number is its own.
            unsafe { libc::kill(child.id() as libc::pid_t, signal) };
        }
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Waits for the next message.
pub fn next<M: Message>(bus: &Bus, subscriber: &mut Subscriber<M>) -> M {
    let mut message = None;
    bus.wait_until(Instant::now() + PATIENCE, || {
        message = subscriber.try_recv()?;
        Ok::<_, RecvError>(message.is_some())
    })
    .unwrap();
    message.unwrap_or_else(|| panic!("nothing on topic {} within {PATIENCE:?}", subscriber.topic()))
}

/// Waits until somebody subscribes.
pub fn until_heard<M: Message>(bus: &Bus, publisher: &mut Publisher<M>) {
    let heard = bus.wait_until(Instant::now() + PATIENCE, || publisher.has_subscribers()).unwrap();
    assert!(heard, "nobody subscribed to {} within {PATIENCE:?}", publisher.topic());
}

/// A message of a step.
pub fn at<M: Message>(step: u64) -> M {
    let mut message = <M as Message>::zeroed();
    message.head_mut().step = step;
    message
}

/// The bytes in which two messages differ only if they are not the same.
pub fn bytes<M: Message>(message: &M) -> &[u8] {
    bytemuck::bytes_of(message)
}
