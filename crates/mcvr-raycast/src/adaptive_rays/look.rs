//! A first look at an image, which its first rays are: what finer combs show of some of them tells the errors along the rays, and
//! how the first values bend tells where more rays will be needed.

use std::time::Instant;

use mcvr_scene::{Camera, Density, Estimand, Watch};
use rand::RngExt;
use rand_pcg::Pcg64Dxsm;
use serde::Serialize;

use super::dark::Dark;
use super::raster::Raster;
use super::rounds::Rounds;
use super::{AdaptiveImage, AdaptiveOptions, Comb, Scene, finished, wide};
use crate::draw::draw;
use crate::packet::{Cast, LANES, Look, Packets, Seen, Square};
use crate::points::Points;
use crate::{Counters, RaycastError};

/// How to look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LookOptions<'a> {
    /// The error that single rays should have, RMSE over the mean pixel: the first rays' distance is set for it.
    pub wanted: f64,
    /// A comb to begin with, and the noise that it usually has: the first rays' distance lies within [`LookOptions::RANGE`] of its own.
    pub first: Comb,
    /// Other distances whose errors are to be told, in units of the first rays'.
    pub others: &'a [f64],
    /// The distance whose sums are taken for true, in units of the first rays'; `None` for exact rays.
    pub truth: Option<f64>,
    /// Squares of 4 by 4 first rays on which distances are compared.
    pub squares: usize,
    /// What a pixel means (METHOD section 2).
    pub estimand: Estimand,
    /// Seed of the phases, and of the choice of squares.
    pub seed: u64,
}

impl LookOptions<'_> {
    /// Least and greatest distance between samples of the first rays, in units of what they begin with.
    pub const RANGE: [f64; 2] = [0.3, 2.5];
}

/// Squares of 16 rays by which the first rays' distance is set.
const GLANCE: usize = 16;

/// Fewest samples of the first rays whose distance is more than [`STRETCH`] times what they begin with.
const FEWEST: f64 = 4.0;
const STRETCH: f64 = 1.5;

/// Closer samples than this, in voxels, take longer than exact rays.
const CLOSEST: f64 = 0.5;

/// What is known before the first rays are cast.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Glance {
    /// First rays, one for 4 by 4 pixels, that can meet density.
    pub rays: u64,
    /// Samples at a distance of 1 a ray, of some of them.
    pub steps: f64,
    /// Their distance for the error that is wanted.
    pub first: f64,
    /// Work of the glance; a look's holds it too.
    pub counters: Counters,
}

/// A comb, and the error along single rays that it leaves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Tried {
    /// Samples, and how noisy they are.
    pub comb: Comb,
    /// RMSE over the mean pixel.
    pub error: f64,
}

/// What a look found out. Errors are RMSE over the whole image, as shares of its mean pixel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pilot {
    /// Samples of the first rays.
    pub first: Comb,
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
    /// The combs that were tried, that of the first rays among them, closest first.
    pub combs: Vec<Tried>,
    /// Samples at a distance of 1 a ray that can meet density.
    pub steps: f64,
    /// Work of the look, the first rays included.
    pub counters: Counters,
}

/// Looks at an image where `begin` says so after a glance, and goes on as `judge` says by what was found: with adaptive rays, of which those of
/// the look are the first where [`coarsest`](AdaptiveOptions::coarsest) and [`first`](AdaptiveOptions::first) are the look's, or no further.
/// `None` where it was not looked, or rays are not cast in packets. The same numbers for any number of threads; the image is that of
/// [`cast_adaptive_rays`](crate::cast_adaptive_rays).
///
/// # Errors
/// As [`cast_adaptive_rays`](crate::cast_adaptive_rays); [`RaycastError::Left`] for an unusable [`LookOptions::wanted`], too.
pub fn look_and_cast(
    density: &Density,
    camera: &Camera,
    options: &LookOptions<'_>,
    begin: &dyn Fn(&Glance) -> bool,
    judge: &dyn Fn(&Pilot) -> Option<AdaptiveOptions>,
    watch: &Watch,
) -> Result<Option<(Pilot, Option<AdaptiveImage>)>, RaycastError> {
    let start = Instant::now();
    let LookOptions { wanted, first, estimand, seed, .. } = *options;
    if !(wanted > 0.0 && wanted.is_finite()) {
        return Err(RaycastError::Left(wanted));
    }
    let of_first = AdaptiveOptions { comb: Some(first), estimand, seed, ..AdaptiveOptions::default() };
    of_first.check(density)?;
    // What rays see by turns stays as it is until the noise is known.
    let of_first = AdaptiveOptions { comb: Some(Comb { noise: 1.0, ..first }), ..of_first };
    let wide = wide(camera)?;
    let looking = Looking { options, of_first, begin, judge, density, scene: Scene::new(density, camera, watch) };
    match Packets::new(density).look(&wide, estimand, watch, looking) {
        None => Ok(None),
        Some(_) if watch.cancelled() => Err(RaycastError::Cancelled),
        Some(Err(e)) => Err(e),
        Some(Ok(None)) => Ok(None),
        Some(Ok(Some((pilot, None)))) => Ok(Some((pilot, None))),
        Some(Ok(Some((pilot, Some(made))))) => Ok(Some((pilot, Some(finished(made, camera, watch, start)?)))),
    }
}

