//! "A million samples are near convergence."

use mcvr_harness::Spread;
use mcvr_scene::Image;
use mcvr_scene::film::Tone;

use super::{Bench, Claim, ClaimError, Figure, Finding, MILLION, Unit, Verdict};
use crate::{Method, Request};

/// Largest error of a converged image, RMSE over the mean pixel.
pub const CONVERGED: f64 = 0.01;
/// Largest share of pixels that the eye may see to be off.
pub const SEEN: f64 = 0.05;
/// Grey levels of 255 from which on a pixel counts as seen to be off: 3 % of the range.
pub const LEVELS: f64 = 8.0;

/// Most samples of the direct run.
const DIRECT: u64 = 1 << 31;

pub(super) const CLAIM: Claim = Claim {
    name: "convergence",
    quote: "a million samples are near convergence",
    tested: "mc against the ray-cast truth: error (RMSE over the mean pixel) at 10^6 and 4·10^6, samples for 1 % by the law \
             M^(-1/2) and by a direct run (up to 2^31), grey levels as the eye has them",
    criterion: "holds if the error at 10^6 is at most 1 %; in part if at most 5 % of the pixels are more than 8 of 255 grey \
                levels off, so that the eye hardly sees it",
    measure,
};

/// The verdict on the error at a million samples and on the share of pixels that are seen to be off.
pub fn judge(error: f64, seen: f64) -> Verdict {
    Verdict::ladder(&[error, seen], error <= CONVERGED, seen <= SEEN)
}

/// Share of pixels whose grey levels differ by more than [`LEVELS`], both images toned with the window of the truth.
fn seen(image: &Image, truth: &Image) -> f64 {
    let tone = Tone::default();
    let limits = tone.limits(truth);
    let levels = |i: &Image| tone.apply(i, limits).into_iter().map(|g| (255.0 * g).round());
    let off = levels(image).zip(levels(truth)).filter(|(a, b)| (a - b).abs() > LEVELS).count();
    off as f64 / image.values().len() as f64
}

fn measure(bench: &Bench<'_>) -> Result<Finding, ClaimError> {
    let truth = bench.truth()?;
    bench.say("errors at 10^6 and 4·10^6 samples");
    let request = bench.with(Method::Mc, MILLION);
    let errors = bench.errors(&request)?;
    let fourfold = bench.errors(&Request { samples: 4 * MILLION, ..request })?;
    let ratios: Vec<f64> = fourfold.iter().zip(&errors).map(|(four, one)| four / one).collect();
    let error = Spread::of(errors);
    let share = seen(&bench.make(&request)?.image, &truth.image);
    // M^(-1/2): an error k times smaller takes k² times the samples.
    let needed = MILLION as f64 * (error.median / CONVERGED).powi(2);
    let mut figures = vec![
        Figure::spread("error at 10^6", error, Unit::Share),
        Figure::plain("pixels more than 8 grey levels off", share, Unit::Share),
        Figure::spread("error at 4·10^6 over that at 10^6", Spread::of(ratios), Unit::Ratio),
        Figure::plain("samples for 1 %, by M^(-1/2)", needed, Unit::Samples),
    ];
    if needed <= DIRECT as f64 {
        bench.say(&format!("a direct run with {needed:.2e} samples"));
        let made = bench.make(&Request { samples: needed.ceil() as u64, ..request })?;
        figures.push(Figure::plain("error of a direct run with that many", bench.error_of(&made)?, Unit::Share));
        figures.push(Figure::plain("its time", made.seconds.complete, Unit::Seconds));
    }
    figures.push(Figure::plain("error of the truth, by its own estimate", truth.rel_error_estimate, Unit::Share));
    let ends = [judge(error.min, share), judge(error.max, share)];
    let direct = if needed > DIRECT as f64 { " No direct run: it would take more than 2^31 samples." } else { "" };
    let note = format!("Four times the samples halve the error of a method that is not converged.{direct}");
    Ok(Finding::new(judge(error.median, share), &ends, figures, note))
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_scene::Extent;

    #[test]
    fn the_eye_sees_differences_of_more_than_eight_levels_in_the_window_of_the_truth() {
        let image =
            |values: &[f64]| Image::from_values(Extent::new(values.len(), 1).unwrap(), values.to_vec()).unwrap();
        let truth = image(&[0.0, 100.0, 100.0, 255.0]);
        assert_eq!(seen(&truth, &truth), 0.0);
        assert_eq!(seen(&image(&[0.0, 108.0, 109.0, 400.0]), &truth), 0.25);
    }
}
