//! Pixel sums in integers: private to each worker while they are small, shared and reached by way of bins when they are not.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::SamplingError;
use crate::binned::{Bins, Locks};
use crate::real::Weights;

/// Bytes that private copies may take together before workers share one.
const PRIVATE_BYTES: usize = 48 << 20;

/// Bytes of one copy beyond which samples are better put into bins first.
const COPY_BYTES: usize = 12 << 20;

/// Additions to one private counter before it must be emptied into the total.
const FLUSH: u64 = 1 << 31;

/// The image's sums. Integer addition commutes, so neither threads nor their order show in the result.
pub(crate) struct Totals {
    sums: Vec<AtomicU64>,
    private: bool,
    /// Where the sums are not private, and not too many to be told apart by 32 bits.
    locks: Option<Locks>,
    workers: usize,
}

impl Totals {
    /// Sums for `pixels` pixels and the two places for samples in none of them.
    ///
    /// # Errors
    /// [`SamplingError::Limit`] when there is no memory for them.
    pub(crate) fn new(pixels: usize, workers: usize) -> Result<Self, SamplingError> {
        let slots = pixels + 2;
        let bytes = slots * size_of::<u64>();
        let private = bytes <= COPY_BYTES && bytes * workers <= PRIVATE_BYTES;
        let mut sums = Vec::new();
        sums.try_reserve_exact(slots).map_err(|_| SamplingError::Limit {
            method: "image",
            problem: format!(
                "the sums of its pixels take {bytes} bytes, which are not to be had; ask for fewer pixels"
            ),
        })?;
        sums.resize_with(slots, || AtomicU64::new(0));
        let locks = if private { None } else { Locks::new(slots) };
        Ok(Self { sums, private, locks, workers })
    }

    fn add(&self, pixel: u32, amount: u64) {
        self.add_at(pixel as usize, amount);
    }

    fn add_at(&self, slot: usize, amount: u64) {
        self.sums[slot].fetch_add(amount, Ordering::Relaxed);
    }

    /// A worker's way in, for a share of `samples` samples.
    pub(crate) fn worker(&self, weighed: bool, samples: u64) -> Worker<'_> {
        let slots = self.sums.len();
        let own = match (self.private && samples >= self.few(), weighed, &self.locks) {
            (true, false, _) => Own::Counts(vec![0; slots]),
            (true, true, _) => Own::Weights(vec![0; slots]),
            // All workers of such sums use bins, however few their samples: who holds no lock may not add.
            (false, _, Some(locks)) => {
                Own::Binned(locks, Bins::new(slots, self.workers), Bins::new(slots, self.workers))
            }
            (false, _, None) => Own::Shared,
        };
        Worker { totals: self, own, since_flush: 0 }
    }

    /// Back to nothing.
    pub(crate) fn clear(&mut self) {
        self.sums.iter_mut().for_each(|s| *s.get_mut() = 0);
    }

    /// Fewer samples than this are added one by one: emptying private copies would take longer.
    fn few(&self) -> u64 {
        self.sums.len() as u64 / 8
    }

    /// The sums of the pixels, without the two extra places.
    pub(crate) fn into_sums(self) -> impl Iterator<Item = u64> {
        let pixels = self.sums.len() - 2;
        self.sums.into_iter().take(pixels).map(AtomicU64::into_inner)
    }

    /// The sum of one pixel.
    #[inline]
    pub(crate) fn sum(&self, slot: usize) -> u64 {
        self.sums[slot].load(Ordering::Relaxed)
    }
}

enum Own<'a> {
    Counts(Vec<u32>),
    Weights(Vec<u64>),
    /// Narrow weights or counts, and wide ones.
    Binned(&'a Locks, Bins<u32>, Bins<u64>),
    Shared,
}

/// One worker's accumulator; [`Worker::finish`] adds it to the totals.
pub(crate) struct Worker<'a> {
    totals: &'a Totals,
    own: Own<'a>,
    since_flush: u64,
}

impl<'a> Worker<'a> {
    /// Goes on to another film of the same kind and size, with the memory of this one.
    pub(crate) fn turn_to(mut self, totals: &'a Totals, weighed: bool, samples: u64) -> Self {
        self.flush();
        let private = matches!(self.own, Own::Counts(_) | Own::Weights(_));
        let shared = matches!(self.own, Own::Shared) && totals.locks.is_none();
        let wanted = totals.private && samples >= totals.few();
        if if wanted { private } else { shared } {
            return Self { totals, ..self };
        }
        totals.worker(weighed, samples)
    }

