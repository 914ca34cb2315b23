//! Control variates: a coarse image that is cheap, and an unbiased correction of what it lacks.
//!
//! The correction is drawn from the positive and from the negative part of the residual, as two images of one Sobol net each with samples in
//! proportion to the parts' masses (the best shares where the error is a part's mass over the root of its samples).

use mcvr::qmc::{Scramble, SobolNet};
use mcvr::raycast::{MarchOptions, RayOptions, cast_rays, march};
use mcvr::sampling::{Distribution, RenderOptions, VoxelOrder, render};
use mcvr::scene::{Camera, Density, Image, Watch};

use crate::baseline::BRICKS;
use crate::clock::processor;
use crate::footprint::Splats;
use crate::nested::{Chain, coarsen, density_of, residual, whole};
use crate::scenes::Scene;
use crate::{Entry, Made, Outcome, Preparation};

/// Coarse grid, by least squares, and its residual.
const SPLIT: &str = "split in two";
/// The same down to the factor 8.
const SPLITS: &str = "split in four";
/// What the residual's points are drawn from.
const DRAW: &str = "residual's distribution";
const DRAWS: &str = "residuals' distributions";
/// Lists of the residual's voxels.
const LISTS: &str = "lists of the residual";
/// Coarse grid alone.
const COARSE: &str = "coarse grid";

/// What [`entries`] has.
pub const FAMILIES: [&str; 5] = ["cv", "cv comb", "multilevel", "cv footprint", "comb difference"];

/// Samples a level of the pilot that shares out the others.
const PILOT: u64 = 1 << 14;

/// A chain ready to draw from.
pub struct Nets<'a> {
    pub chain: &'a Chain,
    /// Distributions of the positive and the negative part of each residual.
    parts: Vec<[Option<Distribution<'a>>; 2]>,
    /// Voxels of both parts of the finest residual.
    lists: [Option<Splats>; 2],
}

fn lists(chain: &Chain) -> [Option<Splats>; 2] {
    let of = |n: usize| chain.residuals.first().and_then(|r| r.parts[n].as_ref()).map(Splats::new);
    [of(0), of(1)]
}

/// How the coarse image is made.
#[derive(Clone, Copy)]
pub enum Base {
    Rays(RayOptions),
    Comb(MarchOptions),
}

impl<'a> Nets<'a> {
    pub fn new(chain: &'a Chain) -> Outcome<Self> {
        let draw = |d: &'a Option<Density>| -> Outcome<Option<Distribution<'a>>> {
            Ok(d.as_ref().map(|d| Distribution::new(d, VoxelOrder::Raster)).transpose()?)
        };
        let mut parts = vec![];
        for r in &chain.residuals {
            let [plus, minus] = &r.parts;
            parts.push([draw(plus)?, draw(minus)?]);
        }
        Ok(Self { chain, parts, lists: lists(chain) })
    }

    /// Adds the image of a level's residual.
    pub fn correct(&self, level: usize, samples: u64, seed: u64, camera: &Camera, image: &mut Image) -> Outcome<u64> {
        let mass = |d: &Option<Distribution<'_>>| d.as_ref().map_or(0.0, Distribution::mass);
        let [plus, minus] = &self.parts[level];
        let all = mass(plus) + mass(minus);
        let mut drawn = 0;
        for (part, sign, key) in [(plus, 1.0, 2 * seed), (minus, -1.0, 2 * seed + 1)] {
            let Some(distribution) = part else { continue };
            let share = ((samples as f64 * distribution.mass() / all).round() as u64).max(1);
            let net = SobolNet::new(share, key, Scramble::default());
            let made = render(distribution, &net, camera, &RenderOptions::default(), &Watch::default())?;
            let scale = sign * self.chain.unit / 8.0;
            for (v, r) in image.values_mut().iter_mut().zip(made.image.values()) {
                *v += scale * r;
            }
            drawn += share;
        }
        Ok(drawn)
    }

    /// The image: the coarse grid `samples.len()` levels up, corrected level by level.
    pub fn image(&self, base: Base, samples: &[u64], seed: u64, camera: &Camera) -> Outcome<Made> {
        let Some(top) = self.chain.coarse.get(samples.len() - 1) else { return Err("too few levels".into()) };
        let Made { mut image, mut work } = cast(top, base, seed, camera)?;
        image.values_mut().iter_mut().for_each(|v| *v *= self.chain.unit);
        for (level, &n) in samples.iter().enumerate() {
            work += self.correct(level, n, seed * 16 + level as u64, camera, &mut image)?;
        }
        Ok(Made { image, work })
    }

