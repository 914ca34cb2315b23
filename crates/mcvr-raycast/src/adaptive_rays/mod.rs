//! Rays where an image needs them: few where it is smooth, many where it bends.
//!
//! One ray for a block of 4 by 4 pixels is cast first. Where the fourth differences of what they saw say that the polynomials through
//! them err most, rays of half the distance follow, and so on down to parts of a pixel. How far expected errors are from true ones is
//! seen wherever finer rays were cast, and puts the rest right. It ends when what is expected to be left is no more than asked for.
//! As long as no ray has seen anything, all places are given closer ones, down to a ray a pixel.
//!
//! M. Levoy, *Volume rendering by adaptive refinement*, The Visual Computer 6, 1990, places rays so by the differences of neighbours.
//! Of all ways to leave a given sum of squared errors, the one with the fewest rays has the same expected gain of every ray: at each
//! distance the places with the largest errors are given rays, every square of 4 by 4 rays costing the same.

mod dark;
mod look;
mod needs;
mod raster;
mod rounds;
mod within;

use std::time::Instant;

use mcvr_scene::{Camera, Density, Estimand, Extent, Watch};
use serde::Serialize;

use crate::packet::{Along, Cast, Look, Packets};
use crate::{MarchImage, MarchOptions, RayOptions, RaycastError};
use dark::Dark;
pub use look::{Glance, LookOptions, Pilot, Tried, look_and_cast};
use rounds::Rounds;

/// Samples at even distances along rays, with a random phase for every ray.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Comb {
    /// Distance between samples, in units of the smallest voxel spacing.
    pub step: f64,
    /// Variance of a sum as a share of what twice the distance would add to it, which is seen at every ray: 1/3 where errors rise
    /// as the distance, 1/7 as its power of 3/2, 1/15 as its square. So much is not taken for an error between rays.
    pub noise: f64,
}

impl Comb {
    /// [`noise`](Self::noise) where it is not known.
    pub const NOISE: f64 = 0.25;

    /// Samples at a distance.
    pub fn new(step: f64) -> Self {
        Self { step, noise: Self::NOISE }
    }

    /// The noise where errors rise by a power of the distance.
    pub fn noise_of(power: f64) -> f64 {
        1.0 / (4f64.powf(power) - 1.0)
    }
}

/// How to cast rays where they are needed. `tent`, without effects.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AdaptiveOptions {
    /// Samples along rays; `None` integrates rays exactly.
    pub comb: Option<Comb>,
    /// The same of the first rays, where it differs.
    pub first: Option<Comb>,
    /// The error that may be left between the rays: RMSE over the mean pixel. That along the rays comes on top.
    pub left: f64,
    /// Pixels along the side of the blocks that share a ray at first: 4, 2 or 1.
    pub coarsest: u32,
    /// What a pixel means (METHOD section 2).
    pub estimand: Estimand,
    /// Seed of the phases.
    pub seed: u64,
}

impl Default for AdaptiveOptions {
    /// Exact rays that leave 1 %.
    fn default() -> Self {
        Self { comb: None, first: None, left: 0.01, coarsest: 4, estimand: Estimand::default(), seed: 0 }
    }
}

/// An image by rays where it needed them.
#[derive(Clone, Debug, PartialEq)]
pub struct AdaptiveImage {
    /// The image, and all work. Samples of the comb or cells count as `evaluations` and `cells`.
    pub made: MarchImage,
    /// The error that is expected to be left between the rays: RMSE over the mean pixel. More than was asked for where
    /// [`RAYS_LIMIT`](AdaptiveOptions::RAYS_LIMIT) rays a pixel do not suffice.
    pub left: f64,
    /// The error that the first rays alone were expected to leave, by how their values bend.
    pub expected: f64,
    /// Rays at each distance, in pixels, those of dark places not counted.
    pub rays: Vec<(f64, u64)>,
}

impl AdaptiveOptions {
    /// Most rays in a pixel.
    pub const RAYS_LIMIT: u32 = FINEST * FINEST;

