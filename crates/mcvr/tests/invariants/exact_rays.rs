//! The ray caster against polynomials integrated in rational arithmetic, on rays that meet faces, edges and corners exactly.

use glam::{DMat3, DVec3};
use mcvr::raycast::{Counters, Integrator};
use mcvr::scene::{Camera, Estimand, Extent, Kernel};
use mcvr::volume::Grid;
use proptest::prelude::*;

use crate::common::SEPARABLE;
use crate::polynomial::{ExactRay, line_integral, q, to_f64};
use crate::scenes::*;

/// A scan of at most 5³ voxels whose spacings are powers of two: its voxel coordinates are exact.
fn dyadic() -> impl Strategy<Value = Scan> {
    (scan(), [-2i32..3, -2i32..3, -2i32..3]).prop_map(|(scan, h)| Scan {
        dims: scan.dims.map(|n| n.div_ceil(3) + n % 2),
        spacing: h.map(|h| 2f64.powi(h)),
        origin: [0.0; 3],
        ..scan
    })
}

/// Sets a value beside its exact one. `δ` is how far, in voxels, rounding moves the ray: coordinates are sums of four products of
/// numbers at most `size`, through two inverses that lose a factor of at most 8 here (rows of small integers), so `64 · 2^-53 size`.
///
/// A field is at most `w` and its slope along an axis at most `w` per voxel (`tent`; `bspline3` 2/3 of that): moved by δ on three
/// axes, its integral changes by `3 δ w` times the way. `box` jumps instead: each of the faces that the ray crosses moves along it
/// by `δ / |d_a|`. The integration itself rounds each cell's part some 64 times, relative to `w` times the way.
fn hold(
    value: f64,
    exact: f64,
    w: f64,
    way: f64,
    size: f64,
    dims: [usize; 3],
    slowest: f64,
) -> Result<(), TestCaseError> {
    let delta = 64.0 * 2f64.powi(-53) * size;
    let faces = dims.iter().sum::<usize>() as f64 + 15.0;
    let bound = w * (3.0 * delta * way + faces * delta * slowest + 64.0 * 2f64.powi(-53) * faces * way);
    prop_assert!((value - exact).abs() <= bound, "{} {}: off by {:e}, bound {:e}", value, exact, value - exact, bound);
    // A bound that says nothing would pass everything.
    prop_assert!(bound <= 1e-8 * w * way, "bound {:e}", bound);
    Ok(())
}

/// A position in quarters of a voxel (with `box` an eighth beside them: off all faces).
fn position(at: [f64; 3], dims: [usize; 3], kernel: Kernel) -> [f64; 3] {
    std::array::from_fn(|a| {
        let beside = if kernel == Kernel::Box { 0.125 } else { 0.0 };
        (at[a] * (dims[a] as f64 + 1.0) * 4.0).floor() / 4.0 - 1.0 + beside
    })
}

fn kernel() -> impl Strategy<Value = Kernel> {
    prop::sample::select(SEPARABLE.to_vec())
}

fn estimand() -> impl Strategy<Value = Estimand> {
    prop::sample::select(Estimand::ALL.to_vec())
}

const UNIT: std::ops::Range<f64> = 0.0..1.0;

