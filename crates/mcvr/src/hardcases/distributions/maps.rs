//! What the density map makes of values that it should not meet, and the same numbers in other types or units.

use mcvr_sampling::{Distribution, Provenance, VoxelOrder, sample};
use mcvr_scene::effects::Gains;
use mcvr_scene::{
    Camera, Density, DensityMap, Emphasis, Estimand, Extent, Hounsfield, Kernel, NegativePolicy, Transfer, View, Watch,
    power_of_two,
};
use mcvr_volume::{Grid, Volume, Voxel};

use super::{Bound, Case, CaseError, Context, Cost, Finding, Group, exact, row};
use crate::hardcases::support::{SAMPLERS, budget};
use crate::request::point_stream;
use crate::{Request, Scenery, make};

pub(super) const CASES: &[Case] = &[
    Case {
        name: "nan-and-infinity-refused",
        group: Group::Distributions,
        breaks: "one NaN makes every sum NaN: a black image without a word",
        asserts: "an error with the number of voxels and the place of the first, wherever they are and in any type",
        cost: Cost::Quick,
        measure: not_finite,
    },
    Case {
        name: "negative-weights-by-the-rule",
        group: Group::Distributions,
        breaks: "negative weights make the running sum fall, and a search finds anything",
        asserts: "clamped with their number and mass stated, or refused with number and first place, as asked",
        cost: Cost::Quick,
        measure: negative,
    },
    Case {
        name: "sums-and-maps-beyond-f64",
        group: Group::Distributions,
        breaks: "slope times value, the sum of weights or the mass overflows to infinity, and images with it",
        asserts: "an error that names what overflowed",
        cost: Cost::Quick,
        measure: overflow,
    },
    Case {
        name: "piecewise-extremes",
        group: Group::Distributions,
        breaks: "(w1 - w0) (v - v0) / (v1 - v0) overflows or vanishes where the weight itself is ordinary",
        asserts: "weights between extreme points are those of the straight line, to 9.25 eps of the larger end",
        cost: Cost::Quick,
        measure: piecewise,
    },
    Case {
        name: "tables-and-computed-weights-agree",
        group: Group::Distributions,
        breaks: "8- and 16-bit voxels go by a table, others by calculation: two programs, two images",
        asserts: "the same numbers in 8 types under 5 maps have the same probabilities, as fractions",
        cost: Cost::Quick,
        measure: types,
    },
    Case {
        name: "scaling-by-a-power-of-two",
        group: Group::Distributions,
        breaks: "weights in other units are rounded elsewhere, and other voxels are drawn",
        asserts: "weights times 2^-1000 to 2^900 give bit-identical points and count images, by every method",
        cost: Cost::Quick,
        measure: scaling,
    },
    Case {
        name: "concentrated-extremes",
        group: Group::Distributions,
        breaks: "the moved weights are kept in 32 bits: infinite above 3e38, gone below 1e-45",
        asserts: "weights times 2^-900 to 2^900 concentrate to the same shares, and the mass stays to half an f32 eps",
        cost: Cost::Quick,
        measure: concentrated,
    },
    Case {
        name: "gains-of-zero",
        group: Group::Distributions,
        breaks: "a gain of 0 leaves a voxel with a share of its own, or 0/0 where nothing is left",
        asserts: "voxels of gain 0 hold no target; where all have it, an error says that nothing can be drawn",
        cost: Cost::Quick,
        measure: no_gain,
    },
];

/// What a density says of a map of a row, or nothing where it takes it.
fn complaint<T: Voxel>(voxels: Vec<T>, map: DensityMap) -> Result<String, CaseError> {
    Ok(Density::new(&row(voxels)?, map).map_or_else(|e| e.to_string(), |_| String::new()))
}

fn linear(slope: f64, intercept: f64) -> DensityMap {
    DensityMap { transfer: Transfer::Linear { slope, intercept }, ..DensityMap::default() }
}

/// Exact: each message must name the count and the first place, which lies behind a chunk of 65,536.
fn not_finite(_: &Context) -> Result<Finding, CaseError> {
    let (mut wrong, mut of) = (0, 0);
    for first in [0usize, 65_535, 65_536, 199_999] {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let (mut wide, mut narrow) = (vec![1f64; 200_000], vec![1f32; 200_000]);
            for at in [first, 199_999] {
                (wide[at], narrow[at]) = (bad, bad as f32);
            }
            let count = if first == 199_999 { 1 } else { 2 };
            for says in [complaint(wide, DensityMap::default())?, complaint(narrow, DensityMap::default())?] {
                let clear = says.contains(&format!("{count} voxels")) && says.contains(&format!("at {first},0,0"));
                wrong += u64::from(!clear);
                of += 1;
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "messages"))
}

