//! The ground truth: X-ray images by casting rays through the density field.
//!
//! [`reference()`] integrates the field exactly along every ray (METHOD section 7: `ρ` is a polynomial in each
//! cell) and adaptively over every pixel's area, and says how large its error may be. [`march`] is the plain ray
//! march with a fixed step that people use every day, to be measured against it. Both integrate the same field
//! `ρ` that the Monte Carlo samplers draw from (METHOD section 1), so every difference between the images is
//! error, not modelling.
//!
//! A pixel (i, j) spans `[i, i+1) × [j, j+1)` in pixel coordinates and holds, by [`Estimand`](mcvr_scene::Estimand):
//!
//! - `line`: `∫∫ dpx dpy ∫ ρ dl`, in weight units times mm;
//! - `count`: `(1/F) ∫∫ dpx dpy ∫ ρ / line_factor(px, py, z) dl`, dimensionless, with `F` the total mass.
//!
//! A pinhole counts only depths `z ≥ near`.
//!
//! [`march`], its combs and [`cast_rays`] (a few rays a pixel, exact in depth) take `tent` rays sixteen at a time, with the image's own
//! differences as the way from points to pixels ([`RayOptions::average`]). [`cast_adaptive_rays`] casts them where an image needs them, and
//! [`look_and_cast`] tells errors and costs from the first of them.
//!
//! [`reference_with_look`] and [`march_with_look`] are the same with [effects](mcvr_scene::effects) on the integrand.
//!
//! Sources: J. Amanatides and A. Woo, *A fast voxel traversal algorithm for ray tracing*, Eurographics 1987 (the
//! walk from cell to cell); R. Siddon, *Fast calculation of the exact radiological path for a three-dimensional
//! CT array*, Medical Physics 12, 1985 (the exact integral for `box`); P. Joseph, *An improved algorithm for
//! reprojecting rays through pixel images*, IEEE Trans. Medical Imaging 1, 1982 (the march over interpolated samples).

mod adaptive;
mod adaptive_rays;
mod average;
mod bricks;
mod cell;
mod counters;
mod cubature;
mod draw;
mod effects;
mod error;
mod factor;
mod field;
mod integrator;
mod line;
mod lit;
mod march;
mod march_effects;
mod neighbours;
mod nested;
mod packet;
mod points;
mod rays;
mod reference;
mod rows;
mod sampled;
mod spot_check;
mod view;
mod walk;

pub use adaptive_rays::{
    AdaptiveImage, AdaptiveOptions, Comb, Glance, LookOptions, Pilot, Tried, cast_adaptive_rays, look_and_cast,
    serves_adaptive_rays,
};
pub use counters::Counters;
pub use effects::{LookReference, reference_with_look};
pub use error::RaycastError;
pub use integrator::{Integrator, Rays};
pub use march::{MarchOptions, march};
pub use march_effects::{LookMarch, cast_rays_with_look, march_with_look};
pub use mcvr_scene::Watch;
pub use rays::{MarchImage, RayOptions, cast_rays};
pub use reference::{ErrorEstimate, Reference, ReferenceOptions, reference};
pub use spot_check::{SpotCheck, spot_check};
