//! A look at a few tiles of an image, to know what errors rays would leave before they are cast.

use mcvr_scene::{Camera, Density, Estimand, Extent, Watch};
use rand::seq::index::sample;
use rand_pcg::Pcg64Dxsm;
use serde::Serialize;

use crate::average::{self, Bends, Rays};
use crate::packet::{Along, Cast, Lines, Look, Packets, Strip, TILE};
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
    /// What averaging over the pixels leaves, where it was looked at: not where blocks of pixels can share a ray.
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
    /// Distances of the combs that are tried.
    pub const DISTANCES: [f64; 7] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];

    /// By what factor averaging over pixels lowers the errors of combs with `side` by `side` rays a pixel less than with one.
    pub fn noise(side: u32) -> f64 {
        average::noise(Rays::Grid(side)) / average::noise(Rays::Grid(1))
    }

    /// The same for one ray a block of `side` by `side` pixels.
    pub fn noise_of_block(side: u32) -> f64 {
        average::noise(Rays::Block(side)) / average::noise(Rays::Grid(1))
    }

    /// Looks at two lines of pixels in up to `tiles` tiles of the image of `tent`, chosen at random by `seed`; `None` where rays are not cast in packets. Combs
    /// are tried from the widest on until one leaves an error of at most `enough`. The same numbers for any number of threads.
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
        let points = |phase: bool| Points::new(1, false, phase, seed);
        let (exact, exact_work) = cast(Along::Exact, &points(false), &chosen);
        let mut counters = exact_work;
        let values = |strips: &[Lines]| strips.iter().flatten().flatten().copied().collect::<Vec<f64>>();
        let truth = values(&exact);
        let number = truth.len().max(1) as f64;
        // From a mean over the tiles looked at to one over the image: the others are dark.
        let share = ((full.len() * TILE * TILE) as f64 / pixels as f64).min(1.0);
        let mean = share * truth.iter().sum::<f64>() / number;
        let rms = |square: f64| (share * square).sqrt() / mean;
        let mut steps = 0.0;
        let mut combs = vec![];
        // Combs with only a few samples a ray are no candidates.
        let widest = exact_work.cells as f64 / exact_work.rays.max(1) as f64 / 8.0;
        for distance in Pilot::DISTANCES.into_iter().rev().filter(|d| *d <= widest.max(2.0)) {
            let (comb, work) = cast(Along::Comb(distance * spacing), &points(true), &chosen);
            counters += work;
            steps = work.evaluations as f64 * distance;
            let square = values(&comb).iter().zip(&truth).map(|(c, e)| (c - e) * (c - e)).sum::<f64>() / number;
            let error = average::noise(Rays::Grid(1)) * rms(square);
            combs.push((distance, error));
            if error <= enough {
                break;
            }
        }
        combs.reverse();
        // Terms of both axes add up; each was looked at along half of the lines.
        let mut bends = Bends::default();
        for line in exact.iter().flatten() {
            let b = Bends::of(line);
            let lines = 2.0 * exact.len() as f64;
            for n in 0..2 {
                bends.terms[n] += 2.0 * b.terms[n] / lines;
                bends.halves[n] += b.halves[n] / lines;
            }
        }
        let [bend, bend_twice] = bends.terms.map(rms);
        let halves = bends.halves.map(rms);
        let left = (halves[0] > enough).then(|| {
            let mut sides = [[0.0; 2]; 2];
            // Strips across and upright, moved along their lines.
            for upright in [false, true] {
                let some: Vec<(usize, Strip)> =
                    chosen.iter().copied().enumerate().filter(|(_, s)| s.upright == upright).collect();
                let strips: Vec<Strip> = some.iter().map(|(_, s)| *s).collect();
                let [before, after] = [-1.0, 1.0].map(|side: f64| {
                    let by = if upright { [0.0, side / 3.0] } else { [side / 3.0, 0.0] };
                    let (values, work) = cast(Along::Exact, &points(false).moved(by), &strips);
                    counters += work;
                    values
                });
                for (n, (at, _)) in some.iter().enumerate() {
                    for line in 0..2 {
                        sides[usize::from(upright)][0] +=
                            average::left([&before[n][line], &exact[*at][line], &after[n][line]]);
                        sides[usize::from(upright)][1] += 1.0;
                    }
                }
            }
            rms(sides.iter().map(|[sum, lines]| sum / f64::max(*lines, 1.0)).sum())
        });
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
