//! Rays and grids: edges, corners, shapes, spacings, directions, origins.

use glam::{DMat3, DVec3};
use mcvr_raycast::{MarchOptions, RayOptions};
use mcvr_scene::{Camera, Estimand, Extent, Kernel, View, Watch};
use mcvr_volume::{Grid, Volume};

use super::super::scenes::{
    SEPARABLE, bytes, cubes, disagreement, exact, filled, identity, largest_amount, lines, made, moved, parallel,
    pinhole, plain, unit,
};
use super::super::{Bound, CaseError, Context, Finding};
use crate::{Method, Request, make};

/// A uniform block of 20 voxels of weight 1: along an axis every chord is 20 mm under `box` and under `tent`, also exactly
/// through edges, corners and faces of voxels. A chord is the sum of at most 22 pieces, each a difference of two parameters up
/// to 64, the weights interpolated: forward error at most `22 · 4 · 2^-53 · 64` of pieces that add up to 20. On the block's
/// border `box` is half-open, and outside both are exactly 0.
pub(super) fn rays_on_edges(_: &Context) -> Result<Finding, CaseError> {
    let volume = filled(Grid::with_spacing([20; 3], [1.0; 3])?, |n| vec![1u8; n])?;
    let density = identity(&volume)?;
    let extent = Extent::new(20, 20)?;
    let mut worst = 0.0f64;
    for axis in 0..3 {
        let [x, y] = [[DVec3::Y, DVec3::Z], [DVec3::Z, DVec3::X], [DVec3::X, DVec3::Y]][axis];
        let camera = parallel(x, y, [0.0; 2], extent, volume.grid())?;
        let inner = [[8.0, 8.0], [7.5, 7.5], [8.0, 7.5], [0.0, 0.0], [19.0, 19.0], [16.0, 3.0], [15.5, 7.5]];
        for kernel in [Kernel::Box, Kernel::Tent] {
            for v in lines(&density, kernel, &camera, inner)? {
                worst = worst.max(if v.is_finite() { (v - 20.0).abs() } else { f64::INFINITY });
            }
        }
        let border =
            lines(&density, Kernel::Box, &camera, [[-0.5, 5.0], [5.0, -0.5], [19.5, 5.0], [-0.5, 19.5], [25.0, 3.0]])?;
        for (v, expected) in border.iter().zip([20.0, 20.0, 0.0, 0.0, 0.0]) {
            worst = worst.max(if expected == 0.0 && *v != 0.0 { f64::INFINITY } else { (v - expected).abs() });
        }
        for v in lines(&density, Kernel::Tent, &camera, [[-1.0, 5.0], [20.0, 5.0], [-1.0, -1.0], [25.0, 25.0]])? {
            worst = worst.max(v.abs());
        }
    }
    // The slab test as it is usually written, for a ray in the plane of a face: 0/0.
    let (low, high, origin, direction) = (-0.5f64, 19.5f64, -0.5f64, 0.0f64);
    let (p, q) = ((low - origin) / direction, (high - origin) / direction);
    let naive = if p.max(q) - p.min(q) > 0.0 { "a hit" } else { "a miss" };
    Ok(Finding::new(worst, "mm", Bound::AtMost(22.0 * 4.0 * 0.5f64.powi(53) * 64.0))
        .with(format!("a slab test that divides by the direction has {p} and {q} there: {naive}")))
}

