//! Replicates of an image against its expectation: Student's t over pixels, rows, columns and the whole.
//!
//! **Cells.** A test is on the sum of the image over a cell. Cells are single pixels where a replicate expects at
//! least [`LEAST`] samples in one (neighbours in row order are merged until it does), every row and every column
//! that expects as many, and the whole image. Large cells have the power against small errors of scale and
//! position that single pixels lack.
//!
//! **Null distribution.** Replicates are independent and, under the null, unbiased. Their mean over R ≥ 32
//! replicates sums at least 32 × 25 = 800 samples, so that it is normal to the depth used here: a Poisson count of
//! mean 800 lies six standard deviations above its mean with probability 2.2e-9 instead of 1.0e-9, and below it with
//! 4e-10. With an unknown variance the statistic is Student's with R - 1 degrees of freedom.
//!
//! **Discreteness.** A cell's count is an integer; if its expectation has the fractional part f, its variance is at
//! least f (1 - f). Low-discrepancy counts can sit at that floor and then show R equal values, whose deviation of 0
//! proves nothing; the sample variance is therefore never taken below the floor (in units of the mean weight).
//!
//! **Budget.** Known deviations come off the difference before it is tested: the reference's own estimate of its
//! error over the cell, and [`ROUNDING`] of the mean pixel per pixel for the samplers' 32-bit positions.
//!
//! **Many tests.** Over the T cells of one comparison and at most [`COMPARISONS`] comparisons in a file, the level is
//! Šidák's: a false alarm anywhere in the file has probability [`FAMILY`]. (Cells overlap, so the tests are
//! dependent; Bonferroni's bound, valid under any dependence, is the same to 0.05 %.)

use mcvr::scene::Image;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Fewest samples that a replicate expects in a cell.
pub const LEAST: f64 = 25.0;
/// Share of the mean pixel that rounding may move across a pixel's border: positions are good to about 1e-5 pixel.
pub const ROUNDING: f64 = 1e-5;
/// Probability of a false alarm in a whole file.
pub const FAMILY: f64 = 1e-3;
/// Most comparisons in a file.
pub const COMPARISONS: usize = 200;

/// What an image must converge to.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Expectation of each pixel.
    pub image: Image,
    /// Bound on the error of that, by pixel.
    pub error: Image,
    /// Share of the samples that each pixel expects: the `count` image.
    pub share: Image,
}

/// The least likely cell of a comparison.
#[derive(Clone, Debug)]
pub struct Worst {
    /// Which cell.
    pub cell: String,
    pub expected: f64,
    pub measured: f64,
    pub standard_error: f64,
    pub t: f64,
    pub p: f64,
}

/// The outcome of a comparison.
#[derive(Clone, Debug)]
pub struct Agreement {
    pub label: String,
    pub tests: usize,
    /// A p-value below this rejects.
    pub level: f64,
    pub worst: Worst,
}

impl Agreement {
    pub fn rejected(&self) -> bool {
        self.worst.p < self.level
    }

    /// Fails with the worst cell unless the images agree; gives the worst p-value over its level otherwise.
    pub fn hold(&self) -> f64 {
        assert!(!self.rejected(), "{self}");
        self.worst.p / self.level
    }
}

impl std::fmt::Display for Agreement {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Worst { cell, expected, measured, standard_error, t, p } = &self.worst;
        write!(
            f,
            "{}: {cell}: expected {expected:.6e}, measured {measured:.6e} ± {standard_error:.1e} (t = {t:.2}, p = \
             {p:.1e}; {} tests at level {:.1e})",
            self.label, self.tests, self.level
        )
    }
}

/// Šidák's level of one of `tests` tests for a level of the family.
pub fn sidak(family: f64, tests: usize) -> f64 {
    -((-family).ln_1p() / tests as f64).exp_m1()
}

