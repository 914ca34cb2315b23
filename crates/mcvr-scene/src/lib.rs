//! What an X-ray image is made of, apart from how it is computed: the [`Camera`], the reconstruction
//! [`Kernel`], the [`Density`] (a volume seen through a [`DensityMap`]), the [`Estimand`], the [`Effects`], and the
//! [`Image`] with its files and tones.
//!
//! Terms and mathematics follow METHOD sections 1, 2 and 5.

mod camera;
mod concentrate;
mod density;
pub mod effects;
mod error;
mod estimand;
pub mod film;
mod kernel;
mod watch;

pub use camera::{Camera, Extent, Ray, View};
pub use density::{
    Density, DensityMap, Emphasis, Hounsfield, MassReport, NegativePolicy, Occupancy, Substance, Transfer, WeightFn,
    WeightLookup, power_of_two,
};
pub use effects::{Effects, Look};
pub use error::SceneError;
pub use estimand::Estimand;
pub use film::Image;
pub use kernel::Kernel;
pub use watch::Watch;
