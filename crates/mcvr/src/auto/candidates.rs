//! Every way to an error that is worth a thought, with what it would take.

use std::cmp::Ordering;

use mcvr_footprint::{FootprintOptions, Refine, footprints_in_all, predicted_error};
use mcvr_raycast::{Comb, Glance, Pilot, Tried};
use mcvr_scene::{Camera, Density, Estimand, Occupancy};
use mcvr_volume::Volume;

use super::{Candidate, Costs};
use crate::{Adaptive, Method};

/// Predictions are held to this share of the error asked for: those from some hundred rays err by a tenth, and more where a few bright pixels
/// carry the error. One case in fifty of phantoms misses with it.
const MARGIN: f64 = 0.9;

/// Most parts of a voxel along its shortest side for footprints.
const PARTS: u32 = 3;

/// Rays a pixel at each distance of adaptive rays, from a ray for 4 by 4 pixels to 2 by 2 in a pixel.
const RAYS: [f64; 4] = [1.0 / 16.0, 1.0 / 4.0, 1.0, 4.0];

/// These distances, in pixels.
const PITCH: [f64; 4] = [4.0, 2.0, 1.0, 0.5];

/// Squared error that is left at these distances, as a share of that at the first: on phantoms (the example `bends`) 1/14 from each to the next,
/// then 1/92 and 1/26, or less, of three in four.
const FALL: [f64; 4] = [1.0, 1.0 / 14.0, 1.0 / 1300.0, 1.0 / 33_000.0];

/// Cells that a ray crosses for every sample at a distance of 1: 1 along an axis, √3 along a diagonal.
const CELLS: f64 = 1.5;

/// Way through the volume of the rays that are needed, in that of all that can meet density: on phantoms.
const THICK: f64 = 1.4;

/// What is expected to be left between rays is this much surer not to be more.
const SURE: f64 = 1.15;

/// Shares of the squared error that combs may be given; the rest is left between rays.
const SPLITS: [f64; 5] = [0.3, 0.4, 0.5, 0.6, 0.7];

/// Error of footprints as a share of what their law says: 0.15 to 0.7 on eight phantoms whose voxels are small beside [`WIDE`] pixels, and up
/// to 1.5 for tubes of one voxel that is 6 pixels wide, whose errors are not independent.
const LAW: f64 = 0.7;

/// Side of a voxel in pixels beyond which the law is not trusted to fall.
const WIDE: f64 = 2.8;

/// All rays over the first ones, for 3 %, from which on rays are looked at.
const LOOKED_AT: f64 = 10.0;

/// Side of a voxel in pixels beyond which rays 4 pixels apart miss less and less.
const NARROW: f64 = 2.0;

/// Power of the samples a pixel by which the net's error falls (METHOD section 4: 1/2 to 2/3).
const NET: f64 = 0.62;

/// Candidates that need no look at the image.
pub(super) fn without_look(
    density: &Density,
    camera: &Camera,
    estimand: Estimand,
    plain: bool,
    error: f64,
) -> Vec<Candidate> {
    let volume = density.volume();
    let costs = Costs::of(volume);
    let mut all = vec![net(volume, camera.extent().pixels() as u64, &costs, error)];
    if plain {
        all.extend(footprints(density, camera, estimand, &costs));
    }
    all
}

/// Pixels on which footprints are checked whose error is not known well enough.
pub(super) const CHECKED: usize = 64;

/// Footprints that pass the check are expected to err by this share of what was asked for at most: 64 pixels told the error to an eighth
/// on the phantoms that were tried.
pub(super) const PASSES: f64 = 0.85;

/// Footprints err by 0.2 to 1 of what is expected of them: where that is too much, but far less time is needed than by the choice, it is worth
/// a trial. The more that is expected, the less likely it ends well.
pub(super) fn worth_a_trial<'a>(
    volume: &Volume,
    pilot: &Pilot,
    all: &'a [Candidate],
    chosen: &Candidate,
    target: f64,
) -> Option<&'a Candidate> {
    let costs = Costs::of(volume);
    let rays = (64 * CHECKED) as f64;
    let check = 1e-9 * rays * (costs.ray + costs.of_rays(costs.cell, 0.0) * CELLS * pilot.steps);
    let worth = |c: &&Candidate| {
        let likely = HOPE * target / c.error;
        c.method == Method::Footprint && c.error > target && c.seconds + check < likely * chosen.seconds
    };
    all.iter().filter(worth).min_by(|a, b| a.seconds.total_cmp(&b.seconds))
}

