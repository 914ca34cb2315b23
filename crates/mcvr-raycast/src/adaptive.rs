//! Adaptive integration over all pixels of an image, whatever the integrand.

use mcvr_scene::{Camera, Estimand, Kernel};
use mcvr_volume::Grid;
use rayon::prelude::*;

use crate::cubature::{Limits, PixelMean, Rule, Scratch, Total};
use crate::integrator::{coarsest_pixel, outline};
use crate::view::View;
use crate::{Counters, RaycastError, ReferenceOptions, Watch};

/// An estimand's density on the image plane.
pub(crate) trait Integrand<const C: usize>: Sync {
    /// Share of a pixel's tolerance that goes to the error along the rays; 0 where there is none.
    fn ray_share(&self) -> f64;

    /// Values at an image point with estimates of their errors, which should not exceed `tolerance` (in the same
    /// unit, positive; infinite for a first impression).
    fn at(&self, px: f64, py: f64, tolerance: f64, counters: &mut Counters) -> ([f64; C], [f64; C]);
}

/// What is to be integrated over, and how well.
pub(crate) struct Task<'a, 'w> {
    pub camera: &'a Camera,
    pub grid: &'a Grid,
    pub view: &'a View,
    /// The box around all density, in index coordinates.
    pub bounds: ([f64; 3], [f64; 3]),
    pub options: &'a ReferenceOptions,
    /// Sum of all pixels of one channel to assume when every ray of the first pass comes back with 0.
    pub fallback: f64,
    pub watch: &'a Watch<'w>,
}

/// Pixel means and their errors, row by row.
pub(crate) struct Pixels<const C: usize> {
    pub values: Vec<[f64; C]>,
    pub errors: Vec<[f64; C]>,
    /// Tolerance in the image's unit.
    pub tolerance: f64,
    pub depth_limited: u64,
    pub counters: Counters,
}

impl ReferenceOptions {
    /// # Errors
    /// [`RaycastError::Shell`], [`RaycastError::Tolerance`] or [`RaycastError::Depth`].
    pub(crate) fn check(&self) -> Result<(), RaycastError> {
        if !self.tolerance.is_finite() || self.tolerance <= 0.0 {
            return Err(RaycastError::Tolerance(self.tolerance));
        }
        if self.max_depth > Self::DEPTH_LIMIT {
            return Err(RaycastError::Depth { given: self.max_depth, limit: Self::DEPTH_LIMIT });
        }
        if self.kernel == Kernel::Shell { Err(RaycastError::Shell) } else { Ok(()) }
    }
}

impl Task<'_, '_> {
    /// Integrates over every pixel that the box can reach. Rows are computed in parallel, each pixel in a fixed order.
    ///
    /// # Errors
    /// [`RaycastError::Cancelled`].
    pub fn run<const C: usize, I: Integrand<C>>(&self, integrand: &I) -> Result<Pixels<C>, RaycastError> {
        let (camera, watch) = (self.camera, self.watch);
        let [x0, x1, y0, y1] = outline(camera, self.grid, self.bounds.0, self.bounds.1);
        let (width, pixels) = (camera.extent().width, camera.extent().pixels());

        let mut counters = Counters::default();
        let mean = self.mean(integrand, [x0, x1, y0, y1], &mut counters);
        let rule = if self.options.kernel == Kernel::Box { Rule::Jumps } else { Rule::Continuous };
        let tolerance = self.options.tolerance * mean;
        let share = integrand.ray_share();
        let along = share * tolerance;
        let limits = Limits {
            tolerance: tolerance * (1.0 - share),
            base: self.base_depth().min(self.options.max_depth),
            depth: self.options.max_depth,
            total: if share > 0.0 && rule == Rule::Continuous { Total::Spread } else { Total::Sum },
        };

        let mut values = vec![[0.0; C]; pixels];
        let mut errors = values.clone();
        let rows: Vec<(u64, Counters)> = values
            .par_chunks_mut(width)
            .zip(errors.par_chunks_mut(width))
            .enumerate()
            .with_max_len(1)
            .map_init(Scratch::default, |scratch, (y, (row, row_error))| {
                let mut counters = Counters::default();
                let mut limited = 0;
                let columns = if (y0..y1).contains(&y) { x0..x1 } else { 0..0 };
                for x in columns {
                    if watch.cancelled() {
                        break;
                    }
                    // The largest error along a ray bounds that of their mean (all weights are positive).
                    let mut worst = [0.0f64; C];
                    let ray = |px: f64, py: f64| {
                        let (values, errors) = integrand.at(px, py, along, &mut counters);
                        for (worst, e) in worst.iter_mut().zip(errors) {
                            *worst = worst.max(e);
                        }
                        values
                    };
                    let mean: PixelMean<C> = rule.pixel_mean(ray, (x as f64, y as f64), limits, scratch);
                    row[x] = mean.value;
                    row_error[x] = std::array::from_fn(|c| mean.error[c] + worst[c]);
                    limited += u64::from(mean.limited || worst.iter().any(|w| *w > along));
                }
                watch.advance(1);
                (limited, counters)
            })
            .collect();
        if watch.cancelled() {
            return Err(RaycastError::Cancelled);
        }
        let mut depth_limited = 0;
        for (limited, c) in rows {
            depth_limited += limited;
            counters += c;
        }
        Ok(Pixels { values, errors, tolerance, depth_limited, counters })
    }

