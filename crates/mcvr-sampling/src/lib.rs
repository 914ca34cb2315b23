//! From a density to an image by points: the voxel [`Distribution`], [`PointStream`]s, and [`render`],
//! the one loop of location, projection and accumulation that every sampling method shares.
//!
//! Monte Carlo and quasi-Monte Carlo differ in their [`PointStream`] and in nothing else. A stream hands out
//! blocks of [`BLOCK`] points; each point is a target in the running sum of weights (which voxel) and three
//! uniforms (where in the kernel around it). Blocks are keyed by their number, never by a thread, and all
//! sums are integers: the same seed gives the same image on any number of threads.
//!
//! [`sample`] keeps the points as a [`Cloud`], and [`project_cloud`] makes the image of it from any view.

mod accumulate;
mod binned;
mod brick_totals;
mod cloud;
mod compact;
mod compact_view;
mod curve;
mod dense;
mod distribution;
mod effects;
mod engine;
mod error;
mod expose;
mod find;
mod frustum;
mod hilbert;
mod locate;
mod nested;
mod offset;
mod order;
mod project;
#[cfg(target_arch = "x86_64")]
mod project512;
mod projection;
mod real;
mod replicates;
pub mod rng;
mod running;
mod running_totals;
mod stored;
mod stream;
mod totals;
mod units;
mod unpack;
mod word;

pub use cloud::{Cloud, ProjectOptions, Provenance, project_cloud, sample};
pub use compact::{Compact, CompactBrick};
pub use distribution::{Distribution, DistributionCounters};
pub use engine::{Counters, GradientSource, PhaseSeconds, RenderOptions, Rendered, render, render_look};
pub use error::SamplingError;
pub use mcvr_volume::SimdLevel;
pub use order::VoxelOrder;
pub use projection::Precision;
pub use replicates::{Developer, MAX_REPLICATE_SAMPLES, ReplicatePoints, Replicates};
pub use stream::{BLOCK, PointBlock, PointStream, Search, Strata, block_count, block_len, check_samples, target_of};
