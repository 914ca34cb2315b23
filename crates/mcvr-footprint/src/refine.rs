//! A tent as a sum of narrower tents: exact, and what makes the parts of a voxel about cubic.

use mcvr_volume::Grid;

use crate::{FootprintOptions, Refine};

/// Parts along each axis.
pub(crate) type Parts = [u32; 3];

/// One of the narrower tents: its place in units of voxels from the voxel's centre, and its share of the mass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Tap {
    pub at: [f32; 3],
    pub share: f32,
}

/// As many parts along each axis as the options say.
pub(crate) fn parts(grid: &Grid, options: &FootprintOptions) -> Parts {
    let n = match options.refine {
        Refine::Each(n) => return [n; 3],
        Refine::Cubic(n) => f64::from(n),
    };
    let spacing = grid.spacing();
    let limit = f64::from(FootprintOptions::REFINE_LIMIT);
    spacing.to_array().map(|h| (n * h / spacing.min_element() - SLACK).ceil().clamp(1.0, limit) as u32)
}

/// How much longer than the shortest a side may be without being refined.
const SLACK: f64 = 0.05;

/// The tents that a voxel's falls into: `2 n - 1` along each axis.
pub(crate) fn taps(parts: Parts) -> Vec<Tap> {
    let along = |n: u32| {
        let n = n as i32;
        (1 - n..n).map(move |d| (d as f32 / n as f32, (n - d.abs()) as f32 / (n * n) as f32))
    };
    let mut all = vec![];
    for (z, wz) in along(parts[2]) {
        for (y, wy) in along(parts[1]) {
            all.extend(along(parts[0]).map(|(x, wx)| Tap { at: [x, y, z], share: wx * wy * wz }));
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Linear interpolation between the narrower tents' centres is the wide tent.
    #[test]
    fn narrow_tents_sum_to_the_wide_one() {
        for n in 1..=FootprintOptions::REFINE_LIMIT {
            let taps = taps([n, 1, 1]);
            assert_eq!(taps.len() as u32, 2 * n - 1);
            let tent = |x: f32| (1.0 - x.abs()).max(0.0);
            for at in -25..=25 {
                let x = at as f32 * 0.047;
                // Each has mass `share` on a width of 1/n.
                let sum: f32 = taps.iter().map(|t| t.share * n as f32 * tent((x - t.at[0]) * n as f32)).sum();
                assert!((sum - tent(x)).abs() < 1e-6, "{n} {x}: {sum}");
            }
        }
    }

    #[test]
    fn parts_are_about_cubic() {
        let parts = |h: [f64; 3]| parts(&Grid::with_spacing([2, 2, 2], h).unwrap(), &FootprintOptions::default());
        assert_eq!(parts([1.0, 1.0, 1.0]), [1, 1, 1]);
        assert_eq!(parts([0.7, 1.0, 1.6]), [1, 2, 3]);
        let options = FootprintOptions { refine: Refine::Cubic(2), ..FootprintOptions::default() };
        assert_eq!(super::parts(&Grid::with_spacing([2, 2, 2], [0.7, 0.7, 1.6]).unwrap(), &options), [2, 2, 5]);
        assert_eq!(parts([1.0, 1.0, 1000.0]), [1, 1, FootprintOptions::REFINE_LIMIT]);
    }
}
