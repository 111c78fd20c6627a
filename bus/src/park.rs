//! Sleeping and waking of nodes.
//!
//! A memory region, shared by all nodes of a bench, holds one word per topic and one slot per node. A node
//! that goes to sleep sets its bit in the word of each topic it subscribes to, polls once more for messages,
//! and sleeps on its slot. A publisher reads the word of its topic after publishing; only if bits are set
//! does it clear them and wake those nodes. So sending needs no system call while no node sleeps, a node is
//! woken only by its own topics, and the bit of a killed node is cleared by the first message after its
//! death.
//!
//! Every sleep is short ([`crate::WaitStrategy::sleep`]), so that messages of publishers without access to
//! the region, such as Python nodes, are received too.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering, fence};
use std::time::Duration;

/// Number of topic words, and of slots; bits of a `u64`.
const WORDS: usize = 64;

/// Sleeping nodes of one topic, one bit per slot. Topics that share a word wake each other, which is
/// harmless.
#[repr(C, align(64))]
struct TopicWord {
    parked: AtomicU64,
}

/// Slot on which one node sleeps.
#[repr(C, align(64))]
struct Slot {
    /// Process that uses the slot; 0 for a free slot.
    owner: AtomicU32,
    /// Number of wake-ups; the futex.
    wakes: AtomicU32,
}

/// The shared region. All bytes zero is its initial state, and every bit pattern is valid.
#[repr(C)]
pub(crate) struct Region {
    topics: [TopicWord; WORDS],
    slots: [Slot; WORDS],
}

impl Region {
    /// A region in this process's own memory.
    pub(crate) fn private() -> Self {
        Self {
            topics: std::array::from_fn(|_| TopicWord { parked: AtomicU64::new(0) }),
            slots: std::array::from_fn(|_| Slot { owner: AtomicU32::new(0), wakes: AtomicU32::new(0) }),
        }
    }

    /// Wakes all nodes that sleep and subscribe to the topic; to be called after publishing.
    #[inline]
    pub(crate) fn wake(&self, topic: TopicBit) {
        // Orders the publication before the look at the sleepers. A sleeper sets its bit, fences and then looks for
        // messages: of the two sides at least one sees the other.
        fence(Ordering::SeqCst);
        let word = &self.topics[topic.0].parked;
        if word.load(Ordering::Relaxed) != 0 {
            self.rouse(word);
        }
    }

    #[cold]
    fn rouse(&self, word: &AtomicU64) {
        let mut sleepers = word.swap(0, Ordering::AcqRel);
        while sleepers != 0 {
            let slot = &self.slots[sleepers.trailing_zeros() as usize];
            slot.wakes.fetch_add(1, Ordering::Release);
            futex_wake(&slot.wakes);
            sleepers &= sleepers - 1;
        }
    }

    /// Takes a slot for this process: a free one, or that of a dead process. When all are in use the last one
    /// is shared, which only causes unnecessary wake-ups.
    pub(crate) fn take_slot(&self) -> usize {
        let me = std::process::id();
        let take = |old: u32, slot: &Slot| {
            slot.owner.compare_exchange(old, me, Ordering::AcqRel, Ordering::Relaxed).is_ok()
        };
        let free = self.slots.iter().position(|s| s.owner.load(Ordering::Relaxed) == 0 && take(0, s));
        free.or_else(|| {
            self.slots.iter().position(|s| {
                let owner = s.owner.load(Ordering::Relaxed);
                !is_alive(owner) && take(owner, s)
            })
        })
        .unwrap_or(WORDS - 1)
    }

    /// Frees a slot.
    pub(crate) fn free_slot(&self, slot: usize) {
        let me = std::process::id();
        // Fails when the slot is shared and belongs to another process, which keeps it.
        let _ = self.slots[slot].owner.compare_exchange(me, 0, Ordering::AcqRel, Ordering::Relaxed);
    }

    /// Sleeps until a message is published on a topic of `topics`, or `timeout` is over; not at all if
    /// `ready` returns true.
    pub(crate) fn sleep<E>(
        &self,
        slot: usize,
        topics: u64,
        timeout: Duration,
        ready: &mut impl FnMut() -> Result<bool, E>,
    ) -> Result<bool, E> {
        let bit = 1u64 << slot;
        let wakes = &self.slots[slot].wakes;
        let before = wakes.load(Ordering::Acquire);
        self.each(topics, |word| word.fetch_or(bit, Ordering::AcqRel));
        fence(Ordering::SeqCst);
        let answer = ready();
        if matches!(answer, Ok(false)) {
            futex_wait(wakes, before, timeout);
        }
        self.each(topics, |word| word.fetch_and(!bit, Ordering::AcqRel));
        answer
    }

    fn each(&self, mut topics: u64, change: impl Fn(&AtomicU64) -> u64) {
        while topics != 0 {
            change(&self.topics[topics.trailing_zeros() as usize].parked);
            topics &= topics - 1;
        }
    }
}

/// Index of a topic's word in the region.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TopicBit(usize);