/// Exact: integers, so the mass that clamping drops is 1000 per voxel; by table and by calculation.
fn negative(_: &Context) -> Result<Finding, CaseError> {
    let at = [70_000usize, 130_000, 199_998];
    let mut voxels = vec![3i16; 200_000];
    at.iter().for_each(|i| voxels[*i] = -1000);
    let refuse = DensityMap { negative: NegativePolicy::Refuse, ..DensityMap::default() };
    let wide: Vec<f32> = voxels.iter().map(|v| f32::from(*v)).collect();
    let mut wrong = 0;
    for says in [complaint(voxels.clone(), refuse.clone())?, complaint(wide.clone(), refuse)?] {
        wrong += u64::from(!(says.contains("3 voxels") && says.contains("at 70000,0,0") && says.contains("-1000")));
    }
    for volume in [row(voxels)?, row(wide)?] {
        let density = Density::new(&volume, DensityMap::default())?;
        let report = density.report();
        let stated = (report.negative, report.dropped, report.weight_sum) == (3, 3000.0, 3.0 * 199_997.0);
        let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
        let empty = |v: &usize| exact::end_of(&distribution, *v, 0) == exact::end_of(&distribution, v - 1, 0);
        wrong += u64::from(!stated) + at.iter().filter(|v| !empty(v)).count() as u64;
    }
    Ok(Finding::wrong(wrong, 10, "checks"))
}

/// Exact: each of these overflows in one step only, which the message must name.
fn overflow(_: &Context) -> Result<Finding, CaseError> {
    let emphasis = Some(Emphasis { threshold: 1.0, gain: 1e300 });
    let mut said = vec![
        (complaint(vec![1.0, 1e10], linear(1e300, 0.0))?, "1 voxels"),
        (complaint(vec![1.0, 1e10], DensityMap { emphasis, ..DensityMap::default() })?, "1 voxels"),
        (complaint(vec![-1.0, -1e10], linear(1e300, 0.0))?, "1 voxels"),
        (complaint(vec![1e308, 1e308], DensityMap::default())?, "sum to inf"),
        (complaint(vec![200u8; 4], linear(8e305, 0.0))?, "sum to inf"),
        (complaint(vec![1.0], linear(f64::NAN, 0.0))?, "slope"),
        (complaint(vec![1.0], linear(f64::INFINITY, 0.0))?, "slope"),
    ];
    for (weight, spacing, word) in [(1e300, 1e5, "volume of 1e15 mm3"), (1e-300, 1e-9, "mm3 is 0e0")] {
        let volume = row(vec![weight])?.with_grid(Grid::with_spacing([1, 1, 1], [spacing; 3])?)?;
        said.push((
            Density::new(&volume, DensityMap::default()).map_or_else(|e| e.to_string(), |_| String::new()),
            word,
        ));
    }
    let wrong: Vec<&String> = said.iter().filter(|(says, word)| !says.contains(word)).map(|(says, _)| says).collect();
    Ok(Finding::wrong(wrong.len() as u64, said.len() as u64, "messages").with(format!("{wrong:?}").replace("[]", "")))
}

