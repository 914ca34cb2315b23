//! An image and how well it is known, in files.
//!
//! OpenEXR keeps such figures as *layers* of one picture: a layer is a prefix of channel names, joined by a dot, as in `stderr.Y`
//! (*Technical Introduction to OpenEXR*, "Channel Names" and "Layers"; `Y` is its name for luminance, the one channel of a grey
//! picture). All layers stand in one part, not in a part each, since programs that know no parts then still show the picture:
//! they look for R, G and B and leave the rest alone. A grey picture has equal R, G and B here for the same reason, as
//! [`write()`](super::write()) has it.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image as ExrImage, Layer};
use exr::meta::attribute::{AttributeValue, Text};
use exr::meta::header::LayerAttributes;
use exr::prelude::WritableImage;
use npyz::WriterBuilder;

use super::file::{check_floats, fail, write_whole};
use super::{Image, ImageFormat, Tone, write, write_colour};
use crate::{Extent, SceneError};

/// How well every pixel of an image, or of one of its three channels, is known. All have the image's size and unit.
///
/// In OpenEXR files these are layers, that is, prefixes of channel names: `stderr.Y` belongs to a grey image, `stderr.R`,
/// `stderr.G` and `stderr.B` to a coloured one.
///
/// | layer | a pixel's value |
/// |---|---|
/// | none: R, G, B | the estimate; of a grey image, three times the same |
/// | `stderr` | standard error of the estimate, in the estimate's unit |
/// | `low`, `high` | ends of its confidence interval, in the same unit |
/// | `unresolved` | 1 where no sample fell, else 0: there a standard error of 0 says nothing |
///
/// The header's attribute `confidence` (`double`) is the level of the intervals, 0.95 for 95 %. Values are 32-bit floats, rounded
/// to the nearest and packed without loss (ZIP).
#[derive(Clone, Copy, Debug)]
pub struct ErrorBars<'a> {
    /// Standard error of the estimate, as a standard deviation.
    pub error: &'a Image,
    /// Lower end of the confidence interval.
    pub low: &'a Image,
    /// Upper end of the confidence interval.
    pub high: &'a Image,
    /// 1 where no sample fell, else 0.
    pub unresolved: &'a Image,
}

