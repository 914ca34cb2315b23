//! What must hold for any scene: properties of random small scenes, and sums and integrals against exact arithmetic.
//!
//! Cases are drawn with a fixed seed and no file of failures: a run is the same everywhere. To look further,
//! `PROPTEST_CASES` and another seed in [`scenes::config`] draw others.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

#[path = "../common/mod.rs"]
mod common;

mod closed;
mod exact_rays;
mod exact_weights;
mod polynomial;
mod sampling;
mod scenes;
mod symmetry;
