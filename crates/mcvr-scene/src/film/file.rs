//! Writing image files, whole or absent.

use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::Path;

use image::{DynamicImage, ImageBuffer, Luma, Rgb};
use npyz::WriterBuilder;

use super::{Image, Tone};
use crate::{Extent, SceneError};

/// Image file formats, chosen by the file name's ending.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFormat {
    /// 8-bit grey PNG, toned.
    Png8,
    /// 16-bit grey PNG, toned.
    Png16,
    /// OpenEXR, 32-bit float, linear values in R, G and B.
    Exr,
    /// TIFF, 32-bit float, linear values in three channels.
    Tiff,
    /// NumPy array (height, width), `<f8`, linear values.
    Npy,
}

impl ImageFormat {
    /// Format of a path by its ending; `deep` asks for 16 bits where the format has a choice.
    ///
    /// # Errors
    /// [`SceneError::File`] when the ending is none of png, exr, tif, tiff, npy.
    pub fn of(path: &Path, deep: bool) -> Result<Self, SceneError> {
        let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
        match ending.as_str() {
            "png" if deep => Ok(Self::Png16),
            "png" => Ok(Self::Png8),
            "exr" => Ok(Self::Exr),
            "tif" | "tiff" => Ok(Self::Tiff),
            "npy" => Ok(Self::Npy),
            _ => Err(fail(path, format!("unknown image ending '{ending}'; use .png, .exr, .tiff or .npy"))),
        }
    }

    /// True when values are stored as they are, without a tone.
    pub fn is_linear(self) -> bool {
        matches!(self, Self::Exr | Self::Tiff | Self::Npy)
    }
}

pub(super) fn fail(path: &Path, problem: impl ToString) -> SceneError {
    SceneError::File { path: path.to_owned(), problem: problem.to_string() }
}

/// Writes an image; the tone applies to PNG only.
///
/// # Errors
/// [`SceneError::File`] when the folder is missing or not writable, the disk is full, or EXR or TIFF is asked to hold a number
/// beyond the largest 32-bit float.
pub fn write(image: &Image, path: &Path, format: ImageFormat, tone: &Tone) -> Result<(), SceneError> {
    // Linear formats have no tone, and limits take an order of all pixels.
    let limits = if format.is_linear() { [0.0, 1.0] } else { tone.limits(image) };
    write_within(image, path, format, tone, limits)
}

/// Writes an image with its tone between given limits instead of the tone's percentiles: images of a series are
/// then as bright as each other.
///
/// # Errors
/// As [`write()`].
pub fn write_within(
    image: &Image,
    path: &Path,
    format: ImageFormat,
    tone: &Tone,
    limits: [f64; 2],
) -> Result<(), SceneError> {
    let Extent { width, height } = image.extent();
    let (w, h) = (width as u32, height as u32);
    let grey = || tone.apply(image, limits);
    let rgb32 = || {
        check_floats(image)?;
        let values = image.values().iter().flat_map(|&v| [v as f32; 3]).collect();
        Ok::<_, String>(ImageBuffer::<Rgb<f32>, Vec<f32>>::from_raw(w, h, values).map(DynamicImage::ImageRgb32F))
    };
    write_whole(path, |out| match format {
        ImageFormat::Npy => write_npy(image, out),
        ImageFormat::Png8 => {
            let levels = grey().into_iter().map(|g| (g * 255.0).round() as u8).collect();
            encode(
                ImageBuffer::<Luma<u8>, Vec<u8>>::from_raw(w, h, levels).map(Into::into),
                out,
                image::ImageFormat::Png,
            )
        }
        ImageFormat::Png16 => {
            let levels = grey().into_iter().map(|g| (g * 65535.0).round() as u16).collect();
            encode(
                ImageBuffer::<Luma<u16>, Vec<u16>>::from_raw(w, h, levels).map(Into::into),
                out,
                image::ImageFormat::Png,
            )
        }
        ImageFormat::Exr => encode(rgb32()?, out, image::ImageFormat::OpenExr),
        ImageFormat::Tiff => encode(rgb32()?, out, image::ImageFormat::Tiff),
    })
}

/// Writes colours as an 8-bit PNG.
///
/// # Errors
/// As [`write()`].
pub fn write_rgb8(extent: Extent, pixels: &[[u8; 3]], path: &Path) -> Result<(), SceneError> {
    let buffer =
        ImageBuffer::<Rgb<u8>, _>::from_raw(extent.width as u32, extent.height as u32, pixels.as_flattened().to_vec());
    write_whole(path, |out| encode(buffer.map(Into::into), out, image::ImageFormat::Png))
}

/// Writes 8-bit grey frames, each of `extent`, as an animated PNG that repeats for ever, `rate` frames a second.
///
/// # Errors
/// As [`write()`]; also for no frames, more than 2^31 - 1, a side beyond 2^31 - 1, or a frame of another size.
pub fn write_animation(frames: &[Vec<u8>], extent: Extent, path: &Path, rate: u16) -> Result<(), SceneError> {
    write_whole(path, |out| {
        if frames.is_empty() || frames.iter().any(|f| f.len() != extent.pixels()) {
            return Err(format!("{} frames: at least one, each of {extent} pixels", frames.len()));
        }
        let side = |n: usize| u32::try_from(n).map_err(|e| e.to_string());
        let mut encoder = png::Encoder::new(out, side(extent.width)?, side(extent.height)?);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        let fail = |e: png::EncodingError| e.to_string();
        encoder.set_animated(side(frames.len())?, 0).map_err(fail)?;
        encoder.set_frame_delay(1, rate.max(1)).map_err(fail)?;
        let mut writer = encoder.write_header().map_err(fail)?;
        frames.iter().try_for_each(|frame| writer.write_image_data(frame)).map_err(fail)?;
        writer.finish().map_err(fail)
    })
}

