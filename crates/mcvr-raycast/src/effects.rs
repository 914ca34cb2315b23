//! The reference image with effects.

use std::time::Instant;

use mcvr_scene::effects::Look;
use mcvr_scene::{Camera, Density, Image, Kernel};

use crate::adaptive::{Pixels, Task, whole_sum};
use crate::error::check_extents;
use crate::lit::LitField;
use crate::reference::{image_of, rms};
use crate::{Counters, ErrorEstimate, RaycastError, ReferenceOptions, Watch, reference};

/// A reference image with effects.
#[derive(Clone, Debug, PartialEq)]
pub struct LookReference {
    /// The finished channels ([`Look::tint`] applied): one, or red, green and blue when [`Look::is_coloured`]. In the
    /// estimand's unit; with a depth cue, over mm.
    pub channels: Vec<Image>,
    /// Error of each channel, that of the integrals along the rays included. Its `rel_rmse_estimate` refers to the mean
    /// of all channels, its `tolerance` is in the channel's unit.
    pub errors: Vec<ErrorEstimate>,
    /// Root mean square of all channels' error estimates over the mean of all channels.
    pub rel_rmse_estimate: f64,
    /// Work done.
    pub counters: Counters,
    /// Wall time in seconds, preparation included.
    pub seconds: f64,
}

/// Computes the reference image with effects: adaptive along the rays (the integrand is no polynomial any more) and over
/// the pixels. The same image, bit for bit, for any number of threads.
///
/// A look that [is plain](Look::is_plain) takes the exact way of [`reference()`]. Otherwise `tolerance` is the largest
/// error estimate of a pixel as a share of the mean pixel of all channels (before the tint), a twentieth of it allotted
/// to the errors along the rays. With shading or cue (and a kernel other than `box`) a pixel's estimate is two standard
/// errors of squares whose errors have independent signs, where the plain reference takes their sum. `watch` hears of
/// every finished row.
///
/// # Errors
/// As [`reference()`].
pub fn reference_with_look(
    density: &Density,
    camera: &Camera,
    look: &Look,
    options: &ReferenceOptions,
    watch: &Watch,
) -> Result<LookReference, RaycastError> {
    let start = Instant::now();
    options.check()?;
    check_extents(density.volume().grid())?;
    let (channels, counters) = if look.is_plain() {
        let r = reference(density, camera, options, watch)?;
        (vec![(r.image, r.error)], r.counters)
    } else {
        let spline = options.kernel == Kernel::Bspline3;
        match (look.channels(), spline) {
            (3, false) => run::<3, 4>(density, camera, look, options, watch)?,
            (3, true) => run::<3, 10>(density, camera, look, options, watch)?,
            (_, false) => run::<1, 4>(density, camera, look, options, watch)?,
            (_, true) => run::<1, 10>(density, camera, look, options, watch)?,
        }
    };
    let (images, mut errors): (Vec<_>, Vec<_>) = finish(look, channels).into_iter().unzip();
    let mean = images.iter().map(Image::mean).sum::<f64>() / images.len() as f64;
    let share = |rms: f64| if rms == 0.0 { 0.0 } else { rms / mean };
    let mut square = 0.0;
    for e in &mut errors {
        let rms = rms(&e.image);
        square += rms * rms / images.len() as f64;
        e.rel_rmse_estimate = share(rms);
    }
    let rel_rmse_estimate = share(square.sqrt());
    Ok(LookReference { channels: images, errors, rel_rmse_estimate, counters, seconds: start.elapsed().as_secs_f64() })
}

type Channels = Vec<(Image, ErrorEstimate)>;

fn run<const C: usize, const N: usize>(
    density: &Density,
    camera: &Camera,
    look: &Look,
    options: &ReferenceOptions,
    watch: &Watch,
) -> Result<(Channels, Counters), RaycastError> {
    let field = LitField::<C, N>::new(density, camera, look, options);
    let grid = density.volume().grid();
    let cue = look.cue_minimum.map_or(1.0, |minimum| look.cue(minimum, grid.centre()));
    let task = Task {
        camera,
        grid,
        view: field.view(),
        bounds: field.bounds(),
        options,
        fallback: cue * whole_sum(density, camera, options.estimand),
        watch,
    };
    let Pixels { values, errors, tolerance, depth_limited, counters } = task.run(&field)?;
    let channels = (0..C).map(|c| {
        let image = |v: &[[f64; C]]| image_of(camera, v.iter().map(|v| v[c]));
        let error = ErrorEstimate { image: image(&errors), rel_rmse_estimate: 0.0, tolerance, depth_limited };
        (image(&values), error)
    });
    Ok((channels.collect(), counters))
}

/// Applies the tint.
fn finish(look: &Look, channels: Channels) -> Channels {
    let count = if look.is_coloured() { 3 } else { 1 };
    let tinted = |c: usize| {
        let tint = look.tint[c];
        let (mut image, mut error) = channels[c.min(channels.len() - 1)].clone();
        for v in image.values_mut().iter_mut().chain(error.image.values_mut()) {
            *v *= tint;
        }
        error.tolerance *= tint;
        (image, error)
    };
    (0..count).map(tinted).collect()
}
