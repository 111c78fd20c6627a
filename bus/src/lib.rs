//! Transport of messages: one publish/subscribe interface over iceoryx2, Zenoh and in-process.
//!
//! A node joins a bench, opens publishers and subscribers of message types, and waits for what it needs. Which
//! transport carries the messages is a setting, not code.
//!
//! ```
//! use std::time::{Duration, Instant};
//! use whirlstand_bus::{Bus, BusConfig, Transport};
//! use whirlstand_msgs::{Imu, Message};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let bus = Bus::open(&BusConfig::new("example", "echo", Transport::Inproc))?;
//! let mut imus = bus.subscriber::<Imu>(8)?;
//! let mut sensor = bus.publisher::<Imu>()?;
//! sensor.send(&Imu { roll: 0.1, ..Imu::zeroed() })?;
//!
//! let mut imu = None;
//! let soon = Instant::now() + Duration::from_secs(1);
//! bus.wait_until(soon, || {
//!     imu = imus.try_recv()?;
//!     Ok::<_, whirlstand_bus::RecvError>(imu.is_some())
//! })?;
//! assert_eq!(imu.ok_or("nothing came")?.roll, 0.1);
//! # Ok(())
//! # }
//! ```
//!
//! The following rules hold on every transport, and one conformance suite checks them:
//! - topics are named under the bench's name, so that benches are separate;
//! - any number of nodes publish on and subscribe to a topic; the messages of one publisher stay in order;
//! - a subscriber receives what is published from its opening on, nothing from before;
//! - sending never waits for a receiver; a full queue drops its oldest message and counts it;
//! - a killed node does not disturb the others, and can be restarted;
//! - a node with another version of a message is refused: see [`OpenError::Schema`] and [`RecvError::Refused`].

mod authority;
mod bus;
mod carried;
mod config;
mod error;
mod inproc;
mod launcher;
mod lock_file;
mod lost;
mod network;
mod network_keys;
mod network_settings;
mod park;
mod port;
mod presence;
mod protection;
mod residue;
pub mod ring;
mod session;
mod shared_memory;
mod shared_memory_config;
mod shared_memory_space;
mod transport;

pub use authority::{Authority, AuthorityError};
pub use bus::{Bus, Publisher, Subscriber};
pub use carried::{Carried, OpenPublisher, OpenSubscriber, Place};
pub use config::{BusConfig, MAX_NAME, WaitStrategy, ZenohConfig, check_bench_name};
pub use error::{OpenError, RecvError, Refusal, ResidueError, SendError};
pub use launcher::LauncherToken;
pub use lock_file::open_lock_file;
pub use network_keys::{key_expression, spoken_key};
pub use network_settings::{over_tls, zenoh_configuration};
pub use protection::{Identity, Member, ONE_THREAD, Protection, Writes};
pub use residue::{Residue, StaleBench, remove_residue, stale_benches};
pub use session::{SessionError, open_session};
pub use shared_memory::{MAX_NODES, SCHEMA_ATTRIBUTE, service_name};
pub use shared_memory_config::{MAX_DEPTH, MAX_PUBLISHERS, MAX_SUBSCRIBERS};
pub use transport::{Transport, UnknownTransport};
