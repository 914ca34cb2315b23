//! Both sources against the definition.

use super::*;
use crate::SimdLevel;
use glam::DVec3;
use mcvr_scene::Density;
use mcvr_scene::effects::gradient;
use mcvr_scene::{DensityMap, Emphasis, Transfer};
use mcvr_volume::Voxel;
use mcvr_volume::{Grid, Volume};

fn density<T: Voxel>(voxel: impl Fn(usize) -> T, map: DensityMap) -> Density {
    let grid = Grid::with_spacing([7, 5, 6], [1.0; 3]).unwrap();
    let voxels = (0..grid.len()).map(|i| voxel(i * 7919 % 251)).collect();
    Density::new(&Volume::from_vec(grid, voxels, "test").unwrap(), map).unwrap()
}

/// Every source at every level against the definition, inside, on the border and beyond it.
fn check(d: &Density, scale: f64) {
    let positions: Vec<[f64; 3]> = (0..1000u32)
        .map(|i| {
            let u = |k: u32| f64::from(i.wrapping_mul(0x9e37_79b9).wrapping_mul(k).rotate_left(k)) / 2f64.powi(32);
            [u(1) * 10.5 - 2.0, u(3) * 8.5 - 2.0, u(5) * 9.5 - 2.0]
        })
        .chain([[0.0, 0.0, 0.0], [6.0, 4.0, 5.0], [3.0, 2.0, 2.0], [-1.0, 2.5, 3.5], [-2.0, -2.0, -2.0]])
        .collect();
    let column = |a: usize| positions.iter().map(|p| p[a]).collect::<Vec<_>>();
    let [x, y, z] = [column(0), column(1), column(2)];
    for level in SimdLevel::available() {
        let stored = Stored::new(d, level).unwrap();
        let sources: [(&str, Box<dyn Gradients + '_>); 2] = [("lazy", lazy(d, level)), ("stored", Box::new(stored))];
        for (name, source) in sources {
            let n = positions.len();
            let mut g = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
            let [gx, gy, gz] = &mut g;
            source.fill([&x, &y, &z], [gx, gy, gz]);
            for i in 0..n {
                let exact = gradient(d, DVec3::from_array(positions[i])) * 2.0 * scale;
                let found = DVec3::new(g[0][i], g[1][i], g[2][i]);
                // A place in a cell has 24 bits, a difference at most the largest weight (1 or 250 here).
                let bound = 16.0 * f64::from(f32::EPSILON) * d.report().max_weight * scale;
                assert!((found - exact).length() <= bound, "{name} {level:?} {:?} {found} {exact}", positions[i]);
            }
        }
    }
}

#[test]
fn both_sources_agree_with_the_definition_for_every_way_of_reading() {
    check(&density(|v| v as u8, DensityMap::default()), 1.0);
    check(&density(|v| v as i16 - 100, DensityMap::default()), 1.0);
    let emphasis = DensityMap { emphasis: Some(Emphasis { threshold: 99.0, gain: 3.0 }), ..DensityMap::default() };
    check(&density(|v| v as u8, emphasis), 1.0);
    let map = DensityMap { transfer: Transfer::Linear { slope: 2e-5, intercept: 0.02 }, ..DensityMap::default() };
    let d = density(|v| v as i16 * 10 - 1100, map);
    check(&d, 1.0 / d.report().max_weight);
    let d = density(|v| v as f32 * 1e30, DensityMap::default());
    check(&d, 1.0 / d.report().max_weight);
    let d = density(|v| v as f64 * 1e300, DensityMap::default());
    check(&d, 1.0 / d.report().max_weight);
}

#[test]
fn a_flat_region_has_exactly_no_gradient() {
    let d = density(|_| 0.1f32, DensityMap::default());
    let mut g = [[1.0; 1]; 3];
    let [gx, gy, gz] = &mut g;
    lazy(&d, SimdLevel::detect()).fill([&[2.3], &[1.7], &[2.9]], [gx, gy, gz]);
    assert_eq!(g, [[0.0]; 3]);
}
