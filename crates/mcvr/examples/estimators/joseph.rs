//! Joseph's method slice after slice (P. Joseph, IEEE Trans. Medical Imaging 1, 1982): along the axis nearest the view, every ray takes one
//! bilinear sample in each slice of voxels, as far apart as the ray's slices are.
//!
//! It integrates the tent across the slices only, and so a piecewise bilinear field other than the trilinear one: a bias, of second order
//! in how far a ray moves sideways from slice to slice, that no number of rays lowers. Some slices at a time are copied out of the
//! volume with a rim of zeros, in the order of memory; all rays that can meet them are then advanced, sixteen side by side.

use mcvr::scene::{Camera, Density, Image, WeightFn};
use mcvr::volume::SimdLevel;

use crate::scenes::Scene;
use crate::{Entry, Made, Outcome};

/// Slices at a time.
const SLICES: usize = 8;

/// Pixels beyond the image that averaging reads.
const MARGIN: usize = 2;

pub fn entries(scene: &Scene) -> Vec<Entry<'_>> {
    [("1x1", false), ("1x1, averaged", true)]
        .into_iter()
        .map(|(setting, average)| Entry {
            family: "joseph",
            setting: setting.to_owned(),
            needs: vec![crate::baseline::WEIGHTS],
            work: Box::new(move |_| image(&scene.density, &scene.camera, average)),
        })
        .collect()
}

/// Some slices one behind the other, each with a rim of zeros.
struct Slab {
    values: Vec<f32>,
    /// Voxels along the axes across, rim included.
    sides: [usize; 2],
    /// Number of the first slice, and how many.
    first: usize,
    many: usize,
}

impl Slab {
    fn read(&mut self, density: &Density, [main, across, down]: [usize; 3]) {
        let dims = density.volume().grid().dims();
        let strides = [1, dims[0], dims[0] * dims[1]];
        let (wide, size) = (self.sides[0], self.sides[0] * self.sides[1]);
        let lookup = density.lookup();
        // The table of weights as floats, for types that have one.
        let table: Option<Vec<f32>> = density.table().map(|t| t.iter().map(|w| *w as f32).collect());
        mcvr::volume::with_voxels!(density.volume().voxels(), v => for j in 0..dims[down] {
            let to = wide * (j + 1) + 1;
            for s in 0..self.many {
                let from = strides[main] * (self.first + s) + strides[down] * j;
                let out = &mut self.values[size * s + to..][..dims[across]];
                for (i, o) in out.iter_mut().enumerate() {
                    let stored = v[from + strides[across] * i];
                    *o = match (&table, mcvr::volume::Voxel::ordinal(stored)) {
                        (Some(table), Some(n)) => table[n],
                        _ => lookup.weight(stored) as f32,
                    };
                }
            }
        });
    }
}

/// A row of rays: where they are in a slice is `origin + slope * (slice - origin's)`, coordinates with the rim.
struct Row<'a> {
    slopes: [&'a [f32]; 2],
    origin: [f32; 2],
    /// Distance of the slab's first slice from the origin.
    ahead: f32,
}

#[inline(always)]
fn advance(row: &Row<'_>, slab: &Slab, sums: &mut [f32]) {
    let size = slab.sides[0] * slab.sides[1];
    let wide = slab.sides[0] as i32;
    // Beyond the rim's middle the field is 0, as it is on the rim.
    let most = [slab.sides[0] as f32 - 1.001, slab.sides[1] as f32 - 1.001];
    let [a, b] = row.slopes;
    assert!(a.len() == sums.len() && b.len() == sums.len());
    for s in 0..slab.many {
        let values = &slab.values[size * s..][..size];
        let ahead = row.ahead + s as f32;
        for n in 0..sums.len() {
            let x = (row.origin[0] + ahead * a[n]).max(0.0).min(most[0]);
            let y = (row.origin[1] + ahead * b[n]).max(0.0).min(most[1]);
            // SAFETY: `max` and `min` leave numbers between 0 and the sides, NaN becomes 0; so the indices, and those after
            // them by one column and one row, lie within the slice.
            sums[n] += unsafe {
                let (i, j) = (x.to_int_unchecked::<i32>(), y.to_int_unchecked::<i32>());
                let (fx, fy) = (x - i as f32, y - j as f32);
                let at = (i + j * wide) as usize;
                let (p, q) = (*values.get_unchecked(at), *values.get_unchecked(at + 1));
                let at = at + wide as usize;
                let (r, t) = (*values.get_unchecked(at), *values.get_unchecked(at + 1));
                let (upper, lower) = (p + fx * (q - p), r + fx * (t - r));
                upper + fy * (lower - upper)
            };
        }
    }
}

