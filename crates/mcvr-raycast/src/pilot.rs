//! A look at a few tiles of an image, to know what errors rays would leave before they are cast.

use mcvr_scene::{Camera, Density, Estimand, Watch};
use rand::seq::index::sample;
use rand_pcg::Pcg64Dxsm;
use serde::Serialize;

use crate::average;
use crate::packet::{Along, Cast, Look, Packets, TILE};
use crate::points::Points;
use crate::{Counters, RaycastError};

/// What a pilot found out. Errors are RMSE over the whole image, as shares of its mean pixel; they are of rays through the pixels'
/// centres, averaged over pixels from their neighbours ([`RayOptions::average`](crate::RayOptions::average)).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pilot {
    /// Tiles of 8 by 8 pixels whose rays can meet density; rays are cast in no others.
    pub tiles: u64,
    /// Those that were looked at.
    pub looked_at: u64,
    /// Pixels of the image.
    pub pixels: u64,
    /// Mean pixel, from the tiles looked at.
    pub mean: f64,
    /// What averaging over the pixels changes, of the first order (second differences).
    pub bend: f64,
    /// The same of the second order (fourth differences).
    pub bend_twice: f64,
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

    /// By what factor averaging over pixels lowers the errors of combs less with `side` by `side` rays a pixel than with one.
    pub fn noise(side: u32) -> f64 {
        average::noise(side) / average::noise(1)
    }

    /// Looks at up to `tiles` tiles of the image of `tent`, chosen at random by `seed`; `None` where rays are not cast in packets. Combs
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
        let pixels = camera.extent().pixels();
        let sight = Sight { tiles, enough, seed, spacing, pixels };
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
    pixels: usize,
}

impl Look for Sight {
    type Out = Pilot;

    fn run(self, full: &[(usize, usize)], cast: &Cast<'_>) -> Pilot {
        let Self { tiles, enough, seed, spacing, pixels } = self;
        let mut random = Pcg64Dxsm::new(u128::from(seed), 0x7069_6c6f);
        let mut chosen: Vec<usize> = sample(&mut random, full.len(), tiles.min(full.len())).into_vec();
        chosen.sort_unstable();
        let chosen: Vec<(usize, usize)> = chosen.into_iter().map(|n| full[n]).collect();
        let points = |phase: bool| Points::new(1, false, phase, seed);
        let (exact, exact_work) = cast(Along::Exact, &points(false), &chosen);
        let mut counters = exact_work;
        let looked_at = exact.len().max(1) as f64;
        let in_tile = (TILE * TILE) as f64;
        // From a mean over the tiles looked at to one over the image: the others are dark.
        let share = (full.len() as f64 * in_tile / pixels as f64).min(1.0);
        let mean = share * exact.iter().flatten().sum::<f64>() / (looked_at * in_tile);
        let rms = |square: f64| (share * square).sqrt() / mean;
        let mut steps = 0.0;
        let mut combs = vec![];
        for distance in Pilot::DISTANCES.into_iter().rev() {
            let (comb, work) = cast(Along::Comb(distance * spacing), &points(true), &chosen);
            counters += work;
            steps = work.evaluations as f64 * distance;
            let all = comb.iter().flatten().zip(exact.iter().flatten());
            let square = all.map(|(c, e)| (c - e) * (c - e)).sum::<f64>() / (looked_at * in_tile);
            let error = average::noise(1) * rms(square);
            combs.push((distance, error));
            if error <= enough {
                break;
            }
        }
        combs.reverse();
        let bends = exact.iter().map(|e| average::bends(e, TILE));
        let sums = bends.fold([0.0; 2], |sum, b| [sum[0] + b[0] / looked_at, sum[1] + b[1] / looked_at]);
        let [bend, bend_twice] = sums.map(rms);
        let rays = exact_work.rays.max(1) as f64;
        Pilot {
            tiles: full.len() as u64,
            looked_at: chosen.len() as u64,
            pixels: pixels as u64,
            mean,
            bend,
            bend_twice,
            combs,
            steps: steps / rays,
            cells: exact_work.cells as f64 / rays,
            counters,
        }
    }
}
