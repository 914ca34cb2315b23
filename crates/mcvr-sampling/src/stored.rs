//! From stored positions to pixels: the projection without locating and kernel.

use mcvr_scene::Estimand;

use crate::project::{CountWeigh, LineWeigh, Lost, Params, Weigh, land};
#[cfg(target_arch = "x86_64")]
use crate::project512::project_stored;
use crate::projection::{Precision, Projection};
use crate::real::{Real, Weights};
use mcvr_volume::{SimdLevel, vectorised};

/// Turns positions (voxels from the centre voxel) into what [`Project`](crate::project::Project) gives.
pub(crate) trait ProjectStored: Send + Sync {
    fn project(&self, positions: [&[f32]; 3], pixels: &mut [u32], weights: &mut Weights) -> Lost;
}

struct StoredProjector<R, E> {
    params: Params<R>,
    level: SimdLevel,
    kind: std::marker::PhantomData<E>,
}

impl Projection {
    /// The vector code for an estimand, as one call per batch.
    pub(crate) fn stored_projector(&self, estimand: Estimand, level: SimdLevel) -> Box<dyn ProjectStored> {
        match (self.precision(), estimand) {
            (Precision::F32, Estimand::Count) => self.stored::<f32, CountWeigh>(level),
            (Precision::F32, Estimand::Line) => self.stored::<f32, LineWeigh>(level),
            (Precision::F64, Estimand::Count) => self.stored::<f64, CountWeigh>(level),
            (Precision::F64, Estimand::Line) => self.stored::<f64, LineWeigh>(level),
        }
    }

    fn stored<R: Real + 'static, E: Weigh + 'static>(&self, level: SimdLevel) -> Box<dyn ProjectStored> {
        #[cfg(target_arch = "x86_64")]
        if level == SimdLevel::Avx512 && !R::DOUBLE {
            return Box::new(Stored512::<E> { params: self.params(), kind: Default::default() });
        }
        Box::new(StoredProjector::<R, E> { params: self.params(), level, kind: Default::default() })
    }
}

impl<R: Real, E: Weigh> ProjectStored for StoredProjector<R, E> {
    fn project(&self, positions: [&[f32]; 3], pixels: &mut [u32], weights: &mut Weights) -> Lost {
        let weights = R::slot(weights);
        weights.resize(if E::LINE { pixels.len() } else { 0 }, R::Fixed::default());
        stored_batch::<R, E>(self.level, &self.params, positions, pixels, weights)
    }
}

/// 32 bits on AVX-512.
#[cfg(target_arch = "x86_64")]
struct Stored512<E> {
    params: Params<f32>,
    kind: std::marker::PhantomData<E>,
}

#[cfg(target_arch = "x86_64")]
impl<E: Weigh> ProjectStored for Stored512<E> {
    fn project(&self, positions: [&[f32]; 3], pixels: &mut [u32], weights: &mut Weights) -> Lost {
        let weights = f32::slot(weights);
        weights.resize(if E::LINE { pixels.len() } else { 0 }, 0);
        // SAFETY: only made for the level of AVX-512, which is only ever chosen on processors that have it.
        unsafe { project_stored::<E>(&self.params, positions, pixels, weights) }
    }
}

vectorised! {
    fn stored_batch<R: Real, E: Weigh>(
        params: &Params<R>, positions: [&[f32]; 3], pixels: &mut [u32], weights: &mut [R::Fixed],
    ) -> Lost = stored_body::<R, E>
}

#[inline(always)]
fn stored_body<R: Real, E: Weigh>(
    p: &Params<R>,
    positions: [&[f32]; 3],
    pixels: &mut [u32],
    weights: &mut [R::Fixed],
) -> Lost {
    let n = pixels.len();
    let [x, y, z] = positions.map(|s| &s[..n]);
    let weights = if E::LINE { &mut weights[..n] } else { weights };
    let mut lost = Lost::default();
    for i in 0..n {
        let landed = land::<R, E>(p, [R::from_f32(x[i]), R::from_f32(y[i]), R::from_f32(z[i])]);
        pixels[i] = landed.pixel;
        lost.beside += u32::from(landed.ahead & !landed.inside);
        lost.near += u32::from(!landed.ahead);
        if E::LINE {
            weights[i] = landed.weight;
        }
    }
    lost
}
