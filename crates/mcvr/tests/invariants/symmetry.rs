//! The same object described otherwise gives the same image.

use glam::{DMat3, DVec3};
use mcvr::Method;
use mcvr::raycast::{Counters, Integrator};
use mcvr::sampling::{Distribution, PointBlock, PointStream, Precision, RenderOptions, Search, VoxelOrder};
use mcvr::scene::{Camera, Estimand, Extent, Kernel};
use mcvr::volume::{Grid, Volume};
use proptest::prelude::*;

use crate::common::SEPARABLE;
use crate::scenes::*;

/// A grid's axes renamed and reversed: new axis `a` is old axis `axes[a]`, run backwards where `flips[a]`.
#[derive(Clone, Copy, Debug)]
struct Renaming {
    axes: [usize; 3],
    flips: [bool; 3],
}

impl Renaming {
    /// The old voxel at a new place.
    fn old(self, dims: [usize; 3], new: [usize; 3]) -> [usize; 3] {
        let mut old = [0; 3];
        for a in 0..3 {
            let n = dims[self.axes[a]];
            old[self.axes[a]] = if self.flips[a] { n - 1 - new[a] } else { new[a] };
        }
        old
    }

    /// The same voxels at the same places in the world.
    fn apply(self, scan: &Scan) -> Volume {
        let (grid, values) = (scan.grid(), scan.values());
        let dims = self.axes.map(|a| grid.dims()[a]);
        let spacing = DVec3::from_array(self.axes.map(|a| grid.spacing()[a]));
        let column = |a: usize| grid.direction().col(self.axes[a]) * if self.flips[a] { -1.0 } else { 1.0 };
        let first = self.old(grid.dims(), [0; 3]).map(|i| i as f64);
        let origin = grid.index_to_world().transform_point3(first.into());
        let direction = DMat3::from_cols(column(0), column(1), column(2));
        let renamed = Grid::new(dims, spacing, origin, direction).unwrap();
        let moved: Vec<f64> =
            (0..grid.len()).map(|i| values[grid.linear(self.old(grid.dims(), renamed.unravel(i)))]).collect();
        scan.store(renamed, &moved)
    }
}

fn renaming() -> impl Strategy<Value = Renaming> {
    let axes = prop::sample::select(vec![[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]]);
    (axes, any::<[bool; 3]>()).prop_map(|(axes, flips)| Renaming { axes, flips })
}

/// A stream for a renamed grid: uniforms go with their axes; a grid reversed on all axes has its raster order reversed.
struct Renamed<'a> {
    stream: &'a dyn PointStream,
    axes: [usize; 3],
    reversed: bool,
}

impl PointStream for Renamed<'_> {
    fn samples(&self) -> u64 {
        self.stream.samples()
    }

    fn search(&self) -> Search {
        if self.reversed { Search::Binary } else { self.stream.search() }
    }

    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        self.stream.fill(block, total, out);
        out.uniforms = self.axes.map(|a| out.uniforms[a].clone());
        if self.reversed {
            out.targets.iter_mut().for_each(|t| *t = total - 1 - *t);
            out.uniforms.iter_mut().flatten().for_each(|w| *w = !*w);
        }
    }
}

/// A scan of whole weights, not far from the world's origin.
fn whole_scan() -> impl Strategy<Value = Scan> {
    scan().prop_map(|s| Scan {
        origin: s.origin.map(|v| v / 100.0),
        stored: if s.stored.is_whole() { s.stored } else { Stored::U16 },
        ..s
    })
}