    fn check(&self, density: &Density) -> Result<(), RaycastError> {
        let grid = density.volume().grid();
        let rays = RayOptions { estimand: self.estimand, seed: self.seed, ..RayOptions::default() };
        rays.check(grid)?;
        for Comb { step, noise } in [self.comb, self.first].into_iter().flatten() {
            MarchOptions { step, random_phase: true, rays }.check(grid)?;
            if !(noise >= 0.0 && noise.is_finite()) {
                return Err(RaycastError::Noise(noise));
            }
        }
        if !(self.left > 0.0 && self.left.is_finite()) {
            return Err(RaycastError::Left(self.left));
        }
        if ![1, 2, 4].contains(&self.coarsest) {
            return Err(RaycastError::Coarsest(self.coarsest));
        }
        Ok(())
    }
}

/// Casts rays where an image needs them; see the [options](AdaptiveOptions). The same image, bit for bit, for any number of threads and on
/// any vector instructions. `watch` hears of all rows at the end.
///
/// # Errors
/// [`RaycastError::Left`], [`RaycastError::Coarsest`], [`RaycastError::Step`], [`RaycastError::Steps`] or [`RaycastError::Extent`] for unusable
/// options, [`RaycastError::Packets`] for a density that is not cast sixteen rays at a time, [`RaycastError::Image`] for an image that is too
/// large, [`RaycastError::Cancelled`] when `watch` said so.
pub fn cast_adaptive_rays(
    density: &Density,
    camera: &Camera,
    options: &AdaptiveOptions,
    watch: &Watch,
) -> Result<AdaptiveImage, RaycastError> {
    let start = Instant::now();
    options.check(density)?;
    let wide = wide(camera)?;
    let spread = Spread { options, scene: Scene::new(density, camera, watch) };
    let made = Packets::new(density).look(&wide, options.estimand, watch, spread).ok_or(RaycastError::Packets)?;
    finished(made, camera, watch, start)
}

/// Whether adaptive rays serve a density: those of `tent` that are cast sixteen at a time.
pub fn serves_adaptive_rays(density: &Density) -> bool {
    Packets::new(density).serve()
}

/// A camera with the margin in which rays are cast.
fn wide(camera: &Camera) -> Result<Camera, RaycastError> {
    camera.in_blocks(1, MARGIN).map_err(|e| RaycastError::Image(e.to_string()))
}

/// Tells the watch of an image, and the image of its time.
fn finished(
    made: AdaptiveImage,
    camera: &Camera,
    watch: &Watch,
    start: Instant,
) -> Result<AdaptiveImage, RaycastError> {
    if watch.cancelled() {
        return Err(RaycastError::Cancelled);
    }
    watch.advance(camera.extent().height as u64);
    Ok(AdaptiveImage { made: MarchImage { seconds: start.elapsed().as_secs_f64(), ..made.made }, ..made })
}

/// Pixels around the image in which rays are cast: a square of rays of the widest distance.
const MARGIN: usize = 16;

/// Most rays along a pixel's side.
const FINEST: u32 = 8;

/// What is the same for all rays of an image.
#[derive(Clone, Copy)]
struct Scene<'a> {
    extent: Extent,
    /// Smallest voxel spacing.
    spacing: f64,
    watch: &'a Watch<'a>,
}

impl<'a> Scene<'a> {
    fn new(density: &Density, camera: &Camera, watch: &'a Watch<'a>) -> Self {
        Self { extent: camera.extent(), spacing: density.volume().grid().spacing().min_element(), watch }
    }

    fn along(&self, comb: Option<Comb>) -> Along {
        comb.map_or(Along::Exact, |comb| Along::Comb(comb.step * self.spacing))
    }
}

/// Casts an image in rounds.
struct Spread<'a> {
    options: &'a AdaptiveOptions,
    scene: Scene<'a>,
}

impl Look for Spread<'_> {
    type Out = AdaptiveImage;

    fn run(self, full: &[(usize, usize)], cast: &dyn Cast) -> AdaptiveImage {
        let dark = Dark::beside(full, self.scene.extent);
        let mut rounds = Rounds::new(*self.options, self.scene, cast, &dark);
        let squares = rounds.places();
        let raster = rounds.first(&squares);
        rounds.rest(raster, squares, None)
    }
}
