//! From voxel coordinates and uniforms to pixels: kernel offset, projection, `line` weight. Vectorised.

use mcvr_scene::{Estimand, Kernel};

use crate::offset::{BoxOffset, BsplineOffset, Offset, ShellOffset, TentOffset};
#[cfg(target_arch = "x86_64")]
use crate::project512::project_tent;
use crate::projection::{Precision, Projection};
use crate::real::{Real, Weights};
use mcvr_volume::{SimdLevel, vectorised};

/// Whether samples carry the `line` weight.
pub(crate) trait Weigh: Send + Sync {
    const LINE: bool;
}
pub(crate) struct CountWeigh;
pub(crate) struct LineWeigh;
impl Weigh for CountWeigh {
    const LINE: bool = false;
}
impl Weigh for LineWeigh {
    const LINE: bool = true;
}

/// A camera in voxel coordinates, ready for the vector code.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Params<R> {
    /// Voxel coordinates of the reference point, subtracted as integers.
    pub(crate) centre: [i32; 3],
    pub(crate) rows: [[R; 3]; 3],
    pub(crate) shift: [R; 3],
    pub(crate) near: R,
    pub(crate) width: R,
    pub(crate) height: R,
    pub(crate) stride: i32,
    /// Pixel index of samples that miss the image; the next one counts samples in front of the near plane.
    pub(crate) miss: i32,
    pub(crate) middle: [R; 2],
    /// `|M⁻¹ (px, py, 1)|²` about the middle of the image: 1, x, y, x², xy, y².
    pub(crate) stretch: [R; 6],
    /// Fixed-point factor of the weight.
    pub(crate) scale: R,
    pub(crate) largest: R,
}

/// Samples of one batch that are in no pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Lost {
    /// Beyond the near plane but beside the image.
    pub beside: u32,
    /// In front of the near plane.
    pub near: u32,
}

impl Projection {
    /// The vector code for a kernel and an estimand, as one call per batch.
    pub(crate) fn projector(&self, kernel: Kernel, estimand: Estimand, level: SimdLevel) -> Box<dyn Project> {
        match (self.precision(), estimand) {
            (Precision::F32, Estimand::Count) => self.boxed::<f32, CountWeigh>(kernel, level),
            (Precision::F32, Estimand::Line) => self.boxed::<f32, LineWeigh>(kernel, level),
            (Precision::F64, Estimand::Count) => self.boxed::<f64, CountWeigh>(kernel, level),
            (Precision::F64, Estimand::Line) => self.boxed::<f64, LineWeigh>(kernel, level),
        }
    }

    fn boxed<R: Real + 'static, E: Weigh + 'static>(&self, kernel: Kernel, level: SimdLevel) -> Box<dyn Project> {
        let params = self.params::<R>();
        #[cfg(target_arch = "x86_64")]
        if level == SimdLevel::Avx512 && kernel == Kernel::Tent && !R::DOUBLE {
            return Box::new(Tent512::<E> { params: self.params(), kind: Default::default() });
        }
        match kernel {
            Kernel::Box => Box::new(Projector::<R, BoxOffset, E> { params, level, kind: Default::default() }),
            Kernel::Tent => Box::new(Projector::<R, TentOffset, E> { params, level, kind: Default::default() }),
            Kernel::Bspline3 => Box::new(Projector::<R, BsplineOffset, E> { params, level, kind: Default::default() }),
            Kernel::Shell => Box::new(Projector::<R, ShellOffset, E> { params, level, kind: Default::default() }),
        }
    }
}

/// Turns places and uniforms into pixel indices (`width * height` for a miss, one more in front of the near
/// plane) and, for `line`, fixed-point weights.
pub(crate) trait Project: Send + Sync {
    fn project(
        &self,
        places: &[Vec<u32>; 3],
        uniforms: &[Vec<u32>; 3],
        pixels: &mut [u32],
        weights: &mut Weights,
    ) -> Lost;
}

struct Projector<R, K, E> {
    params: Params<R>,
    level: SimdLevel,
    kind: std::marker::PhantomData<(K, E)>,
}

