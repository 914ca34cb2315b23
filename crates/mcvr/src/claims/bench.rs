//! The place where claims are tested: one scenery, its truth, and times that are taken side by side.

use std::cell::OnceCell;
use std::sync::atomic::{AtomicBool, Ordering};

use mcvr_harness::fit::{ErrorsAt, FLOOR_FACTOR};
use mcvr_harness::{Comparison, PhaseSeconds, SlopeFit, Spread, Truth};
use mcvr_scene::Watch;
use rayon::ThreadPool;

use super::ClaimError;
use crate::{Made, Method, Request, Scenery, make};

/// What a test run may take.
#[derive(Clone, Debug)]
pub struct Options {
    /// How often everything that is timed is repeated.
    pub repeats: u32,
    /// Longest sides, in voxels, of the volumes that `data-size` compares.
    pub sizes: Vec<usize>,
    /// Bytes of memory that may be taken; `None` where the system does not tell.
    pub free_memory: Option<u64>,
}

impl Options {
    /// Longest sides by default.
    pub const SIZES: [usize; 7] = [64, 96, 128, 192, 256, 384, 512];
    /// Longest sides that are added on request: a gigavoxel.
    pub const LARGE: [usize; 2] = [768, 1024];
}

/// One thing to time.
pub(super) struct Job<'a> {
    pub scenery: &'a Scenery,
    pub request: Request,
    /// Whether on one thread instead of all.
    pub one: bool,
}

/// Times of a job, round by round.
pub(super) type Rounds = Vec<PhaseSeconds>;

/// A scenery with what it takes to test claims on it.
pub struct Bench<'a> {
    pub(super) scenery: &'a Scenery,
    pub(super) request: Request,
    pub(super) options: &'a Options,
    /// Name of the input as given: `phantom:` ones can be made at other sizes.
    pub(super) input: &'a str,
    one: ThreadPool,
    cancel: &'a AtomicBool,
    progress: &'a dyn Fn(&str),
    truth: OnceCell<Truth>,
}

impl<'a> Bench<'a> {
    /// A plain X-ray of `scenery` as `request` has it; its method and budget are replaced by those of each measurement, its
    /// tolerance is that of the truth.
    ///
    /// # Errors
    /// [`rayon::ThreadPoolBuildError`] when a thread cannot be started.
    pub fn new(
        scenery: &'a Scenery,
        request: Request,
        input: &'a str,
        options: &'a Options,
        cancel: &'a AtomicBool,
        progress: &'a dyn Fn(&str),
    ) -> Result<Self, rayon::ThreadPoolBuildError> {
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
        Ok(Self { scenery, request, options, input, one, cancel, progress, truth: OnceCell::new() })
    }

    /// What goes on now.
    pub(super) fn say(&self, what: &str) {
        (self.progress)(what);
    }

    pub(super) fn check_cancelled(&self) -> Result<(), ClaimError> {
        if self.cancel.load(Ordering::Relaxed) { Err(ClaimError::Cancelled) } else { Ok(()) }
    }

    /// The request for a method and a budget.
    pub(super) fn with(&self, method: Method, samples: u64) -> Request {
        Request { method, samples, ..self.request }
    }

    /// A ray march with one ray a pixel and a step in voxels.
    pub(super) fn one_ray(&self, step: f64) -> Request {
        Request { step, ..self.with(Method::March, self.scenery.camera.extent().pixels() as u64) }
    }

