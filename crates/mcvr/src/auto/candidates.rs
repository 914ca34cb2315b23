//! Every way to an error that is worth a thought, with what it would take.

use mcvr_footprint::{FootprintOptions, Refine, footprints_in_all, predicted_error};
use mcvr_raycast::Pilot;
use mcvr_scene::{Camera, Density, Estimand, Occupancy};
use mcvr_volume::Volume;

use super::{Candidate, Costs};
use crate::Method;

/// Predictions are held to this share of the error asked for: a pilot of some tens of lines errs by about a sixth, and more where a
/// few bright pixels carry the error.
pub(super) const MARGIN: f64 = 0.8;

/// Most pixels along the side of a block that shares a ray: larger ones save little.
const BLOCKS: u32 = 4;

/// Most parts of a voxel along its shortest side for footprints.
const PARTS: u32 = 3;

/// Most rays along a side of a pixel.
const SIDES: u32 = 32;

/// Error of one exact ray for blocks of `side` by `side` pixels; between the sides looked at, a power.
fn of_block(pilot: &Pilot, side: u32) -> f64 {
    let [two, four] = pilot.blocks;
    two * (four / two).max(1.0).powf((0.5 * f64::from(side)).log2())
}

/// Power of the number of rays by which a comb's error falls. Phases of a pixel's rays are stratified: 1 where the rays see the same, 1/2
/// where each sees something of its own. Measured: 0.88 to 0.95 on scans, 0.5 to 0.6 on phantoms with sharp faces.
const PHASES: f64 = 0.6;

/// Power of the number of rays along a pixel's side by which their error falls: about 2 where edges lie along the pixels, 2.4 to 2.7
/// where they cross them (measured on eight phantoms).
const AREA: f64 = 2.0;

/// Error of footprints as a share of what their law says: 0.15 to 0.7 on eight phantoms whose voxels are small beside [`WIDE`] pixels, and up
/// to 1.5 for tubes of one voxel that is 6 pixels wide, whose errors are not independent.
const LAW: f64 = 0.7;

/// Side of a voxel in pixels beyond which the law is not trusted to fall.
const WIDE: f64 = 2.8;

/// Power of the samples a pixel by which the net's error falls (METHOD section 4: 1/2 to 2/3).
const NET: f64 = 0.62;

/// Candidates that are expected to reach an error, and the most accurate ones where none does.
pub(super) fn candidates(
    density: &Density,
    camera: &Camera,
    estimand: Estimand,
    pilot: Option<&Pilot>,
    error: f64,
) -> Vec<Candidate> {
    let (volume, pixels) = (density.volume(), camera.extent().pixels() as u64);
    let costs = Costs::of(volume);
    let mut all = vec![net(volume, pixels, &costs, error)];
    let Some(pilot) = pilot else { return all };
    all.extend(footprints(density, camera, estimand, &costs));
    let wanted = MARGIN * error;
    let rays = (pilot.tiles * 64).min(pixels) as f64;
    let fixed = volume.bytes() as f64 * costs.occupancy + pixels as f64 * costs.pixel;
    // An exact setting of rays, and the widest comb whose error fits beside theirs; `fall` is what is left of a comb's error.
    let mut add = |samples: u64, each: f64, area: f64, fall: f64| {
        all.push(Candidate {
            method: Method::Rays,
            samples,
            step: 0.0,
            adaptive: None,
            error: area / MARGIN,
            seconds: 1e-9 * (fixed + each * (costs.ray + costs.cell * pilot.cells)),
        });
        let rest = (wanted * wanted - area * area).max(0.0).sqrt();
        if let Some((step, depth)) = widest(pilot, rest / fall) {
            all.push(Candidate {
                method: Method::Comb,
                samples,
                step,
                adaptive: None,
                error: area.hypot(depth * fall) / MARGIN,
                seconds: 1e-9 * (fixed + each * (costs.ray + costs.step * pilot.steps / step)),
            });
        }
    };
    for side in (2..=BLOCKS).rev() {
        let (area, blocks) = (of_block(pilot, side), f64::from(side * side));
        if area > 0.0 && area <= wanted {
            add((pixels as f64 / blocks).ceil() as u64, rays / blocks, area, Pilot::noise_of_block(side));
        }
    }
    // Where blocks would do, what averaging leaves was not looked at: it is less than what they leave.
    let left = pilot.left.unwrap_or_else(|| of_block(pilot, 2));
    for side in 1..=SIDES {
        let n = f64::from(side);
        let area = left * n.powf(-AREA);
        if area > wanted && side < SIDES {
            continue;
        }
        add(u64::from(side * side) * pixels, n * n * rays, area, Pilot::noise(side) * n.powf(-2.0 * PHASES));
        // More rays cost more; the next side is a candidate for wider combs only.
        if side > 1 && area < 0.5 * wanted {
            break;
        }
    }
    all
}

/// The largest distance of samples whose error is at most `most`, and its error: between the distances tried, errors rise by a
/// power; below the smallest they fall by the square, as for a field with kinks.
fn widest(pilot: &Pilot, most: f64) -> Option<(f64, f64)> {
    let (first, least) = *pilot.combs.first()?;
    if most <= 0.0 {
        return None;
    }
    if least > most {
        let step = first * (most / least).sqrt();
        return (step >= 0.25).then_some((step, most));
    }
    let mut best = (first, least);
    for pair in pilot.combs.windows(2) {
        let [(a, low), (b, high)] = [pair[0], pair[1]];
        if high <= most {
            best = (b, high);
            continue;
        }
        if low > 0.0 && low <= most && high > low {
            // Distances that fit the grid leave less than those between them, so that no steep fall is trusted.
            let power = ((high / low).ln() / (b / a).ln()).min(2.5);
            let low = high * (a / b).powf(power);
            if low > most {
                break;
            }
            best = (a * (most / low).powf(1.0 / power), most);
        }
        break;
    }
    Some(best)
}

/// All voxels' footprints, whole or in parts; errors are what they are.
fn footprints<'a>(
    density: &'a Density,
    camera: &'a Camera,
    estimand: Estimand,
    costs: &'a Costs,
) -> impl Iterator<Item = Candidate> + 'a {
    let visited = (density.occupancy().count() * Occupancy::SIDE.pow(3)) as f64;
    // Pixels that a footprint in the middle of the volume meets: a tent is two voxels wide along each of its axes.
    let grid = density.volume().grid();
    let step = grid.index_to_world().matrix3;
    let middle = camera.project(grid.centre());
    let steps = [step.x_axis, step.y_axis, step.z_axis].map(|v| {
        let end = camera.project(grid.centre() + v);
        [end.0 - middle.0, end.1 - middle.1]
    });
    let [width, height] = [0, 1].map(|axis: usize| 2.0 * steps.iter().map(|s| s[axis].abs()).sum::<f64>());
    let square = 0.5 * steps.iter().flatten().map(|s| s * s).sum::<f64>();
    let law = LAW * (1.0 + square / (WIDE * WIDE)).sqrt();
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
