//! Images of three channels.

use std::path::Path;

use image::{ImageBuffer, Rgb};
use npyz::WriterBuilder;

use super::file::{check_floats, encode, fail, write_whole};
use super::{Image, ImageFormat, Tone};
use crate::{Extent, SceneError};

/// Writes red, green and blue: PNG as toned RGB, EXR and TIFF as linear RGB, NPY as (height, width, 3).
///
/// The tone acts on the largest channel of each pixel, and its window comes from the percentiles of that; the other
/// channels keep their ratios to it, so every pixel keeps its hue.
///
/// # Errors
/// [`SceneError::File`] when the channels differ in size, the folder is missing or not writable, the disk is full, or EXR or TIFF
/// is asked to hold a number beyond the largest 32-bit float.
pub fn write_colour(channels: &[Image; 3], path: &Path, format: ImageFormat, tone: &Tone) -> Result<(), SceneError> {
    let limits = if format.is_linear() { [0.0, 1.0] } else { tone.limits(&largest(channels)) };
    write_colour_within(channels, path, format, tone, limits)
}

/// Writes red, green and blue with the tone between given limits of the largest channel.
///
/// # Errors
/// As [`write_colour`].
pub fn write_colour_within(
    channels: &[Image; 3],
    path: &Path,
    format: ImageFormat,
    tone: &Tone,
    limits: [f64; 2],
) -> Result<(), SceneError> {
    let extent = channels[0].extent();
    if channels.iter().any(|c| c.extent() != extent) {
        let sizes = channels.each_ref().map(|c| c.extent().to_string()).join(", ");
        return Err(fail(path, format!("the channels differ in size: {sizes}")));
    }
    let (w, h) = (extent.width as u32, extent.height as u32);
    let linear = || -> Vec<f32> { pixels(channels).flatten().map(|v| v as f32).collect() };
    let toned = || toned_colour(channels, tone, limits).into_iter().flatten();
    write_whole(path, |out| match format {
        ImageFormat::Png8 => {
            let levels = toned().map(|v| (v * 255.0).round() as u8).collect();
            encode(
                ImageBuffer::<Rgb<u8>, Vec<u8>>::from_raw(w, h, levels).map(Into::into),
                out,
                image::ImageFormat::Png,
            )
        }
        ImageFormat::Png16 => {
            let levels = toned().map(|v| (v * 65535.0).round() as u16).collect();
            let buffer = ImageBuffer::<Rgb<u16>, Vec<u16>>::from_raw(w, h, levels);
            encode(buffer.map(Into::into), out, image::ImageFormat::Png)
        }
        ImageFormat::Exr | ImageFormat::Tiff => {
            channels.iter().try_for_each(check_floats)?;
            let buffer = ImageBuffer::<Rgb<f32>, _>::from_raw(w, h, linear());
            let format =
                if format == ImageFormat::Exr { image::ImageFormat::OpenExr } else { image::ImageFormat::Tiff };
            encode(buffer.map(Into::into), out, format)
        }
        ImageFormat::Npy => {
            let Extent { width, height } = extent;
            let mut writer = npyz::WriteOptions::new()
                .default_dtype()
                .shape(&[height as u64, width as u64, 3])
                .writer(out)
                .begin_nd()
                .map_err(|e| e.to_string())?;
            writer.extend(pixels(channels).flatten()).and_then(|()| writer.finish()).map_err(|e| e.to_string())
        }
    })
}

/// The largest channel of every pixel: what the tone of a coloured image acts on.
pub fn largest(channels: &[Image; 3]) -> Image {
    let mut out = channels[0].clone();
    for (v, rgb) in out.values_mut().iter_mut().zip(pixels(channels)) {
        *v = rgb.into_iter().fold(f64::NEG_INFINITY, f64::max);
    }
    out
}

fn pixels(channels: &[Image; 3]) -> impl Iterator<Item = [f64; 3]> + '_ {
    let [r, g, b] = channels.each_ref().map(Image::values);
    r.iter().zip(g).zip(b).map(|((r, g), b)| [*r, *g, *b])
}

