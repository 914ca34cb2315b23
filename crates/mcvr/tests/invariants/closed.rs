//! One voxel seen along an axis: its image in closed form.

use glam::{DMat3, DVec3};
use mcvr::Method;
use mcvr::raycast::{ReferenceOptions, reference};
use mcvr::sampling::{Distribution, VoxelOrder};
use mcvr::scene::{Camera, Estimand, Extent, Kernel, Watch};
use mcvr::volume::{Grid, Volume};
use proptest::prelude::*;

use crate::common::SEPARABLE;
use crate::scenes::*;

/// The kernel's distribution function.
fn cdf(kernel: Kernel, t: f64) -> f64 {
    let t = t.clamp(-kernel.support(), kernel.support());
    let a = t.abs();
    let above = match kernel {
        Kernel::Box => a,
        Kernel::Tent => a - a * a / 2.0,
        Kernel::Bspline3 if a < 1.0 => 2.0 * a / 3.0 - a.powi(3) / 3.0 + a.powi(4) / 8.0,
        Kernel::Bspline3 => 0.5 - (2.0 - a).powi(4) / 24.0,
        Kernel::Shell => panic!("shell is not separable"),
    };
    0.5 + above.copysign(t)
}

proptest! {
    #![proptest_config(config(48))]

    /// Seen along z, a voxel's share of a pixel is the product of its kernel's shares of the pixel's two sides. The reference is
    /// held to its own estimate of its RMSE over the image; with `box` to twice that, as a jump in the outer quarter of a square of
    /// cubature moves it by up to 1/6 and its estimate by 1/12, and here all squares along an edge are alike. A sampler's pixel is a mean of independent indicators of probability p (of which
    /// strata only take variance away), so by Bernstein it is off by more than `√(2 p(1−p) L / M) + 2L / 3M` with probability
    /// below `2 exp(−L)`; L = 35 makes that 1e-12 over all pixels and cases.
    #[test]
    fn one_voxel_has_its_image_in_closed_form(
        kernel in prop::sample::select(SEPARABLE.to_vec()), scale in [0.5..6.0f64, 0.5..6.0], shift in [-1.0..1.0f64, -1.0..1.0],
        h in [0.1..10.0f64, 0.1..10.0, 0.1..10.0], estimand in prop::sample::select(Estimand::ALL.to_vec()),
        weight in 1u16..60000, by_mc in any::<bool>(),
    ) {
        let grid = Grid::new([1, 1, 1], h.into(), DVec3::new(3.0, -5.0, 7.0), DMat3::IDENTITY).unwrap();
        let density = density_of(&Volume::from_vec(grid.clone(), vec![weight], "one voxel").unwrap());
        // `scale` pixels a voxel, the voxel's centre at pixel 8 + shift.
        let rows: [[f64; 4]; 2] = std::array::from_fn(|a| {
            let mut row = [0.0; 4];
            row[a] = scale[a] / h[a];
            row[3] = 8.0 + shift[a] - row[a] * grid.origin()[a];
            row
        });
        let matrix = [rows[0], rows[1], [0.0, 0.0, 0.0, 1.0]];
        let camera = Camera::from_matrix(matrix, Extent::new(16, 16).unwrap(), &grid, None).unwrap();
        let share = |a: usize, pixel: usize| {
            let at = |edge: usize| cdf(kernel, (edge as f64 - 8.0 - shift[a]) / scale[a]);
            at(pixel + 1) - at(pixel)
        };
        // A parallel `line` image is `count` times F per pixel area.
        let unit = if estimand == Estimand::Line { density.mass() * camera.det() } else { 1.0 };
        let options = ReferenceOptions { estimand, kernel, ..ReferenceOptions::default() };
        let exact = reference(&density, &camera, &options, &Watch::default()).unwrap();
        let samples = 1 << 14;
        let method = if by_mc { Method::Mc } else { Method::Stratified };
        let ask = Ask { method, kernel, estimand, order: VoxelOrder::Raster, samples, seed: u64::from(weight) };
        let sampled = ask.render(&Distribution::new(&density, VoxelOrder::Raster).unwrap(), &camera).image;
        let (mut square, mut claim) = (0.0, 0.0);
        for pixel in 0..256 {
            let p = share(0, pixel % 16) * share(1, pixel / 16);
            let (value, error) = (exact.image.values()[pixel], exact.error.image.values()[pixel]);
            square += ((value - p * unit) / unit).powi(2);
            claim += (error / unit).powi(2);
            let (l, m) = (35.0, samples as f64);
            // Fixed-point weights and 32-bit arithmetic add 2^-20 of the value, and 2^-16 voxel at the pixel's border.
            let bound = (2.0 * p * (1.0 - p) * l / m).sqrt() + 2.0 * l / (3.0 * m) + 2f64.powi(-16);
            let value = sampled.values()[pixel] / unit;
            prop_assert!((value - p).abs() <= bound, "{} {} bound {}", value, p, bound);
        }
        // 256 pixels of at most 1, each rounded some hundred times.
        let times = if kernel == Kernel::Box { 2.0 } else { 1.0 };
        prop_assert!(square.sqrt() <= times * claim.sqrt() + 1e-13, "{:e} claims {:e}", square.sqrt(), claim.sqrt());
    }
}
