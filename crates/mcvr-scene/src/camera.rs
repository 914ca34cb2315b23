//! Cameras: a 3×4 matrix from world millimetres to homogeneous pixels, and the rays that go with it.

use glam::{DMat3, DVec3};
use mcvr_volume::Grid;

use crate::SceneError;

/// Width and height of an image in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Extent {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Extent {
    /// Most pixels that an image may have; keeps pixel indices within `i32` for the vector code.
    pub const MAX_PIXELS: usize = 1 << 30;

    /// Checks a size.
    ///
    /// # Errors
    /// [`SceneError::Image`] when a side is zero or there are more than [`Self::MAX_PIXELS`] pixels.
    pub fn new(width: usize, height: usize) -> Result<Self, SceneError> {
        match width.checked_mul(height) {
            Some(n) if n > 0 && n <= Self::MAX_PIXELS => Ok(Self { width, height }),
            _ => Err(SceneError::Image(format!(
                "size {width}x{height}: each side must be at least 1 and the product at most 2^30 pixels"
            ))),
        }
    }

    /// Number of pixels.
    pub fn pixels(self) -> usize {
        self.width * self.height
    }
}

impl std::str::FromStr for Extent {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        let bad = || format!("'{s}' is not a size; write WIDTHxHEIGHT, for example 400x400");
        let (w, h) = s.split_once(['x', 'X']).ok_or_else(bad)?;
        let (w, h) = (w.trim().parse().map_err(|_| bad())?, h.trim().parse().map_err(|_| bad())?);
        Extent::new(w, h).map_err(|e| e.to_string())
    }
}

impl std::fmt::Display for Extent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

/// A view of a volume by angles, as people give it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Direction from the volume's centre to the eye: degrees in the x-y plane from +x towards +y.
    pub azimuth: f64,
    /// Degrees above the x-y plane. The image's vertical is the projection of +z (at ±90 the limit).
    pub elevation: f64,
    /// Millimetres from the eye to the volume's centre; `None` for two diameters (of the grid's diagonal).
    pub distance: Option<f64>,
    /// Full angle in degrees across the image's shorter side; `None` to hold the bounding sphere.
    pub fov: Option<f64>,
    /// Parallel rays instead of a pinhole; the shorter side then spans what it spans at the centre.
    pub parallel: bool,
    /// Smallest depth (mm) that counts; `None` for a thousandth of a diameter.
    pub near: Option<f64>,
}

impl Default for View {
    fn default() -> Self {
        Self { azimuth: 30.0, elevation: 20.0, distance: None, fov: None, parallel: false, near: None }
    }
}

/// A camera: `world_to_pixel * (x, y, z, 1) = w * (px, py, 1)` with x, y, z in mm. Pixel (0, 0), the
/// top left one, spans `[0, 1)²`. For a pinhole `w` is the depth in mm along the optical axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Left 3×3 block, by rows.
    rows: [DVec3; 3],
    /// Last column.
    shift: DVec3,
    extent: Extent,
    parallel: bool,
    near: f64,
    inverse: DMat3,
    det: f64,
}

/// A ray through a point of the image plane.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// A point on the ray (mm): the eye, or for a parallel camera a point near the volume.
    pub origin: DVec3,
    /// Unit direction away from the eye.
    pub direction: DVec3,
    /// Parameter (mm along the direction) where the near plane is met; minus infinity if there is none.
    pub start: f64,
}

impl Camera {
    /// A camera from a projection matrix, as a calibrated C-arm or a registration program has it. The
    /// matrix may carry any non-zero factor: it is scaled so that the third row's first three entries have
    /// length 1 (pinhole) and signed so that the grid's centre lies in front.
    ///
    /// `near` is the smallest depth in mm that counts (ignored by a parallel camera).
    ///
    /// # Errors
    /// [`SceneError::Camera`] when an entry is not finite, the matrix is degenerate, `near` is not positive,
    /// or the grid's centre lies in the plane of the eye.
    pub fn from_matrix(
        matrix: [[f64; 4]; 3],
        extent: Extent,
        grid: &Grid,
        near: Option<f64>,
    ) -> Result<Self, SceneError> {
        Self::signed(matrix, extent, grid, near, None)
    }

