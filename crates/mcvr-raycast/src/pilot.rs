//! A look at some places of an image, to know what errors rays would leave before they are cast.

use mcvr_scene::{Camera, Density, Estimand, Extent, Watch};
use rand::RngExt;
use rand_pcg::Pcg64Dxsm;
use serde::Serialize;

use crate::average::{self, Rays};
use crate::packet::{Along, Cast, Job, LANES, Look, Packets, Seen, Strip, TILE};
use crate::{Counters, RaycastError};

/// What a pilot found out. Errors are RMSE over the whole image, as shares of its mean pixel; they are of rays through the pixels'
/// centres, averaged over pixels from their neighbours ([`RayOptions::average`](crate::RayOptions::average)).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pilot {
    /// Tiles of 8 by 8 pixels whose rays can meet density; rays are cast in no others.
    pub tiles: u64,
    /// Lines of pixels that were looked at, each in a tile of its own where there are enough.
    pub looked_at: u64,
    /// Pixels of the image.
    pub pixels: u64,
    /// Mean pixel, from the lines looked at.
    pub mean: f64,
    /// What averaging over the pixels leaves, where that was looked at: not where blocks of pixels can share a ray.
    pub left: Option<f64>,
    /// What one exact ray for blocks of 2 by 2 and of 4 by 4 pixels leaves.
    pub blocks: [f64; 2],
    /// Distance of a comb's samples in units of the smallest voxel spacing, and the error that a comb leaves along the rays.
    pub combs: Vec<(f64, f64)>,
    /// Samples at a distance of 1 a ray, where rays are cast.
    pub steps: f64,
    /// Cells integrated exactly a ray, where rays are cast; of a quick look what is usual for the samples.
    pub cells: f64,
    /// Work of the pilot itself.
    pub counters: Counters,
}

impl Pilot {
    /// By what factor averaging over pixels lowers the errors of combs with `side` by `side` rays a pixel less than with one.
    pub fn noise(side: u32) -> f64 {
        average::noise(Rays::Grid(side)) / average::noise(Rays::Grid(1))
    }

    /// The same for one ray a block of `side` by `side` pixels.
    pub fn noise_of_block(side: u32) -> f64 {
        average::noise(Rays::Block(side)) / average::noise(Rays::Grid(1))
    }

    /// Looks at lines of pixels in up to `tiles` tiles of the image of `tent`, chosen at random by `seed`; `None` where rays are not cast
    /// in packets. Errors far below `wanted` are of no interest. The same numbers for any number of threads.
    ///
    /// # Errors
    /// [`RaycastError::Cancelled`] when `watch` said so, [`RaycastError::Image`] for an image that is too large.
    pub fn look(
        density: &Density,
        camera: &Camera,
        estimand: Estimand,
        (tiles, wanted): (usize, f64),
        seed: u64,
        watch: &Watch,
    ) -> Result<Option<Self>, RaycastError> {
        let spacing = density.volume().grid().spacing().min_element();
        let sight = Sight { tiles, wanted, seed, spacing, extent: camera.extent() };
        // Lines reach by up to a tile beyond the pixels.
        let wide = camera.in_blocks(1, TILE).map_err(|e| RaycastError::Image(e.to_string()))?;
        let pilot = Packets::new(density).look(&wide, estimand, watch, sight);
        if watch.cancelled() { Err(RaycastError::Cancelled) } else { Ok(pilot) }
    }
}

/// What a pilot is to look at.
struct Sight {
    tiles: usize,
    wanted: f64,
    seed: u64,
    spacing: f64,
    /// Of the image, around which there is a margin of a tile.
    extent: Extent,
}

/// Places along a line: the centres of eight pixels, and the rays of five blocks of two and of four pixels around the same middle.
#[rustfmt::skip]
const LINE: [f64; LANES] =
    [-3.5, -2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 3.5, -8.0, -4.0, -2.0, 0.0, 2.0, 4.0, 8.0, -6.0];

