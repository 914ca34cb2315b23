//! A Hilbert curve through a box: cubes of 8³ voxels in curve order, each a run of 512 voxels.
//!
//! The curve fills the smallest cube of 2^p voxels a side that holds the grid; parts outside the grid are
//! left out, so the order is the curve's order restricted to the grid.

use crate::SamplingError;

/// Voxels along a side of a cube that is kept as one entry.
pub(crate) const SIDE: usize = 8;

/// The three directions of the curve in a cube, as (world axis, sign).
type Frame = [(u8, i8); 3];

/// Octants in curve order, as steps along the frame's directions.
const OCTANTS: [[u8; 3]; 8] = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 1, 1], [1, 1, 1], [1, 0, 1], [0, 0, 1]];

/// The frame of each octant: (direction of the parent, sign) for each of its own directions.
const TURNS: [[(u8, i8); 3]; 8] = [
    [(1, 1), (2, 1), (0, 1)],
    [(2, 1), (0, 1), (1, 1)],
    [(2, 1), (0, 1), (1, 1)],
    [(0, -1), (1, -1), (2, 1)],
    [(0, -1), (1, -1), (2, 1)],
    [(2, -1), (0, 1), (1, -1)],
    [(2, -1), (0, 1), (1, -1)],
    [(1, 1), (2, -1), (0, -1)],
];

fn turn(frame: Frame, octant: usize) -> Frame {
    TURNS[octant].map(|(d, s)| {
        let (axis, sign) = frame[d as usize];
        (axis, sign * s)
    })
}

/// Which half of the cube an octant takes along each world axis.
fn half(frame: Frame, octant: usize) -> [usize; 3] {
    let mut at = [0; 3];
    for (d, (axis, sign)) in frame.into_iter().enumerate() {
        let step = OCTANTS[octant][d];
        at[axis as usize] = usize::from(if sign > 0 { step } else { 1 - step });
    }
    at
}

/// The cubes of 8³ voxels that meet a grid, in the order of the curve.
#[derive(Clone, Debug)]
pub(crate) struct Hilbert {
    /// Per cube: x, y, z in cubes (19 bits each) and the frame's number.
    cubes: Vec<u64>,
    /// Per frame, the 512 voxels of a cube in order: x, y, z in 3 bits each.
    local: Vec<[u16; 512]>,
}

impl Hilbert {
    /// # Errors
    /// [`SamplingError::Limit`] when an extent exceeds 2^22 voxels.
    pub(crate) fn new(dims: [usize; 3]) -> Result<Self, SamplingError> {
        if dims.iter().any(|&n| n > SIDE << 19) {
            return Err(SamplingError::Limit {
                method: "hilbert order",
                problem: format!("extents {dims:?} exceed 2^22 voxels; use the raster order"),
            });
        }
        let side = dims.iter().max().copied().unwrap_or(1).next_power_of_two().max(SIDE);
        let mut curve = Self { cubes: Vec::new(), local: Vec::new() };
        let mut frames = Vec::new();
        curve.visit([0; 3], side, [(0, 1), (1, 1), (2, 1)], dims, &mut frames);
        curve.local = frames.into_iter().map(local_order).collect();
        curve.cubes.shrink_to_fit();
        Ok(curve)
    }

    fn visit(&mut self, at: [usize; 3], side: usize, frame: Frame, dims: [usize; 3], frames: &mut Vec<Frame>) {
        if at.iter().zip(dims).any(|(&a, n)| a >= n) {
            return;
        }
        if side == SIDE {
            let number = frames.iter().position(|f| *f == frame).unwrap_or_else(|| {
                frames.push(frame);
                frames.len() - 1
            });
            let [x, y, z] = at.map(|a| (a / SIDE) as u64);
            self.cubes.push(x | y << 19 | z << 38 | (number as u64) << 57);
            return;
        }
        for octant in 0..8 {
            let step = half(frame, octant);
            let child = std::array::from_fn(|a| at[a] + step[a] * side / 2);
            self.visit(child, side / 2, turn(frame, octant), dims, frames);
        }
    }

    /// Number of cubes.
    pub(crate) fn len(&self) -> usize {
        self.cubes.len()
    }

    /// First voxel of a cube and its voxels in order.
    #[inline(always)]
    pub(crate) fn cube(&self, index: usize) -> ([u32; 3], &[u16; 512]) {
        let c = self.cubes[index];
        let at = |shift: u32| ((c >> shift) as u32 & 0x7_ffff) * SIDE as u32;
        ([at(0), at(19), at(38)], &self.local[(c >> 57) as usize])
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        self.cubes.capacity() * size_of::<u64>() + self.local.len() * size_of::<[u16; 512]>()
    }
}

/// The 512 voxels of a cube under a frame.
fn local_order(frame: Frame) -> [u16; 512] {
    fn visit(at: [usize; 3], side: usize, frame: Frame, out: &mut Vec<u16>) {
        if side == 1 {
            out.push((at[0] | at[1] << 3 | at[2] << 6) as u16);
            return;
        }
        for octant in 0..8 {
            let step = half(frame, octant);
            visit(std::array::from_fn(|a| at[a] + step[a] * side / 2), side / 2, turn(frame, octant), out);
        }
    }
    let mut out = Vec::with_capacity(512);
    visit([0; 3], SIDE, frame, &mut out);
    std::array::from_fn(|i| out[i])
}

/// x, y, z of a voxel within its cube.
#[inline(always)]
pub(crate) fn unpack(packed: u16) -> [u32; 3] {
    [packed as u32 & 7, packed as u32 >> 3 & 7, packed as u32 >> 6]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(dims: [usize; 3]) -> Vec<[u32; 3]> {
        let curve = Hilbert::new(dims).unwrap();
        (0..curve.len())
            .flat_map(|c| {
                let (at, local) = curve.cube(c);
                local.iter().map(|&p| std::array::from_fn(|a| at[a] + unpack(p)[a])).collect::<Vec<_>>()
            })
            .collect()
    }

    #[test]
    fn in_a_cube_each_voxel_is_next_to_the_one_before() {
        let path = path([32; 3]);
        assert_eq!(path.len(), 32 * 32 * 32);
        for w in path.windows(2) {
            let distance: u32 = (0..3).map(|a| w[0][a].abs_diff(w[1][a])).sum();
            assert_eq!(distance, 1, "{w:?}");
        }
    }

    #[test]
    fn every_voxel_of_a_box_is_visited_once() {
        let dims = [19usize, 3, 30];
        let mut seen = std::collections::HashSet::new();
        for p in path(dims) {
            if (0..3).all(|a| (p[a] as usize) < dims[a]) {
                assert!(seen.insert(p));
            }
        }
        assert_eq!(seen.len(), 19 * 3 * 30);
    }
}
