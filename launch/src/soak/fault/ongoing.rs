//! Faults that last.

/// A fault that lasts until this is dropped.
pub(in crate::soak) trait Ongoing {
    /// How much of it there was so far: messages, bytes, processors. A fault of nothing shows nothing.
    fn dealt(&self) -> u64;
}
