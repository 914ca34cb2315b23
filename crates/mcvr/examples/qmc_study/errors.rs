//! Errors without a truth: the spread of independent replicates.

use mcvr::scene::Image;

use crate::bias::Check;
use crate::entrants::entrants;
use crate::records::{Circumstances, Key, Log, Record};
use crate::scans::Scene;
use crate::{Options, Outcome};

/// Images of an error: errors of low-discrepancy points go up and down together over all pixels, so that many are needed.
fn replicates(level: u32) -> usize {
    match level {
        0..=18 => 24,
        19..=22 => 16,
        23..=24 => 8,
        _ => 4,
    }
}

/// Sums over the pixels of what follows from replicates.
pub struct Spread {
    /// Mean over the pixels of the sample variance over the replicates: unbiased for the variance of one image.
    pub variance: f64,
    pub mean: f64,
}

impl Spread {
    /// Of all images but one, if one is named.
    pub fn of(images: &[Image], without: Option<usize>) -> Self {
        let used = || images.iter().enumerate().filter(|(i, _)| Some(*i) != without).map(|(_, image)| image.values());
        let (n, pixels) = (used().count() as f64, images.first().map_or(0, |i| i.values().len()));
        let mut sum = vec![0.0; pixels];
        let mut squares = vec![0.0; pixels];
        used().for_each(|values| sum.iter_mut().zip(values).for_each(|(s, v)| *s += v));
        for values in used() {
            squares.iter_mut().zip(values).zip(&sum).for_each(|((q, v), s)| *q += (v - s / n).powi(2));
        }
        let per = |v: &[f64]| v.iter().sum::<f64>() / pixels as f64;
        Self { variance: per(&squares) / (n - 1.0), mean: per(&sum) / n }
    }

    /// RMSE over the mean pixel.
    pub fn rel_rmse(&self) -> f64 {
        self.variance.sqrt() / self.mean
    }
}

/// Standard error of a figure by leaving out one of n in turn (Quenouille's and Tukey's jackknife).
pub fn jackknife(n: usize, without: impl Fn(usize) -> f64) -> f64 {
    let values: Vec<f64> = (0..n).map(without).collect();
    let mean = values.iter().sum::<f64>() / n as f64;
    ((n as f64 - 1.0) / n as f64 * values.iter().map(|v| (v - mean).powi(2)).sum::<f64>()).sqrt()
}

/// Measures what the log does not hold yet, few samples first.
pub fn measure(options: &Options, scene: &Scene<'_>, log: &mut Log) -> Outcome<()> {
    let entrants = entrants();
    let check = Check::due(options, scene, log.records())?;
    let wanted = |own: &'static [u32]| match &options.levels {
        Some(levels) if !own.is_empty() => levels.clone(),
        _ => own.to_vec(),
    };
    let mut levels: Vec<u32> = entrants.iter().flat_map(|e| wanted(e.levels(options.quick))).collect();
    levels.sort_unstable();
    levels.dedup();
    for level in levels {
        for entrant in entrants.iter().filter(|e| wanted(e.levels(options.quick)).contains(&level)) {
            let key =
                Key { scan: scene.scan.name.into(), view: scene.view.0.into(), method: entrant.name.into(), level };
            let there = log.records().iter().any(|r| matches!(r, Record::Error { key: k, .. } if *k == key));
            if there || entrant.is_default(scene.depth) {
                continue;
            }
            let start = std::time::Instant::now();
            let number = options.replicates.unwrap_or(replicates(level));
            let images: Vec<Image> =
                (0..number).map(|r| entrant.image(scene, level, entrant.seed(level, r))).collect::<Outcome<_>>()?;
            let spread = Spread::of(&images, None);
            let standard_error = jackknife(number, |r| Spread::of(&images, Some(r)).rel_rmse());
            println!(
                "{}, 2^{level}, {}: {:.3} % ± {:.3}, {:.1} s",
                scene.label(),
                entrant.name,
                100.0 * spread.rel_rmse(),
                100.0 * standard_error,
                start.elapsed().as_secs_f64()
            );
            if let Some(check) = check.as_ref().filter(|c| c.level == level) {
                log.append(check.bias(key.clone(), &images))?;
            }
            if !log
                .records()
                .iter()
                .any(|r| matches!(r, Record::Scene { scan, view, .. } if *scan == key.scan && *view == key.view))
            {
                log.append(described(scene, spread.mean))?;
            }
            log.append(Record::Error {
                key,
                replicates: number,
                rel_rmse: spread.rel_rmse(),
                standard_error,
                circumstances: Circumstances::now(options.quick),
            })?;
        }
    }
    Ok(())
}

fn described(scene: &Scene<'_>, mean: f64) -> Record {
    let density = scene.density;
    let drawable = (0..density.volume().grid().len()).filter(|i| density.weight(*i) > 0.0).count() as u64;
    Record::Scene {
        scan: scene.scan.name.into(),
        view: scene.view.0.into(),
        described: scene.scan.described(density),
        angles: scene.view.1,
        depth_axis: scene.depth_axis().into(),
        drawable,
        mean,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr::scene::Extent;

    #[test]
    fn the_spread_is_the_mean_sample_variance() {
        let image = |values: [f64; 2]| Image::from_values(Extent::new(2, 1).unwrap(), values.to_vec()).unwrap();
        let images = [image([1.0, 4.0]), image([3.0, 4.0]), image([5.0, 1.0])];
        let spread = Spread::of(&images, None);
        // Sample variances 4 and 3, means 3 and 3.
        assert!((spread.variance - 3.5).abs() < 1e-12 && (spread.mean - 3.0).abs() < 1e-12);
        let without = Spread::of(&images, Some(2));
        assert!((without.variance - 1.0).abs() < 1e-12 && (without.mean - 3.0).abs() < 1e-12);
        // Of a mean the jackknife gives the usual standard error: s/√n.
        let values = [1.0, 2.0, 6.0];
        let se = jackknife(3, |i| (9.0 - values[i]) / 2.0);
        assert!((se - (7f64 / 3.0).sqrt()).abs() < 1e-12);
    }
}