    /// Shares of the samples by level: `√(variance / cost)` of a pilot of its own seeds (M. Giles, Operations Research 56, 2008).
    pub fn shares(&self, levels: usize, camera: &Camera) -> Outcome<Vec<f64>> {
        let mut weights = vec![];
        for level in 0..levels {
            let mut pair = [Image::zeros(camera.extent()), Image::zeros(camera.extent())];
            let mut seconds = f64::INFINITY;
            for (n, image) in pair.iter_mut().enumerate() {
                let start = processor();
                self.correct(level, PILOT, 0x5eed + n as u64, camera, image)?;
                seconds = seconds.min(processor() - start);
            }
            let variance: f64 = pair[0].values().iter().zip(pair[1].values()).map(|(a, b)| (a - b).powi(2)).sum();
            weights.push((variance / seconds.max(1e-9)).sqrt());
        }
        let sum: f64 = weights.iter().sum();
        Ok(weights.into_iter().map(|w| w / sum).collect())
    }
}

fn rays(n: u32) -> Base {
    Base::Rays(RayOptions { rays_per_pixel: n * n, average: true, ..RayOptions::default() })
}

fn comb(step: f64, n: u32) -> MarchOptions {
    let rays = RayOptions { average: true, rays_per_pixel: n * n, ..RayOptions::default() };
    MarchOptions { step, random_phase: true, rays }
}

/// What of a chain must be made anew to be timed.
pub fn preparations<'a>(scene: &'a Scene, chain: &'a Chain) -> Vec<Preparation<'a>> {
    let split = move |depth: usize, residuals: bool| -> Outcome<()> {
        let mut fine = whole(&scene.density, scene.unit)?;
        for _ in 0..depth {
            let coarse = coarsen(&fine, true)?;
            if residuals {
                std::hint::black_box(residual(&fine, &coarse)?);
            }
            std::hint::black_box(density_of(coarse.grid.clone(), coarse.weights.clone())?);
            fine = coarse;
        }
        Ok(())
    };
    let draw = move |depth: usize| -> Outcome<()> {
        for d in chain.residuals[..depth].iter().flat_map(|r| &r.parts).flatten() {
            std::hint::black_box(Distribution::new(d, VoxelOrder::Raster)?);
        }
        Ok(())
    };
    vec![
        Preparation { name: COARSE, work: Box::new(move || split(1, false)) },
        Preparation { name: SPLIT, work: Box::new(move || split(1, true)) },
        Preparation { name: SPLITS, work: Box::new(move || split(chain.residuals.len(), true)) },
        Preparation { name: DRAW, work: Box::new(move || draw(1)) },
        Preparation {
            name: LISTS,
            work: Box::new(move || {
                std::hint::black_box(lists(chain));
                Ok(())
            }),
        },
        Preparation { name: DRAWS, work: Box::new(move || draw(chain.residuals.len())) },
    ]
}

/// Cast or combed coarse grid plus footprints of the residual: no noise but the comb's.
fn by_footprints(
    nets: &Nets<'_>,
    lists: &[Option<Splats>; 2],
    base: Base,
    seed: u64,
    camera: &Camera,
) -> Outcome<Made> {
    let Some(coarse) = nets.chain.coarse.first() else { return Err("no coarse grid".into()) };
    let Made { mut image, mut work } = cast(coarse, base, seed, camera)?;
    image.values_mut().iter_mut().for_each(|v| *v *= nets.chain.unit);
    for (list, sign) in lists.iter().zip([1.0, -1.0]) {
        let Some(list) = list else { continue };
        let made = list.image::<4>(camera, crate::footprint::FINE)?;
        let scale = sign * nets.chain.unit / 8.0;
        for (v, r) in image.values_mut().iter_mut().zip(made.image.values()) {
            *v += scale * r;
        }
        work += made.work;
    }
    Ok(Made { image, work })
}

