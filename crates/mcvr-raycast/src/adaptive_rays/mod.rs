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

use std::time::Instant;

use mcvr_scene::{Camera, Density, Estimand, Extent, Image, Watch};
use mcvr_volume::SimdLevel;
use rayon::prelude::*;
use serde::Serialize;

use crate::average::{self, Rays};
use crate::packet::{Along, Cast, LANES, Look, Packets, SIDE, Seen, Square};
use crate::points::Points;
use crate::{Counters, MarchImage, MarchOptions, RayOptions, RaycastError};
use dark::{Dark, region};
pub use look::{Glance, LookOptions, Pilot, Tried, look_and_cast};
use needs::Needs;
use raster::Raster;

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

/// Error expected of a pixel for the root of its squared fourth differences along both axes, at distances of 4, 2 and 1 pixel. On eight
/// phantoms and three views (the example `bends`) it tells 1.1 times the error at the wider two at the median; at one pixel 0.8 to 1 times along
/// the grid's axes and 2 to 5 times elsewhere. Where expected errors are wrong by a factor, that factor is found when the first of them are given rays.
fn bend(pitch: usize) -> f64 {
    match pitch {
        4 => 0.05,
        2 => 0.035,
        _ => 0.015,
    }
}

/// Factor on squared errors when rays in a pixel are twice as close: the fourth power, as for kinks. On phantoms 1/29 at the median, 1/9 at
/// worst, along the grid's axes.
const FALL: f64 = 1.0 / 16.0;

/// The same when rays come to be 2 pixels apart, or one: 1/15 and 1/240 at the median, 1/7 and 1/16 at worst.
fn fall(pitch: usize) -> f64 {
    if pitch == 2 { 1.0 / 8.0 } else { 1.0 / 32.0 }
}

/// Variance of the polynomial through rays with noise, in units of theirs.
const BETWEEN: f64 = 0.8;

/// Candidates that a thread looks at together.
const CANDIDATES: usize = 2048;

/// Squared fourth differences, along both axes, of values that are noise with a variance of 1.
const NOISY: f64 = 2.0 * 70.0;

/// Expected errors are those beyond what noise looks like, times this: it is told from few rays.
const DOUBT: f64 = 1.5;

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

/// Rays of an image so far, and what they left. Errors are sums of squares over its pixels.
struct Rounds<'a> {
    options: AdaptiveOptions,
    scene: Scene<'a>,
    cast: &'a dyn Cast,
    dark: &'a Dark,
    counters: Counters,
    rays: Vec<(f64, u64)>,
    mean: f64,
    /// That may be left.
    most: f64,
    /// That is expected where no more rays come.
    left: f64,
}

impl<'a> Rounds<'a> {
    fn new(options: AdaptiveOptions, scene: Scene<'a>, cast: &'a dyn Cast, dark: &'a Dark) -> Self {
        let counters = Counters::default();
        Self { options, scene, cast, dark, counters, rays: vec![], mean: 0.0, most: 0.0, left: 0.0 }
    }

    fn set_mean(&mut self, mean: f64) {
        self.mean = mean;
        self.most = self.options.left.powi(2) * self.unit();
    }

    /// Sum of squares over the image that is an error of 1.
    fn unit(&self) -> f64 {
        self.mean * self.mean * self.scene.extent.pixels() as f64
    }

    /// What may still be left; a tenth of the whole where the places behind already leave more than was hoped, since nothing closer helps them.
    fn budget(&self) -> f64 {
        (self.most - self.left).max(0.1 * self.most)
    }

    /// Whether no more rays are needed, or wanted.
    fn suffices(&self, needs: &Needs) -> bool {
        needs.left() <= self.budget() || self.scene.watch.cancelled()
    }

    /// The places that are to be given rays next: all of them as long as none has seen anything.
    fn next(&self, needs: &mut Needs, fall: f64) -> Vec<usize> {
        if self.scene.watch.cancelled() {
            vec![]
        } else if self.mean > 0.0 {
            needs.next(self.budget(), fall)
        } else {
            needs.all()
        }
    }