/// Lanes of the rays of five blocks of 2, and of 4 pixels.
const BLOCKS: [(u32, [usize; 5]); 2] = [(2, [9, 10, 11, 12, 13]), (4, [8, 9, 11, 13, 14])];

/// Pixels whose centres [`LINE`] holds.
const CENTRES: usize = 8;

/// Places a third of a pixel before and after the same eight centres.
const SIDES: [f64; LANES] = {
    let mut places = [0.0; LANES];
    let mut n = 0;
    while n < CENTRES {
        places[n] = LINE[n] - 1.0 / 3.0;
        places[n + CENTRES] = LINE[n] + 1.0 / 3.0;
        n += 1;
    }
    places
};

/// Cells that a ray crosses for every sample at a distance of 1: 1 along an axis, √3 along a diagonal.
const CELLS: f64 = 1.5;

/// The number whose bits are every second one of a number's.
fn every_second_bit(code: u64) -> usize {
    let shifts =
        [0x3333_3333_3333_3333, 0x0f0f_0f0f_0f0f_0f0f, 0x00ff_00ff_00ff_00ff, 0x0000_ffff_0000_ffff, 0xffff_ffff];
    let first = code & 0x5555_5555_5555_5555;
    // At most 32 bits.
    shifts.iter().enumerate().fold(first, |v, (n, mask)| (v | v >> (1 << n)) & mask) as usize
}

/// Tiles inside of a margin of one that are among the given ones or beside one of them, along a Z-shaped curve through the plane, so that
/// neighbours are near each other.
fn beside(tiles: &[(usize, usize)], [columns, rows]: [usize; 2]) -> Vec<(usize, usize)> {
    let side = (columns.max(rows) + 2).next_power_of_two();
    let mut among = vec![false; side * side];
    for (x, y) in tiles {
        for y in y.saturating_sub(1)..(y + 2).min(side) {
            for x in x.saturating_sub(1)..(x + 2).min(side) {
                among[y * side + x] |= (1..=columns).contains(&x) && (1..=rows).contains(&y);
            }
        }
    }
    let all = (0..(side * side) as u64).map(|code| (every_second_bit(code), every_second_bit(code >> 1)));
    all.filter(|(x, y)| among[y * side + x]).collect()
}

/// A first look at tiles, a coarse ray in every second row of them.
struct Glance {
    /// Mean value in the tiles.
    mean: f64,
    /// With what share of the lines a tile is to be looked at: more where it is bright, and where its neighbours differ.
    shares: Vec<f64>,
}

/// Samples of the first look lie so far apart, in units of the smallest voxel spacing.
const GLANCE: f64 = 8.0;

