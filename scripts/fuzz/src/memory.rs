//! An allocator that ends the process at an allocation which the input cannot fill.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

struct Bounded;

/// Largest single allocation, bytes.
static LIMIT: AtomicUsize = AtomicUsize::new(usize::MAX);

/// What any program takes for itself: buffers, tables of decoders, the stacks of threads.
const BASE: usize = 16 << 20;
/// Deflate gives at most 1032 bytes for one; a bit of a packed picture becomes a value of eight bytes.
const RATIO: usize = 1032 * 8 * 8;

/// Sets the limit for an input of `bytes`.
pub fn allow(bytes: usize) {
    LIMIT.store(BASE + RATIO * bytes, Relaxed);
}

fn check(size: usize) {
    if size > LIMIT.load(Relaxed) {
        // The message allocates as well.
        LIMIT.store(usize::MAX, Relaxed);
        eprintln!("one allocation of {size} bytes");
        std::process::abort();
    }
}

// SAFETY: hands every call on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Bounded {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if layout.size() > BASE {
            check(layout.size());
        }
        // SAFETY: the caller's promises are those of this call.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if layout.size() > BASE {
            check(layout.size());
        }
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        if size > BASE {
            check(size);
        }
        // SAFETY: as above.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Bounded = Bounded;