    /// What candidates for rays at half a distance are expected to gain; the same everywhere where nothing was seen yet.
    fn expected(&self, raster: &Raster, candidates: &[Square], pitch: usize) -> Vec<f64> {
        if self.mean <= 0.0 {
            return vec![1.0; candidates.len()];
        }
        let (level, factor) = (SimdLevel::detect(), bend(pitch).powi(2) * (pitch * pitch) as f64);
        // Of 2 by 2 rays.
        let noise = DOUBT * NOISY * 4.0;
        let parent = |at: &Square| at.map(|v| v / 2);
        let mut all = vec![0.0; candidates.len()];
        let parts = all.par_chunks_mut(CANDIDATES).zip(candidates.par_chunks(CANDIDATES));
        parts.for_each(|(mut all, candidates)| {
            // The candidates of a square lie side by side.
            for group in candidates.chunk_by(|a, b| parent(a) == parent(b)) {
                let at = parent(&group[0]);
                let (bends, noise) = (raster.bends(level, at), noise * raster.noise_around(at));
                let (out, rest) = std::mem::take(&mut all).split_at_mut(group.len());
                for (out, [x, y]) in out.iter_mut().zip(group) {
                    *out = factor * (bends[(y % 2 * 2 + x % 2) as usize] - noise).max(0.0);
                }
                all = rest;
            }
        });
        all
    }

    /// Casts squares of rays at a distance; their noise is what the comb's is taken for.
    fn squares(&mut self, comb: Option<Comb>, pitch: f64, squares: &[Square]) -> Vec<Seen> {
        // Rays of different distances know nothing of each other.
        let seed = self.options.seed ^ pitch.to_bits().rotate_left(20);
        let points = Points::new(1, false, comb.is_some(), seed);
        let (mut seen, work) = self.cast.squares(self.scene.along(comb), pitch, &points, squares);
        match self.rays.last_mut().filter(|(p, _)| *p == pitch) {
            Some((_, rays)) => *rays += work.rays,
            None => self.rays.push((pitch, work.rays)),
        }
        self.counters += work;
        let share = comb.map_or(0.0, |comb| comb.noise);
        seen.iter_mut().for_each(|s| s.noise *= share);
        seen
    }

    /// Mean of the values whose places are in the image.
    fn mean_of(&self, raster: &Raster, pitch: usize) -> f64 {
        let Extent { width, height } = self.scene.extent;
        let inside = |pixels: usize| MARGIN / pitch..(MARGIN + pixels).div_ceil(pitch);
        let (x, y) = (inside(width), inside(height));
        let rows = y.clone().map(|y| sum(&raster.values[y * raster.across..][x.clone()]));
        rows.sum::<f64>() / (x.len() * y.len()) as f64
    }

    /// All squares of first rays that can meet density.
    fn places(&self) -> Vec<Square> {
        self.dark.squares(self.options.coarsest as usize)
    }

    /// The first rays.
    fn first(&mut self, squares: &[Square]) -> Raster {
        let Extent { width, height } = self.scene.extent;
        let pitch = self.options.coarsest as usize;
        let [across, down] = [width, height].map(region);
        let seen = self.squares(self.options.first.or(self.options.comb), pitch as f64, squares);
        let mut raster = Raster::zeros([across / pitch, down / pitch]);
        squares.iter().zip(&seen).for_each(|(at, seen)| raster.put(*at, seen));

        self.mean = self.mean_of(&raster, pitch);
        raster
    }

    /// Candidates for rays at half a distance, and what they are expected to gain.
    fn candidates(&self, raster: &Raster, parents: &[Square], pitch: usize) -> (Vec<Square>, Vec<f64>) {
        let candidates = self.children(parents, 2 * pitch);
        let expected = self.expected(raster, &candidates, pitch);
        (candidates, expected)
    }

    /// All rays but the first, and the image. `first` are the first candidates, where they are known already.
    fn rest(
        mut self,
        mut raster: Raster,
        mut parents: Vec<Square>,
        mut first: Option<(Vec<Square>, Vec<f64>)>,
    ) -> AdaptiveImage {
        let mut pitch = self.options.coarsest as usize;
        let mut at_first = None;
        let mut needs;
        let mut candidates;
        loop {
            // The first rays may miss most of an image of few pixels.
            self.set_mean(self.mean_of(&raster, pitch));
            let expected;
            (candidates, expected) = first.take().unwrap_or_else(|| self.candidates(&raster, &parents, pitch));
            at_first.get_or_insert_with(|| share(expected.iter().sum(), self.unit()));
            needs = Needs::new(expected.into_iter());
            // What the first rays do not show, a sample of closer ones does.
            let sampled = pitch < self.options.coarsest as usize;
            if pitch == 1 || sampled && self.suffices(&needs) {
                break;
            }
            let Some(closer) = self.closer(pitch / 2, &raster, &candidates, &mut needs) else { break };
            (raster, parents) = closer;
            pitch /= 2;
        }
        let rays = if pitch == 1 { Rays::Grid(1) } else { Rays::Block(pitch as u32) };
        let first = MARGIN / pitch - average::MARGIN;
        let inner = &raster.values[first * raster.across + first..];
        let mut image = average::means((inner, raster.across), self.scene.extent, rays, 1.0);
        self.dark.over_image(&mut image);
        if pitch == 1 && self.mean > 0.0 && (self.options.coarsest == 1 || !self.suffices(&needs)) {
            self.within_pixels(&raster, candidates, needs, &mut image);
        } else {
            self.left += needs.left();
        }
        let (left, expected) = (share(self.left, self.unit()), at_first.unwrap_or(0.0));
        let made = MarchImage { image, counters: self.counters, seconds: 0.0 };
        AdaptiveImage { made, left, expected, rays: self.rays }
    }

