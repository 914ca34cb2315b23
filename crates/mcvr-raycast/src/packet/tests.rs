//! Packets against the reference's rays, on every set of instructions.

use mcvr_scene::{Camera, Density, DensityMap, Estimand, Extent, Kernel, Transfer, View, Watch};
use mcvr_volume::{Grid, SimdLevel, Volume, Voxel};

use super::corners::{Corners, Weights};
use super::weigh::{Visit, with_corners};
use super::{Along, Packets, Plan};
use crate::points::Points;
use crate::{Counters, Integrator};

/// Blobs in empty space, and a slab that touches the grid's border.
fn value(i: usize, dims: [usize; 3]) -> u64 {
    let [x, y, z] = [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]];
    let blob = (x / 7 + 2 * (y / 9) + 3 * (z / 8)) % 5 == 0;
    if blob || x + 1 == dims[0] { (i as u64 * 7919) % 97 + 1 } else { 0 }
}

fn density<T: Voxel>(map: DensityMap, spacing: [f64; 3], make: impl Fn(u64) -> T) -> Density {
    density_of([37, 29, 41], map, spacing, make)
}

fn density_of<T: Voxel>(dims: [usize; 3], map: DensityMap, spacing: [f64; 3], make: impl Fn(u64) -> T) -> Density {
    let voxels = (0..dims.iter().product()).map(|i| make(value(i, dims))).collect();
    let volume = Volume::from_vec(Grid::with_spacing(dims, spacing).unwrap(), voxels, "blobs").unwrap();
    Density::new(&volume, map).unwrap()
}

fn linear(slope: f64, intercept: f64) -> DensityMap {
    DensityMap { transfer: Transfer::Linear { slope, intercept }, ..DensityMap::default() }
}

fn densities() -> Vec<(&'static str, Density)> {
    let plain = DensityMap::default;
    let bent = || DensityMap {
        transfer: Transfer::Piecewise(vec![[0.0, 0.0], [20.0, 3.0], [60.0, 1.0], [100.0, 9.0]]),
        ..DensityMap::default()
    };
    let even = [1.0; 3];
    let uneven = [0.7, 1.3, 2.1];
    vec![
        ("u8", density(plain(), even, |v| v as u8)),
        ("u8 uneven", density(plain(), uneven, |v| v as u8)),
        ("u8 bent", density(bent(), even, |v| v as u8)),
        ("i8", density(linear(1.0, 3.0), even, |v| v as i8 - 3)),
        ("u16", density(plain(), uneven, |v| v as u16 * 500)),
        ("u16 bent", density(bent(), even, |v| v as u16)),
        ("i16 with an intercept", density(linear(0.02, 20.0), even, |v| v as i16 * 11 - 1000)),
        ("i16 cut off", density(linear(0.5, -4.0), uneven, |v| v as i16)),
        ("f32", density(plain(), even, |v| v as f32 * 0.013)),
        ("f32 cut off", density(linear(0.5, -4.0), uneven, |v| v as f32)),
    ]
}

fn cameras(grid: &Grid) -> Vec<(&'static str, Camera)> {
    let extent = Extent::new(43, 37).unwrap();
    let look = |view: View| Camera::look(&view, grid, extent).unwrap();
    let oblique = View { azimuth: 34.0, elevation: 21.0, ..View::default() };
    vec![
        ("oblique", look(oblique)),
        ("along an axis", look(View { azimuth: 0.0, elevation: 0.0, ..View::default() })),
        ("parallel", look(View { parallel: true, ..oblique })),
        ("near", look(View { distance: Some(40.0), fov: Some(70.0), ..oblique })),
        ("inside", look(View { distance: Some(9.0), fov: Some(90.0), ..oblique })),
    ]
}

fn plan(along: Along, rays: u32, estimand: Estimand) -> Plan {
    Plan { along, points: Points::new(rays, true, true, 5), estimand }
}

#[test]
fn exact_packets_are_the_reference_s_rays() {
    for (name, density) in densities() {
        let integrator = Integrator::new(&density, Kernel::Tent).unwrap();
        for (view, camera) in cameras(density.volume().grid()) {
            for estimand in [Estimand::Line, Estimand::Count] {
                let plan = plan(Along::Exact, 3, estimand);
                let (image, counters) = Packets::new(&density).image(&camera, &plan, &Watch::default()).unwrap();
                let rays = integrator.view(&camera, estimand);
                let mut all = Counters::default();
                let mut worst = 0.0f64;
                for (i, got) in image.values().iter().enumerate() {
                    let (x, y) = (i % 43, i / 43);
                    let expected: f64 = (0..3)
                        .map(|r| {
                            let [dx, dy, _] = plan.points.of(x, y, r);
                            rays.integrate(x as f64 + dx, y as f64 + dy, &mut all) / 3.0
                        })
                        .sum();
                    worst = worst.max((got - expected).abs());
                }
                let mean = image.mean();
                assert!(mean > 0.0 && worst < 2e-5 * mean, "{name}, {view}, {estimand}: off by {:.2e}", worst / mean);
                assert!(counters.rays <= all.rays && counters.rays > 0);
                // The packets' bricks begin a voxel later, so neither count bounds the other; both leap over empty bricks.
                assert!(counters.cells > all.cells / 2, "{name}, {view}: {} cells of {}", counters.cells, all.cells);
                assert!(counters.voxel_reads <= 8 * counters.cells && counters.voxel_reads > 4 * counters.cells);
            }
        }
    }
}