/// Rays along the face diagonal of a uniform block of `N = 16` under `box`, from whole numbers: exactly through the edges of
/// voxels (`x - y` whole) the chord is `(N - |x - y|) √2`, and along the space diagonal through corners `N √3`. Where two
/// crossings coincide, one of them leaves an empty piece or one of rounding, so the bound is that of 2 N + 2 pieces with
/// parameters up to 64: `34 · 4 · 2^-53 · 64`, and that of the direction, normalised within `4 · 2^-53`.
pub(super) fn diagonals(_: &Context) -> Result<Finding, CaseError> {
    let volume = filled(Grid::with_spacing([16; 3], [1.0; 3])?, |n| vec![1u8; n])?;
    let density = identity(&volume)?;
    let extent = Extent::new(32, 32)?;
    let face = parallel(DVec3::new(1.0, -1.0, 0.0), DVec3::Z, [16.0, 0.0], extent, volume.grid())?;
    let mut worst = 0.0f64;
    for (z, inside) in [(0.0, true), (3.5, true), (7.0, true), (-0.5, true), (15.5, false)] {
        let at = (0..=32).map(|k| [f64::from(k), z]);
        for (k, v) in lines(&density, Kernel::Box, &face, at)?.into_iter().enumerate() {
            let expected = if inside { (16.0 - (k as f64 - 16.0).abs()).max(0.0) * 2f64.sqrt() } else { 0.0 };
            worst = worst.max(if v.is_finite() { (v - expected).abs() } else { f64::INFINITY });
        }
    }
    let space = parallel(DVec3::new(1.0, -1.0, 0.0), DVec3::new(1.0, 1.0, -2.0), [16.0; 2], extent, volume.grid())?;
    let through = lines(&density, Kernel::Box, &space, [[16.0, 16.0]])?[0];
    worst = worst.max((through - 16.0 * 3f64.sqrt()).abs());
    Ok(Finding::new(worst, "mm", Bound::AtMost((34.0 * 4.0 * 64.0 + 4.0 * 28.0) * 0.5f64.powi(53))))
}

/// Bernstein's inequality (false alarms: 1e-6) on every pixel for volumes with one or two voxels along an axis: every cell is a
/// border cell. And the `count` image of the reference sums to 1 within its own error.
pub(super) fn thin_volumes(_: &Context) -> Result<Finding, CaseError> {
    let (samples, mut worst, mut at) = (1 << 16, 0.0, String::new());
    for (n, dims) in [[1, 1, 1], [1, 40, 1], [1, 1, 33], [2, 1, 1], [2, 2, 2], [1, 7, 5]].into_iter().enumerate() {
        let volume = cubes(dims)?;
        let view = View { parallel: n % 2 == 0, ..View::default() };
        let scenery = plain(&volume, Camera::look(&view, volume.grid(), Extent::new(4, 4)?)?);
        let nearest = 0.5 * volume.grid().diameter();
        for kernel in SEPARABLE {
            let estimand = Estimand::ALL[n / 2 % 2];
            let truth = exact(&scenery, kernel, estimand, 5e-3)?;
            let request = Request { method: Method::Mc, kernel, estimand, samples, ..Request::default() };
            let image = made(&scenery, &request)?.image;
            let largest = largest_amount(&scenery.camera, estimand, identity(&volume)?.mass(), nearest);
            let mut ratio = disagreement(&image, &truth, samples, largest, f64::INFINITY);
            if estimand == Estimand::Count {
                ratio = ratio.max((truth.image.sum() - 1.0).abs() / truth.error.image.sum().max(1e-12));
            }
            if ratio >= worst {
                (worst, at) = (ratio, format!("largest for {dims:?} under {kernel}"));
            }
        }
    }
    Ok(Finding::new(worst, "of the allowed difference", Bound::AtMost(1.0)).with(at))
}

/// Places in the image of points within a volume, for comparing two grids of one object.
fn rays<'a>(camera: &'a Camera, grid: &'a Grid) -> impl Iterator<Item = [f64; 2]> + 'a {
    (0..400u64).map(move |i| {
        let at = DVec3::new(unit(3 * i), unit(3 * i + 1), unit(3 * i + 2))
            * DVec3::from_array(grid.dims().map(|n| n as f64));
        let (x, y, _) = camera.project(grid.index_to_world().transform_point3(at - 0.5));
        [x, y]
    })
}

/// Largest difference between two lists over the largest value of the first, or infinity where that is no number or 0.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    let largest = a.iter().copied().fold(0.0, f64::max);
    let off = a
        .iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, |m: f64, v| if v.is_nan() { f64::INFINITY } else { m.max(v) });
    if largest > 0.0 { off / largest } else { f64::INFINITY }
}

