//! The passes: Lambert's cosine, depth cue, colours, fixed-point amounts. Each is one loop over a batch.

use glam::{DMat3, DVec3};
use mcvr_scene::effects::{DepthRamp, Palette, Sides};
use mcvr_scene::{Camera, Density, Kernel, Look};
use mcvr_volume::{Grid, Voxel, with_voxels};

use crate::real::Real;
use mcvr_volume::{SimdLevel, vectorised};

/// Lists the samples of a batch that are inside the image, and their pixels.
pub(crate) fn compact(pixels: &[u32], miss: u32, live: &mut Vec<u32>, kept: &mut Vec<u32>) {
    live.clear();
    kept.clear();
    for (i, &pixel) in pixels.iter().enumerate() {
        if pixel < miss {
            live.push(i as u32);
            kept.push(pixel);
        }
    }
}

/// A symmetric quadratic form: xx, yy, zz, 2xy, 2xz, 2yz.
type Form = [f64; 6];

fn form(m: DMat3) -> Form {
    let c = m.to_cols_array_2d();
    [c[0][0], c[1][1], c[2][2], 2.0 * c[1][0], 2.0 * c[2][0], 2.0 * c[2][1]]
}

#[inline(always)]
fn quadratic(f: &Form, x: f64, y: f64, z: f64) -> f64 {
    x * (f[0] * x + f[3] * y + f[4] * z) + y * (f[1] * y + f[5] * z) + f[2] * z * z
}

/// The light in index space. With `A` the map from index to world, `∇ = A⁻ᵀ g` for index differences `g`, so
/// `∇·(A d) = g·d`: only lengths need the metric.
#[derive(Clone, Copy)]
pub(crate) struct Light {
    at: [f64; 3],
    /// `AᵀA`: squared length of an index vector in mm².
    length: Form,
    /// `(AᵀA)⁻¹`: squared length of an index gradient.
    slope: Form,
    minimum: f64,
    /// No sample has a larger cue, in 1/mm; 1 without one.
    pub largest_cue: f64,
}

impl Light {
    pub(crate) fn new(grid: &Grid, look: &Look, kernel: Kernel) -> Option<Self> {
        let position = look.light?;
        let to_world = grid.index_to_world().matrix3;
        let metric = to_world.transpose() * to_world;
        let at = grid.world_to_index().transform_point3(position);
        let (minimum, largest_cue) = (look.cue_minimum.unwrap_or(0.0), look.largest_cue(grid, kernel));
        Some(Self { at: at.to_array(), length: form(metric), slope: form(metric.inverse()), minimum, largest_cue })
    }

    /// Multiplies factors by Lambert's cosine.
    pub(crate) fn shade(
        &self,
        level: SimdLevel,
        sides: Sides,
        positions: [&[f64]; 3],
        gradients: [&[f64]; 3],
        factors: &mut [f64],
    ) {
        match sides {
            Sides::One => shade_batch::<OneSided>(level, self, positions, gradients, factors),
            Sides::Two => shade_batch::<TwoSided>(level, self, positions, gradients, factors),
        }
    }

    /// Multiplies factors by the depth cue over its largest value.
    pub(crate) fn cue(&self, level: SimdLevel, positions: [&[f64]; 3], factors: &mut [f64]) {
        cue_batch(level, self, positions, factors);
    }
}

/// What becomes of a cosine.
trait Face: Send + Sync {
    fn see(cosine: f64) -> f64;
}
struct OneSided;
struct TwoSided;
impl Face for OneSided {
    #[inline(always)]
    fn see(cosine: f64) -> f64 {
        if cosine > 0.0 { cosine } else { 0.0 }
    }
}
impl Face for TwoSided {
    #[inline(always)]
    fn see(cosine: f64) -> f64 {
        if cosine < 0.0 { -cosine } else { cosine }
    }
}

vectorised! {
    fn shade_batch<S: Face>(light: &Light, positions: [&[f64]; 3], gradients: [&[f64]; 3], factors: &mut [f64]) = shade_body::<S>
}

#[inline(always)]
fn shade_body<S: Face>(light: &Light, positions: [&[f64]; 3], gradients: [&[f64]; 3], factors: &mut [f64]) {
    let n = factors.len();
    let [px, py, pz] = positions.map(|s| &s[..n]);
    let [gx, gy, gz] = gradients.map(|s| &s[..n]);
    let (at, length, slope) = (light.at, light.length, light.slope);
    for i in 0..n {
        let (dx, dy, dz) = (at[0] - px[i], at[1] - py[i], at[2] - pz[i]);
        let toward = gx[i] * dx + gy[i] * dy + gz[i] * dz;
        let squared = quadratic(&slope, gx[i], gy[i], gz[i]) * quadratic(&length, dx, dy, dz);
        // Neither gradient nor way to the light: no face to see. Rounding may leave a cosine just above 1.
        let cosine = if squared > 0.0 { -toward / squared.sqrt() } else { 0.0 };
        let seen = S::see(cosine);
        factors[i] *= if seen < 1.0 { seen } else { 1.0 };
    }
}

vectorised! {
    fn cue_batch(light: &Light, positions: [&[f64]; 3], factors: &mut [f64]) = cue_body
}

