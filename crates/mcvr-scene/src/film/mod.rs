//! Images: linear estimand values, how they are stored, and the tones under which people look at them.

mod animation;
mod colour;
mod develop;
mod file;
mod layers;
mod read;
mod tone;

use crate::{Extent, SceneError};

pub use animation::{GIF_RATE_LIMIT, write_gif};
pub use colour::{largest, toned_colour, write_colour, write_colour_within};
pub use develop::{Film, FilmBias, expose, transmission, transmission_bias};
pub use file::{ImageFormat, write, write_animation, write_rgb8, write_whole, write_within};
pub use layers::{ErrorBars, write_error, write_with_error};
pub use read::{read, read_layers};
pub use tone::{Curve, Tone, diverging_rgb};

/// An image of linear values, row by row from the top, `f64`.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    extent: Extent,
    values: Vec<f64>,
}

impl Image {
    /// An image of zeros.
    pub fn zeros(extent: Extent) -> Self {
        Self { extent, values: vec![0.0; extent.pixels()] }
    }

    /// An image from its values in rows from the top.
    ///
    /// # Errors
    /// [`SceneError::Image`] when the number of values is not width × height.
    pub fn from_values(extent: Extent, values: Vec<f64>) -> Result<Self, SceneError> {
        if values.len() == extent.pixels() {
            Ok(Self { extent, values })
        } else {
            Err(SceneError::Image(format!("{} values for {extent} pixels", values.len())))
        }
    }

    /// Size.
    pub fn extent(&self) -> Extent {
        self.extent
    }

    /// Values in rows from the top.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Values in rows from the top, to change.
    pub fn values_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    /// Value of the pixel in column x and row y.
    ///
    /// # Panics
    /// When the pixel is outside.
    pub fn get(&self, x: usize, y: usize) -> f64 {
        self.values[y * self.extent.width + x]
    }

    /// Sum of all values.
    pub fn sum(&self) -> f64 {
        self.values.iter().sum()
    }

    /// Mean of all values.
    pub fn mean(&self) -> f64 {
        self.sum() / self.values.len() as f64
    }

    /// Largest value, at least 0.
    pub fn max(&self) -> f64 {
        self.values.iter().copied().fold(0.0, f64::max)
    }

    /// The mean of three channels of one size, pixel by pixel.
    pub fn mean_of(channels: &[Image; 3]) -> Self {
        let [r, g, b] = channels;
        let sums = r.values.iter().zip(&g.values).zip(&b.values).map(|((r, g), b)| (r + g + b) / 3.0);
        Self { extent: r.extent, values: sums.collect() }
    }

    /// Three channels of one size as one image, one below the other: what compares coloured images as numbers.
    ///
    /// # Errors
    /// [`SceneError::Image`] when that has more than [`Extent::MAX_PIXELS`] pixels.
    pub fn stacked(channels: &[Image; 3]) -> Result<Self, SceneError> {
        let extent = Extent::new(channels[0].extent.width, 3 * channels[0].extent.height)?;
        Self::from_values(extent, channels.iter().flat_map(|c| c.values.iter().copied()).collect())
    }

    /// `self - other`, pixel by pixel.
    ///
    /// # Errors
    /// [`SceneError::Image`] when the sizes differ.
    pub fn difference(&self, other: &Image) -> Result<Image, SceneError> {
        if self.extent != other.extent {
            return Err(SceneError::Image(format!("sizes differ: {} and {}", self.extent, other.extent)));
        }
        let values = self.values.iter().zip(&other.values).map(|(a, b)| a - b).collect();
        Ok(Image { extent: self.extent, values })
    }
}
