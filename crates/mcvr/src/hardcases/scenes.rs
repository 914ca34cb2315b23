//! Scenes that several groups pose, and the statistics that hold an image to its reference.

use glam::{DMat3, DVec3};
use mcvr_raycast::{Counters, Integrator, LookReference, Reference, ReferenceOptions, reference, reference_with_look};
use mcvr_sampling::{
    BLOCK, Distribution, PointBlock, PointStream, Precision, RenderOptions, Rendered, Search, VoxelOrder, render,
};
use mcvr_scene::{Camera, Density, DensityMap, Estimand, Extent, Image, Kernel, Watch};
use mcvr_volume::{Grid, Volume, Voxel};

use super::CaseError;
use crate::request::point_stream;
use crate::{Made, Method, Request, Scenery, make};

/// Kernels that can be integrated along rays.
pub(super) const SEPARABLE: [Kernel; 3] = [Kernel::Box, Kernel::Tent, Kernel::Bspline3];

/// Every method that draws samples.
pub(super) fn samplers() -> impl Iterator<Item = Method> {
    Method::ALL.into_iter().filter(|m| m.samples_volume())
}

/// Reproducible words, by SplitMix64.
pub(super) fn word(key: u64) -> u64 {
    let mut z = key.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A uniform number in [0, 1).
pub(super) fn unit(key: u64) -> f64 {
    (word(key) >> 11) as f64 / (1u64 << 53) as f64
}

/// Bytes in 1..=255.
pub(super) fn bytes(n: usize) -> Vec<u8> {
    (0..n as u64).map(|i| (word(i) >> 56) as u8 | 1).collect()
}

/// A volume of bytes on a grid of cubes of 1 mm.
pub(super) fn cubes(dims: [usize; 3]) -> Result<Volume, CaseError> {
    filled(Grid::with_spacing(dims, [1.0; 3])?, bytes)
}

/// A volume on a grid from the number of its voxels.
pub(super) fn filled<T: Voxel>(grid: Grid, voxels: impl Fn(usize) -> Vec<T>) -> Result<Volume, CaseError> {
    let voxels = voxels(grid.len());
    Ok(Volume::from_vec(grid, voxels, "hard case")?)
}

/// A plain X-ray under the identity map.
pub(super) fn plain(volume: &Volume, camera: Camera) -> Scenery {
    Scenery::new(volume.clone(), DensityMap::default(), camera)
}

/// A volume under the identity map.
pub(super) fn identity(volume: &Volume) -> Result<Density, CaseError> {
    Ok(Density::new(volume, DensityMap::default())?)
}

/// A pinhole at `eye` that looks along `axis`, with `right` and `down` the image's directions, all of unit length: exact where
/// they are whole numbers. `focal` is in pixels; the axis meets the image's middle.
pub(super) fn pinhole(
    eye: DVec3,
    [right, down, axis]: [DVec3; 3],
    focal: f64,
    extent: Extent,
    near: f64,
) -> Result<Camera, CaseError> {
    let (cx, cy) = (0.5 * extent.width as f64, 0.5 * extent.height as f64);
    let rows = [right * focal + axis * cx, down * focal + axis * cy, axis];
    let matrix = rows.map(|r| [r.x, r.y, r.z, -r.dot(eye)]);
    // The sign of a matrix is told from a grid that lies ahead; the volume itself may be anywhere.
    let ahead = Grid::new([1; 3], DVec3::ONE, eye + axis * 16.0, DMat3::IDENTITY)?;
    Ok(Camera::from_matrix(matrix, extent, &ahead, Some(near))?)
}

/// A parallel camera whose image directions are `x` and `y` (pixels per mm) and whose image shows `shift` at the origin.
pub(super) fn parallel(x: DVec3, y: DVec3, shift: [f64; 2], extent: Extent, grid: &Grid) -> Result<Camera, CaseError> {
    let matrix = [[x.x, x.y, x.z, shift[0]], [y.x, y.y, y.z, shift[1]], [0.0, 0.0, 0.0, 1.0]];
    Ok(Camera::from_matrix(matrix, extent, grid, None)?)
}

/// A camera after the world has been moved by `x -> a x + b`: it sees the moved world as the old one saw the old.
pub(super) fn moved(camera: &Camera, a: DMat3, b: DVec3, grid: &Grid) -> Result<Camera, CaseError> {
    let back = a.inverse();
    let matrix = camera.world_to_pixel().map(|r| {
        let row = back.transpose() * DVec3::new(r[0], r[1], r[2]);
        [row.x, row.y, row.z, r[3] - row.dot(b)]
    });
    Ok(Camera::from_matrix(matrix, camera.extent(), grid, Some(camera.near()))?)
}

/// An image by request.
pub(super) fn made(scenery: &Scenery, request: &Request) -> Result<Made, CaseError> {
    Ok(make(scenery, request, &Watch::default())?)
}

/// An image by a method's points in an arithmetic, with no brick left out.
pub(super) fn rendered(
    scenery: &Scenery,
    request: &Request,
    precision: Option<Precision>,
) -> Result<Rendered, CaseError> {
    let density = Density::new(&scenery.volume, scenery.map.clone())?;
    let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
    let stream = point_stream(request, distribution.total());
    let options =
        RenderOptions { estimand: request.estimand, kernel: request.kernel, precision, ..RenderOptions::default() };
    Ok(render(&distribution, &*stream, &scenery.camera, &options, &Watch::default())?)
}

/// The exact image.
pub(super) fn exact(
    scenery: &Scenery,
    kernel: Kernel,
    estimand: Estimand,
    tolerance: f64,
) -> Result<Reference, CaseError> {
    let density = Density::new(&scenery.volume, scenery.map.clone())?;
    let options = ReferenceOptions { estimand, kernel, tolerance, ..ReferenceOptions::default() };
    Ok(reference(&density, &scenery.camera, &options, &Watch::default())?)
}

/// The exact image with the scenery's effects.
pub(super) fn exact_look(
    scenery: &Scenery,
    kernel: Kernel,
    estimand: Estimand,
    tolerance: f64,
) -> Result<LookReference, CaseError> {
    let density = Density::new(&scenery.volume, scenery.map.clone())?;
    let look = scenery.effects.look(scenery.volume.grid(), &scenery.camera)?;
    let options = ReferenceOptions { estimand, kernel, tolerance, ..ReferenceOptions::default() };
    Ok(reference_with_look(&density, &scenery.camera, &look, &options, &Watch::default())?)
}

/// Exact line integrals through points of an image.
pub(super) fn lines(
    density: &Density,
    kernel: Kernel,
    camera: &Camera,
    at: impl IntoIterator<Item = [f64; 2]>,
) -> Result<Vec<f64>, CaseError> {
    let field = Integrator::new(density, kernel)?;
    let rays = field.view(camera, Estimand::Line);
    Ok(at.into_iter().map(|[x, y]| rays.integrate(x, y, &mut Counters::default())).collect())
}

/// How far the mean of `samples` independent numbers in `[0, largest]` whose second moment is at most `square` may lie from its
/// expectation, but for a probability of 1e-6 over `cells` of them: Bernstein's inequality,
/// `P(|mean - E| >= t) <= 2 exp(-n t² / (2 square + 2/3 largest t))`, solved for `t`.
pub(super) fn bernstein(samples: u64, square: f64, largest: f64, cells: usize) -> f64 {
    let l = (2.0 * cells as f64 / 1e-6).ln() / samples as f64;
    let a = largest * l / 3.0;
    a + (a * a + 2.0 * l * square).sqrt()
}

/// The worst pixel of an image of independent samples against its reference: the difference over what [`bernstein`] and the
/// reference's own error allow. A sample adds at most `largest`, so that a pixel of mean `v` has a second moment of at most
/// `largest v`, and of at most `square` where the caller knows better. More than 1 is a failure; so is a pixel that is not
/// finite.
pub(super) fn disagreement(image: &Image, truth: &Reference, samples: u64, largest: f64, square: f64) -> f64 {
    let pixels = truth.image.values().iter().zip(truth.error.image.values()).zip(image.values());
    pixels.fold(0.0, |worst: f64, ((v, e), made)| {
        let allowed = e + bernstein(samples, square.min(largest * (v + e)), largest, truth.image.values().len());
        let ratio = (made - v).abs() / allowed;
        if ratio.is_finite() { worst.max(ratio) } else { f64::INFINITY }
    })
}

/// The largest amount, in the unit of an image, that one sample can add to a pixel: 1 for `count`, `F` times the largest
/// line factor for `line`, at the smallest depth `nearest` that holds density, in a corner of the image.
pub(super) fn largest_amount(camera: &Camera, estimand: Estimand, mass: f64, nearest: f64) -> f64 {
    if estimand == Estimand::Count {
        return 1.0;
    }
    let (w, h) = (camera.extent().width as f64, camera.extent().height as f64);
    let corners = [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]];
    mass * corners.into_iter().map(|[x, y]| camera.line_factor(x, y, nearest)).fold(0.0, f64::max)
}

/// Points as they are given: a target and three words each.
pub(super) struct Points(pub Vec<(u64, [u32; 3])>);

impl PointStream for Points {
    fn samples(&self) -> u64 {
        self.0.len() as u64
    }

    fn search(&self) -> Search {
        Search::Binary
    }

    fn fill(&self, block: u64, _: u64, out: &mut PointBlock) {
        for (i, (target, words)) in self.0[block as usize * BLOCK..].iter().take(BLOCK).enumerate() {
            out.targets[i] = *target;
            for (uniforms, word) in out.uniforms.iter_mut().zip(words) {
                uniforms[i] = *word;
            }
        }
    }
}
