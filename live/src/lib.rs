//! Live display of a flight: a page in the browser, and the same in a terminal.
//!
//! A feed ([`BusFeed`], [`LogFeed`]) receives messages as the recorder does, a [`Collector`] makes frames of them,
//! the [`Hub`] sends every frame to all viewers, and the [`Server`] serves them over HTTP. [`Foxglove`] sends the
//! messages themselves to programs that use Foxglove's protocol. No node of the loop waits for any of these: a
//! full queue drops its oldest message, and a viewer that does not read misses frames and is told so.

mod access;
mod address;
mod bus_feed;
mod chi_square;
mod collector;
mod cpu;
mod ears;
mod foxglove;
mod hub;
mod log_feed;
mod nodes;
mod rows;
mod scene;
mod server;
mod terminal;

pub use address::{Address, AddressError, DEFAULT_PORT};
pub use bus_feed::BusFeed;
pub use collector::Collector;
pub use foxglove::{FOXGLOVE_PORT, Foxglove, FoxgloveFeed};
pub use hub::Hub;
pub use log_feed::{LogFeed, Playback};
pub use scene::{Controls, Scene, SwitchedEffect};
pub use server::{Answer, Control, Server, ServerError};
pub use terminal::Terminal;
