//! The picture so far, with its error bars.

use mcvr_sampling::Replicates;
use mcvr_scene::Image;
use rayon::prelude::*;

use crate::Bars;
use crate::bars::Interval;
use crate::contrasts::MOST;

/// An image and what is known of its error.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Linear values; of a coloured image the mean of its channels.
    pub image: Image,
    /// Red, green and blue, of a coloured image.
    pub colour: Option<[Image; 3]>,
    /// Error bars: one, or one of each channel.
    pub bars: Vec<Bars>,
}

impl Picture {
    /// Develops replicates of `samples` samples each, with intervals of a confidence.
    pub fn of(replicates: &Replicates<'_>, samples: u64, confidence: f64) -> Self {
        let mut planes: Vec<(Image, Bars)> =
            (0..replicates.channels()).map(|channel| plane(replicates, samples, confidence, channel)).collect();
        if planes.len() == 3 {
            let (images, bars): (Vec<Image>, Vec<Bars>) = planes.into_iter().unzip();
            // Three planes are three images.
            let colour = <[Image; 3]>::try_from(images).ok();
            let image = colour.as_ref().map_or_else(|| Image::zeros(replicates.camera().extent()), Image::mean_of);
            return Self { image, colour, bars };
        }
        let (image, bars) = planes.swap_remove(0);
        Self { image, colour: None, bars: vec![bars] }
    }
}

fn plane(replicates: &Replicates<'_>, samples: u64, confidence: f64, channel: usize) -> (Image, Bars) {
    let (number, extent) = (replicates.number(), replicates.camera().extent());
    let develop = replicates.developer(samples);
    let whole: f64 = (0..number)
        .map(|r| (0..extent.pixels()).map(|p| develop.value(replicates.sum(r, p, channel), channel)).sum::<f64>())
        .sum();
    let inside = replicates.counters().inside;
    let sample =
        if inside == 0 || whole == 0.0 { develop.value(replicates.heaviest(), channel) } else { whole / inside as f64 };
    let interval = Interval::new(number, samples, sample, confidence);
    let zeros = || Image::zeros(extent);
    let (mut image, mut error, mut low, mut high, mut unresolved) = (zeros(), zeros(), zeros(), zeros(), zeros());
    // Nothing to see: black, and exactly so.
    let blind = replicates.sees_nothing();
    let width = extent.width;
    let rows = image
        .values_mut()
        .par_chunks_mut(width)
        .zip(error.values_mut().par_chunks_mut(width))
        .zip(low.values_mut().par_chunks_mut(width))
        .zip(high.values_mut().par_chunks_mut(width))
        .zip(unresolved.values_mut().par_chunks_mut(width));
    let unresolved_pixels = rows
        .enumerate()
        .map(|(y, ((((image, error), low), high), unresolved))| {
            let (mut none, mut values) = (0, [0.0; MOST]);
            let values = &mut values[..number];
            for x in 0..width {
                for (r, v) in values.iter_mut().enumerate() {
                    *v = develop.value(replicates.sum(r, y * width + x, channel), channel);
                }
                image[x] = values.iter().sum::<f64>() / number as f64;
                if blind {
                    continue;
                }
                let found = interval.of(values);
                let bar = found.unwrap_or_else(|| interval.unresolved());
                (error[x], low[x], high[x]) = (bar.error, bar.low, bar.high);
                if found.is_none() {
                    unresolved[x] = 1.0;
                    none += 1;
                }
            }
            none
        })
        .sum();
    (image, Bars { error, low, high, unresolved, unresolved_pixels })
}
