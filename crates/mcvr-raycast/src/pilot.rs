//! A look at a few tiles of an image, to know what errors rays would leave before they are cast.

use mcvr_scene::{Camera, Density, Estimand, Extent, Watch};
use rand::seq::index::sample;
use rand_pcg::Pcg64Dxsm;
use serde::Serialize;

use crate::average::{self, Bends, Rays};
use crate::packet::{Along, Cast, Job, Lines, Look, Packets, Strip, TILE};
use crate::points::Points;
use crate::{Counters, RaycastError};

/// What a pilot found out. Errors are RMSE over the whole image, as shares of its mean pixel; they are of rays through the pixels'
/// centres, averaged over pixels from their neighbours ([`RayOptions::average`](crate::RayOptions::average)).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pilot {
    /// Tiles of 8 by 8 pixels whose rays can meet density; rays are cast in no others.
    pub tiles: u64,
    /// Those of which two lines of pixels were looked at.
    pub looked_at: u64,
    /// Pixels of the image.
    pub pixels: u64,
    /// Mean pixel, from the tiles looked at.
    pub mean: f64,
    /// What averaging over the pixels changes, of the first order (second differences).
    pub bend: f64,
    /// The same of the second order (fourth differences).
    pub bend_twice: f64,
    /// What averaging over the pixels leaves, where that was looked at: not where blocks of pixels can share a ray.
    pub left: Option<f64>,
    /// By how much a pixel differs from what its neighbours at one and three pixels tell of it, along a line, and those at one and two.
    pub halves: [f64; 2],
    /// Distance of a comb's samples in units of the smallest voxel spacing, and the error that a comb leaves along the rays.
    pub combs: Vec<(f64, f64)>,
    /// Samples at a distance of 1 a ray, where rays are cast.
    pub steps: f64,
    /// Cells integrated exactly a ray, where rays are cast.
    pub cells: f64,
    /// Work of the pilot itself.
    pub counters: Counters,
}

impl Pilot {
    /// By what factor averaging over pixels lowers the errors of combs with `side` by `side` rays a pixel less than with one.
    pub fn noise(side: u32) -> f64 {
        average::noise(Rays::Grid(side)) / average::noise(Rays::Grid(1))
    }

    /// The same for one ray a block of `side` by `side` pixels.
    pub fn noise_of_block(side: u32) -> f64 {
        average::noise(Rays::Block(side)) / average::noise(Rays::Grid(1))
    }

    /// Looks at two lines of pixels in up to `tiles` tiles of the image of `tent`, chosen at random by `seed`; `None` where rays are not cast in packets. Errors
    /// far below `enough` are of no interest. The same numbers for any number of threads.
    ///
    /// # Errors
    /// [`RaycastError::Cancelled`] when `watch` said so.
    pub fn look(
        density: &Density,
        camera: &Camera,
        estimand: Estimand,
        (tiles, enough): (usize, f64),
        seed: u64,
        watch: &Watch,
    ) -> Result<Option<Self>, RaycastError> {
        let spacing = density.volume().grid().spacing().min_element();
        let sight = Sight { tiles, enough, seed, spacing, extent: camera.extent() };
        let pilot = Packets::new(density).look(camera, estimand, watch, sight);
        if watch.cancelled() { Err(RaycastError::Cancelled) } else { Ok(pilot) }
    }
}

/// What a pilot is to look at.
struct Sight {
    tiles: usize,
    enough: f64,
    seed: u64,
    spacing: f64,
    extent: Extent,
}

impl Look for Sight {
    type Out = Pilot;

