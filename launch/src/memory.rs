//! Behaviour when memory is exhausted: one sentence and exit code 2, instead of an abort. A node in flight ends
//! with exit code 1, so that it is restarted: a temporary shortage of memory does not end a run.

use std::alloc::{GlobalAlloc, Layout, System};

/// Exit code of a failure that the user can correct.
const MENDABLE: i32 = 2;

/// Exit code of a failure after which another attempt may succeed.
const FAILED: i32 = 1;

#[global_allocator]
static ALLOCATOR: OrSaySo = OrSaySo;

/// The system's allocator. When an allocation fails, the process ends with a sentence.
struct OrSaySo;

impl OrSaySo {
    fn checked(given: *mut u8, bytes: usize) -> *mut u8 {
        if given.is_null() {
            give_up(bytes);
        }
        given
    }
}

/// Size above which a block is given back to the system as soon as it is free, bytes. A vector of all samples of
/// ten minutes at 100 Hz of eight outputs is smaller (3.8 MB): a search allocates and frees thousands of such
/// vectors, and mapping and zeroing each of them anew took a third of the search's time. A signal of ten minutes
/// at 1 kHz is larger (4.8 MB): a few of these are made before the search, and would fragment the memory that the
/// search keeps.
const LARGE: libc::c_int = 4 << 20;

/// Free memory of smaller blocks at the top of the heap that is kept before it is given back, bytes.
const KEPT: libc::c_int = 32 << 20;

/// Makes the allocator give large free blocks back to the system at once. By default the system's allocator learns
/// to keep blocks of up to 32 MB, in a heap of its own for every thread. For a long record that doubles the memory
/// of a process; nodes have no such blocks. The threads of a search compute for milliseconds between two allocations,
/// so that one heap for all of them costs no time.
pub(crate) fn give_large_pieces_back() {
    #[cfg(target_env = "gnu")]
    // SAFETY: mallopt(3) sets a parameter of the allocator under its own lock; a value that it does not accept
    // changes nothing.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, LARGE);
        libc::mallopt(libc::M_TRIM_THRESHOLD, KEPT);
        libc::mallopt(libc::M_ARENA_MAX, 1);
    }
}

// SAFETY: every call passes its arguments unchanged to the system allocator. A null pointer is never returned,
// because the process ends first.
unsafe impl GlobalAlloc for OrSaySo {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller keeps the contract of `alloc`.
        Self::checked(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller keeps the contract of `alloc_zeroed`.
        Self::checked(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller keeps the contract of `realloc`.
        Self::checked(unsafe { System.realloc(pointer, layout, size) }, size)
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the contract of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// Reports the size of the failed allocation without allocating, and ends the process.
#[cold]
fn give_up(bytes: usize) -> ! {
    let mut digits = [0; 20];
    let number = decimal(bytes, &mut digits);
    for part in [
        b"error: out of memory (".as_slice(),
        number,
        b" more bytes were requested): allow this process more memory (ulimit -v, or its container's limit), or \
          use a shorter record\n",
    ] {
        // SAFETY: write(2) reads the slice, which is alive; a failed write cannot be reported anywhere else.
        unsafe { libc::write(libc::STDERR_FILENO, part.as_ptr().cast(), part.len()) };
    }
    // SAFETY: _exit(2) ends the process without running code that could allocate again.
    unsafe { libc::_exit(if whirlstand_nodes::is_ready() { FAILED } else { MENDABLE }) }
}

fn decimal(mut number: usize, digits: &mut [u8; 20]) -> &[u8] {
    let mut at = digits.len();
    loop {
        at -= 1;
        digits[at] = b'0' + (number % 10) as u8;
        number /= 10;
        if number == 0 {
            return &digits[at..];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::decimal;

    #[test]
    fn numbers_are_written_without_memory() {
        for number in [0, 7, 10, 1_600_000, usize::MAX] {
            assert_eq!(decimal(number, &mut [0; 20]), number.to_string().as_bytes());
        }
    }
}
