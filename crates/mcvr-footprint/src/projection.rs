//! From index coordinates to pixels.

use glam::DVec3;
use mcvr_scene::Camera;
use mcvr_volume::Grid;

use crate::refine::Parts;

/// The camera over index coordinates from the grid's middle; depths in units of the least that counts.
pub(crate) struct Projection {
    /// Rows of the matrix: three index coordinates, then the shift.
    rows: [[f32; 4]; 3],
    /// Squares of the footprints' knot distances along the image's x and y times the depth, as `c[0] + c[1] v + c[2] v²` of the pixel
    /// coordinate `v`.
    squares: [[f32; 3]; 2],
    /// The ray's direction per unit of depth `c[0] px + c[1] py + c[2]`, 1 at most in the image.
    stretch: [[f32; 3]; 3],
    parallel: bool,
    /// Pixels along x and along y that a voxel's part moves along each of its axes, in the middle of the grid.
    pub steps: [[f32; 3]; 2],
    /// Least and largest knot distance along x and y of voxels that the image shows.
    pub spans: [[f32; 2]; 2],
    /// Least depth (mm) that counts, and the longest ray per mm of depth in the image with its margin.
    pub least_depth: f64,
    pub longest: f64,
}

/// A projected point: pixel coordinates, reciprocal depth, knot distances along x and y in pixels.
pub(crate) type Projected = [f32; 5];

impl Projection {
    /// For voxels in so many parts, and an image with so wide a margin; `None` where nothing lies at or behind the near plane.
    pub fn new(grid: &Grid, parts: Parts, camera: &Camera, margin: usize) -> Option<Self> {
        let m = camera.world_to_pixel();
        let world = grid.index_to_world();
        let of = |r: usize, v: DVec3| m[r][0] * v.x + m[r][1] * v.y + m[r][2] * v.z;
        let columns = [world.matrix3.x_axis, world.matrix3.y_axis, world.matrix3.z_axis];
        let mut rows: [[f64; 4]; 3] = std::array::from_fn(|r| {
            let [x, y, z] = columns.map(|c| of(r, c));
            [x, y, z, of(r, grid.centre()) + m[r][3]]
        });
        // Depth is linear: its extremes lie at corners of the box of the voxels' centres and those of their parts.
        let reach: f64 = (0..3).map(|a| (0.5 * (grid.dims()[a] as f64 - 1.0) + 1.0) * rows[2][a].abs()).sum();
        let (middle, parallel) = (rows[2][3], camera.is_parallel());
        let [near, far] = if parallel { [1.0; 2] } else { [(middle - reach).max(camera.near()), middle + reach] };
        if near > far {
            return None;
        }
        rows.iter_mut().flatten().for_each(|v| *v /= near);
        // A part's step along an axis moves `(rows[r][a] - v rows[2][a]) / z` pixels; a tent's variance is a sixth of the step's
        // square, and the knot distance's square three times the variance.
        let step = |r: usize, a: usize| rows[r][a] / f64::from(parts[a]);
        let half = |r: usize, s: usize| 0.5 * (0..3).map(|a| step(r, a) * step(s, a)).sum::<f64>();
        let squares = [0, 1].map(|r| [half(r, r), -2.0 * half(r, 2), half(2, 2)]);
        let extent = camera.extent();
        let ends = [extent.width, extent.height].map(|n| [-(margin as f64), (n + margin) as f64]);
        let spans = [0, 1].map(|r| {
            let [a, b, c] = squares[r];
            let at = |v: f64| (a + v * (b + v * c)).max(0.0).sqrt() as f32;
            let [low, high] = ends[r];
            let lowest = if c > 0.0 { (-0.5 * b / c).clamp(low, high) } else { low };
            [at(lowest).min(at(high)) * (near / far) as f32, at(low).max(at(high))]
        });
        let inverse = camera.inverse();
        let length = |x: f64, y: f64| (inverse * DVec3::new(x, y, 1.0)).length();
        let corners = ends[0].iter().flat_map(|&x| ends[1].iter().map(move |&y| (x, y)));
        let longest = if parallel { 1.0 } else { corners.map(|(x, y)| length(x, y)).fold(0.0, f64::max) };
        let columns = [inverse.x_axis, inverse.y_axis, inverse.z_axis];
        let [px, py] = [0, 1].map(|r| rows[r][3] / rows[2][3]);
        let steps =
            [(0, px), (1, py)].map(|(r, v)| [0, 1, 2].map(|a| ((step(r, a) - v * step(2, a)) / rows[2][3]) as f32));
        Some(Self {
            rows: rows.map(|r| r.map(|v| v as f32)),
            squares: squares.map(|r| r.map(|v| v as f32)),
            stretch: columns.map(|c| c.to_array().map(|v| (v / longest) as f32)),
            parallel,
            steps,
            spans,
            least_depth: near,
            longest,
        })
    }

    /// Projects a point; what lies before the near plane has a reciprocal depth outside (0, 1].
    #[inline(always)]
    pub fn at(&self, p: [f32; 3]) -> Projected {
        let [a, b, c] = &self.rows;
        let x = a[0] * p[0] + a[1] * p[1] + a[2] * p[2] + a[3];
        let y = b[0] * p[0] + b[1] * p[1] + b[2] * p[2] + b[3];
        let near = 1.0 / (c[0] * p[0] + c[1] * p[1] + c[2] * p[2] + c[3]);
        let (x, y) = (x * near, y * near);
        let [w, h] = &self.squares;
        let wide = (w[0] + x * (w[1] + x * w[2])).max(0.0).sqrt() * near;
        let high = (h[0] + y * (h[1] + y * h[2])).max(0.0).sqrt() * near;
        [x, y, near, wide, high]
    }

    /// The factor of `line` at a place, 1 at most; 1 for a parallel camera.
    #[inline(always)]
    pub fn line_factor(&self, px: f32, py: f32, near: f32) -> f32 {
        let [a, b, c] = &self.stretch;
        let x = a[0] * px + b[0] * py + c[0];
        let y = a[1] * px + b[1] * py + c[1];
        let z = a[2] * px + b[2] * py + c[2];
        if self.parallel { 1.0 } else { (x * x + y * y + z * z).sqrt() * (near * near) }
    }
}
