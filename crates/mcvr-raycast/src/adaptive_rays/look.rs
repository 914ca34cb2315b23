//! A first look at an image, which its first rays are: what finer combs show of some of them tells the errors along the rays, and
//! how the first values bend tells where more rays will be needed.

use std::time::Instant;

use mcvr_scene::{Camera, Density, Estimand, Watch};
use rand::RngExt;
use rand_pcg::Pcg64Dxsm;
use serde::Serialize;

use super::raster::Raster;
use super::{AdaptiveImage, AdaptiveOptions, Comb, Rounds, Scene, finished, wide};
use crate::draw::draw;
use crate::packet::{Cast, LANES, Look, Packets, Square};
use crate::points::Points;
use crate::{Counters, RaycastError};

/// How to look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LookOptions<'a> {
    /// Distance between samples of the first rays, one for 4 by 4 pixels, in units of the smallest voxel spacing.
    pub first: f64,
    /// Other distances whose errors are to be told.
    pub others: &'a [f64],
    /// The distance whose sums are taken for true; `None` for exact rays.
    pub truth: Option<f64>,
    /// Squares of 4 by 4 first rays on which distances are compared.
    pub squares: usize,
    /// What a pixel means (METHOD section 2).
    pub estimand: Estimand,
    /// Seed of the phases, and of the choice of squares.
    pub seed: u64,
}

/// What a look found out. Errors are RMSE over the whole image, as shares of its mean pixel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pilot {
    /// Distance between samples of the first rays.
    pub first: f64,
    /// First rays that can meet density, one for 4 by 4 pixels.
    pub rays: u64,
    /// First rays on which distances were compared.
    pub looked_at: u64,
    /// Pixels of the image.
    pub pixels: u64,
    /// Mean pixel.
    pub mean: f64,
    /// Error that one ray for 4 by 4 pixels is expected to leave.
    pub left: f64,
    /// The squared errors that are expected of it in squares of 8 by 8 pixels, which add up to the square of `left`.
    #[serde(skip)]
    pub lefts: Vec<f64>,
    /// Distance of a comb's samples in units of the smallest voxel spacing, and the error along single rays that it leaves.
    pub combs: Vec<(f64, f64)>,
    /// Variance of the first rays as a share of what twice the distance would add: [`Comb::noise`].
    pub noise: f64,
    /// Samples at a distance of 1 a ray that can meet density.
    pub steps: f64,
    /// Work of the look, the first rays included.
    pub counters: Counters,
}

/// Looks at an image, and goes on as `judge` says by what was found: with adaptive rays, of which those of the look are the first where
/// [`coarsest`](AdaptiveOptions::coarsest) and [`first`](AdaptiveOptions::first) are the look's, or not at all. `None` where rays are not cast
/// in packets. The same numbers for any number of threads; the image is that of [`cast_adaptive_rays`](crate::cast_adaptive_rays).
///
/// # Errors
/// As [`cast_adaptive_rays`](crate::cast_adaptive_rays).
pub fn look_and_cast(
    density: &Density,
    camera: &Camera,
    options: &LookOptions<'_>,
    judge: &dyn Fn(&Pilot) -> Option<AdaptiveOptions>,
    watch: &Watch,
) -> Result<Option<(Pilot, Option<AdaptiveImage>)>, RaycastError> {
    let start = Instant::now();
    let LookOptions { first, estimand, seed, .. } = *options;
    // What rays see by turns stays as it is until the noise is known.
    let comb = Some(Comb { step: first, noise: 1.0 });
    let of_first = AdaptiveOptions { comb, estimand, seed, ..AdaptiveOptions::default() };
    of_first.check(density)?;
    let wide = wide(camera)?;
    let looking = Looking { options, of_first, judge, density, scene: Scene::new(density, camera, watch) };
    match Packets::new(density).look(&wide, estimand, watch, looking) {
        None => Ok(None),
        Some(_) if watch.cancelled() => Err(RaycastError::Cancelled),
        Some(Err(e)) => Err(e),
        Some(Ok((pilot, None))) => Ok(Some((pilot, None))),
        Some(Ok((pilot, Some(made)))) => Ok(Some((pilot, Some(finished(made, camera, watch, start)?)))),
    }
}

struct Looking<'a> {
    options: &'a LookOptions<'a>,
    of_first: AdaptiveOptions,
    judge: &'a dyn Fn(&Pilot) -> Option<AdaptiveOptions>,
    density: &'a Density,
    scene: Scene<'a>,
}

impl Pilot {
    /// By what factor means over pixels have less of the rays' noise than single rays: 0.81 with a ray a pixel, 0.89 with one for 4 by 4.
    pub const SMOOTHING: f64 = 0.87;
}