    /// Adds a batch: one to each pixel, or its weight where there are weights.
    pub(crate) fn add(&mut self, pixels: &[u32], weights: &Weights) {
        match (&mut self.own, weights.narrow.is_empty(), weights.wide.is_empty()) {
            (Own::Counts(counts), ..) => {
                add_ones(counts, pixels);
                self.since_flush += pixels.len() as u64;
                if self.since_flush >= FLUSH {
                    self.flush();
                }
            }
            (Own::Weights(sums), false, _) => add_narrow(sums, pixels, &weights.narrow),
            (Own::Weights(sums), true, _) => {
                for (&p, &w) in pixels.iter().zip(&weights.wide) {
                    sums[p as usize] += w;
                }
            }
            (Own::Binned(locks, bins, _), narrow_is_empty, true) => {
                if narrow_is_empty {
                    pixels.iter().for_each(|&p| bins.put(p, 1));
                } else {
                    pixels.iter().zip(&weights.narrow).for_each(|(&p, &w)| bins.put(p, w));
                }
                bins.settle(pixels.len(), &self.totals.sums, locks);
            }
            (Own::Binned(locks, _, bins), _, false) => {
                pixels.iter().zip(&weights.wide).for_each(|(&p, &w)| bins.put(p, w));
                bins.settle(pixels.len(), &self.totals.sums, locks);
            }
            (Own::Shared, true, true) => pixels.iter().for_each(|&p| self.totals.add(p, 1)),
            (Own::Shared, false, _) => {
                pixels.iter().zip(&weights.narrow).for_each(|(&p, &w)| self.totals.add(p, u64::from(w)));
            }
            (Own::Shared, true, false) => pixels.iter().zip(&weights.wide).for_each(|(&p, &w)| self.totals.add(p, w)),
        }
    }

    /// Adds a batch of several channels: `channels` amounts side by side for each pixel.
    pub(crate) fn add_channels(&mut self, channels: usize, pixels: &[u32], amounts: &[u64]) {
        match (&mut self.own, channels) {
            (Own::Weights(sums), 1) => {
                for (&p, &a) in pixels.iter().zip(amounts) {
                    sums[p as usize] += a;
                }
            }
            (Own::Weights(sums), _) => {
                for (&p, amounts) in pixels.iter().zip(amounts.chunks_exact(channels)) {
                    let first = p as usize * channels;
                    for (sum, a) in sums[first..first + channels].iter_mut().zip(amounts) {
                        *sum += a;
                    }
                }
            }
            (Own::Binned(locks, _, bins), _) => {
                for (&p, amounts) in pixels.iter().zip(amounts.chunks_exact(channels)) {
                    for (c, &a) in amounts.iter().enumerate() {
                        bins.put(p * channels as u32 + c as u32, a);
                    }
                }
                bins.settle(pixels.len() * channels, &self.totals.sums, locks);
            }
            (Own::Shared | Own::Counts(_), _) => {
                for (&p, amounts) in pixels.iter().zip(amounts.chunks_exact(channels)) {
                    for (c, &a) in amounts.iter().enumerate() {
                        self.totals.add_at(p as usize * channels + c, a);
                    }
                }
            }
        }
    }

    fn flush(&mut self) {
        self.since_flush = 0;
        let add = |total: &AtomicU64, own: u64| {
            if own != 0 {
                total.fetch_add(own, Ordering::Relaxed);
            }
        };
        match &mut self.own {
            Own::Counts(counts) => {
                self.totals.sums.iter().zip(&mut *counts).for_each(|(t, c)| add(t, u64::from(std::mem::take(c))));
            }
            Own::Weights(sums) => {
                self.totals.sums.iter().zip(&mut *sums).for_each(|(t, s)| add(t, std::mem::take(s)));
            }
            Own::Binned(locks, narrow, wide) => {
                narrow.empty(&self.totals.sums, locks);
                wide.empty(&self.totals.sums, locks);
            }
            Own::Shared => {}
        }
    }

    /// Adds what is left to the totals.
    pub(crate) fn finish(mut self) {
        self.flush();
    }
}

