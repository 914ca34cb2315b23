//! The error of an image, told from a few of its pixels.

use mcvr_scene::{Camera, Density, Estimand, Extent, Image, Watch};
use rand::RngExt;
use rand_pcg::Pcg64Dxsm;
use serde::Serialize;

use crate::draw::draw;
use crate::packet::{Along, Cast, Look, Packets, SIDE, Square};
use crate::points::Points;
use crate::{Counters, RayOptions, RaycastError};

/// What a few pixels tell of an image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SpotCheck {
    /// RMSE over the image's mean pixel.
    pub error: f64,
    /// Pixels that were compared; one may be drawn several times.
    pub pixels: u64,
    /// Work of the rays.
    pub counters: Counters,
}

/// Rays along the side of a pixel.
const RAYS: usize = 8;

/// Share of the pixels that are drawn wherever they are; the others are drawn in proportion to their values.
const ANYWHERE: f64 = 0.2;

/// Compares `pixels` of an image's pixels with what 8 by 8 rays in each see, integrated exactly (`tent`, without effects): what any method
/// has left wrong, unless it is finer than an eighth of a pixel. They are drawn without favour, weighted by how likely each was, so that
/// the expected square of the error is that of the image. `None` where rays are not cast in packets. The same number for any number of threads.
///
/// # Errors
/// [`RaycastError::Checked`] for an image that is not of the camera's size, [`RaycastError::Extent`] for an estimand that the grid does not
/// serve, [`RaycastError::Cancelled`] when `watch` said so.
pub fn spot_check(
    density: &Density,
    camera: &Camera,
    estimand: Estimand,
    image: &Image,
    pixels: usize,
    seed: u64,
    watch: &Watch,
) -> Result<Option<SpotCheck>, RaycastError> {
    RayOptions { estimand, ..RayOptions::default() }.check(density.volume().grid())?;
    let (Extent { width, height }, is) = (camera.extent(), image.extent());
    if is != camera.extent() {
        let text = format!(
            "it has {}x{} pixels, and the camera {width}x{height}; give that camera's image",
            is.width, is.height
        );
        return Err(RaycastError::Checked(text));
    }
    let whole = image.values().iter().map(|v| v.max(0.0)).sum::<f64>();
    let number = image.values().len();
    if whole <= 0.0 || number == 0 {
        let none = SpotCheck { error: 0.0, pixels: 0, counters: Counters::default() };
        return Ok(Some(none));
    }
    let share = |v: &f64| ANYWHERE / number as f64 + (1.0 - ANYWHERE) * v.max(0.0) / whole;
    let shares: Vec<f64> = image.values().iter().map(share).collect();
    let mut random = Pcg64Dxsm::new(u128::from(seed), 0x7370_6f74);
    let (drawn, weights) = draw(&shares, pixels.min(number), random.random());
    let of = |n: &usize| [n % width, n / width];
    let means = Packets::new(density).look(camera, estimand, watch, Pixels(drawn.iter().map(of).collect()));
    if watch.cancelled() {
        return Err(RaycastError::Cancelled);
    }
    let Some((means, counters)) = means else { return Ok(None) };
    let off = |(n, mean): (&usize, &f64)| (image.values()[*n] - mean) * (image.values()[*n] - mean);
    let sum = drawn.iter().zip(&means).map(off).zip(&weights).map(|(square, w)| w * square).sum::<f64>();
    let error = (sum / number as f64).sqrt() * number as f64 / whole;
    Ok(Some(SpotCheck { error, pixels: drawn.len() as u64, counters }))
}

/// Pixels whose means are wanted.
struct Pixels(Vec<[usize; 2]>);

impl Look for Pixels {
    type Out = (Vec<f64>, Counters);

    fn run(self, _: &[(usize, usize)], cast: &dyn Cast) -> Self::Out {
        const SQUARES: usize = RAYS / SIDE;
        let part = |[x, y]: &[usize; 2]| -> [Square; SQUARES * SQUARES] {
            std::array::from_fn(|n| [x * SQUARES + n % SQUARES, y * SQUARES + n / SQUARES].map(|v| v as u32))
        };
        let squares: Vec<Square> = self.0.iter().flat_map(part).collect();
        let points = Points::new(1, false, false, 0);
        let (seen, counters) = cast.squares(Along::Exact, 1.0 / RAYS as f64, &points, &squares);
        let mean = |parts: &[_]| {
            let sum: f64 = parts.iter().map(|s: &crate::packet::Seen| s.values.iter().sum::<f64>()).sum();
            sum / (RAYS * RAYS) as f64
        };
        (seen.chunks_exact(SQUARES * SQUARES).map(mean).collect(), counters)
    }
}
