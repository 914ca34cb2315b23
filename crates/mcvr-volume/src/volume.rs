//! A scalar volume: grid, voxels, and the file's slope and intercept.

use crate::{Grid, VolumeError, Voxel, VoxelType, Voxels};

/// A scalar field sampled on a [`Grid`].
///
/// The isovalue of a voxel is `slope * stored + intercept` (METHOD section 1). Voxels stay in the
/// type the file stores.
#[derive(Clone, Debug)]
pub struct Volume {
    grid: Grid,
    voxels: Voxels,
    slope: f64,
    intercept: f64,
    name: String,
}

impl Volume {
    /// Joins a grid and its voxels; slope 1, intercept 0.
    ///
    /// # Errors
    /// [`VolumeError::Grid`] when the number of voxels is not the grid's.
    pub fn new(grid: Grid, voxels: Voxels, name: impl Into<String>) -> Result<Self, VolumeError> {
        if voxels.len() != grid.len() {
            let [x, y, z] = grid.dims();
            return Err(VolumeError::Grid(format!("{} voxels given for a grid of {x}x{y}x{z}", voxels.len())));
        }
        Ok(Self { grid, voxels, slope: 1.0, intercept: 0.0, name: name.into() })
    }

    /// Builds a volume from a vector of voxels, x fastest, then y, then z.
    ///
    /// # Errors
    /// As [`Volume::new`].
    pub fn from_vec<T: Voxel>(grid: Grid, voxels: Vec<T>, name: impl Into<String>) -> Result<Self, VolumeError> {
        Self::new(grid, T::wrap(voxels.into()), name)
    }

    /// The same volume with isovalues `slope * stored + intercept`.
    ///
    /// # Errors
    /// [`VolumeError::Grid`] when either is not finite or the slope is 0.
    pub fn with_rescale(mut self, slope: f64, intercept: f64) -> Result<Self, VolumeError> {
        if !slope.is_finite() || slope == 0.0 || !intercept.is_finite() {
            return Err(VolumeError::Grid(format!(
                "slope must be finite and not 0, intercept finite; got {slope} and {intercept}"
            )));
        }
        self.slope = slope;
        self.intercept = intercept;
        Ok(self)
    }

    /// The same volume on another grid of the same extents.
    ///
    /// # Errors
    /// As [`Volume::new`].
    pub fn with_grid(self, grid: Grid) -> Result<Self, VolumeError> {
        let rescaled = Self::new(grid, self.voxels, self.name)?;
        Ok(Self { slope: self.slope, intercept: self.intercept, ..rescaled })
    }

    /// The grid.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The stored voxels, x fastest.
    pub fn voxels(&self) -> &Voxels {
        &self.voxels
    }

    /// The stored type.
    pub fn voxel_type(&self) -> VoxelType {
        self.voxels.voxel_type()
    }

    /// Factor from stored value to isovalue.
    pub fn slope(&self) -> f64 {
        self.slope
    }

    /// Isovalue of a stored 0.
    pub fn intercept(&self) -> f64 {
        self.intercept
    }

    /// What the volume is called in reports: the file's name or the phantom's specification.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Bytes that the voxels take.
    pub fn bytes(&self) -> usize {
        self.grid.len() * self.voxel_type().bytes()
    }

    /// Isovalue of the voxel at a linear index.
    ///
    /// # Panics
    /// When the index is out of range.
    pub fn isovalue(&self, linear: usize) -> f64 {
        self.slope * self.voxels.get_f64(linear) + self.intercept
    }
}
