//! A pinhole camera as other programs describe it: a point source and a flat detector.

use glam::DVec3;
use mcvr_scene::Camera;
use mcvr_volume::Grid;
use serde::Serialize;

/// A point source and a flat rectangular detector behind the scan, all in world millimetres.
///
/// The centre of pixel (column i, row j), both from 0 and row 0 at the top, lies at
/// `centre + (i + 1/2 - width/2) pitch[0] column_axis + (j + 1/2 - height/2) pitch[1] row_axis`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Detector {
    /// Position of the source (the eye), mm.
    pub source: DVec3,
    /// Middle of the pixel rectangle, mm.
    pub centre: DVec3,
    /// Unit direction in which the column number grows.
    pub column_axis: DVec3,
    /// Unit direction in which the row number grows: down in the image.
    pub row_axis: DVec3,
    /// Distance between neighbouring columns and between neighbouring rows, mm.
    pub pitch: [f64; 2],
    /// Columns and rows.
    pub size: [usize; 2],
    /// Distance from the source to the detector's plane, mm.
    pub source_distance: f64,
    /// Distance from the source to the middle of the grid along the detector's normal, mm.
    pub centre_depth: f64,
    /// Foot of the perpendicular from the source, in pixels (0 is the left or upper edge of the first one).
    pub principal_point: [f64; 2],
}

/// Why a camera cannot be said as a [`Detector`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DetectorError {
    /// Rays do not meet in a point.
    #[error("the camera is parallel, and a point source with a flat detector is asked for; leave out --parallel")]
    Parallel,
    /// Rows and columns are not at right angles.
    #[error(
        "the camera's pixel rows and columns meet at {degrees:.4} degrees, and a detector's at 90: the matrix has skew"
    )]
    Skew {
        /// The angle.
        degrees: f64,
    },
    /// The near plane cuts the scan.
    #[error(
        "the scan begins at a depth of {depth:.6} mm, before the near plane at {near:.6} mm; other programs have no near plane: \
         move the eye away (--distance) or the plane nearer (--near)"
    )]
    Near {
        /// Smallest depth of the kernel's support of the outermost voxels, mm.
        depth: f64,
        /// The near plane, mm.
        near: f64,
    },
}

/// Largest cosine between rows and columns that counts as a right angle: far below what a pixel resolves.
const SQUARE: f64 = 1e-9;

/// The detector stands so many times farther from the source than the scan's middle, or behind the scan if that is farther.
const BEHIND: f64 = 1.5;

impl Detector {
    /// The camera's source and a detector behind the grid; where exactly the plane stands changes no pixel. `support` is the
    /// kernel's in voxels: it must lie between the near plane and the detector.
    ///
    /// # Errors
    /// [`DetectorError`] when no such detector sees what the camera sees.
    pub fn of(camera: &Camera, grid: &Grid, support: f64) -> Result<Self, DetectorError> {
        let source = camera.eye().ok_or(DetectorError::Parallel)?;
        let inverse = camera.inverse();
        let (column, row) = (inverse.x_axis, inverse.y_axis);
        let cosine = column.dot(row) / (column.length() * row.length());
        if cosine.abs() > SQUARE {
            return Err(DetectorError::Skew { degrees: cosine.acos().to_degrees() });
        }
        let depth = |x: DVec3| camera.project(x).2;
        let depths = grid.corners(support).map(depth);
        let nearest = depths.iter().copied().fold(f64::INFINITY, f64::min);
        if nearest < camera.near() {
            return Err(DetectorError::Near { depth: nearest, near: camera.near() });
        }
        let farthest = depths.iter().copied().fold(0.0, f64::max);
        let centre_depth = depth(grid.centre());
        let source_distance = (BEHIND * centre_depth).max(1.01 * farthest);
        let (width, height) = (camera.extent().width, camera.extent().height);
        let middle = inverse * DVec3::new(0.5 * width as f64, 0.5 * height as f64, 1.0);
        let (u, v, w) = camera.project(source + camera.axis() * source_distance);
        debug_assert!((w / source_distance - 1.0).abs() < 1e-9, "depth is measured along the axis");
        Ok(Self {
            source,
            centre: source + middle * source_distance,
            column_axis: column.normalize(),
            row_axis: row.normalize(),
            pitch: [column.length() * source_distance, row.length() * source_distance],
            size: [width, height],
            source_distance,
            centre_depth,
            principal_point: [u, v],
        })
    }

