//! What adaptive rays expect to leave beside what they leave, on phantoms: where the constants of adaptive rays and of the choice come from.
//!
//! `cargo run --release -p mcvr --example bends`. For eight phantoms and three views, exact rays of 4, 2, 1 and 1/2 pixels' distance: the error
//! of the image, the error that their fourth differences tell (`bend`), and how squared errors fall from one distance to the next (`FALL`).

mod phantoms;

use std::io::Write;

use mcvr::harness::Comparison;
use mcvr::raycast::{AdaptiveOptions, cast_adaptive_rays};
use mcvr::scene::{Camera, Density, DensityMap, Extent, View, Watch};
use mcvr::{Method, Request, Scenery, make_of};
use phantoms::{PHANTOMS, VIEWS};

fn quartiles(values: &mut [f64]) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    [0.25, 0.5, 0.75].map(|share| values[((values.len() - 1) as f64 * share).round() as usize])
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut told, mut falls) = (vec![vec![]; 3], vec![vec![]; 3]);
    let mut out = std::io::stdout().lock();
    for input in PHANTOMS {
        let volume = mcvr::volume::load(input, None)?.volume;
        let density = Density::new(&volume, DensityMap::default())?;
        for [azimuth, elevation] in VIEWS {
            let view = View { azimuth, elevation, ..View::default() };
            let camera = Camera::look(&view, volume.grid(), Extent::new(400, 400)?)?;
            let scenery = Scenery::new(volume.clone(), DensityMap::default(), camera.clone());
            let rays = |samples: u64| {
                let request = Request { method: Method::Rays, samples, ..Request::default() };
                make_of(&density, &scenery, &request, &Watch::default())
            };
            let pixels = camera.extent().pixels() as u64;
            let truth = rays(64 * pixels)?.image;
            let mut errors = [0.0; 4];
            for (error, samples) in errors.iter_mut().zip([pixels / 16, pixels / 4, pixels, 4 * pixels]) {
                *error = Comparison::of(&rays(samples)?.image, &truth)?.rel_rmse.unwrap_or(f64::NAN);
            }
            write!(out, "{input:<28} {azimuth:>4},{elevation:<4}")?;
            for (n, coarsest) in [4, 2, 1].into_iter().enumerate() {
                let options = AdaptiveOptions { left: 1e9, coarsest, ..AdaptiveOptions::default() };
                let expected = cast_adaptive_rays(&density, &camera, &options, &Watch::default())?.expected;
                told[n].push(expected / errors[n]);
                falls[n].push((errors[n + 1] / errors[n]).powi(2));
                write!(out, "  {:.4} told {:.4}", errors[n], expected)?;
            }
            writeln!(out, "  {:.5}", errors[3])?;
        }
    }
    for (n, pitch) in [4, 2, 1].into_iter().enumerate() {
        let (told, falls) = (quartiles(&mut told[n]), quartiles(&mut falls[n]));
        let [first, half, last] = falls.map(|fall| 1.0 / fall);
        writeln!(
            out,
            "{pitch} pixels: told over true {:.2} [{:.2} {:.2}], squares fall to 1/{half:.1} [1/{first:.1} 1/{last:.1}]",
            told[1], told[0], told[2]
        )?;
    }
    Ok(())
}