/// Refuses numbers that a 32-bit float, as EXR and TIFF have them, would turn into infinity.
pub(super) fn check_floats(image: &Image) -> Result<(), String> {
    match image.values().iter().position(|v| v.is_finite() && (*v as f32).is_infinite()) {
        None => Ok(()),
        Some(at) => Err(format!(
            "the value {:e} of pixel ({}, {}) exceeds {:e}, the largest 32-bit float; write .npy, which has 64 bits",
            image.values()[at],
            at % image.extent().width,
            at / image.extent().width,
            f32::MAX
        )),
    }
}

pub(super) fn encode(
    image: Option<DynamicImage>,
    out: &mut (impl Write + Seek),
    format: image::ImageFormat,
) -> Result<(), String> {
    image.ok_or("pixel buffer of the wrong size")?.write_to(out, format).map_err(|e| e.to_string())
}

fn write_npy(image: &Image, out: &mut impl Write) -> Result<(), String> {
    let Extent { width, height } = image.extent();
    let mut writer = npyz::WriteOptions::new()
        .default_dtype()
        .shape(&[height as u64, width as u64])
        .writer(out)
        .begin_nd()
        .map_err(|e| e.to_string())?;
    writer.extend(image.values().iter().copied()).and_then(|()| writer.finish()).map_err(|e| e.to_string())
}

/// [`mcvr_volume::write_whole`]: whatever goes wrong, the target is whole or as it was.
///
/// # Errors
/// [`SceneError::File`] with what `fill` or the operating system said.
pub fn write_whole<E: Into<Box<dyn std::error::Error + Send + Sync>>>(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&File>) -> Result<(), E>,
) -> Result<(), SceneError> {
    mcvr_volume::write_whole(path, fill).map_err(|e| fail(path, e))
}

#[cfg(test)]
mod tests {
    use super::super::read;
    use super::*;

    fn picture() -> Image {
        Image::from_values(Extent::new(3, 2).unwrap(), vec![0.0, 1.5, 2.25, 1e-3, 7.0, 42.0]).unwrap()
    }

    #[test]
    fn float_formats_give_back_the_values() {
        let folder = tempfile::tempdir().unwrap();
        for (name, tolerance) in [("a.npy", 0.0), ("a.exr", 1e-7), ("a.tiff", 1e-7)] {
            let path = folder.path().join(name);
            write(&picture(), &path, ImageFormat::of(&path, false).unwrap(), &Tone::default()).unwrap();
            let back = read(&path).unwrap();
            for (a, b) in picture().values().iter().zip(back.values()) {
                assert!((a - b).abs() <= tolerance * a.abs(), "{name}: {a} {b}");
            }
        }
    }

    #[test]
    fn a_png_holds_the_toned_levels() {
        let folder = tempfile::tempdir().unwrap();
        let tone = Tone { window: [0.0, 100.0], ..Tone::default() };
        for deep in [false, true] {
            let path = folder.path().join("a.png");
            write(&picture(), &path, ImageFormat::of(&path, deep).unwrap(), &tone).unwrap();
            let back = read(&path).unwrap();
            let level = if deep { 65535.0 } else { 255.0 };
            assert!((back.get(1, 1) - 7.0 / 42.0).abs() <= 0.500_001 / level, "rounding to the nearest level");
        }
    }

    #[test]
    fn numbers_that_would_become_infinite_are_refused_and_infinite_ones_kept() {
        let folder = tempfile::tempdir().unwrap();
        let of = |v: f64| Image::from_values(Extent::new(2, 2).unwrap(), vec![0.0, 1.0, v, 2.0]).unwrap();
        for name in ["a.exr", "a.tiff", "a.npy"] {
            let path = folder.path().join(name);
            let format = ImageFormat::of(&path, false).unwrap();
            let outcome = write(&of(-1e39), &path, format, &Tone::default());
            if format == ImageFormat::Npy {
                assert_eq!((outcome.is_ok(), read(&path).unwrap().get(0, 1)), (true, -1e39));
            } else {
                let message = outcome.unwrap_err().to_string();
                assert!(
                    message.contains("-1e39") && message.contains("(0, 1)") && message.contains(".npy"),
                    "{message}"
                );
                assert!(!path.exists());
            }
            for kept in [f64::INFINITY, f64::from(f32::MAX)] {
                write(&of(kept), &path, format, &Tone::default()).unwrap();
                assert_eq!(read(&path).unwrap().get(0, 1), kept, "{name}");
            }
        }
    }

    #[test]
    fn a_failed_write_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("missing/a.npy");
        assert!(write(&picture(), &path, ImageFormat::Npy, &Tone::default()).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn damaged_and_foreign_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        for (name, content) in [("a.npy", &b"\x93NUMPY"[..]), ("b.png", b"not a picture"), ("c.exr", b"")] {
            let path = folder.path().join(name);
            std::fs::write(&path, content).unwrap();
            assert!(read(&path).is_err(), "{name}");
        }
        assert!(ImageFormat::of(Path::new("a.jpg"), false).is_err());
    }
}
