//! A few rays a pixel, each integrated exactly.

use std::time::Instant;

use mcvr_scene::{Camera, Density, Estimand, Image, Kernel};
use mcvr_volume::Grid;
use serde::Serialize;

use crate::average::{self, Rays};
use crate::error::check_extents;
use crate::integrator::outline;
use crate::packet::{Along, Packets, Plan};
use crate::points::Points;
use crate::rows::pixels;
use crate::{Counters, Integrator, RaycastError, Watch};

/// Which rays to cast.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RayOptions {
    /// Rays per pixel: 1 is the pixel's centre; a square number the centres of a grid of sub-pixels; other
    /// numbers are jittered as [`Self::jitter`].
    pub rays_per_pixel: u32,
    /// A random point in each of as many strata of the pixel as there are rays, which makes the mean over the pixel unbiased.
    pub jitter: bool,
    /// Turns the values at the rays into means over the pixels by the neighbours' values, which leaves about a third of the error of
    /// one ray a pixel and less of more; needs a grid of rays (a square number, no jitter), and is not there with effects. Beside
    /// bright edges a value may come out a little below 0.
    pub average: bool,
    /// Pixels along the side of a block that shares one ray: 1 for rays in every pixel. More of them need `average` and one ray a
    /// pixel (of the block), and serve images that are smooth at that scale.
    pub block: u32,
    /// How weights are spread; not `shell`.
    pub kernel: Kernel,
    /// What a pixel means (METHOD section 2).
    pub estimand: Estimand,
    /// Seed of jitter and phases; random numbers are keyed by it and the pixel.
    pub seed: u64,
}

impl RayOptions {
    /// Largest `rays_per_pixel`.
    pub const RAYS_LIMIT: u32 = 1 << 20;

    /// Largest `block`.
    pub const BLOCK_LIMIT: u32 = 8;

    /// # Errors
    /// [`RaycastError::Shell`], [`RaycastError::Extent`], [`RaycastError::Rays`], [`RaycastError::Grid`] or [`RaycastError::Block`].
    pub(crate) fn check(&self, grid: &Grid) -> Result<(), RaycastError> {
        check_extents(grid)?;
        let Self { rays_per_pixel: rays, jitter, average, block, kernel, .. } = *self;
        if !(1..=Self::RAYS_LIMIT).contains(&rays) {
            return Err(RaycastError::Rays { given: rays, limit: Self::RAYS_LIMIT });
        }
        if average && (jitter || rays.isqrt().pow(2) != rays) {
            return Err(RaycastError::Grid { rays, jitter });
        }
        if !(1..=Self::BLOCK_LIMIT).contains(&block) || block > 1 && (rays != 1 || !average) {
            return Err(RaycastError::Block { given: block, limit: Self::BLOCK_LIMIT });
        }
        if kernel == Kernel::Shell { Err(RaycastError::Shell) } else { Ok(()) }
    }
}

impl Default for RayOptions {
    /// The pixel's centre, `tent`, `line`.
    fn default() -> Self {
        Self {
            rays_per_pixel: 1,
            jitter: false,
            average: false,
            block: 1,
            kernel: Kernel::default(),
            estimand: Estimand::default(),
            seed: 0,
        }
    }
}

/// An image made by rays.
#[derive(Clone, Debug, PartialEq)]
pub struct MarchImage {
    /// The estimand's value for every pixel.
    pub image: Image,
    /// Work done; `evaluations` are steps or cells.
    pub counters: Counters,
    /// Wall time in seconds, preparation included.
    pub seconds: f64,
}

/// Casts rays that are integrated exactly, cell by cell: what is left is the error of a pixel's mean by a few points. `tent` goes
/// sixteen rays at a time in `f32` (relative error of a ray about 1e-6) and skips empty bricks; other kernels go ray by ray in
/// `f64`. The same image, bit for bit, for any number of threads. `watch` hears of every finished row.
///
/// # Errors
/// [`RaycastError::Shell`], [`RaycastError::Rays`], [`RaycastError::Grid`] or [`RaycastError::Extent`] for unusable options,
/// [`RaycastError::Cancelled`] when `watch` said so.
pub fn cast_rays(
    density: &Density,
    camera: &Camera,
    options: &RayOptions,
    watch: &Watch,
) -> Result<MarchImage, RaycastError> {
    options.check(density.volume().grid())?;
    cast(density, camera, options, (Along::Exact, false), watch, |camera, plan| {
        Ok(one_by_one(&Integrator::new(density, options.kernel)?, camera, plan, watch))
    })
}

/// Casts rays of checked options: in packets where those can, else `one_by_one`; with a margin where pixels are averaged.
pub(crate) fn cast(
    density: &Density,
    camera: &Camera,
    options: &RayOptions,
    (along, random_phase): (Along, bool),
    watch: &Watch,
    one_by_one: impl FnOnce(&Camera, &Plan) -> Result<(Image, Counters), RaycastError>,
) -> Result<MarchImage, RaycastError> {
    let start = Instant::now();
    let RayOptions { rays_per_pixel, jitter, average, block, kernel, estimand, seed } = *options;
    let too_large = |e: mcvr_scene::SceneError| RaycastError::Image(e.to_string());
    let wide = if average { Some(camera.in_blocks(block, average::MARGIN).map_err(too_large)?) } else { None };
    let seen = wide.as_ref().unwrap_or(camera);
    let plan = Plan { along, points: Points::new(rays_per_pixel, jitter, random_phase, seed), estimand };
    let packets = (kernel == Kernel::Tent).then(|| Packets::new(density).image(seen, &plan, watch)).flatten();
    let (mut image, counters) = match packets {
        Some(made) => made,
        None => one_by_one(seen, &plan)?,
    };
    if watch.cancelled() {
        return Err(RaycastError::Cancelled);
    }
    if average {
        let rays = if block > 1 { Rays::Block(block) } else { Rays::Grid(rays_per_pixel.isqrt()) };
        // A block's share of the samples is that of all its pixels.
        let share = if estimand == Estimand::Count { f64::from(block * block).recip() } else { 1.0 };
        image = average::over_pixels(&image, camera, rays, share).map_err(too_large)?;
    }
    Ok(MarchImage { image, counters, seconds: start.elapsed().as_secs_f64() })
}

/// The same rays, each by itself.
fn one_by_one(integrator: &Integrator<'_>, camera: &Camera, plan: &Plan, watch: &Watch) -> (Image, Counters) {
    let rays = integrator.view(camera, plan.estimand);
    let (low, high) = integrator.index_bounds();
    let outline = outline(camera, integrator.density().volume().grid(), low, high);
    let share = 1.0 / f64::from(plan.points.rays());
    let mut image = Image::zeros(camera.extent());
    let counters = pixels(image.values_mut(), camera, outline, watch, |(), x, y, counters| {
        let mut sum = 0.0;
        for ray in 0..plan.points.rays() {
            let [dx, dy, _] = plan.points.of(x, y, ray);
            sum += rays.integrate(x as f64 + dx, y as f64 + dy, counters);
        }
        sum * share
    });
    (image, counters)
}
