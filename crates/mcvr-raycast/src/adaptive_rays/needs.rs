//! Which places need rays, by the errors expected there, put right by what the rays then show.

use std::ops::Range;

use crate::points::mix;

/// Steps that tell errors apart in an octave, as bits of the mantissa.
const BITS: u32 = 3;

/// Steps in all, from the largest error down: 128 octaves.
const STEPS: usize = 1024;

/// Least expected error, as a share of the mean.
const LEAST: f64 = 1e-6;

/// Fewest places whose errors are compared with what was expected.
const FEWEST: usize = 8;

/// Octaves above the least error that was given rays, of which errors are compared: the places most like those that are left.
const NEAR: usize = 3 << BITS;

/// One place in so many is given rays though little is expected there: rays at even distances see nothing of what repeats with them.
const SAMPLE: u64 = 32;

/// Places that make a sample, where one in so many is fewer; one in four at most.
const SAMPLED: u64 = 64;

/// Places that are looked at where no rays are needed.
const GLANCE: u64 = 16;

/// Times that rays are given before what is left stays.
const ROUNDS: usize = 8;

/// Places with the squared errors expected there.
pub(super) struct Needs {
    /// Expected, and found with the share of noise in it: `None` where no rays were given.
    errors: Vec<(f64, Option<(f64, f64)>)>,
    /// Step of each from the largest.
    steps: Vec<usize>,
    /// Sum and number of places at each step; those of the sample are taken out.
    sums: Vec<(f64, usize)>,
    /// Steps before this one were given rays.
    given: usize,
    round: usize,
    /// Errors found for those expected.
    pub ratio: f64,
    /// Errors that were found, beyond noise.
    taken: f64,
}

/// Share of what may be left that may stay at one distance, where finer ones follow.
const SHARE: f64 = 0.5;

impl Needs {
    pub fn new(expected: impl Iterator<Item = f64>) -> Self {
        let mut errors: Vec<(f64, Option<(f64, f64)>)> = expected.map(|e| (e, None)).collect();
        // Places where nothing is expected stand for something, or what a sample of them shows would count for nothing.
        let least = LEAST * errors.iter().map(|e| e.0).sum::<f64>() / errors.len().max(1) as f64;
        errors.iter_mut().for_each(|e| e.0 = e.0.max(least));
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
        Self { errors, steps, sums, given: 0, round: 0, ratio: 1.0, taken: 0.0 }
    }

    /// What is expected to be left at places without rays.
    pub fn left(&self) -> f64 {
        self.ratio * self.sums[self.given..].iter().map(|s| s.0).sum::<f64>()
    }

    /// Whether rays were given to no place that needs them: to none, or to a few that were glanced at.
    pub fn only_glanced(&self) -> bool {
        self.given == 0
    }

    /// The places to be given rays next, so that at most `left` stays, where places with rays keep a share `fall` of their errors; none when
    /// that is expected already, but for a few at first, to see whether it is true. Where rays at all places leave more, the places without
    /// them may keep [`SHARE`] of `left`, and the others need closer ones.
    pub fn next(&mut self, left: f64, fall: f64) -> Vec<usize> {
        let keep = fall * (self.taken + self.left());
        let (left, fall) = if keep < left { (left - keep, fall) } else { (SHARE * left, 0.0) };
        // Beyond which step the rest may stay.
        let mut end = STEPS;
        let mut rest = 0.0;
        while end > self.given && rest + (1.0 - fall) * self.ratio * self.sums[end - 1].0 <= left {
            rest += (1.0 - fall) * self.ratio * self.sums[end - 1].0;
            end -= 1;
        }
        let needed = end > self.given;
        if self.round == ROUNDS || !needed && (self.round > 0 || self.sums.iter().all(|s| s.1 == 0)) {
            return vec![];
        }
        // Nothing was given but a glance.
        let first = self.given == 0;
        if needed && first {
            // A few first, to see how right the expectation is.
            let needed: usize = self.sums[..end].iter().map(|s| s.1).sum();
            let mut number = 0;
            let few = |s: &(f64, usize)| {
                number += s.1;
                number >= (needed / 4).clamp(2 * FEWEST, 96)
            };
            end = end.min(1 + self.sums.iter().position(few).unwrap_or(end));
        }
        let number = self.steps.len() as u64;
        let every = if needed { (number / SAMPLED).clamp(4, SAMPLE) } else { (number / GLANCE).max(1) };
        self.round += 1;
        let end = if needed { end } else { 0 };
        self.given = end;
        let wanted = |n: &usize| self.steps[*n] < end || first && mix(*n as u64).is_multiple_of(every);
        let next: Vec<usize> = (0..self.steps.len()).filter(|n| self.errors[*n].1.is_none() && wanted(n)).collect();
        // Those of the sample are no part of what is left.
        for (step, (error, _)) in next.iter().map(|n| (self.steps[*n], self.errors[*n])) {
            if let Some((sum, number)) = self.sums.get_mut(step).filter(|_| step >= end) {
                *sum = if *number > 1 { *sum - error } else { 0.0 };
                *number -= 1;
            }
        }
        next
    }

    /// All places that were given no rays yet; nothing is left to be given.
    pub fn all(&mut self) -> Vec<usize> {
        (self.given, self.round) = (STEPS, ROUNDS);
        (0..self.errors.len()).filter(|n| self.errors[*n].1.is_none()).collect()
    }

