//! Random words: their keys, their ends, and what they do to points.

use std::collections::HashSet;

use mcvr_mc::{OrderStatistics, Stratified, Unsorted};
use mcvr_qmc::{Scramble, SobolNet};
use mcvr_sampling::rng::{Purpose, fill_u32, hash, mix};
use mcvr_sampling::{Distribution, PointBlock, PointStream, Provenance, VoxelOrder, block_count, sample};
use mcvr_scene::{Density, DensityMap, Kernel, Watch};
use mcvr_volume::{Grid, Volume};

use super::{Bound, Case, CaseError, Context, Cost, Finding, Group, SEEDS, nets};
use crate::hardcases::support::block_of;

pub(super) const CASES: &[Case] = &[
    Case {
        name: "no-point-returns",
        group: Group::Sequences,
        breaks: "a generator of 2^16, 2^24 or 2^32 states begins again: new samples, old points",
        asserts: "blocks before and behind 2^16, 2^20, 2^24, 2^32 and 2^40 share no kernel coordinates, by every method",
        cost: Cost::Quick,
        measure: no_return,
    },
    Case {
        name: "blocks-have-keys-of-their-own",
        group: Group::Sequences,
        breaks: "hashed keys collide: two of 2^29 blocks share their random words with probability 2^-7",
        asserts: "the key of a block is an invertible function of its number, so no two of a purpose are equal",
        cost: Cost::Quick,
        measure: keys,
    },
    Case {
        name: "seeds-one-bit-apart",
        group: Group::Sequences,
        breaks: "seeds 1 and 2 give shifted or half equal points, and replicates that agree too well",
        asserts: "flipping any bit of a seed flips half of the bits of scrambles, shifts and words, for seeds 0 to 2^64-1",
        cost: Cost::Quick,
        measure: one_bit_apart,
    },
    Case {
        name: "uniforms-at-their-ends",
        group: Group::Sequences,
        breaks: "u = 0 or u = 1 gives a logarithm or root of 0, or a sample outside the kernel",
        asserts: "words 0 and 2^32-1, and those around the middle, stay within the support of every kernel",
        cost: Cost::Quick,
        measure: ends,
    },
];

