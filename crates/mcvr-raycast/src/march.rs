//! The plain ray march: midpoint samples at a fixed step, the method that people really use (Joseph 1982 and since).

use std::time::Instant;

use mcvr_scene::{Camera, Density, Estimand, Image, Kernel};
use mcvr_volume::{Grid, Voxel, Voxels, with_voxels};
use rayon::prelude::*;
use serde::Serialize;

use crate::average;
use crate::error::check_extents;
use crate::field::{Lifted, Stored, Visit, Weigh, stored_is_weight, with_field};
use crate::packet::{Along, Packets, Plan};
use crate::points::Points;
use crate::sampled::SampledField;
use crate::view::{IndexRay, View};
use crate::{Counters, RaycastError, Watch};

/// How to march.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MarchOptions {
    /// Distance between samples, in units of the smallest voxel spacing.
    pub step: f64,
    /// A comb: the samples of every ray begin at a random phase of their own, which makes the sum along the ray unbiased at any
    /// distance. Without it all begin half a step from where the ray's depth would be 0.
    pub random_phase: bool,
    /// Rays per pixel: 1 is the pixel's centre; a square number the centres of a grid of sub-pixels; other
    /// numbers a lattice with a random shift in every pixel.
    pub rays_per_pixel: u32,
    /// Randomly shifted lattices in every case, which makes the mean over the pixel unbiased.
    pub jitter: bool,
    /// Turns the values at the rays into means over the pixels by the neighbours' values, which leaves about a third of the error of
    /// one ray a pixel and less of more; needs a grid of rays (a square number, no jitter), and is not there with effects.
    pub average: bool,
    /// How weights are spread; not `shell`.
    pub kernel: Kernel,
    /// What a pixel means (METHOD section 2).
    pub estimand: Estimand,
    /// Seed of jitter and phases; random numbers are keyed by it and the pixel.
    pub seed: u64,
}

impl MarchOptions {
    /// Largest `rays_per_pixel`.
    pub const RAYS_LIMIT: u32 = 1 << 20;

    /// Most steps on a ray through the whole grid: seconds for one ray.
    pub const STEPS_LIMIT: u32 = 1 << 24;

    /// # Errors
    /// [`RaycastError::Shell`], [`RaycastError::Step`], [`RaycastError::Steps`], [`RaycastError::Extent`] or [`RaycastError::Rays`].
    pub(crate) fn check(&self, grid: &Grid) -> Result<(), RaycastError> {
        check_extents(grid)?;
        if !self.step.is_finite() || self.step <= 0.0 {
            return Err(RaycastError::Step(self.step));
        }
        let smallest = self.smallest_step(grid);
        if self.step < smallest {
            return Err(RaycastError::Steps { given: self.step, smallest, limit: Self::STEPS_LIMIT });
        }
        if !(1..=Self::RAYS_LIMIT).contains(&self.rays_per_pixel) {
            return Err(RaycastError::Rays { given: self.rays_per_pixel, limit: Self::RAYS_LIMIT });
        }
        if self.average {
            check_grid(self.rays_per_pixel, self.jitter)?;
        }
        if self.kernel == Kernel::Shell { Err(RaycastError::Shell) } else { Ok(()) }
    }

    /// The step that [`Self::STEPS_LIMIT`] leaves for a grid, by the longest way through the support of its samples.
    pub fn smallest_step(&self, grid: &Grid) -> f64 {
        let margin = 2.0 * self.kernel.support() * grid.spacing().element_sum();
        (grid.diameter() + margin) / grid.spacing().min_element() / f64::from(Self::STEPS_LIMIT)
    }
}

impl Default for MarchOptions {
    /// Half-voxel steps through the pixel's centre, `tent`, `line`.
    fn default() -> Self {
        Self {
            step: 0.5,
            random_phase: false,
            rays_per_pixel: 1,
            jitter: false,
            average: false,
            kernel: Kernel::default(),
            estimand: Estimand::default(),
            seed: 0,
        }
    }
}

/// A marched image.
#[derive(Clone, Debug, PartialEq)]
pub struct MarchImage {
    /// The estimand's value for every pixel.
    pub image: Image,
    /// Work done; `evaluations` are steps.
    pub counters: Counters,
    /// Wall time in seconds, preparation included.
    pub seconds: f64,
}