/// Chance that footprints pass the check which are expected to err as much as was asked for.
const HOPE: f64 = 0.8;

/// The least that adaptive rays take: what the first of them do, at a distance between samples, times what all are at least to the first.
/// Before any is cast, they are no more than their ways through the bricks with density.
pub(super) fn least(density: &Density, camera: &Camera, glance: Option<&Glance>, first: f64, error: f64) -> f64 {
    let side = Voxel::of(density, camera).side();
    let costs = Costs::of(density.volume());
    let (rays, steps) = match glance {
        Some(glance) => (glance.rays as f64, glance.rays as f64 * glance.steps),
        // All rays together pass a voxel as often as it covers pixels.
        None => {
            let occupied = (density.occupancy().count() * Occupancy::SIDE.pow(3)) as f64;
            (0.0, RAYS[0] * occupied * side * side)
        }
    };
    // On phantoms all rays are expected to go 13 to 28 times the way of the first for 3 %, 23 to 75 times for 0.3 %, and further where
    // density is thin; 13 times for 0.3 % of smooth bodies of 256 voxels. A look in vain costs some tenth of what is
    // taken instead, and rays that are not looked at cost no more than they need less than this.
    // Where voxels are wide, an image is smooth between the first rays.
    let all = (LOOKED_AT * (0.03 / error).powf(0.25) * (NARROW / side).powi(2).min(1.0)).max(1.0);
    let way = rays * costs.ray + costs.of_rays(costs.step, PITCH[0] / side) * steps / first;
    1e-9 * (camera.extent().pixels() as f64 * costs.pixel + all * way)
}

/// Adaptive rays that are expected to leave an error, exact ones and combs of several distances.
pub(super) fn adaptive_rays(density: &Density, camera: &Camera, pilot: &Pilot, error: f64) -> Vec<Candidate> {
    let (volume, side) = (density.volume(), Voxel::of(density, camera).side());
    let (costs, wanted, pixels) = (Costs::of(volume), MARGIN * error, pilot.pixels as f64);
    let fixed = volume.bytes() as f64 * costs.occupancy + pixels * costs.pixel;
    let places = places(pilot);
    let lit = pilot.rays as f64 / pixels;
    let mut all = vec![];
    let mut add = |method, Tried { comb: Comb { step, noise }, error: along }: Tried, left: f64| {
        let (near, number) =
            if method == Method::Rays { (costs.cell, CELLS * pilot.steps) } else { (costs.step, pilot.steps / step) };
        // Where squares of rays lie scattered, they share less with their neighbours.
        let apart = |n: usize, rays: f64| PITCH[n] / side * (lit * RAYS[n] / (RAYS[0] * rays)).max(1.0).sqrt();
        let of_level = |coarsest: u32, (n, rays): (usize, &f64)| {
            // The first rays go everywhere, those that follow where there is much.
            let way = if PITCH[n] == f64::from(coarsest) { number } else { THICK * number };
            let each = || costs.ray + way * costs.of_rays(near, apart(n, *rays));
            if *rays > 0.0 { rays * each() } else { 0.0 }
        };
        let ways = rays_for(pilot, &places, left).into_iter().map(|(mut rays, coarsest)| {
            // The rays of the look are the first of the image where these need not be closer; else they are cast again.
            let first = (method == Method::Comb && coarsest == 4 && step >= pilot.first.step).then_some(pilot.first);
            if first.is_some() {
                rays[0] = 0.0;
            }
            let seconds = rays.iter().enumerate().map(|level| of_level(coarsest, level)).sum::<f64>();
            (rays, coarsest, first, seconds)
        });
        let Some((rays, coarsest, first, seconds)) = ways.min_by(|a, b| a.3.total_cmp(&b.3)) else { return };
        all.push(Candidate {
            method,
            samples: (rays.iter().sum::<f64>() * pixels).ceil() as u64,
            step,
            adaptive: Some(Adaptive { left, noise, coarsest, first }),
            error: left.hypot(Pilot::SMOOTHING * along) / MARGIN,
            seconds: 1e-9 * (fixed + pixels * seconds),
        });
    };
    let exact = Tried { comb: Comb { step: 0.0, noise: 0.0 }, error: 0.0 };
    add(Method::Rays, exact, wanted);
    // Where no more than the first rays are needed, all else may be noise.
    let least = SURE * pilot.left / wanted;
    let noise_alone = (least < 1.0).then_some(1.0 - least * least);
    let splits = SPLITS.into_iter().chain(noise_alone);
    let between = splits.filter_map(|split| widest(pilot, wanted * split.sqrt() / Pilot::SMOOTHING));
    // Errors at distances that were tried are known, and small where samples fit the grid.
    for tried in pilot.combs.iter().copied().chain(between) {
        let left = (wanted * wanted - (Pilot::SMOOTHING * tried.error).powi(2)).sqrt();
        if left > 0.0 {
            add(Method::Comb, tried, left);
        }
    }
    all
}

