//! Films, tones, photon noise, attenuation.

use mcvr_scene::film::{Curve, Film, ImageFormat, Tone, expose, read, transmission, write_within};
use mcvr_scene::{Density, DensityMap, Extent, Hounsfield, Image, NegativePolicy, Transfer};
use mcvr_volume::{Grid, Volume};

use super::super::scenes::filled;
use super::super::{Bound, CaseError, Context, Finding};

fn image(width: usize, height: usize, value: impl Fn(usize) -> f64) -> Result<Image, CaseError> {
    Ok(Image::from_values(Extent::new(width, height)?, (0..width * height).map(value).collect())?)
}

/// `exp(-0)` is 1 exactly and `exp(-1e4)` 0 exactly, with nothing but falling values in 0..=1 between; and `-ln T` gives the
/// depth back to the rounding of `T`, one unit in the last place, as `2^-52 + 2^-52 |L|` for its own, while `T` is normal
/// (depths up to 708).
pub(super) fn transmission_ends(_: &Context) -> Result<Finding, CaseError> {
    let n = 100_001;
    let depth = |i: usize| i as f64 * 0.1;
    let film = transmission(&image(n, 1, depth)?);
    let ends = film.get(0, 0) == 1.0 && film.get(n - 1, 0) == 0.0;
    let falls = film.values().windows(2).all(|w| (0.0..=1.0).contains(&w[1]) && w[1] <= w[0]);
    let off = |i: usize| (-film.values()[i].ln() - depth(i)).abs() / (f64::EPSILON * (2.0 + depth(i)));
    let worst = (0..7080).map(off).fold(0.0, f64::max);
    let single = (-1e2f32).exp();
    let worst = if ends && falls { worst } else { f64::INFINITY };
    Ok(Finding::new(worst, "of the rounding allowed", Bound::AtMost(1.0))
        .with(format!("exp(-100) in 32 bits: {single:e}")))
}

/// Counts at a mean of `λ = N0 T` have mean and variance `λ` and fourth moment `λ + 3 λ²`; over `n` pixels the mean has variance
/// `λ/n`, the variance `(λ + 2 λ²)/n`. Six standard deviations of 12 normal figures: false alarms below 3e-8. At means below
/// 30/n the variance's figure is not normal and is left out. Every count is a whole number of photons; those of `N0 = 1` are exactly
/// representable, at 1e12 the quotient rounds once.
pub(super) fn photon_moments(_: &Context) -> Result<Finding, CaseError> {
    let (side, mut worst) = (150usize, 0.0f64);
    let n = (side * side) as f64;
    for (share, photons) in [(1.0, 1.0), (0.5, 1.0), (0.01, 1.0), (1.0, 1e12), (0.3, 1e12), (1e-9, 1e12)] {
        let film = expose(&image(side, side, |_| share)?, photons, 77)?;
        let lambda = share * photons;
        let counts: Vec<f64> = film.values().iter().map(|v| v * photons).collect();
        let whole = counts.iter().all(|c| *c >= 0.0 && (c - c.round()).abs() <= f64::EPSILON * c);
        let mean = counts.iter().map(|c| c - lambda).sum::<f64>() / n;
        let variance = counts.iter().map(|c| (c - lambda - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let z_mean = mean / (lambda / n).sqrt();
        let z_variance = (variance - lambda) / ((lambda + 2.0 * lambda * lambda) / n).sqrt();
        for z in [z_mean, z_variance] {
            worst = if whole && z.is_finite() { worst.max(z.abs()) } else { f64::INFINITY };
        }
    }
    Ok(Finding::new(worst, "standard deviations", Bound::AtMost(6.0)))
}

/// Exact: numbers of photons outside 1..=1e15 are refused with those limits, and so are pixels that are no share in 0..=1. Pixels
/// that transmit exactly 0 count nothing at any number of photons.
pub(super) fn photons_refused(_: &Context) -> Result<Finding, CaseError> {
    let (mut wrong, mut of) = (0, 0);
    let flat = image(3, 2, |_| 0.5)?;
    for photons in [0.0, -0.0, 0.999, -1.0, 1.1e15, 1e300, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let says = |e: mcvr_scene::SceneError| e.to_string().contains("between 1 and 1e15");
        let film = Film { photons: Some(photons), ..Film::default() };
        of += 2;
        wrong += u64::from(!expose(&flat, photons, 1).is_err_and(says));
        wrong += u64::from(!film.develop(&flat, 1).is_err_and(says));
    }
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1e-300, 1.0 + f64::EPSILON] {
        let one = image(3, 2, |i| if i == 4 { bad } else { 0.5 })?;
        of += 1;
        wrong += u64::from(!expose(&one, 10.0, 1).is_err_and(|e| e.to_string().contains("pixel 1,1")));
    }
    for photons in [1.0, 1e12, Film::MAX_PHOTONS] {
        of += 1;
        wrong += u64::from(expose(&image(64, 4, |_| 0.0)?, photons, 1)?.values().iter().any(|v| *v != 0.0));
    }
    Ok(Finding::wrong(wrong, of, "films"))
}

/// Exact: the same counts on 1, 2, 3 and 16 threads, and other counts for another seed.
pub(super) fn photon_threads(_: &Context) -> Result<Finding, CaseError> {
    let line = image(61, 47, |i| i as f64 * 3e-3)?;
    let film = Film { photons: Some(1e4), ..Film::default() };
    let on = |threads: usize, seed| -> Result<Image, CaseError> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        Ok(pool.install(|| film.develop(&line, seed))?)
    };
    let (first, mut wrong) = (on(1, 9)?, 0);
    for threads in [2, 3, 16] {
        let other = on(threads, 9)?;
        wrong += first.values().iter().zip(other.values()).filter(|(a, b)| a.to_bits() != b.to_bits()).count() as u64;
    }
    let repeated = first.values().iter().zip(on(1, 10)?.values()).filter(|(a, b)| a == b).count();
    // Counts of a mean above 1.8 agree with probability at most 0.3 each: all of 2867 never.
    wrong += u64::from(repeated == first.values().len());
    Ok(Finding::wrong(wrong, 3 * 61 * 47, "pixels"))
}

