//! The regular grid on which voxels live, and its place in the world.

use glam::{DAffine3, DMat3, DVec3};

use crate::VolumeError;

/// Extent, spacing, origin and direction of a regular 3-D grid.
///
/// Axis order is (x, y, z) everywhere; in memory x varies fastest, so voxel (i, j, k) has the linear
/// index `i + nx * (j + ny * k)`. The centre of voxel (i, j, k) lies at
/// `origin + direction * (spacing * (i, j, k))` millimetres (METHOD section 1).
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    dims: [usize; 3],
    spacing: DVec3,
    origin: DVec3,
    direction: DMat3,
}

impl Grid {
    /// Most voxels that a grid may have: linear indices and sums of them stay far from overflow.
    pub const MAX_VOXELS: u64 = 1 << 40;

    /// Smallest and largest spacing in mm: squares of lengths, volumes and their reciprocals stay within the range of numbers.
    pub const SPACINGS: [f64; 2] = [1e-50, 1e50];

    /// Most by which the spacings may differ: an index rounds to 2^-53 of this.
    pub const MAX_SPACING_RATIO: f64 = 1e9;

    /// Farthest that an origin may be from the world's, in mm.
    pub const MAX_ORIGIN: f64 = 1e50;

    /// A grid with its first voxel's centre at `origin` (mm), `spacing` in mm per voxel along each
    /// grid axis, and `direction` whose columns are the world directions of the grid axes.
    ///
    /// # Errors
    /// [`VolumeError::Grid`] when an extent is zero, the voxel count exceeds [`Self::MAX_VOXELS`],
    /// a spacing is not positive and finite or beyond [`Self::SPACINGS`], two differ by more than
    /// [`Self::MAX_SPACING_RATIO`], the origin is beyond [`Self::MAX_ORIGIN`], the direction is singular or not finite, or a
    /// voxel's volume or the grid's diameter leaves the range of normal numbers.
    pub fn new(dims: [usize; 3], spacing: DVec3, origin: DVec3, direction: DMat3) -> Result<Self, VolumeError> {
        checked_voxel_count(dims)?;
        if !spacing.is_finite() || spacing.min_element() <= 0.0 {
            return Err(VolumeError::Grid(format!("spacing must be positive and finite on every axis, got {spacing}")));
        }
        let [least, most] = Self::SPACINGS;
        let (small, large) = (spacing.min_element(), spacing.max_element());
        if small < least || large > most || large / small > Self::MAX_SPACING_RATIO {
            return Err(VolumeError::Grid(format!(
                "spacing must lie between {least:e} and {most:e} mm and differ between axes by at most a factor of {:e}, \
                 got {spacing:?}",
                Self::MAX_SPACING_RATIO
            )));
        }
        if !origin.is_finite() || origin.abs().max_element() > Self::MAX_ORIGIN {
            return Err(VolumeError::Grid(format!(
                "origin must be finite and at most {:e} mm from 0 on every axis, got {origin:?}",
                Self::MAX_ORIGIN
            )));
        }
        let det = direction.determinant();
        if !direction.is_finite() || !det.is_finite() || det.abs() < 1e-6 {
            return Err(VolumeError::Grid(format!("direction matrix must be invertible, its determinant is {det}")));
        }
        let grid = Self { dims, spacing, origin, direction };
        // Masses are multiples of the one, distances of the other.
        let (voxel, diameter) = (grid.voxel_volume(), grid.diameter());
        if !voxel.is_normal() || !diameter.is_normal() || !grid.centre().is_finite() {
            return Err(VolumeError::Grid(format!(
                "spacing {spacing} and origin {origin} exceed 64-bit numbers: a voxel takes {voxel:e} mm³, the diameter is {diameter:e} mm"
            )));
        }
        Ok(grid)
    }

    /// A grid with origin 0 and identity direction, as raw files have.
    ///
    /// # Errors
    /// As [`Grid::new`].
    pub fn with_spacing(dims: [usize; 3], spacing: [f64; 3]) -> Result<Self, VolumeError> {
        Self::new(dims, DVec3::from_array(spacing), DVec3::ZERO, DMat3::IDENTITY)
    }

    /// Number of voxels along (x, y, z).
    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// Number of voxels.
    pub fn len(&self) -> usize {
        self.dims[0] * self.dims[1] * self.dims[2]
    }

    /// Never true: an empty grid cannot be made.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// Millimetres per voxel along (x, y, z).
    pub fn spacing(&self) -> DVec3 {
        self.spacing
    }

    /// World position (mm) of the centre of voxel (0, 0, 0).
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// Direction matrix; column a is the world direction of grid axis a.
    pub fn direction(&self) -> DMat3 {
        self.direction
    }

    /// Volume of one voxel in mm³ (`h_x h_y h_z |det D|`; the determinant is 1 for a rotation).
    pub fn voxel_volume(&self) -> f64 {
        self.spacing.element_product() * self.direction.determinant().abs()
    }

