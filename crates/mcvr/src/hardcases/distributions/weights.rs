//! How large and how small weights may be.

use mcvr_sampling::{Distribution, VoxelOrder};
use mcvr_scene::power_of_two;

use super::{Bound, Case, CaseError, Context, Cost, Finding, Group, density, exact, probabilities};

pub(super) const CASES: &[Case] = &[
    Case {
        name: "weights-1e-300-to-1e300",
        group: Group::Distributions,
        breaks: "products and squares of weights leave the range of numbers; an f32 sum is infinite from 3e38 on",
        asserts: "each voxel's probability is the exact rational one to within (1 + n p) 2^-62",
        cost: Cost::Quick,
        measure: wide_range,
    },
    Case {
        name: "tiny-weights-only",
        group: Group::Distributions,
        breaks: "the factor that makes integers of weights near 1e-300 overflows: an error, or NaN",
        asserts: "probabilities are exact to within (1 + n p) 2^-62 when no weight exceeds 1e-300",
        cost: Cost::Quick,
        measure: tiny_only,
    },
    Case {
        name: "denormals-only",
        group: Group::Distributions,
        breaks: "1/sum is infinite, or the processor flushes denormals to 0 and nothing is left to draw",
        asserts: "multiples of the smallest f64 and f32 keep their exact proportions",
        cost: Cost::Quick,
        measure: denormals,
    },
    Case {
        name: "faint-weights-are-reported",
        group: Group::Distributions,
        breaks: "weights that vanish beside the others are dropped without a word",
        asserts: "every voxel that no target reaches is counted in the mass report, and no other",
        cost: Cost::Quick,
        measure: faint,
    },
    Case {
        name: "mix-1e-30-and-1e30",
        group: Group::Distributions,
        breaks: "differences of the running sum cancel: equal weights get unequal shares",
        asserts: "equal weights have equal shares to a unit, 2^-61 of the whole, and the sum of shares is 1",
        cost: Cost::Quick,
        measure: mixed,
    },
    Case {
        name: "total-differs-from-the-sum",
        group: Group::Distributions,
        breaks: "the float sum that weights are divided by is not the sum of the rounded shares: the last voxel gets the rest",
        asserts: "each voxel's probability is the exact rational one to within (1 + n p) 2^-62",
        cost: Cost::Quick,
        measure: rounded_total,
    },
    Case {
        name: "last-voxel-below-an-ulp",
        group: Group::Distributions,
        breaks: "1e16 + 1 is 1e16 in f64: the running sum does not move and the last voxel is never drawn",
        asserts: "the last voxel's probability is exact to within (1 + n p) 2^-62, and above 0",
        cost: Cost::Quick,
        measure: below_an_ulp,
    },
    Case {
        name: "f64-digits-keep-half-a-unit",
        group: Group::Distributions,
        breaks: "adding 1/2 before truncation rounds odd integers from 2^52 to 2^53 up",
        asserts: "weights of 53 digits at every size keep probabilities to within (1 + n p) 2^-62",
        cost: Cost::Quick,
        measure: all_digits,
    },
];

/// A weight every factor of 10 from 1e-300 to 1e300, each with an odd neighbour; bound in [`super::worst_error`].
fn wide_range(_: &Context) -> Result<Finding, CaseError> {
    let weights: Vec<f64> =
        (-300..=300).flat_map(|e| [10f64.powi(e), 0.0, 3.7 * 10f64.powi(e)]).filter(|w| *w < 2e300).collect();
    let lost = weights.iter().filter(|w| **w > 0.0 && ((**w as f32) == 0.0 || (**w as f32).is_infinite())).count();
    Ok(probabilities(&weights)?.with(format!("an f32 holds 0 or infinity in place of {lost} of {} weights", weights.len())))
}

/// Weights from 1e-310 to 1e-300; bound in [`super::worst_error`].
fn tiny_only(_: &Context) -> Result<Finding, CaseError> {
    let weights: Vec<f64> = (0..300).map(|i| 1e-300 * 0.93f64.powi(i) * f64::from(1 + i % 5)).collect();
    let factor = 2f64.powi(62) / weights.iter().sum::<f64>();
    Ok(probabilities(&weights)?.with(format!("the plain factor 2^62/sum is {factor}")))
}

