//! How stored voxels become the weights whose differences are gradients.

use bytemuck::Zeroable;
use mcvr_scene::{WeightFn, WeightLookup};
use mcvr_volume::Voxel;

use crate::real::Real;

/// How stored voxels become the weights that are differenced, up to a common factor.
pub(super) trait Read<T>: Send + Sync {
    type Real: Real;
    /// What is kept of a voxel until its stencil is complete; all bits zero stands for weight 0.
    type Staged: Copy + Zeroable + Send + Sync;
    fn stage(&self, stored: T) -> Self::Staged;
    fn weight(staged: Self::Staged) -> Self::Real;
}

/// The stored value is the weight, or its negative part is cut: exact in `f32` for 8 and 16 bits.
pub(super) struct Direct;

impl<T: Voxel> Read<T> for Direct {
    type Real = f32;
    type Staged = T;
    #[inline(always)]
    fn stage(&self, stored: T) -> T {
        stored
    }
    #[inline(always)]
    fn weight(staged: T) -> f32 {
        let w = staged.to_f64() as f32;
        if w > 0.0 { w } else { 0.0 }
    }
}

/// Small integer weights by ordinal: exact in `f32`.
pub(super) struct Small(pub Vec<f32>);

impl<T: Voxel> Read<T> for Small {
    type Real = f32;
    type Staged = f32;
    #[inline(always)]
    fn stage(&self, stored: T) -> f32 {
        self.0[stored.ordinal().unwrap_or(0)]
    }
    #[inline(always)]
    fn weight(staged: f32) -> f32 {
        staged
    }
}

/// Any other weights, over the largest.
pub(super) struct Mapped<'a> {
    pub lookup: WeightLookup<'a>,
    pub scale: f64,
}

impl<T: Voxel> Read<T> for Mapped<'_> {
    type Real = f64;
    type Staged = f64;
    #[inline(always)]
    fn stage(&self, stored: T) -> f64 {
        self.lookup.weight(stored) * self.scale
    }
    #[inline(always)]
    fn weight(staged: f64) -> f64 {
        staged
    }
}

/// Runs an expression with `$read` bound to the density's cheapest exact [`Read`].
macro_rules! with_read {
    ($density:expr, $t:ident, $read:ident => $body:expr) => {
        match $crate::units::UnitWeights::of($density) {
            $crate::units::UnitWeights::Small(table) if $crate::effects::gradient::read::is_direct::<$t>(&table) => {
                let $read = $crate::effects::gradient::read::Direct;
                $body
            }
            $crate::units::UnitWeights::Small(table) => {
                let $read = $crate::effects::gradient::read::Small(table.into_iter().map(|w| w as f32).collect());
                $body
            }
            _ => {
                let $read = $crate::effects::gradient::read::Mapped {
                    lookup: $density.lookup(),
                    // The smallest numbers have no reciprocal.
                    scale: (1.0 / $density.report().max_weight).min(f64::MAX),
                };
                $body
            }
        }
    };
}

/// True when the table holds every stored value itself, or 0 for negative ones.
pub(super) fn is_direct<T: Voxel>(table: &[u32]) -> bool {
    let first = if T::TYPE.name().starts_with('i') { table.len() as i64 / 2 } else { 0 };
    table.iter().enumerate().all(|(i, w)| i64::from(*w) == (i as i64 - first).max(0))
}

pub(super) use with_read;
