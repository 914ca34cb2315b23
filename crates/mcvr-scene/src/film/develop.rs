//! From optical depths to the film of a radiograph: transmission, photon noise, and the bias that a noisy estimate
//! leaves on it.

use mcvr_volume::Grid;
use rand::SeedableRng;
use rand_distr::{Distribution, Poisson};
use rand_pcg::Pcg64Dxsm;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Image;
use crate::{Camera, SceneError};

/// What becomes of the line integrals: nothing, or the film of a radiograph.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct Film {
    /// Show the transmission exp(-line), the share of photons that pass: 1 in air, 0 behind lead. Needs estimand line
    /// and weights that are attenuations per mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transmission: Option<bool>,
    /// Photons per pixel that leave the tube, at least 1: every pixel of the transmission becomes a Poisson count over
    /// this number.
    #[schemars(range(min = 1, max = 1e15))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub photons: Option<f64>,
    /// Key of the photon noise; the sampling seed when absent.
    #[serde(alias = "noise_seed", skip_serializing_if = "Option::is_none")]
    pub noise_seed: Option<u64>,
}

impl Film {
    /// Most photons per pixel: counts stay far below the 2^53 up to which every one is a float of its own.
    pub const MAX_PHOTONS: f64 = 1e15;

    /// True when the film shows a transmission, with or without noise.
    pub fn is_transmission(&self) -> bool {
        self.transmission.unwrap_or(self.photons.is_some())
    }

    /// Checks the parameters.
    ///
    /// # Errors
    /// [`SceneError::Film`] with the key, the value and what is accepted.
    pub fn check(&self) -> Result<(), SceneError> {
        if let Some(photons) = self.photons {
            check_photons(photons)?;
            if self.transmission == Some(false) {
                return Err(SceneError::Film(
                    "film.photons and film.transmission = false contradict each other: photons are counted on the \
                     transmission"
                        .into(),
                ));
            }
        }
        if self.noise_seed.is_some() && self.photons.is_none() {
            return Err(SceneError::Film("film.noise-seed means nothing without film.photons".into()));
        }
        Ok(())
    }

    /// The film of an image of optical depths; `seed` keys the noise where the film names no key of its own.
    ///
    /// # Errors
    /// As [`Film::check`] and [`expose`].
    pub fn develop(&self, line: &Image, seed: u64) -> Result<Image, SceneError> {
        self.check()?;
        if !self.is_transmission() {
            return Ok(line.clone());
        }
        match self.photons {
            Some(photons) => expose(&transmission(line), photons, self.noise_seed.unwrap_or(seed)),
            None => Ok(transmission(line)),
        }
    }
}

fn check_photons(photons: f64) -> Result<(), SceneError> {
    if (1.0..=Film::MAX_PHOTONS).contains(&photons) {
        return Ok(());
    }
    Err(SceneError::Film(format!(
        "film.photons must lie between 1 and {:e} a pixel, got {photons}; leave it out for a film without noise",
        Film::MAX_PHOTONS
    )))
}

/// Beer and Lambert: the share `exp(-line)` of photons that pass an optical depth.
pub fn transmission(line: &Image) -> Image {
    let mut out = line.clone();
    out.values_mut().par_iter_mut().for_each(|v| *v = (-*v).exp());
    out
}

