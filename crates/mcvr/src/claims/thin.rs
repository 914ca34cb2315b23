//! "Thin structures are MCVR's weakness."

use std::collections::BTreeMap;

use mcvr_harness::Spread;
use mcvr_scene::{Image, Kernel};

use super::{Bench, Claim, ClaimError, Figure, Finding, MILLION, Unit, Verdict};
use crate::{Method, Request};

/// How many times larger the relative error of thin structures must be to count as a weakness.
pub const WEAK: f64 = 1.25;
/// Fewest pixels of a kind that a verdict rests on.
pub const FEWEST: usize = 50;

/// Pixels darker than this share of the brightest belong to no object.
const OBJECT: f64 = 1e-3;
/// Pixels that an opening takes more than this share of are thin structures.
const VANISHES: f64 = 0.5;
/// Half the side of the opening's square: 5 × 5 pixels.
const REACH: usize = 2;
/// Fewest pixels of either kind in a class of brightness.
const FEWEST_IN_CLASS: usize = 20;
/// Classes of brightness in each doubling.
const CLASSES: f64 = 2.0;

pub(super) const CLAIM: Claim = Claim {
    name: "thin-structures",
    quote: "thin structures are MCVR's weakness",
    tested: "relative error (RMSE in a class of pixels over the class's mean truth) of thin structures, which lose more than half \
             of their brightness when the truth is opened by 5×5 pixels, over that of the rest of the object, at 10^6; also \
             between pixels of equal brightness (half octaves)",
    criterion: "mc: holds if the relative error of thin structures is at least 1.25 times that of the rest, also at equal brightness; \
                in part if only in all, so that it is faint pixels that are weak; at least 50 pixels of either kind",
    measure,
};

/// The verdict on the relative error of thin structures over that of the rest: in all, and at equal brightness.
pub fn judge(in_all: f64, at_equal_brightness: f64) -> Verdict {
    if in_all < WEAK {
        // Whatever is the case at equal brightness, which not every image can tell.
        return Verdict::DoesNotHold;
    }
    Verdict::ladder(&[in_all, at_equal_brightness], at_equal_brightness >= WEAK, true)
}

/// Morphological opening: the smallest, then the largest value of each square; bright structures narrower than it vanish.
fn open(image: &Image) -> Vec<f64> {
    let (width, height) = (image.extent().width, image.extent().height);
    let pass = |from: &[f64], along_x: bool, pick: fn(f64, f64) -> f64| -> Vec<f64> {
        let around = |at: usize, end: usize| at.saturating_sub(REACH)..=(at + REACH).min(end - 1);
        let value = |i: usize| {
            let (x, y) = (i % width, i / width);
            let line: Box<dyn Iterator<Item = usize>> = match along_x {
                true => Box::new(around(x, width).map(move |x| y * width + x)),
                false => Box::new(around(y, height).map(move |y| y * width + x)),
            };
            line.map(|j| from[j]).reduce(pick).unwrap_or(from[i])
        };
        (0..from.len()).map(value).collect()
    };
    let eroded = pass(&pass(image.values(), true, f64::min), false, f64::min);
    pass(&pass(&eroded, true, f64::max), false, f64::max)
}

/// The pixels of an object, by kind.
struct Kinds<'a> {
    truth: &'a Image,
    thin: Vec<usize>,
    rest: Vec<usize>,
    /// The faintest and the brightest quarter of both.
    faint: Vec<usize>,
    bright: Vec<usize>,
}

impl<'a> Kinds<'a> {
    fn of(truth: &'a Image) -> Self {
        let values = truth.values();
        let opened = open(truth);
        let mut object: Vec<usize> = (0..values.len()).filter(|&i| values[i] > OBJECT * truth.max()).collect();
        let (thin, rest) = object.iter().partition(|&&i| values[i] - opened[i] > VANISHES * values[i]);
        object.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
        let quarter = object.len() / 4;
        let (faint, bright) = (object[..quarter].to_vec(), object[object.len() - quarter..].to_vec());
        Self { truth, thin, rest, faint, bright }
    }

    /// RMSE of an image in some pixels over their mean truth.
    fn error(&self, image: &Image, pixels: &[usize]) -> f64 {
        let (values, truth) = (image.values(), self.truth.values());
        let squares: f64 = pixels.iter().map(|&i| (values[i] - truth[i]).powi(2)).sum();
        let (n, sum) = (pixels.len() as f64, pixels.iter().map(|&i| truth[i]).sum::<f64>());
        (squares / n).sqrt() / (sum / n)
    }

    /// Error of the thin over that of the rest.
    fn in_all(&self, image: &Image) -> f64 {
        self.error(image, &self.thin) / self.error(image, &self.rest)
    }

    /// The same between pixels of equal brightness: the mean logarithm over classes, each weighed by the scarcer kind. Not a
    /// number where no class has enough of both.
    fn at_equal_brightness(&self, image: &Image) -> f64 {
        let peak = self.truth.max();
        let mut classes = BTreeMap::<i64, [Vec<usize>; 2]>::new();
        for (kind, pixels) in [&self.thin, &self.rest].into_iter().enumerate() {
            for &i in pixels {
                let class = (CLASSES * (self.truth.values()[i] / peak).log2()).floor() as i64;
                classes.entry(class).or_default()[kind].push(i);
            }
        }
        let usable = classes.values().filter(|c| c.iter().all(|pixels| pixels.len() >= FEWEST_IN_CLASS));
        let (mut sum, mut weights) = (0.0, 0.0);
        for [thin, rest] in usable {
            let weight = thin.len().min(rest.len()) as f64;
            sum += weight * (self.error(image, thin) / self.error(image, rest)).ln();
            weights += weight;
        }
        (sum / weights).exp()
    }
}

