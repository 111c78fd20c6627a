//! What flies, while it flies: a page in the browser and the same in a terminal.
//!
//! A feed ([`BusFeed`], [`LogFeed`]) hears messages as the recorder does, a [`Collector`] makes frames of them, the [`Hub`]
//! hands every frame to whoever looks on, and the [`Server`] is a web server on that. [`Foxglove`] hands the messages
//! themselves to programs that speak Foxglove's protocol. Nobody in the loop waits for any of
//! them: a queue that is full loses its oldest message, a viewer that does not read misses frames and is told so.

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