/// Squared errors of places and their number, those of a quarter of an octave taken together, without those that are 2^40 times less than
/// the largest.
fn places(pilot: &Pilot) -> Vec<(f64, f64)> {
    const BITS: u32 = 2;
    let most = pilot.lefts.iter().fold(0.0, |a: f64, b| a.max(*b)).to_bits();
    let mut all = vec![(0.0, 0.0); 40 << BITS];
    for e in pilot.lefts.iter().filter(|e| **e > 0.0) {
        // Bits of positive numbers rise with them.
        if let Some((sum, number)) = all.get_mut((most.saturating_sub(e.to_bits()) >> (52 - BITS)) as usize) {
            *sum += e;
            *number += 1.0;
        }
    }
    all.retain(|(_, number)| *number > 0.0);
    all.iter().map(|(sum, number)| (sum / number, *number)).collect()
}

/// Rays a pixel of the image that adaptive rays are expected to take at each distance to leave an error, for blocks of 4, 2 and 1 pixels along the
/// side that share a ray at first. Every place is given rays until more would gain too little.
fn rays_for(pilot: &Pilot, places: &[(f64, f64)], left: f64) -> [([f64; RAYS.len()], u32); 3] {
    let area = 64.0 / pilot.pixels as f64;
    // The distance at which a place stays when a ray has to take away so much.
    let stays = |square: f64, gain: f64| {
        let gains = |n: &usize| square * FALL[n - 1] > gain * area * RAYS[*n];
        (1..RAYS.len()).rev().find(gains).unwrap_or(0)
    };
    let most = left * left;
    let remains = |gain: f64| places.iter().map(|(e, number)| number * e * FALL[stays(*e, gain)]).sum::<f64>();
    // Halves the logarithm's range until it is known to a hundredth.
    let (mut low, mut high) = (most * 1e-6, most * 1e6);
    for _ in 0..12 {
        let middle = (low * high).sqrt();
        if remains(middle) > most { high = middle } else { low = middle }
    }
    let first = pilot.rays as f64 / pilot.pixels as f64;
    let mut at = [0.0; RAYS.len()];
    for (e, number) in places {
        at[stays(*e, low)] += number * area;
    }
    // Dark places are known at once, whatever the distance.
    let with = |coarsest: usize| {
        let of = |n: usize| match n.cmp(&coarsest) {
            Ordering::Less => 0.0,
            Ordering::Equal => first * RAYS[n] / RAYS[0],
            Ordering::Greater => RAYS[n] * at[n..].iter().sum::<f64>(),
        };
        (std::array::from_fn(of), 4 >> coarsest)
    };
    [with(0), with(1), with(2)]
}