/// With the larger end's size W the rise is at most 2W, and 3/4 of it is gone through at most. Nine roundings of eps/2 each
/// (four of the isovalue, then its distance, width, rise, product, quotient) make 9/2 · 2 · 3/4 = 6.75 eps of W, the last
/// sum 1/2, and the four of the reference 2: 9.25 eps.
fn piecewise(_: &Context) -> Result<Finding, CaseError> {
    let ends = [-1e308, -1e200, -1e-200, 0.0, 1e-200, 1.0, 1e200, 1e308];
    let (mut worst, mut of, mut naive) = (0.0f64, 0, 0);
    for (i, &v0) in ends.iter().enumerate() {
        for &v1 in &ends[i + 1..] {
            for (w0, w1) in ends.into_iter().flat_map(|a| ends.map(|b| (a, b))) {
                let map =
                    DensityMap { transfer: Transfer::Piecewise(vec![[v0, w0], [v1, w1]]), ..DensityMap::default() };
                for t in [0.1, 1.0 / 3.0, 0.5, 0.7, 0.75] {
                    let (v, line) = (v0 * (1.0 - t) + v1 * t, w0 * (1.0 - t) + w1 * t);
                    let most = w0.abs().max(w1.abs()).max(f64::MIN_POSITIVE);
                    let error = (map.raw_weight(v) - line).abs() / most;
                    // The maximum passes over what is no number.
                    worst = worst.max(if error.is_nan() { f64::INFINITY } else { error });
                    let plain = w0 + (w1 - w0) * (v - v0) / (v1 - v0);
                    naive +=
                        u64::from((plain - line).abs().partial_cmp(&(1e-6 * most)) != Some(std::cmp::Ordering::Less));
                    of += 1;
                }
            }
        }
    }
    Ok(Finding::new(worst / f64::EPSILON, "eps of the larger end", Bound::AtMost(9.25))
        .with(format!("the plain formula is wrong or no number at {naive} of {of}")))
}

/// Exact: `end/total` of each voxel must be the same fraction in every type; compared crosswise in 128 bits.
fn types(_: &Context) -> Result<Finding, CaseError> {
    fn volumes() -> Result<Vec<Volume>, CaseError> {
        let values = |i: u8| i;
        fn of<T: Voxel>(value: impl Fn(u8) -> T) -> Result<Volume, CaseError> {
            row((0..128).map(value).collect())
        }
        Ok(vec![
            of(values)?,
            of(|i| values(i) as i8)?,
            of(|i| u16::from(values(i)))?,
            of(|i| i16::from(values(i)))?,
            of(|i| u32::from(values(i)))?,
            of(|i| i32::from(values(i)))?,
            of(|i| f32::from(values(i)))?,
            of(|i| f64::from(values(i)))?,
        ])
    }
    let maps = [
        DensityMap::default(),
        linear(0.37, 1.0 / 3.0),
        DensityMap { transfer: Transfer::Hounsfield(Hounsfield::of_water(0.02)?), ..DensityMap::default() },
        DensityMap {
            transfer: Transfer::Piecewise(vec![[10.0, 0.0], [50.0, 1e-30], [90.0, 7.7]]),
            ..DensityMap::default()
        },
        DensityMap { emphasis: Some(Emphasis { threshold: 60.0, gain: 2.5 }), ..DensityMap::default() },
    ];
    let (mut wrong, mut of) = (0, 0);
    for map in maps {
        let mut first: Option<(Vec<u64>, u64)> = None;
        for volume in volumes()? {
            let density = Density::new(&volume, map.clone())?;
            let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
            let (ends, total) = (exact::ends(&distribution), distribution.total());
            let (reference, whole) = first.get_or_insert_with(|| (ends.clone(), total));
            let same = |a: u64, b: u64| u128::from(a) * u128::from(*whole) == u128::from(b) * u128::from(total);
            wrong += ends.iter().zip(reference.iter()).filter(|(a, b)| !same(**a, **b)).count() as u64;
            of += ends.len() as u64;
        }
    }
    Ok(Finding::wrong(wrong, of, "voxels"))
}