impl<R: Real, K: Offset, E: Weigh> Project for Projector<R, K, E> {
    fn project(
        &self,
        places: &[Vec<u32>; 3],
        uniforms: &[Vec<u32>; 3],
        pixels: &mut [u32],
        weights: &mut Weights,
    ) -> Lost {
        let weights = R::slot(weights);
        weights.resize(if E::LINE { pixels.len() } else { 0 }, R::Fixed::default());
        let [x, y, z] = places;
        let [u, v, w] = uniforms;
        project_batch::<R, K, E>(self.level, &self.params, [x, y, z], [u, v, w], pixels, weights)
    }
}

/// The `tent` kernel in 32 bits on AVX-512.
#[cfg(target_arch = "x86_64")]
struct Tent512<E> {
    params: Params<f32>,
    kind: std::marker::PhantomData<E>,
}

#[cfg(target_arch = "x86_64")]
impl<E: Weigh> Project for Tent512<E> {
    fn project(
        &self,
        places: &[Vec<u32>; 3],
        uniforms: &[Vec<u32>; 3],
        pixels: &mut [u32],
        weights: &mut Weights,
    ) -> Lost {
        let weights = f32::slot(weights);
        weights.resize(if E::LINE { pixels.len() } else { 0 }, 0);
        let ([x, y, z], [u, v, w]) = (places, uniforms);
        // SAFETY: only made for the level of AVX-512, which is only ever chosen on processors that have it.
        unsafe { project_tent::<E>(&self.params, [x, y, z], [u, v, w], pixels, weights) }
    }
}

vectorised! {
    fn project_batch<R: Real, K: Offset, E: Weigh>(
        params: &Params<R>, places: [&[u32]; 3], uniforms: [&[u32]; 3], pixels: &mut [u32], weights: &mut [R::Fixed],
    ) -> Lost = project_body::<R, K, E>
}

#[inline(always)]
fn project_body<R: Real, K: Offset, E: Weigh>(
    p: &Params<R>,
    places: [&[u32]; 3],
    uniforms: [&[u32]; 3],
    pixels: &mut [u32],
    weights: &mut [R::Fixed],
) -> Lost {
    let n = pixels.len();
    let (places, uniforms) = (places.map(|s| &s[..n]), uniforms.map(|s| &s[..n]));
    let weights = if E::LINE { &mut weights[..n] } else { weights };
    let mut lost = Lost::default();
    for i in 0..n {
        let x = position::<R, K>(
            p.centre,
            [places[0][i], places[1][i], places[2][i]],
            [uniforms[0][i], uniforms[1][i], uniforms[2][i]],
        );
        let landed = land::<R, E>(p, x);
        pixels[i] = landed.pixel;
        lost.beside += u32::from(landed.ahead & !landed.inside);
        lost.near += u32::from(!landed.ahead);
        if E::LINE {
            weights[i] = landed.weight;
        }
    }
    lost
}

/// Where a sample lies, in voxels from the grid's centre voxel.
#[inline(always)]
pub(crate) fn position<R: Real, K: Offset>(centre: [i32; 3], place: [u32; 3], words: [u32; 3]) -> [R; 3] {
    let t = K::offset::<R>(words);
    [
        R::from_i32(place[0] as i32 - centre[0]) + t[0],
        R::from_i32(place[1] as i32 - centre[1]) + t[1],
        R::from_i32(place[2] as i32 - centre[2]) + t[2],
    ]
}

/// What becomes of one sample.
pub(crate) struct Landed<F> {
    pub pixel: u32,
    pub weight: F,
    pub ahead: bool,
    pub inside: bool,
}

/// Projects a sample that lies at `x`, in voxels from the grid's centre voxel: the one projection of all images.
#[inline(always)]
pub(crate) fn land<R: Real, E: Weigh>(p: &Params<R>, x: [R; 3]) -> Landed<R::Fixed> {
    let row = |r: usize| p.rows[r][0] * x[0] + p.rows[r][1] * x[1] + (p.rows[r][2] * x[2] + p.shift[r]);
    let depth = row(2);
    let inverse = R::lit(1.0) / depth;
    let (px, py) = (row(0) * inverse, row(1) * inverse);
    let zero = R::lit(0.0);
    let ahead = depth >= p.near;
    let inside = ahead & (px >= zero) & (px < p.width) & (py >= zero) & (py < p.height);
    let (cx, cy) = (if inside { px } else { zero }, if inside { py } else { zero });
    // SAFETY: positions inside the image are below its sides, which are below 2^30; others were set to 0.
    let index = unsafe { cy.to_i32() * p.stride + cx.to_i32() };
    let other = if ahead { p.miss } else { p.miss + 1 };
    let pixel = if inside { index } else { other } as u32;
    if !E::LINE {
        return Landed { pixel, weight: R::Fixed::default(), ahead, inside };
    }
    let (dx, dy) = (px - p.middle[0], py - p.middle[1]);
    let s = &p.stretch;
    let q = s[0] + dx * (s[1] + dx * s[3] + dy * s[4]) + dy * (s[2] + dy * s[5]);
    let g = q.sqrt() * (inverse * inverse) * p.scale;
    let bounded = if g < p.largest { g } else { p.largest };
    let weight = if inside & (bounded >= zero) { bounded } else { zero };
    // SAFETY: 0 outside the image, and inside it at least 0 (NaN compares false) and at most `largest`.
    Landed { pixel, weight: unsafe { weight.to_fixed() }, ahead, inside }
}

