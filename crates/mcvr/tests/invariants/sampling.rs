//! Samplers: nothing is lost, nothing depends on who does the work.

use std::ops::Range;

use mcvr::Method;
use mcvr::sampling::{
    BLOCK, Distribution, PointBlock, PointStream, Provenance, Rendered, Search, SimdLevel, block_count, block_len,
    sample,
};
use mcvr::scene::{Estimand, Watch};
use proptest::prelude::*;

use crate::scenes::*;

fn on_threads<R: Send>(threads: usize, work: impl FnOnce() -> R + Send) -> R {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

/// Whole samples in each pixel of a `count` image, a sample counting `share / M`. A pixel `n share / M` was rounded twice,
/// and so is off by less than 2^-50 of itself; it is checked to be that near to a whole number.
fn counts(image: &mcvr::scene::Image, samples: u64, share: f64) -> Vec<u64> {
    let whole = |v: &f64| {
        let n = v * samples as f64 / share;
        assert!((n - n.round()).abs() <= n * 2f64.powi(-50), "{n} samples");
        n.round() as u64
    };
    image.values().iter().map(whole).collect()
}

/// All targets and uniforms of a stream.
fn points(stream: &dyn PointStream, total: u64) -> PointBlock {
    let mut all = PointBlock::default();
    let mut block = PointBlock::default();
    for b in 0..block_count(stream.samples()) {
        block.resize(block_len(stream.samples(), b));
        stream.fill(b, total, &mut block);
        all.targets.extend_from_slice(&block.targets);
        (0..3).for_each(|a| all.uniforms[a].extend_from_slice(&block.uniforms[a]));
    }
    all
}

/// Some blocks of a stream, as a stream of its own.
struct Shard<'a> {
    whole: &'a dyn PointStream,
    blocks: Range<u64>,
}

impl PointStream for Shard<'_> {
    fn samples(&self) -> u64 {
        self.blocks.clone().map(|b| block_len(self.whole.samples(), b) as u64).sum()
    }

    fn search(&self) -> Search {
        self.whole.search()
    }

    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        self.whole.fill(self.blocks.start + block, total, out);
    }
}

