//! The voxel distribution: exact integer totals per brick, and nothing per voxel.

use std::borrow::Cow;

use mcvr_scene::{Camera, Density, DensityMap, Kernel};
use mcvr_volume::{Volume, with_voxels};
use serde::Serialize;

use crate::brick_totals::brick_totals;
use crate::frustum::{Frustum, Sight};
use crate::order::{AnyLayout, Layout, with_layout};
use crate::running_totals::RunningTotals;
use crate::units::{UnitWeights, total_type, with_units};
use crate::word::Word;
use crate::{SamplingError, VoxelOrder};

/// Exact counts of the work done to build a [`Distribution`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct DistributionCounters {
    /// Voxels read (each once).
    pub voxels_read: u64,
    /// Bricks of 256 voxels.
    pub bricks: u64,
    /// Bricks whose weights are all zero.
    pub empty_bricks: u64,
    /// Bricks that the camera cannot see because they lie beside the image: not read.
    pub bricks_beside: u64,
    /// Bricks that the camera cannot see because they lie in front of its near plane.
    pub bricks_near: u64,
    /// Bytes held beside the volume.
    pub bytes: u64,
}

/// Voxels to be drawn with probability proportional to their weight.
///
/// The voxels follow each other in a [`VoxelOrder`], cut into bricks of 256. A brick keeps the exact total of its integer
/// weights in as few bytes as hold it, and each 32nd the sum before it: 0.9 % of a volume of 8- or 16-bit voxels under the
/// identity map and of 32-bit floats under any. Maps whose integer weights are wider take 1.7 % or 3.2 % of 8-bit and 0.8 % or
/// 1.6 % of 16-bit voxels. Sums inside a brick are made when a sample falls into it.
#[derive(Clone, Debug)]
pub struct Distribution<'a> {
    pub(crate) density: Cow<'a, Density>,
    pub(crate) layout: AnyLayout,
    pub(crate) weights: UnitWeights,
    pub(crate) totals: RunningTotals,
    order: VoxelOrder,
    counters: DistributionCounters,
    /// Mass of the bricks that can be drawn, and of those cut off by the near plane.
    mass: f64,
    near_mass: f64,
}

impl<'a> Distribution<'a> {
    /// Sums the weights of a density in an order. Reads every voxel once, in parallel.
    ///
    /// `VoxelOrder::Depth` must have been [resolved](VoxelOrder::resolve) for a camera; otherwise it means
    /// `Raster`.
    ///
    /// # Errors
    /// [`SamplingError::Limit`] when the volume is too large for the order, [`SamplingError::Empty`] when the
    /// weights sum to nothing or to 2^63 or more.
    pub fn new(density: &'a Density, order: VoxelOrder) -> Result<Self, SamplingError> {
        Self::of(density, order, None)
    }

    /// As [`Distribution::new`], of those bricks only of which a camera can see samples under a kernel. An image by that camera
    /// has the same expectation with it, and all samples go where they count. Bricks beside the image are not read; those
    /// in front of the near plane are, for [`Distribution::near_mass`].
    ///
    /// # Errors
    /// As [`Distribution::new`], but nothing to see is no error: the total is then 0.
    pub fn in_view(
        density: &'a Density,
        order: VoxelOrder,
        camera: &Camera,
        kernel: Kernel,
    ) -> Result<Self, SamplingError> {
        Self::of(density, order, Frustum::cutting(camera, density.volume().grid(), kernel).as_ref())
    }

    fn of(density: &'a Density, order: VoxelOrder, frustum: Option<&Frustum>) -> Result<Self, SamplingError> {
        let volume = density.volume();
        let layout = AnyLayout::new(order, volume.grid().dims())?;
        let weights = UnitWeights::fastest(density);
        let (totals, tally) = with_layout!(&layout, l => with_voxels!(volume.voxels(), v =>
            with_units!(&weights, density, u => brick_totals(l, &v[..], u, weights.total_type(density), frustum))))?;
        let bricks = with_layout!(&layout, l => l.bricks()) as u64;
        let sum = totals.total();
        let culled = tally.beside + tally.near > 0;
        if sum == 0 && !culled {
            return Err(SamplingError::Empty("every voxel's share of the whole rounds to zero".into()));
        }
        let counters = DistributionCounters {
            voxels_read: tally.read,
            bricks,
            empty_bricks: tally.without - tally.beside - tally.near,
            bricks_beside: tally.beside,
            bricks_near: tally.near,
            bytes: (totals.bytes() + layout.bytes()) as u64,
        };
        // The quotient first: the smallest masses have few digits to lose.
        let mass_of =
            |units: u64| if units == 0 { 0.0 } else { density.mass() * (units as f64 / weights.whole(density)) };
        let mass = if culled { mass_of(sum) } else { density.mass() };
        let near_mass = mass_of(tally.near_units);
        Ok(Self { density: Cow::Borrowed(density), layout, weights, totals, order, counters, mass, near_mass })
    }

