//! Transport between processes of one machine: iceoryx2, which passes the `repr(C)` type itself through
//! shared memory.
//!
//! Each bench is its own iceoryx2 domain: its files have the prefix `whirlstand.BENCH~` and are in `/dev/shm`
//! and in `/tmp/whirlstand.BENCH/`. So benches are separate, other iceoryx2 users are not disturbed, and
//! leftover files of killed processes can be removed by name. A foreign program joins by setting the same
//! prefix and root path in its iceoryx2 configuration; `docs/wire-format.md` gives the service's settings.

use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::rc::Rc;
use std::time::{Duration, Instant};

use iceoryx2::node::{Node, NodeBuilder};
use iceoryx2::port::publisher::Publisher as IoxPublisher;
use iceoryx2::port::subscriber::Subscriber as IoxSubscriber;
use iceoryx2::prelude::{
    AttributeVerifier, CallbackProgression, LogLevel, NodeName, Service, ServiceName, SignalHandlingMode,
    ZeroCopySend, ipc, set_log_level_from_env_or,
};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeCreateError, PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::messaging_pattern::MessagingPattern;
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use whirlstand_msgs::Message;

use crate::lost::LostCounter;
use crate::park::Region;
use crate::port::{PublisherPort, SubscriberPort};
use crate::presence::Presence;
use crate::shared_memory_config::{
    MAX_BORROWED, MAX_DEPTH, MAX_PUBLISHERS, MAX_SUBSCRIBERS, SHARED_MEMORY, config, prefix, root_path,
};
use crate::shared_memory_space::{FOR_SERVICE, FOR_SUBSCRIBER, Turn, for_publisher};
use crate::{BusConfig, OpenError, RecvError, SendError, Transport};

/// Largest number of nodes of a bench.
pub const MAX_NODES: usize = 32;
/// Key of the service attribute that holds the schema hash, as `0x` and 16 hexadecimal digits.
pub const SCHEMA_ATTRIBUTE: &str = "whirlstand.schema";

/// Duration of retries while another process creates or removes the same service.
const SETTLE: Duration = Duration::from_secs(2);

/// Time between two of these retries.
const AGAIN: Duration = Duration::from_millis(2);

/// A message in shared memory, with its Whirlstand type name.
#[derive(Debug, Clone, Copy)]
#[repr(transparent)]
pub(crate) struct Shared<M>(pub(crate) M);

// SAFETY: every Message is Pod (plain data: no pointer, no handle, no padding, valid for every bit pattern) and
// repr(C), and its type name together with the service's schema attribute stands for one layout.
unsafe impl<M: Message> ZeroCopySend for Shared<M> {
    unsafe fn type_name() -> &'static str {
        M::TYPE_NAME
    }
}

type Factory<M> = PortFactory<ipc::Service, Shared<M>, ()>;

/// iceoryx2's name of a topic.
pub fn service_name(bench: &str, topic: &str) -> String {
    format!("whirlstand/{bench}/{topic}")
}

/// A node's membership in a bench.
pub(crate) struct Member {
    bench: String,
    // Fields are dropped in this order: the node's files first, then, with the last member, all files of the
    // bench.
    node: Node<ipc::Service>,
    presence: Presence,
}

impl Member {
    pub(crate) fn open(bus: &BusConfig) -> Result<Rc<Self>, OpenError> {
        set_log_level_from_env_or(LogLevel::Fatal);
        let refused = |reason: String| transport_error(&bus.bench, "create a node", reason);
        let config = config(&bus.bench)?;
        let presence = Presence::join(&bus.bench)?;
        make_private_root(&bus.bench)?;
        let turn = Turn::wait(&bus.bench)?;
        turn.require("a node", FOR_SERVICE)?;
        let name = NodeName::new(&bus.node).map_err(|e| refused(format!("{e:?}")))?;
        // Signal handling is left to the program that uses the bus.
        let node = NodeBuilder::new()
            .name(&name)
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create()
            .map_err(|e| refused(e.to_string()))?;
        close_to_others(&bus.bench)?;
        Ok(Rc::new(Self { bench: bus.bench.clone(), node, presence }))
    }

    pub(crate) fn region(&self) -> &Region {
        self.presence.region()
    }

