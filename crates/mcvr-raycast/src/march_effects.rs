//! The plain ray march with effects: what a GPU's ray caster with shading does, in `f64`.

use std::time::Instant;

use glam::{DMat3, DVec3};
use mcvr_scene::effects::Look;
use mcvr_scene::{Camera, Density, Image, Kernel};

use crate::field::with_field;
use crate::line::spline;
use crate::neighbours::{MakeNeighbours, Neighbours, Stencil, corner};
use crate::points::Points;
use crate::reference::image_of;
use crate::rows::pixels;
use crate::view::View;
use crate::{Counters, MarchImage, MarchOptions, RayOptions, RaycastError, Watch, cast_rays, march};

/// A marched image with effects.
#[derive(Clone, Debug, PartialEq)]
pub struct LookMarch {
    /// The finished channels ([`Look::tint`] applied): one, or red, green and blue when [`Look::is_coloured`].
    pub channels: Vec<Image>,
    /// Work done; `evaluations` are steps.
    pub counters: Counters,
    /// Wall time in seconds, preparation included.
    pub seconds: f64,
}

/// Marches rays through the field with the look's factors at every step where there is any density. Steps and rays are
/// those of [`march()`], which does the work itself when the look [is plain](Look::is_plain). The same image, bit for
/// bit, for any number of threads. `watch` hears of every finished row.
///
/// # Errors
/// As [`march()`].
pub fn march_with_look(
    density: &Density,
    camera: &Camera,
    look: &Look,
    options: &MarchOptions,
    watch: &Watch,
) -> Result<LookMarch, RaycastError> {
    let start = Instant::now();
    if look.is_plain() {
        return Ok(LookMarch::tinted(camera, look, march(density, camera, options, watch)?));
    }
    options.check(density.volume().grid())?;
    let (values, counters) = rows(density, camera, look, options, watch);
    if watch.cancelled() {
        return Err(RaycastError::Cancelled);
    }
    let count = if look.is_coloured() { 3 } else { 1 };
    let channel = |c: usize| image_of(camera, values.iter().map(|v: &[f64; 3]| v[c] * look.tint[c]));
    Ok(LookMarch { channels: (0..count).map(channel).collect(), counters, seconds: start.elapsed().as_secs_f64() })
}

impl LookMarch {
    /// An image without effects along its rays, in the look's colour.
    fn tinted(camera: &Camera, look: &Look, MarchImage { mut image, counters, seconds }: MarchImage) -> Self {
        let channel = |t: &f64| image_of(camera, image.values().iter().map(|v| v * t));
        let channels = if look.is_coloured() {
            look.tint.iter().map(channel).collect()
        } else {
            if look.tint[0] != 1.0 {
                image.values_mut().iter_mut().for_each(|v| *v *= look.tint[0]);
            }
            vec![image]
        };
        Self { channels, counters, seconds }
    }
}

/// Casts exact rays ([`cast_rays()`]) for a look without effects along the ray; its tint counts.
///
/// # Errors
/// As [`cast_rays()`], and [`RaycastError::Effects`] for a look that is not plain.
pub fn cast_rays_with_look(
    density: &Density,
    camera: &Camera,
    look: &Look,
    options: &RayOptions,
    watch: &Watch,
) -> Result<LookMarch, RaycastError> {
    if !look.is_plain() {
        return Err(RaycastError::Effects);
    }
    Ok(LookMarch::tinted(camera, look, cast_rays(density, camera, options, watch)?))
}

