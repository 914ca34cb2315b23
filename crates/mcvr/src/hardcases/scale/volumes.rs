//! Volumes larger than memory should be, and voxels whose index takes more than 32 bits.

use std::collections::HashMap;
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;
use std::time::Duration;

use mcvr_sampling::{Distribution, RenderOptions, VoxelOrder, render};
use mcvr_scene::{Camera, Density, DensityMap, Estimand, Extent, View, Watch};
use mcvr_volume::{RawOptions, VoxelType, load};

use super::program::{Place, start};
use super::{Bound, Case, CaseError, Context, Cost, Finding, MIB, case};

pub(super) const CASES: &[Case] = &[
    case(
        "mapped-volume",
        Cost::Quick,
        "the volume is read into memory, or a CDF of eight bytes a voxel is made of it",
        "128 MiB of voxels: anonymous memory within 1/32 of the volume, the image's sums and 24 MiB",
        |context| mapped(context, [512, 512, 512], Duration::from_secs(60)),
    ),
    case(
        "mapped-volume-4-gib",
        Cost::Large,
        "the volume is read into memory, or a CDF of eight bytes a voxel (32 GiB) is made of it",
        "2048 × 2048 × 1024 voxels: anonymous memory within 1/32 of the volume, the image's sums and 24 MiB",
        |context| mapped(context, [2048, 2048, 1024], Duration::from_secs(300)),
    ),
    case(
        "voxels-beyond-32-bits",
        Cost::Large,
        "an index of 32 bits wraps, and the image shows another place of the scan",
        "2048 × 2048 × 1088 voxels, mass beyond 2^32 only: every target finds its voxel, the image is that of the same voxels alone",
        voxels_beyond,
    ),
];

/// Writes voxels at their places into a file that is otherwise a hole: it takes what is written, not what it is long.
fn sparse(path: &Path, dims: [usize; 3], runs: &[([usize; 3], Vec<u8>)]) -> Result<(), CaseError> {
    let mut file = std::fs::File::create(path)?;
    file.set_len(dims.iter().map(|n| *n as u64).product())?;
    for ([x, y, z], voxels) in runs {
        let at = *x as u64 + dims[0] as u64 * (*y as u64 + dims[1] as u64 * *z as u64);
        file.seek(SeekFrom::Start(at))?;
        file.write_all(voxels)?;
    }
    Ok(())
}

/// A few dense cubes of 16³ voxels, at and beyond the middle and in both far corners.
fn cubes(dims: [usize; 3]) -> Vec<([usize; 3], Vec<u8>)> {
    let far = dims.map(|n| n - 16);
    let corners = [[0, 0, 0], dims.map(|n| n / 2), [far[0], 0, far[2]], far];
    let lines = |c: [usize; 3]| {
        (0..256).map(move |i| ([c[0], c[1] + i % 16, c[2] + i / 16], (0..16).map(|v| 100 + v).collect::<Vec<u8>>()))
    };
    corners.into_iter().flat_map(lines).collect()
}

/// What the program may hold beside the mapped file, from what it is known to hold: 8 bytes for each brick of 256 voxels; for each of
/// 200 × 200 pixels 8 bytes as a shared sum, 8 for each of two workers, 8 as a value and 26 while a PNG is written; and 24 MiB for
/// all that does not grow: the program's own data, three stacks of 2 MiB, 128 KiB of blocks a worker, the allocator's reserve.
/// The same bound is also *enforced*, as a limit to the size of writable memory, which counts untouched pages as well.
fn mapped(context: &Context, dims: [usize; 3], patience: Duration) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    sparse(&place.path("scan.raw"), dims, &cubes(dims)).map_err(|e| match e {
        CaseError::Failed(e) => CaseError::Impossible(format!("no room for a sparse scan: {e}")),
        other => other,
    })?;
    let voxels: u64 = dims.iter().map(|n| *n as u64).product();
    let bound = voxels / 32 + 200 * 200 * (8 + 2 * 8 + 8 + 26) + 24 * MIB;
    let [x, y, z] = dims;
    let dims = format!("{x},{y},{z}");
    let arguments = [
        "render",
        "scan.raw",
        "--dims",
        &dims,
        "--type",
        "u8",
        "--samples",
        "1000000",
        "--size",
        "200x200",
        "--quiet",
        "--threads",
        "2",
        "-o",
        "a.png",
    ];
    let script = format!("ulimit -d {} || exit 77; exec \"$@\"", bound / 1024);
    let ended = start(place.shell(&script, arguments))?.wait(patience)?;
    if ended.code() == Some(77) {
        return Err(CaseError::Impossible("no limit to writable memory here".into()));
    }
    if !ended.status.success() {
        return Err(format!("under a limit of {} MiB: {}", bound / MIB, ended.last_words()).into());
    }
    let detail = format!("{} MiB of voxels, a million samples; the same limit was enforced (ulimit -d)", voxels / MIB);
    Ok(Finding::new(ended.anonymous()?, "bytes", Bound::AtMost(bound as f64)).with(detail))
}

