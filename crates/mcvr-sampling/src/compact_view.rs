//! From compact points to pixels. Brick and fraction are folded into the view: a brick has its own shift, all have a smaller matrix.

use std::ops::Range;

use mcvr_scene::Estimand;

use crate::compact::{Compact, Piece};
use crate::project::{CountWeigh, LineWeigh, Lost, Params, Weigh, land};
#[cfg(target_arch = "x86_64")]
use crate::project512::project_words;
use crate::projection::{Precision, Projection};
use crate::real::{Real, Weights};
use mcvr_volume::{SimdLevel, vectorised};

/// Turns compact points into what [`Project`](crate::project::Project) gives.
pub(crate) trait ProjectCompact: Send + Sync {
    /// Points of a range; there are as many pixels.
    fn project(&self, points: &Compact, range: Range<u64>, pixels: &mut [u32], weights: &mut Weights) -> Lost;
}

struct CompactProjector<R, E> {
    /// Its matrix takes fractions of bricks.
    params: Params<R>,
    /// The matrix and the shift for voxels from the grid's first voxel.
    rows: [[f64; 3]; 3],
    shift: [f64; 3],
    step: f64,
    level: SimdLevel,
    kind: std::marker::PhantomData<E>,
}

impl Projection {
    /// The vector code for points in fractions of `step` voxels.
    pub(crate) fn compact_projector(&self, step: f64, estimand: Estimand, level: SimdLevel) -> Box<dyn ProjectCompact> {
        match (self.precision(), estimand) {
            (Precision::F32, Estimand::Count) => self.compact::<f32, CountWeigh>(step, level),
            (Precision::F32, Estimand::Line) => self.compact::<f32, LineWeigh>(step, level),
            (Precision::F64, Estimand::Count) => self.compact::<f64, CountWeigh>(step, level),
            (Precision::F64, Estimand::Line) => self.compact::<f64, LineWeigh>(step, level),
        }
    }

    fn compact<R: Real + 'static, E: Weigh + 'static>(&self, step: f64, level: SimdLevel) -> Box<dyn ProjectCompact> {
        let (rows, shift) = self.for_first_voxel();
        let mut params = self.params::<R>();
        for (to, from) in params.rows.iter_mut().flatten().zip(rows.iter().flatten()) {
            // A product with a power of two: exact.
            *to = R::lit(from * step);
        }
        Box::new(CompactProjector::<R, E> { params, rows, shift, step, level, kind: Default::default() })
    }
}

impl<R: Real, E: Weigh> CompactProjector<R, E> {
    /// The view of a brick whose fraction 0 is at `origin`.
    fn of_brick(&self, origin: [f64; 3]) -> Params<R> {
        let mut params = self.params;
        for r in 0..3 {
            // Points stand in the middle of their cells.
            let [a, b, c] = self.rows[r];
            let [x, y, z] = origin.map(|o| o + 0.5 * self.step);
            params.shift[r] = R::lit(a * x + b * y + (c * z + self.shift[r]));
        }
        params
    }
}

impl<R: Real + 'static, E: Weigh> ProjectCompact for CompactProjector<R, E> {
    fn project(&self, points: &Compact, range: Range<u64>, pixels: &mut [u32], weights: &mut Weights) -> Lost {
        let weights = R::slot(weights);
        weights.resize(if E::LINE { pixels.len() } else { 0 }, R::Fixed::default());
        let (mut pixels, mut weights) = (pixels, &mut weights[..]);
        let mut lost = Lost::default();
        for Piece { origin, words } in points.pieces(range.start, range.end) {
            let params = self.of_brick(origin);
            let n = words[0].len();
            let (these, others) = pixels.split_at_mut(n);
            let (heavy, lighter) = weights.split_at_mut(if E::LINE { n } else { 0 });
            let more = words_of::<R, E>(self.level, &params, words, these, heavy);
            lost.beside += more.beside;
            lost.near += more.near;
            (pixels, weights) = (others, lighter);
        }
        lost
    }
}