impl TopicBit {
    /// Index of a topic's word, the same in every process.
    pub(crate) fn of(topic: &str) -> Self {
        let hash = topic.bytes().fold(0xcbf2_9ce4_8422_2325u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
        });
        Self(hash as usize % WORDS)
    }

    /// The topic as a bit set.
    pub(crate) fn mask(self) -> u64 {
        1 << self.0
    }
}

fn is_alive(pid: u32) -> bool {
    let Ok(pid) = libc::pid_t::try_from(pid) else { return false };
    // SAFETY: signal 0 only asks whether the process exists; no memory is involved.
    let answer = unsafe { libc::kill(pid, 0) };
    answer == 0 || std::io::Error::last_os_error().raw_os_error() != Some(libc::ESRCH)
}

fn futex_wake(word: &AtomicU32) {
    // SAFETY: the address is that of a live, aligned 32-bit word; FUTEX_WAKE reads nothing else. An error would
    // only mean that nobody sleeps there.
    unsafe { libc::syscall(libc::SYS_futex, word.as_ptr(), libc::FUTEX_WAKE, i32::MAX) };
}

fn futex_wait(word: &AtomicU32, expected: u32, timeout: Duration) {
    let timeout = libc::timespec {
        tv_sec: timeout.as_secs() as libc::time_t,
        tv_nsec: timeout.subsec_nanos() as libc::c_long,
    };
    // SAFETY: the address is that of a live, aligned 32-bit word and the timeout lives until the call returns. All
    // outcomes (woken, changed word, timeout, signal) mean the same to the caller: look again.
    unsafe { libc::syscall(libc::SYS_futex, word.as_ptr(), libc::FUTEX_WAIT, expected, &timeout) };
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::convert::Infallible;
    use std::time::Instant;

    #[test]
    fn a_sleeper_is_woken_by_its_topic_and_not_by_another() {
        let region = Region::private();
        let (mine, other) = (TopicBit(3), TopicBit(9));
        let slot = region.take_slot();
        std::thread::scope(|scope| {
            let sleeper = scope.spawn(|| {
                let start = Instant::now();
                let asleep = Duration::from_secs(60);
                region.sleep::<Infallible>(slot, mine.mask(), asleep, &mut || Ok(false)).unwrap();
                start.elapsed()
            });
            while region.topics[3].parked.load(Ordering::SeqCst) == 0 {
                std::thread::yield_now();
            }
            region.wake(other);
            assert_ne!(region.topics[3].parked.load(Ordering::SeqCst), 0);
            region.wake(mine);
            assert!(sleeper.join().unwrap() < Duration::from_secs(30));
            assert_eq!(region.topics[3].parked.load(Ordering::SeqCst), 0);
        });
    }

    #[test]
    fn no_wake_up_is_lost_between_two_that_answer_each_other() {
        let region = Region::private();
        let (ping, pong) = (TopicBit(1), TopicBit(2));
        let counters = [AtomicU32::new(0), AtomicU32::new(0)];
        const ROUNDS: u32 = 20_000;
        let long = Duration::from_secs(20);
        let start = Instant::now();
        std::thread::scope(|scope| {
            let play = |me: usize, hears: TopicBit, says: TopicBit| {
                let slot = region.take_slot();
                for round in 1..=ROUNDS {
                    if me == 0 {
                        counters[0].store(round, Ordering::Release);
                        region.wake(says);
                    }
                    let mut there = || Ok::<_, Infallible>(counters[1 - me].load(Ordering::Acquire) >= round);
                    while !there().unwrap() {
                        region.sleep(slot, hears.mask(), long, &mut there).unwrap();
                    }
                    if me == 1 {
                        counters[1].store(round, Ordering::Release);
                        region.wake(says);
                    }
                }
                region.free_slot(slot);
            };
            scope.spawn(move || play(0, pong, ping));
            scope.spawn(move || play(1, ping, pong));
        });
        // One lost wake-up would have cost a whole sleep.
        assert!(start.elapsed() < long, "{:?}", start.elapsed());
    }

    #[test]
    fn slots_run_out_gracefully_and_come_back() {
        let region = Region::private();
        let taken: Vec<_> = (0..WORDS).map(|_| region.take_slot()).collect();
        assert_eq!(taken, (0..WORDS).collect::<Vec<_>>());
        assert_eq!(region.take_slot(), WORDS - 1);
        region.free_slot(5);
        assert_eq!(region.take_slot(), 5);
        // A process number that cannot exist stands for a killed node.
        region.slots[7].owner.store(u32::MAX, Ordering::Relaxed);
        assert_eq!(region.take_slot(), 7);
    }

    #[test]
    fn the_topics_of_a_bench_have_words_of_their_own() {
        let names = "imu odometry estimate command setpoint truth disturbance health progress inject pilot";
        let names: Vec<_> = names.split(' ').collect();
        let mut words: Vec<_> = names.iter().map(|n| TopicBit::of(n).0).collect();
        words.sort_unstable();
        words.dedup();
        assert_eq!(words.len(), names.len());
    }
}