    /// As [`Camera::from_matrix`]; `sign` is the depth's sign where it is known rather than told from the grid's centre.
    fn signed(
        matrix: [[f64; 4]; 3],
        extent: Extent,
        grid: &Grid,
        near: Option<f64>,
        sign: Option<f64>,
    ) -> Result<Self, SceneError> {
        if matrix.iter().flatten().any(|v| !v.is_finite()) {
            return Err(SceneError::Camera(format!("every entry of the 3x4 matrix must be finite, got {matrix:?}")));
        }
        let given = matrix;
        let matrix = normalised(matrix);
        let near = near.unwrap_or(grid.diameter() * 1e-3);
        if !near.is_finite() || near <= 0.0 {
            return Err(SceneError::Camera(format!("the near plane must be a positive distance in mm, got {near}")));
        }
        let rows = matrix.map(|r| DVec3::new(r[0], r[1], r[2]));
        let shift = DVec3::new(matrix[0][3], matrix[1][3], matrix[2][3]);
        let axis = rows[2].length();
        // A third row that moves w by less than rounding over the whole scan has no perspective.
        let parallel = axis * grid.diameter() <= 1e-12 * shift.z.abs();
        let scale = if parallel {
            1.0 / shift.z
        } else {
            let w = sign.unwrap_or_else(|| rows[2].dot(grid.centre()) + shift.z);
            if w == 0.0 {
                return Err(SceneError::Camera("the volume's centre lies in the plane of the eye".into()));
            }
            w.signum() / axis
        };
        let mut rows = rows.map(|r| r * scale);
        let mut shift = shift * scale;
        if parallel {
            rows[2] = DVec3::ZERO;
            shift.z = 1.0;
        }
        let depth_axis = if parallel { rows[0].cross(rows[1]).normalize_or_zero() } else { rows[2] };
        let full = DMat3::from_cols(rows[0], rows[1], depth_axis).transpose();
        let det = full.determinant().abs();
        let size = rows[0].length() * rows[1].length();
        if !det.is_finite() || !size.is_finite() || det <= 1e-12 * size || depth_axis == DVec3::ZERO {
            return Err(SceneError::Camera(format!("the 3x4 matrix is degenerate: {given:?}")));
        }
        Ok(Self { rows, shift, extent, parallel, near, inverse: full.inverse(), det })
    }

    /// The same view in blocks of `side` by `side` pixels, with `margin` more blocks on every side: pixel (x, y) becomes
    /// (x / side + margin, y / side + margin). Blocks at the right and lower edge may reach beyond the image.
    ///
    /// # Errors
    /// [`SceneError::Image`] when there are too many pixels.
    pub fn in_blocks(&self, side: u32, margin: usize) -> Result<Self, SceneError> {
        let Extent { width, height } = self.extent;
        let blocks = |pixels: usize| pixels.div_ceil(side.max(1) as usize) + 2 * margin;
        let extent = Extent::new(blocks(width), blocks(height))?;
        let (side, by) = (f64::from(side.max(1)), margin as f64);
        let mut moved = Self { extent, det: self.det / (side * side), ..self.clone() };
        for n in 0..2 {
            moved.rows[n] = self.rows[n] / side + self.rows[2] * by;
            moved.shift[n] = self.shift[n] / side + self.shift.z * by;
        }
        moved.inverse = if self.parallel {
            let m = self.inverse;
            DMat3::from_cols(m.x_axis * side, m.y_axis * side, m.z_axis)
        } else {
            DMat3::from_cols(moved.rows[0], moved.rows[1], moved.rows[2]).transpose().inverse()
        };
        Ok(moved)
    }

