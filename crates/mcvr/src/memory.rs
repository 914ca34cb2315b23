//! What becomes of memory between images.

/// Blocks of up to this many bytes are taken from memory that the process keeps.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const KEPT: i32 = 16 << 20;

/// Asks the C library to keep freed blocks of up to 16 MiB, 128 MiB in all, for the next image instead of handing them back to the system,
/// which would hand them out again page by page: that takes as long as a quick image of 400 by 400 pixels itself. For a program to
/// call when it starts; the `mcvr` program does. Does nothing where the C library is not GNU's.
pub fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: sets two numbers of the allocator, under its own lock; values out of range are refused.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, KEPT);
        libc::mallopt(libc::M_TRIM_THRESHOLD, 8 * KEPT);
    }
}