proptest! {
    #![proptest_config(config(128))]

    /// An order by another axis is the raster order of a volume whose axes are renamed: the same voxels in the same order with the
    /// same weights.
    #[test]
    fn orders_are_rasters_of_renamed_axes(scan in whole_scan(), z in any::<bool>()) {
        let scan = Scan { dims: scan.dims.map(|n| n.div_ceil(2)), ..scan };
        let (order, axes) = if z { (VoxelOrder::ZInnermost, [2, 0, 1]) } else { (VoxelOrder::YInnermost, [1, 0, 2]) };
        let renaming = Renaming { axes, flips: [false; 3] };
        let volume = renaming.apply(&scan);
        let (density, renamed) = (scan.density(), density_of(&volume));
        let (grid, new) = (scan.grid(), volume.grid());
        let moved = units(&Distribution::new(&renamed, VoxelOrder::Raster).unwrap());
        let back: Vec<_> =
            moved.into_iter().map(|(v, n)| (grid.linear(renaming.old(grid.dims(), new.unravel(v))), n)).collect();
        prop_assert_eq!(units(&Distribution::new(&density, order).unwrap()), back);
    }

    /// Samplers, given the same points, put every sample where it was. The same voxel and the same offset are projected with other
    /// roundings of 2^-53 of coordinates below 10^5 voxels: 10^-10 of a voxel, magnified to a pixel by less than 10^3
    /// here. A sample changes pixel when it is that near to one of four borders: of 128 times 5000 samples 0.3 would, were all
    /// magnified so; most are by some tens. None does with these seeds; one a case is let pass.
    #[test]
    fn samplers_see_a_renamed_volume_as_it_was(scan in whole_scan(), sight in sight(), ask in ask(), kind in 0..3usize) {
        let sight = Sight { distance: sight.distance.max(0.6), near: 1e-3, ..sight };
        let ask = Ask { kernel: if ask.kernel == Kernel::Shell { Kernel::Tent } else { ask.kernel }, ..ask };
        let (order, axes) = [
            (VoxelOrder::YInnermost, [1, 0, 2]), (VoxelOrder::ZInnermost, [2, 0, 1]), (VoxelOrder::Raster, [0, 1, 2])
        ][kind];
        let reversed = kind == 2;
        let density = scan.density();
        let renamed = density_of(&Renaming { axes, flips: [reversed; 3] }.apply(&scan));
        let camera = sight.camera(density.volume().grid());
        let d = Distribution::new(&density, order).unwrap();
        let stream = ask.stream(&d);
        let options = RenderOptions { precision: Some(Precision::F64), estimand: Estimand::Count, ..ask.options() };
        let one = render_by(&d, &*stream, &camera, &options);
        let other = render_by(
            &Distribution::new(&renamed, VoxelOrder::Raster).unwrap(),
            &Renamed { stream: &*stream, axes, reversed },
            &camera,
            &options,
        );
        let changed: f64 = one.image.difference(&other.image).unwrap().values().iter().map(|d| d.abs()).sum();
        prop_assert!((changed * ask.samples as f64).round() <= 2.0, "{} samples moved", changed * ask.samples as f64);
    }

    /// Rays see a renamed volume as it was. Bound as for the exact integrals: a ray's coordinates in voxels are rounded to
    /// `δ = 64 · 2^-53` of the largest number on the way, the field changes by at most its maximum per voxel and axis, and faces of
    /// `box` move along the ray by `δ / |d_a|` each.
    #[test]
    fn rays_see_a_renamed_volume_as_it_was(
        scan in scan(), sight in sight(), renaming in renaming(), kernel in prop::sample::select(SEPARABLE.to_vec()),
        points in prop::collection::vec([0.0..1.0f64, 0.0..1.0], 8),
    ) {
        let density = scan.density();
        let renamed = density_of(&renaming.apply(&scan));
        let grid = density.volume().grid();
        let camera = sight.camera(grid);
        let [a, b] = [&density, &renamed].map(|d| Integrator::new(d, kernel).unwrap());
        let h = grid.spacing();
        let reach = DVec3::from_array(scan.dims.map(|n| n as f64)) + 4.0;
        let way = (reach * h).length();
        let w = density.report().max_weight;
        for [x, y] in points {
            let (px, py) = (x * camera.extent().width as f64, y * camera.extent().height as f64);
            let [p, q] = [&a, &b].map(|i| i.view(&camera, Estimand::Line).integrate(px, py, &mut Counters::default()));
            let ray = camera.ray(px, py);
            let size = (ray.origin.length() + grid.origin().length() + way) / h.min_element();
            let delta = 64.0 * 2f64.powi(-53) * size;
            let d = grid.world_to_index().transform_vector3(ray.direction);
            let faces: f64 = (0..3).map(|a| (reach[a] + 1.0) * delta / d[a].abs()).sum();
            let bound = w * (3.0 * delta * way + faces + 64.0 * 2f64.powi(-53) * reach.element_sum() * way);
            prop_assert!((p - q).abs() <= bound, "{} {}: {:e}, bound {:e}", p, q, p - q, bound);
        }
    }

    /// Where every number is a small dyadic fraction, moving volume and camera together changes no bit, of samplers and of rays.
    #[test]
    fn a_move_by_dyadic_steps_changes_no_bit(
        scan in scan(), ask in ask(), h in [-2i32..3, -2i32..3, -2i32..3], by in any::<[i16; 3]>(), eye in [-40i32..40, 1i32..200, -40i32..40],
        parallel in any::<bool>(), pixel in [0u8..64, 0u8..64],
    ) {
        let spacing = DVec3::from_array(h.map(|h| 2f64.powi(h)));
        let by = DVec3::from_array(by.map(|v| f64::from(v) / 8.0));
        let [one, other] = [DVec3::ZERO, by].map(|by| {
            let grid = Grid::new(scan.dims, spacing, by, DMat3::IDENTITY).unwrap();
            let eye = DVec3::new(f64::from(eye[0]), f64::from(-eye[1]), f64::from(eye[2])) / 8.0 + by;
            let rows = [DVec3::new(16.0, 8.0, 0.0), DVec3::new(0.0, 8.0, -16.0), if parallel { DVec3::ZERO } else { DVec3::Y }];
            let rows = if parallel { [DVec3::X, -DVec3::Z, DVec3::ZERO] } else { rows };
            let mut matrix = rows.map(|r| [r.x, r.y, r.z, -r.dot(eye)]);
            if parallel {
                matrix[2][3] = 1.0;
                matrix[0][3] += 8.0;
                matrix[1][3] += 8.0;
            }
            let camera = Camera::from_matrix(matrix, Extent::new(16, 16).unwrap(), &grid, Some(0.125)).unwrap();
            (density_of(&scan.store(grid, &scan.values())), camera)
        });
        let order = if ask.order == VoxelOrder::Depth { VoxelOrder::Raster } else { ask.order };
        let [a, b] = [&one, &other].map(|(density, camera)| {
            let d = Distribution::in_view(density, order, camera, ask.kernel).unwrap();
            ask.render(&d, camera)
        });
        prop_assert_eq!(a.image, b.image);
        prop_assert_eq!(a.counters, b.counters);
        let kernel = if ask.kernel == Kernel::Shell { Kernel::Box } else { ask.kernel };
        let [p, q] = [&one, &other].map(|(density, camera)| {
            let integrator = Integrator::new(density, kernel).unwrap();
            let [px, py] = pixel.map(|p| f64::from(p) / 4.0 + 0.125);
            integrator.view(camera, ask.estimand).integrate(px, py, &mut Counters::default())
        });
        prop_assert_eq!(p, q);
    }
}