    /// World position of the centre of a pixel, mm.
    pub fn pixel(&self, column: usize, row: usize) -> DVec3 {
        let along = |n: usize, size: usize, pitch: f64| (n as f64 + 0.5 - 0.5 * size as f64) * pitch;
        self.centre
            + self.column_axis * along(column, self.size[0], self.pitch[0])
            + self.row_axis * along(row, self.size[1], self.pitch[1])
    }
}

#[cfg(test)]
mod tests {
    use glam::DMat3;
    use mcvr_scene::{Extent, View};

    use super::*;

    fn grid() -> Grid {
        let direction = DMat3::from_rotation_z(0.3) * DMat3::from_rotation_x(-0.7);
        Grid::new([20, 30, 40], DVec3::new(1.0, 0.5, 2.0), DVec3::new(5.0, -3.0, 11.0), direction).unwrap()
    }

    fn look(view: View) -> Camera {
        Camera::look(&view, &grid(), Extent::new(60, 50).unwrap()).unwrap()
    }

    #[test]
    fn every_pixel_centre_lies_on_its_ray_behind_the_scan() {
        for (azimuth, elevation) in [(30.0, 20.0), (0.0, 90.0), (-120.0, -35.0)] {
            let camera = look(View { azimuth, elevation, ..View::default() });
            let detector = Detector::of(&camera, &grid(), 1.0).unwrap();
            for (i, j) in [(0, 0), (59, 0), (0, 49), (31, 17)] {
                let (px, py, depth) = camera.project(detector.pixel(i, j));
                assert!((px - i as f64 - 0.5).abs() < 1e-9 && (py - j as f64 - 0.5).abs() < 1e-9, "{px} {py}");
                assert!((depth / detector.source_distance - 1.0).abs() < 1e-12);
            }
            assert!(grid().corners(1.0).iter().all(|&c| camera.project(c).2 < detector.source_distance));
            assert!(
                (detector.principal_point[0] - 30.0).abs() < 1e-9 && (detector.principal_point[1] - 25.0).abs() < 1e-9
            );
        }
    }

    #[test]
    fn oblong_pixels_and_a_shifted_principal_point_are_said_as_they_are() {
        let mut matrix = look(View::default()).world_to_pixel();
        let axis = matrix[2];
        // Columns twice as dense, and the whole image moved by 3.5 columns.
        matrix[0].iter_mut().for_each(|v| *v *= 2.0);
        for (v, a) in matrix[0].iter_mut().zip(axis) {
            *v += 3.5 * a;
        }
        let camera = Camera::from_matrix(matrix, Extent::new(120, 50).unwrap(), &grid(), None).unwrap();
        let detector = Detector::of(&camera, &grid(), 1.0).unwrap();
        assert!((detector.pitch[1] / detector.pitch[0] - 2.0).abs() < 1e-9);
        assert!((detector.principal_point[0] - 63.5).abs() < 1e-9);
        let (px, py, _) = camera.project(detector.pixel(7, 9));
        assert!((px - 7.5).abs() < 1e-9 && (py - 9.5).abs() < 1e-9);
    }

    #[test]
    fn what_is_no_point_source_with_a_flat_detector_is_refused() {
        let of = |camera: &Camera| Detector::of(camera, &grid(), 1.0).unwrap_err();
        assert_eq!(of(&look(View { parallel: true, ..View::default() })), DetectorError::Parallel);
        let inside = look(View { distance: Some(5.0), ..View::default() });
        assert!(matches!(of(&inside), DetectorError::Near { .. }));
        let mut matrix = look(View::default()).world_to_pixel();
        let rows = matrix[1];
        for (v, other) in matrix[0].iter_mut().zip(rows) {
            *v += 0.2 * other;
        }
        let skewed = Camera::from_matrix(matrix, Extent::new(60, 50).unwrap(), &grid(), None).unwrap();
        assert!(matches!(of(&skewed), DetectorError::Skew { .. }), "{:?}", of(&skewed));
    }
}