/// Tests replicates of `samples` samples each against their truth.
pub fn agreement(label: impl Into<String>, truth: &Truth, replicates: &[Image], samples: u64) -> Agreement {
    assert!(replicates.len() >= 32, "the normal approximation needs 32 replicates");
    let cells = cells(truth, samples as f64);
    let student = StudentsT::new(0.0, 1.0, replicates.len() as f64 - 1.0).unwrap();
    let rounding = ROUNDING * truth.image.mean();
    let worst = cells
        .iter()
        .map(|(name, pixels)| test(name, pixels, truth, replicates, samples as f64, rounding, &student))
        .min_by(|a, b| a.p.total_cmp(&b.p).then(b.t.abs().total_cmp(&a.t.abs())))
        .expect("the whole image is a cell");
    Agreement { label: label.into(), tests: cells.len(), level: sidak(sidak(FAMILY, COMPARISONS), cells.len()), worst }
}

fn test(
    name: &str,
    pixels: &[usize],
    truth: &Truth,
    replicates: &[Image],
    samples: f64,
    rounding: f64,
    student: &StudentsT,
) -> Worst {
    let sum = |image: &Image| pixels.iter().map(|&p| image.values()[p]).sum::<f64>();
    let (expected, share) = (sum(&truth.image), sum(&truth.share));
    let budget = sum(&truth.error) + rounding * pixels.len() as f64;
    let n = replicates.len() as f64;
    let values: Vec<f64> = replicates.iter().map(sum).collect();
    let measured = values.iter().sum::<f64>() / n;
    let spread = values.iter().map(|v| (v - measured).powi(2)).sum::<f64>() / (n - 1.0);
    let fraction = (share * samples).fract();
    // Shares that are whole up to rounding have no floor.
    let floor = fraction * (1.0 - fraction) * (expected / (share * samples)).powi(2);
    let standard_error = (spread.max(floor) / n).sqrt();
    let beyond = ((measured - expected).abs() - budget).max(0.0) * (measured - expected).signum();
    let t = if beyond == 0.0 { 0.0 } else { beyond / standard_error };
    let p = if t.is_infinite() { 0.0 } else { 2.0 * student.sf(t.abs()) };
    Worst { cell: name.to_owned(), expected, measured, standard_error, t, p }
}

/// Pixels by cell, each cell with its name.
fn cells(truth: &Truth, samples: f64) -> Vec<(String, Vec<usize>)> {
    let extent = truth.share.extent();
    let share = truth.share.values();
    let enough = |pixels: &[usize]| pixels.iter().map(|&p| share[p]).sum::<f64>() * samples >= LEAST;
    let mut cells = vec![];
    let mut open = vec![];
    for p in 0..extent.pixels() {
        open.push(p);
        if enough(&open) {
            let (first, last) = (open[0], p);
            let at = |p: usize| format!("({}, {})", p % extent.width, p / extent.width);
            let name =
                if first == last { format!("pixel {}", at(p)) } else { format!("pixels {}..={}", at(first), at(last)) };
            cells.push((name, std::mem::take(&mut open)));
        }
    }
    if let Some((_, last)) = cells.last_mut() {
        last.append(&mut open);
    }
    let rows =
        (0..extent.height).map(|y| (format!("row {y}"), (0..extent.width).map(|x| x + y * extent.width).collect()));
    let columns =
        (0..extent.width).map(|x| (format!("column {x}"), (0..extent.height).map(|y| x + y * extent.width).collect()));
    cells.extend(rows.chain(columns).filter(|(_, pixels): &(String, Vec<usize>)| enough(pixels)));
    cells.push(("whole image".to_owned(), (0..extent.pixels()).collect()));
    cells
}

/// Fails when a sample lies where the truth is exactly 0 in a pixel and all its neighbours.
pub fn nothing_strays(label: &str, truth: &Truth, replicates: &[Image]) {
    let extent = truth.image.extent();
    let near = |c: usize, n: usize| c.saturating_sub(1)..(c + 2).min(n);
    for p in 0..extent.pixels() {
        let (x, y) = (p % extent.width, p / extent.width);
        let empty = near(y, extent.height)
            .all(|y| near(x, extent.width).all(|x| truth.image.get(x, y) == 0.0 && truth.error.get(x, y) == 0.0));
        if empty {
            assert!(replicates.iter().all(|i| i.get(x, y) == 0.0), "{label}: a sample in the empty pixel ({x}, {y})");
        }
    }
}
