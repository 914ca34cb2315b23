//! Voxels and the way from stored values to weights, compiled once per voxel type and kind of map.

use mcvr_scene::{Density, Transfer, WeightFn, WeightLookup, power_of_two};
use mcvr_volume::{Voxel, Voxels};

/// Weights for the inner loops, in the precision `F` (`f64` for the reference, `f32` for the march).
pub(crate) trait Weigh<T, F>: Sync {
    fn weigh(&self, stored: T) -> F;
}

/// Weight by ordinal; `N` is the number of values of the stored type, so that look-ups need no bounds check.
pub(crate) struct Table<F, const N: usize>(Box<[F; N]>);

impl<T: Voxel, F: Copy + Default + Sync, const N: usize> Weigh<T, F> for Table<F, N> {
    #[inline(always)]
    fn weigh(&self, stored: T) -> F {
        match stored.ordinal() {
            Some(i) if i < N => self.0[i],
            _ => F::default(),
        }
    }
}

/// The identity map: `max(0, slope * stored + intercept)`, the same expression as [`Density`] evaluates.
pub(crate) struct Rescaled {
    slope: f64,
    intercept: f64,
}

impl<T: Voxel> Weigh<T, f64> for Rescaled {
    #[inline(always)]
    fn weigh(&self, stored: T) -> f64 {
        let w = self.slope * stored.to_f64() + self.intercept;
        if w > 0.0 { w } else { 0.0 }
    }
}

impl<T: Voxel> Weigh<T, f32> for Rescaled {
    #[inline(always)]
    fn weigh(&self, stored: T) -> f32 {
        let w: f64 = self.weigh(stored);
        w as f32
    }
}

/// The stored value is the weight: unsigned 8-bit voxels under the identity map without rescaling.
pub(crate) struct Stored;

impl<T: Voxel> Weigh<T, f32> for Stored {
    #[inline(always)]
    fn weigh(&self, stored: T) -> f32 {
        stored.to_f64() as f32
    }
}

/// Any map on any type, by calculation.
pub(crate) struct Mapped<'a>(WeightLookup<'a>);

impl<T: Voxel> Weigh<T, f64> for Mapped<'_> {
    #[inline(always)]
    fn weigh(&self, stored: T) -> f64 {
        self.0.weight(stored)
    }
}

impl<T: Voxel> Weigh<T, f32> for Mapped<'_> {
    #[inline(always)]
    fn weigh(&self, stored: T) -> f32 {
        self.0.weight(stored) as f32
    }
}

/// Weights over a unit, for those that leave the range of `f32`.
pub(crate) struct Lifted<'a> {
    lookup: WeightLookup<'a>,
    unit: f64,
}

impl<'a> Lifted<'a> {
    /// The weights of a density over their unit, a power of two; `None` where `f32` holds them as they are.
    pub(crate) fn of(density: &'a Density) -> Option<(Self, f64)> {
        let report = density.report();
        let fits = (power_of_two(-64)..power_of_two(100)).contains(&report.max_weight);
        // A power of two below all numbers would be 0.
        let unit = power_of_two(report.unit_exponent().max(-1074));
        (!fits).then(|| (Self { lookup: density.lookup(), unit }, unit))
    }
}

impl<T: Voxel> Weigh<T, f32> for Lifted<'_> {
    #[inline(always)]
    fn weigh(&self, stored: T) -> f32 {
        (self.lookup.weight(stored) / self.unit) as f32
    }
}

/// Code to run on the typed voxels and their weights.
pub(crate) trait Visit<'a, F> {
    type Out;
    fn run<T: Voxel, W: Weigh<T, F> + Send + 'a>(self, voxels: &'a [T], weights: W) -> Self::Out;
}

/// A float type in which weights are wanted.
pub(crate) trait Real: Copy + Default + Send + Sync + 'static {
    /// The nearest value of this type.
    fn from_f64(w: f64) -> Self;
}

impl Real for f32 {
    fn from_f64(w: f64) -> Self {
        w as f32
    }
}

impl Real for f64 {
    fn from_f64(w: f64) -> Self {
        w
    }
}

fn table<F: Real, const N: usize>(density: &Density) -> Table<F, N> {
    let mut t = vec![F::default(); N];
    for (t, &w) in t.iter_mut().zip(density.table().unwrap_or_default()) {
        *t = F::from_f64(w);
    }
    // The vector has N elements, so the conversion cannot fail; an empty field would be the fallback.
    Table(t.into_boxed_slice().try_into().unwrap_or_else(|_| Box::new([F::default(); N])))
}

/// The map as [`Rescaled`], when it is the identity.
fn rescaled(density: &Density) -> Option<Rescaled> {
    let map = density.map();
    let plain = map.transfer == Transfer::Identity && map.emphasis.is_none() && map.gains.is_none();
    plain.then(|| Rescaled { slope: density.volume().slope(), intercept: density.volume().intercept() })
}

/// True when the stored values of an unsigned type are the weights themselves.
pub(crate) fn stored_is_weight(density: &Density) -> bool {
    rescaled(density).is_some_and(|r| r.slope == 1.0 && r.intercept == 0.0)
}

/// Runs `visit` on the density's voxels in their stored type: 8-bit types by table, wider ones by calculation
/// under the identity map, else 16-bit ones by table and the widest by [`Density::weight_of`].
pub(crate) fn with_field<'a, F: Real, V: Visit<'a, F>>(density: &'a Density, visit: V) -> V::Out
where
    Rescaled: Weigh<u16, F> + Weigh<i16, F> + Weigh<u32, F> + Weigh<i32, F> + Weigh<f32, F> + Weigh<f64, F>,
    Mapped<'a>: Weigh<u32, F> + Weigh<i32, F> + Weigh<f32, F> + Weigh<f64, F>,
{
    macro_rules! sixteen {
        ($v:expr) => {
            match rescaled(density) {
                Some(r) => visit.run($v, r),
                None => visit.run($v, table::<F, 65536>(density)),
            }
        };
    }
    macro_rules! wide {
        ($v:expr) => {
            match rescaled(density) {
                Some(r) => visit.run($v, r),
                None => visit.run($v, Mapped(density.lookup())),
            }
        };
    }
    match density.volume().voxels() {
        Voxels::U8(v) => visit.run(v, table::<F, 256>(density)),
        Voxels::I8(v) => visit.run(v, table::<F, 256>(density)),
        Voxels::U16(v) => sixteen!(v),
        Voxels::I16(v) => sixteen!(v),
        Voxels::U32(v) => wide!(v),
        Voxels::I32(v) => wide!(v),
        Voxels::F32(v) => wide!(v),
        Voxels::F64(v) => wide!(v),
    }
}
