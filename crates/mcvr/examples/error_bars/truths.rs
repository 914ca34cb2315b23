//! What the images must converge to, kept on disk.

use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::path::Path;

use mcvr::Scenery;
use mcvr::raycast::{ReferenceOptions, reference};
use mcvr::scene::film::{self, ImageFormat, Tone};
use mcvr::scene::{Density, Estimand, Image, Watch};

use crate::Outcome;

pub struct Truth {
    pub image: Image,
    /// The ray caster's estimate of the error of each pixel.
    pub error: Image,
    /// RMS of the ray caster's own estimate of its error, over the mean pixel.
    pub own_error: f64,
}

pub fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len() as f64;
    (values.map(|v| v * v).sum::<f64>() / n).sqrt()
}

impl Truth {
    /// RMSE of an image over the true mean.
    pub fn distance(&self, image: &Image) -> f64 {
        let pairs = image.values().iter().zip(self.image.values());
        rms(pairs.map(|(a, b)| a - b)) / self.image.mean()
    }

    /// Absolute error, over the true mean, that a share of the pixels keeps.
    pub fn quantile(&self, image: &Image, share: f64) -> f64 {
        let pairs = image.values().iter().zip(self.image.values());
        let mut sizes: Vec<f64> = pairs.map(|(a, b)| (a - b).abs()).collect();
        let rank = ((share * sizes.len() as f64).ceil() as usize).clamp(1, sizes.len()) - 1;
        *sizes.select_nth_unstable_by(rank, f64::total_cmp).1 / self.image.mean()
    }
}

/// Casts the rays of a scenery, or reads what an earlier run cast of the same.
pub fn truth(out: &Path, scenery: &Scenery, estimand: Estimand, tolerance: f64) -> Outcome<Truth> {
    let options = ReferenceOptions { estimand, tolerance, ..ReferenceOptions::default() };
    let mut hasher = DefaultHasher::new();
    format!("{:?} {:?} {:?} {options:?}", scenery.volume.grid(), scenery.map, scenery.camera).hash(&mut hasher);
    for voxel in 0..scenery.volume.grid().len() {
        scenery.volume.isovalue(voxel).to_bits().hash(&mut hasher);
    }
    let folder = out.join("truths");
    let path = |what: &str| folder.join(format!("{estimand}-{:016x}-{what}.npy", hasher.finish()));
    let [image, error] = [path("image"), path("error")];
    let (image, error) = if image.exists() && error.exists() {
        (film::read(&image)?, film::read(&error)?)
    } else {
        std::fs::create_dir_all(&folder)?;
        let density = Density::new(&scenery.volume, scenery.map.clone())?;
        let made = reference(&density, &scenery.camera, &options, &Watch::default())?;
        film::write(&made.image, &image, ImageFormat::Npy, &Tone::default())?;
        film::write(&made.error.image, &error, ImageFormat::Npy, &Tone::default())?;
        eprintln!("truth of {estimand}, {}: {:.1} s", made.image.extent(), made.seconds);
        (made.image, made.error.image)
    };
    let own_error = rms(error.values().iter().copied()) / image.mean();
    Ok(Truth { image, error, own_error })
}