    /// A job on this scenery and all threads.
    pub(super) fn job(&self, request: Request) -> Job<'a> {
        Job { scenery: self.scenery, request, one: false }
    }

    pub(super) fn make(&self, request: &Request) -> Result<Made, ClaimError> {
        self.run(&self.job(*request))
    }

    fn run(&self, job: &Job<'_>) -> Result<Made, ClaimError> {
        let watch = Watch { progress: None, cancel: Some(self.cancel) };
        let made = || make(job.scenery, &job.request, &watch);
        Ok(if job.one { self.one.install(made)? } else { made()? })
    }

    /// The ray-cast image, made once.
    pub(super) fn truth(&self) -> Result<&Truth, ClaimError> {
        if let Some(truth) = self.truth.get() {
            return Ok(truth);
        }
        self.say("ray casting the truth");
        let made = self.make(&self.with(Method::Exact, 1))?;
        let seconds = made.seconds.complete;
        let rel_error_estimate = made.error.unwrap_or(f64::INFINITY);
        if made.image.mean() <= 0.0 {
            return Err(ClaimError::NotTestable("the truth is black: the camera sees nothing of the volume".into()));
        }
        Ok(self.truth.get_or_init(|| Truth { image: made.image, rel_error_estimate, seconds }))
    }

    /// The error of an image against the truth, RMSE over the mean pixel.
    ///
    /// # Errors
    /// [`ClaimError::NotTestable`] below ten times the truth's own error, where a measured error means nothing.
    pub(super) fn error_of(&self, made: &Made) -> Result<f64, ClaimError> {
        let truth = self.truth()?;
        let error = Comparison::of(&made.image, &truth.image)?.rel_rmse.unwrap_or(f64::NAN);
        let floor = FLOOR_FACTOR * truth.rel_error_estimate;
        if error >= floor {
            return Ok(error);
        }
        Err(ClaimError::NotTestable(format!(
            "an error of {error:.2e} is less than ten times the truth's own, {:.2e}; a smaller --tolerance may show it",
            truth.rel_error_estimate
        )))
    }

    /// Errors over at most three seeds: they hardly differ, as each is the mean over all pixels.
    pub(super) fn errors(&self, request: &Request) -> Result<Vec<f64>, ClaimError> {
        let seeds = u64::from(self.options.repeats.clamp(1, 3));
        let error = |i| {
            let seed = self.request.seed.wrapping_add(i);
            self.error_of(&self.make(&Request { seed, ..*request })?)
        };
        (0..seeds).map(error).collect()
    }

    /// Times every job once a round, so that a slower minute of the machine falls on all of them; every other round runs
    /// backwards, so that none always follows the same one.
    pub(super) fn rounds(&self, jobs: &[Job<'_>], repeats: u32) -> Result<Vec<Rounds>, ClaimError> {
        let mut all = vec![Rounds::new(); jobs.len()];
        for round in 0..repeats.max(1) {
            self.say(&format!("timing, round {} of {}", round + 1, repeats.max(1)));
            for i in 0..jobs.len() {
                let i = if round % 2 == 0 { i } else { jobs.len() - 1 - i };
                self.check_cancelled()?;
                all[i].push(self.run(&jobs[i])?.seconds);
            }
        }
        Ok(all)
    }
}

/// Seconds of one view, its distribution ready.
pub(super) fn per_view(seconds: &PhaseSeconds) -> f64 {
    seconds.sampling + seconds.projection
}

/// Seconds of a complete image from a volume in memory.
pub(super) fn complete(seconds: &PhaseSeconds) -> f64 {
    seconds.complete
}

/// Seconds until samples can be drawn.
pub(super) fn distribution(seconds: &PhaseSeconds) -> f64 {
    seconds.distribution
}

/// The spread of one clock over the rounds.
pub(super) fn spread(rounds: &Rounds, clock: fn(&PhaseSeconds) -> f64) -> Spread {
    Spread::of(rounds.iter().map(clock).collect())
}

/// The spread of a clock's ratio between two jobs, taken round by round.
pub(super) fn ratio(over: &Rounds, under: &Rounds, clock: fn(&PhaseSeconds) -> f64) -> Spread {
    Spread::of(over.iter().zip(under).map(|(a, b)| clock(a) / clock(b)).collect())
}

/// The exponent of medians against a count (voxels, samples). The medians are fitted, as one round that the machine disturbed
/// must not bend the line.
pub(super) fn exponent(points: impl IntoIterator<Item = (u64, f64)>) -> Result<SlopeFit, ClaimError> {
    let points: Vec<ErrorsAt> =
        points.into_iter().map(|(samples, value)| ErrorsAt { samples, errors: vec![value] }).collect();
    SlopeFit::of(&points, 0.0)
        .ok_or_else(|| ClaimError::NotTestable("an exponent needs at least two different counts".into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ratios_are_taken_round_by_round() {
        let at = |complete| PhaseSeconds { complete, ..PhaseSeconds::default() };
        // The machine slows down tenfold in the second round; the ratio does not.
        let (a, b) = (vec![at(2.0), at(20.0), at(2.2)], vec![at(1.0), at(10.0), at(1.0)]);
        let r = ratio(&a, &b, complete);
        assert_eq!((r.median, r.min, r.max), (2.0, 2.0, 2.2));
    }

    #[test]
    fn exponents_come_out_exactly() {
        let fit = exponent((1..6).map(|i| (1 << i, f64::from(1 << i).sqrt()))).unwrap();
        assert!((fit.slope - 0.5).abs() < 1e-12);
        assert!(matches!(exponent([(1, 1.0)]), Err(ClaimError::NotTestable(_))));
    }
}
