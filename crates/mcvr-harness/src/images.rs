//! The pictures of a run: the truth, the series of images, and the signed differences, all under the same tones.

use std::path::Path;

use mcvr_scene::film::{Tone, diverging_rgb, write};
use mcvr_scene::{Extent, Image, film::ImageFormat};
use serde::Serialize;

use crate::HarnessError;
use crate::record::write_file;

/// One image of the series; paths are relative to the run's folder.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SeriesImage {
    /// The method's identifier.
    pub method: String,
    /// M.
    pub samples: u64,
    /// Relative RMSE of this very image.
    pub rel_rmse: Option<f64>,
    /// Time for the complete image, s.
    pub complete: f64,
    /// The image, toned by the truth's window.
    pub image: String,
    /// Image minus truth in colours.
    pub difference: String,
}

/// What all pictures of a run share, so that they can be compared by eye.
#[derive(Debug)]
pub(crate) struct Pictures<'a> {
    folder: &'a Path,
    truth: &'a Image,
    limits: [f64; 2],
    /// Value of full red.
    pub(crate) scale: f64,
}

impl<'a> Pictures<'a> {
    /// Takes the tone window (0th to 99.9th percentile) and the [`difference_scale`] from the truth.
    pub(crate) fn new(folder: &'a Path, truth: &'a Image) -> Self {
        Self { folder, truth, limits: Tone::default().limits(truth), scale: difference_scale(truth) }
    }

    /// Writes `truth.png` and `truth.npy`, and makes the folder of the series.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub(crate) fn write_truth(&self) -> Result<(), HarnessError> {
        let images = self.folder.join("images");
        std::fs::create_dir_all(&images).map_err(|e| HarnessError::file(&images, e))?;
        write(self.truth, &self.folder.join("truth.npy"), ImageFormat::Npy, &Tone::default())?;
        self.write_grey(self.truth, &self.folder.join("truth.png"))
    }

    /// Relative paths of a series image and its difference map.
    pub(crate) fn names(method: &str, samples: u64) -> [String; 2] {
        [format!("images/{method}-{samples:010}.png"), format!("images/{method}-{samples:010}-difference.png")]
    }

    /// True when both pictures of a series entry are there.
    pub(crate) fn present(&self, method: &str, samples: u64) -> bool {
        Self::names(method, samples).iter().all(|name| self.folder.join(name).is_file())
    }

    /// Writes an image and its difference from the truth.
    ///
    /// # Errors
    /// When a file cannot be written or the sizes differ.
    pub(crate) fn write_pair(&self, method: &str, samples: u64, image: &Image) -> Result<(), HarnessError> {
        let [plain, difference] = Self::names(method, samples);
        self.write_grey(image, &self.folder.join(plain))?;
        write_difference(image, self.truth, self.scale, &self.folder.join(difference))
    }

    /// Writes grey levels under the truth's window (an image on its own would get its own).
    fn write_grey(&self, image: &Image, path: &Path) -> Result<(), HarnessError> {
        let levels: Vec<u8> =
            Tone::default().apply(image, self.limits).into_iter().map(|g| (g * 255.0).round() as u8).collect();
        write_png(image.extent(), &levels, None, path)
    }
}

/// Value of full red in difference maps: twice the truth's mean absolute pixel. It depends on the truth alone, so that
/// the maps of all methods and sample counts compare; and it is of the size of the errors that occur, so that they show.
pub fn difference_scale(truth: &Image) -> f64 {
    2.0 * crate::metrics::mean(|| truth.values().iter().map(|v| v.abs()))
}

/// Levels of a difference map on either side of zero: with zero 255, as many as one byte a pixel holds with a middle.
const LEVELS: f64 = 127.0;

