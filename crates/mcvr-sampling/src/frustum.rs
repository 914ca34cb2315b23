//! Which bricks of voxels a camera can see at all.

use glam::{DVec3, DVec4};
use mcvr_scene::{Camera, Kernel};
use mcvr_volume::Grid;

/// Pixels by which a brick must miss the image's border to be left out: the projection's rounding is far below.
const MARGIN: f64 = 1.0;

/// What a camera sees of a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sight {
    /// Perhaps something, or the near plane cuts it in two.
    Seen,
    /// Nothing: all of it projects beside the image.
    Beside,
    /// Nothing: all of it lies in front of the near plane.
    Near,
}

/// The half-spaces that hold all that a camera sees, in voxel coordinates, and how far kernels reach.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frustum {
    /// `(a, b)`: seen where `a·x + b >= 0`.
    sides: [(DVec3, f64); 4],
    near: Option<(DVec3, f64)>,
    reach: f64,
}

impl Frustum {
    /// `None` where the camera sees all of the grid, so that no brick needs a look of its own.
    pub(crate) fn cutting(camera: &Camera, grid: &Grid, kernel: Kernel) -> Option<Self> {
        let frustum = Self::new(camera, grid, kernel);
        (!frustum.holds([0; 3], grid.dims().map(|n| (n - 1) as u32))).then_some(frustum)
    }

    fn new(camera: &Camera, grid: &Grid, kernel: Kernel) -> Self {
        let to_world = grid.index_to_world();
        let rows = camera.world_to_pixel().map(DVec4::from_array);
        // A homogeneous pixel coordinate as a function of the voxel index.
        let index = |row: DVec4| {
            let plane = to_world.matrix3.transpose() * row.truncate();
            (plane, row.truncate().dot(to_world.translation) + row.w)
        };
        let (w, h) = (camera.extent().width as f64, camera.extent().height as f64);
        let [x, y, z] = rows;
        let sides = [x + z * MARGIN, z * (w + MARGIN) - x, y + z * MARGIN, z * (h + MARGIN) - y].map(index);
        let near = (!camera.is_parallel()).then(|| index(z - DVec4::W * camera.near()));
        Self { sides, near, reach: kernel.support() }
    }

    /// Middle and half extents of the box of all samples of some voxels.
    fn reach(&self, low: [u32; 3], high: [u32; 3]) -> (DVec3, DVec3) {
        let low = DVec3::from_array(low.map(f64::from));
        let high = DVec3::from_array(high.map(f64::from));
        ((low + high) * 0.5, (high - low) * 0.5 + self.reach)
    }

    /// True when every sample of the voxels from `low` to `high`, both included, is seen.
    fn holds(&self, low: [u32; 3], high: [u32; 3]) -> bool {
        let (middle, half) = self.reach(low, high);
        self.near.iter().chain(&self.sides).all(|(a, b)| a.dot(middle) + b - a.abs().dot(half) >= 0.0)
    }

    /// What is seen of the samples of the voxels from `low` to `high`, both included.
    pub(crate) fn see(&self, low: [u32; 3], high: [u32; 3]) -> Sight {
        let (middle, half) = self.reach(low, high);
        let outside = |(a, b): &(DVec3, f64)| {
            // Rounding of the sums is far below 1e-9 of their terms.
            let size = a.abs().dot(middle.abs() + half) + b.abs();
            a.dot(middle) + b + a.abs().dot(half) + 1e-9 * size < 0.0
        };
        let before = |(a, b): &(DVec3, f64)| a.dot(middle) + b - a.abs().dot(half) < 0.0;
        if self.near.as_ref().is_some_and(outside) {
            Sight::Near
        } else if self.near.as_ref().is_some_and(before) {
            // The near plane passes through it: only samples tell how much of its mass is cut off.
            Sight::Seen
        } else if self.sides.iter().any(outside) {
            Sight::Beside
        } else {
            Sight::Seen
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_scene::{Extent, View};
    use proptest::prelude::*;

    proptest! {
        /// No point of a box that is left out lies in the image.
        #[test]
        fn nothing_that_is_seen_is_left_out(
            azimuth in -180.0..180.0f64, elevation in -90.0..90.0f64, distance in 0.1..3.0f64, fov in 1.0..120.0f64,
            parallel in any::<bool>(), near in 0.01..1.5f64, low in [0u32..30, 0u32..20, 0u32..10],
            size in [0u32..9, 0u32..9, 0u32..9], u in any::<[u16; 3]>()
        ) {
            let grid = Grid::with_spacing([40, 30, 20], [1.0, 0.5, 2.0]).expect("a grid");
            let (distance, near) = (Some(distance * grid.diameter()), Some(near * grid.diameter()));
            let view = View { azimuth, elevation, distance, fov: Some(fov), parallel, near };
            let camera = Camera::look(&view, &grid, Extent::new(64, 48).expect("a size")).expect("a camera");
            let frustum = Frustum::new(&camera, &grid, Kernel::Bspline3);
            let high = [low[0] + size[0], low[1] + size[1], low[2] + size[2]];
            let at: [f64; 3] = std::array::from_fn(|a| {
                f64::from(low[a]) - 2.0 + (f64::from(size[a]) + 4.0) * f64::from(u[a]) / 65535.0
            });
            let (px, py, z) = camera.project(grid.index_to_world().transform_point3(at.into()));
            let ahead = parallel || z >= camera.near();
            let inside = ahead && (0.0..64.0).contains(&px) && (0.0..48.0).contains(&py);
            match frustum.see(low, high) {
                Sight::Seen => {}
                Sight::Near => prop_assert!(!ahead),
                Sight::Beside => prop_assert!(!inside),
            }
            if frustum.holds(low, high) {
                prop_assert!(ahead && (-1.0..=65.0).contains(&px) && (-1.0..=49.0).contains(&py));
                prop_assert_eq!(frustum.see(low, high), Sight::Seen);
            }
        }
    }

    #[test]
    fn a_close_up_leaves_most_of_a_volume_out_and_a_whole_view_nothing() {
        let grid = Grid::with_spacing([64, 64, 64], [1.0; 3]).expect("a grid");
        let seen = |fov: Option<f64>| {
            let view = View { fov, ..View::default() };
            let camera = Camera::look(&view, &grid, Extent::new(64, 64).expect("a size")).expect("a camera");
            let frustum = Frustum::new(&camera, &grid, Kernel::Tent);
            let corners = (0..512u32).map(|i| [i % 8 * 8, i / 8 % 8 * 8, i / 64 * 8]);
            corners.filter(|low| frustum.see(*low, low.map(|v| v + 7)) == Sight::Seen).count()
        };
        assert_eq!(seen(None), 512);
        let extent = Extent::new(64, 64).expect("a size");
        let cutting = |fov| {
            let camera = Camera::look(&View { fov, ..View::default() }, &grid, extent).expect("a camera");
            Frustum::cutting(&camera, &grid, Kernel::Tent).is_some()
        };
        assert!(!cutting(None) && cutting(Some(4.0)));
        // The pyramid is 15 voxels wide at the centre; boxes of 10 with their kernels, turned, add about 13: a tube of
        // 28 x 28 x 77 voxels is 118 boxes.
        let close = seen(Some(4.0));
        assert!((60..180).contains(&close), "{close}");
    }
}
