//! Light and gradients.

use glam::{DMat3, DVec3};
use mcvr_sampling::{Distribution, GradientSource, RenderOptions, Rendered, VoxelOrder, render_look};
use mcvr_scene::effects::{DepthCue, Effects, Light, LightPosition, Shading, Sides};
use mcvr_scene::{Camera, Density, Estimand, Extent, Kernel, Look, View, Watch};
use mcvr_volume::{Grid, Volume, Voxel};

use super::super::scenes::{Points, bernstein, bytes, cubes, exact_look, filled, identity, made, plain, unit, word};
use super::super::{Bound, CaseError, Context, Finding};
use crate::{Made, Method, Request, Scenery};

/// Shading by a light at a place in the world.
pub(super) fn shaded(at: DVec3, sides: Sides) -> Effects {
    let light = Light { position: LightPosition::World(at.to_array()), ..Light::default() };
    Effects { light, shading: Some(Shading { sides }), ..Effects::default() }
}

fn camera(volume: &Volume, side: usize) -> Result<Camera, CaseError> {
    Ok(Camera::look(&View::default(), volume.grid(), Extent::new(side, side)?)?)
}

/// A shaded `count` image by given points.
fn by_points(
    density: &Density,
    look: &Look,
    points: &Points,
    kernel: Kernel,
    gradients: GradientSource,
) -> Result<Rendered, CaseError> {
    let camera = camera(density.volume(), 8)?;
    let distribution = Distribution::new(density, VoxelOrder::Raster)?;
    let options = RenderOptions { estimand: Estimand::Count, kernel, gradients, ..RenderOptions::default() };
    Ok(render_look(&distribution, points, &camera, look, &options, &Watch::default())?)
}

/// Equal weights have differences of exactly 0, so samples more than a kernel's support and a voxel from the border have no
/// gradient: Lambert's factor is 0 by its stated rule, exactly, whatever the weights' type and size. The same samples without
/// shading show that they are there.
pub(super) fn flat(_: &Context) -> Result<Finding, CaseError> {
    fn wrong<T: Voxel>(weight: T) -> Result<u64, CaseError> {
        let volume = filled(Grid::with_spacing([12; 3], [0.3, 0.7, 1.1])?, |n| vec![weight; n])?;
        let density = identity(&volume)?;
        let total = Distribution::new(&density, VoxelOrder::Raster)?.total();
        let middle = volume.grid().linear([5, 6, 6]) as u64;
        // One of 1728 equal weights: the middle of its part of the whole.
        let target = ((u128::from(total) * u128::from(2 * middle + 1)) / (2 * 1728)) as u64;
        let points = Points((0..500).map(|i| (target, [0, 1, 2].map(|a| (word(3 * i + a) >> 32) as u32))).collect());
        let mut wrong = 0;
        for sides in [Sides::One, Sides::Two] {
            let look = shaded(DVec3::splat(40.0), sides).look(volume.grid(), &camera(&volume, 8)?)?;
            for kernel in Kernel::ALL {
                for gradients in [GradientSource::Lazy, GradientSource::Stored] {
                    let made = by_points(&density, &look, &points, kernel, gradients)?;
                    let black = made.image.values().iter().all(|v| *v == 0.0);
                    wrong += u64::from(!black || made.counters.inside != 500);
                }
            }
        }
        Ok(wrong)
    }
    let all = [
        wrong(7u8)?,
        wrong(-3i16 + 10)?,
        wrong(0.1f32)?,
        wrong(0.1f64)?,
        wrong(1e304f64)?,
        wrong(1e-300f64)?,
        wrong(1e-310f64)?,
    ];
    let naive = DVec3::ZERO.normalize();
    Ok(Finding::wrong(all.iter().sum(), 7 * 16, "images").with(format!("a normal by division is {naive}")))
}