fn cast(density: &Density, base: Base, seed: u64, camera: &Camera) -> Outcome<Made> {
    let watch = Watch::default();
    let made = match base {
        Base::Rays(options) => cast_rays(density, camera, &RayOptions { seed, ..options }, &watch)?,
        Base::Comb(options) => {
            march(density, camera, &MarchOptions { rays: RayOptions { seed, ..options.rays }, ..options }, &watch)?
        }
    };
    Ok(Made { image: made.image, work: made.counters.evaluations })
}

pub fn entries<'a>(scene: &'a Scene, nets: &'a Nets<'a>) -> Outcome<Vec<Entry<'a>>> {
    let camera = &scene.camera;
    let mut all = vec![];
    let bases =
        [("cv", "rays 1x1", rays(1)), ("cv", "rays 2x2", rays(2)), ("cv comb", "comb 2", Base::Comb(comb(2.0, 1)))];
    let bases = bases
        .into_iter()
        .chain([("cv comb", "comb 1", Base::Comb(comb(1.0, 1))), ("cv comb", "comb 4", Base::Comb(comb(4.0, 1)))]);
    for (family, base_name, base) in bases {
        for m in (14..=22).step_by(2) {
            all.push(Entry {
                family,
                setting: format!("{base_name}, 2^{m}"),
                needs: vec![SPLIT, DRAW],
                work: Box::new(move |seed| nets.image(base, &[1 << m], seed, camera)),
            });
        }
    }
    for levels in 2..=nets.chain.residuals.len() {
        let shares = nets.shares(levels, camera)?;
        for m in (14..=22).step_by(2) {
            let samples: Vec<u64> = shares.iter().map(|s| ((s * f64::from(1 << m)) as u64).max(2)).collect();
            all.push(Entry {
                family: "multilevel",
                setting: format!("{levels} residuals, 2^{m}"),
                needs: vec![SPLITS, DRAWS],
                work: Box::new(move |seed| nets.image(rays(1), &samples, seed, camera)),
            });
        }
    }
    for (name, base) in [
        ("rays 1x1", rays(1)),
        ("comb 1x1, step 0.5", Base::Comb(comb(0.5, 1))),
        ("comb 1x1, step 1", Base::Comb(comb(1.0, 1))),
        ("comb 1x1, step 2", Base::Comb(comb(2.0, 1))),
        ("comb 2x2, step 1", Base::Comb(comb(1.0, 2))),
    ] {
        all.push(Entry {
            family: "cv footprint",
            setting: name.into(),
            needs: vec![SPLIT, LISTS],
            work: Box::new(move |seed| by_footprints(nets, &nets.lists, base, seed, camera)),
        });
    }
    for step in [1.0, 2.0, 3.0, 4.0, 8.0] {
        for n in 1..=2 {
            all.push(Entry {
                family: "comb difference",
                setting: format!("{n}x{n}, step {step}"),
                needs: vec![BRICKS, COARSE],
                work: Box::new(move |seed| {
                    let teeth = comb(step, n);
                    let rays = RayOptions { seed, ..teeth.rays };
                    combed_difference(scene, nets.chain, MarchOptions { rays, ..teeth })
                }),
            });
        }
    }
    Ok(all)
}

/// Rays through the coarse grid plus a comb of the fine grid less the same comb, tooth by tooth, of the coarse one.
pub fn combed_difference(scene: &Scene, chain: &Chain, teeth: MarchOptions) -> Outcome<Made> {
    let Some(coarse) = chain.coarse.first() else { return Err("no coarse grid".into()) };
    let (camera, watch) = (&scene.camera, Watch::default());
    let MarchOptions { step, rays, .. } = teeth;
    let options = rays;
    let exact = cast_rays(coarse, camera, &options, &watch)?;
    let fine = march(&scene.density, camera, &teeth, &watch)?;
    // The coarse voxels are twice as wide: half the step is the same distance, and phases are keyed by seed and pixel.
    let same = march(coarse, camera, &MarchOptions { step: 0.5 * step, ..teeth }, &watch)?;
    let mut image = fine.image;
    for ((v, e), c) in image.values_mut().iter_mut().zip(exact.image.values()).zip(same.image.values()) {
        *v += chain.unit * (e - c);
    }
    let work = [exact.counters, fine.counters, same.counters].iter().map(|c| c.evaluations).sum();
    Ok(Made { image, work })
}