/// Photon noise: each pixel of a transmission becomes a Poisson count of mean `photons` times its value, over `photons`.
/// Keyed by (seed, row), so the number of threads changes nothing.
///
/// # Errors
/// [`SceneError::Film`] when `photons` is out of bounds or a pixel is not in 0..=1.
pub fn expose(transmission: &Image, photons: f64, seed: u64) -> Result<Image, SceneError> {
    check_photons(photons)?;
    let width = transmission.extent().width;
    let mut out = transmission.clone();
    out.values_mut().par_chunks_mut(width).enumerate().try_for_each(|(y, row)| {
        let mut rng = row_generator(seed, y as u64);
        row.iter_mut().enumerate().try_for_each(|(x, v)| {
            if !(0.0..=1.0).contains(v) {
                return Err(SceneError::Film(format!("pixel {x},{y} transmits {v}, which is no share in 0..1")));
            }
            // A mean of exactly 0 has no Poisson distribution in the library, but one outcome.
            let mean = *v * photons;
            if mean > 0.0 {
                let count = Poisson::new(mean).map_err(|e| SceneError::Film(format!("pixel {x},{y}: {e}")))?;
                *v = count.sample(&mut rng) / photons;
            }
            Ok(())
        })
    })?;
    Ok(out)
}

/// The generator of a row. The key fills both the state and the increment: plain PCG streams of one state correlate.
fn row_generator(seed: u64, row: u64) -> Pcg64Dxsm {
    // SplitMix64's finaliser (Steele, Lea, Flood 2014).
    let mix = |mut z: u64| {
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    };
    // A tag keeps these streams apart from those that draw samples with the same seed.
    let key = mix(mix(seed ^ 0x7068_6f74_6f6e_7321).wrapping_add(mix(row.wrapping_add(0x9e37_79b9_7f4a_7c15))));
    let mut words = [0u8; 32];
    for (i, word) in words.chunks_exact_mut(8).enumerate() {
        word.copy_from_slice(&mix(key.wrapping_add((i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15))).to_le_bytes());
    }
    Pcg64Dxsm::from_seed(words)
}

/// Bias of a transmission that comes from a noisy line integral, in units of the transmission.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FilmBias {
    /// Contribution of one sample at the volume's centre to its pixel's line integral.
    pub sample_weight: f64,
    /// Mean bias over the image.
    pub mean: f64,
    /// Largest bias of a pixel.
    pub max: f64,
}