mcvr::volume::vectorised! {
    fn advanced(row: &Row<'_>, slab: &Slab, sums: &mut [f32]) = advance
}

/// The image: one ray a pixel, and with `average` the means over pixels by the neighbours' values, as mcvr's own rays have them.
pub fn image(density: &Density, camera: &Camera, average: bool) -> Outcome<Made> {
    let view = if average { camera.in_blocks(1, MARGIN)? } else { camera.clone() };
    let grid = density.volume().grid();
    let dims = grid.dims();
    let to_index = grid.world_to_index();
    let main = view.depth_axis(grid);
    let [across, down] = [0, 1, 2].into_iter().filter(|a| *a != main).collect::<Vec<_>>()[..] else {
        return Err("a grid has three axes".into());
    };
    let (Some(eye), extent) = (view.eye(), view.extent()) else { return Err("joseph needs a pinhole".into()) };
    let origin = to_index.transform_point3(eye).to_array();
    let pixels = extent.pixels();
    let mut slopes = [vec![0f32; pixels], vec![0f32; pixels]];
    let mut length = vec![0f32; pixels];
    for (n, length) in length.iter_mut().enumerate() {
        let (x, y) = (n % extent.width, n / extent.width);
        let ray = view.ray(x as f64 + 0.5, y as f64 + 0.5);
        let d = to_index.transform_vector3(ray.direction).to_array();
        let per = 1.0 / d[main];
        // A ray along the slices meets none; depth axes of a narrow view leave no such ray.
        let per = if per.is_finite() { per } else { 0.0 };
        slopes[0][n] = (d[across] * per) as f32;
        slopes[1][n] = (d[down] * per) as f32;
        *length = per.abs() as f32;
    }
    let sides = [dims[across] + 2, dims[down] + 2];
    let mut slab = Slab { values: vec![0.0; sides[0] * sides[1] * SLICES], sides, first: 0, many: 0 };
    let mut sums = vec![0f32; pixels];
    let level = SimdLevel::detect();
    let mut work = 0;
    for first in (0..dims[main]).step_by(SLICES) {
        (slab.first, slab.many) = (first, SLICES.min(dims[main] - first));
        slab.read(density, [main, across, down]);
        let [x0, x1, y0, y1] = outline(&view, grid, [main, across, down], [first, first + slab.many - 1]);
        for y in y0..y1 {
            let span = y * extent.width + x0..y * extent.width + x1.max(x0);
            let row = Row {
                slopes: [&slopes[0][span.clone()], &slopes[1][span.clone()]],
                origin: [origin[across] as f32 + 1.0, origin[down] as f32 + 1.0],
                ahead: (first as f64 - origin[main]) as f32,
            };
            work += (span.len() * slab.many) as u64;
            advanced(level, &row, &slab, &mut sums[span]);
        }
    }
    let values: Vec<f64> = sums.iter().zip(&length).map(|(s, l)| f64::from(*s) * f64::from(*l)).collect();
    let image = Image::from_values(extent, values)?;
    Ok(Made { image: if average { averaged(&image, camera)? } else { image }, work })
}

/// Pixels that slices can project to, `[x0, x1, y0, y1]`.
fn outline(
    camera: &Camera,
    grid: &mcvr::volume::Grid,
    [main, across, down]: [usize; 3],
    slices: [usize; 2],
) -> [usize; 4] {
    let dims = grid.dims();
    let to_world = grid.index_to_world();
    let mut span = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
    for corner in 0..8 {
        let mut p = [0.0; 3];
        p[main] = slices[corner & 1] as f64;
        p[across] = if corner & 2 == 0 { -1.0 } else { dims[across] as f64 };
        p[down] = if corner & 4 == 0 { -1.0 } else { dims[down] as f64 };
        let (x, y, _) = camera.project(to_world.transform_point3(p.into()));
        span = [span[0].min(x), span[1].max(x), span[2].min(y), span[3].max(y)];
    }
    let [width, height] = [camera.extent().width, camera.extent().height];
    let clip = |v: f64, n: usize| (v.max(0.0) as usize).min(n);
    [clip(span[0] - 1.0, width), clip(span[1] + 1.0, width), clip(span[2] - 1.0, height), clip(span[3] + 1.0, height)]
}

/// Means over pixels from the values at their centres: `v + δ²/24 - 17 δ⁴/5760` along each axis.
fn averaged(wide: &Image, camera: &Camera) -> Outcome<Image> {
    let extent = camera.extent();
    let across = wide.extent().width;
    let (second, fourth) = (1.0 / 24.0, -17.0 / 5760.0);
    let [c0, c1, c2] = [1.0 - 2.0 * second + 6.0 * fourth, second - 4.0 * fourth, fourth];
    let v = wide.values();
    let mut out = Vec::with_capacity(extent.pixels());
    let mut column = vec![0.0; across];
    for y in 0..extent.height {
        let row = |n: usize| &v[across * (y + n)..][..across];
        let (a, b, c, d, e) = (row(0), row(1), row(2), row(3), row(4));
        for (x, o) in column.iter_mut().enumerate() {
            *o = c0 * c[x] + c1 * (b[x] + d[x]) + c2 * (a[x] + e[x]);
        }
        out.extend(column.windows(5).map(|v| c0 * v[2] + c1 * (v[1] + v[3]) + c2 * (v[0] + v[4])));
    }
    Ok(Image::from_values(extent, out)?)
}
