//! Sums of images that no cache holds: samples wait in bins by their place in the image.
//!
//! Added one by one, each sample waits for a line of memory that holds eight sums, of which it needs one. In bins of 2^17 sums (1 MiB,
//! what a core's own cache holds) they are written and read in order, and all that fall on a line find it there.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Sums of a bin, as a power of two.
const SHIFT: u32 = 17;

/// Bytes that waiting samples of all workers may take; the lists that hold them up to twice as much.
const BYTES: usize = 32 << 20;

/// One lock for each bin's part of the sums. Only who holds it changes them.
pub(crate) struct Locks(Vec<Mutex<()>>);

impl Locks {
    /// Locks for so many sums; `None` where a 32-bit number does not tell them apart.
    pub(crate) fn new(slots: usize) -> Option<Self> {
        u32::try_from(slots).ok().map(|_| Self((0..slots.div_ceil(1 << SHIFT)).map(|_| Mutex::new(())).collect()))
    }
}

/// Waiting samples of one worker: the number of a sum, and what comes to it.
pub(crate) struct Bins<W> {
    bins: Vec<Vec<(u32, W)>>,
    held: usize,
    most: usize,
}

impl<W: Copy + Into<u64>> Bins<W> {
    /// Bins for one of so many workers.
    pub(crate) fn new(slots: usize, workers: usize) -> Self {
        let most = BYTES / workers.max(1) / size_of::<(u32, W)>();
        Self { bins: (0..slots.div_ceil(1 << SHIFT)).map(|_| vec![]).collect(), held: 0, most }
    }

    /// Puts a sample into its bin. [`Self::settle`] is to follow after a batch.
    #[inline]
    pub(crate) fn put(&mut self, slot: u32, amount: W) {
        self.bins[(slot >> SHIFT) as usize].push((slot, amount));
    }

    /// To be called after so many samples more: empties the bins when they hold enough.
    pub(crate) fn settle(&mut self, more: usize, sums: &[AtomicU64], locks: &Locks) {
        self.held += more;
        if self.held >= self.most {
            self.empty(sums, locks);
        }
    }

    /// Adds all that waits to the sums.
    pub(crate) fn empty(&mut self, sums: &[AtomicU64], locks: &Locks) {
        self.held = 0;
        for (bin, lock) in self.bins.iter_mut().zip(&locks.0) {
            if bin.is_empty() {
                continue;
            }
            // The lock guards no data of its own, so that a panic elsewhere has spoiled none.
            let held = lock.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            for (slot, amount) in bin.drain(..) {
                let sum = &sums[slot as usize];
                sum.store(sum.load(Ordering::Relaxed) + amount.into(), Ordering::Relaxed);
            }
            drop(held);
        }
    }
}