/// One object in two grids: voxels of 1000 × 1 × 1 mm (and 1 × 1000 × 1, and 1000 × 1000 × 1), and the same cut into cubes of
/// 50 mm along the long axes, under `box`: the field is the same, so is every line integral. Crossings of planes are parameters
/// of at most `2 D` with 4 roundings, each of at most 100 pieces; chord errors add up to
/// `100 · 4 · 2 D · 2^-53` times the largest weight, against the largest integral, at least 1 mm of weight 1.
pub(super) fn spacing_ratio(_: &Context) -> Result<Finding, CaseError> {
    let (mut worst, mut bound) = (0.0f64, f64::INFINITY);
    for long in [[true, false, false], [false, true, false], [true, true, false]] {
        let coarse_dims = long.map(|l| if l { 3 } else { 6 });
        let coarse = filled(Grid::with_spacing(coarse_dims, long.map(|l| if l { 1000.0 } else { 1.0 }))?, bytes)?;
        let fine_dims = long.map(|l| if l { 60 } else { 6 });
        let spacing = long.map(|l| if l { 50.0 } else { 1.0 });
        let origin = DVec3::from_array(long.map(|l| if l { -475.0 } else { 0.0 }));
        let grid = Grid::new(fine_dims, spacing.into(), origin, DMat3::IDENTITY)?;
        let weights = identity(&coarse)?;
        let fine = filled(grid.clone(), |n| {
            let whole = |i: usize| {
                let at = grid.unravel(i);
                coarse.grid().linear([0, 1, 2].map(|a| if long[a] { at[a] / 20 } else { at[a] }))
            };
            (0..n).map(|i| weights.weight(whole(i)) as u8).collect::<Vec<_>>()
        })?;
        for is_parallel in [false, true] {
            let view = View { azimuth: 31.0, elevation: 17.0, parallel: is_parallel, ..View::default() };
            let camera = Camera::look(&view, coarse.grid(), Extent::new(64, 64)?)?;
            let a = lines(&weights, Kernel::Box, &camera, rays(&camera, coarse.grid()))?;
            let b = lines(&identity(&fine)?, Kernel::Box, &camera, rays(&camera, coarse.grid()))?;
            worst = worst.max(apart(&a, &b));
            let largest = a.iter().copied().fold(0.0, f64::max);
            // The eye is two diameters away, so parameters reach three.
            let error = 100.0 * 4.0 * 3.0 * coarse.grid().diameter() * 0.5f64.powi(53) * 255.0;
            bound = bound.min(2.0 * error / largest);
        }
    }
    Ok(Finding::new(worst, "of the largest integral", Bound::AtMost(bound)))
}

