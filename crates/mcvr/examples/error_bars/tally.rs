//! How often intervals hold the truth, counted repeat by repeat.

use mcvr::MadeRefined;
use serde::{Deserialize, Serialize};

use crate::Outcome;
use crate::statistics::{Figure, mean, ratio};
use crate::strata::Group;
use crate::truths::Truth;

/// Samples of a pixel, over all repeats, from which its mean is taken for normal and its variance for known.
pub const ENOUGH: f64 = 1000.0;

/// What one repeat says of a group of pixels.
#[derive(Clone, Copy, Default)]
struct Held {
    resolved: f64,
    /// Of the resolved, those whose interval holds the truth.
    interval: f64,
    unresolved: f64,
    /// Of the unresolved, those whose bound holds it.
    bound: f64,
    /// Sum of (image - truth).
    off: f64,
    /// Sum of (image - truth) / standard error.
    studentised: f64,
}

/// What one repeat says.
pub struct Repeat {
    groups: Vec<Held>,
    /// Squared relative RMSE as the image estimates it, and as it is.
    pub squares: (f64, f64),
}

/// Sums over repeats, pixel by pixel: image - truth, its square, the interval's width, the squared standard error.
pub struct Pixels(Vec<[f64; 4]>);

impl Pixels {
    pub fn new(pixels: usize) -> Self {
        Self(vec![[0.0; 4]; pixels])
    }

    pub fn add(&mut self, other: &Self) {
        for (a, b) in self.0.iter_mut().flatten().zip(other.0.iter().flatten()) {
            *a += b;
        }
    }

    /// Mean of image - truth and the true variance of the image.
    fn moments(&self, pixel: usize, repeats: f64) -> (f64, f64) {
        let [off, square, ..] = self.0[pixel];
        let mean = off / repeats;
        (mean, (square / repeats - mean * mean).max(0.0) * repeats / (repeats - 1.0))
    }

    /// The largest deviation of a pixel's mean from the truth, in standard errors, the truth's own included, of pixels with enough
    /// samples in all repeats together; and their number.
    pub fn worst(&self, expected: &[f64], truth: &Truth, repeats: f64) -> (f64, usize) {
        let deviation = |p: usize| {
            let (off, variance) = self.moments(p, repeats);
            off.abs() / (variance / repeats).sqrt().hypot(truth.error.values()[p])
        };
        let judged = (0..self.0.len()).filter(|&p| expected[p] * repeats >= ENOUGH);
        (judged.clone().map(deviation).fold(0.0, f64::max), judged.count())
    }
}

/// Counts one image, and adds it to the sums of the pixels.
pub fn count(made: &MadeRefined, truth: &Truth, groups: &[Group], pixels: &mut Pixels) -> Outcome<Repeat> {
    let bars = made.bars.first().ok_or("an image without error bars")?;
    let (image, truths) = (made.made.image.values(), truth.image.values());
    let layers = [&bars.error, &bars.low, &bars.high, &bars.unresolved].map(|i| i.values());
    let [error, low, high, unresolved] = layers;
    for (p, sums) in pixels.0.iter_mut().enumerate() {
        let off = image[p] - truths[p];
        for (sum, v) in sums.iter_mut().zip([off, off * off, high[p] - low[p], error[p] * error[p]]) {
            *sum += v;
        }
    }
    let of = |group: &Group| {
        let mut held = Held::default();
        for &p in &group.pixels {
            let holds = f64::from(u8::from((low[p]..=high[p]).contains(&truths[p])));
            held.off += image[p] - truths[p];
            held.studentised += (image[p] - truths[p]) / error[p];
            if unresolved[p] == 1.0 {
                held.unresolved += 1.0;
                held.bound += holds;
            } else {
                held.resolved += 1.0;
                held.interval += holds;
            }
        }
        held
    };
    let estimate = made.made.error.ok_or("an image that does not know its error")?;
    let squares = (estimate.powi(2), truth.distance(&made.made.image).powi(2));
    Ok(Repeat { groups: groups.iter().map(of).collect(), squares })
}

/// What all repeats say of a group of pixels.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Coverage {
    pub name: String,
    pub pixels: usize,
    /// Samples that a pixel expects: the least and the median of the group.
    pub expected: [f64; 2],
    /// Share of all intervals that hold the truth, bounds of pixels without samples included.
    pub share: Figure,
    /// Share of pixels without samples.
    pub unresolved: f64,
    /// How often the bound of those holds.
    pub bound: Option<Figure>,
    /// Share of the intervals of the other pixels that hold.
    pub interval: Option<Figure>,
    /// Mean width over the true standard error, averaged over the pixels with [`ENOUGH`] samples; `None` where there are none.
    pub width: Option<f64>,
    /// Mean squared standard error over the true variance, likewise.
    pub variance: Option<f64>,
    /// Sum of (image - truth) over the sum of the truth. Its standard error includes the truth's own.
    pub bias: Figure,
    /// Mean of (image - truth) / standard error; not 0 where few samples fall, as faint pixels have short bars.
    pub studentised: Figure,
}

/// Sums up the `n`-th group.
pub fn coverage(
    group: &Group,
    n: usize,
    repeats: &[Repeat],
    sums: &Pixels,
    expected: &[f64],
    truth: &Truth,
) -> Option<Coverage> {
    let held = repeats.iter().map(|r| r.groups[n]);
    let (number, all) = (repeats.len() as f64, group.pixels.len() as f64);
    let mut samples: Vec<f64> = group.pixels.iter().map(|&p| expected[p]).collect();
    samples.sort_by(f64::total_cmp);
    let light: f64 = group.pixels.iter().map(|&p| truth.image.values()[p]).sum();
    let known = group.pixels.iter().filter(|&&p| expected[p] * number >= ENOUGH).map(|&p| {
        let (_, variance) = sums.moments(p, number);
        let [_, _, width, square] = sums.0[p];
        (width / number / variance.sqrt(), square / number / variance)
    });
    let (width, variance): (Vec<f64>, Vec<f64>) = known.unzip();
    let average = |v: &[f64]| (!v.is_empty()).then(|| v.iter().sum::<f64>() / v.len() as f64);
    let mut bias = mean(held.clone().map(|h| h.off / light));
    let own: f64 = group.pixels.iter().map(|&p| truth.error.values()[p].powi(2)).sum();
    bias.error = bias.error.hypot(own.sqrt() / light);
    Some(Coverage {
        name: group.name.clone(),
        pixels: group.pixels.len(),
        expected: [*samples.first()?, samples[samples.len() / 2]],
        share: mean(held.clone().map(|h| (h.interval + h.bound) / all)),
        unresolved: mean(held.clone().map(|h| h.unresolved / all)).value,
        bound: ratio(held.clone().map(|h| (h.bound, h.unresolved))),
        interval: ratio(held.clone().map(|h| (h.interval, h.resolved))),
        width: average(&width),
        variance: average(&variance),
        bias,
        studentised: mean(held.map(|h| h.studentised / all)),
    })
}
