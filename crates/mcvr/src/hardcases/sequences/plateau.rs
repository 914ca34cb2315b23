//! Samplers that stop improving.
//!
//! The unit cube of (target, kernel coordinates) is cut into 3^4 boxes, which no power of two divides. With n samples in a
//! box, `X² = Σ (n - M/81)² / (M/81)` is M times the mean square error: of independent samples its mean is 80 at every M, a
//! net's falls, and of samples that repeat it grows in proportion to M. A coverage test sees none of this.
//!
//! Bound: from M to 4M, the ratio of the sums of X² over R seeds is for independent samples an F variate with 80R and 80R
//! degrees of freedom; its logarithm has a deviation of √(4/80R), 0.11 at R = 4, so it exceeds ln 2 with probability below
//! 3e-10. Stratified samples and nets vary less, as an average over scrambles never exceeds what M points had. Repeating
//! samples give exactly 4. So 2 separates the two.

use mcvr_qmc::Scramble;
use mcvr_sampling::{PointBlock, PointStream, block_count};
use rayon::prelude::*;

use super::{Bound, Case, CaseError, Context, Cost, Finding, Group};
use crate::hardcases::support::block_of;
use crate::request::point_stream;
use crate::{Method, Request};

pub(super) const CASES: &[Case] = &[
    Case {
        name: "no-plateau-at-2-16",
        group: Group::Sequences,
        breaks: "a Sobol library of 2^16 points begins again: the error at 2^18 samples is that at 2^16",
        asserts: "M times the squared error does not double from M = 2^16 to 2^18, by any method or scramble",
        cost: Cost::Quick,
        measure: at_16,
    },
    Case {
        name: "no-plateau-at-2-20",
        group: Group::Sequences,
        breaks: "words of 20 bits, or blocks keyed by 9: the error stops falling at a million samples",
        asserts: "M times the squared error does not double from M = 2^20 to 2^22, by any method",
        cost: Cost::Quick,
        measure: at_20,
    },
    Case {
        name: "no-plateau-at-2-24",
        group: Group::Sequences,
        breaks: "uniforms kept in f32 have 24 bits: the error stops falling at 16 million samples",
        asserts: "M times the squared error does not double from M = 2^24 to 2^26, by any method",
        cost: Cost::Large,
        measure: at_24,
    },
    Case {
        name: "stuck-samplers-are-caught",
        group: Group::Sequences,
        breaks: "a sampler stuck on 2^14 points covers everything and passes a coverage test",
        asserts: "the check of the plateau rejects samplers that repeat all, or the kernel coordinates alone",
        cost: Cost::Quick,
        measure: stuck,
    },
];

/// A sampler that repeats a few points: altogether, or their kernel coordinates alone with targets that go on.
struct Stuck<'a> {
    points: &'a dyn PointStream,
    targets: Option<&'a dyn PointStream>,
    samples: u64,
}

impl PointStream for Stuck<'_> {
    fn samples(&self) -> u64 {
        self.samples
    }

    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        self.points.fill(block % block_count(self.points.samples()), total, out);
        if let Some(targets) = self.targets {
            out.targets = block_of(targets, block, total).targets;
        }
    }
}

/// `X²` of a stream's first `blocks` blocks, and whether every box holds a sample.
fn chi_square(stream: &dyn PointStream, blocks: u64) -> (f64, bool) {
    const THIRD: u64 = 1 << 50;
    let zero = || (vec![0u64; 81], 0u64);
    let (counts, samples) = (0..blocks)
        .into_par_iter()
        .fold(zero, |(mut counts, samples), block| {
            let points = block_of(stream, block, 3 * THIRD);
            let [x, y, z] = &points.uniforms;
            for (((t, x), y), z) in points.targets.iter().zip(x).zip(y).zip(z) {
                let third = |w: &u32| (u64::from(*w) * 3) >> 32;
                counts[(((t / THIRD * 3 + third(x)) * 3 + third(y)) * 3 + third(z)) as usize] += 1;
            }
            (counts, samples + points.targets.len() as u64)
        })
        .reduce(zero, |(a, m), (b, n)| (a.iter().zip(b).map(|(a, b)| a + b).collect(), m + n));
    let expected = samples as f64 / 81.0;
    (counts.iter().map(|n| (*n as f64 - expected).powi(2)).sum::<f64>() / expected, counts.iter().all(|n| *n > 0))
}