    pub(crate) fn publisher<M: Message>(self: &Rc<Self>, topic: &str) -> Result<Publisher<M>, OpenError> {
        let what = format!("topic \"{topic}\"");
        let turn = Turn::wait(&self.bench)?;
        let factory = self.service::<M>(&turn, topic)?;
        turn.require(&what, for_publisher(size_of::<M>()))?;
        let port = factory
            .publisher_builder()
            .max_loaned_samples(1)
            .create()
            .map_err(|e| transport_error(&self.bench, &format!("publish on topic \"{topic}\""), e))?;
        turn.reserve(&what, port.id().value())?;
        Ok(Publisher { port, factory, _member: self.clone() })
    }

    pub(crate) fn subscriber<M: Message>(
        self: &Rc<Self>,
        topic: &str,
        depth: usize,
    ) -> Result<Subscriber<M>, OpenError> {
        if depth > MAX_DEPTH {
            return Err(OpenError::Depth { topic: topic.into(), depth, max: MAX_DEPTH });
        }
        let what = format!("topic \"{topic}\"");
        let turn = Turn::wait(&self.bench)?;
        let factory = self.service::<M>(&turn, topic)?;
        turn.require(&what, FOR_SUBSCRIBER)?;
        let port = factory
            .subscriber_builder()
            .buffer_size(depth)
            .create()
            .map_err(|e| transport_error(&self.bench, &format!("subscribe to topic \"{topic}\""), e))?;
        turn.reserve(&what, port.id().value())?;
        Ok(Subscriber { port, lost: LostCounter::default(), _member: self.clone() })
    }

    fn service<M: Message>(&self, turn: &Turn, topic: &str) -> Result<Factory<M>, OpenError> {
        turn.require(&format!("topic \"{topic}\""), FOR_SERVICE)?;
        let action = format!("open topic \"{topic}\"");
        let refused = |reason: String| transport_error(&self.bench, &action, reason);
        let text = service_name(&self.bench, topic);
        let name = ServiceName::new(&text).map_err(|e| refused(format!("{e:?}")))?;
        let hash = format!("{:#018x}", M::SCHEMA_HASH);
        let key = SCHEMA_ATTRIBUTE.try_into().map_err(|e| refused(format!("{e:?}")))?;
        let value = hash.as_str().try_into().map_err(|e| refused(format!("{e:?}")))?;
        let schema = AttributeVerifier::new().require(&key, &value).map_err(|e| refused(format!("{e:?}")))?;
        let give_up = Instant::now() + SETTLE;
        loop {
            let attempt = self
                .node
                .service_builder(&name)
                .publish_subscribe::<Shared<M>>()
                .max_publishers(MAX_PUBLISHERS)
                .max_subscribers(MAX_SUBSCRIBERS)
                .max_nodes(MAX_NODES)
                .subscriber_max_buffer_size(MAX_DEPTH)
                .subscriber_max_borrowed_samples(MAX_BORROWED)
                .history_size(0)
                .enable_safe_overflow(true)
                .open_or_create_with_attributes(&schema);
            match attempt {
                Ok(factory) => return Ok(factory),
                Err(e) if is_schema_mismatch(&e) => {
                    return Err(OpenError::Schema {
                        bench: self.bench.clone(),
                        topic: topic.into(),
                        type_name: M::TYPE_NAME,
                        expected: M::SCHEMA_HASH,
                        found: self.schema_in_use(&name),
                    });
                }
                Err(e) if is_in_flux(&e) && Instant::now() < give_up => {
                    // iceoryx2 has no event for a service that becomes complete, or is gone.
                    std::thread::sleep(AGAIN);
                }
                Err(e) => return Err(refused(e.to_string())),
            }
        }
    }

    /// Schema hash and type of an existing service.
    fn schema_in_use(&self, name: &ServiceName) -> String {
        let details = ipc::Service::details(name, self.node.config(), MessagingPattern::PublishSubscribe);
        let Ok(Some(details)) = details else { return "that this program cannot read".into() };
        let mut hash = String::from("without a hash");
        if let Ok(key) = SCHEMA_ATTRIBUTE.try_into() {
            details.static_details.attributes().iter_key_values(&key, |value| {
                hash = value.to_string();
                CallbackProgression::Stop
            });
        }
        let payload = details.static_details.publish_subscribe().message_type_details().payload;
        format!("{hash} ({}, {} bytes)", payload.type_name(), payload.size())
    }
}