fn glance(
    tiles: &[(usize, usize)],
    [columns, rows]: [usize; 2],
    spacing: f64,
    random: &mut Pcg64Dxsm,
    cast: &dyn Cast,
    counters: &mut Counters,
) -> Glance {
    let stride = columns + 2;
    let mut wanted = vec![false; stride * (rows + 2)];
    // Two rows of tiles share a ray, that of the first.
    let first = |row: usize| row - (row + 1) % 2;
    tiles.iter().for_each(|(x, y)| wanted[first(*y) * stride + x] = true);
    let runs = (1..=rows).step_by(2).flat_map(|y| (1..=columns).step_by(LANES).map(move |x| (x, y)));
    let runs: Vec<(usize, usize)> =
        runs.filter(|(x, y)| wanted[y * stride + x..y * stride + (x + LANES).min(stride)].contains(&true)).collect();
    let strip = |(x, y): &(usize, usize)| Strip {
        middle: [(x * TILE) as f64, ((y + usize::from(*y < rows)) * TILE) as f64],
        upright: false,
    };
    let strips: Vec<Strip> = runs.iter().map(strip).collect();
    let places = std::array::from_fn(|l| (l * TILE + TILE / 2) as f64);
    let phases = strips.iter().map(|_| random.random()).collect();
    let (seen, work) = cast.strips(&[Job { along: Along::Comb(GLANCE * spacing), places, phases }], &strips);
    work.iter().for_each(|w| *counters += *w);
    let mut values = vec![0.0; wanted.len()];
    for ((x, y), seen) in runs.iter().zip(&seen) {
        let number = LANES.min(columns + 1 - x);
        values[y * stride + x..][..number].copy_from_slice(&seen[0].values[..number]);
    }
    let value = |x: usize, y: usize| values[first(y.clamp(1, rows)) * stride + x];
    let slope = |(x, y): (usize, usize)| {
        (value(x + 1, y) - value(x - 1, y)).abs() + 0.5 * (value(x, y + 2) - value(x, y.saturating_sub(2))).abs()
    };
    let number = tiles.len().max(1) as f64;
    let mean = tiles.iter().map(|(x, y)| value(*x, *y)).sum::<f64>() / number;
    let bend = tiles.iter().map(|t| slope(*t)).sum::<f64>() / number;
    let part = |v: f64, of: f64| if of > 0.0 { v / of } else { 1.0 };
    let share = |t: &(usize, usize)| 0.25 + 0.4 * part(value(t.0, t.1), mean) + 0.35 * part(slope(*t), bend);
    Glance { mean, shares: tiles.iter().map(|t| share(t) / number).collect() }
}

/// Draws so many from a list in proportion to their shares, evenly along it, begun at `start` in [0, 1): their places in the list, and what
/// each stands for beside one that is drawn with the share of all.
fn draw(shares: &[f64], number: usize, start: f64) -> (Vec<usize>, Vec<f64>) {
    let whole = shares.iter().sum::<f64>();
    let (mut at, mut sum) = (0, shares.first().copied().unwrap_or(0.0));
    let one = |n: usize| {
        let wanted = whole * (n as f64 + start) / number as f64;
        while sum <= wanted && at + 1 < shares.len() {
            at += 1;
            sum += shares[at];
        }
        (at, whole / (shares.len() as f64 * shares[at]))
    };
    (0..number).map(one).unzip()
}

/// What a line's rays tell of blocks of pixels: mean squares of their errors.
fn of_blocks(line: &[f64; LANES]) -> [f64; 2] {
    let inner = 2..CENTRES - 2;
    let truth: Vec<f64> = inner.map(|i| average::mean_of_pixel(&line[i - 2..=i + 2], 1)).collect();
    BLOCKS.map(|(side, lanes)| {
        let taps = Rays::Block(side).taps();
        let first = (truth.len() - taps.len()) / 2;
        let told = |taps: &[f64; 5]| taps.iter().zip(lanes).map(|(t, l)| t * line[l]).sum::<f64>();
        let square = |(t, truth): (&[f64; 5], &f64)| (told(t) - truth).powi(2);
        taps.iter().zip(&truth[first..]).map(square).sum::<f64>() / f64::from(side)
    })
}

impl Look for Sight {
    type Out = Pilot;