#[test]
fn all_instructions_and_thread_numbers_give_the_same_bits() {
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let four = rayon::ThreadPoolBuilder::new().num_threads(4).build().unwrap();
    for (name, density) in densities() {
        for (view, camera) in cameras(density.volume().grid()) {
            for along in [Along::Exact, Along::Comb(0.8), Along::Comb(5.0)] {
                for estimand in [Estimand::Line, Estimand::Count] {
                    let plan = plan(along, 2, estimand);
                    let cast =
                        |level| Packets::new(&density).on(level).image(&camera, &plan, &Watch::default()).unwrap();
                    let expected = one.install(|| cast(SimdLevel::Portable));
                    for level in SimdLevel::available() {
                        let got = four.install(|| cast(level));
                        assert!(got == expected, "{name}, {view}, {along:?}, {estimand}: {level:?} differs");
                    }
                }
            }
        }
    }
}

#[test]
fn combs_are_unbiased_at_any_distance_and_fine_ones_converge() {
    let scenes = [("u8", density(DensityMap::default(), [0.7, 1.3, 2.1], |v| v as u8))];
    for (name, density) in scenes {
        let camera = &cameras(density.volume().grid())[0].1;
        for estimand in [Estimand::Line, Estimand::Count] {
            // Through the pixels' centres, so that only the way along the ray is random.
            let cast = |along, seed| {
                let plan = Plan { along, points: Points::new(1, false, true, seed), estimand };
                Packets::new(&density).image(camera, &plan, &Watch::default()).unwrap().0
            };
            let truth = cast(Along::Exact, 0);
            let mut last = f64::INFINITY;
            for distance in [6.0, 2.0, 0.5] {
                let repeats = 64;
                let mut sums = vec![[0.0; 2]; truth.values().len()];
                for seed in 0..repeats {
                    for (s, (v, t)) in
                        sums.iter_mut().zip(cast(Along::Comb(distance), seed).values().iter().zip(truth.values()))
                    {
                        s[0] += v - t;
                        s[1] += (v - t) * (v - t);
                    }
                }
                // Sum over pixels of the mean deviations, in its own standard errors.
                let n = repeats as f64;
                let total: f64 = sums.iter().map(|s| s[0] / n).sum();
                let variance: f64 = sums.iter().map(|s| (s[1] / n - (s[0] / n).powi(2)) / (n - 1.0)).sum();
                assert!(
                    variance > 0.0 && total.abs() < 4.5 * variance.sqrt(),
                    "{name}, {estimand}, {distance}: z = {}",
                    total / variance.sqrt()
                );
                let rmse = (sums.iter().map(|s| s[1] / n).sum::<f64>() / sums.len() as f64).sqrt() / truth.mean();
                assert!(rmse < 0.6 * last, "{distance} mm: {rmse} after {last}");
                last = rmse;
            }
            assert!(last < 0.02, "{last}");
        }
    }
}

#[test]
fn memory_asked_for_ahead_changes_nothing() {
    let far = density_of([140, 90, 100], DensityMap::default(), [1.0; 3], |v| v as u8);
    assert!(with_corners(&far, IsFar) == Some(true));
    let near = density(DensityMap::default(), [1.0; 3], |v| v as u8);
    assert!(with_corners(&near, IsFar) == Some(false));
    let integrator = Integrator::new(&far, Kernel::Tent).unwrap();
    for (view, camera) in cameras(far.volume().grid()) {
        let exact = plan(Along::Exact, 3, Estimand::Line);
        let image = Packets::new(&far).image(&camera, &exact, &Watch::default()).unwrap().0;
        let rays = integrator.view(&camera, Estimand::Line);
        let mut counters = Counters::default();
        for (i, got) in image.values().iter().enumerate() {
            let (x, y) = (i % 43, i / 43);
            let one = |r| {
                let [dx, dy, _] = exact.points.of(x, y, r);
                rays.integrate(x as f64 + dx, y as f64 + dy, &mut counters) / 3.0
            };
            let expected: f64 = (0..3).map(one).sum();
            assert!((got - expected).abs() < 2e-5 * image.mean(), "{view}, {x}, {y}: {got} for {expected}");
        }
        let comb = |distance: f64| plan(Along::Comb(distance), 3, Estimand::Line);
        let cast = |distance| Packets::new(&far).image(&camera, &comb(distance), &Watch::default()).unwrap();
        for level in SimdLevel::available() {
            let got = Packets::new(&far).on(level).image(&camera, &comb(0.75), &Watch::default()).unwrap();
            assert!(got == cast(0.75), "{view}: {level:?} differs");
        }
        let close = cast(0.25).0;
        let squares = close.values().iter().zip(image.values()).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        let error = (squares / image.values().len() as f64).sqrt() / image.mean();
        assert!(error < 0.01, "{view}: {error}");
    }
}

/// Whether a density's voxels are too many for the inner caches.
struct IsFar;

impl<'a> Visit<'a> for IsFar {
    type Out = bool;

    fn run<T: Voxel, W: Weights<T> + Send + 'a>(self, field: Corners<'a, T, W>) -> bool {
        field.far()
    }
}

#[test]
fn what_packets_do_not_serve_they_refuse() {
    let camera = |d: &Density| cameras(d.volume().grid())[0].1.clone();
    let plan = plan(Along::Exact, 1, Estimand::Line);
    let huge = density(linear(1e120, 0.0), [1.0; 3], |v| v as f32);
    let wide = density(DensityMap::default(), [1.0; 3], |v| v as u32);
    let flat = {
        let grid = Grid::with_spacing([8, 8, 1], [1.0; 3]).unwrap();
        Density::new(&Volume::from_vec(grid, vec![1u8; 64], "flat").unwrap(), DensityMap::default()).unwrap()
    };
    for density in [huge, wide, flat] {
        assert!(Packets::new(&density).image(&camera(&density), &plan, &Watch::default()).is_none());
    }
}