    /// Map from continuous voxel index to world millimetres.
    pub fn index_to_world(&self) -> DAffine3 {
        DAffine3::from_mat3_translation(self.direction * DMat3::from_diagonal(self.spacing), self.origin)
    }

    /// Map from world millimetres to continuous voxel index.
    pub fn world_to_index(&self) -> DAffine3 {
        self.index_to_world().inverse()
    }

    /// Continuous index of the middle of the grid.
    pub fn centre_index(&self) -> DVec3 {
        (DVec3::new(self.dims[0] as f64, self.dims[1] as f64, self.dims[2] as f64) - 1.0) * 0.5
    }

    /// World position (mm) of the middle of the grid.
    pub fn centre(&self) -> DVec3 {
        self.index_to_world().transform_point3(self.centre_index())
    }

    /// Physical size (mm) along the grid axes, whole voxels counted (`dims * spacing`).
    pub fn size_mm(&self) -> DVec3 {
        DVec3::new(self.dims[0] as f64, self.dims[1] as f64, self.dims[2] as f64) * self.spacing
    }

    /// Length of the grid's diagonal (mm), whole voxels counted: the "diameter" of the scan.
    pub fn diameter(&self) -> f64 {
        let m = self.index_to_world().matrix3;
        let [x, y, z] = self.dims.map(|n| n as f64);
        let corner = |sx: f64, sy: f64, sz: f64| (m * DVec3::new(sx * x, sy * y, sz * z)).length();
        corner(1., 1., 1.).max(corner(-1., 1., 1.)).max(corner(1., -1., 1.)).max(corner(1., 1., -1.))
    }

    /// World corners (mm) of the box that spans `margin` voxels beyond the outermost voxel centres.
    pub fn corners(&self, margin: f64) -> [DVec3; 8] {
        let to_world = self.index_to_world();
        std::array::from_fn(|c| {
            let pick = |axis: usize| if c >> axis & 1 == 0 { -margin } else { self.dims[axis] as f64 - 1.0 + margin };
            to_world.transform_point3(DVec3::new(pick(0), pick(1), pick(2)))
        })
    }

    /// Linear index of voxel (i, j, k); x varies fastest.
    pub fn linear(&self, [i, j, k]: [usize; 3]) -> usize {
        i + self.dims[0] * (j + self.dims[1] * k)
    }

    /// Voxel (i, j, k) of a linear index.
    pub fn unravel(&self, linear: usize) -> [usize; 3] {
        let (nx, ny) = (self.dims[0], self.dims[1]);
        [linear % nx, linear / nx % ny, linear / (nx * ny)]
    }
}

/// Number of voxels of a grid of these extents, checked before anything is allocated.
///
/// # Errors
/// [`VolumeError::Grid`] when an extent is zero or the product overflows [`Grid::MAX_VOXELS`].
pub fn checked_voxel_count(dims: [usize; 3]) -> Result<usize, VolumeError> {
    if dims.contains(&0) {
        return Err(VolumeError::Grid(format!(
            "every extent must be at least 1, got {}x{}x{}",
            dims[0], dims[1], dims[2]
        )));
    }
    let n = dims.iter().try_fold(1u64, |n, &d| n.checked_mul(d as u64)).filter(|&n| n <= Grid::MAX_VOXELS);
    n.map(|n| n as usize).ok_or_else(|| {
        VolumeError::Grid(format!("{}x{}x{} voxels exceed the limit of 2^40", dims[0], dims[1], dims[2]))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn index_and_world_are_inverse_for_a_left_handed_oblique_grid() {
        let d = DMat3::from_cols(DVec3::new(0.0, 1.0, 0.0), DVec3::new(1.0, 0.0, 0.0), DVec3::new(0.0, 0.6, 0.8));
        let g = Grid::new([3, 4, 5], DVec3::new(0.5, 2.0, 3.0), DVec3::new(-7.0, 8.0, 1e4), d).unwrap();
        let p = DVec3::new(1.25, 2.5, 3.75);
        let q = g.world_to_index().transform_point3(g.index_to_world().transform_point3(p));
        assert!((p - q).length() < 1e-9);
    }

    #[test]
    fn extents_that_overflow_are_refused_before_memory_is_taken() {
        assert!(checked_voxel_count([usize::MAX, 2, 2]).is_err());
        assert!(checked_voxel_count([0, 2, 2]).is_err());
        assert!(checked_voxel_count([1 << 20, 1 << 20, 2]).is_err());
        assert_eq!(checked_voxel_count([301, 324, 56]).unwrap(), 5_461_344);
    }

    #[test]
    fn linear_and_unravel_are_inverse() {
        let g = Grid::with_spacing([3, 4, 5], [1.0; 3]).unwrap();
        for n in 0..g.len() {
            assert_eq!(g.linear(g.unravel(n)), n);
        }
    }
}