/// The voxel from which positions are counted, so that they are small in 32 bits.
pub(crate) fn centre_voxel(dims: [usize; 3]) -> [i32; 3] {
    dims.map(|n| (n as i32 - 1) / 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::offset::tests::words;
    use glam::DVec3;
    use mcvr_scene::{Camera, Extent, View};
    use mcvr_volume::Grid;

    #[test]
    fn every_level_gives_the_same_bits_for_every_kernel_estimand_and_precision() {
        let grid = Grid::with_spacing([30, 20, 10], [1.0, 1.5, 2.0]).expect("a grid");
        let view = View { near: Some(105.0), fov: Some(8.0), ..View::default() };
        let camera = Camera::look(&view, &grid, Extent::new(37, 23).expect("a size")).expect("a camera");
        let words = words();
        let column = |a: usize| words.iter().map(|w| w[a]).collect::<Vec<_>>();
        let uniforms = [column(0), column(1), column(2)];
        let places = [column(1), column(2), column(0)].map(|c| c.iter().map(|w| w % 10).collect::<Vec<_>>());
        for kernel in Kernel::ALL {
            for estimand in Estimand::ALL {
                for precision in [Precision::F32, Precision::F64] {
                    let projection = Projection::new(&grid, &camera, kernel, 1 << 20, Some(precision)).expect("ok");
                    let mut first = None;
                    for level in SimdLevel::available() {
                        let mut pixels = vec![0; words.len()];
                        let mut weights = Weights::default();
                        let lost = projection.projector(kernel, estimand, level).project(
                            &places,
                            &uniforms,
                            &mut pixels,
                            &mut weights,
                        );
                        assert!(lost.beside > 0 && lost.near > 0, "{lost:?}");
                        assert!(pixels.iter().any(|p| *p < 37 * 23));
                        let all = (pixels, weights.narrow, weights.wide, lost);
                        assert_eq!(
                            *first.get_or_insert_with(|| all.clone()),
                            all,
                            "{kernel} {estimand} {precision:?} {level:?}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn weights_are_the_cameras_line_factors() {
        let grid = Grid::with_spacing([30, 20, 10], [1.0, 1.5, 2.0]).expect("a grid");
        for parallel in [false, true] {
            let view = View { parallel, distance: Some(60.0), ..View::default() };
            let camera = Camera::look(&view, &grid, Extent::new(64, 48).expect("a size")).expect("a camera");
            let projection = Projection::new(&grid, &camera, Kernel::Box, 1 << 20, None).expect("a projection");
            assert_eq!(projection.precision(), Precision::F32);
            let places = [vec![3, 29, 0], vec![4, 19, 0], vec![5, 9, 0]];
            let middle = vec![1u32 << 31; 3];
            let (mut pixels, mut weights) = (vec![0; 3], Weights::default());
            projection.projector(Kernel::Box, Estimand::Line, SimdLevel::detect()).project(
                &places,
                &[middle.clone(), middle.clone(), middle],
                &mut pixels,
                &mut weights,
            );
            for i in 0..3 {
                let index = DVec3::new(f64::from(places[0][i]), f64::from(places[1][i]), f64::from(places[2][i]));
                let (px, py, z) = camera.project(grid.index_to_world().transform_point3(index));
                assert_eq!(pixels[i] as usize, py as usize * 64 + px as usize);
                let weight = f64::from(weights.narrow[i]) * projection.weight_unit() * camera.det();
                let exact = camera.line_factor(px, py, z);
                assert!((weight / exact - 1.0).abs() < 1e-5, "{weight} {exact}");
            }
        }
    }
}
