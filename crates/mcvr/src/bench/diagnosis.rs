//! What a changed image means: other samples of the same image, or another image.

use mcvr_scene::{Image, Watch};

use super::BenchError;
use super::accuracy::{Case, Figure, Studio, Truth, compare};
use crate::{Method, Request, make};

/// Seeds that a bias is looked for with.
const SEEDS: u64 = 24;
/// Standard deviations beyond which a deviation is no chance. This only words a note: the case has failed by its hash.
const BEYOND_CHANCE: f64 = 6.0;
/// Relative change of the error below which it is rounding.
const ROUNDING: f64 = 1e-6;

/// Says what probably changed about a case whose image or error did.
pub(super) fn diagnose(
    studio: &mut Studio,
    case: &Case,
    before: &Figure,
    now: &Figure,
    watch: &Watch<'_>,
) -> Result<String, BenchError> {
    if before.sha256 == now.sha256 {
        return Ok("the image is the same; the truth that it is held to changed".into());
    }
    let work = if before.counters == now.counters { "same work counters" } else { "other work counters" };
    let close = |a: f64, b: f64| (a - b).abs() <= ROUNDING * a.abs().max(b.abs());
    if close(before.mean, now.mean) && before.error.zip(now.error).is_some_and(|(a, b)| close(a, b)) {
        return Ok(format!("{work}, mean and error the same to 1e-6: other rounding"));
    }
    let mean = format!("mean pixel {:+.3} %", 100.0 * (now.mean / before.mean - 1.0));
    match case.request.method {
        Method::Exact => return Ok(format!("{work}, {mean}: the truth itself changed")),
        Method::March => return Ok(format!("{work}, {mean}: a march has no seed; its arithmetic changed")),
        Method::Footprint => return Ok(format!("{work}, {mean}: footprints have no seed; their arithmetic changed")),
        _ => {}
    }
    let scenery = studio.scenery(case);
    let Some(truth) = studio.truth(case, watch)?.cloned() else {
        return Ok(format!("{work}, {mean}; no ray caster knows this kernel, so whether it is still unbiased is open"));
    };
    let image = |seed| {
        let made = make(&scenery, &Request { seed: 90_000 + seed, ..case.request }, watch)?;
        Ok::<Image, BenchError>(made.measurable()?.into_owned())
    };
    let images = (0..SEEDS).map(image).collect::<Result<Vec<_>, _>>()?;
    let bias = Bias::of(&images, &truth)?;
    Ok(if bias.z > BEYOND_CHANCE {
        format!(
            "{work}; BIASED: over {SEEDS} seeds the mean image is {:.2} % RMS from the truth beyond chance (z = {:.0}), its mean \
             pixel {:+.2} %",
            100.0 * bias.rms,
            bias.z,
            100.0 * bias.shift
        )
    } else {
        format!(
            "{work}, unbiased over {SEEDS} seeds (z = {:.1}): other samples, as of a changed seed, stream or order",
            bias.z
        )
    })
}

/// How far the mean of replicates lies from the truth.
///
/// Let `d` be the mean difference of a pixel over R seeds and `s²` the sample variance. Without a bias `E d² = σ²/R`, so
/// `D = Σ d² − Σ s²/R` is 0 in expectation, with variance `Σ 2σ⁴/R² (1 + 1/(R−1))` for normal, independent pixels. What the
/// truth may itself be wrong by is taken off.
struct Bias {
    /// `D` over its standard deviation.
    z: f64,
    /// `√(D/N)` over the truth's mean.
    rms: f64,
    /// Mean pixel of the mean image against the truth's, relative.
    shift: f64,
}

impl Bias {
    fn of(images: &[Image], truth: &Truth) -> Result<Self, BenchError> {
        let (r, scale) = (images.len() as f64, truth.image.mean().abs());
        let pixels = truth.image.values();
        let (mut excess, mut variance) = (0.0, 0.0);
        for (p, expected) in pixels.iter().enumerate() {
            let values = images.iter().map(|i| i.values()[p] - expected);
            let d = values.clone().sum::<f64>() / r;
            let s2 = values.map(|v| (v - d).powi(2)).sum::<f64>() / (r - 1.0);
            excess += d * d - s2 / r;
            variance += 2.0 * (s2 / r).powi(2) * (1.0 + 1.0 / (r - 1.0));
        }
        let n = pixels.len() as f64;
        let beyond = (excess - n * (truth.error * scale).powi(2)).max(0.0);
        let z = if beyond == 0.0 { 0.0 } else { beyond / variance.sqrt() };
        let shifts = images.iter().map(|i| Ok(compare(i, &truth.image)?.bias.unwrap_or(0.0)));
        let shift = shifts.sum::<Result<f64, BenchError>>()? / r;
        Ok(Self { z, rms: (beyond / n).sqrt() / scale, shift })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::accuracy::cases;
    use mcvr_scene::Kernel;

    fn case(name: &str) -> Case {
        cases().unwrap().into_iter().find(|c| c.name == name).unwrap()
    }

    fn figure(studio: &mut Studio, case: &Case) -> Figure {
        studio.figure(case, &Watch::default()).unwrap()
    }

    #[test]
    fn another_seed_is_told_from_a_bias() {
        for name in ["mc/tent/line/plain", "qmc/box/count/plain", "stratified/tent/line/shading"] {
            let mut studio = Studio::new().unwrap();
            let case = case(name);
            let now = figure(&mut studio, &case);
            let seed = Case { request: Request { seed: 7, ..case.request }, ..case.clone() };
            let other = figure(&mut studio, &seed);
            let note = diagnose(&mut studio, &case, &other, &now, &Watch::default()).unwrap();
            assert!(note.contains("unbiased over 24 seeds"), "{name}: {note}");
        }
    }

    #[test]
    fn images_of_another_kernel_are_biased() {
        let mut studio = Studio::new().unwrap();
        let tent = case("mc/tent/line/plain");
        // A tent that is drawn as a B-spline would be.
        let truth = studio.truth(&tent, &Watch::default()).unwrap().unwrap().clone();
        let wrong = Request { kernel: Kernel::Bspline3, ..tent.request };
        let of = |request: Request| -> Vec<Image> {
            (0..SEEDS)
                .map(|seed| {
                    make(&studio.scenery(&tent), &Request { seed, ..request }, &Watch::default()).unwrap().image
                })
                .collect()
        };
        let [biased, fair] = [wrong, tent.request].map(|r| Bias::of(&of(r), &truth).unwrap());
        assert!(biased.z > BEYOND_CHANCE && fair.z < BEYOND_CHANCE, "{} {}", biased.z, fair.z);
    }

    #[test]
    fn rounding_and_a_changed_truth_are_named() {
        let mut studio = Studio::new().unwrap();
        let case = case("qmc/tent/line/plain");
        let now = figure(&mut studio, &case);
        let rounded = Figure { sha256: "other".into(), mean: now.mean * (1.0 + 1e-12), ..now.clone() };
        let note = diagnose(&mut studio, &case, &rounded, &now, &Watch::default()).unwrap();
        assert!(note.contains("other rounding"), "{note}");
        let moved = Figure { error: now.error.map(|e| e * 1.1), ..now.clone() };
        let note = diagnose(&mut studio, &case, &moved, &now, &Watch::default()).unwrap();
        assert!(note.contains("the truth that it is held to changed"), "{note}");
    }
}
