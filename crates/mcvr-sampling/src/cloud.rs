//! Samples kept as points in space: drawn once, projected from any view.

use std::time::Instant;

use glam::DVec3;
use mcvr_scene::{Camera, Estimand, Kernel, Watch};
use mcvr_volume::Grid;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::engine::{Counters, Rendered};
use crate::expose::{Exposure, Scratch};
use crate::find::locator;
use crate::offset::{BoxOffset, BsplineOffset, Offset, ShellOffset, TentOffset};
use crate::project::{Projection, centre_voxel, position};
use crate::simd::vectorised;
use crate::stream::check_samples;
use crate::{BLOCK, Distribution, PointStream, Precision, SamplingError, SimdLevel};

/// Where a cloud's points come from, in words; nothing is computed from it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    /// The volume.
    pub source: String,
    /// The density map.
    pub map: String,
    /// The sampling method.
    pub method: String,
    /// Key of all randomness.
    pub seed: u64,
    /// Order of the voxels.
    pub order: String,
    /// Randomisation of the net, for methods that have one.
    pub scramble: Option<String>,
}

/// Points with the density of the volume, and what it takes to make either estimand's image of them.
///
/// Positions are in voxels, counted from the grid's centre voxel `(n - 1) / 2` (rounded down) along each axis: the
/// numbers that the 32-bit projection starts from, so an image of a cloud equals the image that
/// [`render`](crate::render) makes of the same points, bit for bit, wherever the projection runs in
/// [`Precision::F32`]. Where it runs in [`Precision::F64`], the cloud's points keep their 32 bits: each is within
/// 2^-24 of its distance from the centre voxel.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    grid: Grid,
    kernel: Kernel,
    mass: f64,
    positions: [Vec<f32>; 3],
    provenance: Provenance,
}

impl Cloud {
    /// Bytes of memory that a point takes.
    pub const BYTES_PER_POINT: u64 = 12;

    /// Joins the parts: x, y and z of the points in voxels from the centre voxel, the grid, the kernel that spread
    /// them, and the total mass `F` in weight units × mm³.
    ///
    /// # Errors
    /// [`SamplingError::Cloud`] when the three lists differ in length or are empty, a position lies beyond the
    /// kernel's support around the grid or is no number, or the mass is not positive and finite.
    pub fn new(
        grid: Grid,
        kernel: Kernel,
        mass: f64,
        positions: [Vec<f32>; 3],
        provenance: Provenance,
    ) -> Result<Self, SamplingError> {
        let fail = |problem: String| Err(SamplingError::Cloud(problem));
        let lens = [0, 1, 2].map(|a: usize| positions[a].len());
        if lens[0] == 0 || lens[0] != lens[1] || lens[0] != lens[2] {
            return fail(format!("{lens:?} coordinates along x, y and z: expected as many on each axis, at least 1"));
        }
        if !mass.is_finite() || mass <= 0.0 {
            return fail(format!("the mass must be positive and finite, got {mass}"));
        }
        let dims = grid.dims();
        if dims.iter().any(|&n| n >= 1 << 31) {
            return fail(format!("extents {dims:?} exceed 2^31 - 1 voxels along an axis"));
        }
        let centre = centre_voxel(dims);
        for axis in 0..3 {
            // Rounding to 32 bits may move a point at the very end of the support outwards.
            let slack = 1e-3 + dims[axis] as f64 * f64::from(f32::EPSILON);
            let reach = kernel.support() + slack;
            let low = (-f64::from(centre[axis]) - reach) as f32;
            let high = ((dims[axis] - 1) as f64 - f64::from(centre[axis]) + reach) as f32;
            let wrong = positions[axis].par_iter().find_any(|v| !(low..=high).contains(*v));
            if let Some(v) = wrong {
                return fail(format!("axis {axis}: position {v} is outside {low}..{high} voxels from the centre"));
            }
        }
        Ok(Self { grid, kernel, mass, positions, provenance })
    }

    /// Number of points `M`.
    pub fn samples(&self) -> u64 {
        self.positions[0].len() as u64
    }

    /// The volume's grid.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The kernel that spread the points.
    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// Total mass `F`, weight units × mm³.
    pub fn mass(&self) -> f64 {
        self.mass
    }

    /// Where the points come from.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// x, y and z of all points, in voxels from the centre voxel.
    pub fn positions(&self) -> &[Vec<f32>; 3] {
        &self.positions
    }

    /// World position (mm) of point `index`.
    ///
    /// # Panics
    /// When there are fewer points.
    pub fn world(&self, index: usize) -> DVec3 {
        let centre = centre_voxel(self.grid.dims());
        let at = |a: usize| f64::from(centre[a]) + f64::from(self.positions[a][index]);
        self.grid.index_to_world().transform_point3(DVec3::new(at(0), at(1), at(2)))
    }
}

