//! Effects as passes over a batch of projected samples. A scene's passes are put together once per image, from its
//! [`Look`]; what the look does not ask for is not there, and the plain X-ray has none of this.

pub(crate) mod gradient;
mod passes;
mod positions;

use mcvr_scene::{Camera, Density, Estimand, Kernel, Look};
use mcvr_volume::Grid;

use self::gradient::{CORNERS, Gradients, STENCIL, Stored};
use self::passes::{Light, Ramp, Voxelwise, amounts_grey, amounts_rgb, compact, palette};
use self::positions::Place;
use crate::engine::Counters;
use crate::expose::Scratch;
use crate::projection::{LEAST_UNITS, Projection};
use crate::{GradientSource, RenderOptions, SamplingError, SimdLevel};

/// The passes of one image.
pub(crate) struct EffectPasses<'a> {
    place: Box<dyn Place>,
    gradients: Option<(Box<dyn Gradients + 'a>, u64)>,
    light: Option<Light>,
    palette: Option<Box<dyn Voxelwise + 'a>>,
    ramp: Option<Ramp<'a>>,
    look: &'a Look,
    level: SimdLevel,
    /// Largest value of all factors together; amounts are relative to it.
    largest: f64,
    /// What each sample weighs before the effects when it carries no `line` weight.
    unit: f64,
    field_voxels: u64,
}

/// Arrays of one worker for the effects, reused from batch to batch; one entry per sample inside the image.
#[derive(Default)]
pub(crate) struct Layers {
    /// Pixel of each sample.
    pub pixels: Vec<u32>,
    /// Fixed-point amounts for that pixel, the channels of a sample side by side.
    pub amounts: Vec<u64>,
    live: Vec<u32>,
    positions: [Vec<f64>; 3],
    gradients: [Vec<f64>; 3],
    factors: Vec<f64>,
    colours: [Vec<f64>; 3],
}

/// Refuses a depth cue whose largest value, next to the light, leaves the others no digits.
fn check_cue(
    look: &Look,
    grid: &Grid,
    kernel: Kernel,
    projection: &Projection,
    estimand: Estimand,
) -> Result<(), SamplingError> {
    let (Some(minimum), Some(light)) = (look.cue_minimum, look.light) else { return Ok(()) };
    let far = grid.corners(kernel.support()).into_iter().map(|c| (c - light).length()).fold(minimum, f64::max);
    let units = projection.faintest_units(estimand);
    if units >= LEAST_UNITS * far * look.largest_cue(grid, kernel) {
        return Ok(());
    }
    Err(SamplingError::Limit {
        method: "depth-cue",
        problem: format!(
            "a sample {minimum:e} mm from the light (depth-cue.minimum) outshines one at {far:.3} mm by more than fixed point \
             holds; use a minimum of at least {:.2e} mm",
            LEAST_UNITS * far / units
        ),
    })
}

impl<'a> EffectPasses<'a> {
    /// Puts the passes together for a density, which must outlive them.
    pub(crate) fn new(
        density: &'a Density,
        camera: &Camera,
        look: &'a Look,
        projection: &Projection,
        options: &RenderOptions,
        level: SimdLevel,
    ) -> Result<Self, SamplingError> {
        let kernel = options.kernel;
        let grid = density.volume().grid();
        let stored = options.gradients == GradientSource::Stored && look.shading.is_some();
        let gradients = match look.shading {
            None => None,
            Some(_) if stored => Some((Box::new(Stored::new(density, level)?) as Box<dyn Gradients>, CORNERS)),
            Some(_) => Some((gradient::lazy(density, level), STENCIL)),
        };
        let light = Light::new(grid, look, kernel);
        let largest = light.as_ref().map_or(1.0, |l| l.largest_cue);
        check_cue(look, grid, kernel, projection, options.estimand)?;
        Ok(Self {
            place: positions::place(projection.precision(), kernel, grid, level),
            gradients,
            light,
            palette: look.palette.as_ref().map(|p| palette(density, p)),
            ramp: look.ramp.as_ref().map(|r| Ramp::new(r, grid, camera)),
            look,
            level,
            largest,
            unit: 2f64.powi(projection.weight_bits() as i32),
            field_voxels: if stored { Stored::voxels(grid.dims()) } else { 0 },
        })
    }

    /// What an amount of 1 stands for: in units of a fixed-point weight for `line`, of a sample for `count`.
    pub(crate) fn unit(&self, estimand: Estimand) -> f64 {
        match estimand {
            Estimand::Line => self.largest,
            Estimand::Count => self.largest / self.unit,
        }
    }

    /// Voxels of the stored gradient field, 0 without one.
    pub(crate) fn field_voxels(&self) -> u64 {
        self.field_voxels
    }

    /// Turns a projected batch into pixels and amounts. Samples outside the image are dropped first, so nothing is
    /// computed for them.
    pub(crate) fn apply(&self, scratch: &mut Scratch, miss: u32, counters: &mut Counters) {
        let Scratch { points, places, pixels, weights, layers, .. } = scratch;
        let Layers { pixels: kept, amounts, live, positions, gradients, factors, colours } = layers;
        compact(pixels, miss, live, kept);
        let n = live.len();
        factors.clear();
        match (&weights.narrow[..], &weights.wide[..]) {
            ([], []) => factors.resize(n, self.unit),
            ([], wide) => factors.extend(live.iter().map(|&i| wide[i as usize] as f64)),
            (narrow, _) => factors.extend(live.iter().map(|&i| f64::from(narrow[i as usize]))),
        }
        if self.light.is_some() || self.ramp.is_some() {
            self.place.fill(places, &points.uniforms, live, positions);
        }
        let at = |a: usize| &positions[a][..];
        if let Some((source, reads)) = &self.gradients {
            for column in gradients.iter_mut() {
                column.resize(n, 0.0);
            }
            let [gx, gy, gz] = gradients;
            source.fill([at(0), at(1), at(2)], [gx, gy, gz]);
            counters.gradients += n as u64;
            counters.gradient_reads += reads * n as u64;
        }
        if let Some(light) = &self.light {
            if let Some(sides) = self.look.shading {
                let [gx, gy, gz] = &*gradients;
                light.shade(self.level, sides, [at(0), at(1), at(2)], [gx, gy, gz], factors);
            }
            if self.look.cue_minimum.is_some() {
                light.cue(self.level, [at(0), at(1), at(2)], factors);
                counters.depth_cues += n as u64;
            }
        }
        let channels = self.look.channels();
        amounts.resize(channels * n, 0);
        if channels == 1 {
            amounts_grey(self.level, factors, amounts);
            return;
        }
        for column in colours.iter_mut() {
            column.clear();
            column.resize(n, 1.0);
        }
        if let Some(palette) = &self.palette {
            palette.colour(places, live, colours);
            counters.voxel_colours += n as u64;
        }
        if let Some(ramp) = &self.ramp {
            ramp.colour([at(0), at(1), at(2)], colours);
            counters.depth_colours += n as u64;
        }
        let [r, g, b] = &*colours;
        amounts_rgb(self.level, factors, r, g, b, amounts);
    }
}
