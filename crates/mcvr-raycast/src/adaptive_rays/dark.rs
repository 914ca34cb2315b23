//! Tiles of pixels whose rays meet no density. What is known there is known for certain, and no polynomial may say otherwise.

use std::ops::Range;

use super::MARGIN;
use super::raster::Raster;
use crate::packet::{SIDE, Square, TILE};
use mcvr_scene::{Extent, Image};

/// The tiles of an image and its margin.
pub(super) struct Dark {
    /// Whether a tile can have density, row by row.
    lit: Vec<bool>,
    columns: usize,
}

/// The whole number of squares of the widest distance that hold so many pixels, and the margin.
pub(super) fn region(pixels: usize) -> usize {
    pixels.next_multiple_of(MARGIN) + 2 * MARGIN
}

impl Dark {
    /// All tiles but these are dark.
    pub fn beside(full: &[(usize, usize)], extent: Extent) -> Self {
        let [columns, rows] = [extent.width, extent.height].map(|n| region(n) / TILE);
        let mut lit = vec![false; columns * rows];
        full.iter().for_each(|(x, y)| lit[y * columns + x] = true);
        Self { lit, columns }
    }

    /// Whether a square of so many pixels along its side meets a tile that is not dark.
    pub fn meets(&self, at: &Square, side: usize) -> bool {
        if side <= TILE && TILE.is_multiple_of(side) {
            let [x, y] = at.map(|n| n as usize / (TILE / side));
            return self.lit[y * self.columns + x];
        }
        let tiles = |n: u32| n as usize * side / TILE..((n as usize + 1) * side).div_ceil(TILE);
        tiles(at[1]).any(|y| self.lit[y * self.columns..][tiles(at[0])].contains(&true))
    }

    /// All squares of rays at a distance that meet a tile that is not dark.
    pub fn squares(&self, pitch: usize) -> Vec<Square> {
        let side = SIDE * pitch;
        let [across, down] = [self.columns, self.lit.len() / self.columns].map(|n| (n * TILE / side) as u32);
        let all = (0..down).flat_map(|y| (0..across).map(move |x| [x, y]));
        all.filter(|at| self.meets(at, side)).collect()
    }

    /// Brings values at a distance of `pitch` pixels in dark tiles to 0.
    pub fn over_raster(&self, raster: &mut Raster, pitch: usize) {
        let across = raster.across;
        self.over_rows(&mut raster.values, across, TILE / pitch, 0);
    }

    /// The same of an image without its margin.
    pub fn over_image(&self, image: &mut Image) {
        let width = image.extent().width;
        self.over_rows(image.values_mut(), width, TILE, MARGIN / TILE);
    }

    /// Rows of values of which `side` lie in a tile, the first in the tile `first` along both axes.
    fn over_rows(&self, values: &mut [f64], across: usize, side: usize, first: usize) {
        let mut runs: Vec<Range<usize>> = vec![];
        for (tiles, band) in self.lit.chunks_exact(self.columns).skip(first).zip(values.chunks_mut(side * across)) {
            runs.clear();
            let dark = tiles[first..].iter().enumerate().filter(|(_, lit)| !**lit);
            for (n, from) in dark.map(|(n, _)| (n, n * side)).take_while(|(_, from)| *from < across) {
                let end = ((n + 1) * side).min(across);
                match runs.last_mut().filter(|run| run.end == from) {
                    Some(run) => run.end = end,
                    None => runs.push(from..end),
                }
            }
            for row in band.chunks_exact_mut(across) {
                runs.iter().for_each(|run| row[run.clone()].fill(0.0));
            }
        }
    }
}
