//! Tiles of pixels whose rays meet no density. What is known there is known for certain, and no polynomial may say otherwise.

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

    fn rows(&self) -> impl Iterator<Item = &[bool]> {
        self.lit.chunks_exact(self.columns)
    }

    /// Whether a square of so many pixels along its side meets a tile that is not dark.
    pub fn meets(&self, at: &Square, side: usize) -> bool {
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
        let (side, across) = (TILE / pitch, raster.across);
        for (tiles, band) in self.rows().zip(raster.values.chunks_exact_mut(side * across)) {
            for row in band.chunks_exact_mut(across) {
                blacken(tiles, row, side);
            }
        }
    }

    /// The same of an image without its margin.
    pub fn over_image(&self, image: &mut Image) {
        let width = image.extent().width;
        let first = MARGIN / TILE;
        for (y, row) in image.values_mut().chunks_exact_mut(width).enumerate() {
            let tiles = &self.lit[(y / TILE + first) * self.columns..][first..self.columns];
            blacken(tiles, row, TILE);
        }
    }
}

fn blacken(tiles: &[bool], row: &mut [f64], side: usize) {
    for (values, _) in row.chunks_mut(side).zip(tiles).filter(|(_, lit)| !**lit) {
        values.fill(0.0);
    }
}
