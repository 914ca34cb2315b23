//! Where samples lie, in voxels: the projection's own positions, for the passes that need them.

use mcvr_scene::Kernel;
use mcvr_volume::Grid;

use crate::Precision;
use crate::offset::{BoxOffset, BsplineOffset, Offset, ShellOffset, TentOffset};
use crate::project::{centre_voxel, position};
use crate::real::Real;
use mcvr_volume::{SimdLevel, vectorised};

/// Positions of a batch's samples.
pub(crate) trait Place: Send + Sync {
    /// Writes the continuous voxel indices of the samples `live` of a batch, column by column.
    fn fill(&self, places: &[Vec<u32>; 3], uniforms: &[Vec<u32>; 3], live: &[u32], out: &mut [Vec<f64>; 3]);
}

/// Positions in the precision in which the projection computes them.
pub(crate) fn place(precision: Precision, kernel: Kernel, grid: &Grid, level: SimdLevel) -> Box<dyn Place> {
    let centre = centre_voxel(grid.dims());
    fn boxed<R: Real + 'static>(kernel: Kernel, centre: [i32; 3], level: SimdLevel) -> Box<dyn Place> {
        match kernel {
            Kernel::Box => Box::new(Placer::<R, BoxOffset> { centre, level, kind: Default::default() }),
            Kernel::Tent => Box::new(Placer::<R, TentOffset> { centre, level, kind: Default::default() }),
            Kernel::Bspline3 => Box::new(Placer::<R, BsplineOffset> { centre, level, kind: Default::default() }),
            Kernel::Shell => Box::new(Placer::<R, ShellOffset> { centre, level, kind: Default::default() }),
        }
    }
    match precision {
        Precision::F32 => boxed::<f32>(kernel, centre, level),
        Precision::F64 => boxed::<f64>(kernel, centre, level),
    }
}

struct Placer<R, K> {
    centre: [i32; 3],
    level: SimdLevel,
    kind: std::marker::PhantomData<(R, K)>,
}

impl<R: Real, K: Offset> Place for Placer<R, K> {
    fn fill(&self, places: &[Vec<u32>; 3], uniforms: &[Vec<u32>; 3], live: &[u32], out: &mut [Vec<f64>; 3]) {
        let len = places[0].len();
        let [x, y, z] = &mut *out;
        for column in [&mut *x, &mut *y, &mut *z] {
            column.resize(len, 0.0);
        }
        let ([i, j, k], [u, v, w]) = (places, uniforms);
        place_batch::<R, K>(self.level, self.centre, [i, j, k], [u, v, w], [x, y, z]);
        if live.len() < len {
            for column in out {
                for (to, &from) in live.iter().enumerate() {
                    column[to] = column[from as usize];
                }
                column.truncate(live.len());
            }
        }
    }
}

vectorised! {
    fn place_batch<R: Real, K: Offset>(
        centre: [i32; 3], places: [&[u32]; 3], uniforms: [&[u32]; 3], out: [&mut [f64]; 3],
    ) = place_body::<R, K>
}

#[inline(always)]
fn place_body<R: Real, K: Offset>(centre: [i32; 3], places: [&[u32]; 3], uniforms: [&[u32]; 3], out: [&mut [f64]; 3]) {
    let n = out[0].len();
    let [px, py, pz] = places.map(|s| &s[..n]);
    let [ux, uy, uz] = uniforms.map(|s| &s[..n]);
    let [x, y, z] = out.map(|s| &mut s[..n]);
    for i in 0..n {
        let at = position::<R, K>(centre, [px[i], py[i], pz[i]], [ux[i], uy[i], uz[i]]);
        x[i] = at[0].to_f64() + f64::from(centre[0]);
        y[i] = at[1].to_f64() + f64::from(centre[1]);
        z[i] = at[2].to_f64() + f64::from(centre[2]);
    }
}