fn measure(bench: &Bench<'_>) -> Result<Finding, ClaimError> {
    let kinds = Kinds::of(&bench.truth()?.image);
    if kinds.thin.len() < FEWEST || kinds.rest.len() < FEWEST {
        return Err(ClaimError::NotTestable(format!(
            "{} pixels of thin structures and {} of the rest of the object: a verdict takes {FEWEST} of either",
            kinds.thin.len(),
            kinds.rest.len()
        )));
    }
    let mut figures = vec![];
    let mut deciding = None;
    for method in [Method::Mc, Method::Qmc] {
        bench.say(&format!("errors of thin structures, {method}"));
        let images: Vec<Image> = (0..u64::from(bench.options.repeats.max(1)))
            .map(|i| {
                let seed = bench.request.seed.wrapping_add(i);
                Ok(bench.make(&Request { seed, ..bench.with(method, MILLION) })?.image)
            })
            .collect::<Result<_, ClaimError>>()?;
        let over = |of: &dyn Fn(&Image) -> f64| Spread::of(images.iter().map(of).collect());
        let (all, equal) = (over(&|i| kinds.in_all(i)), over(&|i| kinds.at_equal_brightness(i)));
        figures.push(Figure::spread(format!("thin over rest, {method}"), all, Unit::Ratio));
        if equal.median.is_finite() {
            figures.push(Figure::spread(format!("the same at equal brightness, {method}"), equal, Unit::Ratio));
        }
        for (name, pixels) in [
            ("thin", &kinds.thin),
            ("rest", &kinds.rest),
            ("faintest quarter", &kinds.faint),
            ("brightest quarter", &kinds.bright),
        ] {
            figures.push(Figure::spread(
                format!("error of {name}, {method}"),
                over(&|i| kinds.error(i, pixels)),
                Unit::Share,
            ));
        }
        deciding = deciding.or(Some((all, equal)));
    }
    if bench.request.kernel != Kernel::Shell {
        let march = bench.make(&bench.one_ray(1.0))?.image;
        figures.push(Figure::plain("error of thin, ray march", kinds.error(&march, &kinds.thin), Unit::Share));
        figures.push(Figure::plain("error of rest, ray march", kinds.error(&march, &kinds.rest), Unit::Share));
    }
    figures.push(Figure::plain("pixels of thin structures", kinds.thin.len() as f64, Unit::Count));
    figures.push(Figure::plain("pixels of the rest", kinds.rest.len() as f64, Unit::Count));
    let Some((all, equal)) = deciding else {
        return Err(ClaimError::NotTestable("no method was measured".into()));
    };
    let verdict = judge(all.median, equal.median);
    let ends = [judge(all.min, equal.min), judge(all.max, equal.max)];
    let note = if verdict == Verdict::NotTestable {
        "No class of brightness has 20 pixels of either kind, so that thin and faint cannot be told apart here."
    } else {
        "Theory: a pixel's relative error is 1/√(samples in it), whatever the shape around it. What the kernel's blur \
         takes from thin structures is no noise and not in this table; the study of thin structures in bench-results has it."
    };
    Ok(Finding::new(verdict, &ends, figures, note))
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_scene::Extent;

    /// A square of 20 × 20 and a line two pixels wide, both of brightness 1, on 60 × 60 pixels.
    fn truth() -> Image {
        let value = |i: usize| {
            let (x, y) = (i % 60, i / 60);
            f64::from((5..25).contains(&x) && (5..25).contains(&y) || (40..42).contains(&x) && (2..58).contains(&y))
        };
        Image::from_values(Extent::new(60, 60).unwrap(), (0..3600).map(value).collect()).unwrap()
    }

    #[test]
    fn a_line_is_thin_and_a_square_is_not() {
        let truth = truth();
        let kinds = Kinds::of(&truth);
        assert_eq!((kinds.thin.len(), kinds.rest.len()), (2 * 56, 400));
        assert!(kinds.thin.iter().all(|i| (40..42).contains(&(i % 60))));
    }

    #[test]
    fn errors_are_relative_to_the_class_and_equal_errors_at_equal_brightness_give_one() {
        let truth = truth();
        let kinds = Kinds::of(&truth);
        let off = |thin: f64| {
            let value = |i: usize| truth.values()[i] * if i % 60 >= 40 { 1.0 + thin } else { 1.1 };
            Image::from_values(truth.extent(), (0..3600).map(value).collect()).unwrap()
        };
        assert!((kinds.error(&off(0.3), &kinds.thin) - 0.3).abs() < 1e-12);
        assert!((kinds.in_all(&off(0.3)) - 3.0).abs() < 1e-9);
        assert!((kinds.at_equal_brightness(&off(0.1)) - 1.0).abs() < 1e-9);
    }
}
