//! X-ray images of 3-D scans by Monte Carlo, quasi-Monte Carlo and ray casting, on one definition of the image.
//!
//! This crate re-exports the workspace's crates under short names and joins them in [`make`]: a [`Request`]
//! names a method, a budget and a seed, and gives an image with the time and the work it took.
//!
//! ```
//! use mcvr::{Request, Scenery, make, scene, volume};
//! let loaded = volume::load("phantom:lobster@32", None)?;
//! let extent = scene::Extent::new(64, 64)?;
//! let camera = scene::Camera::look(&scene::View::default(), loaded.volume.grid(), extent)?;
//! let scenery = Scenery::new(loaded.volume, scene::DensityMap::default(), camera);
//! let made = make(&scenery, &Request { samples: 1 << 14, ..Request::default() }, &scene::Watch::default())?;
//! assert_eq!(made.image.extent(), extent);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub use mcvr_footprint as footprint;
pub use mcvr_harness as harness;
pub use mcvr_mc as mc;
pub use mcvr_qmc as qmc;
pub use mcvr_raycast as raycast;
pub use mcvr_refine as refinement;
pub use mcvr_sampling as sampling;
pub use mcvr_scene as scene;
pub use mcvr_volume as volume;

pub mod auto;
pub mod bench;
pub mod claims;
mod cloud;
mod cloud_file;
mod detector;
mod entrants;
pub mod hardcases;
mod make;
mod matrix_file;
mod measured;
mod memory;
mod method;
pub mod plan;
mod refine;
mod request;
mod scene_file;

pub use cloud::draw_cloud;
pub use cloud_file::{CloudFileError, is_cloud, read_cloud, write_cloud, write_ply};
pub use detector::{Detector, DetectorError};
pub use entrants::{Contestant, Timed};
pub use make::{Made, MakeError, Scenery, make, make_first, make_of};
pub use matrix_file::{MatrixFileError, read_matrix};
pub use measured::Measured;
pub use memory::keep_freed_memory;
pub use method::Method;
pub use refine::{MadeRefined, Refinement, refine};
pub use request::{Adaptive, Request};
pub use scene_file::{
    CameraSection, ErrorSection, ImageSection, PixelSection, SamplingSection, SceneFile, SceneFileError, VolumeSection,
};
