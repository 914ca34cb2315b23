//! Replicates against their truth: Student's t over cells of at least 25 samples, Šidák's level over all tests.
//!
//! As in the crate's tests (`tests/common/agreement.rs`), but for two things. The share of samples by pixel, which only
//! chooses the cells, comes from an independent `count` image of 2^22 samples. And the variance of a cell's count, which for low-discrepancy
//! points can show R equal values, is never taken below 1/4 (of a sample), the largest that it can be at the floor.

use mcvr::scene::Image;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::Outcome;
use crate::truths::Truth;

/// Fewest samples that a replicate expects in a cell.
const LEAST: f64 = 25.0;
/// Share of the mean pixel that 32-bit positions may move across a pixel's border.
const ROUNDING: f64 = 1e-5;
/// Probability of a false alarm anywhere in the table.
pub const FAMILY: f64 = 1e-3;
/// Comparisons in the table.
const COMPARISONS: f64 = 81.0;

#[derive(Clone, Debug, Serialize)]
pub struct Agreement {
    pub replicates: usize,
    pub samples: u64,
    pub tests: usize,
    /// A p-value below this rejects.
    pub level: f64,
    /// The least likely cell.
    pub cell: String,
    pub t: f64,
    pub p: f64,
    pub passed: bool,
}

struct Cell {
    name: String,
    pixels: Vec<usize>,
}

/// Level of one of `n` tests.
fn sidak(family: f64, n: f64) -> f64 {
    -((-family).ln_1p() / n).exp_m1()
}

pub fn agreement(truth: &Truth, share: &Image, replicates: &[Image], samples: u64) -> Outcome<Agreement> {
    let cells = cells(share, samples as f64);
    let n = replicates.len() as f64;
    let student = StudentsT::new(0.0, 1.0, n - 1.0)?;
    let rounding = ROUNDING * truth.image.mean();
    let statistic = |cell: &Cell| {
        let sum = |image: &Image| cell.pixels.iter().map(|&p| image.values()[p]).sum::<f64>();
        let values: Vec<f64> = replicates.iter().map(sum).collect();
        let measured = values.iter().sum::<f64>() / n;
        let spread = values.iter().map(|v| (v - measured).powi(2)).sum::<f64>() / (n - 1.0);
        let (expected, counted) = (sum(&truth.image), sum(share) * samples as f64);
        let floor = 0.25 * (expected / counted).powi(2);
        let budget = sum(&truth.error) + rounding * cell.pixels.len() as f64;
        let off = measured - expected;
        off.signum() * (off.abs() - budget).max(0.0) / (spread.max(floor) / n).sqrt()
    };
    let worst = cells.iter().map(|c| (c, statistic(c))).max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    let Some((cell, t)) = worst else { return Err("no cell expects 25 samples".into()) };
    let p = 2.0 * student.sf(t.abs());
    let level = sidak(sidak(FAMILY, COMPARISONS), cells.len() as f64);
    Ok(Agreement {
        replicates: replicates.len(),
        samples,
        tests: cells.len(),
        level,
        cell: cell.name.clone(),
        t,
        p,
        passed: p >= level,
    })
}

/// Single pixels where enough samples fall, else runs of neighbours; every row and column; the whole.
fn cells(share: &Image, samples: f64) -> Vec<Cell> {
    let extent = share.extent();
    let enough = |pixels: &[usize]| pixels.iter().map(|&p| share.values()[p]).sum::<f64>() * samples >= LEAST;
    let mut cells: Vec<Cell> = vec![];
    let mut open = vec![];
    for p in 0..extent.pixels() {
        open.push(p);
        if enough(&open) {
            let name = format!("pixel ({}, {}) and {} before", p % extent.width, p / extent.width, open.len() - 1);
            cells.push(Cell { name, pixels: std::mem::take(&mut open) });
        }
    }
    let line = |name: String, pixels: Vec<usize>| Cell { name, pixels };
    let row = |y| line(format!("row {y}"), (0..extent.width).map(|x| x + y * extent.width).collect());
    let column = |x| line(format!("column {x}"), (0..extent.height).map(|y| x + y * extent.width).collect());
    let lines = (0..extent.height).map(row).chain((0..extent.width).map(column));
    cells.extend(lines.filter(|c| enough(&c.pixels)));
    cells.push(line("whole image".into(), (0..extent.pixels()).collect()));
    cells
}