/// A method, and the scramble of the net.
type Sampler = (Method, Scramble);

const ALL: [Sampler; 7] = [
    (Method::Mc, Scramble::None),
    (Method::McQuicksort, Scramble::None),
    (Method::McBinary, Scramble::None),
    (Method::Stratified, Scramble::None),
    (Method::Qmc, Scramble::Linear),
    (Method::Qmc, Scramble::Owen),
    (Method::Qmc, Scramble::Shift),
];

fn stream_of((method, scramble): Sampler, samples: u64, seed: u64) -> Box<dyn PointStream> {
    point_stream(&Request { method, scramble, samples, seed, ..Request::default() }, 3 << 50)
}

/// The growth of X² from M to 4M over seeds, the worst of some samplers.
fn growth(samplers: &[Sampler], samples: u64, seeds: u64) -> Finding {
    let sum = |sampler, samples| -> f64 {
        (0..seeds).map(|seed| chi_square(&*stream_of(sampler, samples, seed), block_count(samples)).0).sum()
    };
    let of = |sampler: &Sampler| sum(*sampler, 4 * samples) / sum(*sampler, samples);
    let growths: Vec<f64> = samplers.iter().map(of).collect();
    let worst = growths.iter().copied().fold(0.0, f64::max);
    let show = |((method, scramble), growth): (&Sampler, &f64)| match method {
        Method::Qmc => format!("{method} {} {growth:.2}", scramble.name()),
        _ => format!("{method} {growth:.2}"),
    };
    let shown: Vec<String> = samplers.iter().zip(&growths).map(show).collect();
    Finding::new(worst, "times M error² when M is four times as large", Bound::AtMost(2.0)).with(shown.join(", "))
}

/// Bound above, R = 8.
fn at_16(_: &Context) -> Result<Finding, CaseError> {
    Ok(growth(&ALL, 1 << 16, 8))
}

/// Bound above, R = 4.
fn at_20(_: &Context) -> Result<Finding, CaseError> {
    Ok(growth(&[ALL[0], ALL[3], ALL[4]], 1 << 20, 4))
}

/// Bound above, R = 4.
fn at_24(_: &Context) -> Result<Finding, CaseError> {
    Ok(growth(&[ALL[0], ALL[3], ALL[4], ALL[5]], 1 << 24, 4))
}

/// Bound above, from the other side: repeated samples must fail the check. Where the targets go on, 26 of the 80 degrees of
/// freedom, the kernel coordinates' own, grow with M and the others stay: from 16 to 64 times the period by a factor of
/// (26 · 64 + 54) / (26 · 16 + 54) = 3.7 for independent samples, and the deviation of its logarithm at R = 4 is below
/// √(2 / 104) · 54 / 470 + √(2 / 216) · 54 / 470 < 0.03.
fn stuck(_: &Context) -> Result<Finding, CaseError> {
    let period = 1u64 << 14;
    let (mut least, mut covered) = (f64::INFINITY, true);
    for sampler in [ALL[0], ALL[3], ALL[4]] {
        for targets_go_on in [false, true] {
            let [before, after] = [16, 64].map(|times| {
                let samples = times * period;
                let sums = (0..4).map(|seed| {
                    let (points, whole) = (stream_of(sampler, period, seed), stream_of(sampler, samples, seed));
                    let stuck = Stuck { points: &*points, targets: targets_go_on.then_some(&*whole), samples };
                    chi_square(&stuck, block_count(samples))
                });
                sums.fold(0.0, |sum, (chi_square, all)| {
                    covered &= all;
                    sum + chi_square
                })
            });
            least = least.min(after / before);
        }
    }
    let coverage = if covered { "every box holds samples, so a coverage test passes" } else { "some boxes are empty" };
    Ok(Finding::new(least, "times M error², the least of 6 stuck samplers", Bound::AtLeast(2.0)).with(coverage))
}
