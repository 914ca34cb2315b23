//! Trilinear X-rays sixteen rays at a time.
//!
//! A packet is sixteen rays of neighbouring pixels, or of one pixel. One gather brings a voxel and its neighbour along x for
//! all sixteen, so that a sample costs four gathers; weights are made from stored voxels in registers. Depths in which the rays'
//! tile of pixels holds no occupied brick are skipped ([`tiles`]). Positions and sums of a piece are `f32` relative to the
//! piece's start, pieces are added in `f64`.
//!
//! What packets do not serve (other kernels than `tent`, voxels of `u32`, `i32` and `f64`, maps of `f32` that are no line, 2^31 voxels and more,
//! weights beyond `f32`) goes ray by ray in [`crate::march`] and [`crate::Integrator`].

mod band;
mod beam;
mod corners;
mod driver;
mod lanes;
#[cfg(test)]
mod tests;
mod tiles;
mod trace;
mod weigh;
#[cfg(target_arch = "x86_64")]
mod x86;

pub(crate) use driver::{Along, Cast, Look, Packets, Plan, SIDE, Seen, Square};
pub(crate) use lanes::LANES;
pub(crate) use tiles::TILE;