/// Bernstein's inequality (false alarms: 1e-6) on every pixel of shaded `count` images against ray casting, the light exactly at
/// voxels' centres, in density, on a face, and at the corner of eight voxels: a factor lies in 0..=1, so a sample adds at most 1.
/// The definition at the light itself is 0, exactly.
pub(super) fn light_inside(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([4, 4, 3])?;
    let samples = 1 << 16;
    let (mut worst, mut at_light) = (0.0f64, 0.0f64);
    for (n, at) in [[2.0, 2.0, 1.0], [2.25, 1.0, 1.5], [-0.5, 2.0, 1.0], [1.5, 1.5, 1.5]].into_iter().enumerate() {
        let at = DVec3::from_array(at);
        let sides = if n % 2 == 0 { Sides::One } else { Sides::Two };
        let scenery = plain(&volume, camera(&volume, 4)?).with_effects(shaded(at, sides));
        let look = scenery.effects.look(volume.grid(), &scenery.camera)?;
        at_light = at_light.max(look.lambert(sides, at, DVec3::new(1.0, -2.0, 0.5)).abs());
        worst = worst.max(against_rays(&scenery, Kernel::Tent, samples, 1.0)?);
    }
    let worst = if at_light == 0.0 { worst } else { f64::INFINITY };
    Ok(Finding::new(worst, "of the allowed difference", Bound::AtMost(1.0)))
}

/// The worst pixel of independent samples under effects, of factors up to `largest`, over what Bernstein's inequality allows.
fn against_rays(scenery: &Scenery, kernel: Kernel, samples: u64, largest: f64) -> Result<f64, CaseError> {
    let truth = exact_look(scenery, kernel, Estimand::Count, 2e-2)?;
    let request = Request { method: Method::Mc, kernel, estimand: Estimand::Count, samples, ..Request::default() };
    let image = made(scenery, &request)?.image;
    let pixels = truth.channels[0].values().iter().zip(truth.errors[0].image.values()).zip(image.values());
    Ok(pixels.fold(0.0, |worst: f64, ((v, e), made)| {
        let allowed = e + bernstein(samples, largest * (v + e), largest, image.values().len());
        let ratio = (made - v).abs() / allowed;
        if ratio.is_finite() { worst.max(ratio) } else { f64::INFINITY }
    }))
}

/// As for the light inside, for volumes one voxel thick, where every gradient is one across the border.
pub(super) fn thin(_: &Context) -> Result<Finding, CaseError> {
    let mut worst = 0.0f64;
    for (n, dims) in [[1, 1, 1], [1, 6, 5], [7, 1, 4], [1, 1, 9]].into_iter().enumerate() {
        let volume = cubes(dims)?;
        let sides = if n % 2 == 0 { Sides::One } else { Sides::Two };
        let scenery = plain(&volume, camera(&volume, 4)?).with_effects(shaded(DVec3::new(20.0, 12.0, 9.0), sides));
        worst = worst.max(against_rays(&scenery, Kernel::Tent, 1 << 16, 1.0)?);
    }
    Ok(Finding::new(worst, "of the allowed difference", Bound::AtMost(1.0)))
}

/// Normals at `90° ± α` to the light, α from 1e-16 to 1e-3, the gradient of any length: the cosine must be `sin α` to 8 roundings
/// of a sum of products, each at most 1: `8 · 2^-52`. One-sided it is 0 on the far side to the same bound, and both sides of one
/// normal add up to the two-sided factor exactly, so that nothing jumps and no noise decides which side is seen.
pub(super) fn grazing(_: &Context) -> Result<Finding, CaseError> {
    let mut worst = 0.0f64;
    for i in 0..3000u64 {
        let random = |k| DVec3::new(unit(9 * i + k) - 0.5, unit(9 * i + k + 1) - 0.5, unit(9 * i + k + 2) - 0.5);
        let to_light = random(0).normalize();
        let across = to_light.cross(random(3)).normalize();
        let alpha = 10f64.powf(-16.0 + 13.0 * unit(9 * i + 6)) * if i % 2 == 0 { 1.0 } else { -1.0 };
        let length = 10f64.powf(400.0 * unit(9 * i + 7) - 200.0);
        let gradient = -(across + to_light * alpha.tan()) * length;
        let look = Look { light: Some(to_light * 100.0), shading: Some(Sides::One), ..Look::plain() };
        let [one, other] = [gradient, -gradient].map(|g| look.lambert(Sides::One, DVec3::ZERO, g));
        let two = look.lambert(Sides::Two, DVec3::ZERO, gradient);
        let off = (one - alpha.sin().max(0.0)).abs().max((two - alpha.sin().abs()).abs());
        let off = if one + other == two && off.is_finite() { off } else { f64::INFINITY };
        worst = worst.max(off);
    }
    Ok(Finding::new(worst, "of a factor in 0..1", Bound::AtMost(8.0 * f64::EPSILON)))
}