/// What the two methods above rest on: the mirrored word stands for one minus the uniform.
#[test]
fn a_reversed_stream_is_the_stream_mirrored() {
    let scan = Scan {
        dims: [5, 4, 3],
        spacing: [1.0; 3],
        turn: [0.0; 3],
        mirrored: false,
        origin: [0.0; 3],
        stored: Stored::U8,
        zeros: 100,
        seed: 3,
    };
    let density = scan.density();
    let d = Distribution::new(&density, VoxelOrder::Raster).unwrap();
    let renamed = density_of(&Renaming { axes: [0, 1, 2], flips: [true; 3] }.apply(&scan));
    let r = Distribution::new(&renamed, VoxelOrder::Raster).unwrap();
    assert_eq!(d.total(), r.total());
    for method in [Method::Mc, Method::Stratified] {
        let ask = Ask {
            method,
            kernel: Kernel::Tent,
            estimand: Estimand::Count,
            order: VoxelOrder::Raster,
            samples: 3000,
            seed: 1,
        };
        let stream = ask.stream(&d);
        let mut block = PointBlock::default();
        block.resize(2048);
        stream.fill(0, d.total(), &mut block);
        for &t in &block.targets {
            assert_eq!(d.voxel_of(t), 59 - r.voxel_of(d.total() - 1 - t));
        }
    }
}
