//! Samples kept as points in space: drawn once, projected from any view.

use std::borrow::Cow;
use std::time::Instant;

use glam::DVec3;
use mcvr_scene::{Camera, Estimand, Kernel, Watch};
use mcvr_volume::Grid;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::compact::{Compact, MOST_VOXELS};
use crate::engine::{Counters, Rendered};
use crate::expose::{Exposure, Scratch};
use crate::find::locator;
use crate::offset::{BoxOffset, BsplineOffset, Offset, ShellOffset, TentOffset};
use crate::project::{centre_voxel, position};
use crate::projection::Projection;
use crate::stream::check_samples;
use crate::{BLOCK, Distribution, PointStream, Precision, SamplingError, SimdLevel};
use mcvr_volume::vectorised;

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
///
/// A [compact](Cloud::compacted) cloud takes half the memory and is the quicker to project; its points are each moved by up to
/// [`Compact::error`] voxels along an axis, and sorted by place.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    grid: Grid,
    kernel: Kernel,
    mass: f64,
    points: Points,
    provenance: Provenance,
}

/// Points as 32-bit positions, or in bricks.
#[derive(Clone, Debug, PartialEq)]
enum Points {
    Single([Vec<f32>; 3]),
    Compact(Compact),
}

impl Cloud {
    /// Bytes of memory that a point takes in a cloud that is not compact.
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
        check_whole(&grid, mass)?;
        let dims = grid.dims();
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
        Ok(Self { grid, kernel, mass, points: Points::Single(positions), provenance })
    }

    /// As [`Cloud::new`], of compact points.
    ///
    /// # Errors
    /// [`SamplingError::Cloud`] as [`Cloud::new`], and for a grid of more than 2^22 voxels along an axis.
    pub fn of_compact(
        grid: Grid,
        kernel: Kernel,
        mass: f64,
        points: Compact,
        provenance: Provenance,
    ) -> Result<Self, SamplingError> {
        check_whole(&grid, mass)?;
        check_compact(&grid)?;
        // A point at the very end of the support lies in a cell that may begin before it.
        let slack = 1e-3 + 2.0 * points.error();
        let ranges = grid.dims().map(|n| {
            let reach = kernel.support() + slack + n as f64 * f64::from(f32::EPSILON);
            [-reach, (n - 1) as f64 + reach]
        });
        if let Some((axis, v)) = points.outside(ranges) {
            let [low, high] = ranges[axis];
            return Err(SamplingError::Cloud(format!(
                "axis {axis}: position {v} is outside {low}..{high} voxels from the first voxel"
            )));
        }
        Ok(Self { grid, kernel, mass, points: Points::Compact(points), provenance })
    }

    /// The same points in six bytes each, sorted by place; see [`Compact`]. Takes ten bytes a point more while it works.
    ///
    /// # Errors
    /// [`SamplingError::Cloud`] when there is no memory for it, or the grid has more than 2^22 voxels along an axis.
    pub fn compacted(&self) -> Result<Self, SamplingError> {
        let Points::Single(positions) = &self.points else { return Ok(self.clone()) };
        check_compact(&self.grid)?;
        let dims = self.grid.dims();
        let points = Compact::of(dims, centre_voxel(dims), positions).map_err(SamplingError::Cloud)?;
        Self::of_compact(self.grid.clone(), self.kernel, self.mass, points, self.provenance.clone())
    }

    /// The bricks of a compact cloud.
    pub fn compact(&self) -> Option<&Compact> {
        match &self.points {
            Points::Single(_) => None,
            Points::Compact(points) => Some(points),
        }
    }

    /// Bytes of memory that the points take.
    pub fn bytes(&self) -> u64 {
        match &self.points {
            Points::Single(_) => Self::BYTES_PER_POINT * self.samples(),
            Points::Compact(c) => Compact::BYTES_PER_POINT * c.samples() + size_of_val(c.bricks()) as u64,
        }
    }

    /// Number of points `M`.
    pub fn samples(&self) -> u64 {
        match &self.points {
            Points::Single(positions) => positions[0].len() as u64,
            Points::Compact(points) => points.samples(),
        }
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

    /// x, y and z of all points, in voxels from the centre voxel. Those of a compact cloud are made for the call: 12 bytes a point.
    pub fn positions(&self) -> Cow<'_, [Vec<f32>; 3]> {
        match &self.points {
            Points::Single(positions) => Cow::Borrowed(positions),
            Points::Compact(points) => {
                let centre = centre_voxel(self.grid.dims());
                let mut positions = [vec![], vec![], vec![]];
                points.decoded(|at| (0..3).for_each(|a| positions[a].push((at[a] - f64::from(centre[a])) as f32)));
                Cow::Owned(positions)
            }
        }
    }

    /// World position (mm) of point `index` of a cloud that is not compact.
    ///
    /// # Panics
    /// When there are fewer points, or the cloud is compact.
    pub fn world(&self, index: usize) -> DVec3 {
        let centre = centre_voxel(self.grid.dims());
        let Points::Single(positions) = &self.points else { panic!("points of a compact cloud have no order") };
        let at = |a: usize| f64::from(centre[a]) + f64::from(positions[a][index]);
        self.grid.index_to_world().transform_point3(DVec3::new(at(0), at(1), at(2)))
    }

    /// Hands over the world positions (mm) of all points, in their order.
    pub fn for_each_world(&self, mut each: impl FnMut(DVec3)) {
        let to_world = self.grid.index_to_world();
        let centre = centre_voxel(self.grid.dims());
        match &self.points {
            Points::Single([x, y, z]) => {
                for ((x, y), z) in x.iter().zip(y).zip(z) {
                    let at = [*x, *y, *z].map(f64::from);
                    let [x, y, z] = [0, 1, 2].map(|a: usize| f64::from(centre[a]) + at[a]);
                    each(to_world.transform_point3(DVec3::new(x, y, z)));
                }
            }
            Points::Compact(points) => points.decoded(|at| each(to_world.transform_point3(DVec3::from_array(at)))),
        }
    }
}

