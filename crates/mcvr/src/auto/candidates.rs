//! Every way to an error that is worth a thought, with what it would take.

use mcvr_raycast::Pilot;
use mcvr_volume::Volume;

use super::{Candidate, Costs};
use crate::Method;

/// Predictions are held to this share of the error asked for: a pilot of some tens of tiles errs by about a quarter, and more where a
/// few bright pixels carry the error. At 0.75, a fifth of the choices on 18 scans missed their error (by up to 2.2 times).
const MARGIN: f64 = 0.6;

/// Most rays along a side of a pixel.
const SIDES: u32 = 32;

/// The second term of the formula for pixel means over the first: how rough the image is at the pixels' scale (0.23 for noise).
fn roughness(pilot: &Pilot) -> f64 {
    if pilot.bend > 0.0 { pilot.bend_twice / pilot.bend } else { 0.0 }
}

/// What averaging over pixels leaves of the first term of its formula, for one ray a pixel: the formula holds for smooth images. Measured
/// at 400×400 on three scans (0.26 at a roughness of 0.122, 0.32 at 0.127, 0.73 at 0.149) and on phantoms at 96×80 (1.3 to 2 at 0.19
/// to 0.2).
fn left(pilot: &Pilot) -> f64 {
    0.3 * (roughness(pilot) / 0.123).powi(4).clamp(0.5, 10.0)
}

/// Power of the number of rays by which a comb's error falls. Phases of a pixel's rays are stratified: 1 where the rays see the same, 1/2
/// where each sees something of its own. Measured: 0.88 to 0.95 on four scans up to a roughness of 0.15; less than 1/2 to 0.6 on a
/// phantom at 0.17.
fn phases(pilot: &Pilot) -> f64 {
    (0.95 - 0.45 * (roughness(pilot) - 0.15) / 0.02).clamp(0.5, 0.95)
}

/// Power of the number of rays along a pixel's side by which that falls: 2 for an image with edges (measured on scans 2.4 to 2.6).
const AREA: f64 = 2.0;

/// Power of the samples a pixel by which the net's error falls (METHOD section 4: 1/2 to 2/3).
const NET: f64 = 0.62;

/// Candidates that are expected to reach an error, and the most accurate ones where none does.
pub(super) fn candidates(volume: &Volume, pixels: u64, pilot: Option<&Pilot>, error: f64) -> Vec<Candidate> {
    let costs = Costs::of(volume);
    let mut all = vec![net(volume, pixels, &costs, error)];
    let Some(pilot) = pilot else { return all };
    let wanted = MARGIN * error;
    let (left, phases) = (left(pilot), phases(pilot));
    let rays = (pilot.tiles * 64).min(pixels) as f64;
    let fixed = volume.bytes() as f64 * costs.occupancy;
    for side in 1..=SIDES {
        let n = f64::from(side);
        let area = left * pilot.bend * n.powf(-AREA);
        if area > wanted && side < SIDES {
            continue;
        }
        let each = n * n * rays;
        let exact = Candidate {
            method: Method::Rays,
            samples: u64::from(side * side) * pixels,
            step: 0.0,
            error: area / MARGIN,
            seconds: 1e-9 * (fixed + each * (costs.ray + costs.cell * pilot.cells)),
        };
        all.push(exact);
        // The widest comb whose error fits beside the area's.
        let rest = (wanted * wanted - area * area).max(0.0).sqrt();
        let fall = Pilot::noise(side) * n.powf(-2.0 * phases);
        if let Some((step, depth)) = widest(pilot, rest / fall) {
            let depth = depth * fall;
            all.push(Candidate {
                method: Method::Comb,
                samples: u64::from(side * side) * pixels,
                step,
                error: area.hypot(depth) / MARGIN,
                seconds: 1e-9 * (fixed + each * (costs.ray + costs.step * pilot.steps / step)),
            });
        }
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
        error: reached,
        seconds: 1e-9 * (fixed + samples * costs.sample),
    }
}
