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
    /// What averaging over the pixels leaves.
    pub left: f64,
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
        let (few, many) =
            if enough > 0.01 { (&[4.0, 8.0, 16.0][..], &[1.0, 2.0][..]) } else { (&[1.0, 2.0, 4.0, 8.0][..], &[][..]) };
        let mut jobs: Vec<Job> = [0.0, -1.0 / 3.0, 1.0 / 3.0].map(exact).into();
        jobs.extend(few.iter().map(|d| comb(*d)));
        let (lines, work) = cast(&jobs, &chosen);
        let number = (2 * TILE * lines.len()).max(1) as f64;
        let values = |job: usize| lines.iter().flat_map(move |s| s[job].iter().flatten());
        // From a mean over the tiles looked at to one over the image: the others are dark.
        let share = ((full.len() * TILE * TILE) as f64 / pixels as f64).min(1.0);
        let mean = share * values(0).sum::<f64>() / number;
        let rms = |square: f64| (share * square).sqrt() / mean;
        let error = |lines: &[Vec<Lines>], job: usize| {
            let pairs = lines.iter().flat_map(|s| s[job].iter().flatten()).zip(values(0));
            average::noise(Rays::Grid(1)) * rms(pairs.map(|(c, e)| (c - e) * (c - e)).sum::<f64>() / number)
        };
        let exact_work = work[0];
        let mut counters = Counters::default();
        work.iter().for_each(|w| counters += *w);
        let mut steps = work[3].evaluations as f64 * few[0];
        let mut combs: Vec<(f64, f64)> = few.iter().enumerate().map(|(n, d)| (*d, error(&lines, n + 3))).collect();
        if combs[0].1 > enough && !many.is_empty() {
            let jobs: Vec<Job> = many.iter().map(|d| comb(*d)).collect();
            let (lines, work) = cast(&jobs, &chosen);
            work.iter().for_each(|w| counters += *w);
            steps = work[0].evaluations as f64 * many[0];
            let finer = many.iter().enumerate().map(|(n, d)| (*d, error(&lines, n)));
            combs.splice(0..0, finer);
        }
        // Terms of both axes add up; each was looked at along half of the lines.
        let (mut bends, mut left) = (Bends::default(), 0.0);
        let share_of_line = 1.0 / (2 * lines.len()).max(1) as f64;
        for strip in &lines {
            for line in 0..2 {
                let b = Bends::of(&strip[0][line]);
                for n in 0..2 {
                    bends.terms[n] += 2.0 * b.terms[n] * share_of_line;
                    bends.halves[n] += b.halves[n] * share_of_line;
                }
                left += 2.0 * share_of_line * average::left([&strip[1][line], &strip[0][line], &strip[2][line]]);
            }
        }
        let [bend, bend_twice] = bends.terms.map(rms);
        let (halves, left) = (bends.halves.map(rms), rms(left));
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