    fn run(self, full: &[(usize, usize)], cast: &Cast<'_>) -> Pilot {
        let Self { tiles, enough, seed, spacing, extent: Extent { width, height } } = self;
        let pixels = width * height;
        let mut random = Pcg64Dxsm::new(u128::from(seed), 0x7069_6c6f);
        // Lines that the image's edge cuts would look bent; where all are cut, so be it.
        let whole: Vec<(usize, usize)> =
            full.iter().copied().filter(|t| (t.0 + 1) * TILE <= width && (t.1 + 1) * TILE <= height).collect();
        let from = if whole.is_empty() { full } else { &whole };
        let mut chosen: Vec<usize> = sample(&mut random, from.len(), tiles.min(from.len())).into_vec();
        chosen.sort_unstable();
        let strip = |(n, of): (usize, usize)| Strip { tile: from[of], upright: n % 2 == 1 };
        let chosen: Vec<Strip> = chosen.into_iter().enumerate().map(strip).collect();
        let points = |by: f64| {
            let one = || Points::new(1, false, false, seed);
            [one().moved([by, 0.0]), one().moved([0.0, by])]
        };
        let comb = |distance: f64| {
            let one = || Points::new(1, false, true, seed);
            Job { along: Along::Comb(distance * spacing), points: [one(), one()] }
        };
        let exact = |by: f64| Job { along: Along::Exact, points: points(by) };
        // The ways that are wanted for sure go strip by strip; those that turn out to be wanted go over the strips once more.
        let quick = enough > 0.01;
        let few = if quick { &[4.0, 8.0, 16.0][..] } else { &[1.0, 2.0, 4.0, 8.0][..] };
        let sides = || [-1.0 / 3.0, 1.0 / 3.0].map(exact);
        let mut jobs: Vec<Job> = vec![exact(0.0)];
        jobs.extend(few.iter().map(|d| comb(*d)));
        if !quick {
            jobs.extend(sides());
        }
        let (lines, work) = cast(&jobs, &chosen);
        let mut counters = Counters::default();
        work.iter().for_each(|w| counters += *w);
        let (exact_work, mut steps) = (work[0], work[1].evaluations as f64 * few[0]);
        let number = (2 * TILE * lines.len()).max(1) as f64;
        let truth = || lines.iter().flat_map(|s| s[0].iter().flatten());
        // From a mean over the tiles looked at to one over the image: the others are dark.
        let share = ((full.len() * TILE * TILE) as f64 / pixels as f64).min(1.0);
        let mean = share * truth().sum::<f64>() / number;
        let rms = |square: f64| (share * square).sqrt() / mean;
        let error = |lines: &[Vec<Lines>], job: usize| {
            let pairs = lines.iter().flat_map(|s| s[job].iter().flatten()).zip(truth());
            average::noise(Rays::Grid(1)) * rms(pairs.map(|(c, e)| (c - e) * (c - e)).sum::<f64>() / number)
        };
        let mut combs: Vec<(f64, f64)> = few.iter().enumerate().map(|(n, d)| (*d, error(&lines, n + 1))).collect();
        // Terms of both axes add up; each was looked at along half of the lines.
        let share_of_line = 1.0 / (2 * lines.len()).max(1) as f64;
        let mut bends = Bends::default();
        for line in lines.iter().flat_map(|s| s[0]) {
            let b = Bends::of(&line);
            for n in 0..2 {
                bends.terms[n] += 2.0 * b.terms[n] * share_of_line;
                bends.halves[n] += b.halves[n] * share_of_line;
            }
        }
        let [bend, bend_twice] = bends.terms.map(rms);
        let halves = bends.halves.map(rms);
        let left_by = |sides: &[Vec<Lines>], first: usize| {
            let all = lines.iter().zip(sides).flat_map(|(s, sides)| {
                [0, 1].map(|line: usize| average::left([&sides[first][line], &s[0][line], &sides[first + 1][line]]))
            });
            rms(2.0 * share_of_line * all.sum::<f64>())
        };
        let mut left = None;
        if !quick {
            left = Some(left_by(&lines, few.len() + 1));
        } else if halves[0] > enough || combs[0].1 > enough {
            let finer = [1.0, 2.0];
            let mut jobs: Vec<Job> = sides().into();
            jobs.extend(finer.map(comb));
            let (more, work) = cast(&jobs, &chosen);
            work.iter().for_each(|w| counters += *w);
            steps = work[2].evaluations as f64 * finer[0];
            combs.splice(0..0, finer.iter().enumerate().map(|(n, d)| (*d, error(&more, n + 2))));
            left = Some(left_by(&more, 0));
        }
        let rays = exact_work.rays.max(1) as f64;
        Pilot {
            tiles: full.len() as u64,
            looked_at: chosen.len() as u64,
            pixels: pixels as u64,
            mean,
            bend,
            bend_twice,
            left,
            halves,
            combs,
            steps: steps / rays,
            cells: exact_work.cells as f64 / rays,
            counters,
        }
    }
}