    /// The image's mean pixel, over all channels, by one ray per pixel.
    fn mean<const C: usize, I: Integrand<C>>(
        &self,
        integrand: &I,
        [x0, x1, y0, y1]: [usize; 4],
        counters: &mut Counters,
    ) -> f64 {
        let centres: Vec<([f64; C], Counters)> = (y0..y1)
            .into_par_iter()
            .map(|y| {
                let mut counters = Counters::default();
                let columns = if self.watch.cancelled() { x0..x0 } else { x0..x1 };
                let mut sum = [0.0; C];
                for x in columns {
                    let (v, _) = integrand.at(x as f64 + 0.5, y as f64 + 0.5, f64::INFINITY, &mut counters);
                    sum.iter_mut().zip(v).for_each(|(s, v)| *s += v);
                }
                (sum, counters)
            })
            .collect();
        let mut sum = [0.0; C];
        for (row, c) in &centres {
            sum.iter_mut().zip(row).for_each(|(s, v)| *s += v);
            *counters += *c;
        }
        let sum = sum.iter().sum::<f64>() / C as f64;
        let pixels = self.camera.extent().pixels() as f64;
        // Centre rays can all miss a small volume.
        if sum > 0.0 { sum / pixels } else { self.fallback / pixels }
    }

    /// Halvings before the first estimate, so that nothing that the grid can hold slips between the points unseen.
    ///
    /// No square is wider than two voxels: 5×5 points lie half a voxel apart. `box` needs more: its image is full of
    /// kinks that meet at voxel corners, and a corner of size δ between the points hides an error of the order of δ³.
    /// So there squares shrink from one voxel at a tolerance of 1e-3 with the cube root of the tolerance.
    fn base_depth(&self) -> u32 {
        let ReferenceOptions { kernel, tolerance, .. } = *self.options;
        let widest = if kernel == Kernel::Box { (tolerance * 1e3).cbrt().min(1.0) } else { 2.0 };
        let (low, high) = self.bounds;
        let ratio = coarsest_pixel(self.camera, self.grid, self.view, low, high) / widest;
        if ratio > 1.0 { ratio.log2().ceil().min(16.0) as u32 } else { 0 }
    }
}

/// Sum of all pixels when the image holds the whole volume: 1 for `count`; for `line` as if all mass were at the
/// grid's centre.
pub(crate) fn whole_sum(density: &mcvr_scene::Density, camera: &Camera, estimand: Estimand) -> f64 {
    let (px, py, z) = camera.project(density.volume().grid().centre());
    match estimand {
        Estimand::Count => 1.0,
        Estimand::Line => density.mass() * camera.line_factor(px, py, z.max(camera.near())),
    }
}