proptest! {
    #![proptest_config(config(192))]

    #[test]
    fn parallel_rays_have_their_exact_integrals(
        scan in dyadic(), kernel in kernel(), estimand in estimand(), at in [UNIT, UNIT, UNIT],
        r in [-2i8..3, -2i8..3, -2i8..3], s in [-2i8..3, -2i8..3, -2i8..3],
    ) {
        let [r, s] = [r, s].map(|v| DVec3::from_array(v.map(f64::from)));
        let along = r.cross(s);
        prop_assume!(along != DVec3::ZERO);
        let h = DVec3::from_array(scan.spacing);
        let grid = Grid::new(scan.dims, h, DVec3::ZERO, DMat3::IDENTITY).unwrap();
        let density = density_of(&scan.store(grid.clone(), &scan.values()));
        let at = position(at, scan.dims, kernel);
        let world = DVec3::from_array(at) * h;
        let matrix = [[r.x, r.y, r.z, 0.0], [s.x, s.y, s.z, 0.0], [0.0, 0.0, 0.0, 1.0]];
        let camera = Camera::from_matrix(matrix, Extent::new(4, 4).unwrap(), &grid, None).unwrap();
        let (px, py) = (r.dot(world), s.dot(world));
        let value = Integrator::new(&density, kernel).unwrap().view(&camera, estimand).integrate(px, py, &mut Counters::default());

        let weights: Vec<_> = (0..grid.len()).map(|i| q(density.weight(i))).collect();
        let d = along / h;
        let ray = ExactRay { o: at.map(q), d: d.to_array().map(q), start: None, squared: false };
        let integral = line_integral(kernel, scan.dims, &weights, &ray);
        let scale = if estimand == Estimand::Count { 1.0 / (density.mass() * camera.det()) } else { 1.0 };
        let exact = along.length() * scale * to_f64(&integral);
        let way = ((DVec3::from_array(scan.dims.map(|n| n as f64)) + 4.0) * h).length();
        let slowest = d.to_array().into_iter().filter(|d| *d != 0.0).map(|d| along.length() / d.abs()).fold(0.0, f64::max);
        let size = (px.abs() + py.abs() + world.abs().element_sum() + way) / h.min_element();
        hold(value, exact, density.report().max_weight * scale, way, size, scan.dims, slowest)?;
    }

    #[test]
    fn rays_from_a_pinhole_have_their_exact_integrals(
        scan in dyadic(), kernel in kernel(), estimand in estimand(), at in [UNIT, UNIT, UNIT], before in 0u8..3,
        slope in [-8i8..9, -8i8..9], near in 1i32..6,
    ) {
        let h = DVec3::from_array(scan.spacing);
        let grid = Grid::new(scan.dims, h, DVec3::ZERO, DMat3::IDENTITY).unwrap();
        let density = density_of(&scan.store(grid.clone(), &scan.values()));
        // In the lower half of the scan or before it, in density as often as not.
        let mut at = position(at, scan.dims, kernel);
        at[2] = at[2].min((scan.dims[2] as f64 - 1.0) / 2.0 - 0.375) - f64::from(before) * 2.0;
        let eye = DVec3::from_array(at) * h;
        let near = 2f64.powi(-near);
        let rows = [DVec3::new(16.0, 0.0, 8.0), DVec3::new(0.0, 16.0, 8.0), DVec3::Z];
        let matrix = rows.map(|r| [r.x, r.y, r.z, -r.dot(eye)]);
        let camera = Camera::from_matrix(matrix, Extent::new(16, 16).unwrap(), &grid, Some(near)).unwrap();
        let v = DVec3::new(f64::from(slope[0]) / 4.0, f64::from(slope[1]) / 4.0, 1.0);
        let (px, py) = (16.0 * v.x + 8.0, 16.0 * v.y + 8.0);
        let value = Integrator::new(&density, kernel).unwrap().view(&camera, estimand).integrate(px, py, &mut Counters::default());

        let weights: Vec<_> = (0..grid.len()).map(|i| q(density.weight(i))).collect();
        let d = v / h;
        let squared = estimand == Estimand::Count;
        let ray = ExactRay { o: at.map(q), d: d.to_array().map(q), start: Some(q(near)), squared };
        let integral = to_f64(&line_integral(kernel, scan.dims, &weights, &ray));
        let way = ((DVec3::from_array(scan.dims.map(|n| n as f64)) + 14.0) * h).length();
        // The largest weight times the largest t² for `count`.
        let scale = if squared { 1.0 / (density.mass() * camera.det()) } else { v.length() };
        let most = density.report().max_weight * scale * if squared { way * way } else { 1.0 };
        let slowest = d.to_array().into_iter().filter(|d| *d != 0.0).map(|d| 1.0 / d.abs()).fold(0.0, f64::max);
        let size = (px.abs() + py.abs() + eye.abs().element_sum() + way) / h.min_element();
        hold(value, scale * integral, most, way, size, scan.dims, slowest)?;
    }
}
