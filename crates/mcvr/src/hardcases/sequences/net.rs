//! The Sobol net.

use mcvr_qmc::sobol::{columns, point};
use mcvr_qmc::{Scramble, SobolNet};
use mcvr_sampling::Strata;

use super::{Bound, Case, CaseError, Context, Cost, Finding, Group, SEEDS, nets};
use crate::hardcases::support::block_of;

pub(super) const CASES: &[Case] = &[
    Case {
        name: "net-never-repeats",
        group: Group::Sequences,
        breaks: "direction numbers of 16 or 32 bits: point 65,536 + i is point i again, and the error stops falling",
        asserts: "no two of 2^40 points share their kernel coordinates: the generator matrices have full rank",
        cost: Cost::Quick,
        measure: full_rank,
    },
    Case {
        name: "net-published-points",
        group: Group::Sequences,
        breaks: "a wrong direction number gives points that look even and are not a net",
        asserts: "the first ten points in three dimensions are those that Joe and Kuo print",
        cost: Cost::Quick,
        measure: published,
    },
    Case {
        name: "net-property-at-any-index",
        group: Group::Sequences,
        breaks: "scrambles, block offsets or 32-bit indices destroy the net far from its beginning",
        asserts: "in aligned runs of 2048 points up to index 2^40 each elementary interval of volume 2^-10 holds two points",
        cost: Cost::Quick,
        measure: net_property,
    },
    Case {
        name: "zero-point-kept",
        group: Group::Sequences,
        breaks: "the first point is skipped because it is 0, and with it the balance of the net",
        asserts: "point 0 of the plain net is 0 in all coordinates, no other is; without it intervals run empty",
        cost: Cost::Quick,
        measure: zero_point,
    },
    Case {
        name: "scrambles-permute",
        group: Group::Sequences,
        breaks: "a scramble that is no bijection leaves gaps in a coordinate and fills others twice",
        asserts: "every scramble of 2^16 points fills each of 2^16 intervals of each coordinate once, for every seed",
        cost: Cost::Quick,
        measure: permute,
    },
    Case {
        name: "net-discrepancy",
        group: Group::Sequences,
        breaks: "points that pass a coverage test and are no more even than random ones",
        asserts: "the mean square discrepancy (Warnock) of strata and of the plain net is that of the published formulas",
        cost: Cost::Quick,
        measure: discrepancy,
    },
];

/// Exact. The linear, shift and plain scrambles are affine over GF(2): points i and j coincide in all three coordinates only
/// if the 96 by 40 matrix of index bits to digits sends i xor j to 0. Its rank is found by elimination on the differences
/// to point 0. Owen's scramble permutes each coordinate's digits, so it keeps distinct what was.
fn full_rank(_: &Context) -> Result<Finding, CaseError> {
    let word = |net: &SobolNet, index| net.digits(index).iter().fold(0u128, |w, d| w << 32 | u128::from(*d));
    let mut single = 0;
    let (mut missing, mut of) = (0, 0);
    for seed in SEEDS {
        for scramble in [Scramble::Linear, Scramble::Shift, Scramble::None] {
            let net = SobolNet::new(1 << 40, seed, scramble);
            let columns: Vec<u128> = (0..40).map(|bit| word(&net, 1 << bit) ^ word(&net, 0)).collect();
            single = single.max(rank(columns.iter().map(|c| c >> 64)));
            missing += 40 - rank(columns.into_iter());
            of += 40;
        }
    }
    Ok(Finding::wrong(missing, of, "index bits lost")
        .with(format!("one coordinate of 32 digits alone has rank {single}")))
}

/// Rank over GF(2), by elimination.
fn rank(columns: impl Iterator<Item = u128>) -> u64 {
    let mut basis: Vec<u128> = vec![];
    for mut v in columns {
        basis.iter().for_each(|b| v = v.min(v ^ b));
        if v != 0 {
            basis.push(v);
        }
    }
    basis.len() as u64
}

/// Exact: ten points as printed by S. Joe and F. Y. Kuo's program `sobol` (web.maths.unsw.edu.au/~fkuo/sobol) in Gray-code
/// order, from their file new-joe-kuo-6.21201, as numerators over 16.
fn published(_: &Context) -> Result<Finding, CaseError> {
    const PRINTED: [[u64; 3]; 10] = [
        [0, 0, 0],
        [8, 8, 8],
        [12, 4, 4],
        [4, 12, 12],
        [6, 6, 10],
        [14, 14, 2],
        [10, 2, 14],
        [2, 10, 6],
        [3, 5, 15],
        [11, 13, 7],
    ];
    let net = SobolNet::new(16, 1, Scramble::None);
    let mut wrong = 0;
    for (k, printed) in PRINTED.iter().enumerate() {
        let gray = (k ^ (k >> 1)) as u64;
        for (axis, numerator) in printed.iter().enumerate() {
            wrong += u64::from(point(&columns(axis), gray) != numerator << 60);
            wrong += u64::from(u64::from(net.digits(gray)[axis]) != numerator << 28);
        }
    }
    Ok(Finding::wrong(wrong, 60, "coordinates"))
}

/// How many elementary intervals of volume 2^-10 in three coordinates do not hold two of 2048 points.
fn uneven(words: [&[u32]; 3]) -> (u64, u64) {
    let (mut wrong, mut of) = (0, 0);
    for a in 0..=10 {
        for b in 0..=10 - a {
            let mut counts = [0u32; 1024];
            for ((x, y), z) in words[0].iter().zip(words[1]).zip(words[2]) {
                let top = |w: &u32, bits: u32| if bits == 0 { 0 } else { w >> (32 - bits) };
                counts[((top(x, a) << b | top(y, b)) << (10 - a - b) | top(z, 10 - a - b)) as usize] += 1;
            }
            wrong += counts.iter().filter(|n| **n != 2).count() as u64;
            of += 1024;
        }
    }
    (wrong, of)
}

