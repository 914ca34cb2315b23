//! A named piece of work that is run alone, again and again.

use super::BenchError;

/// A piece of the program by name. Deterministic: every run does the same work.
pub struct Stage {
    /// `group/what`, for example `render/tent-line`.
    pub name: String,
    /// What an element of its work is: `voxel`, `sample`, `point`, `step`, `cell`, `ray`.
    pub unit: &'static str,
    prepare: Box<dyn Fn() -> Result<Prepared, BenchError> + Send + Sync>,
}

impl Stage {
    /// A stage whose work is made ready by `prepare`.
    pub(super) fn new(
        name: impl Into<String>,
        unit: &'static str,
        prepare: impl Fn() -> Result<Prepared, BenchError> + Send + Sync + 'static,
    ) -> Self {
        Self { name: name.into(), unit, prepare: Box::new(prepare) }
    }

    /// Makes everything ready that is not the stage's own work: volumes, distributions, cameras.
    ///
    /// # Errors
    /// When its scene cannot be made.
    pub fn prepare(&self) -> Result<Prepared, BenchError> {
        (self.prepare)()
    }
}

impl std::fmt::Debug for Stage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Stage").field("name", &self.name).field("unit", &self.unit).finish_non_exhaustive()
    }
}

type Work = Box<dyn FnMut() -> Result<u64, BenchError> + Send>;

/// A stage that is ready to run.
pub struct Prepared {
    /// Elements of one run.
    pub elements: u64,
    work: Work,
}

impl Prepared {
    /// Work of so many elements, repeated in every run so often that a run can be timed. The work gives a number that depends
    /// on all of it, so that no compiler leaves it out.
    pub(super) fn new(
        elements: u64,
        repeats: u64,
        mut work: impl FnMut() -> Result<u64, BenchError> + Send + 'static,
    ) -> Self {
        let repeated = move || {
            let mut sum = 0u64;
            for _ in 0..repeats {
                sum = sum.wrapping_add(std::hint::black_box(work()?));
            }
            Ok(sum)
        };
        Self { elements: elements * repeats, work: Box::new(repeated) }
    }

    /// One run.
    ///
    /// # Errors
    /// What the work said.
    pub fn run(&mut self) -> Result<u64, BenchError> {
        counted_stage_run(&mut self.work)
    }
}

/// Callgrind counts inside this function and nowhere else: it finds it by its name.
#[inline(never)]
fn counted_stage_run(work: &mut Work) -> Result<u64, BenchError> {
    std::hint::black_box(work())
}

impl std::fmt::Debug for Prepared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Prepared").field("elements", &self.elements).finish_non_exhaustive()
    }
}
