//! Single rays against integration by the definitions of density, gradient and look.

use super::*;
use mcvr_scene::effects::{DepthColour, DepthCue, Effects, Light, LightPosition, Material, Shading, Sides, gradient};
use mcvr_scene::{DensityMap, Estimand, Extent, View as Angles};
use mcvr_volume::{Grid, Volume};

/// A turned grid with unequal spacing and noise, a third of it 0.
fn scene(parallel: bool) -> (Density, Camera) {
    let turn = DMat3::from_rotation_z(0.7) * DMat3::from_rotation_x(-0.3);
    let grid = Grid::new([9, 8, 10], DVec3::new(0.7, 1.0, 1.4), DVec3::new(4.0, 5.0, 6.0), turn).unwrap();
    let voxels: Vec<u8> = (0..grid.len()).map(|n| ((n * n * 31 + n * 97) % 251) as u8).collect();
    let voxels = voxels.into_iter().map(|v| if v < 80 { 0 } else { v }).collect::<Vec<u8>>();
    let view = Angles { azimuth: 25.0, elevation: 15.0, parallel, ..Angles::default() };
    let camera = Camera::look(&view, &grid, Extent::new(10, 10).unwrap()).unwrap();
    (Density::new(&Volume::from_vec(grid, voxels, "noise").unwrap(), DensityMap::default()).unwrap(), camera)
}

fn cases() -> Vec<Effects> {
    let light = Light {
        position: LightPosition::Around { azimuth: 70.0, elevation: 40.0, distance: Some(9.0) },
        ..Light::default()
    };
    let none = Effects { light, ..Effects::default() };
    let shading = |sides| Some(Shading { sides });
    let depth_cue = Some(DepthCue { minimum: Some(5.0) });
    let depth_colour = Some(DepthColour::default());
    let colour = "#ff8020".parse().unwrap();
    let materials = vec![Material { name: None, from: Some(100.0), to: Some(180.0), colour, weight: 1.0 }];
    let unlisted = Some(mcvr_scene::effects::Unlisted { weight: 1.0, ..Default::default() });
    let painted = Effects { materials, unlisted, ..none.clone() };
    vec![
        Effects { shading: shading(Sides::One), ..none.clone() },
        Effects { shading: shading(Sides::Two), ..none.clone() },
        Effects { depth_cue, ..none.clone() },
        Effects { shading: shading(Sides::One), depth_cue, ..none.clone() },
        Effects { depth_colour: depth_colour.clone(), ..none },
        painted.clone(),
        Effects { shading: shading(Sides::Two), depth_cue, depth_colour, ..painted },
    ]
}

/// The field by its definition, and the look's factor and colours by theirs.
fn integrand(d: &Density, kernel: Kernel, look: &Look, x: DVec3, depth: f64) -> [f64; 3] {
    let grid = d.volume().grid();
    let index = grid.world_to_index().transform_point3(x);
    let base = index.floor();
    let mut density = [0.0; 3];
    for n in 0..64 {
        let c = [n % 4, n / 4 % 4, n / 16];
        let at: [f64; 3] = std::array::from_fn(|a| base[a] - 1.0 + f64::from(c[a]));
        if (0..3).any(|a| at[a] < 0.0 || at[a] >= grid.dims()[a] as f64) {
            continue;
        }
        let linear = grid.linear(at.map(|v| v as usize));
        let k: f64 = (0..3).map(|a| kernel.density(index[a] - at[a]).unwrap()).product();
        let colour = look.palette.as_ref().map_or([1.0; 3], |p| p.colour(d.volume().isovalue(linear)));
        (0..3).for_each(|c| density[c] += d.weight(linear) * k * colour[c]);
    }
    if density == [0.0; 3] {
        return density;
    }
    let factor = look.factor(x, depth, || gradient(d, index));
    [0, 1, 2].map(|c| density[c] * factor[c])
}

/// Midpoint sums of the definitions along the ray, with n steps over the whole support.
fn brute(d: &Density, camera: &Camera, look: &Look, o: &ReferenceOptions, p: (f64, f64), n: usize) -> [f64; 3] {
    let grid = d.volume().grid();
    let ray = camera.ray(p.0, p.1);
    let centre = (grid.centre() - ray.origin).dot(ray.direction);
    let reach = 0.5 * grid.diameter() + 1.5;
    let from = (centre - reach).max(ray.start);
    let dl = (centre + reach - from) / n as f64;
    let mut sum = [0.0; 3];
    for i in 0..n {
        let x = ray.origin + ray.direction * (from + (i as f64 + 0.5) * dl);
        let depth = camera.project(x).2;
        let v = integrand(d, o.kernel, look, x, depth);
        let w = match o.estimand {
            Estimand::Line => dl,
            Estimand::Count => dl / camera.line_factor(p.0, p.1, depth) / d.mass(),
        };
        (0..3).for_each(|c| sum[c] += w * v[c]);
    }
    sum
}

fn check<const C: usize, const N: usize>(d: &Density, camera: &Camera, look: &Look, o: &ReferenceOptions) {
    let field = LitField::<C, N>::new(d, camera, look, o);
    let at = |p: (f64, f64), tolerance| field.at(p.0, p.1, tolerance, &mut Counters::default());
    let scale = at((5.0, 5.0), f64::INFINITY).0.iter().sum::<f64>() / C as f64;
    for p in [(5.03, 5.11), (4.31, 5.77), (6.2, 3.9)] {
        let (exact, error) = at(p, 1e-9 * scale);
        // Midpoint sums are wrong by up to half a step at each jump. For box that is some thirty jumps of up to ten
        // times the mean integrand: about 16 steps of those that lie inside, so a few 1e-4 of the whole.
        let (n, tolerance) = if o.kernel == Kernel::Box { (40_000, 3e-3) } else { (6000, 2e-5) };
        let slow = brute(d, camera, look, o, p, n);
        for c in 0..C {
            assert!((exact[c] - slow[c]).abs() < tolerance * scale, "{o:?} {p:?} {look:?}: {exact:?} {slow:?}");
            assert!(error[c] <= 1e-9 * scale, "{o:?} {p:?} {look:?}: {error:?} of {scale}");
        }
        for share in [1e-1, 1e-2, 1e-3, 1e-5] {
            let (rough, estimate) = at(p, share * scale);
            for c in 0..C {
                assert!(
                    (rough[c] - exact[c]).abs() <= estimate[c] + 1e-9 * scale && estimate[c] <= share * scale,
                    "{o:?} {share}: {rough:?} {exact:?} {estimate:?}"
                );
            }
        }
    }
}

#[test]
fn rays_agree_with_the_definitions_and_know_their_error() {
    for parallel in [false, true] {
        let (d, camera) = scene(parallel);
        for effects in cases() {
            let look = effects.look(d.volume().grid(), &camera).unwrap();
            for estimand in Estimand::ALL {
                for kernel in [Kernel::Box, Kernel::Tent, Kernel::Bspline3] {
                    let o = ReferenceOptions { estimand, kernel, ..ReferenceOptions::default() };
                    match (look.channels(), kernel) {
                        (3, Kernel::Bspline3) => check::<3, 10>(&d, &camera, &look, &o),
                        (3, _) => check::<3, 4>(&d, &camera, &look, &o),
                        (_, Kernel::Bspline3) => check::<1, 10>(&d, &camera, &look, &o),
                        _ => check::<1, 4>(&d, &camera, &look, &o),
                    }
                }
            }
        }
    }
}
