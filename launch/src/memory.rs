//! What happens where there is no memory left: one sentence and exit code 2, in the place of an abort. A node that flies ends
//! with exit code 1, so that it is started again: memory that is short for a while is no end of a run.

use std::alloc::{GlobalAlloc, Layout, System};

/// Exit code of what the user can mend.
const MENDABLE: i32 = 2;

/// Exit code of what may go well the next time.
const FAILED: i32 = 1;

#[global_allocator]
static ALLOCATOR: OrSaySo = OrSaySo;

/// The system's allocator. Where it has nothing, the process ends with a sentence.
struct OrSaySo;

impl OrSaySo {
    fn checked(given: *mut u8, bytes: usize) -> *mut u8 {
        if given.is_null() {
            give_up(bytes);
        }
        given
    }
}

/// What takes more than this is given back to the system as soon as it is free, bytes. A vector of all samples of ten
/// minutes at 100 Hz of eight outputs is smaller (3.8 MB): a search makes and drops such vectors by the thousand, and to have
/// each mapped and zeroed anew took as long as a third of the search. A signal of ten minutes at 1 kHz is larger (4.8 MB):
/// of those a few are made before the search, and would lie between what it keeps.
const LARGE: libc::c_int = 4 << 20;

/// Of what is smaller, so much may lie free at an end of the heap before it is given back, bytes.
const KEPT: libc::c_int = 32 << 20;

/// Gives what is large and no longer held back to the system at once. By itself the system's allocator learns to keep pieces of
/// up to 32 MB: for a long record that doubles what a process has, and its nodes have no such pieces.
pub(crate) fn give_large_pieces_back() {
    #[cfg(target_env = "gnu")]
    // SAFETY: mallopt(3) sets a number of the allocator, under its own lock; one that it does not take changes nothing.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, LARGE);
        libc::mallopt(libc::M_TRIM_THRESHOLD, KEPT);
    }
}

// SAFETY: every call is the system allocator's with the arguments as they came; a null pointer is never returned, because
// the process then ends.
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

/// Says how much was asked for, without asking for more, and ends the process.
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
        // SAFETY: write(2) reads the slice, which lives; what it could not write cannot be told anywhere else.
        unsafe { libc::write(libc::STDERR_FILENO, part.as_ptr().cast(), part.len()) };
    }
    // SAFETY: _exit(2) ends the process without running anything that could ask for memory again.
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
