//! Where a pixel's rays pass through it, and where on a ray its samples begin.

/// The points of a pixel in the unit cube: place in the pixel, and phase of the samples along the ray.
#[derive(Clone, Debug)]
pub(crate) struct Points {
    places: Vec<[f64; 3]>,
    /// Sides of a stratum.
    stratum: [f64; 2],
    /// Whether places are random within their strata, and phases random.
    move_places: bool,
    move_phases: bool,
    seed: u64,
    /// Random shift of all phases.
    shift: f64,
}

// Multiples of these, modulo 1, lie evenly in one and in two dimensions: the golden section, and powers of the inverse of the plastic
// number, x³ = x + 1. M. Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018.
const PLASTIC: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3];
const GOLDEN: f64 = 0.618_033_988_749_894_9;

impl Points {
    /// Points for `rays` rays a pixel. Square numbers are the centres of a grid of sub-pixels, others a random point in each of as many
    /// strata; `jitter` asks for the latter in every case, which makes a pixel's mean unbiased, with an error of `R^-1` where the image
    /// is smooth (METHOD section 4). A random phase does the same for the sum along the ray: phases of a pixel's rays lie evenly, from
    /// a random start in every pixel, or (over a grid) from a lattice over the image with one random shift. A fixed one is 1/2.
    pub fn new(rays: u32, jitter: bool, random_phase: bool, seed: u64) -> Self {
        // The most nearly square arrangement of strata, at least as many columns as rows.
        let rows = (1..=rays.isqrt()).rev().find(|r| rays.is_multiple_of(*r)).unwrap_or(1);
        let columns = rays / rows;
        let grid = !jitter && columns == rows;
        let (width, height) = (1.0 / f64::from(columns), 1.0 / f64::from(rows));
        let places = (0..rays)
            .map(|n| {
                let within = if grid { 0.5 } else { 0.0 };
                let place = [f64::from(n % columns) + within, f64::from(n / columns) + within];
                let phase = if random_phase { (f64::from(n) * GOLDEN).fract() } else { 0.5 };
                [place[0] * width, place[1] * height, phase]
            })
            .collect();
        let stratum = [width, height];
        Self { places, stratum, move_places: !grid, move_phases: random_phase, seed, shift: unit(mix(seed)) }
    }

    pub fn rays(&self) -> u32 {
        // Made from a `u32`.
        self.places.len() as u32
    }

    /// Place of a ray in its pixel, and its phase, all in [0, 1).
    #[inline(always)]
    pub fn of(&self, x: usize, y: usize, ray: u32) -> [f64; 3] {
        let mut p = self.places[ray as usize];
        if self.move_places {
            let pixel = mix(self.seed ^ mix((y as u64) << 32 | x as u64));
            let first = mix(pixel ^ u64::from(ray));
            p[0] += self.stratum[0] * unit(first);
            p[1] += self.stratum[1] * unit(mix(first));
            if self.move_phases {
                p[2] = fraction(p[2] + unit(pixel));
            }
        } else if self.move_phases {
            // Phases of neighbouring pixels differ much, so that averages over pixels even them out.
            p[2] = fraction(p[2] + self.shift + x as f64 * PLASTIC[0] + y as f64 * PLASTIC[1]);
        }
        p
    }
}

/// `fract` of numbers from 0 to 2^53, without a call on processors of which no more than SSE2 is known.
#[inline(always)]
fn fraction(v: f64) -> f64 {
    v - v as i64 as f64
}

/// The top 53 bits as a number in [0, 1).
#[inline(always)]
fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 * (0.5f64).powi(53)
}

/// One round of SplitMix64 (G. Steele, D. Lea and C. Flood, *Fast splittable pseudorandom number generators*, OOPSLA 2014).
#[inline(always)]
pub(crate) fn mix(v: u64) -> u64 {
    let v = v.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let v = (v ^ (v >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let v = (v ^ (v >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    v ^ (v >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(points: &Points, x: usize, y: usize) -> Vec<[f64; 3]> {
        (0..points.rays()).map(|r| points.of(x, y, r)).collect()
    }

    #[test]
    fn one_ray_is_the_centre_and_square_numbers_are_a_grid_of_centres() {
        assert_eq!(all(&Points::new(1, false, false, 7), 3, 4), [[0.5, 0.5, 0.5]]);
        let four = [[0.25, 0.25, 0.5], [0.75, 0.25, 0.5], [0.25, 0.75, 0.5], [0.75, 0.75, 0.5]];
        assert_eq!(all(&Points::new(4, false, false, 7), 3, 4), four);
    }

    #[test]
    fn jittered_points_hold_one_per_stratum_and_differ_from_pixel_to_pixel() {
        for (rays, columns, rows) in [(1, 1.0, 1.0), (2, 2.0, 1.0), (6, 3.0, 2.0), (7, 7.0, 1.0), (16, 4.0, 4.0)] {
            let points = Points::new(rays, true, true, 1);
            let places = all(&points, 1, 2);
            let mut strata: Vec<_> = places.iter().map(|p| ((p[0] * columns) as u32, (p[1] * rows) as u32)).collect();
            strata.sort_unstable();
            strata.dedup();
            assert_eq!(strata.len(), rays as usize);
            assert!(places.iter().flatten().all(|v| (0.0..1.0).contains(v)));
            assert_ne!(places, all(&points, 2, 1));
            assert_eq!(places, all(&Points::new(rays, true, true, 1), 1, 2));
        }
    }

    /// Means over pixels, and over seeds, of places and phases are 1/2, and neighbours are independent.
    #[test]
    fn random_points_are_uniform() {
        let n = 40_000;
        let mut sums = [0.0; 5];
        for k in 0..n {
            let points = Points::new(1, true, true, k / 100);
            let (a, b) = (points.of((k % 100) as usize, 0, 0), points.of((k % 100) as usize + 1, 0, 0));
            (0..3).for_each(|c| sums[c] += a[c] - 0.5);
            sums[3] += (a[0] - 0.5) * (b[0] - 0.5) * 12.0;
            sums[4] += (a[0] - 0.5) * (a[1] - 0.5) * 12.0;
        }
        // Standard deviations of one term: 1/√12, and 1 for the products.
        for (c, sum) in sums.into_iter().enumerate() {
            let sigma = if c < 3 { (1.0 / 12f64).sqrt() } else { 1.0 };
            assert!(sum.abs() < 5.0 * sigma * (n as f64).sqrt(), "moment {c}: {sum}");
        }
    }
}
