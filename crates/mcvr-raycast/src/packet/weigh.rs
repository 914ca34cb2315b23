//! Which way from stored values to weights serves a density's packets.

use mcvr_scene::{Density, Transfer, power_of_two};
use mcvr_volume::{Voxel, Voxels};

use super::corners::{Affine, Corners, Plain, Table, Weights, Whole};

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
        ($voxels:expr, $weights:expr, $unit:expr) => {
            Corners::new($voxels, $weights, $unit, dims).map(|field| visit.run(field))
        };
    }
    // Where no weight is cut off at 0 and the line goes through 0, the slope can wait until the sum is there.
    macro_rules! line {
        ($voxels:expr, $line:expr, $else:expr) => {
            match $line {
                Some(Line { slope, intercept: 0.0 }) if density.report().negative == 0 => on!($voxels, Plain, slope),
                Some(line) => on!($voxels, line.affine(), 1.0),
                None => $else,
            }
        };
    }
    match density.volume().voxels() {
        Voxels::U8(v) => line!(v, line_of_table::<u8>(density), on!(v, table(density)?, 1.0)),
        Voxels::I8(v) => on!(v, table(density)?, 1.0),
        Voxels::U16(v) => line!(v, line_of_table::<u16>(density), on!(v, table(density)?, 1.0)),
        Voxels::I16(v) => line!(v, line_of_table::<i16>(density), on!(v, table(density)?, 1.0)),
        Voxels::F32(v) => line!(v, line_of_map(density), None),
        Voxels::U32(_) | Voxels::I32(_) | Voxels::F64(_) => None,
    }
}

/// `max(0, slope * stored + intercept)`, in full precision.
struct Line {
    slope: f64,
    intercept: f64,
}

impl Line {
    fn affine(&self) -> Affine {
        Affine { slope: self.slope as f32, intercept: self.intercept as f32 }
    }
}

fn table(density: &Density) -> Option<Table> {
    let table: Vec<f32> = density.table()?.iter().map(|w| *w as f32).collect();
    // One weight for each value of the type, as look-ups rely on.
    let values = density.volume().voxel_type().cardinality()?;
    (table.len() == values).then_some(Table(table))
}

/// The straight line, cut off at 0, on which all weights of a table lie; `None` when they do not, as far as `f32` can tell.
fn line_of_table<T: Whole>(density: &Density) -> Option<Line> {
    let table = density.table()?;
    let stored = |n: usize| f64::from(n as i32 - T::ORIGIN);
    let (first, last) = (table.iter().position(|w| *w > 0.0)?, table.iter().rposition(|w| *w > 0.0)?);
    if last <= first {
        return None;
    }
    let slope = (table[last] - table[first]) / (stored(last) - stored(first));
    let intercept = table[first] - slope * stored(first);
    let most = density.report().max_weight;
    // What is left of terms that cancel but for rounding.
    let intercept = if intercept.abs() < most * power_of_two(-40) { 0.0 } else { intercept };
    let line = Line { slope, intercept };
    let (affine, slack) = (line.affine(), most * power_of_two(-21));
    // Values that the volume does not hold may be anywhere.
    let near = |(n, w): (usize, &f64)| *w > most || (f64::from(affine.of(stored(n) as f32)) - w).abs() <= slack;
    table.iter().enumerate().all(near).then_some(line)
}

/// The same of a map of floats, where it says so itself.
fn line_of_map(density: &Density) -> Option<Line> {
    let (map, volume) = (density.map(), density.volume());
    if map.emphasis.is_some() || map.gains.is_some() {
        return None;
    }
    let (slope, intercept) = match map.transfer {
        Transfer::Identity => (1.0, 0.0),
        Transfer::Linear { slope, intercept } => (slope, intercept),
        Transfer::Piecewise(_) | Transfer::Hounsfield(_) => return None,
    };
    let line = Line { slope: slope * volume.slope(), intercept: slope * volume.intercept() + intercept };
    // Where the line's terms nearly cancel, `f32` has too few digits for what is left.
    (line.intercept.abs() <= 16.0 * density.report().max_weight).then_some(line)
}