fn rows(
    density: &Density,
    camera: &Camera,
    look: &Look,
    options: &MarchOptions,
    watch: &Watch,
) -> (Vec<[f64; 3]>, Counters) {
    let volume = density.volume();
    let grid = volume.grid();
    let rays = &options.rays;
    let support = rays.kernel.support();
    let low = [-support; 3];
    let high = grid.dims().map(|n| n as f64 - 1.0 + support);
    let make = MakeNeighbours { volume, palette: look.palette.as_ref(), taps: 2 * support.ceil() as usize };
    let (neighbours, _) = with_field(density, make);
    let to_gradient = grid.world_to_index().matrix3.transpose();
    let sampler = Sampler { neighbours, look, kernel: rays.kernel, to_gradient };
    let view = View::new(camera, grid, rays.estimand, density.mass(), 0.0);
    let points = Points::new(rays.rays_per_pixel, rays.jitter, options.random_phase, rays.seed);
    let share = 1.0 / f64::from(rays.rays_per_pixel);
    let spacing = options.step * grid.spacing().min_element();
    let outline = crate::integrator::outline(camera, grid, low, high);
    let mut values = vec![[0.0; 3]; camera.extent().pixels()];
    let counters = pixels(&mut values, camera, outline, watch, |stencil: &mut Stencil, x, y, counters| {
        let mut sum = [0.0; 3];
        for ray in 0..points.rays() {
            let [dx, dy, phase] = points.of(x, y, ray);
            let (px, py) = (x as f64 + dx, y as f64 + dy);
            let (ray, factor) = view.ray(px, py);
            let world = view.world(px, py);
            counters.rays += 1;
            let Some((from, to)) = ray.clip(low, high) else { continue };
            // As in the march without effects.
            let dt = spacing * camera.depth_rate(px, py);
            let first = (from / dt - phase).ceil();
            let steps = ((to / dt - phase).ceil() - first) as u64;
            counters.evaluations += steps;
            for s in 0..steps {
                let t = (first + s as f64 + phase) * dt;
                let u = DVec3::from(ray.origin) + DVec3::from(ray.direction) * t;
                let at = world.origin + world.direction * t;
                let value = sampler.at(u, at, world.depth + t, stencil, counters);
                let weight = dt * factor * if view.squared() { t * t } else { 1.0 };
                sum.iter_mut().zip(value).for_each(|(s, v)| *s += weight * v);
            }
        }
        sum.map(|s| s * share)
    });
    (values, counters)
}

/// The integrand at single points.
struct Sampler<'a> {
    neighbours: Box<dyn Neighbours + 'a>,
    look: &'a Look,
    kernel: Kernel,
    to_gradient: DMat3,
}

impl Sampler<'_> {
    /// At a continuous index, given the world position and the depth as well.
    fn at(&self, u: DVec3, world: DVec3, depth: f64, stencil: &mut Stencil, counters: &mut Counters) -> [f64; 3] {
        let cell = u.floor();
        let local = (u - cell).to_array();
        let first = [cell.x as i32 - 1, cell.y as i32 - 1, cell.z as i32 - 1];
        let wide = self.kernel == Kernel::Bspline3;
        if !self.neighbours.density(first, wide, stencil, counters) {
            return [0.0; 3];
        }
        let rho = |w: &[f64; 64]| match self.kernel {
            Kernel::Box => {
                let bit = |a: usize| usize::from(local[a] >= 0.5) << a;
                w[corner(bit(0) | bit(1) | bit(2))]
            }
            Kernel::Bspline3 => spline(w, local),
            Kernel::Tent | Kernel::Shell => interpolate(std::array::from_fn(|n| [w[corner(n)]]), local)[0],
        };
        let density = if self.look.palette.is_some() {
            [0, 1, 2].map(|c| rho(&stencil.tinted[c]))
        } else {
            [rho(&stencil.weights); 3]
        };
        if density == [0.0; 3] {
            return density;
        }
        let factor = self.look.factor(world, depth, || {
            counters.gradients += 1;
            if !wide {
                self.neighbours.surround(first, stencil, counters);
            }
            self.to_gradient * DVec3::from(interpolate(stencil.differences(), local))
        });
        [0, 1, 2].map(|c| density[c] * factor[c])
    }
}

/// Trilinear interpolation.
fn interpolate<const N: usize>(corners: [[f64; N]; 8], [x, y, z]: [f64; 3]) -> [f64; N] {
    let lerp = |a: [f64; N], b: [f64; N], t: f64| -> [f64; N] { std::array::from_fn(|n| a[n] + t * (b[n] - a[n])) };
    let along = |n: usize| lerp(corners[n], corners[n + 1], x);
    lerp(lerp(along(0), along(2), y), lerp(along(4), along(6), y), z)
}