/// What all clouds need.
fn check_whole(grid: &Grid, mass: f64) -> Result<(), SamplingError> {
    let dims = grid.dims();
    if !mass.is_finite() || mass <= 0.0 {
        return Err(SamplingError::Cloud(format!("the mass must be positive and finite, got {mass}")));
    }
    if dims.iter().any(|&n| n >= 1 << 31) {
        return Err(SamplingError::Cloud(format!("extents {dims:?} exceed 2^31 - 1 voxels along an axis")));
    }
    Ok(())
}

/// What compact clouds need.
fn check_compact(grid: &Grid) -> Result<(), SamplingError> {
    let dims = grid.dims();
    if dims.iter().any(|&n| n > MOST_VOXELS) {
        return Err(SamplingError::Cloud(format!(
            "extents {dims:?}: a compact cloud has at most {MOST_VOXELS} voxels along an axis; leave it as it is"
        )));
    }
    Ok(())
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
                    let Scratch { points, places, turned, .. } = &mut scratch;
                    points.resize(len);
                    places.iter_mut().for_each(|p| p.resize(len, 0));
                    stream.fill(block as u64, distribution.total(), points);
                    locator.locate(stream.search(), &points.targets, places, turned, &mut counters);
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
    let exposure = Exposure { camera, estimand: options.estimand, samples, mass: cloud.mass, share: 1.0 };
    match &cloud.points {
        Points::Single([x, y, z]) => {
            let projector = projection.stored_projector(options.estimand, level);
            exposure.run(&projection, start, watch, |block, scratch, film, _| {
                let drawn = Instant::now();
                let first = block as usize * BLOCK;
                let range = first..first + scratch.pixels.len();
                let batch = [&x[range.clone()], &y[range.clone()], &z[range]];
                let lost = projector.project(batch, &mut scratch.pixels, &mut scratch.weights);
                film.add(&scratch.pixels, &scratch.weights);
                (lost, drawn)
            })
        }
        Points::Compact(points) => {
            let projector = projection.compact_projector(points.step(), options.estimand, level);
            exposure.run(&projection, start, watch, |block, scratch, film, _| {
                let drawn = Instant::now();
                let first = block * BLOCK as u64;
                let end = first + scratch.pixels.len() as u64;
                let lost = projector.project(points, first..end, &mut scratch.pixels, &mut scratch.weights);
                film.add(&scratch.pixels, &scratch.weights);
                (lost, drawn)
            })
        }
    }
}
