//! What an X-ray image is made of, apart from how it is computed: the [`Camera`], the reconstruction
//! [`Kernel`], the [`Density`] (a volume seen through a [`DensityMap`]), the [`Estimand`], and the
//! [`Image`] with its files and tones.
//!
//! Terms and mathematics follow METHOD sections 1 and 2.

mod camera;
mod density;
mod error;
mod estimand;
pub mod film;
mod kernel;
mod watch;

pub use camera::{Camera, Extent, Ray, View};
pub use density::{Density, DensityMap, Emphasis, MassReport, NegativePolicy, Transfer, WeightFn, WeightLookup};
pub use error::SceneError;
pub use estimand::Estimand;
pub use film::Image;
pub use kernel::Kernel;
pub use watch::Watch;