    fn run(self, full: &[(usize, usize)], cast: &dyn Cast) -> Pilot {
        let Self { tiles, wanted, seed, spacing, extent: Extent { width, height } } = self;
        let pixels = width * height;
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let mut random = Pcg64Dxsm::new(u128::from(seed), 0x7069_6c6f);
        let inside = |(x, y): &&(usize, usize)| (1..=columns).contains(x) && (1..=rows).contains(y);
        let full_inside = full.iter().filter(inside).count();
        // A line reaches a tile beyond its own.
        let inner = beside(full, [columns, rows]);
        let number = tiles.min(inner.len());
        let mut counters = Counters::default();
        let glance = glance(&inner, [columns, rows], spacing, &mut random, cast, &mut counters);
        let (chosen, weights) = draw(&glance.shares, number, random.random());
        let strips: Vec<Strip> = chosen
            .iter()
            .enumerate()
            .map(|(n, tile)| {
                let (tile, upright) = (inner[*tile], n % 2 == 1);
                // The line's middle lies between two pixels, the line in the middle of a row of pixels.
                let mut at = |tile: usize, along: bool| {
                    (tile * TILE + random.random_range(0..TILE)) as f64 + if along { 0.0 } else { 0.5 }
                };
                Strip { middle: [at(tile.0, !upright), at(tile.1, upright)], upright }
            })
            .collect();
        let mut phases = || -> Vec<[f64; LANES]> { strips.iter().map(|_| random.random()).collect() };
        let mut comb = |distance: f64| Job { along: Along::Comb(distance * spacing), places: LINE, phases: phases() };
        let exact = |places| Job { along: Along::Exact, places, phases: vec![[0.5; LANES]; number] };
        let mut run = |jobs: &[Job]| {
            let (seen, work) = cast.strips(jobs, &strips);
            work.iter().for_each(|w| counters += *w);
            seen
        };
        // What is to be told from noise: a comb so dense that its own error is small beside the one asked for, or exact rays.
        let (finest, coarse): (f64, &[f64]) = match wanted {
            w if w > 0.03 => (2.0, &[6.0, 16.0]),
            w if w > 0.01 => (1.0, &[3.0, 8.0]),
            _ => (0.0, &[1.0, 2.0, 4.0, 8.0]),
        };
        let mut jobs = vec![if finest > 0.0 { comb(finest) } else { exact(LINE) }];
        jobs.extend(coarse.iter().map(|d| comb(*d)));
        if finest == 0.0 {
            jobs.push(exact(SIDES));
        }
        let mut seen = run(&jobs);
        // From means over these tiles to those over the image: the others are dark.
        let share = ((inner.len() * TILE * TILE) as f64 / pixels as f64).min(1.0);
        let mean = share * glance.mean;
        let rms = |square: f64| if mean > 0.0 { (share * square).sqrt() / mean } else { 0.0 };
        // Mean over the tiles of what a line tells.
        let over = |seen: &[Vec<Seen>], of: &dyn Fn(&[Seen]) -> f64| {
            seen.iter().zip(&weights).map(|(s, w)| w * of(s)).sum::<f64>() / number.max(1) as f64
        };
        let error = |seen: &[Vec<Seen>], job: usize| {
            let of = |s: &[Seen]| {
                let squares = s[job].values.iter().zip(&s[0].values).map(|(c, e)| (c - e) * (c - e));
                squares.sum::<f64>() / LANES as f64
            };
            average::noise(Rays::Grid(1)) * rms(over(seen, &of))
        };
        let errors = |seen: &[Vec<Seen>], of: &[f64]| -> Vec<(f64, f64)> {
            of.iter().enumerate().map(|(n, d)| (*d, error(seen, n + 1))).collect()
        };
        // Terms of both axes add up; each was looked at along half of the lines.
        let blocks = |seen: &[Vec<Seen>]| [0, 1].map(|n: usize| rms(2.0 * over(seen, &|s| of_blocks(&s[0].values)[n])));
        let left = |seen: &[Vec<Seen>], job: usize| {
            let of = |s: &[Seen]| {
                let (before, after) = s[job].values.split_at(CENTRES);
                average::left([before, &s[0].values[..CENTRES], after])
            };
            rms(2.0 * over(seen, &of))
        };
        // Rays visit the depths of all tiles that their line meets; those of an image visit their own tile's.
        let lit = LANES as f64 * over(&seen, &|s| f64::from(u8::from(s[0].share > 0.0)));
        let a_ray = |seen: &[Vec<Seen>], job: usize, of: fn(&Seen) -> u64| {
            over(seen, &|s| of(&s[job]) as f64 * s[job].share) / lit.max(1e-3)
        };
        let mut steps = a_ray(&seen, 1, |s| s.samples) * coarse[0];
        let mut found = (errors(&seen, coarse), blocks(&seen), None, CELLS * steps);
        if finest == 0.0 {
            found.2 = Some(left(&seen, coarse.len() + 1));
            found.3 = a_ray(&seen, 0, |s| s.cells);
        } else if found.1[0] > wanted || found.0[0].1 > 0.5 * wanted {
            let finer = [1.0, 2.0];
            let mut jobs = vec![exact(LINE)];
            jobs.extend(finer.map(&mut comb));
            jobs.push(exact(SIDES));
            let more = run(&jobs);
            let coarser = found.0.into_iter().filter(|(d, _)| *d > 2.0);
            found = (
                errors(&more, &finer).into_iter().chain(coarser).collect(),
                blocks(&more),
                Some(left(&more, 3)),
                a_ray(&more, 0, |s| s.cells),
            );
            steps = a_ray(&more, 1, |s| s.samples) * finer[0];
            seen = more;
        }
        let (combs, blocks, left, cells) = found;
        Pilot {
            tiles: full_inside as u64,
            looked_at: seen.len() as u64,
            pixels: pixels as u64,
            mean,
            left,
            blocks,
            combs,
            steps,
            cells,
            counters,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_beside_tiles_come_along_a_curve() {
        // Columns 1 to 5 and rows 1 to 3 are inside.
        let full = [(0, 0), (6, 4), (4, 2)];
        let tiles = beside(&full, [5, 3]);
        let mut sorted = tiles.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, [(1, 1), (3, 1), (3, 2), (3, 3), (4, 1), (4, 2), (4, 3), (5, 1), (5, 2), (5, 3)]);
        let code =
            |(x, y): &(usize, usize)| (0..8).fold(0, |c, b| c | (x >> b & 1) << (2 * b) | (y >> b & 1) << (2 * b + 1));
        assert!(tiles.is_sorted_by_key(code));
        assert!(
            (0..70_000)
                .all(|c| code(&(every_second_bit(c) & 255, every_second_bit(c >> 1) & 255)) == c as usize & 0xffff)
        );
    }

    /// Sums by what is drawn, and what it stands for, are those of the whole, whatever the shares.
    #[test]
    fn draws_stand_for_the_whole() {
        let shares: Vec<f64> = (0..40).map(|n| if n % 7 == 3 { 9.0 } else { 0.5 + f64::from(n % 3) }).collect();
        let value = |n: usize| (n * n % 11) as f64;
        let truth = (0..40).map(value).sum::<f64>() / 40.0;
        let of = |start: f64| {
            let (drawn, weights) = draw(&shares, 16, start);
            drawn.iter().zip(&weights).map(|(n, w)| w * value(*n)).sum::<f64>() / 16.0
        };
        let mean = (0..4000).map(|n| of((f64::from(n) + 0.5) / 4000.0)).sum::<f64>() / 4000.0;
        assert!((mean - truth).abs() < 1e-3 * truth, "{mean} {truth}");
        assert_eq!(draw(&[], 0, 0.5), (vec![], vec![]));
    }

    /// A line of a polynomial of degree 4 is told exactly by blocks; a spike is not.
    #[test]
    fn blocks_are_judged_by_their_pixels() {
        let mean = |x: f64| {
            let whole = |x: f64| x.powi(5) / 5.0 - x.powi(3) / 3.0 + x;
            whole(x + 0.5) - whole(x - 0.5)
        };
        let value = |x: f64| x.powi(4) - x * x + 1.0;
        assert!((average::mean_of_pixel(&[-2.0, -1.0, 0.0, 1.0, 2.0].map(value), 1) - mean(0.0)).abs() < 1e-12);
        let smooth = of_blocks(&LINE.map(value));
        assert!(smooth.iter().all(|e| *e < 1e-18), "{smooth:?}");
        let spike = of_blocks(&LINE.map(|x| if x == 0.5 { 1.0 } else { 0.0 }));
        assert!(spike[0] > 0.4 && spike[1] > 0.2, "{spike:?}");
    }
}
