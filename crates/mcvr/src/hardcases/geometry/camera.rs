//! What a camera may be given.

use glam::DVec3;
use mcvr_sampling::Precision;
use mcvr_scene::{Camera, Estimand, Extent, Kernel, View};
use mcvr_volume::Grid;

use super::super::scenes::{
    SEPARABLE, bernstein, bytes, cubes, disagreement, exact, filled, identity, largest_amount, lines, made, parallel,
    pinhole, plain, rendered, samplers, unit,
};
use super::super::{Bound, CaseError, Context, Finding};
use crate::{Method, Request};

fn turned() -> Result<Grid, CaseError> {
    let direction = glam::DMat3::from_rotation_x(0.4) * glam::DMat3::from_rotation_z(-0.9);
    Ok(Grid::new([11, 9, 7], DVec3::new(0.7, 1.0, 1.6), DVec3::new(-31.0, 12.0, 55.0), direction)?)
}

/// At elevation ±90 the image's vertical is the limit. A camera's rows are focal length and image centre times unit vectors
/// that turn by the change of the angle `δ`; so entries differ from those at ±(90° - δ) by at most `(f + c) δ` and the
/// rounding of products, `8 eps (f + c)`.
pub(super) fn up_parallel(_: &Context) -> Result<Finding, CaseError> {
    let grid = turned()?;
    let extent = Extent::new(64, 48)?;
    let (delta, mut worst) = (1e-7f64, 0.0f64);
    for azimuth in [0.0, 30.0, 90.0, 123.0, 180.0, 270.0] {
        for pole in [90.0, -90.0] {
            for is_parallel in [false, true] {
                let view = |elevation| View { azimuth, elevation, parallel: is_parallel, ..View::default() };
                let at = Camera::look(&view(pole), &grid, extent)?.world_to_pixel();
                let by = Camera::look(&view(pole * (1.0 - delta / 90.0)), &grid, extent)?.world_to_pixel();
                let entries = |m: &[[f64; 4]; 3]| m.map(|r| DVec3::new(r[0], r[1], r[2]));
                let size = entries(&at).iter().map(|r| r.length()).sum::<f64>();
                let allowed = size * (delta.to_radians() + 8.0 * f64::EPSILON);
                for (a, b) in entries(&at).iter().zip(entries(&by)) {
                    let ratio = (*a - b).length() / allowed;
                    worst = if ratio.is_finite() { worst.max(ratio) } else { f64::INFINITY };
                }
            }
        }
    }
    let right = DVec3::NEG_Z.cross(DVec3::Z).normalize();
    Ok(Finding::new(worst, "of the allowed change", Bound::AtMost(1.0))
        .with(format!("the usual right = normalise(axis x up) is {right} there")))
}

/// Bernstein's inequality (false alarms: 1e-6) on every pixel of `count` and `line` images at a field of view of 0.001 degrees,
/// from 4e4 diameters, where it holds most of the volume.
pub(super) fn narrow_view(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([6, 5, 4])?;
    let density = identity(&volume)?;
    let (samples, mut worst, mut seen) = (1 << 17, 0.0f64, 0.0);
    let diameter = volume.grid().diameter();
    let distance = 4e4 * diameter;
    let view = View { fov: Some(1e-3), distance: Some(distance), azimuth: 31.0, elevation: 17.0, ..View::default() };
    let scenery = plain(&volume, Camera::look(&view, volume.grid(), Extent::new(3, 3)?)?);
    for estimand in Estimand::ALL {
        let truth = exact(&scenery, Kernel::Tent, estimand, 1e-2)?;
        let request = Request { method: Method::Mc, estimand, samples, cull: false, ..Request::default() };
        let image = made(&scenery, &request)?.image;
        let largest = largest_amount(&scenery.camera, estimand, density.mass(), distance - diameter);
        worst = worst.max(disagreement(&image, &truth, samples, largest, f64::INFINITY));
        seen = if estimand == Estimand::Count { truth.image.sum() } else { seen };
    }
    let worst = if seen > 0.5 { worst } else { f64::INFINITY };
    Ok(Finding::new(worst, "of the allowed difference", Bound::AtMost(1.0))
        .with(format!("{seen:.3} of the mass in view")))
}