/// Places in a batch from which samples are added in turn. Neighbours in a batch lie near each other and often in one pixel,
/// and an addition to a sum that was stored an instant ago must wait for it; samples from eight places rarely meet.
const WAYS: usize = 8;

/// Adds one to each pixel.
fn add_ones(counts: &mut [u32], pixels: &[u32]) {
    let part = pixels.len() / WAYS;
    let parts: [&[u32]; WAYS] = std::array::from_fn(|k| &pixels[k * part..(k + 1) * part]);
    for i in 0..part {
        for pixels in parts {
            counts[pixels[i] as usize] += 1;
        }
    }
    for &p in &pixels[WAYS * part..] {
        counts[p as usize] += 1;
    }
}

/// Adds a weight to each pixel.
fn add_narrow(sums: &mut [u64], pixels: &[u32], weights: &[u32]) {
    let part = pixels.len() / WAYS;
    let parts: [[&[u32]; 2]; WAYS] =
        std::array::from_fn(|k| [&pixels[k * part..(k + 1) * part], &weights[k * part..(k + 1) * part]]);
    for i in 0..part {
        for [pixels, weights] in parts {
            sums[pixels[i] as usize] += u64::from(weights[i]);
        }
    }
    for (&p, &w) in pixels[WAYS * part..].iter().zip(&weights[WAYS * part..]) {
        sums[p as usize] += u64::from(w);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn private_and_shared_sums_are_the_same() {
        // More than the ways, and no multiple of them.
        let pixels = [0u32, 3, 3, 1, 4, 5, 0, 3, 3, 1, 4, 5, 0, 3, 3, 1, 4, 5, 2];
        let repeat = |w: [u64; 6]| [&w[..], &w, &w, &[7]].concat();
        let none = Weights::default();
        let wide = Weights { wide: repeat([10u64, 1 << 40, 2, 3, 100, 200]), ..Weights::default() };
        let narrow = Weights {
            narrow: repeat([10, 1 << 20, 2, 3, 100, 200]).iter().map(|w| *w as u32).collect(),
            ..Weights::default()
        };
        let run = |private: bool, weights: &Weights| {
            let mut totals = Totals::new(4, 2).expect("memory");
            totals.private = private;
            for _ in 0..2 {
                let mut w = totals.worker(!std::ptr::eq(weights, &none), 6);
                w.add(&pixels, weights);
                w.finish();
            }
            totals.into_sums().map(|s| s as f64 * 0.5).collect::<Vec<_>>()
        };
        assert_eq!(run(true, &none), vec![3.0, 3.0, 1.0, 6.0]);
        for weights in [&none, &wide, &narrow] {
            assert_eq!(run(true, weights), run(false, weights));
        }
    }

    /// Sums of more than one bin, from two threads, emptied in between because they hold more than they may.
    #[test]
    fn bins_lose_nothing() {
        let slots = (1 << 21) + 5;
        let pixels: Vec<u32> = (0..1u64 << 16).map(|k| (k * 0x9e37_79b9_7f4a % slots as u64) as u32).collect();
        let narrow = Weights { narrow: pixels.iter().map(|p| p % 1000 + 1).collect(), ..Weights::default() };
        let wide = Weights { wide: pixels.iter().map(|p| u64::from(*p) << 20 | 1).collect(), ..Weights::default() };
        let batches = 40;
        for weights in [&Weights::default(), &narrow, &wide] {
            let totals = Totals::new(slots, 2).expect("memory");
            let weighed = !(weights.narrow.is_empty() && weights.wide.is_empty());
            let worker = totals.worker(weighed, 1 << 30);
            assert!(matches!(worker.own, Own::Binned(..)), "an image of this size goes through bins");
            worker.finish();
            std::thread::scope(|scope| {
                for _ in 0..2 {
                    scope.spawn(|| {
                        let mut worker = totals.worker(weighed, 1 << 30);
                        (0..batches).for_each(|_| worker.add(&pixels, weights));
                        worker.finish();
                    });
                }
            });
            let mut expected = vec![0u64; slots];
            for (n, p) in pixels.iter().enumerate() {
                let amount = weights.narrow.get(n).map(|w| u64::from(*w)).or(weights.wide.get(n).copied()).unwrap_or(1);
                expected[*p as usize] += 2 * batches * amount;
            }
            assert!(totals.into_sums().eq(expected), "sums by way of bins");
        }
    }
}
