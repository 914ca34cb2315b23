//! Monte Carlo: independent samples and stratified samples, as point streams.
//!
//! Independent samples come by four strategies that give the same distribution and differ in cost only; the
//! report compares the first three:
//!
//! | name | how | memory |
//! |---|---|---|
//! | [`Unsorted::linear`] | targets in random order, each found by adding up weights from the first voxel | none |
//! | [`Unsorted::binary`] | targets in random order, each found by binary search | none |
//! | [`Quicksorted`] | all targets drawn and sorted first, then one walk: the report's improvement 1 | 8 bytes a sample |
//! | [`OrderStatistics`] | targets drawn in rising order, so that there is nothing to sort | 8 bytes per 2048 samples |
//!
//! [`Stratified`] draws one target in each of M intervals of equal mass: not independent, less variance.
//! [`Systematic`] draws them at one place in all intervals, and [`Ssp`] gives each voxel its share of the samples rounded up or
//! down; both for comparison.

mod order_statistics;
mod ssp;
mod stratified;
mod systematic;
mod unsorted;

pub use order_statistics::OrderStatistics;
pub use ssp::Ssp;
pub use stratified::Stratified;
pub use systematic::Systematic;
pub use unsorted::{Quicksorted, Unsorted};