/// Exact: weights k d for the smallest number d have a sum of n(n+1)/2 d, so units of k U / (n(n+1)/2) each, whole numbers
/// as the unit is a power of two times d. Every end of a voxel's range must be the exact one.
fn denormals(_: &Context) -> Result<Finding, CaseError> {
    let n = 300u64;
    let sum = n * (n + 1) / 2;
    let wide: Vec<f64> = (1..=n).map(|k| f64::from_bits(k)).collect();
    let narrow: Vec<f32> = (1..=n as u32).map(f32::from_bits).collect();
    let naive = 1.0 / wide.iter().sum::<f64>();
    let mut wrong = 0;
    for density in [density(wide)?, density(narrow)?] {
        let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
        let total = u128::from(distribution.total());
        let share = |k: u64| total * u128::from(k * (k + 1) / 2);
        let ends = exact::ends(&distribution);
        wrong += (1..=n).zip(ends).filter(|(k, end)| u128::from(*end) * u128::from(sum) != share(*k)).count() as u64;
    }
    Ok(Finding::wrong(wrong, 2 * n, "voxels").with(format!("1/sum is {naive}")))
}

/// Exact: a voxel is unreachable when its range of targets is empty. The weights 2^-k beside 1 cross half a unit, 2^-62, on
/// the way; the mass report must count exactly the unreachable ones.
fn faint(_: &Context) -> Result<Finding, CaseError> {
    let mut weights: Vec<f64> = (0..=1074).map(|k| power_of_two(-k)).collect();
    weights.extend([f64::from_bits(1); 200]);
    let density = density(weights)?;
    let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
    let mut before = 0;
    let unreachable = exact::ends(&distribution).into_iter().filter(|end| std::mem::replace(&mut before, *end) == *end);
    let (unreachable, report) = (unreachable.count() as f64, density.report());
    Ok(Finding::new((unreachable - report.faint as f64).abs(), "voxels unreported", Bound::AtMost(0.0)).with(format!(
        "{unreachable} of {} voxels cannot be drawn; together they weigh {:.1e} of the whole",
        report.voxels,
        report.faint_sum / report.weight_sum
    )))
}

/// Equal weights are rounded alike, so their integers are the same: the largest difference is 0, and 1 unit is allowed to a
/// scheme that rounds the running sum instead. The ranges end at the total by definition of the last end.
fn mixed(_: &Context) -> Result<Finding, CaseError> {
    let n = 512;
    let voxels: Vec<f32> = (0..n).map(|i| if i % 2 == 0 { 1e30 } else { 1e-30 }).collect();
    let steps = voxels.chunks(2).scan(0f32, |sum, pair| {
        let before = *sum;
        *sum += pair[0];
        let step = *sum - before;
        *sum += pair[1];
        Some(step)
    });
    let (least, most) = steps.fold((f32::INFINITY, 0f32), |(l, m), s| (l.min(s), m.max(s)));
    let density = density(voxels)?;
    let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
    let ends = exact::ends(&distribution);
    let share = |i: usize| ends[i] - if i == 0 { 0 } else { ends[i - 1] };
    let spread = |parity: usize| {
        let shares = (parity..n).step_by(2).map(share);
        shares.clone().max().unwrap_or(0) - shares.min().unwrap_or(u64::MAX)
    };
    let worst = spread(0).max(spread(1)) + (distribution.total() - ends[n - 1]);
    Ok(Finding::new(worst as f64, "units between equal weights", Bound::AtMost(1.0))
        .with(format!("steps of an f32 running sum at the equal large weights differ by {:.1e}", (most - least) / least)))
}

/// Weights of all digits over forty powers of two, so that their float sum is rounded; bound in [`super::worst_error`].
fn rounded_total(_: &Context) -> Result<Finding, CaseError> {
    let weights: Vec<f64> = (1..600u64).map(|i| (i as f64).sqrt() * power_of_two((i * 7919 % 41) as i32 - 20)).collect();
    let sum = exact::whole(weights.iter().sum());
    let exact: num_bigint::BigUint = weights.iter().map(|w| exact::whole(*w)).sum();
    let differs = if sum == exact { "is" } else { "is not" };
    Ok(probabilities(&weights)?.with(format!("the f64 sum {differs} the exact one")))
}

/// Bound in [`super::worst_error`]; the last weight is 461 units, so it has not vanished.
fn below_an_ulp(_: &Context) -> Result<Finding, CaseError> {
    let finding = probabilities(&[1e16, 1.0])?;
    let naive = (1e16f64 + 1.0) - 1e16;
    let density = density(vec![1e16, 1.0])?;
    let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
    let units = distribution.total() - exact::end_of(&distribution, 0, 0);
    if units == 0 {
        return Err("the last voxel cannot be drawn".into());
    }
    Ok(finding.with(format!("{units} units of {}; an f64 running sum moves by {naive}", distribution.total())))
}

/// Odd 53-bit integers times every power of two down from the whole: each size meets another place of the last digit; bound
/// in [`super::worst_error`].
fn all_digits(_: &Context) -> Result<Finding, CaseError> {
    let weights: Vec<f64> = (0..400i32)
        .map(|i| ((1u64 << 52) + ((i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 12) | 1) as f64 * power_of_two(-(i / 5)))
        .collect();
    probabilities(&weights)
}
