//! Materials, emphasis, depth colours, and the bound of the accumulators.

use mcvr_scene::effects::{Colour, DepthColour, Effects, Material, Unlisted};
use mcvr_scene::{Camera, Density, DensityMap, Emphasis, Estimand, Extent, Kernel, View};
use mcvr_volume::{Grid, Volume};

use super::super::scenes::{cubes, filled, made, plain, unit};
use super::super::{Bound, CaseError, Context, Finding};
use crate::{Method, Request};

fn material(from: Option<f64>, to: Option<f64>, rgb: [f64; 3], weight: f64) -> Result<Material, CaseError> {
    Ok(Material { name: None, from, to, colour: Colour::new(rgb)?, weight })
}

fn camera(volume: &Volume, side: usize) -> Result<Camera, CaseError> {
    Ok(Camera::look(&View::default(), volume.grid(), Extent::new(side, side)?)?)
}

/// A red and a blue material that touch at `b`, and white for the rest: each isovalue around the border, the next number below
/// and above included, has exactly one of the colours, the border itself the upper one's, whatever the boundary.
pub(super) fn touching(_: &Context) -> Result<Finding, CaseError> {
    let (mut wrong, mut of) = (0, 0);
    let volume = cubes([2; 3])?;
    for b in [0.0f64, -0.0, 0.1, 255.0, -1024.0, 1e300, 5e-324, 1.0 / 3.0] {
        let width = f64::max(1.0, b.abs());
        let effects = Effects {
            materials: vec![
                material(Some(b), Some(b + width), [0.0, 0.0, 1.0], 1.0)?,
                material(Some(b - width), Some(b), [1.0, 0.0, 0.0], 1.0)?,
            ],
            ..Effects::default()
        };
        let look = effects.look(volume.grid(), &camera(&volume, 2)?)?;
        let (Some(palette), Some(gains)) = (look.palette, effects.gains()) else { return Err("no palette".into()) };
        let (red, blue, white) = ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0; 3]);
        let (low, high) = (b - width, b + width);
        for (at, colour) in [
            (low.next_down(), white),
            (low, red),
            (b.next_down(), red),
            (b, blue),
            (-b * 0.0 + b, blue),
            (high.next_down(), blue),
            (high, white),
        ] {
            of += 1;
            let gain = if colour == white { 0.0 } else { 1.0 };
            wrong += u64::from(palette.colour(at) != colour || gains.at(at) != gain);
        }
    }
    Ok(Finding::wrong(wrong, of, "isovalues"))
}

/// Materials with gaps and touching borders over 256 isovalues, each with its weight, and the rest: the masses of every part
/// alone add up to that of all together. Weights are multiples of 1/4 and isovalues whole, so every sum is exact.
pub(super) fn gaps(_: &Context) -> Result<Finding, CaseError> {
    let volume =
        filled(Grid::with_spacing([16, 16, 16], [1.0; 3])?, |n| (0..n).map(|i| (i % 256) as u8).collect::<Vec<_>>())?;
    let parts = [(10.0, 20.0, 2.0), (20.0, 21.0, 0.25), (100.0, 100.5, 4.0), (101.0, 255.0, 1.0)];
    let mass = |chosen: &[usize], elsewhere: f64| -> Result<f64, CaseError> {
        let materials = parts.iter().enumerate().map(|(i, (from, to, weight))| {
            material(Some(*from), Some(*to), [1.0; 3], if chosen.contains(&i) { *weight } else { 0.0 })
        });
        let effects = Effects {
            materials: materials.collect::<Result<_, _>>()?,
            unlisted: Some(Unlisted { colour: Colour::WHITE, weight: elsewhere }),
            ..Effects::default()
        };
        Ok(Density::new(&volume, DensityMap { gains: effects.gains(), ..DensityMap::default() })?.mass())
    };
    let whole = mass(&[0, 1, 2, 3], 0.5)?;
    let mut sum = mass(&[], 0.5)?;
    for i in 0..parts.len() {
        sum += mass(&[i], 0.0)?;
    }
    let expected: f64 = (0..256)
        .map(|v| {
            let v = f64::from(v);
            let gain = parts.iter().find(|(from, to, _)| *from <= v && v < *to).map_or(0.5, |p| p.2);
            16.0 * v * gain
        })
        .sum();
    Ok(Finding::new((whole - sum).abs() + (whole - expected).abs(), "of mass", Bound::Exactly(0.0))
        .with(format!("of {whole}")))
}