    /// A camera that looks at the grid's centre from the given angles.
    ///
    /// # Errors
    /// [`SceneError::Camera`] when the distance or the near plane is not positive, an angle is not finite, or
    /// the field of view is not between 0 and 180 degrees.
    pub fn look(view: &View, grid: &Grid, extent: Extent) -> Result<Self, SceneError> {
        let fail = |what: String| Err(SceneError::Camera(what));
        if !view.azimuth.is_finite() || !view.elevation.is_finite() {
            return fail(format!("view angles must be finite, got {},{}", view.azimuth, view.elevation));
        }
        let diameter = grid.diameter();
        let distance = view.distance.unwrap_or(2.0 * diameter);
        if !distance.is_finite() || distance <= 0.0 {
            return fail(format!("the distance must be positive, in mm; got {distance}"));
        }
        // The whole kernel support of the outermost voxels fits: bspline3 reaches 1.5 voxels past the
        // boundary that `diameter` counts.
        let radius = 0.5 * diameter + 1.5 * grid.spacing().length();
        let half_tan = match view.fov {
            Some(fov) if fov > 0.0 && fov < 180.0 => (fov.to_radians() * 0.5).tan(),
            Some(fov) => return fail(format!("the field of view must lie between 0 and 180 degrees, got {fov}")),
            None if distance > radius => 1.02 * radius / (distance * distance - radius * radius).sqrt(),
            None => 45f64.to_radians().tan(),
        };
        let (sa, ca) = view.azimuth.to_radians().sin_cos();
        let (se, ce) = view.elevation.to_radians().sin_cos();
        let to_eye = DVec3::new(ce * ca, ce * sa, se);
        let right = DVec3::new(-sa, ca, 0.0);
        let up = to_eye.cross(right);
        let (width, height) = (extent.width as f64, extent.height as f64);
        let focal = 0.5 * width.min(height) / half_tan;
        let (cx, cy) = (0.5 * width, 0.5 * height);
        let centre = grid.centre();
        let (rows, eye_free): ([DVec3; 3], DVec3) = if view.parallel {
            let scale = focal / distance;
            ([right * scale, -up * scale, DVec3::ZERO], DVec3::new(cx, cy, 1.0))
        } else {
            let axis = -to_eye;
            ([right * focal + axis * cx, -up * focal + axis * cy, axis], DVec3::new(cx, cy, 1.0) * distance)
        };
        let shift: [f64; 3] = std::array::from_fn(|r| eye_free[r] - rows[r].dot(centre));
        let matrix = std::array::from_fn(|r| [rows[r].x, rows[r].y, rows[r].z, shift[r]]);
        // The depth's sign is known: told from the grid's centre it would be lost to rounding when the eye is all but there.
        Self::signed(matrix, extent, grid, view.near, Some(1.0))
    }

    /// The matrix by rows, scaled as described at [`Camera`].
    pub fn world_to_pixel(&self) -> [[f64; 4]; 3] {
        std::array::from_fn(|r| [self.rows[r].x, self.rows[r].y, self.rows[r].z, self.shift[r]])
    }

    /// Size of the image.
    pub fn extent(&self) -> Extent {
        self.extent
    }

    /// True for parallel rays.
    pub fn is_parallel(&self) -> bool {
        self.parallel
    }

    /// Smallest depth in mm that counts; no effect on a parallel camera.
    pub fn near(&self) -> f64 {
        self.near
    }

    /// Position of the eye (mm), `None` for a parallel camera.
    pub fn eye(&self) -> Option<DVec3> {
        (!self.parallel).then(|| -(self.inverse * self.shift))
    }

    /// Unit vector along the optical axis, away from the eye.
    pub fn axis(&self) -> DVec3 {
        if self.parallel { self.rows[0].cross(self.rows[1]).normalize() } else { self.rows[2] }
    }