/// For independent coordinates, n = 9 blocks of 2048 points of 96 bits agree somewhere with probability n² / 2^97, 4e-21.
/// The nets' points are distinct by their rank (`net-never-repeats`).
fn no_return(_: &Context) -> Result<Finding, CaseError> {
    let (mut wrong, mut of) = (0, 0);
    for seed in SEEDS {
        let m = 1 << 40;
        let mut streams: Vec<Box<dyn PointStream>> =
            vec![Box::new(Unsorted::binary(m, seed)), Box::new(Stratified::new(m, seed))];
        streams.extend(nets(m, seed).map(|n| Box::new(n) as Box<dyn PointStream>));
        if seed == 0 {
            streams.push(Box::new(OrderStatistics::new((1 << 32) + 1, seed)));
        }
        for stream in streams {
            let mut seen = HashSet::new();
            for block in [0, 31, 32, 512, 1 << 13, (1 << 21) - 1, 1 << 21, 1 << 28, (1 << 29) - 1] {
                if block < block_count(stream.samples()) {
                    let [x, y, z] = block_of(&*stream, block, 1 << 50).uniforms;
                    let points = x.into_iter().zip(y).zip(z);
                    of += points.len() as u64;
                    wrong += points.filter(|p| !seen.insert(*p)).count() as u64;
                }
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "points"))
}

/// The inverse of [`mix`]: shifts undone by repeating them, factors by their inverses modulo 2^64 (Newton's iteration).
fn unmix(mut z: u64) -> u64 {
    let inverse = |c: u64| (0..6).fold(c, |x, _| x.wrapping_mul(2u64.wrapping_sub(c.wrapping_mul(x))));
    z ^= z >> 31 ^ z >> 62;
    z = z.wrapping_mul(inverse(0x94d0_49bb_1331_11eb));
    z ^= z >> 27 ^ z >> 54;
    z = z.wrapping_mul(inverse(0xbf58_476d_1ce4_e5b9));
    z ^ z >> 30 ^ z >> 60
}

/// Exact: a function with an inverse sends no two blocks to one key. The inverse is applied to the keys of blocks at every
/// power of two and of the first 2^16, for each seed and purpose, and must give their numbers.
fn keys(_: &Context) -> Result<Finding, CaseError> {
    const STEP: u64 = 0x9e37_79b9_7f4a_7c15;
    let (mut wrong, mut of) = (0, 0);
    for seed in SEEDS {
        for purpose in [Purpose::Targets, Purpose::Offsets, Purpose::Blocks, Purpose::Scramble, Purpose::Shift] {
            let before = hash(&[seed, purpose as u64]).rotate_left(23);
            let powers = (0..64).flat_map(|b| [(1u64 << b) - 1, 1 << b]);
            for block in (0..1 << 16).chain(powers).chain([u64::MAX]) {
                let key = hash(&[seed, purpose as u64, block]);
                let found = unmix(unmix(key).wrapping_sub(before)).wrapping_sub(STEP);
                wrong += u64::from(found != block || unmix(mix(block)) != block);
                of += 1;
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "keys"))
}

/// Of N bits of independent words a Binomial(N, 1/2) number differs, of deviation √N/2; a normal variate exceeds 5.3 with
/// probability 1.2e-7, so six kinds of words raise a false alarm with less than 1e-6.
fn one_bit_apart(_: &Context) -> Result<Finding, CaseError> {
    let net = |scramble| move |seed| SobolNet::new(1, seed, scramble).digits(12_345).to_vec();
    let words = |purpose| {
        move |seed| {
            let mut words = vec![0u32; 4];
            fill_u32(seed, purpose, 0, &mut words);
            words
        }
    };
    let target =
        |stream: &dyn PointStream| block_of(stream, 0, 1 << 62).targets.iter().map(|t| (t >> 30) as u32).collect();
    type Words<'a> = Box<dyn Fn(u64) -> Vec<u32> + 'a>;
    let kinds: [Words<'_>; 6] = [
        Box::new(net(Scramble::Linear)),
        Box::new(net(Scramble::Owen)),
        Box::new(net(Scramble::Shift)),
        Box::new(words(Purpose::Offsets)),
        Box::new(|seed| target(&Unsorted::binary(4, seed))),
        Box::new(|seed| target(&SobolNet::new(1, seed, Scramble::Linear))),
    ];
    let mut worst = 0.0f64;
    for kind in kinds {
        let (mut differ, mut of) = (0u64, 0u64);
        for seed in SEEDS {
            let base = kind(seed);
            for bit in 0..64 {
                let other = kind(seed ^ 1 << bit);
                differ += base.iter().zip(&other).map(|(a, b)| u64::from((a ^ b).count_ones())).sum::<u64>();
                of += 32 * base.len() as u64;
            }
        }
        worst = worst.max((differ as f64 - of as f64 / 2.0).abs() / (of as f64).sqrt() * 2.0);
    }
    Ok(Finding::new(worst, "deviations from half of the bits, the worst of 6 kinds", Bound::AtMost(5.3)))
}

/// A stream of words at the ends and in the middle, every combination of three, and targets over the whole.
struct Ends;

const WORDS: [u32; 8] = [0, 1, 255, (1 << 31) - 1, 1 << 31, u32::MAX - 255, u32::MAX - 1, u32::MAX];

impl PointStream for Ends {
    fn samples(&self) -> u64 {
        1 << 9
    }

    fn fill(&self, _: u64, total: u64, out: &mut PointBlock) {
        let last = out.targets.len().max(2) as u64 - 1;
        for (i, target) in out.targets.iter_mut().enumerate() {
            *target = (total - 1) * i as u64 / last;
            out.uniforms.iter_mut().enumerate().for_each(|(a, u)| u[i] = WORDS[i >> (3 * a) & 7]);
        }
    }
}

/// Exact for `box`, `tent` and `bspline3`, whose maps of 32-bit numbers end at the support's ends. The sphere of `shell` goes
/// through a root and two polynomials in 32 bits, each rounded a few times: 8 f32 eps of its radius of 1/2 are allowed. The
/// reference in 64 bits must keep the support itself.
fn ends(_: &Context) -> Result<Finding, CaseError> {
    let grid = Grid::with_spacing([3, 3, 3], [1.0; 3])?;
    let density = Density::new(&Volume::from_vec(grid.clone(), vec![1u8; 27], "cube")?, DensityMap::default())?;
    let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
    let points = block_of(&Ends, 0, distribution.total());
    let (mut wrong, mut of) = (0, 0);
    for kernel in Kernel::ALL {
        let slack = if kernel == Kernel::Shell { 4.0 * f64::from(f32::EPSILON) } else { 0.0 };
        let (cloud, _) = sample(&distribution, &Ends, kernel, Provenance::default(), &Watch::default())?;
        for (i, target) in points.targets.iter().enumerate() {
            let voxel = grid.unravel(distribution.voxel_of(*target)).map(|c| c as f64);
            let inside = (0..3).all(|a| (cloud.world(i)[a] - voxel[a]).abs() <= kernel.support() + slack);
            let uniforms = [0, 1, 2].map(|a: usize| (f64::from(points.uniforms[a][i]) + 0.5) / 2f64.powi(32));
            let exact = kernel.offset(uniforms).abs().max_element() <= kernel.support();
            wrong += u64::from(!inside) + u64::from(!exact);
            of += 2;
        }
    }
    Ok(Finding::wrong(wrong, of, "offsets"))
}