    /// The errors found where rays were given, and what the rays' own noise is expected to have added to each.
    pub fn found(&mut self, places: &[usize], errors: impl Iterator<Item = (f64, f64)>) {
        let mut sums = (0.0, 0.0);
        for (n, e) in places.iter().zip(errors) {
            self.errors[*n].1 = Some(e);
            sums = (sums.0 + e.0, sums.1 + e.1);
        }
        self.taken += (sums.0 - sums.1).max(0.0);
        let ratio = |among: Range<usize>, fewest: usize| {
            let (mut sums, mut number) = ((0.0, 0.0, 0.0), 0);
            for ((expected, found), step) in self.errors.iter().zip(&self.steps) {
                if let (Some((found, noise)), true) = (found, among.contains(step)) {
                    sums = (sums.0 + expected, sums.1 + found, sums.2 + noise);
                    number += 1;
                }
            }
            let (expected, found, noise) = sums;
            // At least a tenth: how much of it is noise is not known that well.
            let found = (found - noise).max(0.1 * found);
            (number >= fewest && expected > 0.0).then_some(found / expected)
        };
        // The places most like those that are left, and those among them.
        let near = ratio(self.given.saturating_sub(NEAR)..self.given, FEWEST);
        let near = near.or_else(|| ratio(0..self.given, FEWEST));
        // Small images have few places, and one of them may tell.
        let sample = ratio(self.given..STEPS + 1, 1);
        // A glance alone tells of surprises only.
        let near = if self.given == 0 { Some(1.0) } else { near };
        if let Some(ratio) = near.into_iter().chain(sample).reduce(f64::max) {
            self.ratio = ratio;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Errors over twelve octaves, in no order.
    fn errors() -> Vec<f64> {
        (0..2000u64).map(|n| (mix(n) % 4096 + 1) as f64 / 64.0).collect()
    }

    #[test]
    fn the_largest_come_first_and_no_more_than_needed() {
        let all = errors();
        let whole: f64 = all.iter().sum();
        let mut needs = Needs::new(all.iter().copied());
        assert!((needs.left() - whole).abs() < 1e-9 * whole);
        let mut given = vec![false; all.len()];
        loop {
            let next = needs.next(0.1 * whole, 0.0);
            if next.is_empty() {
                break;
            }
            next.iter().for_each(|n| assert!(!std::mem::replace(&mut given[*n], true), "{n} twice"));
            needs.found(&next, next.iter().map(|n| (all[*n], 0.0)));
            assert!((needs.ratio - 1.0).abs() < 1e-9);
        }
        let rest = |given: &[bool]| all.iter().zip(given).filter(|(_, g)| !**g).map(|(e, _)| e).sum::<f64>();
        assert!(rest(&given) <= 0.1 * whole && needs.left() <= 0.1 * whole);
        // But for a sample, the least of them stay, and they are as many as may: to an eighth of an octave.
        let number = given.iter().filter(|g| **g).count();
        let mut sorted = all.clone();
        sorted.sort_by(|a, b| b.total_cmp(a));
        let mut sum = whole;
        let fewest = sorted
            .iter()
            .take_while(|e| {
                let more = sum > 0.1 * whole;
                sum -= **e;
                more
            })
            .count();
        assert!(number >= fewest && number <= fewest + all.len() / 16 + all.len() / 8, "{number} for {fewest}");
    }

    #[test]
    fn what_is_found_puts_the_rest_right() {
        for factor in [0.2, 5.0] {
            let all = errors();
            let whole: f64 = all.iter().sum();
            let mut needs = Needs::new(all.iter().copied());
            let mut rest = factor * whole;
            loop {
                let next = needs.next(0.1 * whole, 0.0);
                if next.is_empty() {
                    break;
                }
                rest -= factor * next.iter().map(|n| all[*n]).sum::<f64>();
                needs.found(&next, next.iter().map(|n| (factor * all[*n], 0.0)));
            }
            assert!((needs.ratio / factor - 1.0).abs() < 1e-9, "{}", needs.ratio);
            assert!(rest <= 0.1 * whole, "{factor}: {rest}");
        }
    }

    /// Where little is expected and much is there, the sample tells.
    #[test]
    fn a_sample_finds_what_was_not_expected() {
        let expected: Vec<f64> = (0..2000).map(|n| if n < 200 { 10.0 } else { 0.01 }).collect();
        let mut needs = Needs::new(expected.iter().copied());
        let mut given = 0;
        loop {
            let next = needs.next(100.0, 0.0);
            if next.is_empty() {
                break;
            }
            given += next.len();
            needs.found(&next, next.iter().map(|_| (10.0, 0.0)));
        }
        assert!(given > 1900, "{given}");
    }

    #[test]
    fn noise_is_no_error_but_never_all_of_it() {
        let found = |noise: f64| {
            let mut needs = Needs::new(errors().into_iter());
            let next = needs.next(0.0, 0.0);
            let errors = errors();
            needs.found(&next, next.iter().map(|n| (errors[*n] + 1.0, noise)));
            needs.ratio
        };
        assert!((found(1.0) - 1.0).abs() < 0.01 && found(0.0) > 1.01 && found(1e9) < 0.3);
        let mut none = Needs::new(std::iter::empty());
        assert_eq!((none.left(), none.next(0.0, 0.0)), (0.0, vec![]));
        assert_eq!(Needs::new([0.0, 0.0].into_iter()).next(0.0, 0.0), Vec::<usize>::new());
    }
}
