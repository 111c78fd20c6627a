//! Operating-system services of a node: scheduling, exact wake-ups, signals, readiness.

mod notify;
mod port_holder;
mod restarts;
mod scheduling;
mod sleep;
mod stop;

pub use notify::{notify_ready, notify_status};
pub(crate) use port_holder::with_holder;
pub use restarts::RESTARTS;
pub(crate) use restarts::was_restarted;
pub(crate) use scheduling::available_cpus;
pub use scheduling::{RealtimeError, apply_realtime};
pub use sleep::{MonotonicTime, sleep_until};
pub(crate) use sleep::{thread_time, wake_when_due};
pub use stop::StopFlag;