/// One object in grids whose axes are exchanged and mirrored (left-handed directions): the same integrals, under every kernel,
/// up to rounding: pieces as above, 80 at most, and polynomials of at most 64 terms whose weights are at most 1, so
/// `80 · (4 · 3 D / h + 64) · 2^-53 · w h` in all against the largest integral.
pub(super) fn mirrored(_: &Context) -> Result<Finding, CaseError> {
    let dims = [9, 8, 7];
    let spacing = [0.7, 1.0, 1.6];
    let plain_grid = Grid::new(dims, spacing.into(), DVec3::new(3.0, -4.0, 5.0), DMat3::IDENTITY)?;
    let volume = filled(plain_grid.clone(), bytes)?;
    let density = identity(&volume)?;
    let (mut worst, mut bound) = (0.0f64, f64::INFINITY);
    for (axes, mirror) in [([0, 1, 2], 0b001), ([1, 0, 2], 0b000), ([2, 0, 1], 0b110), ([2, 1, 0], 0b111)] {
        // Axis a of the new grid runs along axis axes[a] of the old one, backwards where mirrored.
        let back = |a: usize| mirror >> a & 1 == 1;
        let unit = |a: usize| DVec3::AXES[axes[a]] * if back(a) { -1.0 } else { 1.0 };
        let direction = DMat3::from_cols(unit(0), unit(1), unit(2));
        let last = |a: usize| (dims[axes[a]] - 1) as f64 * spacing[axes[a]];
        let origin =
            plain_grid.origin() + (0..3).filter(|a| back(*a)).map(|a| DVec3::AXES[axes[a]] * last(a)).sum::<DVec3>();
        let grid = Grid::new(axes.map(|a| dims[a]), axes.map(|a| spacing[a]).into(), origin, direction)?;
        let same = filled(grid.clone(), |n| {
            let old = |i: usize| {
                let (at, mut place) = (grid.unravel(i), [0; 3]);
                for a in 0..3 {
                    place[axes[a]] = if back(a) { dims[axes[a]] - 1 - at[a] } else { at[a] };
                }
                density.weight(plain_grid.linear(place)) as u8
            };
            (0..n).map(old).collect::<Vec<_>>()
        })?;
        let camera = Camera::look(&View::default(), &plain_grid, Extent::new(64, 64)?)?;
        for kernel in SEPARABLE {
            let a = lines(&density, kernel, &camera, rays(&camera, &plain_grid))?;
            let b = lines(&identity(&same)?, kernel, &camera, rays(&camera, &plain_grid))?;
            worst = worst.max(apart(&a, &b));
            let largest = a.iter().copied().fold(0.0, f64::max);
            let error = 80.0 * (12.0 * plain_grid.diameter() / 0.7 + 64.0) * 0.5f64.powi(53) * 255.0 * 1.6;
            // Under `box` an integral has no slope: its pieces alone err. Under the others the field does as well, by its
            // slope of at most √3 w / h times the error of a position.
            bound = bound.min(2.0 * 3.0 * error / largest);
        }
    }
    Ok(Finding::new(worst, "of the largest integral", Bound::AtMost(bound)))
}

/// An affine map of the world that takes grid and camera along leaves every `count` as it is, however oblique it makes the
/// directions: here shears of up to 75 degrees and spacings of 1 : 1000. Line integrals change by the stretch of the ray, so
/// Bernstein's inequality (false alarms: 1e-6) is applied to `count` images, sampled on the oblique grid, cast on the plain one.
pub(super) fn oblique(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([7, 6, 5])?;
    let (samples, mut worst) = (1 << 16, 0.0f64);
    let shear = |x: f64, y: f64| DMat3::from_cols(DVec3::X, DVec3::new(x, 1.0, 0.0), DVec3::new(0.0, y, -1.0));
    for (n, map) in [
        shear(3.7, 0.0),
        shear(-1.5, 3.7),
        shear(0.5, 0.2) * DMat3::from_diagonal(DVec3::new(1000.0, 1.0, 1.0)),
        DMat3::from_diagonal(DVec3::new(1000.0, 1.0, 1000.0)),
    ]
    .into_iter()
    .enumerate()
    {
        let by = DVec3::new(12.0, -30.0, 5.0);
        let scale = DVec3::new(map.x_axis.length(), map.y_axis.length(), map.z_axis.length());
        let direction = map * DMat3::from_diagonal(scale.recip());
        let grid = Grid::new(volume.grid().dims(), scale, by, direction)?;
        let same = filled(grid, bytes)?;
        let camera =
            Camera::look(&View { parallel: n % 2 == 1, ..View::default() }, volume.grid(), Extent::new(6, 6)?)?;
        let truth = exact(&plain(&volume, camera.clone()), Kernel::Tent, Estimand::Count, 1e-3)?;
        let scenery = plain(&same, moved(&camera, map, by, same.grid())?);
        let request = Request { method: Method::Mc, estimand: Estimand::Count, samples, ..Request::default() };
        // The matrix's third row is scaled to length 1, in mm of the oblique world: its near plane is not the old one, but both
        // lie before the volume.
        worst = worst.max(disagreement(&made(&scenery, &request)?.image, &truth, samples, 1.0, f64::INFINITY));
        let cast = exact(&scenery, Kernel::Tent, Estimand::Count, 1e-3)?;
        for ((a, b), (e, f)) in truth
            .image
            .values()
            .iter()
            .zip(cast.image.values())
            .zip(truth.error.image.values().iter().zip(cast.error.image.values()))
        {
            worst = worst.max((a - b).abs() / (e + f).max(1e-15));
        }
    }
    Ok(Finding::new(worst, "of the allowed difference", Bound::AtMost(1.0)))
}