/// The largest distance of samples whose error is at most `most`: between the distances tried, errors rise by a
/// power; below the smallest they fall by the square, as for a field with kinks.
fn widest(pilot: &Pilot, most: f64) -> Option<Tried> {
    let least = *pilot.combs.first()?;
    if most <= 0.0 {
        return None;
    }
    if least.error > most {
        let step = least.comb.step * (most / least.error).sqrt();
        let noise = least.comb.noise.min(Comb::noise_of(2.0));
        return (step >= 0.25).then_some(Tried { comb: Comb { step, noise }, error: most });
    }
    let mut best = least;
    for pair in pilot.combs.windows(2) {
        let [low, high] = [pair[0], pair[1]];
        if high.error <= most {
            best = high;
            continue;
        }
        if low.error > 0.0 && low.error <= most && high.error > low.error {
            // Distances that fit the grid leave less than those between them, so that no steep fall is trusted.
            let (a, b) = (low.comb.step, high.comb.step);
            let power = ((high.error / low.error).ln() / (b / a).ln()).min(2.5);
            let least = high.error * (a / b).powf(power);
            if least > most {
                break;
            }
            let step = a * (most / least).powf(1.0 / power);
            let part = (step / a).ln() / (b / a).ln();
            let noise = low.comb.noise.powf(1.0 - part) * high.comb.noise.powf(part);
            best = Tried { comb: Comb { step, noise }, error: most };
        }
        break;
    }
    Some(best)
}

/// A voxel in the middle of a volume, in an image.
struct Voxel {
    /// Pixels along x and y from it to the next along each axis.
    steps: [[f64; 2]; 3],
}

impl Voxel {
    fn of(density: &Density, camera: &Camera) -> Self {
        let grid = density.volume().grid();
        let step = grid.index_to_world().matrix3;
        let middle = camera.project(grid.centre());
        let steps = [step.x_axis, step.y_axis, step.z_axis].map(|v| {
            let end = camera.project(grid.centre() + v);
            [end.0 - middle.0, end.1 - middle.1]
        });
        Self { steps }
    }

    /// Pixels along its side.
    fn side(&self) -> f64 {
        (0.5 * self.steps.iter().flatten().map(|s| s * s).sum::<f64>()).sqrt()
    }

    /// Pixels along x and y of a tent's footprint, which is two voxels wide along each of its axes.
    fn footprint(&self) -> [f64; 2] {
        [0, 1].map(|axis: usize| 2.0 * self.steps.iter().map(|s| s[axis].abs()).sum::<f64>())
    }
}

/// All voxels' footprints, whole or in parts; errors are what they are.
fn footprints<'a>(
    density: &'a Density,
    camera: &'a Camera,
    estimand: Estimand,
    costs: &'a Costs,
) -> impl Iterator<Item = Candidate> + 'a {
    let visited = (density.occupancy().count() * Occupancy::SIDE.pow(3)) as f64;
    let voxel = Voxel::of(density, camera);
    let [width, height] = voxel.footprint();
    let law = LAW * (1.0 + (voxel.side() / WIDE).powi(2)).sqrt();
    let pixels = camera.extent().pixels() as f64 * costs.pixel;
    (1..=PARTS).map(move |parts| {
        let options = FootprintOptions { estimand, refine: Refine::Cubic(parts), ..FootprintOptions::default() };
        let (number, part) = (footprints_in_all(density, &options) as f64, 1.0 / f64::from(parts));
        let each = costs.footprint + costs.add * (part * width + 1.0) * (part * height + 1.0);
        Candidate {
            method: Method::Footprint,
            samples: number as u64,
            step: part,
            adaptive: None,
            error: law * predicted_error(density, camera, &options),
            seconds: 1e-9 * (costs.tables + pixels + visited * costs.visit + number * each),
        }
    })
}

/// The Sobol net: a pixel's share of M samples errs by `(M / pixels)^-1/2` by chance, and by less in a net.
fn net(volume: &Volume, pixels: u64, costs: &Costs, error: f64) -> Candidate {
    let wanted = MARGIN * error;
    let samples = (pixels as f64 * wanted.powf(-1.0 / NET)).max(pixels as f64).log2().ceil().clamp(10.0, 36.0).exp2();
    let reached = (samples / pixels as f64).powf(-NET) / MARGIN;
    let fixed = volume.grid().len() as f64 * costs.distribution;
    Candidate {
        method: Method::Qmc,
        samples: samples as u64,
        step: 0.0,
        adaptive: None,
        error: reached,
        seconds: 1e-9 * (fixed + samples * costs.sample),
    }
}
