//! Two image files against each other, for the command line.

use std::fmt;
use std::path::Path;

use mcvr_scene::film::read;

use crate::format::significant;
use crate::{Comparison, HarnessError, difference_scale, write_difference};

/// Figures of a test image against a reference, with the scale of the difference map.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct FileComparison {
    /// How far the images are apart.
    pub comparison: Comparison,
    /// Value that is full red in the difference map, in the images' unit.
    pub difference_scale: f64,
}

/// Reads two images (see [`mcvr_scene::film::read`]), compares the first with the second, which is the reference, and writes
/// the signed difference as a PNG if a path is given: red where the first is larger, full colour at twice the
/// reference's mean absolute pixel.
///
/// # Errors
/// When a file cannot be read or written, or the images do not match.
pub fn compare_files(test: &Path, reference: &Path, difference: Option<&Path>) -> Result<FileComparison, HarnessError> {
    let (a, b) = (read(test)?, read(reference)?);
    let comparison = Comparison::of(&a, &b).map_err(|e| match e {
        HarnessError::Comparison(problem) => {
            HarnessError::Comparison(format!("{} against {}: {problem}", test.display(), reference.display()))
        }
        other => other,
    })?;
    let scale = difference_scale(&b);
    difference.map_or(Ok(()), |path| write_difference(&a, &b, scale, path))?;
    Ok(FileComparison { comparison, difference_scale: scale })
}

impl fmt::Display for Comparison {
    /// One figure a line, without a final newline; `undefined` where a figure is.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let figure = |v: Option<f64>, unit: &str, factor: f64| {
            v.map_or("undefined".to_owned(), |v| format!("{}{unit}", significant(v * factor, 4)))
        };
        let percent = |v| figure(v, " %", 100.0);
        writeln!(f, "pixels           {}", self.pixels)?;
        writeln!(f, "reference mean   {}", significant(self.reference_mean, 6))?;
        writeln!(f, "reference peak   {}", significant(self.reference_peak, 6))?;
        writeln!(f, "RMSE             {}", significant(self.rmse, 4))?;
        writeln!(f, "RMSE / mean      {}", percent(self.rel_rmse))?;
        writeln!(f, "RMSE / peak      {}", percent(self.rel_rmse_peak))?;
        writeln!(f, "MAE / mean       {}", percent(self.mae))?;
        writeln!(f, "maximum / mean   {}", percent(self.max))?;
        writeln!(f, "PSNR             {}", figure(self.psnr, " dB", 1.0))?;
        let se = self.bias_se.map_or(String::new(), |se| format!(" ± {} %", significant(100.0 * se, 2)));
        write!(f, "bias / mean      {}{se}", percent(self.bias))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_scene::film::{ImageFormat, Tone, write};
    use mcvr_scene::{Extent, Image};

    #[test]
    fn files_are_compared_and_the_difference_is_drawn() {
        let folder = tempfile::tempdir().unwrap();
        let image = |v: [f64; 4]| Image::from_values(Extent::new(2, 2).unwrap(), v.to_vec()).unwrap();
        let [a, b, small, map] = ["a.npy", "b.npy", "small.npy", "d.png"].map(|n| folder.path().join(n));
        let save = |i: &Image, path: &Path| write(i, path, ImageFormat::Npy, &Tone::default()).unwrap();
        save(&image([1.0, 1.0, 3.0, 0.0]), &a);
        save(&image([1.0, 1.0, 1.0, 1.0]), &b);
        save(&Image::zeros(Extent::new(1, 2).unwrap()), &small);
        let result = compare_files(&a, &b, Some(&map)).unwrap();
        assert_eq!(result.difference_scale, 2.0);
        assert_eq!(result.comparison.rel_rmse, Some(1.25f64.sqrt()));
        let pixels = image::open(&map).unwrap().to_rgb8();
        assert_eq!(pixels.get_pixel(0, 0).0, [255, 255, 255]);
        assert_eq!(pixels.get_pixel(0, 1).0, [178, 24, 43], "full red at the scale");
        assert!(pixels.get_pixel(1, 1).0[2] > pixels.get_pixel(1, 1).0[0], "blue below");
        let text = result.comparison.to_string();
        assert!(text.contains("RMSE / mean      111.8 %") && text.contains("bias / mean      25.00 %"), "{text}");
        let message = compare_files(&small, &b, None).unwrap_err().to_string();
        assert!(message.contains("small.npy") && message.contains("1x2"), "{message}");
        assert!(compare_files(&folder.path().join("none.npy"), &b, None).is_err());
    }
}
