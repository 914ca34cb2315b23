//! The order in which voxels follow each other in the running sum, cut into bricks of 256.
//!
//! Independent samples do not care. Low-discrepancy targets do: they are evenly spread along this order, so
//! the order decides which shapes in space get an even share (METHOD section 3).

use mcvr_scene::Camera;
use mcvr_volume::{Grid, Voxel};
use serde::{Deserialize, Serialize};

use crate::curve::Curve;
use crate::dense::Lines;
use crate::hilbert::Hilbert;
use crate::nested::Nested;
use crate::units::Units;
use crate::unpack::Turned;
use crate::word::Word;
use crate::{SamplingError, SimdLevel};

/// Voxels per brick.
pub(crate) const BRICK: usize = 256;

/// An order of the voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub enum VoxelOrder {
    /// x fastest, then y, then z: as in memory.
    Raster,
    /// Along a Hilbert curve.
    Hilbert,
    /// y fastest, then x, then z.
    YInnermost,
    /// z fastest, then x, then y.
    ZInnermost,
    /// The grid axis nearest to the view's depth fastest: one of the three above, by the camera.
    #[default]
    Depth,
}

impl VoxelOrder {
    /// Every order, by name.
    pub const ALL: [(&'static str, VoxelOrder); 5] = [
        ("raster", VoxelOrder::Raster),
        ("hilbert", VoxelOrder::Hilbert),
        ("y", VoxelOrder::YInnermost),
        ("z", VoxelOrder::ZInnermost),
        ("depth", VoxelOrder::Depth),
    ];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, o)| *o == self).map_or("", |(n, _)| n)
    }

    /// Replaces `Depth` by the order it stands for under a camera.
    pub fn resolve(self, camera: &Camera, grid: &Grid) -> Self {
        match (self, camera.depth_axis(grid)) {
            (VoxelOrder::Depth, 0) => VoxelOrder::Raster,
            (VoxelOrder::Depth, 1) => VoxelOrder::YInnermost,
            (VoxelOrder::Depth, _) => VoxelOrder::ZInnermost,
            (other, _) => other,
        }
    }
}

impl std::str::FromStr for VoxelOrder {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        let found = Self::ALL.iter().find(|(n, _)| *n == s);
        found.map(|(_, o)| *o).ok_or_else(|| format!("unknown order '{s}'; one of raster, hilbert, y, z, depth"))
    }
}

/// Bricks of voxels in some order. A place within the order is (brick, position); positions are turned into
/// coordinates in two steps, a scalar one per sample and a vectorised one per batch.
pub(crate) trait Layout: Sync {
    /// Number of bricks.
    fn bricks(&self) -> usize;

    /// Writes the brick's inclusive running sums of integer weights (the rest of the array is filled with the
    /// brick's total) and returns how many voxels were read.
    fn sums<T: Voxel, U: Units<T>>(&self, brick: usize, voxels: &[T], units: U, sums: &mut [U::Word; BRICK]) -> usize;

    /// As [`Layout::sums`], for bricks in rising order of which many are wanted.
    #[inline]
    fn unpack<T: Voxel, U: Units<T>>(
        &self,
        brick: usize,
        voxels: &[T],
        units: U,
        _: &mut Turned,
        sums: &mut [U::Word; BRICK],
    ) -> usize {
        self.sums(brick, voxels, units, sums)
    }

    /// Says that a brick's voxels will soon be wanted.
    #[inline(always)]
    fn prefetch<T: Voxel>(&self, _: usize, _: &[T]) {}

    /// Voxels in a brick.
    fn voxels(&self, brick: usize) -> usize;

    /// Bricks whose totals are best made together.
    fn bricks_at_once(&self) -> usize {
        BRICK
    }

    /// Writes the totals of the bricks from `first` on and returns how many voxels were read.
    fn totals<T: Voxel, U: Units<T>>(&self, first: usize, voxels: &[T], units: U, totals: &mut [u64]) -> usize {
        let mut sums = [U::Word::default(); BRICK];
        let mut read = 0;
        for (i, total) in totals.iter_mut().enumerate() {
            read += self.sums(first + i, voxels, units, &mut sums);
            *total = sums[BRICK - 1].to_u64();
        }
        read
    }

    /// Position of one voxel, not yet resolved.
    fn place(&self, brick: usize, start: [u32; 3], position: u32) -> [u32; 3];

    /// What [`Layout::place`] needs to know of a brick.
    fn start(&self, brick: usize) -> [u32; 3];

    /// The first and the last voxel of a box around the brick's voxels, both inside the grid.
    fn bounds(&self, brick: usize) -> ([u32; 3], [u32; 3]);

    /// Turns places into voxel coordinates (x, y, z), in place. Coordinates along the layout's own axes are places as well.
    fn resolve(&self, level: SimdLevel, places: &mut [Vec<u32>; 3]);

    /// Extents of the lines that its bricks follow, where they follow lines; a brick then starts at [`Layout::start`].
    fn lines(&self) -> Option<Lines>;