    /// The counters that [`Distribution::new`] (or, given a camera and a kernel, [`Distribution::in_view`]) would have, without
    /// reading a voxel; only `empty_bricks`, which the voxels decide, is 0 here. Says as well how many voxels lie in bricks
    /// that can be drawn.
    ///
    /// # Errors
    /// [`SamplingError::Limit`] when the volume is too large for the order.
    pub fn survey(
        volume: &Volume,
        map: &DensityMap,
        order: VoxelOrder,
        view: Option<(&Camera, Kernel)>,
    ) -> Result<(DistributionCounters, u64), SamplingError> {
        let grid = volume.grid();
        let layout = AnyLayout::new(order, grid.dims())?;
        let frustum = view.and_then(|(camera, kernel)| Frustum::cutting(camera, grid, kernel));
        let mut counters = DistributionCounters::default();
        let mut seen = 0;
        with_layout!(&layout, l => {
            counters.bricks = l.bricks() as u64;
            for brick in 0..l.bricks() {
                let sight = frustum.map_or(Sight::Seen, |f| {
                    let (low, high) = l.bounds(brick);
                    f.see(low, high)
                });
                let voxels = l.voxels(brick) as u64;
                match sight {
                    Sight::Beside => counters.bricks_beside += 1,
                    Sight::Near => {
                        counters.bricks_near += 1;
                        counters.voxels_read += voxels;
                    }
                    Sight::Seen => {
                        seen += voxels;
                        counters.voxels_read += voxels;
                    }
                }
            }
        });
        let kind = total_type(&map.table(volume));
        counters.bytes = (kind.bytes_of(counters.bricks as usize) + layout.bytes()) as u64;
        Ok((counters, seen))
    }

    /// Mass that can be drawn (weight units × mm³): all of the density's, or what a camera may see of it.
    pub fn mass(&self) -> f64 {
        self.mass
    }

    /// Mass of the bricks that lie wholly in front of the camera's near plane (weight units × mm³).
    pub fn near_mass(&self) -> f64 {
        self.near_mass
    }

    /// The density whose voxels are drawn.
    pub fn density(&self) -> &Density {
        &self.density
    }

    /// Sum of all integer weights; targets lie below it.
    pub fn total(&self) -> u64 {
        self.totals.total()
    }

    /// The order of the voxels.
    pub fn order(&self) -> VoxelOrder {
        self.order
    }

    /// What building it took.
    pub fn counters(&self) -> DistributionCounters {
        self.counters
    }