/// Writes `test − reference` as colours: blue below, white at zero, red above; full colour at ±`scale`, in steps of
/// 1/127 of it.
///
/// # Errors
/// When the sizes differ or the file cannot be written.
pub fn write_difference(test: &Image, reference: &Image, scale: f64, path: &Path) -> Result<(), HarnessError> {
    let difference = test.difference(reference)?;
    let level = |v: &f64| if scale > 0.0 { (LEVELS * (v / scale).clamp(-1.0, 1.0)).round() } else { 0.0 };
    let levels: Vec<u8> = difference.values().iter().map(|v| (LEVELS + level(v)) as u8).collect();
    let steps = (0..=2 * LEVELS as i32).map(|i| f64::from(i) - LEVELS).collect();
    let steps = Image::from_values(Extent::new(2 * LEVELS as usize + 1, 1)?, steps)?;
    write_png(difference.extent(), &levels, Some(&diverging_rgb(&steps, LEVELS)), path)
}

/// Writes one byte a pixel, grey or an index into a palette, as small as PNG gets: a page embeds dozens of these.
fn write_png(extent: Extent, pixels: &[u8], palette: Option<&[[u8; 3]]>, path: &Path) -> Result<(), HarnessError> {
    let (width, height) = (extent.width as u32, extent.height as u32);
    let encoded = |filter: png::Filter| -> Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_color(if palette.is_some() { png::ColorType::Indexed } else { png::ColorType::Grayscale });
        if let Some(palette) = palette {
            encoder.set_palette(palette.as_flattened());
        }
        encoder.set_compression(png::Compression::High);
        encoder.set_filter(filter);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(pixels)?;
        writer.finish()?;
        Ok(bytes)
    };
    // Noise packs best as it is, smooth images as differences of neighbours.
    let plain = encoded(png::Filter::NoFilter).map_err(|e| HarnessError::file(path, e))?;
    let filtered = encoded(png::Filter::Adaptive).map_err(|e| HarnessError::file(path, e))?;
    write_file(path, if plain.len() <= filtered.len() { &plain } else { &filtered })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_keep_sign_order_and_zero_in_255_steps() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.png");
        let extent = Extent::new(601, 1).unwrap();
        let values: Vec<f64> = (-300..=300).map(|i| f64::from(i) / 200.0).collect();
        let test = Image::from_values(extent, values.clone()).unwrap();
        write_difference(&test, &Image::zeros(extent), 1.0, &path).unwrap();
        let shown = image::open(&path).unwrap().to_rgb8();
        let exact = diverging_rgb(&test, 1.0);
        for (x, (value, exact)) in values.iter().zip(exact).enumerate() {
            let pixel = shown.get_pixel(x as u32, 0).0;
            assert_eq!(value.abs() < 0.5 / LEVELS, pixel == [255; 3], "white is the same: {value}");
            // Half a step of 1/127 over at most 231 grey levels, and rounding.
            let off = pixel.iter().zip(exact).map(|(a, b)| a.abs_diff(b)).max().unwrap();
            assert!(f64::from(off) <= 231.0 / (2.0 * LEVELS) + 1.0, "{value}: {pixel:?} for {exact:?}");
        }
        assert_eq!(shown.get_pixel(0, 0).0, [33, 102, 172]);
        assert_eq!(shown.get_pixel(600, 0).0, [178, 24, 43]);
        assert_eq!(std::fs::read(&path).unwrap()[25], 3, "one byte a pixel and a palette");
    }

    #[test]
    fn grey_pictures_keep_every_level() {
        let folder = tempfile::tempdir().unwrap();
        let extent = Extent::new(16, 16).unwrap();
        let truth = Image::from_values(extent, (0..256).map(f64::from).collect()).unwrap();
        let mut pictures = Pictures::new(folder.path(), &truth);
        pictures.limits = [0.0, 255.0];
        pictures.write_truth().unwrap();
        let shown = image::open(folder.path().join("truth.png")).unwrap();
        assert_eq!(shown.color(), image::ColorType::L8);
        assert_eq!(shown.to_luma8().as_raw()[..], (0..=255).collect::<Vec<u8>>()[..]);
    }
}