/// At 179.9 degrees from within a uniform block, along an axis, an image of 3 × 3 pixels has all of the block beyond the near
/// plane `n` in its middle: 1146 n sideways at the near plane itself, more than the block's width. That is a share
/// `(x + 1/2 - n) / 16` of the mass for an eye at `x`, under `box`. Samples differ by Bernstein's `t` at most (false alarms:
/// 1e-6), none may lie beside; ray casting, which cannot resolve such a pixel, by its own error estimate at most.
pub(super) fn wide_view(_: &Context) -> Result<Finding, CaseError> {
    let volume = filled(Grid::with_spacing([16; 3], [1.0; 3])?, |n| vec![3u8; n])?;
    let (distance, near, samples) = (2.5, 0.0625, 1 << 17);
    let view = View {
        fov: Some(179.9),
        distance: Some(distance),
        near: Some(near),
        azimuth: 0.0,
        elevation: 0.0,
        ..View::default()
    };
    let scenery = plain(&volume, Camera::look(&view, volume.grid(), Extent::new(3, 3)?)?);
    let share = (7.5 + distance + 0.5 - near) / 16.0;
    let base = Request { kernel: Kernel::Box, estimand: Estimand::Count, samples, cull: false, ..Request::default() };
    let made = made(&scenery, &Request { method: Method::Mc, ..base })?;
    let mut worst = (made.image.get(1, 1) - share).abs() / bernstein(samples, share * (1.0 - share), 1.0, 1);
    if made.counters["render"]["outside"] != 0 {
        worst = f64::INFINITY;
    }
    let truth = exact(&scenery, Kernel::Box, Estimand::Count, 1e-2)?;
    let (cast, claim) = (truth.image.get(1, 1), truth.error.image.get(1, 1));
    worst = worst.max((cast - share).abs() / claim);
    Ok(Finding::new(worst, "of the allowed difference", Bound::AtMost(1.0)).with(format!(
        "{share:.4} of the mass: samples {:.4}, ray casting {cast:.2} and says ± {claim:.2}",
        made.image.get(1, 1)
    )))
}

/// Exact: each unusable parameter must be refused by an error that names what is wrong; none may make a camera.
pub(super) fn nonsense(_: &Context) -> Result<Finding, CaseError> {
    let (grid, extent) = (turned()?, Extent::new(8, 8)?);
    let mut accepted = vec![];
    let mut of = 0;
    let mut look = |what: &str, view: View| {
        of += 1;
        let says = Camera::look(&view, &grid, extent).map_or_else(|e| e.to_string(), |_| String::new());
        if !says.contains(what) {
            accepted.push(format!("{view:?}: {says}"));
        }
    };
    let base = View::default();
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        look("angles", View { azimuth: bad, ..base });
        look("angles", View { elevation: bad, ..base });
        look("distance", View { distance: Some(bad), ..base });
        look("field of view", View { fov: Some(bad), ..base });
        look("near plane", View { near: Some(bad), ..base });
    }
    for bad in [0.0, -0.0, -1.0] {
        look("distance", View { distance: Some(bad), ..base });
        look("field of view", View { fov: Some(bad), ..base });
        look("near plane", View { near: Some(bad), ..base });
    }
    look("field of view", View { fov: Some(180.0), ..base });
    let good = Camera::look(&base, &grid, extent)?.world_to_pixel();
    for (r, c) in (0..3).flat_map(|r| (0..4).map(move |c| (r, c))) {
        for bad in [f64::NAN, f64::INFINITY] {
            let mut matrix = good;
            matrix[r][c] = bad;
            of += 1;
            if Camera::from_matrix(matrix, extent, &grid, None).is_ok() {
                accepted.push(format!("{bad} at {r},{c}"));
            }
        }
    }
    Ok(Finding::wrong(accepted.len() as u64, of, "cameras accepted, or refused without naming the field")
        .with(accepted.join("; ")))
}

