//! Where the eye is.

use glam::DVec3;
use mcvr_scene::{Camera, Estimand, Extent, Kernel, View};

use super::super::scenes::{
    SEPARABLE, bernstein, cubes, disagreement, exact, filled, identity, largest_amount, lines, made, pinhole, plain,
    rendered, samplers,
};
use super::super::{Bound, CaseError, Context, Finding};
use crate::{Method, Request};

/// Right, down and axis of six pictures of 90 degrees: together they show all directions once.
const FACES: [[DVec3; 3]; 6] = [
    [DVec3::Y, DVec3::Z, DVec3::X],
    [DVec3::NEG_Y, DVec3::Z, DVec3::NEG_X],
    [DVec3::Z, DVec3::X, DVec3::Y],
    [DVec3::NEG_Z, DVec3::X, DVec3::NEG_Y],
    [DVec3::X, DVec3::Y, DVec3::Z],
    [DVec3::NEG_X, DVec3::Y, DVec3::NEG_Z],
];

/// Places for an eye in a volume of 8 voxels a side: a voxel's centre, the middle of a face, an edge and a corner of the
/// volume, a corner between voxels, and a millionth of a diameter inside and outside of a face.
fn places() -> [(&'static str, DVec3); 7] {
    let hair = 1e-6 * 8.0 * 3f64.sqrt();
    [
        ("voxel centre", DVec3::new(3.0, 4.0, 2.0)),
        ("face", DVec3::new(-0.5, 3.25, 4.0)),
        ("edge", DVec3::new(-0.5, 7.5, 4.0)),
        ("corner", DVec3::new(-0.5, -0.5, 7.5)),
        ("voxel corner", DVec3::new(2.5, 3.5, 4.5)),
        ("just inside", DVec3::new(-0.5 + hair, 3.0, 4.0)),
        ("just outside", DVec3::new(-0.5 - hair, 3.0, 4.0)),
    ]
}

/// Six pictures of 90 degrees from one eye share out all directions: every sample is in exactly one of them, but for those with
/// no coordinate farther than the near plane from the eye, 1e-4 voxels. Of `M = 4099` samples in each of 6 methods × 4
/// kernels × 7 places, whose density is at most 255 over a sum above 512, fewer than
/// `688632 · 8e-12 · 255 / 512 = 3e-6` are expected there, and as the sums to a shared border round to 2^-50, as few on it.
pub(super) fn six_faces(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([8; 3])?;
    let extent = Extent::new(16, 16)?;
    let (mut wrong, mut of, mut at) = (0, 0, vec![]);
    for (name, eye) in places() {
        for (n, method) in samplers().enumerate() {
            let kernel = Kernel::ALL[n % Kernel::ALL.len()];
            let request = Request { method, kernel, estimand: Estimand::Count, samples: 4099, ..Request::default() };
            let mut inside = 0;
            for face in FACES {
                let camera = pinhole(eye, face, 8.0, extent, 1e-4)?;
                inside += rendered(&plain(&volume, camera), &request, None)?.counters.inside;
            }
            of += request.samples;
            if inside != request.samples {
                wrong += inside.abs_diff(request.samples);
                at.push(format!("{name} {method} {kernel}: {inside}"));
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "samples in no picture, or in two").with(at.join(", ")))
}

/// Bernstein's inequality (false alarms: 1e-6) on every pixel of a `line` image. A sample adds at most `B`, the mass times the
/// largest line factor at the near plane `n`. Its second moment in a pixel is
/// `F² ∫ (ρ/F) lf² dx = F ∫_p ∫ ρ lf dl dp` as `dx = dp dl / lf`; with `lf = det s / z²`, `dl = s dz`, `s` at most the stretch
/// in the image's corner and `ρ` at most the largest weight, that is at most `F ρ det s² / n`: finite, and growing only as the
/// reciprocal of the near plane. A weight that were not `1/z²`, or unclipped, breaks it.
pub(super) fn in_density(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([8; 3])?;
    let density = identity(&volume)?;
    let (near, extent, samples) = (0.25, Extent::new(4, 4)?, 1 << 16);
    let (mut worst, mut at) = (0.0, "");
    for (n, (name, eye)) in places().into_iter().enumerate() {
        let camera = pinhole(eye, FACES[0], 2.0, extent, near)?;
        let kernel = SEPARABLE[n % 2];
        let scenery = plain(&volume, camera);
        let truth = exact(&scenery, kernel, Estimand::Line, 1e-3)?;
        let request = Request { method: Method::Mc, kernel, samples, cull: false, ..Request::default() };
        let image = made(&scenery, &request)?.image;
        let largest = largest_amount(&scenery.camera, Estimand::Line, density.mass(), near);
        let stretch = 1.0 / scenery.camera.depth_rate(0.0, 0.0);
        let square = density.mass() * density.report().max_weight * scenery.camera.det() * stretch.powi(2) / near;
        let ratio = disagreement(&image, &truth, samples, largest, square);
        if ratio >= worst {
            (worst, at) = (ratio, name);
        }
    }
    Ok(Finding::new(worst, "of the allowed difference", Bound::AtMost(1.0))
        .with(format!("largest with the eye at: {at}")))
}

/// The eye looks along -x from inside a uniform block of 16 voxels under `box`: the near plane cuts the block where
/// `x > eye - near`, which is `(15.5 - eye + near) / 16` of the mass, whatever else the image shows. Of `M` independent
/// samples the reported share differs by Bernstein's `t` at most (false alarms: 1e-6); whole bricks are cut exactly.
pub(super) fn clipped_mass(_: &Context) -> Result<Finding, CaseError> {
    let volume = filled(mcvr_volume::Grid::with_spacing([16; 3], [1.0; 3])?, |n| vec![7u8; n])?;
    let samples = 1 << 17;
    let mut worst = 0.0f64;
    for (eye, near) in [(7.5, 0.125), (7.0, 3.0), (15.5, 15.5), (15.5, 1e-9), (3.25, 3.5)] {
        let camera = pinhole(DVec3::new(eye, 7.0, 8.0), FACES[1], 8.0, Extent::new(16, 16)?, near)?;
        let share = ((15.5 - eye + near) / 16.0).min(1.0);
        for cull in [false, true] {
            let request = Request {
                method: Method::Mc,
                kernel: Kernel::Box,
                estimand: Estimand::Count,
                samples,
                cull,
                ..Request::default()
            };
            let clipped = made(&plain(&volume, camera.clone()), &request)?.clipped;
            worst = worst.max((clipped - share).abs() / bernstein(samples, share * (1.0 - share), 1.0, 10));
        }
    }
    Ok(Finding::new(worst, "of the allowed difference", Bound::AtMost(1.0)))
}

/// From `d = 1e9` diameters a pinhole's rays are parallel but for an angle of at most `1/d`, which over a volume of diameter
/// `D` displaces them by `D/d`; sums of coordinates near `d D` round to 8 units of 2^-53 of that at most, eye and ray each. A
/// `tent` field of weights up to `w` has a slope of at most `√3 w / h`, along a chord of at most `D + 2√3 h`; so line integrals
/// differ by no more than `(D + 2√3 h) √3 w/h · (1/d + 16 · 2^-53 d) D`.
pub(super) fn far_eye(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([16; 3])?;
    let density = identity(&volume)?;
    let (extent, far) = (Extent::new(32, 32)?, 1e9);
    let diameter = volume.grid().diameter();
    let camera = |parallel| {
        let view = View { distance: Some(far * diameter), parallel, ..View::default() };
        Camera::look(&view, volume.grid(), extent)
    };
    let at = || (0..1024).map(|i| [(i % 32) as f64 + 0.5, (i / 32) as f64 + 0.5]);
    let [pinhole, limit] = [camera(false)?, camera(true)?];
    let a = lines(&density, Kernel::Tent, &pinhole, at())?;
    let b = lines(&density, Kernel::Tent, &limit, at())?;
    let off = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let root = 3f64.sqrt();
    let displaced = (1.0 / far + 16.0 * 0.5f64.powi(53) * far) * diameter;
    let bound = (diameter + 2.0 * root) * root * density.report().max_weight * displaced;
    let off = if pinhole.is_parallel() || b.iter().all(|v| *v == 0.0) { f64::NAN } else { off };
    let naive = far * diameter;
    let lost = (naive as f32 + 1.0) - naive as f32;
    Ok(Finding::new(off, "weight x mm", Bound::AtMost(bound))
        .with(format!("in 32 bits, a step of 1 mm at that distance is {lost} mm")))
}

/// Angles of a view and a distance tell the axis: `-(cos e cos a, cos e sin a, sin e)`. However near the eye is to the volume's
/// centre, the camera must look along it, to 8 roundings of unit vectors.
pub(super) fn eye_at_centre(_: &Context) -> Result<Finding, CaseError> {
    let grid = mcvr_volume::Grid::new(
        [9, 7, 5],
        DVec3::new(0.7, 1.0, 1.6),
        DVec3::new(-31.3, 12.7, 55.1),
        glam::DMat3::from_rotation_z(0.3),
    )?;
    let (mut wrong, mut of, mut behind) = (0, 0, 0);
    for distance in [1e-6 * grid.diameter(), 1e-12, 1e-15, 1e-16, 1e-17, 1e-30, 1e-160, 1e-300, f64::MIN_POSITIVE] {
        for n in 0..48 {
            let (azimuth, elevation) = (f64::from(n) * 37.0, f64::from(n % 7) * 25.0 - 75.0);
            let view = View { azimuth, elevation, distance: Some(distance), ..View::default() };
            let (sa, ca) = azimuth.to_radians().sin_cos();
            let (se, ce) = elevation.to_radians().sin_cos();
            of += 1;
            match Camera::look(&view, &grid, Extent::new(8, 8)?) {
                Ok(c) => {
                    let off = (c.axis() + DVec3::new(ce * ca, ce * sa, se)).length();
                    behind += u64::from(off > 1.0);
                    wrong += u64::from(off > 8.0 * f64::EPSILON);
                }
                Err(_) => wrong += 1,
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "cameras").with(format!("{behind} look the other way")))
}
