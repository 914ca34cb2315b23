//! Exact counts of the work done.

use std::ops::AddAssign;

use serde::Serialize;

/// Work done for an image. Exact, and the same for any number of threads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counters {
    /// Rays asked for, those that miss the volume included; pixels outside the volume's outline on the image
    /// ask for none.
    pub rays: u64,
    /// Cells (boxes on which the field is one polynomial) integrated over a path of positive length. Cells of
    /// skipped bricks do not count. 0 for a march.
    pub cells: u64,
    /// Bricks of 8×8×8 cells crossed in one step since they hold no density. 0 for a march.
    pub empty_bricks: u64,
    /// Points at which the field was evaluated: Gauss points, or steps of a march.
    pub evaluations: u64,
    /// Voxels read from the volume while casting (voxels outside the grid are not read; preparing the brick
    /// map, which looks at every voxel about once, is not counted).
    pub voxel_reads: u64,
    /// Points at which shading evaluated the gradient; 0 without shading.
    pub gradients: u64,
    /// Voxels whose colour was looked up; 0 without materials.
    pub colours: u64,
}

impl AddAssign for Counters {
    fn add_assign(&mut self, other: Self) {
        self.rays += other.rays;
        self.cells += other.cells;
        self.empty_bricks += other.empty_bricks;
        self.evaluations += other.evaluations;
        self.voxel_reads += other.voxel_reads;
        self.gradients += other.gradients;
        self.colours += other.colours;
    }
}
