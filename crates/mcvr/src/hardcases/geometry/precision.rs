//! Pixels and precision: where samples fall.

use glam::DVec3;
use mcvr_sampling::{Distribution, Precision, RenderOptions, VoxelOrder, render};
use mcvr_scene::{Camera, Density, Estimand, Extent, Kernel, View, Watch};
use mcvr_volume::{Grid, Volume};

use super::super::scenes::{Points, cubes, filled, identity, parallel, plain, rendered, samplers, word};
use super::super::{Bound, CaseError, Context, Finding};
use crate::Request;

/// Exact: inside + beside + clipped = M, and the `count` image sums to inside / M, whole counts each: for every method, kernel
/// and precision, from views that cut the volume on every side.
pub(super) fn conservation(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([9, 8, 7])?;
    let base = View { azimuth: 31.0, elevation: 17.0, ..View::default() };
    let d = volume.grid().diameter();
    let views = [
        base,
        View { parallel: true, fov: Some(10.0), ..base },
        View { distance: Some(1e-6 * d), fov: Some(120.0), ..base },
        View { near: Some(2.0 * d), fov: Some(8.0), ..base },
        View { fov: Some(1e-3), elevation: 90.0, ..base },
        View { distance: Some(1e9 * d), azimuth: 0.0, elevation: 0.0, ..base },
    ];
    let (mut wrong, mut of) = (0, 0);
    for view in views {
        let scenery = plain(&volume, Camera::look(&view, volume.grid(), Extent::new(33, 21)?)?);
        for method in samplers() {
            for kernel in Kernel::ALL {
                for precision in [Precision::F32, Precision::F64] {
                    let samples = 2049;
                    let request = Request { method, kernel, estimand: Estimand::Count, samples, ..Request::default() };
                    let made = rendered(&scenery, &request, Some(precision))?;
                    let c = made.counters;
                    let whole = made.image.values().iter().map(|v| v * samples as f64);
                    let counted: u64 = whole.clone().map(|v| v.round() as u64).sum();
                    let split = whole.into_iter().any(|v| (v - v.round()).abs() > samples as f64 * f64::EPSILON);
                    of += 1;
                    wrong += u64::from(c.inside + c.outside + c.clipped != samples || counted != c.inside || split);
                }
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "images"))
}

/// Samples that fall exactly on pixel borders and corners: voxels one pixel apart, offsets that are dyadic fractions and a shift
/// that takes them away, so that every position is a whole number exactly. Pixels are half-open: position `(i, j)` belongs to
/// pixel `(i, j)` alone, and those at the image's right and lower border to none.
pub(super) fn pixel_borders(_: &Context) -> Result<Finding, CaseError> {
    let volume = filled(Grid::with_spacing([9, 9, 1], [1.0; 3])?, |n| vec![1u8; n])?;
    let density = identity(&volume)?;
    let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
    let (mut wrong, mut of) = (0, 0);
    for precision in [Precision::F64, Precision::F32] {
        // In 32 bits offsets have few digits as well, so that sums with whole numbers stay exact.
        let words = [0u32, 1 << 31, 3 << 30, 0xffff_ffff, 0x1234_5678];
        let bits = if precision == Precision::F64 { 32 } else { 23 };
        for word in words {
            let u = (f64::from(word >> (32 - bits)) + 0.5) / 2f64.powi(bits);
            let t = u - 0.5;
            if precision == Precision::F32 && (t + 8.0) as f32 as f64 != t + 8.0 {
                continue;
            }
            let extent = Extent::new(8, 8)?;
            let camera = parallel(DVec3::X, DVec3::Y, [-t, -t], extent, volume.grid())?;
            let points = Points((0..81).map(|i| (i, [word; 3])).collect());
            let options = RenderOptions {
                estimand: Estimand::Count,
                kernel: Kernel::Box,
                precision: Some(precision),
                ..RenderOptions::default()
            };
            let made = render(&distribution, &points, &camera, &options, &Watch::default())?;
            of += 81;
            for v in made.image.values() {
                wrong += ((v * 81.0).round() as u64).abs_diff(1);
            }
            wrong += made.counters.outside.abs_diff(17);
        }
    }
    Ok(Finding::wrong(wrong, of, "samples"))
}

/// How far apart the positions of the same points along one image axis are in 32 and in 64 bits, in pixels of `camera`.
///
/// The image's row is magnified by `2^k` so that its width is 2^19 or 2^22 pixels: scaling by a power of two changes no rounding,
/// so pixel numbers are the positions, in both precisions, to `2^-k`. Sorted positions pair up: the largest difference between
/// two sorted lists is no larger than the largest error, and equal to it where points lie farther apart than they err.
fn displacement(density: &Density, camera: &Camera, kernel: Kernel, along: usize) -> Result<f64, CaseError> {
    let extent = camera.extent();
    let side = [extent.width, extent.height][along];
    let k = if side > 1 << 12 { 8 } else { (19 - side.next_power_of_two().ilog2()).min(16) };
    let m = camera.world_to_pixel();
    // The other axis is dropped: all of it in one pixel.
    let row = m[along].map(|v| v * f64::from(1u32 << k));
    let other = m[1 - along].map(|v| v / [extent.width, extent.height][1 - along] as f64);
    let magnified = Extent::new(side << k, 1)?;
    let camera = Camera::from_matrix([row, other, m[2]], magnified, density.volume().grid(), Some(camera.near()))?;
    let distribution = Distribution::new(density, VoxelOrder::Raster)?;
    let total = distribution.total();
    // Words in the middle of both precisions' grids of uniforms: the same number, to 2^-33.
    let words = |i: u64| [0, 1, 2].map(|a| (word(3 * i + a) >> 32) as u32 & !0x1ff | 0x100);
    let mut points: Vec<_> =
        (0..512).map(|i| (((u128::from(word(!i)) * u128::from(total)) >> 64) as u64, words(i))).collect();
    // The ends of the volume and of the kernel, where positions are largest.
    let ends = [0x100, 0xffff_ff00];
    points.extend([0, total - 1].into_iter().flat_map(|t| ends.map(|w| (t, [w; 3]))));
    // The poles of the shell, where its radius has the fewest digits.
    points
        .extend((0..128).map(|i| {
            (word(i) % total, [(i as u32 * 37) << 9 | 0x100, (word(i) >> 32) as u32 & !0x1ff | 0x100, 0x100])
        }));
    let points = Points(points);
    let positions = |precision| -> Result<Vec<f64>, CaseError> {
        let options =
            RenderOptions { estimand: Estimand::Count, kernel, precision: Some(precision), ..RenderOptions::default() };
        let made = render(&distribution, &points, &camera, &options, &Watch::default())?;
        let count = |v: f64| (v * points.0.len() as f64).round() as usize;
        let pixels = made.image.values().iter().enumerate();
        Ok(pixels.flat_map(|(i, v)| std::iter::repeat_n(i as f64, count(*v))).collect())
    };
    let (a, b) = (positions(Precision::F32)?, positions(Precision::F64)?);
    if a.len() != b.len() || a.is_empty() {
        return Err(format!("{} and {} samples inside", a.len(), b.len()).into());
    }
    let apart = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    // Pixel numbers are truncated positions: one unit more, at worst.
    Ok((apart + 1.0) / f64::from(1u32 << k))
}

/// Wherever 32 bits are chosen, no position may be off by more than the code states, [`Precision::LIMIT`] = 1/64 pixel; measured
/// against 64 bits, whose error is 2^-29 of that. Scenes at both sides of the choice: long axes, large images, close eyes, far
/// origins, all kernels.
pub(super) fn single_error(_: &Context) -> Result<Finding, CaseError> {
    let (mut worst, mut chosen, mut refused, mut forced) = (0.0f64, 0, 0, 0.0f64);
    for (dims, origin) in [([1, 1, 1], 0.0), ([24, 20, 16], 1e7), ([40_000, 1, 1], 0.0), ([1 << 20, 1, 1], -300.0)] {
        let grid = Grid::new(dims, DVec3::ONE, DVec3::splat(origin), glam::DMat3::from_rotation_y(0.4))?;
        let volume = filled(grid, |n| vec![1u8; n])?;
        let density = identity(&volume)?;
        for side in [64, 16_384] {
            for (is_parallel, close) in [(false, 0.8), (true, 2.0)] {
                let distance = Some(close * volume.grid().diameter());
                let view = View { azimuth: 31.0, elevation: 17.0, parallel: is_parallel, distance, ..View::default() };
                let camera = Camera::look(&view, volume.grid(), Extent::new(side, side)?)?;
                // Images of 16,384 pixels a side take a hundredth of a second each: the two kernels that differ most.
                let kernels = if side == 64 { &Kernel::ALL[..] } else { &[Kernel::Tent, Kernel::Shell] };
                for &kernel in kernels {
                    if side > 64 && dims[0] > 1 {
                        continue;
                    }
                    let one = Points(vec![(0, [1 << 31; 3])]);
                    let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
                    let options = RenderOptions { estimand: Estimand::Count, kernel, ..RenderOptions::default() };
                    let small =
                        Camera::from_matrix(camera.world_to_pixel(), Extent::new(side, 1)?, volume.grid(), None)?;
                    if render(&distribution, &one, &small, &options, &Watch::default())?.precision == Precision::F64 {
                        refused += 1;
                        forced = forced.max(displacement(&density, &camera, kernel, 0)?);
                        continue;
                    }
                    chosen += 1;
                    worst = worst.max(displacement(&density, &camera, kernel, 0)?);
                }
            }
        }
    }
    let worst = if chosen == 0 { f64::NAN } else { worst };
    Ok(Finding::new(worst, "pixels", Bound::AtMost(Precision::LIMIT)).with(format!(
        "{chosen} scenes in 32 bits, {refused} in 64; those would be off by up to {forced:.3} pixels in 32"
    )))
}

/// A row of 2^21 + 3 voxels, 5 of them not 0, one pixel each: every sample lies in one of those 5 pixels under `box`, the last
/// voxel's among them. A position in 32 bits has steps of 1/4 voxel there, so that samples leave their pixel.
pub(super) fn long_axis(_: &Context) -> Result<Finding, CaseError> {
    let n = (1usize << 21) + 3;
    let marks = [0, 1, 1 << 20, (1 << 21) - 1, n - 1];
    let voxels = |n: usize| {
        let mut voxels = vec![0u8; n];
        marks.iter().for_each(|m| voxels[*m] = 1);
        voxels
    };
    let (samples, mut wrong, mut of, mut single) = (4099, 0, 0, 0);
    for axis in 0..3 {
        let mut dims = [1; 3];
        dims[axis] = n;
        let volume: Volume = filled(Grid::with_spacing(dims, [1.0; 3])?, voxels)?;
        let (x, y) = (DVec3::AXES[axis], DVec3::AXES[(axis + 1) % 3]);
        let camera = parallel(x, y, [0.5, 0.5], Extent::new(n, 1)?, volume.grid())?;
        let scenery = plain(&volume, camera);
        let request = Request { kernel: Kernel::Box, estimand: Estimand::Count, samples, ..Request::default() };
        let stray = |precision| -> Result<u64, CaseError> {
            let image = rendered(&scenery, &request, precision)?.image;
            let kept: f64 = marks.iter().map(|m| image.values()[*m]).sum();
            let empty = marks.iter().filter(|m| image.values()[**m] == 0.0).count() as u64;
            Ok(samples - (kept * samples as f64).round() as u64 + empty * samples)
        };
        of += samples;
        wrong += stray(None)?;
        single += stray(Some(Precision::F32))?;
    }
    Ok(Finding::wrong(wrong, of, "samples").with(format!("{single} in 32 bits")))
}

/// An image of 16,384² pixels: no sample of a volume that it holds is lost, and every pixel is a whole count.
pub(super) fn large_image(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([40, 30, 20])?;
    let camera = Camera::look(&View::default(), volume.grid(), Extent::new(16_384, 16_384)?)?;
    let samples = 1_000_003;
    let request = Request { estimand: Estimand::Count, samples, ..Request::default() };
    let made = rendered(&plain(&volume, camera), &request, None)?;
    let counted: u64 = made.image.values().iter().map(|v| (v * samples as f64).round() as u64).sum();
    Ok(Finding::wrong(samples.abs_diff(counted) + samples.abs_diff(made.counters.inside), samples, "samples"))
}
