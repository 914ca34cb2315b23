//! Memory that opening a hostile file takes, measured by a counting allocator.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which clippy does not take for tests")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering::SeqCst};

use mcvr_volume::open;

/// Counts the bytes in use and their peak.
struct Counting;

static USED: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

// SAFETY: hands every call on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        PEAK.fetch_max(USED.fetch_add(layout.size(), SeqCst) + layout.size(), SeqCst);
        // SAFETY: the caller's promises are those of this call.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        USED.fetch_sub(layout.size(), SeqCst);
        // SAFETY: the caller's promises are those of this call.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Bytes that opening takes at its peak; the file must be refused.
fn peak_of(path: &Path) -> usize {
    let before = USED.load(SeqCst);
    PEAK.store(before, SeqCst);
    assert!(open(path, None).is_err(), "{}", path.display());
    PEAK.load(SeqCst) - before
}

fn packed(megabytes: usize, fill: impl Fn(usize) -> u8) -> Vec<u8> {
    let mut e = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    for m in 0..megabytes {
        e.write_all(&(0..1 << 20).map(|n| fill(m << 20 | n)).collect::<Vec<u8>>()).unwrap();
    }
    e.finish().unwrap()
}

/// One test, because the peak is the process's.
#[test]
fn hostile_files_take_no_more_memory_than_their_data() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };

    // 100 MiB behind a name that asks for 8 bytes.
    let bomb = file("bomb_2x2x2_uint8.raw.gz", &packed(100, |_| 0));
    let peak = peak_of(&bomb);
    assert!(peak < 1 << 20, "{peak} bytes");

    // A name that asks for 3 GiB, which the length of the packed data would allow, but 4 MiB of data.
    let noise = |n: usize| {
        let z = (n as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb).to_be_bytes()[0]
    };
    let promise = file("promise_1024x1024x3072_uint8.raw.gz", &packed(4, noise));
    assert!(std::fs::metadata(&promise).unwrap().len() * 1032 > 3 << 30);
    let peak = peak_of(&promise);
    // The buffer doubles, and for a moment the old one stays beside the new one.
    assert!(peak < 16 << 20, "{peak} bytes");

    // A NRRD header that asks for a tebibyte.
    let mut nrrd = b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 1048576 1048576 1\nencoding: raw\n\n".to_vec();
    nrrd.extend([0; 1000]);
    assert!(peak_of(&file("tera.nrrd", &nrrd)) < 1 << 16);
}
