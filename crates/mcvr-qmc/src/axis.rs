//! One kernel coordinate of a digital net: a word for each point, in runs that share their high index bits.

use mcvr_sampling::rng::xor;

use crate::scramble::{Scrambled, owen};
use crate::sobol::point;

/// Points that share their high index bits; their digits differ by a table look-up.
const RUN: usize = 1024;

#[derive(Clone, Debug)]
pub(crate) struct Axis {
    scrambled: Scrambled,
    /// First 32 digits of the points 0..RUN, before the shift.
    table: Vec<u32>,
}

impl Axis {
    /// A coordinate of `samples` points.
    pub(crate) fn new(scrambled: Scrambled, samples: u64) -> Self {
        let table =
            (0..(RUN as u64).min(samples)).map(|i| (point(&scrambled.columns, i) >> 32) as u32).collect::<Vec<_>>();
        Self { scrambled, table }
    }

    /// First 32 digits of one point, by the plain definition that [`Axis::fill`] must agree with.
    pub(crate) fn digits(&self, index: u64) -> u32 {
        let s = &self.scrambled;
        let digits = ((point(&s.columns, index) ^ s.shift) >> 32) as u32;
        s.owen.map_or(digits, |seed| owen(digits, seed))
    }

    /// First 32 digits of the points whose indices are those from `first` on with the bits of `flip` exchanged. `first` is a
    /// multiple of [`RUN`] or of a power of two not below the words' number.
    pub(crate) fn fill(&self, first: u64, flip: u64, words: &mut [u32]) {
        let s = &self.scrambled;
        let shift = s.shift ^ point(&s.columns, flip);
        for (run, words) in words.chunks_mut(RUN).enumerate() {
            let base = ((point(&s.columns, first + (run * RUN) as u64) ^ shift) >> 32) as u32;
            match s.owen {
                None => xor(base, &self.table, words),
                Some(seed) => words.iter_mut().zip(&self.table).for_each(|(w, t)| *w = owen(base ^ t, seed)),
            }
        }
    }
}
