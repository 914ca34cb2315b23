//! What the images must converge to, kept on disk.

use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::path::Path;

use mcvr::Scenery;
use mcvr::raycast::{ReferenceOptions, reference_with_look};
use mcvr::scene::film::{self, ImageFormat, Tone};
use mcvr::scene::{Density, Extent, Image, Watch};

use crate::Outcome;

pub struct Truth {
    /// Channels one below the other.
    pub image: Image,
    /// Estimate of the error of each value.
    pub error: Image,
}

pub fn rms(image: &Image) -> f64 {
    (image.values().iter().map(|v| v * v).sum::<f64>() / image.values().len() as f64).sqrt()
}

impl Truth {
    /// RMS of its own estimate of its error, over its mean.
    pub fn own_error(&self) -> f64 {
        rms(&self.error) / self.image.mean()
    }

    /// RMSE of an image over the mean.
    pub fn distance(&self, image: &Image) -> Outcome<f64> {
        Ok(rms(&image.difference(&self.image)?) / self.image.mean())
    }
}

pub fn stack(channels: &[Image]) -> Outcome<Image> {
    let Some(first) = channels.first() else { return Err("an image without channels".into()) };
    let values = channels.iter().flat_map(|c| c.values().iter().copied()).collect();
    let extent = first.extent();
    Ok(Image::from_values(Extent::new(extent.width, extent.height * channels.len())?, values)?)
}

/// Casts the rays of a scenery, or reads what an earlier run cast of the same.
pub fn truth(folder: &Path, label: &str, scenery: &Scenery, options: &ReferenceOptions) -> Outcome<Truth> {
    let look = scenery.effects.look(scenery.volume.grid(), &scenery.camera)?;
    let mut hasher = DefaultHasher::new();
    format!("{:?} {:?} {look:?} {options:?}", scenery.map, scenery.camera).hash(&mut hasher);
    let stem = format!("{}-{:016x}", label.replace([' ', ',', '+'], ""), hasher.finish());
    let path = |what: &str| folder.join(format!("{stem}-{what}.npy"));
    let [image, error] = [path("image"), path("error")];
    if image.exists() && error.exists() {
        return Ok(Truth { image: film::read(&image)?, error: film::read(&error)? });
    }
    std::fs::create_dir_all(folder)?;
    let density = Density::new(&scenery.volume, scenery.map.clone())?;
    let made = reference_with_look(&density, &scenery.camera, &look, options, &Watch::default())?;
    let errors: Vec<Image> = made.errors.iter().map(|e| e.image.clone()).collect();
    let truth = Truth { image: stack(&made.channels)?, error: stack(&errors)? };
    film::write(&truth.image, &image, ImageFormat::Npy, &Tone::default())?;
    film::write(&truth.error, &error, ImageFormat::Npy, &Tone::default())?;
    Ok(truth)
}