/// Marches rays through the field. Positions and interpolation are `f32` (as on a GPU), sums `f64`. `tent` goes sixteen rays at
/// a time and skips empty bricks; other kernels take every step within the outline of the grid's support. The same image, bit
/// for bit, for any number of threads. `watch` hears of every finished row.
///
/// # Errors
/// [`RaycastError::Shell`], [`RaycastError::Step`], [`RaycastError::Steps`] or [`RaycastError::Rays`] for unusable
/// options, [`RaycastError::Cancelled`] when `watch` said so.
pub fn march(
    density: &Density,
    camera: &Camera,
    options: &MarchOptions,
    watch: &Watch,
) -> Result<MarchImage, RaycastError> {
    let start = Instant::now();
    let grid = density.volume().grid();
    options.check(grid)?;
    if options.average {
        return averaged(camera, options.rays_per_pixel, |camera| {
            march(density, camera, &MarchOptions { average: false, ..*options }, watch)
        });
    }
    let MarchOptions { rays_per_pixel, jitter, random_phase, seed, kernel, estimand, .. } = *options;
    let distance = options.step * grid.spacing().min_element();
    let points = Points::new(rays_per_pixel, jitter, random_phase, seed);
    let plan = Plan { along: Along::Comb(distance), points, estimand };
    let packets = || (kernel == Kernel::Tent).then(|| Packets::new(density).image(camera, &plan, watch)).flatten();
    let one_by_one = || {
        let job = Job { density, camera, options, watch, unit: 1.0, points: &plan.points };
        match (density.volume().voxels(), Lifted::of(density)) {
            (Voxels::U8(voxels), _) if stored_is_weight(density) => job.run(voxels, Stored),
            (voxels, Some((lifted, unit))) => with_voxels!(voxels, v => Job { unit, ..job }.run(v, lifted)),
            _ => with_field(density, job),
        }
    };
    let (image, counters) = packets().unwrap_or_else(one_by_one);
    if watch.cancelled() {
        return Err(RaycastError::Cancelled);
    }
    Ok(MarchImage { image, counters, seconds: start.elapsed().as_secs_f64() })
}

/// # Errors
/// [`RaycastError::Grid`] unless the rays of a pixel are a grid.
pub(crate) fn check_grid(rays: u32, jitter: bool) -> Result<(), RaycastError> {
    if jitter || rays.isqrt().pow(2) != rays { Err(RaycastError::Grid { rays, jitter }) } else { Ok(()) }
}

/// Casts an image with a margin and averages it over the pixels.
pub(crate) fn averaged(
    camera: &Camera,
    rays: u32,
    cast: impl FnOnce(&Camera) -> Result<MarchImage, RaycastError>,
) -> Result<MarchImage, RaycastError> {
    let start = Instant::now();
    let wide = camera.with_margin(average::MARGIN).map_err(|e| RaycastError::Image(e.to_string()))?;
    let MarchImage { image, counters, .. } = cast(&wide)?;
    let image = average::over_pixels(&image, camera, rays.isqrt()).map_err(|e| RaycastError::Image(e.to_string()))?;
    Ok(MarchImage { image, counters, seconds: start.elapsed().as_secs_f64() })
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
        let field = SampledField::new(voxels, weights, grid.dims(), options.kernel);
        let view = View::new(camera, grid, options.estimand, density.mass(), 0.0);
        let squared = view.squared();
        // Millimetres of path between samples.
        let step = options.step * grid.spacing().min_element();
        let share = 1.0 / f64::from(options.rays_per_pixel);
        let mut image = Image::zeros(camera.extent());
        let [x0, x1, y0, y1] = crate::integrator::outline(camera, grid, field.low(), field.high());
        let rows: Vec<Counters> = image
            .values_mut()
            .par_chunks_mut(camera.extent().width)
            .enumerate()
            .with_max_len(1)
            .map(|(y, row)| {
                let mut counters = Counters::default();
                let columns = if (y0..y1).contains(&y) && !watch.cancelled() { x0..x1 } else { 0..0 };
                for x in columns {
                    if watch.cancelled() {
                        break;
                    }
                    let mut sum = 0.0;
                    for ray in 0..points.rays() {
                        let [dx, dy, phase] = points.of(x, y, ray);
                        let (px, py) = (x as f64 + dx, y as f64 + dy);
                        let (ray, factor) = view.ray(px, py);
                        let distance = step * camera.depth_rate(px, py);
                        sum += factor * (unit * cast(&field, &ray, distance, phase, squared, &mut counters));
                    }
                    row[x] = sum * share;
                }
                watch.advance(1);
                counters
            })
            .collect();
        let mut counters = Counters::default();
        rows.into_iter().for_each(|c| counters += c);
        (image, counters)
    }
}

/// `Σ ρ dt` (or `Σ ρ t² dt`) over samples at `t = (n + phase) * distance`.
fn cast<T: Voxel, W: Weigh<T, f32>>(
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
