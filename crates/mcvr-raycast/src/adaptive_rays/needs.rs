//! Which places need rays, by the errors expected there, put right by what the rays then show.

use std::ops::Range;

use crate::points::mix;

/// Steps that tell errors apart in an octave, as bits of the mantissa.
const BITS: u32 = 3;

/// Steps in all, from the largest error down: 128 octaves.
const STEPS: usize = 1024;

/// Fewest places whose errors are compared with what was expected.
const FEWEST: usize = 8;

/// Octaves above the least error that was given rays, of which errors are compared: the places most like those that are left.
const NEAR: usize = 3 << BITS;

/// One place in so many is given rays though little is expected there: rays at even distances see nothing of what repeats with them.
const SAMPLE: u64 = 32;

/// Places that make a sample, where one in so many is fewer; one in four at most.
const SAMPLED: u64 = 64;

/// Times that rays are given before what is left stays.
const ROUNDS: usize = 8;

/// Places with the squared errors expected there.
pub(super) struct Needs {
    /// Expected, and found with the share of noise in it: `None` where no rays were given.
    errors: Vec<(f64, Option<(f64, f64)>)>,
    /// Step of each from the largest.
    steps: Vec<usize>,
    /// Sum and number of places at each step.
    sums: Vec<(f64, usize)>,
    /// Steps before this one were given rays.
    given: usize,
    round: usize,
    /// Errors found for those expected.
    pub ratio: f64,
}

impl Needs {
    pub fn new(expected: impl Iterator<Item = f64>) -> Self {
        let errors: Vec<(f64, Option<(f64, f64)>)> = expected.map(|e| (e, None)).collect();
        let most = errors.iter().map(|e| e.0).fold(0.0, f64::max).to_bits();
        let mut sums = vec![(0.0, 0); STEPS];
        // Bits of positive numbers rise with them. What is 0 needs nothing.
        let step = |e: f64| ((most.saturating_sub(e.to_bits())) >> (52 - BITS)).min(STEPS as u64 - 1) as usize;
        let steps: Vec<usize> = errors.iter().map(|e| if e.0 > 0.0 { step(e.0) } else { STEPS }).collect();
        for (e, step) in errors.iter().zip(&steps) {
            if let Some((sum, number)) = sums.get_mut(*step) {
                *sum += e.0;
                *number += 1;
            }
        }
        Self { errors, steps, sums, given: 0, round: 0, ratio: 1.0 }
    }

    /// What is expected to be left at places without rays.
    pub fn left(&self) -> f64 {
        self.ratio * self.sums[self.given..].iter().map(|s| s.0).sum::<f64>()
    }

    /// The places to be given rays next, so that at most `left` stays; none when that is expected already.
    pub fn next(&mut self, left: f64) -> Vec<usize> {
        // Beyond which step the rest may stay.
        let mut end = STEPS;
        let mut rest = 0.0;
        while end > self.given && rest + self.ratio * self.sums[end - 1].0 <= left {
            rest += self.ratio * self.sums[end - 1].0;
            end -= 1;
        }
        if self.round == ROUNDS || end <= self.given {
            return vec![];
        }
        if self.round == 0 {
            // A few first, to see how right the expectation is.
            let needed: usize = self.sums[..end].iter().map(|s| s.1).sum();
            let mut number = 0;
            let few = |s: &(f64, usize)| {
                number += s.1;
                number >= (needed / 4).max(2 * FEWEST)
            };
            end = end.min(1 + self.sums.iter().position(few).unwrap_or(end));
        }
        let sample = self.round == 0;
        let every = (self.steps.len() as u64 / SAMPLED).clamp(4, SAMPLE);
        self.round += 1;
        self.given = end;
        let wanted = |n: &usize| self.steps[*n] < end || sample && mix(*n as u64).is_multiple_of(every);
        (0..self.steps.len()).filter(|n| self.errors[*n].1.is_none() && wanted(n)).collect()
    }

    /// The errors found where rays were given, and what the rays' own noise is expected to have added to each.
    pub fn found(&mut self, places: &[usize], errors: impl Iterator<Item = (f64, f64)>) {
        places.iter().zip(errors).for_each(|(n, e)| self.errors[*n].1 = Some(e));
        let ratio = |among: Range<usize>| {
            let (mut sums, mut number) = ((0.0, 0.0, 0.0), 0);
            for ((expected, found), step) in self.errors.iter().zip(&self.steps) {
                if let (Some((found, noise)), true) = (found, among.contains(step)) {
                    sums = (sums.0 + expected, sums.1 + found, sums.2 + noise);
                    number += 1;
                }
            }
            let (expected, found, noise) = sums;
            // At least a quarter: how much of it is noise is not known that well.
            let found = (found - noise).max(0.25 * found);
            (number >= FEWEST && expected > 0.0).then_some(found / expected)
        };
        // The places most like those that are left, and those among them.
        let near = ratio(self.given.saturating_sub(NEAR)..self.given).or_else(|| ratio(0..self.given));
        let sample = ratio(self.given..STEPS + 1);
        if let Some(ratio) = near.into_iter().chain(sample).reduce(f64::max) {
            self.ratio = ratio;
        }
    }
}
