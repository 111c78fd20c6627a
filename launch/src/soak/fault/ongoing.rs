//! Faults that last.

/// A fault that lasts until this is dropped.
pub(in crate::soak) trait Ongoing {
    /// Amount of the fault so far: messages, bytes or processors. A fault of amount zero tests nothing.
    fn dealt(&self) -> u64;
}
