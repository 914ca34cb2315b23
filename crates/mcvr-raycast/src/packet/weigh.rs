//! Which way from stored values to weights serves a density's packets.

use mcvr_scene::{Density, Transfer, power_of_two};
use mcvr_volume::{Voxel, Voxels};

use super::corners::{Affine, Corners, FloatAffine, Plain, Table, Weights, Whole, WholeAffine};

/// Code to run on the typed voxels and their weights.
pub(crate) trait Visit<'a> {
    type Out;
    fn run<T: Voxel, W: Weights<T> + Send + 'a>(self, field: Corners<'a, T, W>) -> Self::Out;
}

/// Runs `visit` on the density's field, or says that packets do not serve it.
pub(crate) fn with_corners<'a, V: Visit<'a>>(density: &'a Density, visit: V) -> Option<V::Out> {
    let dims = density.volume().grid().dims();
    // `f32` holds such weights, and sums of as many as a ray meets.
    if !(power_of_two(-64)..power_of_two(100)).contains(&density.report().max_weight) {
        return None;
    }
    macro_rules! on {
        ($voxels:expr, $weights:expr) => {
            Corners::new($voxels, $weights, dims).map(|field| visit.run(field))
        };
    }
    match density.volume().voxels() {
        Voxels::U8(v) if plain::<u8>(density) => on!(v, Plain),
        Voxels::U8(v) => on!(v, table(density)?),
        Voxels::I8(v) => on!(v, table(density)?),
        Voxels::U16(v) => match affine_table::<u16>(density) {
            Some(affine) => on!(v, WholeAffine(affine)),
            None => on!(v, table(density)?),
        },
        Voxels::I16(v) => match affine_table::<i16>(density) {
            Some(affine) => on!(v, WholeAffine(affine)),
            None => on!(v, table(density)?),
        },
        Voxels::F32(v) => on!(v, FloatAffine(affine_map(density)?)),
        Voxels::U32(_) | Voxels::I32(_) | Voxels::F64(_) => None,
    }
}

/// True when every stored value is its own weight.
fn plain<T: Whole>(density: &Density) -> bool {
    let own = |(n, w): (usize, &f64)| *w == (n as i32 - T::ORIGIN) as f64;
    density.table().is_some_and(|t| t.iter().enumerate().all(own))
}

fn table(density: &Density) -> Option<Table> {
    let table: Vec<f32> = density.table()?.iter().map(|w| *w as f32).collect();
    // One weight for each value of the type, as look-ups rely on.
    let values = density.volume().voxel_type().cardinality()?;
    (table.len() == values).then_some(Table(table))
}

/// The straight line, cut off at 0, on which all weights of a table lie; `None` when they do not, as far as `f32` can tell.
fn affine_table<T: Whole>(density: &Density) -> Option<Affine> {
    let table = density.table()?;
    let stored = |n: usize| (n as i32 - T::ORIGIN) as f64;
    // The longest run of positive weights at the end or the start gives the line.
    let (first, last) = (table.iter().position(|w| *w > 0.0)?, table.iter().rposition(|w| *w > 0.0)?);
    if last <= first {
        return None;
    }
    let slope = (table[last] - table[first]) / (stored(last) - stored(first));
    let affine = Affine { slope: slope as f32, intercept: (table[first] - slope * stored(first)) as f32 };
    let most = density.report().max_weight;
    let slack = most * power_of_two(-21);
    let near = |(n, w): (usize, &f64)| *w > 2.0 * most || (f64::from(affine.one(stored(n) as f32)) - w).abs() <= slack;
    table.iter().enumerate().all(near).then_some(affine)
}

/// The same of a map of floats, where it says so itself.
fn affine_map(density: &Density) -> Option<Affine> {
    let (map, volume) = (density.map(), density.volume());
    if map.emphasis.is_some() || map.gains.is_some() {
        return None;
    }
    let (slope, intercept) = match map.transfer {
        Transfer::Identity => (1.0, 0.0),
        Transfer::Linear { slope, intercept } => (slope, intercept),
        Transfer::Piecewise(_) | Transfer::Hounsfield(_) => return None,
    };
    let (slope, intercept) = (slope * volume.slope(), slope * volume.intercept() + intercept);
    // Where the line's terms nearly cancel, `f32` has too few digits for what is left.
    let few = intercept.abs() > 16.0 * density.report().max_weight;
    (!few).then_some(Affine { slope: slope as f32, intercept: intercept as f32 })
}