/// A volume at `o = 1e7` mm, its camera moved along. The matrix's last column rounds `f o` to `2^-53` of itself, and so do the
/// eye and the map to indices: rays are displaced by at most `16 · 2^-53 · √3 o`, and a `tent` integral changes by at most that
/// times `(D + 2√3 h) √3 w / h`, as for the far eye. The sampler's counters must not notice.
pub(super) fn far_origin(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([12; 3])?;
    let density = identity(&volume)?;
    let by = DVec3::new(1e7, -1e7, 1e7);
    let grid = Grid::new([12; 3], DVec3::ONE, by, DMat3::IDENTITY)?;
    let far = filled(grid.clone(), bytes)?;
    let (mut worst, mut lost) = (0.0f64, 0);
    for is_parallel in [false, true] {
        let view = View { parallel: is_parallel, ..View::default() };
        let camera = |v: &Volume| Camera::look(&view, v.grid(), Extent::new(64, 64)?);
        let near = camera(&volume)?;
        let a = lines(&density, Kernel::Tent, &near, rays(&near, volume.grid()))?;
        let b = lines(&identity(&far)?, Kernel::Tent, &camera(&far)?, rays(&near, volume.grid()))?;
        let off = a.iter().zip(&b).map(|(a, b)| (a - b).abs());
        worst = off.fold(worst, |m, v| if v.is_nan() { f64::INFINITY } else { m.max(v) });
        let request = Request { samples: 1 << 14, ..Request::default() };
        let scenery = plain(&far, camera(&far)?);
        let inside = made(&scenery, &request)?.counters["render"]["inside"].as_u64();
        lost += (1u64 << 14) - inside.unwrap_or(0);
    }
    let root = 3f64.sqrt();
    let displaced = 16.0 * 0.5f64.powi(53) * root * 1e7;
    let bound = (grid.diameter() + 2.0 * root) * root * 255.0 * displaced;
    let worst = if lost > 0 { f64::INFINITY } else { worst };
    let single = 1e7f32 + 0.3;
    Ok(Finding::new(worst, "weight x mm", Bound::AtMost(bound)).with(format!("in 32 bits 1e7 + 0.3 mm is {single} mm")))
}

/// A grid beyond what double precision can invert must be refused, with the limit; one that is accepted gives maps that undo
/// each other within `64 · 2^-52` indices times the ratio of its spacings (the map's condition number, indices up to 4, and both
/// maps' roundings), a voxel volume that is a normal number and a finite diameter.
pub(super) fn extreme_grids(_: &Context) -> Result<Finding, CaseError> {
    let (mut wrong, mut of, mut refused) = (0, 0, 0);
    for k in (-1074..=1023).step_by(31) {
        for anisotropic in [false, true] {
            let h = 2f64.powi(k);
            let spacing = if anisotropic { DVec3::new(h, 1.0, 1.0) } else { DVec3::splat(h) };
            of += 1;
            let Ok(grid) = Grid::new([5, 4, 3], spacing, DVec3::ZERO, DMat3::from_rotation_z(0.3)) else {
                refused += 1;
                continue;
            };
            let p = DVec3::new(1.25, 2.5, 0.75);
            let q = grid.world_to_index().transform_point3(grid.index_to_world().transform_point3(p));
            let v = grid.voxel_volume();
            let ratio = spacing.max_element() / spacing.min_element();
            let fine = (p - q).length() <= 64.0 * f64::EPSILON * ratio
                && v.is_normal()
                && v > 0.0
                && grid.diameter().is_finite();
            wrong += u64::from(!fine);
        }
    }
    // What every format reads must be there.
    for h in [1e-9, 1e-6, 1.0, 1e6, 1e9] {
        of += 1;
        wrong += u64::from(Grid::new([5, 4, 3], DVec3::splat(h), DVec3::ZERO, DMat3::IDENTITY).is_err());
    }
    Ok(Finding::wrong(wrong, of, "grids").with(format!("{refused} refused")))
}

