//! The rounds of an image: rays everywhere at first, then closer ones where they are needed.

use mcvr_scene::Extent;
use mcvr_volume::SimdLevel;
use rayon::prelude::*;

use super::dark::{Dark, region};
use super::needs::Needs;
use super::raster::Raster;
use super::{AdaptiveImage, AdaptiveOptions, Comb, MARGIN, Scene};
use crate::average::{self, Rays};
use crate::packet::{Cast, LANES, Seen, Square};
use crate::points::Points;
use crate::{Counters, MarchImage};

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

/// Factor on squared errors when rays come to be 2 pixels apart, or one: 1/15 and 1/240 at the median, 1/7 and 1/16 at worst.
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
pub(super) const DOUBT: f64 = 1.5;

/// Rays of an image so far, and what they left. Errors are sums of squares over its pixels.
pub(super) struct Rounds<'a> {
    pub(super) options: AdaptiveOptions,
    pub(super) scene: Scene<'a>,
    pub(super) cast: &'a dyn Cast,
    pub(super) dark: &'a Dark,
    pub(super) counters: Counters,
    pub(super) rays: Vec<(f64, u64)>,
    pub(super) mean: f64,
    /// That may be left.
    pub(super) most: f64,
    /// That is expected where no more rays come.
    pub(super) left: f64,
}

impl<'a> Rounds<'a> {
    pub(super) fn new(options: AdaptiveOptions, scene: Scene<'a>, cast: &'a dyn Cast, dark: &'a Dark) -> Self {
        let counters = Counters::default();
        Self { options, scene, cast, dark, counters, rays: vec![], mean: 0.0, most: 0.0, left: 0.0 }
    }

    fn set_mean(&mut self, mean: f64) {
        self.mean = mean;
        self.most = self.options.left.powi(2) * self.unit();
    }

    /// Sum of squares over the image that is an error of 1.
    pub(super) fn unit(&self) -> f64 {
        self.mean * self.mean * self.scene.extent.pixels() as f64
    }

    /// What may still be left; a tenth of the whole where the places behind already leave more than was hoped, since nothing closer helps them.
    pub(super) fn budget(&self) -> f64 {
        (self.most - self.left).max(0.1 * self.most)
    }

    /// Whether no more rays are needed, or wanted.
    fn suffices(&self, needs: &Needs) -> bool {
        needs.left() <= self.budget() || self.scene.watch.cancelled()
    }

    /// The places that are to be given rays next: all of them as long as none has seen anything.
    pub(super) fn next(&self, needs: &mut Needs, fall: f64) -> Vec<usize> {
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
    pub(super) fn squares(&mut self, comb: Option<Comb>, pitch: f64, squares: &[Square]) -> Vec<Seen> {
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
    pub(super) fn places(&self) -> Vec<Square> {
        self.dark.squares(self.options.coarsest as usize)
    }

    /// The first rays.
    pub(super) fn first(&mut self, squares: &[Square]) -> Raster {
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
    pub(super) fn candidates(&self, raster: &Raster, parents: &[Square], pitch: usize) -> (Vec<Square>, Vec<f64>) {
        let candidates = self.children(parents, 2 * pitch);
        let expected = self.expected(raster, &candidates, pitch);
        (candidates, expected)
    }

    /// All rays but the first, and the image. `first` are the first candidates, where they are known already.
    pub(super) fn rest(
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