/// Exact. The three Sobol coordinates have primitive polynomials of degree 0, 1 and 2, so t = 0 + 0 + 1 (Sobol 1967), and
/// every aligned run of 2^11 points is a (1, 11, 3)-net: two points in each interval of volume 2^(1-11).
fn net_property(_: &Context) -> Result<Finding, CaseError> {
    let (mut wrong, mut of) = (0, 0);
    for seed in [0, u64::MAX] {
        for net in nets(1 << 40, seed) {
            for block in [0, 1, (1 << 5) + 1, (1 << 13) - 1, 1 << 21, (1 << 29) - 1] {
                let points = block_of(&net, block, 1 << 40);
                let [x, y, z] = &points.uniforms;
                let (bad, all) = uneven([x, y, z]);
                wrong += bad;
                of += all;
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "intervals"))
}

/// Exact: as [`net_property`], and the numerators of point 0.
fn zero_point(_: &Context) -> Result<Finding, CaseError> {
    let net = SobolNet::new(1 << 16, 1, Scramble::None);
    let points = block_of(&net, 0, 1 << 40);
    let mut wrong = u64::from(points.targets[0] != 0 || net.digits(0) != [0; 3]);
    wrong += (1..1u64 << 16).filter(|k| net.digits(*k).contains(&0)).count() as u64;
    // Without it: points 1 to 2048 in place of 0 to 2047.
    let next = block_of(&net, 1, 1 << 40);
    let shifted = [0, 1, 2].map(|a: usize| [&points.uniforms[a][1..], &next.uniforms[a][..1]].concat());
    let (uneven, of) = uneven([&shifted[0], &shifted[1], &shifted[2]]);
    wrong += u64::from(uneven == 0);
    Ok(Finding::wrong(wrong, 1 << 16, "points").with(format!("without point 0, {uneven} of {of} intervals are uneven")))
}

/// Exact: the first 2^16 points of each Sobol coordinate have the 2^16 different leading 16 digits, and every scramble here
/// lets a digit depend on itself and those before it, so it permutes them.
fn permute(_: &Context) -> Result<Finding, CaseError> {
    let (mut wrong, mut of) = (0, 0);
    for seed in SEEDS {
        for net in nets(1 << 16, seed) {
            let mut seen = [(); 3].map(|()| vec![false; 1 << 16]);
            for block in 0..32 {
                let points = block_of(&net, block, 1 << 40);
                for (seen, words) in seen.iter_mut().zip(&points.uniforms) {
                    words.iter().for_each(|w| seen[(w >> 16) as usize] = true);
                }
            }
            wrong += seen.iter().flatten().filter(|s| !**s).count() as u64;
            of += 3 << 16;
        }
    }
    Ok(Finding::wrong(wrong, of, "intervals missed"))
}

/// The mean square of the star discrepancy over all boxes [0, x), by T. T. Warnock's formula (1972).
fn mean_square(points: &[Vec<f64>]) -> f64 {
    let (m, s) = (points.len() as f64, points.first().map_or(0, Vec::len) as i32);
    let single: f64 = points.iter().map(|p| p.iter().map(|x| 1.0 - x * x).product::<f64>()).sum();
    let pair = |p: &[f64], q: &[f64]| p.iter().zip(q).map(|(a, b)| 1.0 - a.max(*b)).product::<f64>();
    let double: f64 = points.iter().map(|p| points.iter().map(|q| pair(p, q)).sum::<f64>()).sum();
    3f64.powi(-s) - 2f64.powi(1 - s) / m * single + double / (m * m)
}

/// Two sets whose mean square is known: M points in the middle of M strata, 1/(12 M²), the least there is in one dimension;
/// and the plain net's first two coordinates, Hammersley's set of M = 2^m points (J. H. Halton and S. K. Zaremba, 1969):
/// `(m²/64 + 29m/192 + 3/8 - m/(16M) + 1/(4M) - 1/(72M²)) / M²`. The formula's three terms are at most 1 and summed one by
/// one over M twice, so it errs by 3 · 2M eps: 3.4e-13 of 1.3e-6 at M = 256, 1.4e-12 of 3.4e-6 at M = 1024; below 1e-6.
fn discrepancy(_: &Context) -> Result<Finding, CaseError> {
    let m = 256u64;
    let mut middles = vec![0u64; m as usize];
    Strata::new(0, 1 << 52, m).fill(1 << 31, &mut middles);
    let unit = |target: &u64| *target as f64 / 2f64.powi(52);
    let strata = mean_square(&middles.iter().map(|t| vec![unit(t)]).collect::<Vec<_>>()) * 12.0 * (m * m) as f64;

    let (bits, m) = (10.0, 1024.0);
    let exact = bits * bits / 64.0 + 29.0 * bits / 192.0 + 0.375 - bits / (16.0 * m) + 0.25 / m - 1.0 / (72.0 * m * m);
    let points = block_of(&SobolNet::new(1024, 1, Scramble::None), 0, 1 << 52);
    let pairs = points.targets.iter().zip(&points.uniforms[0]);
    let pairs: Vec<Vec<f64>> = pairs.map(|(t, x)| vec![unit(t), f64::from(*x) / 2f64.powi(32)]).collect();
    let net = mean_square(&pairs) * m * m / exact;
    let random = (0.25 - 1.0 / 9.0) * m / exact;
    Ok(Finding::new((strata - 1.0).abs().max((net - 1.0).abs()), "of the exact mean square", Bound::AtMost(1e-6))
        .with(format!("as many random points have {random:.0} times the net's")))
}