/// Weights times a power of two change no direction: shaded `count` images must stay bit for bit the same when sampled, from
/// 2^-1000 to 2^1000, where squares of gradients under- and overflow. Cast, the image may differ by rounding alone where none
/// is subnormal, so by twice the reference's own error estimate at most. The shaded march integrates in 64 bits: no bit moves.
pub(super) fn scaled_weights(_: &Context) -> Result<Finding, CaseError> {
    let grid = Grid::new([6, 5, 5], DVec3::new(1e-3, 2e-3, 1e-3), DVec3::ZERO, DMat3::IDENTITY)?;
    let scene = |k: i32| -> Result<Scenery, CaseError> {
        let volume = filled(grid.clone(), |n| bytes(n).into_iter().map(|v| f64::from(v) * 2f64.powi(k)).collect())?;
        let camera = camera(&volume, 4)?;
        Ok(plain(&volume, camera).with_effects(shaded(DVec3::new(0.02, 0.01, 0.03), Sides::Two)))
    };
    let request = Request { estimand: Estimand::Count, samples: 1 << 12, ..Request::default() };
    let base = scene(0)?;
    let march = Request { method: Method::March, samples: 64, ..request };
    let marched = made(&base, &march)?.image;
    let (sampled, cast) = (made(&base, &request)?.image, exact_look(&base, Kernel::Tent, Estimand::Count, 5e-3)?);
    let (mut wrong, mut of, mut failed) = (0, 0, vec![]);
    for k in [-1000, -700, -520, 500, 700, 1000] {
        let scene = scene(k)?;
        of += 3;
        if made(&scene, &request)?.image != sampled {
            wrong += 1;
            failed.push(format!("sampled at 2^{k}"));
        }
        if made(&scene, &march)?.image != marched {
            wrong += 1;
            failed.push(format!("marched at 2^{k}"));
        }
        let again = exact_look(&scene, Kernel::Tent, Estimand::Count, 5e-3)?;
        let same = again.channels[0].values().iter().zip(cast.channels[0].values()).zip(cast.errors[0].image.values());
        if !same.into_iter().all(|((a, b), e)| (a - b).abs() <= 2.0 * e + 1e-12) {
            wrong += 1;
            failed.push(format!("cast at 2^{k}"));
        }
    }
    Ok(Finding::wrong(wrong, of, "images").with(failed.join(", ")))
}

