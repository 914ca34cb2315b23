//! Targets: which voxel each sample is to find.

use mcvr_mc::{OrderStatistics, Stratified, Unsorted};
use mcvr_sampling::{BLOCK, PointStream, block_count, target_of};
use mcvr_scene::{Camera, DensityMap, Estimand, Extent, View, Watch};
use mcvr_volume::{Grid, Volume};

use super::{Bound, Case, CaseError, Context, Cost, Finding, Group, SAMPLES, SEEDS, nets, probes};
use crate::hardcases::support::{SAMPLERS, block_of, budget};
use crate::request::point_stream;
use crate::{Method, Request, Scenery, make};

pub(super) const CASES: &[Case] = &[
    Case {
        name: "one-target-per-stratum",
        group: Group::Sequences,
        breaks: "k * total overflows 64 bits, or a rounded step drifts out of its stratum after many of them",
        asserts: "stratified and net targets are in their strata and rise, for M from 1 to 2^40 and totals to 2^63-1",
        cost: Cost::Quick,
        measure: strata,
    },
    Case {
        name: "random-targets-in-range",
        group: Group::Sequences,
        breaks: "the largest spacing or a rounded product gives total itself, or totals near 2^63 are refused by a panic",
        asserts: "targets stay below the total, and sorted ones rise, for M from 1 to 2^32+1 and totals to 2^63-1",
        cost: Cost::Quick,
        measure: random,
    },
    Case {
        name: "sorted-targets-at-2-40",
        group: Group::Sequences,
        breaks: "partial sums of 2^29 block spacings lose the last digits: blocks overlap or leave the range",
        asserts: "2^40 sorted targets by index: below the total, rising, blocks in order to an ulp; takes 4 GiB",
        cost: Cost::Large,
        measure: sorted_large,
    },
    Case {
        name: "a-single-sample-is-uniform",
        group: Group::Sequences,
        breaks: "with one spacing the sorted sampler has nothing to divide by, or always draws the middle",
        asserts: "for M = 1 the only target of every method is uniform over seeds (Kolmogorov-Smirnov)",
        cost: Cost::Quick,
        measure: single,
    },
    Case {
        name: "block-ends",
        group: Group::Sequences,
        breaks: "the last, partial block is dropped or filled up: M-1 or M+1 samples at the ends of blocks",
        asserts: "for M = 1, 2, 3, 2047, 2048, 2049 exactly M samples are counted and the image's sum is theirs",
        cost: Cost::Quick,
        measure: block_ends,
    },
    Case {
        name: "budgets-beyond-limits-refused",
        group: Group::Sequences,
        breaks: "0 samples divide by 0, 2^40 + 1 overflow the accumulators, a sort takes all memory",
        asserts: "an error that names the limit, before any work",
        cost: Cost::Quick,
        measure: budgets,
    },
];

/// Totals at the ends of 1, 32, 53 and 63 bits.
const TOTALS: [u64; 7] = [1, 3, 255, (1 << 32) + 1, (1 << 53) + 1, 1 << 62, (1 << 63) - 1];

/// The targets of the blocks probed that are not below the total or, where they should rise within the block, do not.
fn astray(stream: &dyn PointStream, total: u64, rising: bool) -> (u64, u64) {
    let (mut wrong, mut of) = (0, 0);
    for block in probes(block_count(stream.samples())) {
        let targets = block_of(stream, block, total).targets;
        wrong += targets.iter().filter(|t| **t >= total).count() as u64;
        wrong += if rising { targets.windows(2).filter(|w| w[0] > w[1]).count() as u64 } else { 0 };
        of += targets.len() as u64;
    }
    (wrong, of)
}