    /// Turns coordinates along the layout's own axes into (x, y, z).
    fn turn(&self, places: &mut [Vec<u32>; 3]);
}

/// Any order, chosen at run time.
#[derive(Clone, Debug)]
pub(crate) enum AnyLayout {
    Nested(Nested),
    Curve(Curve),
}

impl AnyLayout {
    pub(crate) fn new(order: VoxelOrder, dims: [usize; 3]) -> Result<Self, SamplingError> {
        Ok(match order {
            VoxelOrder::Raster | VoxelOrder::Depth => Self::Nested(Nested::new(dims, 0)?),
            VoxelOrder::YInnermost => Self::Nested(Nested::new(dims, 1)?),
            VoxelOrder::ZInnermost => Self::Nested(Nested::new(dims, 2)?),
            VoxelOrder::Hilbert => Self::Curve(Curve { dims, curve: Hilbert::new(dims)? }),
        })
    }

    pub(crate) fn bytes(&self) -> usize {
        match self {
            Self::Nested(_) => 0,
            Self::Curve(c) => c.curve.bytes(),
        }
    }
}

/// Runs an expression with `$layout` bound to the concrete [`Layout`], compiled once per kind.
macro_rules! with_layout {
    ($any:expr, $layout:ident => $body:expr) => {
        match $any {
            $crate::order::AnyLayout::Nested($layout) => $body,
            $crate::order::AnyLayout::Curve($layout) => $body,
        }
    };
}
pub(crate) use with_layout;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::TableUnits;

    /// Every voxel's linear index in the layout's order, through `place` and `resolve`.
    fn visit(layout: &impl Layout, dims: [usize; 3]) -> Vec<usize> {
        let ones = vec![1u8; dims.iter().product()];
        let table = vec![1u32; 256];
        let mut order = vec![];
        for brick in 0..layout.bricks() {
            let mut sums = [0u32; BRICK];
            let read = layout.sums(brick, &ones, TableUnits(&table[..]), &mut sums);
            assert_eq!(read as u32, sums[BRICK - 1]);
            assert_eq!(read, layout.voxels(brick));
            let (low, high) = layout.bounds(brick);
            assert!((0..3).all(|a| low[a] <= high[a] && high[a] < dims[a] as u32), "{low:?} {high:?}");
            let mut places = [vec![], vec![], vec![]];
            for position in 0..BRICK {
                let before = if position == 0 { 0 } else { sums[position - 1] };
                if sums[position] > before {
                    let p = layout.place(brick, layout.start(brick), position as u32);
                    (0..3).for_each(|a| places[a].push(p[a]));
                }
            }
            layout.resolve(SimdLevel::detect(), &mut places);
            let [nx, ny, _] = dims;
            for ((&x, &y), &z) in places[0].iter().zip(&places[1]).zip(&places[2]) {
                assert!((x as usize) < dims[0] && (y as usize) < dims[1] && (z as usize) < dims[2]);
                order.push(x as usize + nx * (y as usize + ny * z as usize));
            }
        }
        order
    }

    #[test]
    fn every_order_visits_every_voxel_once() {
        for dims in [[1, 1, 1], [1, 700, 1], [7, 5, 3], [40, 30, 20], [300, 2, 3], [3, 2, 300]] {
            for (name, order) in VoxelOrder::ALL {
                let any = AnyLayout::new(order, dims).unwrap();
                let mut seen = with_layout!(&any, l => visit(l, dims));
                seen.sort_unstable();
                assert!(seen.iter().copied().eq(0..dims.iter().product()), "{name} {dims:?}");
            }
        }
    }

    #[test]
    fn the_named_axis_is_innermost() {
        let dims = [4, 5, 6];
        for (axis, stride) in [(0, 1), (1, 4), (2, 20)] {
            let order = visit(&Nested::new(dims, axis).unwrap(), dims);
            assert!(order[..dims[axis]].windows(2).all(|w| w[1] - w[0] == stride));
        }
    }

    #[test]
    fn running_sums_follow_the_voxels_in_every_order() {
        let dims = [9, 11, 13];
        let voxels: Vec<u16> = (0..dims.iter().product::<usize>()).map(|i| (i * i % 977) as u16).collect();
        let table: Vec<u32> = (0..65536).collect();
        for (_, order) in VoxelOrder::ALL {
            let any = AnyLayout::new(order, dims).unwrap();
            with_layout!(&any, l => {
                let path = visit(l, dims);
                let mut expected = path.iter().map(|&i| u32::from(voxels[i]));
                let mut sums = [0u32; BRICK];
                let mut total = 0u64;
                for brick in 0..l.bricks() {
                    let read = l.sums(brick, &voxels, TableUnits(&table[..]), &mut sums);
                    let brick_sum: u32 = expected.by_ref().take(read).sum();
                    assert_eq!(sums[BRICK - 1], brick_sum);
                    total += u64::from(brick_sum);
                }
                assert_eq!(total, voxels.iter().map(|&v| u64::from(v)).sum::<u64>());
            });
        }
    }
}