/// One brick's points; in 32 bits by explicit instructions where there are any.
fn words_of<R: Real + 'static, E: Weigh>(
    level: SimdLevel,
    params: &Params<R>,
    words: [&[u16]; 3],
    pixels: &mut [u32],
    weights: &mut [R::Fixed],
) -> Lost {
    #[cfg(target_arch = "x86_64")]
    if level == SimdLevel::Avx512
        && let Some((params, weights)) = R::single(params, weights)
    {
        // SAFETY: the level is only ever chosen on processors with AVX-512 F, BW, DQ and VL.
        return unsafe { project_words::<E>(params, words, pixels, weights) };
    }
    compact_batch::<R, E>(level, params, words, pixels, weights)
}

vectorised! {
    fn compact_batch<R: Real, E: Weigh>(
        params: &Params<R>, words: [&[u16]; 3], pixels: &mut [u32], weights: &mut [R::Fixed],
    ) -> Lost = compact_body::<R, E>
}

#[inline(always)]
fn compact_body<R: Real, E: Weigh>(
    p: &Params<R>,
    words: [&[u16]; 3],
    pixels: &mut [u32],
    weights: &mut [R::Fixed],
) -> Lost {
    let n = pixels.len();
    let [x, y, z] = words.map(|s| &s[..n]);
    let weights = if E::LINE { &mut weights[..n] } else { weights };
    let mut lost = Lost::default();
    for i in 0..n {
        let at = [R::from_i32(i32::from(x[i])), R::from_i32(i32::from(y[i])), R::from_i32(i32::from(z[i]))];
        let landed = land::<R, E>(p, at);
        pixels[i] = landed.pixel;
        lost.beside += u32::from(landed.ahead & !landed.inside);
        lost.near += u32::from(!landed.ahead);
        if E::LINE {
            weights[i] = landed.weight;
        }
    }
    lost
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::project::centre_voxel;
    use mcvr_scene::{Camera, Extent, Kernel, View};
    use mcvr_volume::Grid;

    #[test]
    fn every_level_gives_the_same_bits_for_every_estimand_and_precision_and_cut() {
        let grid = Grid::with_spacing([90, 60, 30], [1.0, 1.5, 2.0]).unwrap();
        let view = View { near: Some(210.0), fov: Some(20.0), distance: Some(230.0), ..View::default() };
        let camera = Camera::look(&view, &grid, Extent::new(37, 23).unwrap()).unwrap();
        let axis = |k: usize, n: f32| (0..9001).map(|i| ((i * k) % 9973) as f32 / 9973.0 * n - n / 2.0).collect();
        let positions = [axis(7919, 89.0), axis(31, 59.0), axis(577, 29.0)];
        let points = Compact::of(grid.dims(), centre_voxel(grid.dims()), &positions).unwrap();
        for estimand in Estimand::ALL {
            for precision in [Precision::F32, Precision::F64] {
                let projection = Projection::new(&grid, &camera, Kernel::Tent, 1 << 20, Some(precision)).unwrap();
                let mut first = None;
                for level in SimdLevel::available() {
                    for cut in [9001, 2048, 37] {
                        let projector = projection.compact_projector(points.step(), estimand, level);
                        let mut all = (vec![], vec![], vec![], [0, 0]);
                        for from in (0..9001u64).step_by(cut) {
                            let to = (from + cut as u64).min(9001);
                            let mut pixels = vec![0; (to - from) as usize];
                            let mut weights = Weights::default();
                            let lost = projector.project(&points, from..to, &mut pixels, &mut weights);
                            all.0.extend(pixels);
                            all.1.extend(weights.narrow);
                            all.2.extend(weights.wide);
                            all.3[0] += lost.beside;
                            all.3[1] += lost.near;
                        }
                        assert!(all.3.iter().all(|n| *n > 0) && all.0.iter().any(|p| *p < 37 * 23), "{:?}", all.3);
                        let same = *first.get_or_insert_with(|| all.clone()) == all;
                        assert!(same, "{estimand} {precision:?} {level:?} {cut}");
                    }
                }
            }
        }
    }
}