/// Exact: the target of stratum k at fraction f is `floor((k + f) total / M)`, or that less one, where 64 fraction bits end;
/// so it lies between those of f = 0, less one, and of f = 1 - 2^-32.
fn strata(_: &Context) -> Result<Finding, CaseError> {
    let (mut wrong, mut of) = (0, 0);
    for samples in SAMPLES {
        for total in TOTALS {
            for seed in [0, u64::MAX] {
                let mut streams: Vec<Box<dyn PointStream>> = vec![Box::new(Stratified::new(samples, seed))];
                streams.extend(nets(samples, seed).map(|n| Box::new(n) as Box<dyn PointStream>));
                for stream in streams {
                    let (bad, all) = astray(&*stream, total, true);
                    wrong += bad;
                    of += all;
                    // All strata of the block's first and last 64 points.
                    for block in probes(block_count(samples)) {
                        let targets = block_of(&*stream, block, total).targets;
                        let ends = (0..targets.len()).filter(|i| *i < 64 || i + 64 >= targets.len());
                        for i in ends {
                            let k = block * BLOCK as u64 + i as u64;
                            let least = target_of(k, 0, total, samples).saturating_sub(1);
                            let most = target_of(k, u32::MAX, total, samples);
                            wrong += u64::from(!(least..=most).contains(&targets[i]));
                        }
                    }
                }
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "targets"))
}

/// Exact: what each method promises of its targets.
fn random(_: &Context) -> Result<Finding, CaseError> {
    let (mut wrong, mut of) = (0, 0);
    let mut add = |(bad, all)| {
        wrong += bad;
        of += all;
    };
    for samples in SAMPLES {
        for seed in SEEDS {
            // Of 2^40 samples, the sorted stream keeps 4 GiB of block ends: the large case.
            let few = samples < 1 << 24 || samples < 1 << 33 && seed == 0;
            let sorted = few.then(|| OrderStatistics::new(samples, seed));
            for total in TOTALS {
                add(astray(&Unsorted::binary(samples, seed), total, false));
                if let Some(sorted) = &sorted {
                    add(astray(sorted, total, true));
                }
                if samples <= 2049 {
                    add(astray(&mcvr_mc::Quicksorted::new(samples, seed, total), total, true));
                }
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "targets"))
}

/// Exact but for one thing: a block's last target and the next one's first are rounded apart, so they may overlap by the
/// roundings of offset, product and sum: two ulps of 2^62, 1024. The figure counts what is beyond.
fn sorted_large(_: &Context) -> Result<Finding, CaseError> {
    let (samples, total) = (1u64 << 40, 1u64 << 62);
    let stream = OrderStatistics::new(samples, 1);
    let (mut wrong, mut of) = astray(&stream, total, true);
    for block in probes(block_count(samples) - 1) {
        let (here, next) = (block_of(&stream, block, total).targets, block_of(&stream, block + 1, total).targets);
        let apart = here.last().zip(next.first()).is_some_and(|(a, b)| *a <= b + 1024);
        wrong += u64::from(!apart);
        of += 1;
    }
    Ok(Finding::wrong(wrong, of, "targets"))
}

/// Of n seeds √n D exceeds 2.9 with probability 2 exp(-2 · 2.9²) = 1e-7 (Massart 1990), so four methods with less than 1e-6.
/// The net has one random fraction of 32 bits, the others more.
fn single(_: &Context) -> Result<Finding, CaseError> {
    let (n, total) = (4000u64, 1u64 << 50);
    let mut worst = 0.0f64;
    for method in [Method::Mc, Method::McBinary, Method::Stratified, Method::Qmc] {
        let target = |seed| {
            let request = Request { method, samples: 1, seed, ..Request::default() };
            block_of(&*point_stream(&request, total), 0, total).targets[0] as f64 / total as f64
        };
        let mut targets: Vec<f64> = (0..n).map(target).collect();
        targets.sort_unstable_by(f64::total_cmp);
        let gap = |(i, x): (usize, &f64)| (x - i as f64 / n as f64).abs().max((x - (i + 1) as f64 / n as f64).abs());
        worst = worst.max(targets.iter().enumerate().map(gap).fold(0.0, f64::max) * (n as f64).sqrt());
    }
    Ok(Finding::new(worst, "√n D over 4000 seeds, the worst of 4 methods", Bound::AtMost(2.9)))
}

/// Exact: counters are integers, and a `count` image's pixels are multiples of 1/M, so its sum times M is the number of
/// samples inside to (pixels · eps) M, far below 1/2. One voxel of weight 1 makes the total 1, below every M.
fn block_ends(_: &Context) -> Result<Finding, CaseError> {
    let (mut wrong, mut of) = (0, 0);
    for dims in [[1, 1, 1], [9, 8, 7]] {
        let grid = Grid::with_spacing(dims, [1.0; 3])?;
        let camera = Camera::look(&View::default(), &grid, Extent::new(20, 20)?)?;
        let voxels = vec![1u8; grid.len()];
        let scenery = Scenery::new(Volume::from_vec(grid, voxels, "few")?, DensityMap::default(), camera);
        for method in SAMPLERS {
            for samples in [1, 2, 3, 2047, 2048, 2049].map(|m| budget(method, m)) {
                let request = Request { method, samples, estimand: Estimand::Count, ..Request::default() };
                let made = make(&scenery, &request, &Watch::default())?;
                let count = |name: &str| made.counters["render"][name].as_u64().unwrap_or(0);
                let sum = made.image.values().iter().sum::<f64>() * samples as f64;
                wrong += u64::from(count("samples") != samples || made.samples != samples);
                wrong += u64::from(count("inside") + count("outside") + count("clipped") != samples);
                wrong += u64::from((sum - count("inside") as f64).abs() > 0.5 || count("inside") == 0);
                of += 3;
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "counts"))
}

/// Exact: each budget must be refused with its limit in the message.
fn budgets(_: &Context) -> Result<Finding, CaseError> {
    let grid = Grid::with_spacing([3, 3, 3], [1.0; 3])?;
    let camera = Camera::look(&View::default(), &grid, Extent::new(4, 4)?)?;
    let scenery = Scenery::new(Volume::from_vec(grid, vec![1u8; 27], "few")?, DensityMap::default(), camera);
    let mut asked: Vec<(Method, u64, String)> = vec![
        (Method::McQuicksort, Method::QUICKSORT_LIMIT + 1, Method::QUICKSORT_LIMIT.to_string()),
        (Method::McLinear, Method::LINEAR_LIMIT + 1, Method::LINEAR_LIMIT.to_string()),
    ];
    for method in SAMPLERS {
        asked.extend([0, (1 << 40) + 1, u64::MAX].map(|samples| (method, samples, "2^40".to_owned())));
    }
    let mut wrong = 0;
    for (method, samples, limit) in &asked {
        let request = Request { method: *method, samples: *samples, ..Request::default() };
        let says = make(&scenery, &request, &Watch::default()).map_or_else(|e| e.to_string(), |_| String::new());
        wrong += u64::from(!says.contains(limit));
    }
    Ok(Finding::wrong(wrong, asked.len() as u64, "messages"))
}
