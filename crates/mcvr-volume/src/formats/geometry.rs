//! From a header's numbers to a grid.

use glam::{DMat3, DVec3};

use super::source::Source;
use crate::{Grid, VolumeError, checked_voxel_count};

/// A map from voxel index to world: `origin + axes * index`, in the header's unit of length.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Affine {
    /// Column a is the step in the world from one voxel to the next along grid axis a.
    pub(crate) axes: DMat3,
    /// Centre of the first voxel.
    pub(crate) origin: DVec3,
}

impl Affine {
    /// Axes along the world's.
    pub(crate) fn axis_aligned(spacing: DVec3, origin: DVec3) -> Self {
        Self { axes: DMat3::from_diagonal(spacing), origin }
    }

    /// True when the axes span the space and all numbers are finite, so that it can place a grid.
    pub(crate) fn is_usable(&self) -> bool {
        let (spacing, direction) = self.split();
        self.origin.is_finite()
            && spacing.is_finite()
            && spacing.min_element() > 0.0
            && direction.is_finite()
            && direction.determinant().abs() >= 1e-6
    }

    /// Spacing (lengths of the columns) and direction (columns of length 1). A shear stays in the direction, whose
    /// columns are then not at right angles: the map from index to world is kept exactly.
    pub(crate) fn split(&self) -> (DVec3, DMat3) {
        let [x, y, z] = [self.axes.x_axis, self.axes.y_axis, self.axes.z_axis];
        let spacing = DVec3::new(x.length(), y.length(), z.length());
        (spacing, DMat3::from_cols(x / spacing.x, y / spacing.y, z / spacing.z))
    }

    /// The grid, with lengths multiplied by `to_mm`.
    ///
    /// # Errors
    /// [`VolumeError::Header`] when the axes do not span the space or a number is not finite.
    pub(crate) fn grid(
        &self,
        source: &Source,
        format: &'static str,
        dims: [usize; 3],
        to_mm: f64,
    ) -> Result<Grid, VolumeError> {
        let (spacing, direction) = self.split();
        Grid::new(dims, spacing * to_mm, self.origin * to_mm, direction)
            .map_err(|e| source.header_error(format, "spacing, origin and direction", e.to_string()))
    }

    /// What to tell a user about axes that are not at right angles; `None` when they are.
    pub(crate) fn shear_note(&self) -> Option<String> {
        let (_, d) = self.split();
        let worst = d.x_axis.dot(d.y_axis).abs().max(d.y_axis.dot(d.z_axis).abs()).max(d.z_axis.dot(d.x_axis).abs());
        (worst > 1e-3).then(|| {
            format!(
                "the grid is sheared: its axes are up to {:.2} degrees off a right angle",
                worst.asin().to_degrees()
            )
        })
    }
}

/// Extents from a header, checked: positive, and few enough to count.
///
/// # Errors
/// [`VolumeError::Header`] that names the field.
pub(crate) fn checked_dims(
    source: &Source,
    format: &'static str,
    field: &str,
    dims: &[i64],
) -> Result<[usize; 3], VolumeError> {
    let fail = |problem: String| source.header_error(format, field, problem);
    let &[x, y, z] = dims else { return Err(fail(format!("three extents are needed, got {}", dims.len()))) };
    let positive = |n: i64| {
        usize::try_from(n).ok().filter(|&n| n > 0).ok_or_else(|| fail(format!("extents must be at least 1, got {n}")))
    };
    let dims = [positive(x)?, positive(y)?, positive(z)?];
    checked_voxel_count(dims).map_err(|e| fail(e.to_string()))?;
    Ok(dims)
}

/// Millimetres per named unit of length; `None` when the name is unknown.
pub(crate) fn millimetres(unit: &str) -> Option<f64> {
    match unit.trim().to_ascii_lowercase().as_str() {
        "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => Some(1.0),
        "cm" | "centimeter" | "centimeters" => Some(10.0),
        "m" | "meter" | "meters" | "metre" | "metres" => Some(1000.0),
        "um" | "µm" | "micron" | "microns" | "micrometer" | "micrometers" => Some(1e-3),
        "nm" | "nanometer" | "nanometers" => Some(1e-6),
        _ => None,
    }
}