struct Looking<'a> {
    options: &'a LookOptions<'a>,
    of_first: AdaptiveOptions,
    begin: &'a dyn Fn(&Glance) -> bool,
    judge: &'a dyn Fn(&Pilot) -> Option<AdaptiveOptions>,
    density: &'a Density,
    scene: Scene<'a>,
}

impl Pilot {
    /// By what factor means over pixels have less of the rays' noise than single rays: 0.81 with a ray a pixel, 0.89 with one for 4 by 4.
    pub const SMOOTHING: f64 = 0.87;
}

impl Look for Looking<'_> {
    type Out = Result<Option<(Pilot, Option<AdaptiveImage>)>, RaycastError>;

    fn run(self, full: &[(usize, usize)], cast: &dyn Cast) -> Self::Out {
        let dark = Dark::beside(full, self.scene.extent);
        let mut rounds = Rounds::new(self.of_first, self.scene, cast, &dark);
        let squares = rounds.places();
        let glance = self.glance(&mut rounds, &squares);
        if !(self.begin)(&glance) {
            return Ok(None);
        }
        let step = glance.first;
        rounds.options.comb = Some(Comb { step, noise: 1.0 });
        let before = rounds.counters;
        let mut raster = rounds.first(&squares);
        let (pilot, candidates) = self.pilot(&mut rounds, (step, before), &mut raster, &squares);
        let Some(options) = (self.judge)(&pilot) else { return Ok(Some((pilot, None))) };
        options.check(self.density)?;
        let first = Some(pilot.first);
        let same = (options.coarsest, options.first.or(options.comb), options.estimand, options.seed)
            == (self.of_first.coarsest, first, self.of_first.estimand, self.of_first.seed);
        let made = if same {
            Rounds { options, ..rounds }.rest(raster, squares, Some(candidates))
        } else {
            let mut rounds = Rounds { options, rays: vec![], ..rounds };
            let squares = rounds.places();
            let raster = rounds.first(&squares);
            rounds.rest(raster, squares, None)
        };
        Ok(Some((pilot, Some(made))))
    }
}