    /// The squares of `side` pixels in those of twice the side that meet the image and are not dark.
    fn children(&self, parents: &[Square], side: usize) -> Vec<Square> {
        let Extent { width, height } = self.scene.extent;
        let inside = |at: u32, pixels: usize| {
            let at = at as usize * side;
            at + side > MARGIN && at < MARGIN + pixels
        };
        let mut all = Vec::with_capacity(4 * parents.len());
        for [x, y] in parents {
            let (x, y) = (2 * x, 2 * y);
            for at in [[x, y], [x + 1, y], [x, y + 1], [x + 1, y + 1]] {
                if inside(at[0], width) && inside(at[1], height) && self.dark.meets(&at, side) {
                    all.push(at);
                }
            }
        }
        all
    }

    /// Casts rays at a distance of `pitch` where they are needed: values at all places, and the squares with rays of their own. `None` where a
    /// glance told that none are.
    fn closer(
        &mut self,
        pitch: usize,
        coarse: &Raster,
        at: &[Square],
        needs: &mut Needs,
    ) -> Option<(Raster, Vec<Square>)> {
        let area = (pitch * pitch) as f64;
        let number = area * LANES as f64;
        let mut all: Vec<Square> = vec![];
        let mut glanced = vec![];
        let mut raster: Option<Raster> = None;
        loop {
            let next = self.next(needs, fall(pitch));
            if next.is_empty() {
                break;
            }
            if raster.is_none() && !needs.only_glanced() {
                let mut finer = coarse.finer();
                self.dark.over_raster(&mut finer, pitch);
                all.iter().zip(&glanced).for_each(|(at, seen)| finer.put(*at, seen));
                raster = Some(finer);
            }
            let squares: Vec<Square> = next.iter().map(|n| at[*n]).collect();
            let seen = self.squares(self.options.comb, pitch as f64, &squares);
            let found = squares.iter().zip(&seen).map(|(at, seen)| {
                let (told, noise) = match &raster {
                    Some(raster) => (raster.square(*at), raster.noise_at(*at)),
                    None => (coarse.between(*at), coarse.noise_at(at.map(|v| v / 2))),
                };
                (area * difference(&told, &seen.values), number * (seen.noise + BETWEEN * noise))
            });
            needs.found(&next, found);
            all.extend(&squares);
            match &mut raster {
                Some(raster) => squares.iter().zip(&seen).for_each(|(at, seen)| raster.put(*at, seen)),
                None => glanced.extend(seen),
            }
        }
        let raster = raster?;
        self.left += needs.left();
        Some((raster, all))
    }

