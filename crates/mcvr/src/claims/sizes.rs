//! One volume at several sizes.

use mcvr_scene::Effects;
use mcvr_volume::{Grid, Phantom, Volume, VolumeError, checked_voxel_count, with_voxels};
use rayon::prelude::*;

use super::{Bench, ClaimError};
use crate::Scenery;

/// The bench's scene at the sizes that it asks for, in the same place and of the same extent in millimetres, seen by the same
/// camera: a phantom is made anew, any other volume copied with nearest neighbours. In order of size; sizes that memory has no
/// room for are left out and named.
pub(super) fn at_sizes(bench: &Bench<'_>) -> Result<(Vec<Scenery>, Vec<String>), ClaimError> {
    let original = &bench.scenery.volume;
    let bytes = original.voxel_type().bytes() as u64;
    // A quarter is left for distributions and whatever else runs.
    let mut room = bench.options.free_memory.map_or(u64::MAX, |free| free / 4 * 3);
    let (mut all, mut left_out) = (Vec::<Scenery>::new(), vec![]);
    let mut sides = bench.options.sizes.clone();
    sides.sort_unstable();
    for side in sides {
        bench.check_cancelled()?;
        bench.say(&format!("making a volume of {side} voxels along its longest side"));
        let dims = scaled(original.grid().dims(), side);
        let taken = checked_voxel_count(dims)? as u64 * bytes;
        if taken > room {
            left_out.push(format!("{side} (takes {taken} bytes of memory, {room} are free for it)"));
            continue;
        }
        if all.last().is_some_and(|s| s.volume.grid().dims() == dims) {
            continue;
        }
        room -= taken;
        let volume = resized(original, bench.input, dims)?;
        let scenery = bench.scenery.clone();
        all.push(Scenery { volume, effects: Effects::default(), ..scenery });
    }
    Ok((all, left_out))
}

/// Dims in the same proportion, the longest as given.
fn scaled(dims: [usize; 3], side: usize) -> [usize; 3] {
    let longest = dims.into_iter().max().unwrap_or(1) as f64;
    dims.map(|n| ((n as f64 * side as f64 / longest).round() as usize).max(1))
}

fn resized(original: &Volume, input: &str, dims: [usize; 3]) -> Result<Volume, VolumeError> {
    let [x, y, z] = dims;
    let volume = match input.strip_prefix("phantom:") {
        Some(spec) => {
            let name = spec.split('@').next().unwrap_or(spec);
            Phantom::parse(&format!("{name}@{x}x{y}x{z}"))?.generate()?
        }
        None => nearest(original, dims)?.with_rescale(original.slope(), original.intercept())?,
    };
    volume.with_grid(grid(original.grid(), dims)?)
}

/// A grid of other dims between the same borders.
fn grid(original: &Grid, dims: [usize; 3]) -> Result<Grid, VolumeError> {
    let old = original.dims();
    let mut spacing = original.spacing();
    let mut first = glam::DVec3::ZERO;
    for axis in 0..3 {
        let factor = old[axis] as f64 / dims[axis] as f64;
        spacing[axis] *= factor;
        // The first centre lies half a voxel inside the border, in voxels of the original.
        first[axis] = factor / 2.0 - 0.5;
    }
    let origin = original.index_to_world().transform_point3(first);
    Grid::new(dims, spacing, origin, original.direction())
}

fn nearest(original: &Volume, dims: [usize; 3]) -> Result<Volume, VolumeError> {
    let (old, grid) = (original.grid(), Grid::with_spacing(dims, [1.0; 3])?);
    let from = |axis: usize, i: usize| ((i as f64 + 0.5) / dims[axis] as f64 * old.dims()[axis] as f64) as usize;
    let source = |index: usize| {
        let at = grid.unravel(index);
        let inside = |axis: usize| from(axis, at[axis]).min(old.dims()[axis] - 1);
        old.linear([inside(0), inside(1), inside(2)])
    };
    let sources = (0..grid.len()).into_par_iter().map(source);
    with_voxels!(original.voxels(), v => Volume::from_vec(grid.clone(), sources.map(|i| v[i]).collect(), original.name()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_volume_of_another_size_lies_between_the_same_borders_and_shows_the_same() {
        let original = Phantom::parse("ramp@8x4x2").unwrap().generate().unwrap();
        let double = resized(&original, "file.raw", scaled([8, 4, 2], 16)).unwrap();
        assert_eq!(double.grid().dims(), [16, 8, 4]);
        assert!((double.grid().size_mm() - original.grid().size_mm()).length() < 1e-9);
        assert!((double.grid().centre() - original.grid().centre()).length() < 1e-9);
        let row: Vec<f64> = (0..6).map(|i| double.isovalue(i)).collect();
        assert_eq!(row, [0.0, 0.0, 1.0, 1.0, 2.0, 2.0]);
        let phantom = resized(&original, "phantom:ramp@8x4x2", [16, 8, 4]).unwrap();
        assert_eq!(phantom.grid(), double.grid());
        assert_eq!(phantom.isovalue(5), 5.0);
    }
}