/// Exact: every grey lies in 0..=1, for images that are constant (0, positive, negative, 1e300, the smallest number), all 0 but
/// for one pixel, hold infinities or NaN, or span the whole range of numbers. A flat image is at the start of the curve: black,
/// and white when inverted.
pub(super) fn tones(_: &Context) -> Result<Finding, CaseError> {
    let (mut wrong, mut of, mut failed) = (0, 0, vec![]);
    let flat = [0.0, 5.0, 0.1, -3.0, 1e300, 5e-324, f64::MAX, -f64::MAX];
    let mut images: Vec<(String, Image)> = vec![];
    for v in flat {
        images.push((format!("flat {v:e}"), image(5, 4, |_| v)?));
        images.push((format!("one of 0 in {v:e}"), image(50, 40, |i| if i == 7 { 0.0 } else { v })?));
        images.push((format!("one of {v:e} in 0"), image(50, 40, |i| if i == 7 { v } else { 0.0 })?));
    }
    images.push(("infinities".into(), image(3, 1, |i| [f64::NEG_INFINITY, 1.0, f64::INFINITY][i])?));
    images.push(("NaN".into(), image(3, 1, |i| [f64::NAN, 1.0, 2.0][i])?));
    images.push(("only NaN".into(), image(3, 1, |_| f64::NAN)?));
    images.push(("the whole range".into(), image(3, 1, |i| [f64::MIN, 0.0, f64::MAX][i])?));
    for (name, image) in &images {
        for curve in [Curve::Linear, Curve::Log, Curve::Film] {
            for invert in [false, true] {
                let tone = Tone { curve, invert, ..Tone::default() };
                let grey = tone.apply(image, tone.limits(image));
                let fine = grey.iter().all(|g| (0.0..=1.0).contains(g));
                // The film's curve starts white.
                let start = f64::from(u8::from(invert != (curve == Curve::Film)));
                let flat = !name.starts_with("flat") || grey.iter().all(|g| (g - start).abs() < 1e-15);
                of += 1;
                if !fine || !flat {
                    wrong += 1;
                    failed.push(format!("{name} {curve:?}"));
                }
            }
        }
    }
    failed.dedup();
    Ok(Finding::wrong(wrong, of, "images").with(failed.join(", ")))
}

/// Exact: PNG of values beyond the limits of its tone holds black and white, of 8 and of 16 bits; NaN is black.
pub(super) fn png_beyond(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let values = [-1e300, f64::NEG_INFINITY, -1.0, 0.0, 0.5, 1.0, 1.0000001, 7.0, 1e300, f64::INFINITY, f64::NAN];
    let expected = [0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0];
    let image = image(values.len(), 1, |i| values[i])?;
    let (mut wrong, mut of) = (0, 0);
    for (format, levels) in [(ImageFormat::Png8, 255.0), (ImageFormat::Png16, 65535.0)] {
        let path = folder.path().join(format!("{levels}.png"));
        write_within(&image, &path, format, &Tone::default(), [0.0, 1.0])?;
        for (got, want) in read(&path)?.values().iter().zip(expected) {
            of += 1;
            wrong += u64::from(*got != (want * levels + 0.5f64).floor() / levels);
        }
    }
    Ok(Finding::wrong(wrong, of, "pixels"))
}

/// Hounsfield units of -1024 and below would attenuate less than nothing: they weigh 0, their number and what they drop is
/// stated, and the policy can refuse them. The mass of the rest is exact up to the rounding of a sum of 6 terms; from -1000 on
/// nothing is dropped.
pub(super) fn below_air(_: &Context) -> Result<Finding, CaseError> {
    let isovalues = [-32768i16, -2000, -1024, -1001, -1000, -999, 0, 1000, 3071, 32767];
    let volume: Volume = filled(Grid::with_spacing([isovalues.len(), 1, 1], [1.0; 3])?, |_| isovalues.to_vec())?;
    let (mut wrong, mut of) = (0, 0);
    for hounsfield in
        [Hounsfield::of_water(0.02)?, Hounsfield::at_energy(60.0, 70.0)?, Hounsfield::at_energy(500.0, 40.0)?]
    {
        let map = DensityMap { transfer: Transfer::Hounsfield(hounsfield), ..DensityMap::default() };
        let density = Density::new(&volume, map.clone())?;
        let report = density.report();
        let raw = isovalues.map(|v| map.raw_weight(f64::from(v)));
        let (kept, dropped): (Vec<f64>, Vec<f64>) = raw.into_iter().partition(|w| *w > 0.0);
        let close = |a: f64, b: f64| (a - b).abs() <= 6.0 * f64::EPSILON * b.abs();
        let checks = [
            report.negative == 4,
            report.positive == 5,
            close(report.weight_sum, kept.iter().sum()),
            close(report.dropped, -dropped.iter().sum::<f64>()),
            (0..5).all(|i| density.weight(i) == 0.0),
            raw.windows(2).all(|w| w[0] < w[1]),
        ];
        let refusing = DensityMap { negative: NegativePolicy::Refuse, ..map };
        let refused = Density::new(&volume, refusing).is_err_and(|e| e.to_string().contains("4 voxels"));
        of += checks.len() as u64 + 1;
        wrong += checks.iter().filter(|c| !**c).count() as u64 + u64::from(!refused);
    }
    Ok(Finding::wrong(wrong, of, "statements"))
}