/// A depth cue's amounts are held in fixed point relative to its largest value, `1 / minimum` where the light is within the
/// volume. Such an image is refused with the minimum that would do, or every pixel agrees with the mean of the cue over the
/// volume: on one pixel that holds all of it, of `M` independent samples, with at most `1 / c₀` each but for the few within `c₀`
/// of the light. The light is in a hollow, so that none is nearer than `c₀ = 2` mm: Bernstein's inequality (false alarms: 1e-6)
/// around the mean of the same samples by the definition, in plain `f64`, which another seed gives.
pub(super) fn tiny_cue(_: &Context) -> Result<Finding, CaseError> {
    let grid = Grid::with_spacing([9; 3], [1.0; 3])?;
    let hollow = filled(grid.clone(), |n| {
        let far = |i: usize| grid.unravel(i).iter().any(|a| a.abs_diff(4) >= 4);
        (0..n).map(|i| u8::from(far(i))).collect()
    })?;
    let density = identity(&hollow)?;
    let samples = 1 << 15;
    // The mean of the cue by a lattice of points in every voxel: its error is that of 64 points a voxel of a function with a
    // second derivative of at most 2 / c³: below 2/8 · (1/4)² / 8 = 2e-3 of 1/mm.
    let centre = DVec3::splat(4.0);
    let mut sum = [0.0; 2];
    for i in 0..grid.len() {
        if density.weight(i) > 0.0 {
            let at = DVec3::from_array(grid.unravel(i).map(|v| v as f64));
            for k in 0..64usize {
                let offset = DVec3::new((k % 4) as f64, (k / 4 % 4) as f64, (k / 16) as f64) * 0.25 - 0.375;
                sum[0] += 1.0 / (at + offset - centre).length();
                sum[1] += 1.0;
            }
        }
    }
    let mean = sum[0] / sum[1];
    let (mut wrong, mut of, mut refused) = (0, 0, vec![]);
    for minimum in [1.0, 1e-3, 1e-6, 1e-9, 1e-12, 1e-15, 1e-100, 1e-300] {
        let light = Light { position: LightPosition::World([4.0; 3]), ..Light::default() };
        let effects = Effects { light, depth_cue: Some(DepthCue { minimum: Some(minimum) }), ..Effects::default() };
        let scenery = plain(&hollow, camera(&hollow, 1)?).with_effects(effects);
        let request = Request {
            method: Method::Mc,
            kernel: Kernel::Box,
            estimand: Estimand::Count,
            samples,
            ..Request::default()
        };
        of += 1;
        match made(&scenery, &request) {
            Ok(made) => {
                let allowed = 2e-3 + bernstein(samples, mean / 2.0, 0.5, 1);
                wrong += u64::from((made.image.get(0, 0) - mean).abs() > allowed || made.image.get(0, 0).is_nan());
            }
            Err(CaseError::Failed(e)) if e.to_string().contains("minimum") => refused.push(format!("{minimum:e}")),
            Err(_) => wrong += 1,
        }
    }
    Ok(Finding::wrong(wrong, of, "images").with(format!("refused: minima of {} mm", refused.join(", "))))
}

/// Intensities up to 1e300 scale the image, each pixel rounded once; one that takes a pixel beyond the range of numbers is
/// refused, and so are negative ones and those that are not finite. No image may hold an infinity or NaN.
pub(super) fn intensity(_: &Context) -> Result<Finding, CaseError> {
    let request = Request { samples: 1 << 12, ..Request::default() };
    let lit = |intensity: f64, scale: f64| -> Result<Made, CaseError> {
        let mut effects = shaded(DVec3::new(20.0, 12.0, 9.0), Sides::Two);
        effects.light.intensity = intensity;
        let grid = Grid::with_spacing([6, 5, 5], [scale; 3])?;
        let volume = filled(grid, bytes)?;
        made(&plain(&volume, camera(&volume, 4)?).with_effects(effects), &request)
    };
    let base = lit(1.0, 1.0)?.image;
    let (mut wrong, mut of) = (0, 0);
    for intensity in [0.0, 1e-300, 0.5, 1e100, 1e300] {
        let image = lit(intensity, 1.0)?.image;
        of += 1;
        let close = |(a, b): (&f64, &f64)| (a - b * intensity).abs() <= 2.0 * f64::EPSILON * (b * intensity).abs();
        wrong += u64::from(!image.values().iter().zip(base.values()).all(close));
    }
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        of += 1;
        wrong += u64::from(!lit(bad, 1.0).is_err_and(|e| says(&e, "intensity")));
    }
    // Voxels of 1e9 mm: optical depths of 1e11.
    of += 1;
    wrong += u64::from(!lit(1e300, 1e9).is_err_and(|e| says(&e, "intensity")));
    Ok(Finding::wrong(wrong, of, "images"))
}

/// Whether an error's text holds a word.
pub(super) fn says(error: &CaseError, word: &str) -> bool {
    matches!(error, CaseError::Failed(e) if e.to_string().contains(word))
}
