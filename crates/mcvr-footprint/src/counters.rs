//! Exact counts of the work done.

use serde::Serialize;

/// Work done for an image. Exact, and the same for any number of threads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counters {
    /// Voxels of the bricks that hold any weight: all of them are looked at.
    pub voxels_visited: u64,
    /// Footprints that meet the image: of voxels of positive weight, or of their parts where the grid is refined.
    pub footprints: u64,
    /// Pixels that footprints were added to, those of a margin around the image included.
    pub pixels_touched: u64,
}

impl std::ops::AddAssign for Counters {
    fn add_assign(&mut self, other: Self) {
        self.voxels_visited += other.voxels_visited;
        self.footprints += other.footprints;
        self.pixels_touched += other.pixels_touched;
    }
}
