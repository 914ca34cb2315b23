//! Single rays and pixels against integration by the field's definition.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use common::*;
use mcvr_raycast::{Counters, Integrator};
use mcvr_scene::{Camera, Density, Estimand, Kernel};

/// `∫ ρ dl` or `(1/F) ∫ ρ / line_factor dl` through one image point, midpoint rule of `n` steps over the support.
fn brute(density: &Density, camera: &Camera, kernel: Kernel, estimand: Estimand, px: f64, py: f64, n: usize) -> f64 {
    let grid = density.volume().grid();
    let to_index = grid.world_to_index();
    let ray = camera.ray(px, py);
    let centre = (grid.centre() - ray.origin).dot(ray.direction);
    let reach = grid.diameter() * 0.5 + 2.0 * grid.spacing().length();
    let from = (centre - reach).max(ray.start);
    let dl = (centre + reach - from) / n as f64;
    let rate = camera.depth_rate(px, py);
    let mut sum = 0.0;
    for i in 0..n {
        let l = from + (i as f64 + 0.5) * dl;
        let rho = field(density, kernel, to_index.transform_point3(ray.origin + ray.direction * l));
        sum += match estimand {
            Estimand::Line => rho,
            Estimand::Count => rho / camera.line_factor(px, py, l * rate) / density.mass(),
        };
    }
    sum * dl
}

#[test]
fn rays_agree_with_the_definition_of_the_field() {
    let dims = [4, 5, 3];
    for grid in [plain_grid(dims), skewed_grid(dims)] {
        let d = density(grid.clone(), noise(grid.len()));
        for kernel in KERNELS {
            // The midpoint rule converges as the step for box (jumps), squared for the others.
            let tolerance = if kernel == Kernel::Box { 3e-3 } else { 1e-6 };
            for estimand in Estimand::ALL {
                for parallel in [false, true] {
                    let camera = look(&grid, 25.0, 15.0, parallel, 10);
                    let field = Integrator::new(&d, kernel).unwrap();
                    let rays = field.view(&camera, estimand);
                    let scale = rays.integrate(5.0, 5.0, &mut Counters::default());
                    for (px, py) in [(5.0, 5.0), (4.31, 5.77), (6.2, 3.9), (3.3, 6.4)] {
                        let exact = rays.integrate(px, py, &mut Counters::default());
                        let slow = brute(&d, &camera, kernel, estimand, px, py, 6000);
                        assert!(
                            (exact - slow).abs() <= tolerance * scale,
                            "{kernel} {estimand} parallel {parallel} at {px},{py}: {exact} {slow}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn pixels_agree_with_the_mean_of_brute_force_rays() {
    let grid = skewed_grid([3, 3, 2]);
    let d = density(grid.clone(), noise(grid.len()));
    let camera = look(&grid, 40.0, 25.0, false, 6);
    for kernel in [Kernel::Tent, Kernel::Bspline3] {
        let r = run(&d, &camera, &options(Estimand::Line, kernel, 1e-5));
        for (x, y) in [(2, 2), (3, 2), (2, 4)] {
            let n = 24;
            let at = |i: usize| (i as f64 + 0.5) / n as f64;
            let mut mean = 0.0;
            for j in 0..n {
                for i in 0..n {
                    let (px, py) = (x as f64 + at(i), y as f64 + at(j));
                    mean += brute(&d, &camera, kernel, Estimand::Line, px, py, 300) / (n * n) as f64;
                }
            }
            let exact = r.image.get(x, y);
            assert!((exact - mean).abs() < 4e-4 * r.image.max(), "{kernel} {x},{y}: {exact} {mean}");
        }
    }
}

#[test]
fn every_voxel_type_gives_the_image_of_its_values() {
    let grid = skewed_grid([5, 4, 3]);
    let camera = look(&grid, 40.0, 25.0, false, 8);
    let bytes: Vec<u8> = noise(grid.len()).iter().map(|v| v / 2).collect();
    let o = options(Estimand::Line, Kernel::Tent, 1e-3);
    let expected = run(&density(grid.clone(), bytes.clone()), &camera, &o).image;
    macro_rules! check {
        ($($t:ty)*) => { $({
            let d = density(grid.clone(), bytes.iter().map(|&v| v as $t).collect::<Vec<$t>>());
            assert_eq!(run(&d, &camera, &o).image, expected, stringify!($t));
        })* };
    }
    check!(i8 u16 i16 u32 i32 f32 f64);
}
