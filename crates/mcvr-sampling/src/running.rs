//! The weights one after another, for methods that decide voxel by voxel.

use mcvr_volume::with_voxels;

use crate::Distribution;
use crate::order::{BRICK, Layout, with_layout};
use crate::units::with_units;
use crate::word::Word;

impl Distribution<'_> {
    /// Visits every voxel that can be drawn, in order: its first target and its integer weight. Targets of one voxel follow
    /// each other, and the weights sum to [`Distribution::total`].
    pub fn for_each_weight(&self, mut visit: impl FnMut(u64, u64)) {
        with_layout!(&self.layout, l => with_voxels!(self.density.volume().voxels(), v =>
        with_units!(&self.weights, &self.density, u => {
            let mut sums = [Default::default(); BRICK];
            let mut totals = self.totals.cursor(0);
            for brick in 0..l.bricks() {
                let ends = totals.ends(brick);
                // Empty, or out of the camera's sight.
                if ends[0] == ends[1] {
                    continue;
                }
                l.sums(brick, &v[..], u, &mut sums);
                let mut before = 0;
                for sum in sums {
                    let sum = sum.to_u64();
                    if sum > before {
                        visit(ends[0] + before, sum - before);
                    }
                    before = sum;
                }
            }
        })));
    }
}

#[cfg(test)]
mod tests {
    use crate::{Distribution, VoxelOrder};
    use mcvr_scene::{Camera, Density, DensityMap, Extent, Kernel, View};
    use mcvr_volume::{Grid, Volume};

    #[test]
    fn every_drawable_voxel_is_visited_with_its_targets() {
        let grid = Grid::with_spacing([40, 20, 20], [1.0; 3]).unwrap();
        let voxels: Vec<u8> = (0..grid.len()).map(|i| (i * 7919 % 13) as u8 / 2).collect();
        let density = Density::new(&Volume::from_vec(grid, voxels, "test").unwrap(), DensityMap::default()).unwrap();
        let view = View { fov: Some(6.0), ..View::default() };
        let camera = Camera::look(&view, density.volume().grid(), Extent::new(8, 8).unwrap()).unwrap();
        let mut culled = false;
        for (name, order) in VoxelOrder::ALL {
            let whole = Distribution::new(&density, order).unwrap();
            let seen = Distribution::in_view(&density, order, &camera, Kernel::Tent).unwrap();
            culled |= seen.total() < whole.total();
            for distribution in [whole, seen] {
                let mut next = 0;
                distribution.for_each_weight(|target, weight| {
                    assert_eq!(target, next, "{name}");
                    next += weight;
                    // One voxel has both ends, and the whole of its weight.
                    let voxel = distribution.voxel_of(target);
                    assert_eq!(voxel, distribution.voxel_of(next - 1), "{name}");
                    assert_eq!(weight as f64, density.weight(voxel), "{name}");
                });
                assert_eq!(next, distribution.total(), "{name}");
            }
        }
        assert!(culled, "some order leaves bricks out");
    }
}