/// Exact: scaling by a power of two rounds nothing, so units, targets, points and counts are the same bits.
fn scaling(_: &Context) -> Result<Finding, CaseError> {
    let grid = Grid::with_spacing([12, 11, 10], [1.0; 3])?;
    let camera = Camera::look(&View::default(), &grid, Extent::new(16, 16)?)?;
    let bytes: Vec<u8> = (0..grid.len()).map(|i| (i * i % 251) as u8).collect();
    let floats: Vec<f32> = bytes.iter().map(|v| f32::from(*v).sqrt()).collect();
    let volumes = [Volume::from_vec(grid.clone(), bytes, "bytes")?, Volume::from_vec(grid, floats, "floats")?];
    let (mut wrong, mut of) = (0, 0);
    for volume in volumes {
        for method in SAMPLERS {
            let request = Request {
                method,
                samples: budget(method, 2100),
                estimand: Estimand::Count,
                order: VoxelOrder::Hilbert,
                ..Request::default()
            };
            let draw = |e: i32| -> Result<_, CaseError> {
                let map = linear(power_of_two(e), 0.0);
                let density = Density::new(&volume, map.clone())?;
                let distribution = Distribution::new(&density, request.order)?;
                let stream = point_stream(&request, distribution.total());
                let watch = Watch::default();
                let (cloud, _) = sample(&distribution, &*stream, Kernel::Tent, Provenance::default(), &watch)?;
                Ok((cloud, make(&Scenery::new(volume.clone(), map, camera.clone()), &request, &watch)?.image))
            };
            let (cloud, image) = draw(0)?;
            for e in [-1000, -1, 1, 900] {
                let (points, scaled) = draw(e)?;
                for axis in 0..3 {
                    let [these, those] = [cloud.positions(), points.positions()];
                    let pairs = these[axis].iter().zip(&those[axis]);
                    wrong += pairs.filter(|(a, b)| a != b).count() as u64;
                }
                wrong += image.values().iter().zip(scaled.values()).filter(|(a, b)| a != b).count() as u64;
                of += 3 * cloud.samples() + image.values().len() as u64;
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "coordinates and pixels"))
}

/// A moved weight is rounded to `f32` once, by eps/2 of itself, so the mass errs by at most 1/2 f32 eps of itself; the `f64`
/// sums before and behind (504 terms of 2^-53) add less than 1e-3 of that. The moved weights of a scaled volume are those of the volume, scaled: any difference is added to the figure.
fn concentrated(_: &Context) -> Result<Finding, CaseError> {
    let weights: Vec<f64> = (0..9 * 8 * 7).map(|n| ((n * 7919 % 97) as f64 - 30.0).max(0.0)).collect();
    let grid = Grid::with_spacing([9, 8, 7], [1.0; 3])?;
    let map = DensityMap { concentrate: true, ..DensityMap::default() };
    let of = |e: i32| -> Result<(Density, f64), CaseError> {
        let scaled: Vec<f64> = weights.iter().map(|w| w * power_of_two(e)).collect();
        let volume = Volume::from_vec(grid.clone(), scaled, "scaled")?;
        let before = Density::new(&volume, DensityMap::default())?.mass();
        let after = Density::new(&volume, map.clone())?;
        let error = (after.mass() / before - 1.0).abs();
        Ok((after, error))
    };
    let (plain, mut worst) = of(0)?;
    let mut different = 0;
    for e in [-900, -200, -100, 100, 130, 900] {
        let (scaled, error) = of(e)?;
        worst = worst.max(error);
        let same = |n: &usize| scaled.weight(*n) == plain.weight(*n) * power_of_two(e);
        different += (0..weights.len()).filter(|n| !same(n)).count();
    }
    let unit = "f32 eps of the mass, and 1 for each voxel that differs";
    Ok(Finding::new(worst / f64::from(f32::EPSILON) + different as f64, unit, Bound::AtMost(0.501)))
}

/// Exact: a voxel without a target ends where its predecessor does.
fn no_gain(_: &Context) -> Result<Finding, CaseError> {
    let ranges = vec![(10.0, 20.0, 0.0), (20.0, 30.0, 2.0)];
    let gains =
        |elsewhere| DensityMap { gains: Some(Gains { ranges: ranges.clone(), elsewhere }), ..DensityMap::default() };
    let emphasis =
        |threshold| DensityMap { emphasis: Some(Emphasis { threshold, gain: 0.0 }), ..DensityMap::default() };
    let bytes: Vec<u8> = (0..100).collect();
    let (mut wrong, mut of) = (0, 0);
    for (map, drawn) in [
        (gains(0.0), (|v| (20..30).contains(&v)) as fn(usize) -> bool),
        (gains(1.0), |v| v > 0 && !(10..20).contains(&v)),
        (emphasis(40.0), |v| v > 0 && v < 40),
    ] {
        for volume in [row(bytes.clone())?, row(bytes.iter().map(|v| f32::from(*v)).collect())?] {
            let density = Density::new(&volume, map.clone())?;
            let ends = exact::ends(&Distribution::new(&density, VoxelOrder::Raster)?);
            wrong += (0..100).filter(|v| (ends[*v] > if *v > 0 { ends[v - 1] } else { 0 }) != drawn(*v)).count() as u64;
            of += 100;
        }
    }
    for says in [complaint(bytes.clone(), emphasis(-1.0))?, complaint(vec![12u8; 9], gains(1.0))?] {
        wrong += u64::from(!says.contains("nothing can be drawn"));
        of += 1;
    }
    Ok(Finding::wrong(wrong, of, "voxels and messages"))
}