impl Looking<'_> {
    /// The distance at which single rays are expected to err as wanted, by what a few of them see by turns.
    fn glance(&self, rounds: &mut Rounds<'_>, squares: &[Square]) -> Glance {
        let LookOptions { wanted, first, seed, .. } = *self.options;
        if squares.is_empty() {
            return Glance { rays: 0, steps: 0.0, first: first.step, counters: Counters::default() };
        }
        let mut random = Pcg64Dxsm::new(u128::from(seed), 0x676c_616e);
        let shares = vec![1.0 / squares.len() as f64; squares.len()];
        let (chosen, _) = draw(&shares, GLANCE.min(squares.len()), random.random());
        let at: Vec<Square> = chosen.iter().map(|n| squares[*n]).collect();
        let points = Points::new(1, false, true, seed.wrapping_add(1 << 48));
        let (seen, work) = rounds.cast.squares(rounds.scene.along(self.of_first.comb), 4.0, &points, &at);
        rounds.counters += work;
        let mean = seen.iter().flat_map(|s| s.values).sum::<f64>() / (LANES * seen.len()) as f64;
        let noise = first.noise * seen.iter().map(|s| s.noise).sum::<f64>() / seen.len() as f64;
        // Of the whole image, dark places included.
        let lit = squares.len() as f64 * (4 * 4 * LANES) as f64 / self.scene.extent.pixels() as f64;
        let error = (noise / lit).sqrt() / mean;
        let [least, most] = LookOptions::RANGE;
        // Nothing seen, or nothing that differs.
        let by = if error > 0.0 && error.is_finite() { (wanted / error).sqrt() } else { 1.0 };
        let steps = work.evaluations as f64 * first.step / work.rays.max(1) as f64;
        let most = most.min((steps / FEWEST / first.step).max(STRETCH));
        let rays = (LANES * squares.len()) as u64;
        Glance { rays, steps, first: first.step * by.clamp(least, most), counters: work }
    }

    fn pilot(
        &self,
        rounds: &mut Rounds<'_>,
        (first, before): (f64, Counters),
        raster: &mut Raster,
        squares: &[Square],
    ) -> (Pilot, (Vec<Square>, Vec<f64>)) {
        let LookOptions { others, truth, squares: most, seed, .. } = *self.options;
        let number = rounds.counters.rays - before.rays;
        let steps = (rounds.counters.evaluations - before.evaluations) as f64 * first / number.max(1) as f64;
        // More where it is bright: noise rises with what a ray meets.
        let brightness: Vec<f64> = squares.iter().map(|at| raster.sum_of_square(*at).max(0.0)).collect();
        let whole = brightness.iter().sum::<f64>();
        let even = 1.0 / brightness.len().max(1) as f64;
        let shares: Vec<f64> =
            brightness.iter().map(|b| if whole > 0.0 { 0.2 * even + 0.8 * b / whole } else { even }).collect();
        let mut random = Pcg64Dxsm::new(u128::from(seed), 0x7069_6c6f);
        let (chosen, weights) = draw(&shares, most.min(squares.len()), random.random());
        let at: Vec<Square> = chosen.iter().map(|n| squares[*n]).collect();
        let mut rays = |step: Option<f64>, n: u64| -> Vec<Seen> {
            let along = rounds.scene.along(step.map(Comb::new));
            let points = Points::new(1, false, step.is_some(), seed.wrapping_add(n << 32));
            let (seen, work) = rounds.cast.squares(along, 4.0, &points, &at);
            rounds.counters += work;
            seen
        };
        let truth = rays(truth.map(|d| first * d).filter(|step| *step >= CLOSEST), 1);
        let pixels = self.scene.extent.pixels() as f64;
        // A square's share of the image: those at its rim are taken for whole.
        let area = (4 * 4 * LANES) as f64 / pixels;
        let unit = rounds.mean * rounds.mean;
        let own: Vec<Seen> =
            at.iter().map(|at| Seen { values: raster.square(*at), noise: raster.noise_at(*at) }).collect();
        let turns = |seen: &[Seen]| seen.iter().zip(&weights).map(|(s, w)| w * s.noise).sum::<f64>();
        // What the first rays saw by turns is known at all squares: those that were drawn stand for more, or less.
        let (all, drawn) = (squares.iter().map(|at| raster.noise_at(*at)).sum::<f64>(), turns(&own));
        let area = if drawn > 0.0 { area * all / drawn } else { area };
        let tried = |step: f64, seen: &[Seen]| {
            let square = |(s, t): (&Seen, &Seen)| {
                s.values.iter().zip(t.values).map(|(v, t)| (v - t) * (v - t)).sum::<f64>() / LANES as f64
            };
            let sum = seen.iter().zip(&truth).zip(&weights).map(|(v, w)| w * square(v)).sum::<f64>();
            let turns = turns(seen);
            let noise = if turns > 0.0 { sum / turns } else { 0.0 };
            let error = if unit > 0.0 { (area * sum / unit).sqrt() } else { 0.0 };
            Tried { comb: Comb { step, noise }, error }
        };
        let of_first = tried(first, &own);
        let others = others.iter().map(|d| first * d).enumerate().filter(|(_, step)| *step >= CLOSEST);
        let mut combs: Vec<Tried> = others.map(|(n, d)| tried(d, &rays(Some(d), n as u64 + 2))).collect();
        combs.push(of_first);
        combs.sort_by(|a, b| a.comb.step.total_cmp(&b.comb.step));
        // What the first rays' noise looks like is no error between them.
        raster.scale_noise(of_first.comb.noise);
        let (candidates, expected) = rounds.candidates(&*raster, squares, 4);
        let all = rounds.unit();
        let lefts: Vec<f64> = expected.iter().map(|e| if all > 0.0 { e / all } else { 0.0 }).collect();
        let pilot = Pilot {
            first: of_first.comb,
            rays: number,
            looked_at: (at.len() * LANES) as u64,
            pixels: pixels as u64,
            mean: rounds.mean,
            left: lefts.iter().sum::<f64>().sqrt(),
            lefts,
            combs,
            steps,
            counters: rounds.counters,
        };
        (pilot, (candidates, expected))
    }
}