    /// Absolute determinant of the left 3×3 block (the third row being the optical axis): pixels² per mm²
    /// at depth 1 mm for a pinhole, pixels² per mm² for a parallel camera.
    pub fn det(&self) -> f64 {
        self.det
    }

    /// Inverse of the left 3×3 block: maps `(px, py, 1)` to the ray's direction per mm of depth.
    pub fn inverse(&self) -> DMat3 {
        self.inverse
    }

    /// Pixel coordinates and depth (mm; for a parallel camera along its axis from the world's origin) of a
    /// world point. For a pinhole with depth ≤ 0 the pixel coordinates mean nothing.
    pub fn project(&self, x: DVec3) -> (f64, f64, f64) {
        let q = DVec3::new(self.rows[0].dot(x), self.rows[1].dot(x), self.rows[2].dot(x)) + self.shift;
        if self.parallel { (q.x, q.y, self.axis().dot(x)) } else { (q.x / q.z, q.y / q.z, q.z) }
    }

    /// The ray through the point (px, py) of the image.
    pub fn ray(&self, px: f64, py: f64) -> Ray {
        if self.parallel {
            let origin = self.inverse * DVec3::new(px - self.shift.x, py - self.shift.y, 0.0);
            return Ray { origin, direction: self.axis(), start: f64::NEG_INFINITY };
        }
        let per_depth = self.inverse * DVec3::new(px, py, 1.0);
        let stretch = per_depth.length();
        Ray { origin: -(self.inverse * self.shift), direction: per_depth / stretch, start: self.near * stretch }
    }

    /// Depth (mm) gained per mm of way along the ray through (px, py); 1 for a parallel camera.
    pub fn depth_rate(&self, px: f64, py: f64) -> f64 {
        if self.parallel { 1.0 } else { 1.0 / (self.inverse * DVec3::new(px, py, 1.0)).length() }
    }

    /// What a sample at pixel position (px, py) and depth `z` (mm) contributes to the `line` estimand per unit
    /// of its share of the mass: `|det M| |M⁻¹(px, py, 1)| / z²` for a pinhole with `M` the left 3×3 block,
    /// which for square pixels of area A at distance d is METHOD's `(1/A) (d/z)² √(1 + (u²+v²)/d²)`; a constant
    /// for a parallel camera. In mm⁻². The `count` reference weights the density by the reciprocal.
    pub fn line_factor(&self, px: f64, py: f64, z: f64) -> f64 {
        if self.parallel { self.det } else { self.det * (self.inverse * DVec3::new(px, py, 1.0)).length() / (z * z) }
    }

    /// Grid axis (0, 1, 2) most nearly along the optical axis.
    pub fn depth_axis(&self, grid: &Grid) -> usize {
        let along = (grid.direction().transpose() * self.axis()).abs().to_array();
        (0..3).max_by(|&a, &b| along[a].total_cmp(&along[b])).unwrap_or(0)
    }
}

