//! The processes of a bench: plant, estimator, controller, recorder.

pub mod clock;
pub mod config;
pub mod controller;
pub mod error;
pub mod estimator;
pub mod gate;
pub mod inproc;
pub mod os;
mod peers;
pub mod plant;
mod ports;
pub mod process;
pub mod recorder;
pub mod setup;
pub mod signals;

pub use error::NodeError;
pub use inproc::run_inproc;
pub use process::{run_node, run_node_until};