/// Estimates the bias `½ Var exp(-line)` of a transmission from `samples` samples of a volume of a mass (METHOD section
/// 2): `exp` is convex, so noise brightens the film on average.
///
/// The variance is that of independent samples, line integral times the weight of a sample at the volume's centre; for
/// stratified and quasi-Monte Carlo samples it is an upper bound, up to how far weights differ from that at the centre.
pub fn transmission_bias(line: &Image, camera: &Camera, grid: &Grid, mass: f64, samples: u64) -> FilmBias {
    let (px, py, z) = camera.project(grid.centre());
    let z = if camera.is_parallel() { z } else { z.max(camera.near()) };
    let sample_weight = mass / samples as f64 * camera.line_factor(px, py, z);
    let bias = |line: f64| 0.5 * line * sample_weight * (-line).exp();
    let mean = line.values().iter().map(|l| bias(*l)).sum::<f64>() / line.values().len() as f64;
    FilmBias { sample_weight, mean, max: line.values().iter().map(|l| bias(*l)).fold(0.0, f64::max) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Extent;

    fn flat(width: usize, height: usize, value: f64) -> Image {
        let extent = Extent::new(width, height).unwrap();
        Image::from_values(extent, vec![value; width * height]).unwrap()
    }

    #[test]
    fn air_passes_everything_and_lead_nothing() {
        let line = Image::from_values(Extent::new(3, 1).unwrap(), vec![0.0, 1e4, 1.0]).unwrap();
        assert_eq!(transmission(&line).values(), [1.0, 0.0, (-1.0f64).exp()]);
        for photons in [1.0, 1e12, Film::MAX_PHOTONS] {
            let film = Film { photons: Some(photons), ..Film::default() }.develop(&line, 3).unwrap();
            assert_eq!(film.get(1, 0), 0.0, "no photon, no count");
            // Six standard deviations.
            assert!((film.get(0, 0) - 1.0).abs() <= 6.0 / photons.sqrt() + f64::EPSILON, "{photons}");
            assert!(film.values().iter().all(|v| *v >= 0.0 && (v * photons).fract() == 0.0 || photons > 1e11));
        }
    }

    #[test]
    fn counts_have_the_mean_and_the_variance_of_a_poisson_distribution() {
        let n = 160_000.0f64;
        for (share, photons) in [(0.5, 1.0), (0.05, 100.0), (1.0, 11.5), (0.3, 100.0), (0.01, 1e6), (0.7, 1e12)] {
            let lambda = share * photons;
            let film = expose(&flat(400, 400, share), photons, 77).unwrap();
            let counts: Vec<f64> = film.values().iter().map(|v| v * photons - lambda).collect();
            let mean = counts.iter().sum::<f64>() / n;
            let variance = counts.iter().map(|c| (c - mean).powi(2)).sum::<f64>() / (n - 1.0);
            // Var(mean) = λ/n; Var(s²) = (μ₄ - λ²)/n with μ₄ = λ + 3λ². Five standard deviations: one run in 10⁶ fails.
            let z_mean = mean / (lambda / n).sqrt();
            let z_variance = (variance - lambda) / ((lambda + 2.0 * lambda * lambda) / n).sqrt();
            assert!(z_mean.abs() < 5.0 && z_variance.abs() < 5.0, "λ = {lambda}: z {z_mean:.2}, {z_variance:.2}");
        }
    }

    #[test]
    fn rows_and_seeds_are_independent() {
        let film = |seed| expose(&flat(20_000, 2, 0.5), 200.0, seed).unwrap();
        let (a, b) = (film(1), film(2));
        let correlate = |x: &[f64], y: &[f64]| {
            let products = x.iter().zip(y).map(|(x, y)| (x - 0.5) * (y - 0.5)).sum::<f64>();
            // The variance of a pixel is 0.5/200; a correlation of n independent pairs has deviation 1/√n.
            products / (x.len() as f64 * 0.0025) * (x.len() as f64).sqrt()
        };
        let (first, second) = a.values().split_at(20_000);
        assert!(correlate(first, second).abs() < 5.0, "rows");
        assert!(correlate(a.values(), b.values()).abs() < 5.0, "seeds");
        assert!(correlate(&first[1..], &first[..19_999]).abs() < 5.0, "neighbours");
    }

    #[test]
    fn threads_do_not_change_a_count() {
        let line = Image::from_values(Extent::new(37, 61).unwrap(), (0..37 * 61).map(|i| i as f64 * 1e-3).collect());
        let (line, film) = (line.unwrap(), Film { photons: Some(1e3), ..Film::default() });
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| film.develop(&line, 9).unwrap())
        };
        assert_eq!(on(1), on(7));
        let other = Film { noise_seed: Some(8), ..film };
        assert_ne!(on(1), other.develop(&line, 9).unwrap());
        assert_eq!(other.develop(&line, 9).unwrap(), other.develop(&line, 10).unwrap());
    }

    #[test]
    fn what_cannot_be_exposed_is_refused_with_the_limits() {
        for photons in [0.0, 0.99, -1.0, 1e16, f64::NAN, f64::INFINITY] {
            let message = expose(&flat(2, 2, 0.5), photons, 1).unwrap_err().to_string();
            assert!(message.contains("photons") && message.contains("between 1 and 1e15"), "{message}");
        }
        assert!(expose(&flat(2, 2, 1.5), 10.0, 1).is_err() && expose(&flat(2, 2, f64::NAN), 10.0, 1).is_err());
        let contradictory = Film { transmission: Some(false), photons: Some(10.0), noise_seed: None };
        assert!(contradictory.check().unwrap_err().to_string().contains("film.transmission"));
        let idle = Film { noise_seed: Some(1), ..Film::default() };
        assert!(idle.check().unwrap_err().to_string().contains("film.noise-seed"));
        assert_eq!(Film::default().develop(&flat(2, 2, 7.0), 1).unwrap(), flat(2, 2, 7.0));
    }
}
