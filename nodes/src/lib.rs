//! The processes of a bench: plant, estimator, controller, recorder.
//!
//! Each node is a state machine over the bus: a `turn` does all work that is possible now and never waits. A
//! process runs one node with [`run_node`]; [`run_inproc`] runs all nodes in turn in one thread.
//!
//! # A step
//! At `t_j` the plant closes the [`gate`] for command j-1, publishes `Truth` j, `Odometry` j, `Disturbance` j
//! (when it changed) and last `Imu` j, and integrates to `t_j+1`. The estimator answers `Imu` j with `Estimate` j,
//! the controller that with command j. Steps are numbered by the plant alone, and every message of a step carries
//! its number and its bench time, step times period.
//!
//! # How a run begins
//! 1. A node opens all its ports, its subscription to `health` last, and reports `READY=1` to `NOTIFY_SOCKET`. It
//!    then publishes `Health` with state `Starting`: at once, whenever it hears somebody new, and every 100 ms.
//! 2. Because `health` comes last, having heard the health of X means that X knows all subscriptions of this node
//!    (over Zenoh, declarations arrive in order). A node that has heard everybody it listens to says `Running`.
//! 3. When all its peers are `Running` the plant publishes step 0, with neutral inputs, and waits for command 0. So
//!    no message of step 0 can be lost. Peers that are foreign programs publish no `Health`; for them, and for
//!    peers of a plant that was restarted, `Imu` 0 is repeated every 200 ms until it is answered. A repeated
//!    step is answered with the same message again, and recorded once.
//! 4. In realtime the clock starts with that answer: command 0 acts from one period later.
//!
//! # How it ends
//! After the last step, or when it is asked to stop, the plant waits for the command of its last step, which
//! completes the log, and says `Stopping` with the number of that step. The recorder, once asked to stop, writes
//! until every topic has reached that step (at most 2 s), then closes the file. So the order is: plant, controller,
//! estimator, recorder.
//!
//! # When a node is lost
//! - **Controller or estimator**: no commands arrive. In realtime the last one is held, and after
//!   `misses_to_failsafe` misses the inputs go to neutral; in lockstep the plant waits until another process
//!   has replaced the node (or for `answer_timeout_s`, if it is set) and goes to neutral for the unanswered
//!   step. A live controller without a usable command reports it, and the plant goes to neutral at once. The
//!   failsafe is reported in `Health`, in `Truth` and on standard error. A restarted node joins at the first
//!   step it receives, and the first command in time ends the failsafe.
//! - **Plant**: the others wait. A restarted plant begins a new run at step 0. Estimator and controller see
//!   the step number go back, and restart as well; the recorder begins its next file (`log.2.mcap`).
//! - **Recorder**: the loop continues; a lockstep plant waits for a recorder as long as it is alive, but not
//!   for messages on their way to one that has been replaced. A restarted recorder writes `log.2.mcap`: no
//!   log is overwritten.
//! - **Mirror**: the loop is not affected; a lockstep plant waits for it as for the recorder.
//! - **A node that was only stopped** (`SIGSTOP`) finds a queue of old messages, answers them, and its late
//!   answers are refused as stale. A realtime plant that was stopped does not catch up: bench time stood
//!   still with it, and every whole period of the delay counts as a miss.

mod adjustment_desk;
pub mod bench;
pub mod bridge;
pub mod clock;
mod companion;
pub mod config;
pub mod controller;
pub mod error;
pub mod estimator;
pub mod flight;
pub mod follower;
pub mod gate;
pub mod inproc;
pub mod mirror;
mod mirror_config;
mod notices;
mod onset;
pub mod os;
mod peers;
pub mod plant;
mod ports;
pub mod process;
mod ready;
pub mod recorder;
mod refusal;
pub mod relay;
pub mod setup;
pub mod signals;
mod succession;
pub mod topics;
mod wait_report;
mod worker;

pub use adjustment_desk::ADJUST_TOPIC;
pub use error::NodeError;
pub use inproc::run_inproc;
pub use process::{run_node, run_node_until};
pub use ready::is_ready;
pub use refusal::refusal;
pub use wait_report::WAITING_FOR;