/// As [`rays_on_edges`] for pinholes: from an eye on a grid plane, along an axis and in that plane, the direction's other
/// components are exactly 0.
pub(super) fn axis_pinhole(_: &Context) -> Result<Finding, CaseError> {
    let volume = filled(Grid::with_spacing([20; 3], [1.0; 3])?, |n| vec![1u8; n])?;
    let density = identity(&volume)?;
    let mut worst = 0.0f64;
    for (eye, expected) in [
        (DVec3::new(-10.0, 3.5, 4.0), 20.0),
        (DVec3::new(-10.0, 3.5, 4.5), 20.0),
        (DVec3::new(-10.0, -0.5, 4.0), 20.0),
        (DVec3::new(-10.0, 19.5, 4.0), 0.0),
        (DVec3::new(-10.0, 20.5, 4.0), 0.0),
        (DVec3::new(9.5, 3.5, 4.0), 9.75),
        (DVec3::new(-0.5, 3.5, 4.0), 19.75),
    ] {
        let camera = pinhole(eye, [DVec3::Y, DVec3::Z, DVec3::X], 16.0, Extent::new(16, 16)?, 0.25)?;
        let v = lines(&density, Kernel::Box, &camera, [[8.0, 8.0]])?[0];
        worst = worst.max(if v.is_finite() { (v - expected).abs() } else { f64::INFINITY });
    }
    Ok(Finding::new(worst, "mm", Bound::AtMost(22.0 * 4.0 * 0.5f64.powi(53) * 64.0)))
}

/// Exact: a step is refused, or the march takes at most 2^24 steps a ray (fewer where it crosses less than the
/// diagonal). The image at the smallest step, on a long thin volume, is finite and not black.
pub(super) fn endless_steps(_: &Context) -> Result<Finding, CaseError> {
    let volume = filled(Grid::new([1 << 10, 1, 1], DVec3::new(1e3, 1.0, 1.0), DVec3::ZERO, DMat3::IDENTITY)?, bytes)?;
    let view = View { azimuth: 0.0, elevation: 0.0, ..View::default() };
    let scenery = plain(&volume, Camera::look(&view, volume.grid(), Extent::new(1, 1)?)?);
    let options = MarchOptions::from(RayOptions { kernel: Kernel::Box, ..RayOptions::default() });
    let smallest = options.smallest_step(volume.grid());
    let request = |step| Request { method: Method::March, samples: 1, kernel: Kernel::Box, step, ..Request::default() };
    let (mut wrong, mut of) = (0, 0);
    for step in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300, 1e-30, smallest * 0.999] {
        of += 1;
        let refused = make(&scenery, &request(step), &Watch::default()).err().map(|e| e.to_string());
        let says = refused.is_some_and(|e| e.contains("step"));
        wrong += u64::from(!says);
    }
    let made = made(&scenery, &request(smallest))?;
    let steps = made.counters["march"]["evaluations"].as_u64().unwrap_or(u64::MAX);
    of += 2;
    wrong += u64::from(!(1 << 23..=u64::from(MarchOptions::STEPS_LIMIT)).contains(&steps));
    wrong += u64::from(!(made.image.max() > 0.0 && made.image.max().is_finite()));
    Ok(Finding::wrong(wrong, of, "marches").with(format!("{steps} steps at the smallest step, {smallest:.2e}")))
}