impl<'a> ErrorBars<'a> {
    /// Names of the layers in EXR files, in the order of an array's first axis.
    pub const LAYERS: [&'static str; 4] = ["stderr", "low", "high", "unresolved"];

    fn layers(&self) -> [&'a Image; 4] {
        [self.error, self.low, self.high, self.unresolved]
    }
}

/// Writes an image with its error bars where the format has layers, which is EXR; all others get the image alone.
///
/// `channels` is one grey image, or red, green and blue. `bars` has one entry for each, or a single one for all channels
/// together; entries for red, green and blue give the channels `stderr.R`, `stderr.G`, `stderr.B`, and so on. `confidence` is the
/// level of the intervals, in 0..1.
///
/// # Errors
/// [`SceneError::File`] when there are other numbers of channels or bars, sizes differ, a number is too large for a 32-bit float,
/// the folder is missing or not writable, or the disk is full.
pub fn write_with_error(
    channels: &[Image],
    bars: &[ErrorBars<'_>],
    confidence: f64,
    path: &Path,
    format: ImageFormat,
    tone: &Tone,
) -> Result<(), SceneError> {
    let channels: Vec<&Image> = channels.iter().collect();
    check(&channels, bars).map_err(|problem| fail(path, problem))?;
    match format {
        ImageFormat::Exr => write_whole(path, |out| write_exr(&channels, bars, confidence, out)),
        _ => picture(&channels, path, format, tone),
    }
}

/// Writes error bars alone.
///
/// - NPY: `<f8` of shape (4, height, width): standard error, low, high, unresolved; of (4, 3, height, width) for bars of red,
///   green and blue.
/// - EXR: the same layers as [`write_with_error`], with the standard error as the picture.
/// - PNG (toned) and TIFF (linear): the standard error as a picture.
///
/// # Errors
/// As [`write_with_error`].
pub fn write_error(
    bars: &[ErrorBars<'_>],
    confidence: f64,
    path: &Path,
    format: ImageFormat,
    tone: &Tone,
) -> Result<(), SceneError> {
    let errors: Vec<&Image> = bars.iter().map(|b| b.error).collect();
    check(&errors, bars).map_err(|problem| fail(path, problem))?;
    match format {
        ImageFormat::Npy => write_whole(path, |out| write_npy(bars, out)),
        ImageFormat::Exr => write_whole(path, |out| write_exr(&errors, bars, confidence, out)),
        _ => picture(&errors, path, format, tone),
    }
}

/// Refuses what is neither grey nor red, green and blue, and images of different sizes.
fn check(channels: &[&Image], bars: &[ErrorBars<'_>]) -> Result<(), String> {
    if !matches!((channels.len(), bars.len()), (1 | 3, 1) | (3, 3)) {
        let (channels, bars) = (channels.len(), bars.len());
        return Err(format!(
            "{channels} channels with {bars} error bars: one or three channels, and one bar or as many"
        ));
    }
    let extent = channels[0].extent();
    match channels.iter().copied().chain(bars.iter().flat_map(ErrorBars::layers)).find(|i| i.extent() != extent) {
        Some(other) => Err(format!("the image has {extent} pixels and one of its layers {}", other.extent())),
        None => Ok(()),
    }
}

fn picture(channels: &[&Image], path: &Path, format: ImageFormat, tone: &Tone) -> Result<(), SceneError> {
    match *channels {
        [r, g, b] => write_colour(&[r.clone(), g.clone(), b.clone()], path, format, tone),
        ref one => write(one[0], path, format, tone),
    }
}

fn write_exr(
    channels: &[&Image],
    bars: &[ErrorBars<'_>],
    confidence: f64,
    out: &mut BufWriter<&File>,
) -> Result<(), String> {
    let Extent { width, height } = channels[0].extent();
    let channel = |name: String, image: &Image| {
        check_floats(image).map_err(|problem| format!("channel {name}: {problem}"))?;
        let values = image.values().iter().map(|v| *v as f32).collect();
        Ok::<_, String>(AnyChannel::new(name.as_str(), FlatSamples::F32(values)))
    };
    // One image is the grey of all three.
    let colours = ["R", "G", "B"].into_iter().zip(channels.iter().cycle());
    let mut list: Vec<_> = colours.map(|(name, image)| channel(name.into(), image)).collect::<Result<_, _>>()?;
    let names: &[&str] = if bars.len() == 1 { &["Y"] } else { &["R", "G", "B"] };
    for (colour, bar) in names.iter().zip(bars) {
        for (layer, image) in ErrorBars::LAYERS.iter().zip(bar.layers()) {
            list.push(channel(format!("{layer}.{colour}"), image)?);
        }
    }
    let mut attributes = LayerAttributes::default();
    attributes.other.insert(Text::from("confidence"), AttributeValue::F64(confidence));
    attributes.comments = Some(Text::from(
        "stderr: standard error; low, high: ends of the confidence interval; unresolved: 1 where no sample fell",
    ));
    let channels = AnyChannels::sort(list.into_iter().collect());
    let layer = Layer::new((width, height), attributes, Encoding::SMALL_LOSSLESS, channels);
    ExrImage::from_layer(layer).write().to_buffered(out).map_err(|e| e.to_string())
}

fn write_npy(bars: &[ErrorBars<'_>], out: &mut BufWriter<&File>) -> Result<(), String> {
    let Extent { width, height } = bars[0].error.extent();
    let mut shape = vec![ErrorBars::LAYERS.len() as u64];
    if bars.len() > 1 {
        shape.push(bars.len() as u64);
    }
    shape.extend([height as u64, width as u64]);
    let mut writer =
        npyz::WriteOptions::new().default_dtype().shape(&shape).writer(out).begin_nd().map_err(|e| e.to_string())?;
    for layer in 0..ErrorBars::LAYERS.len() {
        for bar in bars {
            writer.extend(bar.layers()[layer].values().iter().copied()).map_err(|e| e.to_string())?;
        }
    }
    writer.finish().map_err(|e| e.to_string())
}

#[cfg(test)]
#[path = "layers_tests.rs"]
mod tests;