/// Exact: overlaps (by one number, by containment, by an open end, twice the same), ranges that are empty, reversed or NaN, and
/// weights that are negative or not finite are refused by an error that names the material; touching ones are not.
pub(super) fn overlaps(_: &Context) -> Result<Finding, CaseError> {
    let (mut wrong, mut of) = (0, 0);
    let mut check =
        |a: (Option<f64>, Option<f64>), b: (Option<f64>, Option<f64>), good: bool| -> Result<(), CaseError> {
            for (first, second) in [(a, b), (b, a)] {
                let materials =
                    vec![material(first.0, first.1, [1.0; 3], 1.0)?, material(second.0, second.1, [0.0; 3], 1.0)?];
                let says = Effects { materials, ..Effects::default() }.check().map_err(|e| e.to_string());
                of += 1;
                wrong += u64::from(says.as_ref().map_or_else(|e| good || !e.contains("material"), |()| !good));
            }
            Ok(())
        };
    let ten = Some(10.0);
    check((ten, Some(20.0)), (Some(20.0), Some(30.0)), true)?;
    check((ten, Some(20.0)), (Some(20f64.next_down()), Some(30.0)), false)?;
    check((ten, Some(20.0)), (Some(12.0), Some(13.0)), false)?;
    check((ten, Some(20.0)), (ten, Some(20.0)), false)?;
    check((None, Some(11.0)), (ten, None), false)?;
    check((None, ten), (ten, None), true)?;
    check((None, None), (ten, None), false)?;
    check((Some(-0.0), ten), (Some(-5.0), Some(0.0)), true)?;
    for bad in [(ten, ten), (Some(11.0), ten), (Some(f64::NAN), ten), (ten, Some(f64::NAN))] {
        check(bad, (Some(100.0), Some(101.0)), false)?;
    }
    for weight in [-1.0, f64::NAN, f64::INFINITY] {
        let effects = Effects { materials: vec![material(ten, None, [1.0; 3], weight)?], ..Effects::default() };
        of += 1;
        wrong += u64::from(!effects.check().is_err_and(|e| e.to_string().contains("weight")));
    }
    Ok(Finding::wrong(wrong, of, "scenes"))
}

/// Exact: materials whose weights are all 0, that no voxel has, or that take the weight beyond the range of numbers leave
/// nothing to draw, which is an error that says so.
pub(super) fn weightless(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([4; 3])?;
    let (mut wrong, mut of) = (0, 0);
    for (from, weight, word) in
        [(None, 0.0, "no usable mass"), (Some(1e6), 1.0, "no usable mass"), (None, 1e308, "not finite")]
    {
        let effects = Effects { materials: vec![material(from, None, [1.0; 3], weight)?], ..Effects::default() };
        for method in [Method::Qmc, Method::Exact, Method::March] {
            let scenery = plain(&volume, camera(&volume, 2)?).with_effects(effects.clone());
            let request = Request { method, samples: 100, ..Request::default() };
            of += 1;
            wrong += u64::from(!made(&scenery, &request).is_err_and(|e| super::shading::says(&e, word)));
        }
    }
    Ok(Finding::wrong(wrong, of, "scenes"))
}

