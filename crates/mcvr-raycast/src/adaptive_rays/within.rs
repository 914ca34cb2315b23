//! Several rays in a pixel, where one is too few.

use mcvr_scene::{Extent, Image};

use super::needs::Needs;
use super::raster::Raster;
use super::rounds::{DOUBT, Rounds};
use super::{FINEST, MARGIN};
use crate::packet::{SIDE, Seen, Square};

/// Factor on squared errors when rays in a pixel are twice as close: the fourth power, as for kinks. On phantoms 1/29 at the median, 1/9 at
/// worst, along the grid's axes.
const FALL: f64 = 1.0 / 16.0;

impl Rounds<'_> {
    /// Casts several rays a pixel where they are needed: candidates are of 2 by 2 pixels at first, then of one.
    pub(super) fn within_pixels(&mut self, raster: &Raster, candidates: Vec<Square>, needs: Needs, image: &mut Image) {
        let Extent { width, height } = self.scene.extent;
        let (mut at, mut needs, mut side) = (candidates, needs, 2);
        let mut rays: u32 = 2;
        loop {
            // Squares of rays along a candidate.
            let squares = side * rays / SIDE as u32;
            // That of a pixel's rays, and of the quarter as many before.
            let noise = 5.0 / f64::from(rays * rays);
            let mut finer = vec![];
            loop {
                let next = self.next(&mut needs, FALL);
                if next.is_empty() {
                    break;
                }
                let parts = |n: &usize| {
                    let [x, y] = at[*n].map(|v| v * squares);
                    (0..squares).flat_map(move |dy| (0..squares).map(move |dx| [x + dx, y + dy]))
                };
                let all: Vec<Square> = next.iter().flat_map(parts).collect();
                let seen = self.squares(self.options.comb, f64::from(rays).recip(), &all);
                let mut found = Vec::with_capacity(next.len());
                for (n, seen) in next.iter().zip(seen.chunks_exact((squares * squares) as usize)) {
                    let mut sum = (0.0, 0.0);
                    let noise = noise * seen.iter().map(|s| s.noise).sum::<f64>() / seen.len() as f64;
                    for (dx, dy) in (0..side).flat_map(|dy| (0..side).map(move |dx| (dx, dy))) {
                        let [x, y] = [at[*n][0] * side + dx, at[*n][1] * side + dy].map(|v| v as usize);
                        if x < MARGIN || y < MARGIN || x >= MARGIN + width || y >= MARGIN + height {
                            continue;
                        }
                        let mean =
                            mean_of(seen, rays, side, [dx, dy]) + raster.curvature(x, y) / f64::from(24 * rays * rays);
                        let pixel = &mut image.values_mut()[(y - MARGIN) * width + x - MARGIN];
                        let square = (mean - *pixel) * (mean - *pixel);
                        *pixel = mean;
                        sum = (sum.0 + square, sum.1 + noise);
                        finer.push(([x as u32, y as u32], (square - DOUBT * noise).max(0.0)));
                    }
                    found.push(sum);
                }
                needs.found(&next, found.into_iter());
            }
            self.left += needs.left();
            if rays < FINEST {
                share_with_neighbours(&mut finer, width + 2 * MARGIN);
            }
            // Of the pixels that were given rays.
            let rest = FALL * finer.iter().map(|(_, square)| square).sum::<f64>();
            if rays == FINEST || rest <= self.budget() || self.scene.watch.cancelled() {
                self.left += rest;
                return;
            }
            needs = Needs::new(finer.iter().map(|(_, square)| FALL * square));
            at = finer.into_iter().map(|(at, _)| at).collect();
            (rays, side) = (2 * rays, 1);
        }
    }
}

/// Gives half of what was found at every pixel to the pixels around it that were looked at, itself among them: where an image is rough, two
/// means may agree by chance.
fn share_with_neighbours(found: &mut [([u32; 2], f64)], across: usize) {
    let Some(last) = found.iter().map(|(at, _)| at[1]).max() else { return };
    let mut squares = vec![f64::NAN; across * (last as usize + 2)];
    let place = |[x, y]: [u32; 2]| y as usize * across + x as usize;
    found.iter().for_each(|(at, square)| squares[place(*at)] = *square);
    for (at, square) in found {
        let (mut sum, mut number) = (0.0, 0.0);
        for row in 0..3 {
            let first = place(*at) + row * across - across - 1;
            for v in squares[first..first + 3].iter().filter(|v| !v.is_nan()) {
                (sum, number) = (sum + v, number + 1.0);
            }
        }
        *square = 0.5 * (*square + sum / number);
    }
}

/// Mean of the rays of one pixel of a candidate of `side` pixels, with `rays` along a pixel's side.
fn mean_of(squares: &[Seen], rays: u32, side: u32, [dx, dy]: [u32; 2]) -> f64 {
    if side > 1 {
        // A square holds 2 by 2 rays of each of 2 by 2 pixels.
        let first = (dy as usize * 2) * SIDE + dx as usize * 2;
        let v = &squares[0].values;
        return 0.25 * ((v[first] + v[first + 1]) + (v[first + SIDE] + v[first + SIDE + 1]));
    }
    squares.iter().flat_map(|s| s.values).sum::<f64>() / f64::from(rays * rays)
}