/// A projection matrix means the same under any factor. Powers of two change no digit, so the camera must be the same bit for
/// bit; other factors round each entry once more, and the camera's scale twice.
pub(super) fn scaled_matrix(_: &Context) -> Result<Finding, CaseError> {
    let (grid, extent) = (turned()?, Extent::new(20, 16)?);
    let (mut wrong, mut of, mut failed) = (0, 0, vec![]);
    for is_parallel in [false, true] {
        let view = View { parallel: is_parallel, ..View::default() };
        let camera = Camera::look(&view, &grid, extent)?;
        let same = |factor: f64, allowed: f64| {
            let matrix = camera.world_to_pixel().map(|r| r.map(|v| v * factor));
            Camera::from_matrix(matrix, extent, &grid, Some(camera.near())).is_ok_and(|c| {
                let pairs = c.world_to_pixel().into_iter().flatten().zip(camera.world_to_pixel().into_iter().flatten());
                c.is_parallel() == is_parallel && pairs.into_iter().all(|(a, b)| (a - b).abs() <= allowed * b.abs())
            })
        };
        for k in [-980, -900, -560, -498, -1, 1, 3, 498, 560, 900, 980] {
            // The camera's own scale is 1 to rounding; a second look at it changes no more than that.
            let first = same(1.0, 4.0 * f64::EPSILON);
            for sign in [1.0, -1.0] {
                of += 1;
                if !first || !same(sign * 2f64.powi(k), 4.0 * f64::EPSILON) {
                    wrong += 1;
                    failed.push(format!("2^{k}"));
                }
            }
        }
        for factor in [1e-290, 1e-150, 1e150, -1e150, 1e290] {
            of += 1;
            if !same(factor, 8.0 * f64::EPSILON) {
                wrong += 1;
                failed.push(format!("{factor:e}"));
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "matrices").with(failed.join(", ")))
}

/// Two image directions that differ by `ε` alone: the camera is refused, or its ray through a pixel projects back to that
/// pixel. The inverse's relative error is at most `8 eps κ`, with the condition number `κ` at most `4 / ε²` times that of an
/// orthogonal camera with the same focal length and image centre (`κ₀ <= (f + c)²`); a projection of 200 mm of ray rounds no
/// worse.
pub(super) fn nearly_singular(_: &Context) -> Result<Finding, CaseError> {
    let (grid, extent) = (Grid::with_spacing([8; 3], [1.0; 3])?, Extent::new(16, 16)?);
    let (mut wrong, mut of, mut refused) = (0, 0, 0);
    for k in 1..=60 {
        let e = 0.5f64.powi(k);
        for is_parallel in [false, true] {
            let (f, c) = if is_parallel { (1.0, 0.0) } else { (16.0, 8.0) };
            let axis = if is_parallel { DVec3::ZERO } else { DVec3::Z };
            let rows = [DVec3::X * f + axis * c, (DVec3::X + DVec3::Y * e) * f + axis * c, axis];
            let matrix = [0, 1, 2]
                .map(|r| [rows[r].x, rows[r].y, rows[r].z, [4.0, 4.0, if is_parallel { 1.0 } else { 40.0 }][r]]);
            of += 1;
            let Ok(camera) = Camera::from_matrix(matrix, extent, &grid, None) else {
                refused += 1;
                continue;
            };
            let allowed = 8.0 * f64::EPSILON * 4.0 / (e * e) * (f + c).powi(2) * 16.0;
            let off = [[0.0, 0.0], [16.0, 0.0], [3.5, 11.25]].into_iter().fold(0.0, |worst: f64, [x, y]| {
                let ray = camera.ray(x, y);
                let (px, py, _) = camera.project(ray.origin + ray.direction * 200.0);
                let off = (px - x).abs().max((py - y).abs());
                if off.is_finite() { worst.max(off) } else { f64::INFINITY }
            });
            wrong += u64::from(off > allowed);
        }
    }
    Ok(Finding::wrong(wrong, of, "cameras").with(format!("{refused} refused as degenerate")))
}

/// A near plane beyond the volume leaves nothing: every pixel exactly 0, all of the mass reported as clipped, whether or not
/// bricks are left out, by every method; ray casting gives exactly 0 as well.
pub(super) fn near_beyond(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([9, 8, 7])?;
    let (mut wrong, mut of) = (0, 0);
    let view = View { near: Some(1e6), ..View::default() };
    let scenery = plain(&volume, Camera::look(&view, volume.grid(), Extent::new(8, 8)?)?);
    for estimand in Estimand::ALL {
        for method in samplers() {
            for cull in [false, true] {
                let request = Request { method, estimand, cull, samples: 3000, ..Request::default() };
                let made = made(&scenery, &request)?;
                of += 1;
                wrong += u64::from(made.image.values().iter().any(|v| *v != 0.0) || made.clipped != 1.0);
            }
        }
        for kernel in SEPARABLE {
            of += 1;
            let image = exact(&scenery, kernel, estimand, 1e-3)?.image;
            wrong += u64::from(image.values().iter().any(|v| *v != 0.0));
        }
    }
    Ok(Finding::wrong(wrong, of, "images"))
}

/// The eye in an empty hollow, all density at depths of 3 mm and more, near planes down to 1e-300 mm: `line` weights are held
/// in fixed point relative to the largest that the near plane allows, so a plane far too near leaves the real ones no digits.
/// Such an image is refused with the near plane that would do, or it agrees with the reference within Bernstein's inequality
/// (false alarms: 1e-6), whose largest amount is that at 3 mm.
pub(super) fn tiny_near(_: &Context) -> Result<Finding, CaseError> {
    let grid = Grid::with_spacing([12; 3], [1.0; 3])?;
    let hollow = filled(grid.clone(), |n| {
        let mut voxels = bytes(n);
        for (i, v) in voxels.iter_mut().enumerate() {
            if grid.unravel(i)[0] < 8 {
                *v = 0;
            }
        }
        voxels
    })?;
    let density = identity(&hollow)?;
    let samples = 1 << 16;
    let (mut wrong, mut of, mut refused) = (0, 0, vec![]);
    for near in [1.0, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-9, 1e-12, 1e-100, 1e-160, 1e-300] {
        let axes = [DVec3::Y, DVec3::Z, DVec3::X];
        let camera = pinhole(DVec3::new(3.5, 5.0, 6.0), axes, 3.0, Extent::new(6, 6)?, near)?;
        let scenery = plain(&hollow, camera);
        let request = Request { method: Method::Mc, samples, kernel: Kernel::Tent, ..Request::default() };
        of += 1;
        match made(&scenery, &request) {
            Ok(made) => {
                let truth = exact(&scenery, Kernel::Tent, Estimand::Line, 1e-3)?;
                let largest = largest_amount(&scenery.camera, Estimand::Line, density.mass(), 3.0);
                wrong += u64::from(disagreement(&made.image, &truth, samples, largest, f64::INFINITY) > 1.0);
            }
            Err(CaseError::Failed(e)) if e.to_string().contains("near plane") => refused.push(format!("{near:e}")),
            Err(_) => wrong += 1,
        }
    }
    Ok(Finding::wrong(wrong, of, "images").with(format!("refused: near planes {} mm", refused.join(", "))))
}

/// An image of `W × 1`, `1 × H` and `W × H` pixels and one of 1 × 1 of the same field, by the same points: scaling a row of the
/// matrix by a power of two scales pixel positions exactly, so the pixels of each must add up to that one pixel, sample for
/// sample.
pub(super) fn thin_images(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([9, 8, 7])?;
    let (mut wrong, mut of) = (0, 0);
    for (w, h) in [(1, 1), (64, 1), (1, 64), (16384, 1), (1, 16384), (1024, 512)] {
        for method in samplers() {
            let request = Request { method, estimand: Estimand::Count, samples: 5003, ..Request::default() };
            let count = |w: usize, h: usize| -> Result<u64, CaseError> {
                let (x, y) = (DVec3::new(0.125, 0.03, 0.0) * w as f64, DVec3::new(0.0, 0.11, 0.125) * h as f64);
                let shift = [0.01 * w as f64, -0.25 * h as f64];
                let camera = parallel(x, y, shift, Extent::new(w, h)?, volume.grid())?;
                let made = rendered(&plain(&volume, camera), &request, Some(Precision::F64))?;
                let inside = made.counters.inside;
                let summed = made.image.values().iter().map(|v| (v * 5003.0).round() as u64).sum::<u64>();
                Ok(if summed == inside { inside } else { u64::MAX })
            };
            let (one, many) = (count(1, 1)?, count(w, h)?);
            of += 5003;
            wrong += one.abs_diff(many);
        }
    }
    Ok(Finding::wrong(wrong, of, "samples"))
}

/// Seeds of a ray that surely misses: it passes the volume's bounding sphere, blown up by the kernel's support and a
/// millionth, at a distance. Its integral is 0 exactly, not a small number and not NaN.
pub(super) fn misses(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([9, 8, 7])?;
    let density = identity(&volume)?;
    let grid = volume.grid();
    let (mut wrong, mut of) = (0, 0);
    for kernel in SEPARABLE {
        let radius = (0.5 * grid.diameter() + 2.0 * kernel.support() * 3f64.sqrt()) * (1.0 + 1e-6);
        for n in 0..24u64 {
            let view = View {
                azimuth: 15.0 * n as f64,
                elevation: 45.0 * (n % 5) as f64 - 90.0,
                distance: Some(grid.diameter() * 10f64.powi((n % 4) as i32 * 2)),
                fov: Some(60.0),
                parallel: n % 3 == 0,
                near: None,
            };
            let camera = Camera::look(&view, grid, Extent::new(64, 64)?)?;
            let far = |at: &[f64; 2]| {
                let ray = camera.ray(at[0], at[1]);
                (grid.centre() - ray.origin).cross(ray.direction).length() > radius
            };
            let at: Vec<[f64; 2]> =
                (0..500).map(|i| [1e4 * (unit(i * 2) - 0.5), 1e4 * (unit(i * 2 + 1) - 0.5)]).filter(far).collect();
            of += at.len() as u64;
            let values = lines(&density, kernel, &camera, at)?;
            wrong += values.iter().filter(|v| **v != 0.0).count() as u64;
        }
    }
    Ok(Finding::wrong(wrong, of, "rays"))
}
