//! Models of a run's times: what each method's work grows with.

use super::model::{CostModel, Timing, fit};
use super::summary::{CostSummary, MethodInfo};

impl CostSummary {
    pub(super) fn find_models(&self) -> Vec<CostModel> {
        let mut models = Vec::new();
        for method in &self.methods {
            // The rays of an exact caster are decided by its tolerance and by the image: no linear law.
            if method.budget_unit == "1/tolerance" {
                continue;
            }
            for &threads in &self.meta.threads {
                for clock in ["prepare", "view"] {
                    models.extend(self.model(method, threads, clock));
                }
            }
        }
        models
    }

    fn model(&self, method: &MethodInfo, threads: usize, clock: &str) -> Option<CostModel> {
        let names: &[&str] = match (method.continuous, clock) {
            (true, "prepare") if method.name.ends_with("cloud") => &["volume", "voxel", "sample"],
            (true, "prepare") => &["volume", "voxel"],
            (true, _) => &["image", "sample", "pixel", "brick"],
            (false, "prepare") => &["volume", "voxel"],
            (false, _) => &["image", "ray", "ray and voxel along an edge"],
        };
        let timings: Vec<Timing> = self
            .subjects
            .iter()
            .flat_map(|s| self.points_of(s, threads, &method.name).map(move |p| (s, p)))
            .map(|(s, p)| {
                let (budget, voxels) = (p.budget as f64, s.voxels as f64);
                let value = |name: &&str| match *name {
                    "sample" | "ray" => budget,
                    "pixel" => s.pixels as f64,
                    "voxel" => voxels,
                    "brick" => bricks_unpacked(voxels, budget),
                    "ray and voxel along an edge" => budget * voxels.cbrt(),
                    _ => 1.0,
                };
                let seconds = if clock == "prepare" { p.prepare.median } else { p.view.median };
                Timing { terms: names.iter().map(value).collect(), seconds }
            })
            .collect();
        // A preparation that is no more than a look at the clock has no law.
        if timings.iter().all(|t| t.seconds < 1e-5) {
            return None;
        }
        let kept = telling(&timings);
        let reduced: Vec<Timing> = timings
            .iter()
            .map(|t| Timing { terms: kept.iter().map(|&i| t.terms[i]).collect(), seconds: t.seconds })
            .collect();
        let fitted = fit(&reduced)?;
        let n = fitted.residuals.len();
        let terms = kept.iter().zip(&fitted.coefficients).filter(|(_, c)| **c > 0.0);
        Some(CostModel {
            method: method.name.clone(),
            clock: clock.to_owned(),
            threads,
            terms: terms.map(|(&i, &c)| (names[i].to_owned(), c)).collect(),
            timings: n,
            rms_residual: (fitted.residuals.iter().map(|r| r * r).sum::<f64>() / n as f64).sqrt(),
            worst_residual: fitted.residuals.into_iter().max_by(|a, b| a.abs().total_cmp(&b.abs()))?,
        })
    }
}

/// Voxels of a brick, which is unpacked as a whole when a sample falls into it.
const BRICK: f64 = 256.0;

/// Bricks into which at least one of so many samples falls, if all bricks weigh the same.
fn bricks_unpacked(voxels: f64, samples: f64) -> f64 {
    let bricks = voxels / BRICK;
    -bricks * (-samples / bricks).exp_m1()
}

/// Terms that the timings can tell from the ones before: the constant, and what varies otherwise than those.
fn telling(timings: &[Timing]) -> Vec<usize> {
    let width = timings.first().map_or(0, |t| t.terms.len());
    let mut kept: Vec<usize> = Vec::new();
    for i in 0..width {
        let steady = |ratio: &dyn Fn(&Timing) -> f64| {
            let (low, high) =
                timings.iter().map(ratio).fold((f64::INFINITY, 0.0f64), |(low, high), r| (low.min(r), high.max(r)));
            high <= 1.5 * low
        };
        if kept.iter().all(|&k| !steady(&|t: &Timing| t.terms[i] / t.terms[k])) {
            kept.push(i);
        }
    }
    kept
}