/// Exact: emphasis from a threshold that no voxel reaches changes no bit of an image, by any method; one that all reach with a
/// gain of a power of two leaves `count` as it is.
pub(super) fn emphasis(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([7, 6, 5])?;
    let (mut wrong, mut of) = (0, 0);
    for method in [Method::Mc, Method::Stratified, Method::Qmc, Method::March, Method::Exact] {
        for estimand in Estimand::ALL {
            let request = Request { method, estimand, samples: 3001, tolerance: 1e-2, ..Request::default() };
            let with = |emphasis| -> Result<_, CaseError> {
                let mut scenery = plain(&volume, camera(&volume, 6)?);
                scenery.map.emphasis = emphasis;
                Ok(made(&scenery, &request)?.image)
            };
            let base = with(None)?;
            for threshold in [255.0f64.next_up(), 256.0, 1e300] {
                of += 1;
                wrong += u64::from(with(Some(Emphasis { threshold, gain: 7.0 }))? != base);
            }
            if estimand == Estimand::Count && method.samples_volume() {
                of += 1;
                wrong += u64::from(with(Some(Emphasis { threshold: 0.0, gain: 4.0 }))? != base);
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "images"))
}

/// Colours by depth stay between their stops (each component in 0..=1, which the accumulators need) at depths from -1e308 to 1e308
/// and NaN, for ranges from two neighbouring numbers to the whole of them; the ends have the stops' own colours exactly. Ranges
/// that do not rise, or whose width is no number, are refused.
pub(super) fn depth_ends(_: &Context) -> Result<Finding, CaseError> {
    let volume = cubes([3; 3])?;
    let camera = camera(&volume, 2)?;
    let (mut wrong, mut of) = (0, 0);
    let stops = vec![Colour::new([1.0, 0.0, 0.5])?, Colour::new([0.0, 1.0, 0.1])?, Colour::new([0.3, 0.3, 1.0])?];
    for range in
        [[0.0, 1.0], [1.0, 1f64.next_up()], [0.0, 5e-324], [-1e307, 1e307], [-1e308, 1e308], [f64::MIN, f64::MAX]]
    {
        let effects = Effects {
            depth_colour: Some(DepthColour { range: Some(range), stops: Some(stops.clone()) }),
            ..Effects::default()
        };
        let look = match effects.look(volume.grid(), &camera) {
            Ok(look) => look,
            Err(e) => {
                of += 1;
                wrong += u64::from((range[1] - range[0]).is_finite() || !e.to_string().contains("depth-colour.range"));
                continue;
            }
        };
        let Some(ramp) = look.ramp else { return Err("no ramp".into()) };
        let depths =
            [f64::NAN, f64::MIN, -1e300, -1.0, 0.0, 0.25, 0.5, 1.0, 1e300, f64::MAX, f64::INFINITY, f64::NEG_INFINITY];
        for depth in depths.into_iter().chain((0..100).map(|i| range[0] + (range[1] - range[0]) * unit(i))) {
            of += 1;
            wrong += u64::from(!ramp.colour(depth).iter().all(|c| (0.0..=1.0).contains(c)));
        }
        of += 3;
        wrong +=
            u64::from(ramp.colour(range[0]) != stops[0].rgb()) + u64::from(ramp.colour(range[1]) != stops[2].rgb());
        let (near, far) = (ramp.colour(range[0].next_down()), ramp.colour(f64::MAX));
        wrong += u64::from(near != stops[0].rgb() || far != stops[2].rgb());
    }
    for range in [[1.0, 1.0], [2.0, 1.0], [f64::NAN, 1.0], [0.0, f64::INFINITY]] {
        let depth_colour = Some(DepthColour { range: Some(range), stops: None });
        of += 1;
        let says = Effects { depth_colour, ..Effects::default() }.check();
        wrong += u64::from(!says.is_err_and(|e| e.to_string().contains("depth-colour.range")));
    }
    Ok(Finding::wrong(wrong, of, "colours"))
}

/// The largest sums that the accumulators can hold: all of `M` samples in one pixel, each with the largest amount that it can
/// have (a white material, no other factor), which is `2^min(40, 62 - bits of M)`; the sum stays below `2^62 <= 2^63`. At
/// `M = 2^22` it is `2^61`, the largest that any number of samples reaches; the channels must then be 1 exactly.
pub(super) fn accumulators(_: &Context) -> Result<Finding, CaseError> {
    let volume = filled(Grid::with_spacing([3; 3], [1.0; 3])?, |n| vec![9u8; n])?;
    let effects = Effects { materials: vec![material(None, None, [1.0; 3], 1.0)?], ..Effects::default() };
    let scenery = plain(&volume, camera(&volume, 1)?).with_effects(effects);
    let mut worst = 0.0f64;
    for (method, samples) in [(Method::Mc, 1 << 22), (Method::Qmc, 1 << 18), (Method::Stratified, (1 << 17) + 1)] {
        let request = Request { method, samples, kernel: Kernel::Box, estimand: Estimand::Count, ..Request::default() };
        let made = made(&scenery, &request)?;
        for channel in made.colour.iter().flatten().chain([&made.image]) {
            worst = worst.max((channel.get(0, 0) - 1.0).abs());
        }
        worst = if made.colour.is_some() { worst } else { f64::INFINITY };
    }
    Ok(Finding::new(worst, "of 1", Bound::AtMost(2.0 * f64::EPSILON)).with("sums of 2^61"))
}
