//! mcvr's own methods, for comparison.

use mcvr::qmc::{Scramble, SobolNet};
use mcvr::raycast::{MarchOptions, RayOptions, cast_rays, march};
use mcvr::sampling::{Distribution, RenderOptions, VoxelOrder, render};
use mcvr::scene::{Density, Watch};

use crate::scenes::Scene;
use crate::{Entry, Made, Outcome, Preparation};

const STEPS: [f64; 9] = [1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 20.0];

/// Weights looked up, sums made.
pub const WEIGHTS: &str = "weights";
/// Weights and the map of empty bricks.
pub const BRICKS: &str = "weights and bricks";
/// What points are drawn from.
pub const DISTRIBUTION: &str = "distribution";

/// What images are made from.
pub struct Ready<'a> {
    distribution: Distribution<'a>,
}

fn distribution<'a>(scene: &'a Scene, density: &'a Density) -> Outcome<Distribution<'a>> {
    Ok(Distribution::new(density, VoxelOrder::default().resolve(&scene.camera, density.volume().grid()))?)
}

impl<'a> Ready<'a> {
    pub fn new(scene: &'a Scene) -> Outcome<Self> {
        scene.density.occupancy();
        Ok(Self { distribution: distribution(scene, &scene.density)? })
    }
}

pub fn preparations(scene: &Scene) -> Vec<Preparation<'_>> {
    let fresh = || Density::new(scene.density.volume(), scene.density.map().clone());
    vec![
        Preparation { name: WEIGHTS, work: Box::new(move || Ok(fresh().map(drop)?)) },
        Preparation {
            name: BRICKS,
            work: Box::new(move || {
                let copy = Density::new(scene.density.volume(), scene.density.map().clone())?;
                std::hint::black_box(copy.occupancy());
                Ok(())
            }),
        },
        Preparation { name: DISTRIBUTION, work: Box::new(move || distribution(scene, &scene.density).map(drop)) },
    ]
}

pub fn entries<'a>(scene: &'a Scene, ready: &'a Ready<'a>) -> Vec<Entry<'a>> {
    let watch = Watch::default;
    let mut all = vec![];
    for n in 1..=4u32 {
        let options = RayOptions { rays_per_pixel: n * n, average: true, ..RayOptions::default() };
        all.push(Entry {
            family: "rays",
            setting: format!("{n}x{n}"),
            needs: vec![BRICKS],
            work: Box::new(move |seed| {
                let made = cast_rays(&scene.density, &scene.camera, &RayOptions { seed, ..options }, &watch())?;
                Ok(Made { image: made.image, work: made.counters.evaluations })
            }),
        });
        for step in STEPS {
            all.push(marched(scene, "comb", n, step));
        }
        if n < 4 {
            all.push(marched(scene, "march", n, 1.0));
        }
    }
    for m in 16..=24 {
        all.push(Entry {
            family: "qmc",
            setting: format!("2^{m}"),
            needs: vec![WEIGHTS, DISTRIBUTION],
            work: Box::new(move |seed| {
                let net = SobolNet::new(1 << m, seed, Scramble::default());
                let made = render(&ready.distribution, &net, &scene.camera, &RenderOptions::default(), &watch())?;
                Ok(Made { image: made.image, work: made.counters.samples })
            }),
        });
    }
    all
}

fn marched<'a>(scene: &'a Scene, family: &'static str, n: u32, step: f64) -> Entry<'a> {
    let comb = family == "comb";
    let rays = RayOptions { average: comb, rays_per_pixel: n * n, ..RayOptions::default() };
    let options = MarchOptions { step, random_phase: comb, rays };
    Entry {
        family,
        setting: format!("{n}x{n}, step {step}"),
        needs: vec![BRICKS],
        work: Box::new(move |seed| {
            let made = march(
                &scene.density,
                &scene.camera,
                &MarchOptions { rays: RayOptions { seed, ..options.rays }, ..options },
                &Watch::default(),
            )?;
            Ok(Made { image: made.image, work: made.counters.evaluations })
        }),
    }
}