impl Look for Looking<'_> {
    type Out = Result<(Pilot, Option<AdaptiveImage>), RaycastError>;

    fn run(self, full: &[(usize, usize)], cast: &dyn Cast) -> Self::Out {
        let mut rounds = Rounds::new(self.of_first, self.scene, cast);
        let (mut raster, squares) = rounds.first(full);
        let (pilot, expected) = self.pilot(&mut rounds, &mut raster, &squares);
        let Some(options) = (self.judge)(&pilot) else { return Ok((pilot, None)) };
        options.check(self.density)?;
        let first = Some(Comb { step: pilot.first, noise: pilot.noise });
        let same = (options.coarsest, options.first.or(options.comb), options.estimand, options.seed)
            == (self.of_first.coarsest, first, self.of_first.estimand, self.of_first.seed);
        let made = if same {
            Rounds { options, ..rounds }.rest(raster, squares, Some(expected))
        } else {
            let mut rounds = Rounds { options, rays: vec![], ..rounds };
            let (raster, squares) = rounds.first(full);
            rounds.rest(raster, squares, None)
        };
        Ok((pilot, Some(made)))
    }
}

impl Looking<'_> {
    fn pilot(&self, rounds: &mut Rounds<'_>, raster: &mut Raster, squares: &[Square]) -> (Pilot, Vec<f64>) {
        let LookOptions { first, others, truth, squares: number, seed, .. } = *self.options;
        let rays = rounds.counters.rays;
        let steps = rounds.counters.evaluations as f64 * first / rays.max(1) as f64;
        // More where it is bright: noise rises with what a ray meets.
        let brightness: Vec<f64> = squares.iter().map(|at| raster.sum_of_square(*at).max(0.0)).collect();
        let whole = brightness.iter().sum::<f64>();
        let even = 1.0 / brightness.len().max(1) as f64;
        let shares: Vec<f64> =
            brightness.iter().map(|b| if whole > 0.0 { 0.2 * even + 0.8 * b / whole } else { even }).collect();
        let mut random = Pcg64Dxsm::new(u128::from(seed), 0x7069_6c6f);
        let (chosen, weights) = draw(&shares, number.min(squares.len()), random.random());
        let at: Vec<Square> = chosen.iter().map(|n| squares[*n]).collect();
        let mut values = |step: Option<f64>, n: u64| -> Vec<[f64; LANES]> {
            let along = rounds.scene.along(step.map(Comb::new));
            let points = Points::new(1, false, step.is_some(), seed.wrapping_add(n << 32));
            let (seen, work) = rounds.cast.squares(along, 4.0, &points, &at);
            rounds.counters += work;
            seen.iter().map(|s| s.values).collect()
        };
        let truth = values(truth, 1);
        let pixels = self.scene.extent.pixels() as f64;
        // A square's share of the image: those at its rim are taken for whole.
        let area = (4 * 4 * LANES) as f64 / pixels;
        let unit = rounds.mean * rounds.mean;
        // What rays saw by turns is known at all squares: those that were drawn stand for more, or less.
        let turns = |at: &Square| raster.noise_at(*at);
        let (all, drawn) =
            (squares.iter().map(turns).sum::<f64>(), at.iter().zip(&weights).map(|(at, w)| w * turns(at)));
        let drawn = drawn.sum::<f64>();
        let area = if drawn > 0.0 { area * all / drawn } else { area };
        let error = |values: &[[f64; LANES]]| {
            let square = |(v, t): (&[f64; LANES], &[f64; LANES])| {
                v.iter().zip(t).map(|(v, t)| (v - t) * (v - t)).sum::<f64>() / LANES as f64
            };
            let sum = values.iter().zip(&truth).zip(&weights).map(|(v, w)| w * square(v)).sum::<f64>();
            if unit > 0.0 { (area * sum / unit).sqrt() } else { 0.0 }
        };
        let own: Vec<[f64; LANES]> = at.iter().map(|at| raster.square(*at)).collect();
        let mut combs = vec![(first, error(&own))];
        combs.extend(others.iter().enumerate().map(|(n, d)| (*d, error(&values(Some(*d), n as u64 + 2)))));
        combs.sort_by(|a, b| a.0.total_cmp(&b.0));
        // What the first rays' noise looks like is no error between them.
        let noise = if all > 0.0 { error(&own).powi(2) * unit * pixels / ((4 * 4 * LANES) as f64 * all) } else { 0.0 };
        raster.scale_noise(noise);
        let candidates = rounds.children(squares, 8);
        let expected = rounds.expected(&*raster, &candidates, 4);
        let all = rounds.unit();
        let lefts: Vec<f64> = expected.iter().map(|e| if all > 0.0 { e / all } else { 0.0 }).collect();
        let pilot = Pilot {
            first,
            rays,
            looked_at: (at.len() * LANES) as u64,
            pixels: pixels as u64,
            mean: rounds.mean,
            left: lefts.iter().sum::<f64>().sqrt(),
            lefts,
            combs,
            noise,
            steps,
            counters: rounds.counters,
        };
        (pilot, expected)
    }
}
