//! Whole images of weights that other numbers than 64-bit ones do not hold.

use mcvr_scene::effects::Shading;
use mcvr_scene::{Camera, DensityMap, Effects, Estimand, Extent, View, Watch, power_of_two};
use mcvr_volume::{Grid, Volume};

use super::{Case, CaseError, Context, Cost, Finding, Group};
use crate::{Method, Request, Scenery, make};

pub(super) const CASES: &[Case] = &[Case {
    name: "images-of-extreme-weights",
    group: Group::Distributions,
    breaks: "32-bit weights in a ray march, or the unit of the sums, overflow to NaN or vanish to black",
    asserts: "weights times 2^-1000 or 2^900 give the same image times that, bit for bit (shaded ray casting: to its tolerance)",
    cost: Cost::Quick,
    measure: extreme_images,
}];

/// Exact: a power of two rounds nothing on the way, and the images' pixels stay in the range of numbers. `count` does not
/// depend on the weights' unit at all. Shaded ray casting chooses its points by an error estimate that is not proportional
/// to the weights; its means may differ by two of its tolerances, each a bound on the RMSE and so on the mean's error.
fn extreme_images(_: &Context) -> Result<Finding, CaseError> {
    let grid = Grid::with_spacing([9, 8, 7], [1.0; 3])?;
    let camera = Camera::look(&View::default(), &grid, Extent::new(12, 12)?)?;
    let weights: Vec<f64> = (0..grid.len()).map(|i| (i * i % 97) as f64 / 7.0).collect();
    let scenery = |e: i32, shaded: bool| -> Result<Scenery, CaseError> {
        let scaled: Vec<f64> = weights.iter().map(|w| w * power_of_two(e)).collect();
        let volume = Volume::from_vec(grid.clone(), scaled, "scaled")?;
        let effects = Effects { shading: shaded.then(Shading::default), ..Effects::default() };
        Ok(Scenery::new(volume, DensityMap::default(), camera.clone()).with_effects(effects))
    };
    let (mut wrong, mut of) = (0, 0);
    for method in [Method::Mc, Method::Stratified, Method::Qmc, Method::March, Method::Exact] {
        for (estimand, shaded) in [(Estimand::Count, false), (Estimand::Line, false), (Estimand::Line, true)] {
            let request = Request { method, estimand, samples: 3000, tolerance: 1e-2, ..Request::default() };
            let image =
                |e| -> Result<_, CaseError> { Ok(make(&scenery(e, shaded)?, &request, &Watch::default())?.image) };
            let plain = image(0)?;
            for e in [-1000, 900] {
                let unit = if estimand == Estimand::Line { power_of_two(e) } else { 1.0 };
                let scaled = image(e)?;
                if method == Method::Exact && shaded {
                    let [a, b] = [&plain, &scaled].map(|i| i.values().iter().sum::<f64>());
                    wrong += u64::from(!(0.0..=2.0 * request.tolerance).contains(&(b / unit / a - 1.0).abs()));
                    of += 1;
                    continue;
                }
                wrong += plain.values().iter().zip(scaled.values()).filter(|(a, b)| **a * unit != **b).count() as u64;
                of += plain.values().len() as u64;
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "pixels"))
}