proptest! {
    #![proptest_config(config(160))]

    /// Every sample is in one pixel, beside the image, or in front of the near plane; and where bricks that the camera cannot see
    /// are left out, what remains stands for its own share of the mass.
    #[test]
    fn no_sample_is_lost(scan in scan(), sight in sight(), ask in ask()) {
        let density = scan.density();
        let camera = sight.camera(density.volume().grid());
        let order = ask.order.resolve(&camera, density.volume().grid());
        let whole = Distribution::new(&density, order).unwrap();
        let seen = Distribution::in_view(&density, order, &camera, ask.kernel).unwrap();
        for d in [&whole, &seen] {
            let made = ask.render(d, &camera);
            let c = made.counters;
            if d.total() == 0 {
                prop_assert!(c.samples == 0 && made.image.values().iter().all(|v| *v == 0.0));
                continue;
            }
            prop_assert_eq!(c.samples, ask.samples);
            prop_assert_eq!(c.inside + c.outside + c.clipped, ask.samples);
            let count = Ask { estimand: Estimand::Count, ..ask.clone() }.render(d, &camera);
            prop_assert_eq!(count.counters.inside, c.inside);
            let share = d.mass() / density.mass();
            prop_assert_eq!(counts(&count.image, ask.samples, share).iter().sum::<u64>(), c.inside);
            prop_assert!(made.image.values().iter().all(|v| v.is_finite() && *v >= 0.0));
        }
        prop_assert_eq!(whole.mass(), density.mass());
    }

    /// The same bits and the same work on one and on three threads, with any vector instructions.
    #[test]
    fn an_image_depends_on_no_thread_and_no_vector(scan in scan(), sight in sight(), ask in ask()) {
        let density = scan.density();
        let camera = sight.camera(density.volume().grid());
        let d = Distribution::new(&density, ask.order.resolve(&camera, density.volume().grid())).unwrap();
        let stream = ask.stream(&d);
        let at = |threads, simd| {
            let options = mcvr::sampling::RenderOptions { simd: Some(simd), ..ask.options() };
            on_threads(threads, || render_by(&d, &*stream, &camera, &options))
        };
        let one = at(1, SimdLevel::Portable);
        for level in SimdLevel::available() {
            for threads in [1, 3] {
                let other = at(threads, level);
                prop_assert_eq!(&one.image, &other.image, "{:?} {}", level, threads);
                prop_assert_eq!(one.counters, other.counters);
            }
        }
    }

    /// An image is the sum of the images of its blocks, each by its number of samples: exactly in samples, and in `line` weights up
    /// to the roundings of a pixel's factor. A pixel is `S · u` with a whole `S` below 2^53 and `u = F / M · det · unit` rounded four
    /// times, `S · u` once; back times M once more: 6 · 2^-53 of a pixel on either side.
    #[test]
    fn an_image_is_the_sum_of_its_shards(scan in scan(), sight in sight(), ask in ask(), cut in 0.0..1.0f64, threads in 1usize..4) {
        let density = scan.density();
        let camera = sight.camera(density.volume().grid());
        let d = Distribution::new(&density, ask.order.resolve(&camera, density.volume().grid())).unwrap();
        let ask = Ask { samples: ask.samples + BLOCK as u64, ..ask };
        let stream = ask.stream(&d);
        let blocks = block_count(ask.samples);
        let cut = 1 + (cut * (blocks - 1) as f64) as u64;
        let render = |stream: &dyn PointStream| render_by(&d, stream, &camera, &ask.options());
        let whole = render(&*stream);
        let shards = [0..cut, cut..blocks].map(|blocks| Shard { whole: &*stream, blocks });
        let parts: Vec<(f64, Rendered)> = shards
            .iter()
            .filter(|s| s.samples() > 0)
            .map(|s| (s.samples() as f64, on_threads(threads, || render(s))))
            .collect();
        for (pixel, value) in whole.image.values().iter().enumerate() {
            let sum: f64 = parts.iter().map(|(m, part)| part.image.values()[pixel] * m).sum();
            let all = value * ask.samples as f64;
            // Two sums of two, and both sides' roundings.
            prop_assert!((sum - all).abs() <= 16.0 * 2f64.powi(-53) * all, "{}: {} {}", pixel, sum, all);
            if ask.estimand == Estimand::Count {
                prop_assert_eq!(sum.round(), all.round());
            }
        }
        prop_assert_eq!(parts.iter().map(|(_, p)| p.counters.inside).sum::<u64>(), whole.counters.inside);
        prop_assert_eq!(parts.iter().map(|(_, p)| p.counters.voxels_read).sum::<u64>(), whole.counters.voxels_read);
    }

    /// Every point of a cloud lies in the kernel's support around the voxel of positive weight that its target names. Positions
    /// are single sums of a whole number below 16 and an offset below 2, rounded to 24 bits: off by at most 2^-20, the
    /// offset's own rounding included.
    #[test]
    fn points_lie_in_the_support_of_a_positive_voxel(scan in scan(), ask in ask()) {
        let density = scan.density();
        let grid = density.volume().grid();
        let order = if ask.order.name() == "depth" { mcvr::sampling::VoxelOrder::Raster } else { ask.order };
        let d = Distribution::new(&density, order).unwrap();
        let stream = ask.stream(&d);
        let (cloud, counters) = sample(&d, &*stream, ask.kernel, Provenance::default(), &Watch::default()).unwrap();
        prop_assert_eq!(counters.samples, ask.samples);
        let points = points(&*stream, d.total());
        for (k, &target) in points.targets.iter().enumerate() {
            let voxel = d.voxel_of(target);
            prop_assert!(density.weight(voxel) > 0.0, "voxel {} of weight 0 is drawn", voxel);
            let at = grid.unravel(voxel);
            for (a, &place) in at.iter().enumerate() {
                let centre = (grid.dims()[a] - 1) / 2;
                let offset = f64::from(cloud.positions()[a][k]) + centre as f64 - place as f64;
                prop_assert!(offset.abs() <= ask.kernel.support() + 2f64.powi(-20), "{} at {} on axis {}", offset, k, a);
            }
        }
    }

    /// Floating-point weights times a power of two: every number on the way is scaled exactly, so the same voxels are drawn, the
    /// `count` image keeps every bit and the `line` image is multiplied exactly.
    #[test]
    fn a_power_of_two_on_the_weights_changes_no_draw(scan in scan(), sight in sight(), ask in ask(), k in -900i32..900) {
        let scan = Scan { stored: Stored::F64, ..scan };
        let grid = scan.grid();
        let camera = sight.camera(&grid);
        let factor = 2f64.powi(k);
        let values = scan.values();
        let scaled: Vec<f64> = values.iter().map(|v| v * factor).collect();
        let [a, b] = [&values, &scaled].map(|v| density_of(&scan.store(grid.clone(), v)));
        let order = ask.order.resolve(&camera, &grid);
        let [da, db] = [&a, &b].map(|d| Distribution::new(d, order).unwrap());
        prop_assert_eq!(da.total(), db.total());
        prop_assert_eq!(a.mass() * factor, b.mass());
        let drawn = points(&*ask.stream(&da), da.total()).targets;
        prop_assert!(drawn.iter().all(|&t| da.voxel_of(t) == db.voxel_of(t)));
        let [one, other] = [&da, &db].map(|d| ask.render(d, &camera));
        prop_assert_eq!(one.counters, other.counters);
        let by = if ask.estimand == Estimand::Line { factor } else { 1.0 };
        for (x, y) in one.image.values().iter().zip(other.image.values()) {
            prop_assert_eq!(x * by, *y);
        }
    }

    /// Leaving out bricks that the camera cannot see changes no expectation. Exactly: a voxel is drawn with the same integer weight
    /// or not at all, the distribution's mass is that of the voxels left in it, and no sample of the others is in the image.
    /// Statistically: with independent offsets the share inside is a mean of M independent numbers in 0..=1, so by
    /// Hoeffding it is off by more than `t = √(ln(2/α) / 2M)` with probability below α = 1e-9.
    #[test]
    fn leaving_bricks_out_changes_no_expectation(scan in scan(), sight in sight(), ask in ask(), by_mc in any::<bool>()) {
        let scan = Scan { stored: if scan.stored.is_whole() { scan.stored } else { Stored::U16 }, ..scan };
        // Long enough to have bricks to leave out.
        let scan = Scan { dims: scan.dims.map(|n| n.max(7)), ..scan };
        let method = if by_mc { Method::Mc } else { Method::Stratified };
        let ask = Ask { method, estimand: Estimand::Count, samples: 4096, ..ask };
        let density = scan.density();
        let grid = density.volume().grid();
        let camera = sight.camera(grid);
        let order = ask.order.resolve(&camera, grid);
        let whole = Distribution::new(&density, order).unwrap();
        let seen = Distribution::in_view(&density, order, &camera, ask.kernel).unwrap();
        let mut weight = vec![0; grid.len()];
        let mut mass = 0.0;
        for (voxel, n) in units(&seen) {
            prop_assert_eq!(n as f64, density.weight(voxel));
            weight[voxel] = n;
            mass += density.weight(voxel);
        }
        // Whole numbers below 2^53: their sum is exact; the product is rounded, `units × (F / sum)` twice and the volume once.
        let mass = mass * grid.voxel_volume();
        prop_assert!((seen.mass() - mass).abs() <= 4.0 * f64::EPSILON * mass, "{} {}", seen.mass(), mass);
        prop_assert!(seen.mass() + seen.near_mass() <= density.mass() * (1.0 + 8.0 * f64::EPSILON));

        let stream = ask.stream(&whole);
        let (cloud, _) = sample(&whole, &*stream, ask.kernel, Provenance::default(), &Watch::default()).unwrap();
        let targets = points(&*stream, whole.total()).targets;
        let (width, height) = (camera.extent().width as f64, camera.extent().height as f64);
        for (k, &target) in targets.iter().enumerate() {
            let (x, y, z) = camera.project(cloud.world(k));
            let inside = (0.0..width).contains(&x) && (0.0..height).contains(&y);
            if inside && (camera.is_parallel() || z >= camera.near()) {
                prop_assert!(weight[whole.voxel_of(target)] > 0, "a visible sample of a voxel that was left out");
            }
        }
        let [all, some] = [&whole, &seen].map(|d| ask.render(d, &camera).image.sum());
        let t = ((2.0f64 / 1e-9).ln() / (2.0 * ask.samples as f64)).sqrt();
        prop_assert!((all - some).abs() <= t * (1.0 + seen.mass() / density.mass()), "{} {}", all, some);
    }
}