/// Creates the folder of iceoryx2's other files before iceoryx2 does, which would make it readable by the
/// owner's group.
fn make_private_root(bench: &str) -> Result<(), OpenError> {
    let path = root_path(bench);
    match std::fs::DirBuilder::new().mode(0o700).create(&path) {
        Err(source) if source.kind() != std::io::ErrorKind::AlreadyExists => {
            Err(OpenError::File { path, source })
        }
        _ => Ok(()),
    }
}

/// Restricts iceoryx2's count of nodes, which it creates writable by everybody, whatever the process's mask
/// is.
fn close_to_others(bench: &str) -> Result<(), OpenError> {
    let prefix = prefix(bench);
    let folder = std::path::Path::new(SHARED_MEMORY);
    let failed = |path: &std::path::Path, source| OpenError::File { path: path.into(), source };
    for entry in std::fs::read_dir(folder).map_err(|e| failed(folder, e))?.flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with(&prefix) && name.ends_with(".global_mgmt") {
            let mode = std::fs::Permissions::from_mode(0o600);
            std::fs::set_permissions(entry.path(), mode).map_err(|e| failed(&entry.path(), e))?;
        }
    }
    Ok(())
}

fn is_schema_mismatch(error: &PublishSubscribeOpenOrCreateError) -> bool {
    use PublishSubscribeOpenError::{IncompatibleAttributes, IncompatibleTypes};
    matches!(
        error,
        PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError(
            IncompatibleAttributes | IncompatibleTypes
        )
    )
}

/// True when another process creates, removes or cleans up the same service at this moment.
fn is_in_flux(error: &PublishSubscribeOpenOrCreateError) -> bool {
    use PublishSubscribeOpenOrCreateError as E;
    match error {
        E::SystemInFlux => true,
        E::PublishSubscribeOpenError(e) => matches!(
            e,
            PublishSubscribeOpenError::IsMarkedForDestruction
                | PublishSubscribeOpenError::HangsInCreation
                | PublishSubscribeOpenError::DoesNotExist
                | PublishSubscribeOpenError::ServiceInCorruptedState
        ),
        E::PublishSubscribeCreateError(e) => matches!(
            e,
            PublishSubscribeCreateError::AlreadyExists
                | PublishSubscribeCreateError::IsBeingCreatedByAnotherInstance
                | PublishSubscribeCreateError::HangsInCreation
                | PublishSubscribeCreateError::ServiceInCorruptedState
        ),
    }
}

fn transport_error(bench: &str, action: &str, reason: impl ToString) -> OpenError {
    OpenError::Transport {
        action: action.into(),
        bench: bench.into(),
        transport: Transport::Iceoryx2,
        reason: reason.to_string(),
    }
}

pub(crate) struct Publisher<M: Message> {
    port: IoxPublisher<ipc::Service, Shared<M>, ()>,
    factory: Factory<M>,
    _member: Rc<Member>,
}

impl<M: Message> PublisherPort<M> for Publisher<M> {
    /// Sends without waiting: a full queue loses its oldest message.
    fn send(&mut self, topic: &str, message: &M, seq: u64) -> Result<(), SendError> {
        let refused = |reason: String| SendError { topic: topic.into(), reason };
        let sample = self.port.loan_uninit().map_err(|e| refused(e.to_string()))?;
        let mut sample = sample.write_payload(Shared(*message));
        sample.payload_mut().0.head_mut().seq = seq;
        sample.send().map_err(|e| refused(e.to_string()))?;
        Ok(())
    }

    fn has_subscribers(&self, _topic: &str) -> Result<bool, SendError> {
        Ok(self.factory.dynamic_config().number_of_subscribers() > 0)
    }
}

pub(crate) struct Subscriber<M: Message> {
    port: IoxSubscriber<ipc::Service, Shared<M>, ()>,
    lost: LostCounter,
    _member: Rc<Member>,
}

impl<M: Message> SubscriberPort<M> for Subscriber<M> {
    fn try_recv(&mut self, topic: &str) -> Result<Option<M>, RecvError> {
        match self.port.receive() {
            Ok(Some(sample)) => {
                let message = sample.payload().0;
                self.lost.note(sample.header().publisher_id().value(), message.head().seq);
                Ok(Some(message))
            }
            Ok(None) => Ok(None),
            Err(e) => Err(RecvError::Transport { topic: topic.into(), reason: e.to_string() }),
        }
    }

    fn lost(&self) -> u64 {
        self.lost.lost()
    }
}