/// The matrix times the power of two that brings its largest entry into [1, 2), so that no square of an entry overflows and none
/// that matters vanishes. No digit changes.
fn normalised(matrix: [[f64; 4]; 3]) -> [[f64; 4]; 3] {
    let largest = matrix.iter().flatten().fold(0.0f64, |m, v| m.max(v.abs()));
    if largest == 0.0 {
        return matrix;
    }
    let exponent = largest.log2().floor() as i32;
    // In two steps, each of which is a number.
    let (first, second) = (2f64.powi(-exponent / 2), 2f64.powi(-exponent - -exponent / 2));
    matrix.map(|r| r.map(|v| v * first * second))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Grid {
        Grid::new([20, 30, 40], DVec3::new(1.0, 0.5, 2.0), DVec3::new(5.0, -3.0, 11.0), DMat3::IDENTITY).unwrap()
    }

    fn cameras() -> Vec<Camera> {
        let extent = Extent::new(60, 50).unwrap();
        let mut all = vec![];
        for (azimuth, elevation) in [(30.0, 20.0), (0.0, 0.0), (200.0, 90.0), (10.0, -90.0), (-45.0, -35.0)] {
            for parallel in [false, true] {
                let view = View { azimuth, elevation, parallel, ..View::default() };
                all.push(Camera::look(&view, &grid(), extent).unwrap());
            }
        }
        all
    }

    #[test]
    fn the_centre_of_the_grid_is_the_centre_of_the_image() {
        for c in cameras() {
            let (px, py, _) = c.project(grid().centre());
            assert!((px - 30.0).abs() < 1e-9 && (py - 25.0).abs() < 1e-9, "{px}, {py}");
        }
    }

    #[test]
    fn every_corner_of_the_kernel_support_is_inside_the_default_image() {
        for c in cameras() {
            for corner in grid().corners(2.0) {
                let (px, py, z) = c.project(corner);
                assert!(c.is_parallel() || z > c.near());
                assert!((0.0..60.0).contains(&px) && (0.0..50.0).contains(&py), "{px}, {py}");
            }
        }
    }

    #[test]
    fn a_point_on_a_ray_projects_back_to_its_pixel() {
        for c in cameras() {
            let ray = c.ray(12.25, 40.5);
            let (px, py, _) = c.project(ray.origin + ray.direction * 173.0);
            assert!((px - 12.25).abs() < 1e-8 && (py - 40.5).abs() < 1e-8);
        }
    }

    #[test]
    fn up_is_up_and_the_right_hand_side_is_right() {
        let c = &cameras()[2]; // azimuth 0, elevation 0: from +x towards -x
        let centre = grid().centre();
        assert!(c.project(centre + DVec3::Z).1 < 25.0, "+z lies above");
        assert!(c.project(centre + DVec3::Y).0 > 30.0, "+y lies to the right when seen from +x");
    }

    #[test]
    fn line_factor_is_the_jacobian_of_pixel_and_path_length() {
        // dx = di dj dl / line_factor: compare with the volume spanned by finite differences.
        for c in cameras() {
            let (px, py, h) = (20.0, 33.0, 1e-4);
            let at = |px: f64, py: f64, l: f64| {
                let r = c.ray(px, py);
                r.origin + r.direction * l
            };
            let l = 150.0;
            let x = at(px, py, l);
            let cell =
                DMat3::from_cols((at(px + h, py, l) - x) / h, (at(px, py + h, l) - x) / h, (at(px, py, l + h) - x) / h);
            let z = c.project(x).2;
            let product = cell.determinant().abs() * c.line_factor(px, py, z);
            assert!((product - 1.0).abs() < 1e-4, "{product}");
        }
    }

    #[test]
    fn any_factor_of_the_matrix_gives_the_same_camera() {
        for c in cameras() {
            let m = c.world_to_pixel().map(|r| r.map(|v| v * -3.5));
            let d = Camera::from_matrix(m, c.extent(), &grid(), Some(c.near())).unwrap();
            for (a, b) in c.world_to_pixel().iter().flatten().zip(d.world_to_pixel().iter().flatten()) {
                assert!((a - b).abs() < 1e-9 * (1.0 + a.abs()), "{a} {b}");
            }
        }
    }

    #[test]
    fn degenerate_cameras_are_refused() {
        let e = Extent::new(4, 4).unwrap();
        assert!(Camera::from_matrix([[0.0; 4]; 3], e, &grid(), None).is_err());
        assert!(Camera::from_matrix([[f64::NAN; 4]; 3], e, &grid(), None).is_err());
        assert!(Camera::look(&View { fov: Some(180.0), ..View::default() }, &grid(), e).is_err());
        assert!(Camera::look(&View { distance: Some(0.0), ..View::default() }, &grid(), e).is_err());
        assert!(Extent::new(0, 4).is_err());
        assert!(Extent::new(usize::MAX, 2).is_err());
    }
}
