//! The exact integral along single rays, prepared once per density and kernel.

use mcvr_scene::{Camera, Density, Estimand, Kernel};
use mcvr_volume::{Grid, Voxel};

use crate::cell::{BoxCell, SplineCell, TentCell};
use crate::error::check_extents;
use crate::field::{Visit, Weigh, with_field};
use crate::view::View;
use crate::walk::{CellField, RayField};
use crate::{Counters, RaycastError};

/// Integrates the field of a density and a kernel exactly along rays (METHOD section 7).
///
/// Making one scans every voxel about once for the map of empty bricks (1/512 byte per voxel); it can then serve
/// any number of cameras and threads.
pub struct Integrator<'a> {
    density: &'a Density,
    kernel: Kernel,
    field: Box<dyn RayField + 'a>,
}

impl<'a> Integrator<'a> {
    /// Prepares the field.
    ///
    /// # Errors
    /// [`RaycastError::Shell`] for the kernel `shell`, [`RaycastError::Extent`] for an axis of more than 2^30 voxels.
    pub fn new(density: &'a Density, kernel: Kernel) -> Result<Self, RaycastError> {
        check_extents(density.volume().grid())?;
        if kernel == Kernel::Shell {
            return Err(RaycastError::Shell);
        }
        let field = with_field(density, MakeField { kernel, dims: density.volume().grid().dims() });
        Ok(Self { density, kernel, field })
    }

    /// The density.
    pub fn density(&self) -> &'a Density {
        self.density
    }

    /// The kernel.
    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// This integrator's rays for a camera.
    pub fn view(&self, camera: &Camera, estimand: Estimand) -> Rays<'_> {
        let grid = self.density.volume().grid();
        let view = View::new(camera, grid, estimand, self.density.mass(), self.kernel.support());
        let squared = view.squared();
        Rays { field: &*self.field, view, squared }
    }

    /// The box around all density, in index coordinates.
    pub(crate) fn index_bounds(&self) -> ([f64; 3], [f64; 3]) {
        let (low, high) = self.field.bounds();
        let support = self.kernel.support();
        (low.map(|v| v - support), high.map(|v| v - support))
    }
}

/// Length of a pixel's side in voxels, at the far end of a box given in index coordinates.
pub(crate) fn coarsest_pixel(camera: &Camera, grid: &Grid, view: &View, low: [f64; 3], high: [f64; 3]) -> f64 {
    let corners = projected_corners(camera, grid, low, high);
    let depth = corners.iter().map(|c| c.2).fold(f64::NEG_INFINITY, f64::max);
    view.pixel_in_voxels(depth)
}

/// Pixel coordinates and depths of the corners of a box given in index coordinates.
fn projected_corners(camera: &Camera, grid: &Grid, low: [f64; 3], high: [f64; 3]) -> [(f64, f64, f64); 8] {
    let to_world = grid.index_to_world();
    std::array::from_fn(|corner| {
        let index: [f64; 3] = std::array::from_fn(|a| if corner >> a & 1 == 0 { low[a] } else { high[a] });
        camera.project(to_world.transform_point3(index.into()))
    })
}

/// Columns and rows of the pixels to which a box (index coordinates) can project, as half-open ranges
/// `[x0, x1, y0, y1]` within the image; the whole image when the box reaches before a pinhole's near plane.
pub(crate) fn outline(camera: &Camera, grid: &Grid, low: [f64; 3], high: [f64; 3]) -> [usize; 4] {
    let (width, height) = (camera.extent().width, camera.extent().height);
    let mut span = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
    for (px, py, z) in projected_corners(camera, grid, low, high) {
        if !camera.is_parallel() && z < camera.near() {
            return [0, width, 0, height];
        }
        span = [span[0].min(px), span[1].max(px), span[2].min(py), span[3].max(py)];
    }
    // One pixel of margin for rounding; `as` saturates.
    let clamp = |v: f64, n: usize| (v.max(0.0) as usize).min(n);
    let [x0, x1, y0, y1] = span;
    let (x0, x1) = (clamp(x0.floor() - 1.0, width), clamp(x1.ceil() + 1.0, width));
    let (y0, y1) = (clamp(y0.floor() - 1.0, height), clamp(y1.ceil() + 1.0, height));
    [x0, x1.max(x0), y0, y1.max(y0)]
}

/// The rays of one camera through one field, for one estimand.
pub struct Rays<'a> {
    field: &'a dyn RayField,
    view: View,
    squared: bool,
}

impl Rays<'_> {
    pub(crate) fn view(&self) -> &View {
        &self.view
    }

    /// The estimand's density at the image point (px, py): `∫ ρ dl` in weight units times mm for `line`,
    /// `(1/F) ∫ ρ / line_factor dl` per pixel area for `count`. Its mean over a pixel is the pixel's value.
    #[inline]
    pub fn integrate(&self, px: f64, py: f64, counters: &mut Counters) -> f64 {
        let (ray, factor) = self.view.ray(px, py);
        factor * self.field.integrate(&ray, self.squared, counters)
    }
}

struct MakeField {
    kernel: Kernel,
    dims: [usize; 3],
}

impl<'a> Visit<'a, f64> for MakeField {
    type Out = Box<dyn RayField + 'a>;

    fn run<T: Voxel, W: Weigh<T, f64> + Send + 'a>(self, voxels: &'a [T], weights: W) -> Self::Out {
        match self.kernel {
            Kernel::Box => Box::new(CellField::<T, W, BoxCell>::new(voxels, weights, self.dims)),
            Kernel::Bspline3 => Box::new(CellField::<T, W, SplineCell>::new(voxels, weights, self.dims)),
            // `Integrator::new` has refused shell.
            Kernel::Tent | Kernel::Shell => Box::new(CellField::<T, W, TentCell>::new(voxels, weights, self.dims)),
        }
    }
}