    /// Linear index of the voxel that holds a target. For tests and single draws; rendering walks.
    ///
    /// # Panics
    /// When the target is not below the total.
    pub fn voxel_of(&self, target: u64) -> usize {
        assert!(target < self.total(), "target {target} is not below the total {}", self.total());
        let (brick, before) = self.totals.find(target);
        let dims = self.density.volume().grid().dims();
        let mut place = [vec![], vec![], vec![]];
        with_layout!(&self.layout, l => with_voxels!(self.density.volume().voxels(), v =>
        with_units!(&self.weights, &self.density, u => {
            let mut sums = crate::locate::BrickSums::new();
            l.sums(brick, &v[..], u, &mut sums.sums);
            sums.index();
            let position = sums.find(Word::from_u64(target - before));
            let at = l.place(brick, l.start(brick), position);
            (0..3).for_each(|a| place[a].push(at[a]));
            l.resolve(crate::SimdLevel::Portable, &mut place);
        })));
        let [x, y, z] = [0, 1, 2].map(|a: usize| place[a][0] as usize);
        x + dims[0] * (y + dims[1] * z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_scene::{Extent, Transfer, View};
    use mcvr_volume::Grid;

    fn density<T: mcvr_volume::Voxel>(dims: [usize; 3], voxels: Vec<T>) -> Density {
        let grid = Grid::with_spacing(dims, [1.0; 3]).unwrap();
        Density::new(&Volume::from_vec(grid, voxels, "test").unwrap(), DensityMap::default()).unwrap()
    }

    #[test]
    fn every_target_of_an_integer_volume_finds_its_voxel_exactly_as_often_as_it_weighs() {
        let dims = [7, 9, 11];
        let voxels: Vec<u8> = (0..7 * 9 * 11).map(|i| (i * 7 % 5) as u8).collect();
        let d = density(dims, voxels.clone());
        for (_, order) in VoxelOrder::ALL {
            let distribution = Distribution::new(&d, order).unwrap();
            let mut counts = vec![0u8; voxels.len()];
            for t in 0..distribution.total() {
                counts[distribution.voxel_of(t)] += 1;
            }
            assert_eq!(counts, voxels, "{order:?}");
            assert_eq!(distribution.counters().voxels_read, voxels.len() as u64);
        }
    }

    #[test]
    fn a_single_voxel_first_last_or_in_the_middle_is_always_found() {
        for at in [0, 300, 599] {
            let mut voxels = vec![0f32; 600];
            voxels[at] = 1e-30;
            let d = density([600, 1, 1], voxels);
            let distribution = Distribution::new(&d, VoxelOrder::Raster).unwrap();
            for t in [0, distribution.total() / 2, distribution.total() - 1] {
                assert_eq!(distribution.voxel_of(t), at);
            }
        }
    }

    #[test]
    fn one_huge_weight_does_not_swallow_many_tiny_ones() {
        // An f32 running sum of these stalls at the huge one; here the tiny ones keep their half.
        let n = 1 << 16;
        let mut voxels = vec![1.0f32; n];
        voxels[17] = n as f32;
        let d = density([n, 1, 1], voxels);
        let distribution = Distribution::new(&d, VoxelOrder::Raster).unwrap();
        let total = distribution.total() as f64;
        let before = distribution.totals.cursor(0).ends(1)[0] as f64 / total;
        let expected = (255.0 + n as f64) / (2 * n - 1) as f64;
        assert!((before - expected).abs() < 1e-12, "{before} {expected}");
    }

    #[test]
    fn a_survey_knows_what_building_will_count() {
        let d = density([37, 21, 19], (0..37 * 21 * 19).map(|i| (i % 3) as u8).collect());
        let grid = d.volume().grid().clone();
        for distance in [40.0, 12.0] {
            let view = View { fov: Some(3.0), distance: Some(distance), near: Some(9.0), ..View::default() };
            let camera = Camera::look(&view, &grid, Extent::new(32, 32).unwrap()).unwrap();
            for (name, order) in VoxelOrder::ALL {
                let built = Distribution::in_view(&d, order, &camera, Kernel::Tent).unwrap().counters();
                let (survey, _) =
                    Distribution::survey(d.volume(), d.map(), order, Some((&camera, Kernel::Tent))).unwrap();
                assert_eq!(survey, DistributionCounters { empty_bricks: 0, ..built }, "{name}");
                // From nearby the near plane may cut every brick, and those are looked into whether beside or not.
                assert!(built.bricks_beside > 0 || distance < 40.0, "{built:?}");
                let (all, seen) = Distribution::survey(d.volume(), d.map(), order, None).unwrap();
                let built = Distribution::new(&d, order).unwrap().counters();
                assert_eq!(all, DistributionCounters { empty_bricks: 0, ..built }, "{name}");
                assert_eq!(seen, 37 * 21 * 19);
            }
        }
    }

    /// The mass that a camera sees, that it cuts and that lies beside add up; what is drawn is drawn as often as ever.
    #[test]
    fn culled_bricks_take_their_mass_with_them() {
        let d = density([64, 32, 32], (0..64 * 32 * 32).map(|i| (i * 7919 % 13) as u8).collect());
        let grid = d.volume().grid().clone();
        let view = View { fov: Some(30.0), distance: Some(20.0), near: Some(15.0), azimuth: 0.0, ..View::default() };
        let camera = Camera::look(&view, &grid, Extent::new(32, 32).unwrap()).unwrap();
        for (name, order) in VoxelOrder::ALL {
            let all = Distribution::new(&d, order).unwrap();
            let seen = Distribution::in_view(&d, order, &camera, Kernel::Box).unwrap();
            // Along the view, which is x, the near plane cuts every line of the raster: all are looked into, so that no mass
            // goes unreported.
            let along = seen.order() == VoxelOrder::Raster || seen.order() == VoxelOrder::Depth;
            assert_eq!(seen.counters().bricks_beside > 0, !along, "{name} {:?}", seen.counters());
            assert_eq!(seen.near_mass() > 0.0, !along, "{name} {:?}", seen.counters());
            assert_eq!(seen.mass() + seen.near_mass() < all.mass(), !along, "{name}");
            // A quotient and a product are rounded.
            let mass = seen.total() as f64 * grid.voxel_volume();
            assert!((seen.mass() - mass).abs() <= f64::EPSILON * mass, "{} {mass}", seen.mass());
            let mut drawn = vec![0u8; grid.len()];
            for t in 0..seen.total() {
                drawn[seen.voxel_of(t)] += 1;
            }
            for (i, &n) in drawn.iter().enumerate() {
                assert!(n == 0 || f64::from(n) == d.weight(i));
                let [x, y, z] = grid.unravel(i).map(|v| v as f64);
                let (px, py, depth) = camera.project(grid.index_to_world().transform_point3([x, y, z].into()));
                let inside = depth >= 15.0 && (0.0..32.0).contains(&px) && (0.0..32.0).contains(&py);
                assert!(!inside || f64::from(n) == d.weight(i), "{name}: voxel {i} is seen but never drawn");
            }
        }
    }

    #[test]
    fn the_distribution_takes_less_than_one_percent_of_the_volume() {
        fn share<T: mcvr_volume::Voxel>(voxel: T, map: DensityMap, order: VoxelOrder) -> f64 {
            let dims = [128, 128, 64];
            let grid = Grid::with_spacing(dims, [1.0; 3]).unwrap();
            let mut voxels = vec![voxel; grid.len()];
            voxels[..999].fill(T::zeroed());
            let volume = Volume::from_vec(grid, voxels, "test").unwrap();
            let density = Density::new(&volume, map.clone()).unwrap();
            let counters = Distribution::new(&density, order).unwrap().counters();
            let (survey, _) = Distribution::survey(&volume, &map, order, None).unwrap();
            assert_eq!(survey.bytes, counters.bytes);
            // The Hilbert order holds its curve as well, which small volumes do not make up for.
            let curve = AnyLayout::new(order, dims).unwrap().bytes() as f64;
            (counters.bytes as f64 - curve) / volume.bytes() as f64
        }
        for (name, order) in VoxelOrder::ALL {
            let plain = DensityMap::default;
            let wide = || DensityMap { transfer: Transfer::Linear { slope: 0.37, intercept: 1.25 }, ..plain() };
            let table = || DensityMap { transfer: Transfer::Piecewise(vec![[0.0, 0.0], [4.0, 2000.0]]), ..plain() };
            for (kind, share, most) in [
                ("u8", share(1u8, plain(), order), 0.01),
                ("i8", share(1i8, plain(), order), 0.01),
                ("u16", share(1u16, plain(), order), 0.01),
                ("i16", share(1i16, plain(), order), 0.01),
                ("f32", share(1f32, wide(), order), 0.01),
                ("f64", share(1f64, wide(), order), 0.01),
                ("16-bit voxels of 32-bit weights", share(1u16, table(), order), 0.01),
                ("8-bit voxels of 32-bit weights", share(1u8, table(), order), 0.017),
                ("16-bit voxels of 64-bit weights", share(1i16, wide(), order), 0.017),
                ("8-bit voxels of 64-bit weights", share(1u8, wide(), order), 0.0325),
            ] {
                assert!(share < most, "{name}, {kind}: {share}");
            }
        }
    }
}