/// Red, green and blue in 0..=1: what [`write_colour`] puts into a PNG. The channels have one size.
pub fn toned_colour(channels: &[Image; 3], tone: &Tone, limits: [f64; 2]) -> Vec<[f64; 3]> {
    let largest = largest(channels);
    let grey = tone.apply(&largest, limits);
    pixels(channels)
        .zip(largest.values().iter().zip(grey))
        .map(|(rgb, (max, grey))| match *max > 0.0 && max.is_finite() {
            true => rgb.map(|v| if v > 0.0 { grey * (v / max) } else { 0.0 }),
            // Nothing there: no hue, and white where the tone is inverted.
            false => [grey; 3],
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::{Curve, read};
    use super::*;

    fn channels() -> [Image; 3] {
        let extent = Extent::new(2, 2).unwrap();
        // Black, red, a dim version of the same orange as the bright one.
        let image = |v: [f64; 4]| Image::from_values(extent, v.to_vec()).unwrap();
        [image([0.0, 8.0, 2.0, 10.0]), image([0.0, 0.0, 1.0, 5.0]), image([0.0, 0.0, 0.0, 0.0])]
    }

    fn whole() -> Tone {
        Tone { window: [0.0, 100.0], ..Tone::default() }
    }

    #[test]
    fn a_png_keeps_hues_and_takes_its_window_from_the_largest_channel() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        for (format, top, tolerance) in [(ImageFormat::Png8, 255.0, 0.004), (ImageFormat::Png16, 65535.0, 2e-5)] {
            for curve in [Curve::Linear, Curve::Log] {
                write_colour(&channels(), &path, format, &Tone { curve, ..whole() }).unwrap();
                let decoded = image::open(&path).unwrap();
                assert_eq!(decoded.color().channel_count(), 3);
                let back = decoded.to_rgb16();
                let at = |x, y| back.get_pixel(x, y).0.map(|v| f64::from(v) / 65535.0);
                assert_eq!((at(0, 0), at(1, 1)[0]), ([0.0; 3], 1.0), "{top}");
                assert!((at(1, 1)[1] - 0.5).abs() < tolerance, "half as much green as red");
                let dim = at(0, 1);
                assert!((dim[1] / dim[0] - 0.5).abs() < 4.0 * tolerance, "{curve:?}: the same hue when dim: {dim:?}");
                if curve == Curve::Linear {
                    assert!((at(1, 0)[0] - 0.8).abs() < tolerance && at(1, 0)[1] == 0.0);
                }
            }
        }
    }

    #[test]
    fn linear_formats_hold_the_values_of_all_channels_and_are_refused_as_grey_images() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.exr", "a.tiff", "a.npy", "a.png"] {
            let path = folder.path().join(name);
            let format = ImageFormat::of(&path, false).unwrap();
            write_colour(&channels(), &path, format, &whole()).unwrap();
            let message = read(&path).unwrap_err().to_string();
            assert!(message.contains("colour") && message.contains(name), "{message}");
            if format == ImageFormat::Exr || format == ImageFormat::Tiff {
                let back = image::open(&path).unwrap().to_rgb32f();
                assert_eq!(back.get_pixel(1, 1).0, [10.0, 5.0, 0.0], "{name}");
            }
        }
        let npy = npyz::NpyFile::new(std::fs::File::open(folder.path().join("a.npy")).unwrap()).unwrap();
        assert_eq!(npy.shape(), [2, 2, 3]);
        let values: Vec<f64> = npy.into_vec().unwrap();
        assert_eq!(values[6..], [2.0, 1.0, 0.0, 10.0, 5.0, 0.0]);
    }

    #[test]
    fn channels_of_different_sizes_and_empty_images_are_safe() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let mut odd = channels();
        odd[2] = Image::zeros(Extent::new(1, 4).unwrap());
        assert!(write_colour(&odd, &path, ImageFormat::Png8, &whole()).is_err() && !path.exists());
        let huge = channels().map(|c| Image::from_values(c.extent(), vec![1e39; 4]).unwrap());
        assert!(write_colour(&huge, &path, ImageFormat::Exr, &whole()).is_err() && !path.exists());
        let black = channels().map(|c| Image::zeros(c.extent()));
        for invert in [false, true] {
            write_colour(&black, &path, ImageFormat::Png8, &Tone { invert, ..whole() }).unwrap();
            let expected = if invert { 255 } else { 0 };
            assert!(image::open(&path).unwrap().to_rgb8().iter().all(|v| *v == expected));
        }
    }
}
