//! What this machine's memory does: reading in order, and adding to places in no order.

use mcvr::sampling::rng::{Purpose, fill_u32};
use rayon::prelude::*;

use crate::Entry;

/// Bytes that are read: well beyond any cache of one core, and beyond a shared one where memory for it is cheap to have.
const READ_BYTES: usize = 1 << 29;
/// Additions of one run of all threads together.
const INCREMENTS: usize = 1 << 23;
/// Random places made at a time; they stay in the first cache.
const BATCH: usize = 2048;

/// Names of the rows, which loops refer to.
pub const READ: &str = "read in order";
pub const SMALL: &str = "random increments, 400×400";
pub const LARGE: &str = "random increments, 4096×4096";

pub fn entries(threads: usize) -> Vec<Entry<'static>> {
    vec![reading(threads), increments(SMALL, 400 * 400, threads), increments(LARGE, 4096 * 4096, threads)]
}

/// Sums a large array of words, each thread a part of it.
fn reading(threads: usize) -> Entry<'static> {
    let mut words: Vec<u64> = vec![];
    let work = move || {
        if words.is_empty() {
            words = (0..READ_BYTES as u64 / 8).collect();
        }
        let sum = words.par_chunks(words.len().div_ceil(threads)).map(add).reduce(|| 0, u64::wrapping_add);
        std::hint::black_box(sum);
        Ok(READ_BYTES as u64)
    };
    Entry { name: READ.into(), unit: "byte", threads, limit: None, work: Box::new(work) }
}

/// Eight sums at once, so that the additions wait for memory and not for each other.
fn add(words: &[u64]) -> u64 {
    let mut sums = [0u64; 8];
    for chunk in words.chunks_exact(8) {
        for i in 0..8 {
            sums[i] = sums[i].wrapping_add(chunk[i]);
        }
    }
    sums.into_iter().fold(0, u64::wrapping_add)
}

/// Each thread adds to words of an image of its own, at independent uniform places. Making the places is part of it (a tenth of a
/// nanosecond each).
fn increments(name: &'static str, pixels: usize, threads: usize) -> Entry<'static> {
    let mut images: Vec<Vec<u64>> = vec![];
    let work = move || {
        if images.is_empty() {
            images = vec![vec![0; pixels]; threads];
        }
        let share = INCREMENTS / threads;
        images.par_iter_mut().enumerate().with_max_len(1).for_each(|(thread, image)| {
            let mut places = [0u32; BATCH];
            for batch in 0..(share / BATCH) as u64 {
                fill_u32(thread as u64, Purpose::Offsets, batch, &mut places);
                for p in &mut places {
                    *p = ((u64::from(*p) * pixels as u64) >> 32) as u32;
                }
                for &p in &places {
                    image[p as usize] += 1 + u64::from(p);
                }
            }
        });
        Ok((share / BATCH * BATCH * threads) as u64)
    };
    Entry { name: name.into(), unit: "increment", threads, limit: None, work: Box::new(work) }
}