#[inline(always)]
fn cue_body(light: &Light, positions: [&[f64]; 3], factors: &mut [f64]) {
    let n = factors.len();
    let [px, py, pz] = positions.map(|s| &s[..n]);
    let (at, length) = (light.at, light.length);
    for i in 0..n {
        let squared = quadratic(&length, at[0] - px[i], at[1] - py[i], at[2] - pz[i]);
        let distance = squared.sqrt();
        let bounded = if distance > light.minimum { distance } else { light.minimum };
        let share = 1.0 / (bounded * light.largest_cue);
        factors[i] *= if share < 1.0 { share } else { 1.0 };
    }
}

/// A colour that depends on the drawn voxel.
pub(crate) trait Voxelwise: Send + Sync {
    /// Multiplies colours by those of the voxels of the samples `live` of a batch.
    fn colour(&self, places: &[Vec<u32>; 3], live: &[u32], colours: &mut [Vec<f64>; 3]);
}

struct Paletted<'a, T> {
    voxels: &'a [T],
    dims: [usize; 3],
    slope: f64,
    intercept: f64,
    /// Colour per ordinal, for types that have them.
    table: Vec<[f64; 3]>,
    palette: &'a Palette,
}

/// The colours of a density's voxels: by table for 8 and 16 bits.
pub(crate) fn palette<'a>(density: &'a Density, palette: &'a Palette) -> Box<dyn Voxelwise + 'a> {
    fn make<'a, T: Voxel>(density: &'a Density, voxels: &'a [T], palette: &'a Palette) -> Box<dyn Voxelwise + 'a> {
        let volume = density.volume();
        let (slope, intercept) = (volume.slope(), volume.intercept());
        let first = if T::TYPE.name().starts_with('i') { T::TYPE.cardinality().unwrap_or(0) as f64 / 2.0 } else { 0.0 };
        let table = (0..T::TYPE.cardinality().unwrap_or(0))
            .map(|i| palette.colour(slope * (i as f64 - first) + intercept))
            .collect();
        Box::new(Paletted { voxels, dims: volume.grid().dims(), slope, intercept, table, palette })
    }
    with_voxels!(density.volume().voxels(), v => make(density, &v[..], palette))
}

impl<T: Voxel> Voxelwise for Paletted<'_, T> {
    fn colour(&self, places: &[Vec<u32>; 3], live: &[u32], colours: &mut [Vec<f64>; 3]) {
        let [nx, ny, _] = self.dims;
        let [r, g, b] = colours;
        let [px, py, pz] = places;
        for (((r, g), b), &i) in r.iter_mut().zip(g).zip(b).zip(live) {
            let i = i as usize;
            let (x, y, z) = (px[i] as usize, py[i] as usize, pz[i] as usize);
            let stored = self.voxels[x + nx * (y + ny * z)];
            let c = match stored.ordinal() {
                Some(o) => self.table[o],
                None => self.palette.colour(self.slope * stored.to_f64() + self.intercept),
            };
            *r *= c[0];
            *g *= c[1];
            *b *= c[2];
        }
    }
}

/// Depth (mm) as an affine function of the voxel index, and the ramp over it.
pub(crate) struct Ramp<'a> {
    ramp: &'a DepthRamp,
    constant: f64,
    along: DVec3,
}

impl<'a> Ramp<'a> {
    pub(crate) fn new(ramp: &'a DepthRamp, grid: &Grid, camera: &Camera) -> Self {
        let to_world = grid.index_to_world();
        let constant = camera.project(to_world.translation).2;
        Self { ramp, constant, along: to_world.matrix3.transpose() * camera.axis() }
    }

    /// Multiplies colours by those of the depths.
    pub(crate) fn colour(&self, positions: [&[f64]; 3], colours: &mut [Vec<f64>; 3]) {
        let [px, py, pz] = positions;
        let [r, g, b] = colours;
        let at = px.iter().zip(py).zip(pz);
        for (((r, g), b), ((x, y), z)) in r.iter_mut().zip(g).zip(b).zip(at) {
            let depth = self.constant + (self.along.x * x + self.along.y * y + self.along.z * z);
            let c = self.ramp.colour(depth);
            *r *= c[0];
            *g *= c[1];
            *b *= c[2];
        }
    }
}

vectorised! {
    /// Rounds factors to fixed point.
    pub(crate) fn amounts_grey(factors: &[f64], amounts: &mut [u64]) = amounts_grey_body
}

#[inline(always)]
fn amounts_grey_body(factors: &[f64], amounts: &mut [u64]) {
    for (a, f) in amounts.iter_mut().zip(factors) {
        // SAFETY: a factor is a weight of at most 2^40 times numbers in 0..=1.
        *a = unsafe { f.to_fixed() };
    }
}

vectorised! {
    /// Rounds factors times colours to fixed point, the three channels of a sample side by side.
    pub(crate) fn amounts_rgb(factors: &[f64], r: &[f64], g: &[f64], b: &[f64], amounts: &mut [u64]) = amounts_rgb_body
}

#[inline(always)]
fn amounts_rgb_body(factors: &[f64], r: &[f64], g: &[f64], b: &[f64], amounts: &mut [u64]) {
    let n = factors.len();
    let (r, g, b, amounts) = (&r[..n], &g[..n], &b[..n], &mut amounts[..3 * n]);
    for i in 0..n {
        // SAFETY: a factor is a weight of at most 2^40 times numbers in 0..=1, and so are colours.
        unsafe {
            amounts[3 * i] = (factors[i] * r[i]).to_fixed();
            amounts[3 * i + 1] = (factors[i] * g[i]).to_fixed();
            amounts[3 * i + 2] = (factors[i] * b[i]).to_fixed();
        }
    }
}
