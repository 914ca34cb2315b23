//! Where a pixel's rays pass through it, and where on a ray its samples begin.

/// The points of a pixel in the unit cube: place in the pixel, and phase of the samples along the ray.
#[derive(Clone, Debug)]
pub(crate) struct Points {
    places: Vec<[f64; 3]>,
    /// Moves all points of a pixel by its own random amounts, modulo 1: places, and phases.
    move_places: bool,
    move_phases: bool,
    seed: u64,
    /// Random shift of all phases.
    shift: f64,
}

// Kronecker's sequence with the powers of the inverse of the plastic number's relatives: x³ = x + 1 for two dimensions, and the
// golden section for one. M. Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018.
const PLASTIC: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3];
const GOLDEN: f64 = 0.618_033_988_749_894_9;

impl Points {
    /// Points for `rays` rays a pixel. Square numbers are the centres of a grid of sub-pixels, others a rank-1 lattice with a random
    /// shift of its own in every pixel; `jitter` asks for the latter in every case, which makes a pixel's mean unbiased. A random
    /// phase does the same for the sum along the ray (over a grid, phases follow a lattice over the image with one random shift); a
    /// fixed one is 1/2.
    pub fn new(rays: u32, jitter: bool, random_phase: bool, seed: u64) -> Self {
        let side = rays.isqrt();
        let grid = !jitter && side * side == rays;
        let places = (0..rays)
            .map(|n| {
                let k = f64::from(n);
                let place = if grid {
                    let centre = |i: u32| (f64::from(i) + 0.5) / f64::from(side);
                    [centre(n % side), centre(n / side)]
                } else {
                    [k / f64::from(rays), (k * PLASTIC[0]).fract()]
                };
                let phase = match (random_phase, grid) {
                    (false, _) => 0.5,
                    (true, true) => (k * GOLDEN).fract(),
                    (true, false) => (k * PLASTIC[1]).fract(),
                };
                [place[0], place[1], phase]
            })
            .collect();
        Self { places, move_places: !grid, move_phases: random_phase, seed, shift: unit(mix(seed)) }
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
            let first = mix(self.seed ^ mix((y as u64) << 32 | x as u64));
            p[0] = wrap(p[0] + unit(first));
            p[1] = wrap(p[1] + unit(mix(first)));
            if self.move_phases {
                p[2] = wrap(p[2] + unit(mix(first ^ 0x5851_f42d_4c95_7f2d)));
            }
        } else if self.move_phases {
            // Phases of neighbouring pixels differ much, so that averages over pixels even them out.
            p[2] = (p[2] + self.shift + x as f64 * PLASTIC[0] + y as f64 * PLASTIC[1]).fract();
        }
        p
    }
}

#[inline(always)]
fn wrap(v: f64) -> f64 {
    if v >= 1.0 { v - 1.0 } else { v }
}

/// The top 53 bits as a number in [0, 1).
#[inline(always)]
fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 * (0.5f64).powi(53)
}

/// One round of SplitMix64 (G. Steele, D. Lea and C. Flood, *Fast splittable pseudorandom number generators*, OOPSLA 2014).
#[inline(always)]
fn mix(v: u64) -> u64 {
    let v = v.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let v = (v ^ (v >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let v = (v ^ (v >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    v ^ (v >> 31)
}
