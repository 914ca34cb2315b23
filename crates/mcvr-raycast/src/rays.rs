//! A few rays a pixel, each integrated exactly.

use std::time::Instant;

use mcvr_scene::{Camera, Density, Estimand, Image, Kernel};
use rayon::prelude::*;
use serde::Serialize;

use crate::error::check_extents;
use crate::integrator::outline;
use crate::march::{averaged, check_grid};
use crate::packet::{Along, Packets, Plan};
use crate::points::Points;
use crate::{Counters, Integrator, MarchImage, MarchOptions, RaycastError, Watch};

/// Which rays to cast.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RayOptions {
    /// Rays per pixel, placed as a [march](MarchOptions::rays_per_pixel)'s.
    pub rays_per_pixel: u32,
    /// Randomly shifted lattices in every case, which makes the image unbiased.
    pub jitter: bool,
    /// Means over the pixels from the neighbours' values, as a [march](MarchOptions::average)'s.
    pub average: bool,
    /// How weights are spread; not `shell`.
    pub kernel: Kernel,
    /// What a pixel means (METHOD section 2).
    pub estimand: Estimand,
    /// Seed of the jitter; random numbers are keyed by it and the pixel.
    pub seed: u64,
}

impl Default for RayOptions {
    /// The pixel's centre, `tent`, `line`.
    fn default() -> Self {
        Self {
            rays_per_pixel: 1,
            jitter: false,
            average: false,
            kernel: Kernel::default(),
            estimand: Estimand::default(),
            seed: 0,
        }
    }
}

/// Casts rays that are integrated exactly, cell by cell: what is left is the error of a pixel's mean by a few points. `tent` goes
/// sixteen rays at a time in `f32` (relative error of a ray about 1e-6) and skips empty bricks; other kernels go ray by ray in
/// `f64`. The same image, bit for bit, for any number of threads. `watch` hears of every finished row.
///
/// # Errors
/// [`RaycastError::Shell`], [`RaycastError::Rays`] or [`RaycastError::Extent`] for unusable options,
/// [`RaycastError::Cancelled`] when `watch` said so.
pub fn cast_rays(
    density: &Density,
    camera: &Camera,
    options: &RayOptions,
    watch: &Watch,
) -> Result<MarchImage, RaycastError> {
    let start = Instant::now();
    let RayOptions { rays_per_pixel, jitter, average, kernel, estimand, seed } = *options;
    check_extents(density.volume().grid())?;
    if !(1..=MarchOptions::RAYS_LIMIT).contains(&rays_per_pixel) {
        return Err(RaycastError::Rays { given: rays_per_pixel, limit: MarchOptions::RAYS_LIMIT });
    }
    if kernel == Kernel::Shell {
        return Err(RaycastError::Shell);
    }
    if average {
        check_grid(rays_per_pixel, jitter)?;
        return averaged(camera, rays_per_pixel, |camera| {
            cast_rays(density, camera, &RayOptions { average: false, ..*options }, watch)
        });
    }
    let plan = Plan { along: Along::Exact, points: Points::new(rays_per_pixel, jitter, false, seed), estimand };
    let packets = (kernel == Kernel::Tent).then(|| Packets::new(density).image(camera, &plan, watch)).flatten();
    let (image, counters) = match packets {
        Some(made) => made,
        None => one_by_one(&Integrator::new(density, kernel)?, camera, &plan, watch),
    };
    if watch.cancelled() {
        return Err(RaycastError::Cancelled);
    }
    Ok(MarchImage { image, counters, seconds: start.elapsed().as_secs_f64() })
}

/// The same rays, each by itself.
fn one_by_one(integrator: &Integrator<'_>, camera: &Camera, plan: &Plan, watch: &Watch) -> (Image, Counters) {
    let rays = integrator.view(camera, plan.estimand);
    let (low, high) = integrator.index_bounds();
    let [x0, x1, y0, y1] = outline(camera, integrator.density().volume().grid(), low, high);
    let share = 1.0 / f64::from(plan.points.rays());
    let mut image = Image::zeros(camera.extent());
    let rows: Vec<Counters> = image
        .values_mut()
        .par_chunks_mut(camera.extent().width)
        .enumerate()
        .with_max_len(1)
        .map(|(y, row)| {
            let mut counters = Counters::default();
            let columns = if (y0..y1).contains(&y) { x0..x1 } else { 0..0 };
            for x in columns {
                if watch.cancelled() {
                    break;
                }
                let mut sum = 0.0;
                for ray in 0..plan.points.rays() {
                    let [dx, dy, _] = plan.points.of(x, y, ray);
                    sum += rays.integrate(x as f64 + dx, y as f64 + dy, &mut counters);
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