/// Exact: all mass lies in the last 16 of 1088 layers of 2^22 voxels, and the first 1024 layers hold 2^32. Targets that lie at both ends of every voxel's range
/// must find that voxel, by its 64-bit index. Then an image of `count` must be, bit for bit, that of a volume of the occupied
/// layers alone under the same camera: both distributions hold the same weights in the same order, so equal targets find equal
/// voxels; the camera is parallel and looks along z, so that the other z of the alone layers does not show.
fn voxels_beyond(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let (n, deep, layers) = (2048usize, 1088usize, 16usize);
    let lines: Vec<([usize; 3], Vec<u8>)> = (0..4096)
        .map(|i| {
            let at = [(i * 37) % (n - 16), (i * 101) % n, deep - layers + i % layers];
            (at, (0..16u8).map(|v| v % 5).collect())
        })
        .collect();
    // Later lines overwrite earlier ones where they meet, as in the file.
    let weights: HashMap<u64, u8> = lines
        .iter()
        .flat_map(|([x, y, z], voxels)| {
            let first = (x + n * (y + n * z)) as u64;
            voxels.iter().enumerate().map(move |(i, v)| (first + i as u64, *v))
        })
        .collect();
    let (whole, alone) = (folder.path().join("whole.raw"), folder.path().join("alone.raw"));
    sparse(&whole, [n, n, deep], &lines).map_err(|e| match e {
        CaseError::Failed(e) => CaseError::Impossible(format!("no room for a sparse scan: {e}")),
        other => other,
    })?;
    let shifted: Vec<_> = lines.iter().map(|([x, y, z], v)| ([*x, *y, z - (deep - layers)], v.clone())).collect();
    sparse(&alone, [n, n, layers], &shifted)?;
    let open = |path: &Path, dims| -> Result<Density, CaseError> {
        let options = RawOptions { dims: Some(dims), voxel_type: Some(VoxelType::U8), ..RawOptions::default() };
        let volume = load(&path.to_string_lossy(), Some(&options))?.volume;
        Ok(Density::new(&volume, DensityMap::default())?)
    };
    let whole = open(&whole, [n, n, deep])?;
    let distribution = Distribution::new(&whole, VoxelOrder::Raster)?;
    let (mut wrong, mut before) = (0u64, 0u64);
    let mut indices: Vec<(&u64, &u8)> = weights.iter().filter(|(_, w)| **w > 0).collect();
    indices.sort();
    for (index, weight) in &indices {
        let last = before + u64::from(**weight) - 1;
        for target in [before, last] {
            wrong += u64::from(target >= distribution.total() || distribution.voxel_of(target) as u64 != **index);
        }
        before = last + 1;
    }
    wrong += u64::from(before != distribution.total());
    let below = indices.iter().filter(|(i, _)| **i < 1 << 32).count();
    if below > 0 {
        return Err(format!("{below} voxels below 2^32: the case is not posed").into());
    }
    let image = |distribution: &Distribution<'_>| -> Result<Vec<f64>, CaseError> {
        let grid = distribution.density().volume().grid();
        // A span of its own, so that both cameras see the same millimetres.
        let view =
            View { azimuth: 0.0, elevation: 90.0, parallel: true, distance: Some(1e5), fov: Some(1.5), near: None };
        let camera = Camera::look(&view, grid, Extent::new(256, 256)?)?;
        let options = RenderOptions { estimand: Estimand::Count, ..RenderOptions::default() };
        let stream = mcvr_mc::Stratified::new(1 << 20, 3);
        Ok(render(distribution, &stream, &camera, &options, &Watch::default())?.image.values().to_vec())
    };
    let alone = open(&alone, [n, n, layers])?;
    let (a, b) = (image(&distribution)?, image(&Distribution::new(&alone, VoxelOrder::Raster)?)?);
    let apart = a.iter().zip(&b).filter(|(a, b)| a != b).count() as u64;
    let of = 2 * indices.len() as u64 + 1 + a.len() as u64;
    let detail = format!("{} voxels, the first at {}", indices.len(), indices.first().map_or(0, |(i, _)| **i));
    Ok(Finding::wrong(wrong + apart, of, "targets and pixels").with(detail))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sparse_file_takes_what_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        sparse(&path, [64, 64, 64], &[([1, 2, 3], vec![7, 8])]).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(
            (bytes.len(), bytes[1 + 64 * (2 + 64 * 3)], bytes.iter().filter(|b| **b > 0).count()),
            (64 * 64 * 64, 7, 2)
        );
    }
}
