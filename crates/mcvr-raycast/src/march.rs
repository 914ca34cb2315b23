//! The plain ray march: midpoint samples at a fixed step, the method that people really use (Joseph 1982 and since).

use mcvr_scene::{Camera, Density, Image};
use mcvr_volume::{Grid, Voxel, Voxels, with_voxels};
use serde::Serialize;

use crate::field::{Lifted, Stored, Visit, Weigh, stored_is_weight, with_field};
use crate::packet::Along;
use crate::points::Points;
use crate::rays::cast;
use crate::rows::pixels;
use crate::sampled::SampledField;
use crate::view::{IndexRay, View};
use crate::{Counters, MarchImage, RayOptions, RaycastError, Watch};

/// How to march.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MarchOptions {
    /// Distance between samples, in units of the smallest voxel spacing.
    pub step: f64,
    /// A comb: the samples of every ray begin at a random phase of their own, which makes the sum along the ray unbiased at any
    /// distance. Without it all begin half a step from where the ray's depth would be 0.
    pub random_phase: bool,
    /// Which rays.
    pub rays: RayOptions,
}

impl MarchOptions {
    /// Most steps on a ray through the whole grid: seconds for one ray.
    pub const STEPS_LIMIT: u32 = 1 << 24;

    /// # Errors
    /// [`RaycastError::Step`], [`RaycastError::Steps`], and as [`RayOptions::check`].
    pub(crate) fn check(&self, grid: &Grid) -> Result<(), RaycastError> {
        self.rays.check(grid)?;
        if !self.step.is_finite() || self.step <= 0.0 {
            return Err(RaycastError::Step(self.step));
        }
        let smallest = self.smallest_step(grid);
        if self.step < smallest {
            return Err(RaycastError::Steps { given: self.step, smallest, limit: Self::STEPS_LIMIT });
        }
        Ok(())
    }

    /// The step that [`Self::STEPS_LIMIT`] leaves for a grid, by the longest way through the support of its samples.
    pub fn smallest_step(&self, grid: &Grid) -> f64 {
        let margin = 2.0 * self.rays.kernel.support() * grid.spacing().element_sum();
        (grid.diameter() + margin) / grid.spacing().min_element() / f64::from(Self::STEPS_LIMIT)
    }
}

impl Default for MarchOptions {
    /// Half-voxel steps through the pixel's centre, `tent`, `line`.
    fn default() -> Self {
        RayOptions::default().into()
    }
}

impl From<RayOptions> for MarchOptions {
    /// Half-voxel steps along these rays.
    fn from(rays: RayOptions) -> Self {
        Self { step: 0.5, random_phase: false, rays }
    }
}

/// Marches rays through the field. Positions and interpolation are `f32` (as on a GPU), sums `f64`. `tent` goes sixteen rays at
/// a time and skips empty bricks; other kernels take every step within the outline of the grid's support. The same image, bit
/// for bit, for any number of threads. `watch` hears of every finished row.
///
/// # Errors
/// [`RaycastError::Step`], [`RaycastError::Steps`], and as [`cast_rays`](crate::cast_rays).
pub fn march(
    density: &Density,
    camera: &Camera,
    options: &MarchOptions,
    watch: &Watch,
) -> Result<MarchImage, RaycastError> {
    let grid = density.volume().grid();
    options.check(grid)?;
    let along = Along::Comb(options.step * grid.spacing().min_element());
    cast(density, camera, &options.rays, (along, options.random_phase), watch, |camera, plan| {
        let job = Job { density, camera, options, watch, unit: 1.0, points: &plan.points };
        Ok(match (density.volume().voxels(), Lifted::of(density)) {
            (Voxels::U8(voxels), _) if stored_is_weight(density) => job.run(voxels, Stored),
            (voxels, Some((lifted, unit))) => with_voxels!(voxels, v => Job { unit, ..job }.run(v, lifted)),
            _ => with_field(density, job),
        })
    })
}

struct Job<'a, 'w> {
    density: &'a Density,
    camera: &'w Camera,
    options: &'w MarchOptions,
    watch: &'w Watch<'w>,
    points: &'w Points,
    /// What a weight of 1 stands for.
    unit: f64,
}

impl<'a> Visit<'a, f32> for Job<'a, '_> {
    type Out = (Image, Counters);

    fn run<T: Voxel, W: Weigh<T, f32> + Send + 'a>(self, voxels: &'a [T], weights: W) -> Self::Out {
        let Self { density, camera, options, watch, points, unit } = self;
        let grid = density.volume().grid();
        let rays = &options.rays;
        let field = SampledField::new(voxels, weights, grid.dims(), rays.kernel);
        let view = View::new(camera, grid, rays.estimand, density.mass(), 0.0);
        let squared = view.squared();
        // Millimetres of path between samples.
        let step = options.step * grid.spacing().min_element();
        let share = 1.0 / f64::from(rays.rays_per_pixel);
        let outline = crate::integrator::outline(camera, grid, field.low(), field.high());
        let mut image = Image::zeros(camera.extent());
        let counters = pixels(image.values_mut(), camera, outline, watch, |(), x, y, counters| {
            let mut sum = 0.0;
            for ray in 0..points.rays() {
                let [dx, dy, phase] = points.of(x, y, ray);
                let (px, py) = (x as f64 + dx, y as f64 + dy);
                let (ray, factor) = view.ray(px, py);
                let distance = step * camera.depth_rate(px, py);
                sum += factor * (unit * along(&field, &ray, distance, phase, squared, counters));
            }
            sum * share
        });
        (image, counters)
    }
}

/// `Σ ρ dt` (or `Σ ρ t² dt`) over samples at `t = (n + phase) * distance`.
fn along<T: Voxel, W: Weigh<T, f32>>(
    field: &SampledField<T, W>,
    ray: &IndexRay,
    distance: f64,
    phase: f64,
    squared: bool,
    counters: &mut Counters,
) -> f64 {
    counters.rays += 1;
    let Some((from, to)) = ray.clip(field.low(), field.high()) else { return 0.0 };
    let first = (from / distance - phase).ceil();
    // At most `STEPS_LIMIT` or so, as the options were checked; `as` saturates.
    let steps = ((to / distance - phase).ceil() - first) as u64;
    // The march counts from half a step before its first sample.
    let from = (first + phase - 0.5) * distance;
    distance
        * if squared {
            field.sum::<true>(ray, from, distance, steps, counters)
        } else {
            field.sum::<false>(ray, from, distance, steps, counters)
        }
}
