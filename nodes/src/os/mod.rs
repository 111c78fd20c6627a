//! What a node asks of the operating system: scheduling, exact waking, signals, readiness.

mod notify;
mod scheduling;
mod sleep;
mod stop;

pub use notify::{notify_ready, notify_status};
pub use scheduling::{RealtimeError, apply_realtime};
pub use sleep::{MonotonicTime, sleep_until};
pub use stop::StopFlag;