/// Draws a stream's points into a cloud on the current rayon pool; point `k` of the stream is point `k` of the
/// cloud, whatever the number of threads. Takes [`Cloud::BYTES_PER_POINT`] bytes a point.
///
/// # Errors
/// [`SamplingError::Samples`] for no samples or too many, [`SamplingError::Limit`] when memory for them cannot be
/// had, [`SamplingError::Cancelled`] when stopped.
pub fn sample(
    distribution: &Distribution<'_>,
    stream: &dyn PointStream,
    kernel: Kernel,
    provenance: Provenance,
    watch: &Watch<'_>,
) -> Result<(Cloud, Counters), SamplingError> {
    let samples = stream.samples();
    check_samples(samples)?;
    let level = SimdLevel::detect();
    let mut positions = [reserved(samples)?, reserved(samples)?, reserved(samples)?];
    let locator = locator(distribution, level);
    let density = distribution.density();
    let grid = density.volume().grid();
    let centre = centre_voxel(grid.dims());
    let place = match kernel {
        Kernel::Box => place_batch::<BoxOffset>,
        Kernel::Tent => place_batch::<TentOffset>,
        Kernel::Bspline3 => place_batch::<BsplineOffset>,
        Kernel::Shell => place_batch::<ShellOffset>,
    };
    let [x, y, z] = &mut positions;
    let blocks = x.par_chunks_mut(BLOCK).zip(y.par_chunks_mut(BLOCK)).zip(z.par_chunks_mut(BLOCK)).enumerate();
    let counters = blocks
        .fold(
            || (Scratch::default(), Counters::default()),
            |(mut scratch, mut counters), (block, ((x, y), z))| {
                if !watch.cancelled() {
                    let len = x.len();
                    let Scratch { points, places, .. } = &mut scratch;
                    points.resize(len);
                    places.iter_mut().for_each(|p| p.resize(len, 0));
                    stream.fill(block as u64, distribution.total(), points);
                    locator.locate(stream.search(), &points.targets, places, &mut counters);
                    let ([i, j, k], [u, v, w]) = (&*places, &points.uniforms);
                    place(level, centre, [i, j, k], [u, v, w], [x, y, z]);
                    counters.samples += len as u64;
                    watch.advance(len as u64);
                }
                (scratch, counters)
            },
        )
        .map(|(_, counters)| counters)
        .reduce(Counters::default, |mut a, b| {
            a.add(&b);
            a
        });
    if watch.cancelled() {
        return Err(SamplingError::Cancelled);
    }
    Ok((Cloud::new(grid.clone(), kernel, density.mass(), positions, provenance)?, counters))
}

/// Room for one coordinate of all points, zeroed; an error instead of an abort where there is none.
fn reserved(samples: u64) -> Result<Vec<f32>, SamplingError> {
    let mut room = vec![];
    let refused = |_| SamplingError::Limit {
        method: "cloud",
        problem: format!("no memory for {samples} points of {} bytes", Cloud::BYTES_PER_POINT),
    };
    room.try_reserve_exact(samples as usize).map_err(refused)?;
    room.resize(samples as usize, 0.0);
    Ok(room)
}

vectorised! {
    fn place_batch<K: Offset>(
        centre: [i32; 3], places: [&[u32]; 3], uniforms: [&[u32]; 3], out: [&mut [f32]; 3],
    ) = place_body::<K>
}

#[inline(always)]
fn place_body<K: Offset>(centre: [i32; 3], places: [&[u32]; 3], uniforms: [&[u32]; 3], out: [&mut [f32]; 3]) {
    let n = out[0].len();
    let [px, py, pz] = places.map(|s| &s[..n]);
    let [ux, uy, uz] = uniforms.map(|s| &s[..n]);
    let [x, y, z] = out.map(|s| &mut s[..n]);
    for i in 0..n {
        [x[i], y[i], z[i]] = position::<f32, K>(centre, [px[i], py[i], pz[i]], [ux[i], uy[i], uz[i]]);
    }
}

/// How to project a cloud; the default is what users want.
#[derive(Clone, Copy, Debug, Default)]
pub struct ProjectOptions {
    /// What a pixel means.
    pub estimand: Estimand,
    /// Vector instructions; `None` for the best there are. All give the same image.
    pub simd: Option<SimdLevel>,
    /// Arithmetic of the projection; `None` for the cheapest that is exact to 1/64 pixel.
    pub precision: Option<Precision>,
}

/// Makes an image of a cloud on the current rayon pool; see [`Cloud`] for when it equals [`render`](crate::render)'s.
///
/// # Errors
/// [`SamplingError::Samples`] for too many samples, [`SamplingError::Cancelled`] when stopped.
pub fn project_cloud(
    cloud: &Cloud,
    camera: &Camera,
    options: &ProjectOptions,
    watch: &Watch<'_>,
) -> Result<Rendered, SamplingError> {
    let start = Instant::now();
    let samples = cloud.samples();
    check_samples(samples)?;
    let level = SimdLevel::choose(options.simd);
    let projection = Projection::new(&cloud.grid, camera, cloud.kernel, samples, options.precision)?;
    projection.check(options.estimand)?;
    let projector = projection.stored_projector(options.estimand, level);
    let exposure = Exposure { camera, estimand: options.estimand, samples, mass: cloud.mass, share: 1.0 };
    exposure.run(&projection, start, watch, |block, scratch, film, _| {
        let drawn = Instant::now();
        let len = scratch.pixels.len();
        let first = block as usize * BLOCK;
        let [x, y, z] = &cloud.positions;
        let batch = [x, y, z].map(|s| &s[first..first + len]);
        let lost = projector.project(batch, &mut scratch.pixels, &mut scratch.weights);
        film.add(&scratch.pixels, &scratch.weights);
        (lost, drawn)
    })
}