    /// Casts several rays a pixel where they are needed: candidates are of 2 by 2 pixels at first, then of one.
    fn within_pixels(&mut self, raster: &Raster, candidates: Vec<Square>, needs: Needs, image: &mut Image) {
        let Extent { width, height } = self.scene.extent;
        let (mut at, mut needs, mut side) = (candidates, needs, 2);
        let mut rays: u32 = 2;
        loop {
            // Squares of rays along a candidate.
            let squares = side * rays / SIDE as u32;
            // That of a pixel's rays, and of the quarter as many before.
            let noise = 5.0 / f64::from(rays * rays);
            let mut finer = vec![];
            loop {
                let next = self.next(&mut needs, FALL);
                if next.is_empty() {
                    break;
                }
                let parts = |n: &usize| {
                    let [x, y] = at[*n].map(|v| v * squares);
                    (0..squares).flat_map(move |dy| (0..squares).map(move |dx| [x + dx, y + dy]))
                };
                let all: Vec<Square> = next.iter().flat_map(parts).collect();
                let seen = self.squares(self.options.comb, f64::from(rays).recip(), &all);
                let mut found = Vec::with_capacity(next.len());
                for (n, seen) in next.iter().zip(seen.chunks_exact((squares * squares) as usize)) {
                    let mut sum = (0.0, 0.0);
                    let noise = noise * seen.iter().map(|s| s.noise).sum::<f64>() / seen.len() as f64;
                    for (dx, dy) in (0..side).flat_map(|dy| (0..side).map(move |dx| (dx, dy))) {
                        let [x, y] = [at[*n][0] * side + dx, at[*n][1] * side + dy].map(|v| v as usize);
                        if x < MARGIN || y < MARGIN || x >= MARGIN + width || y >= MARGIN + height {
                            continue;
                        }
                        let mean =
                            mean_of(seen, rays, side, [dx, dy]) + raster.curvature(x, y) / f64::from(24 * rays * rays);
                        let pixel = &mut image.values_mut()[(y - MARGIN) * width + x - MARGIN];
                        let square = (mean - *pixel) * (mean - *pixel);
                        *pixel = mean;
                        sum = (sum.0 + square, sum.1 + noise);
                        finer.push(([x as u32, y as u32], (square - DOUBT * noise).max(0.0)));
                    }
                    found.push(sum);
                }
                needs.found(&next, found.into_iter());
            }
            self.left += needs.left();
            if rays < FINEST {
                share_with_neighbours(&mut finer, width + 2 * MARGIN);
            }
            // Of the pixels that were given rays.
            let rest = FALL * finer.iter().map(|(_, square)| square).sum::<f64>();
            if rays == FINEST || rest <= self.budget() || self.scene.watch.cancelled() {
                self.left += rest;
                return;
            }
            needs = Needs::new(finer.iter().map(|(_, square)| FALL * square));
            at = finer.into_iter().map(|(at, _)| at).collect();
            (rays, side) = (2 * rays, 1);
        }
    }
}

/// Gives half of what was found at every pixel to the pixels around it that were looked at, itself among them: where an image is rough, two
/// means may agree by chance.
fn share_with_neighbours(found: &mut [([u32; 2], f64)], across: usize) {
    let Some(last) = found.iter().map(|(at, _)| at[1]).max() else { return };
    let mut squares = vec![f64::NAN; across * (last as usize + 2)];
    let place = |[x, y]: [u32; 2]| y as usize * across + x as usize;
    found.iter().for_each(|(at, square)| squares[place(*at)] = *square);
    for (at, square) in found {
        let (mut sum, mut number) = (0.0, 0.0);
        for row in 0..3 {
            let first = place(*at) + row * across - across - 1;
            for v in squares[first..first + 3].iter().filter(|v| !v.is_nan()) {
                (sum, number) = (sum + v, number + 1.0);
            }
        }
        *square = 0.5 * (*square + sum / number);
    }
}

/// Sum of the squared differences between the values of two squares.
fn difference(a: &[f64; LANES], b: &[f64; LANES]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// An error for a sum of squares, in units of the mean.
fn share(squares: f64, unit: f64) -> f64 {
    if unit > 0.0 { (squares / unit).sqrt() } else { 0.0 }
}

/// By eight sums side by side, which vector code makes.
#[allow(clippy::needless_range_loop, reason = "vector code wants plain loops")]
fn sum(values: &[f64]) -> f64 {
    let (rows, rest) = values.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for row in rows {
        for n in 0..8 {
            sums[n] += row[n];
        }
    }
    rest.iter().sum::<f64>() + sums.iter().sum::<f64>()
}

/// Mean of the rays of one pixel of a candidate of `side` pixels, with `rays` along a pixel's side.
fn mean_of(squares: &[Seen], rays: u32, side: u32, [dx, dy]: [u32; 2]) -> f64 {
    if side > 1 {
        // A square holds 2 by 2 rays of each of 2 by 2 pixels.
        let first = (dy as usize * 2) * SIDE + dx as usize * 2;
        let v = &squares[0].values;
        return 0.25 * ((v[first] + v[first + 1]) + (v[first + SIDE] + v[first + SIDE + 1]));
    }
    squares.iter().flat_map(|s| s.values).sum::<f64>() / f64::from(rays * rays)
}
