//! The gradient of the density as shading sees it: the definition.

use glam::DVec3;

use crate::Density;

/// `∇ρ` at a continuous voxel index, in weight units per mm, in world directions: central differences of the weights at
/// the eight voxels around (weights outside the grid are 0), trilinearly interpolated. Reads 32 different voxels.
///
/// Differences come first, so a region of equal weights has a gradient of exactly zero.
pub fn gradient(density: &Density, index: DVec3) -> DVec3 {
    let grid = density.volume().grid();
    let dims = grid.dims().map(|n| n as i64);
    let base = index.floor();
    let f = index - base;
    let base = [base.x as i64, base.y as i64, base.z as i64];
    let weight = |at: [i64; 3]| {
        let inside = (0..3).all(|a| at[a] >= 0 && at[a] < dims[a]);
        if inside { density.weight(grid.linear(at.map(|v| v as usize))) } else { 0.0 }
    };
    let central = |at: [i64; 3]| {
        DVec3::from_array(std::array::from_fn(|a| {
            let (mut low, mut high) = (at, at);
            low[a] -= 1;
            high[a] += 1;
            0.5 * (weight(high) - weight(low))
        }))
    };
    let corner = |dx: i64, dy: i64, dz: i64| central([base[0] + dx, base[1] + dy, base[2] + dz]);
    let along_x = |dy: i64, dz: i64| {
        let (a, b) = (corner(0, dy, dz), corner(1, dy, dz));
        a + (b - a) * f.x
    };
    let along_y = |dz: i64| {
        let (a, b) = (along_x(0, dz), along_x(1, dz));
        a + (b - a) * f.y
    };
    let (a, b) = (along_y(0), along_y(1));
    // Index differences to world: the transpose of the map from world to index.
    grid.world_to_index().matrix3.transpose() * (a + (b - a) * f.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DensityMap;
    use glam::DMat3;
    use mcvr_volume::{Grid, Volume};

    #[test]
    fn a_ramp_in_world_space_has_its_slope_under_spacing_and_rotation() {
        let direction = DMat3::from_rotation_z(0.7) * DMat3::from_rotation_x(-0.3);
        let grid = Grid::new([9, 8, 7], DVec3::new(0.5, 1.0, 3.0), DVec3::new(4.0, 5.0, 6.0), direction).unwrap();
        let slope = DVec3::new(0.3, -0.7, 0.2);
        let voxels: Vec<f64> = (0..grid.len())
            .map(|i| {
                let [x, y, z] = grid.unravel(i).map(|v| v as f64);
                100.0 + slope.dot(grid.index_to_world().transform_point3(DVec3::new(x, y, z)))
            })
            .collect();
        let volume = Volume::from_vec(grid, voxels, "ramp").unwrap();
        let density = Density::new(&volume, DensityMap::default()).unwrap();
        for at in [DVec3::new(3.2, 4.7, 2.1), DVec3::new(1.0, 1.0, 1.0), DVec3::new(5.9, 2.5, 3.999)] {
            assert!((gradient(&density, at) - slope).length() < 1e-11);
        }
    }

    #[test]
    fn equal_weights_have_exactly_no_gradient() {
        let grid = Grid::with_spacing([6, 6, 6], [0.3, 0.7, 1.1]).unwrap();
        let volume = Volume::from_vec(grid, vec![0.1f32; 216], "flat").unwrap();
        let density = Density::new(&volume, DensityMap::default()).unwrap();
        assert_eq!(gradient(&density, DVec3::new(2.3, 2.71, 2.9)), DVec3::ZERO);
        // Half a voxel from the border the field falls off.
        assert!(gradient(&density, DVec3::new(0.0, 2.5, 2.5)).x > 0.0);
    }
}
