//! What an image will take, before it is made: the passes that will run, why, what they hold, and their exact work.
//!
//! [`plan`] reads no voxel. Counters that follow from the scene alone are forecast exactly; those that depend on which voxels
//! the seed draws are forecast as a range, which [`Plan::draw`] narrows to one number by drawing the points without
//! making the image. [`Plan::verify`] holds a finished image's counters to the forecast.

mod effects;
mod sampled;
mod scene;

use mcvr_scene::film::Film;
use serde::Serialize;
use serde_json::Value;

pub use scene::plan;

/// How often something will happen: at least and at most; equal when it is known exactly.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Forecast {
    /// The counter, as a path into [`Made::counters`](crate::Made::counters): `render.gradients`.
    pub counter: String,
    /// Fewest.
    pub at_least: u64,
    /// Most; `None` where nothing bounds it beforehand (adaptive subdivision).
    pub at_most: Option<u64>,
}

impl Forecast {
    fn exact(counter: &str, n: u64) -> Self {
        Self { counter: counter.to_owned(), at_least: n, at_most: Some(n) }
    }

    fn between(counter: &str, at_least: u64, at_most: u64) -> Self {
        Self { counter: counter.to_owned(), at_least, at_most: Some(at_most) }
    }

    fn from(counter: &str, at_least: u64) -> Self {
        Self { counter: counter.to_owned(), at_least, at_most: None }
    }

    /// True when it is one number.
    pub fn is_exact(&self) -> bool {
        self.at_most == Some(self.at_least)
    }

    /// True when a count agrees.
    pub fn allows(&self, count: u64) -> bool {
        count >= self.at_least && self.at_most.is_none_or(|most| count <= most)
    }
}

impl std::fmt::Display for Forecast {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let name = self.counter.rsplit('.').next().unwrap_or(&self.counter);
        match self.at_most {
            Some(most) if most == self.at_least => write!(f, "{name} {}", grouped(most)),
            Some(most) => write!(f, "{name} {} to {}", grouped(self.at_least), grouped(most)),
            None => write!(f, "{name} at least {}", grouped(self.at_least)),
        }
    }
}

/// A count with its thousands apart: 1,100,800.
pub fn grouped(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::with_capacity(digits.len() * 4 / 3 + 1);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

/// One pass over some data.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Pass {
    /// What runs.
    pub name: &'static str,
    /// The key that asked for it, and its value.
    pub why: String,
    /// What it reads.
    pub reads: String,
    /// Bytes it holds while the image is made.
    pub holds: u64,
    /// Its counters.
    pub work: Vec<Forecast>,
}

/// Something that will not run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// What.
    pub name: &'static str,
    /// Why not.
    pub why: String,
    /// Counters that therefore stay at 0.
    pub work: Vec<Forecast>,
}

/// The least work that gives a scene's image.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Plan {
    /// What runs, in order.
    pub passes: Vec<Pass>,
    /// What does not.
    pub left_out: Vec<LeftOut>,
    /// Bytes that all passes hold together.
    pub bytes: u64,
}

/// A count against its forecast.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Verdict {
    /// What was forecast; `None` for a counter that the plan does not know.
    pub forecast: Option<Forecast>,
    /// The counter.
    pub counter: String,
    /// What was counted; `None` for a forecast counter that was not reported.
    pub counted: Option<u64>,
}

impl Verdict {
    /// True when the two agree.
    pub fn holds(&self) -> bool {
        matches!((&self.forecast, self.counted), (Some(f), Some(n)) if f.allows(n))
    }
}

impl Plan {
    /// All forecasts, those of passes left out included.
    pub fn forecasts(&self) -> impl Iterator<Item = &Forecast> {
        let passes = self.passes.iter().flat_map(|p| &p.work);
        passes.chain(self.left_out.iter().flat_map(|l| &l.work))
    }

    /// Narrows the forecasts of counters to what they were in `counters`.
    fn narrow(&mut self, counters: &Value) {
        let passes = self.passes.iter_mut().flat_map(|p| &mut p.work);
        for forecast in passes.chain(self.left_out.iter_mut().flat_map(|l| &mut l.work)) {
            if let Some(n) = look_up(counters, &forecast.counter) {
                (forecast.at_least, forecast.at_most) = (n, Some(n));
            }
        }
    }

    /// Compares what was counted with what was forecast: every counter of the image, and every forecast.
    pub fn verify(&self, counters: &Value) -> Vec<Verdict> {
        let mut counted = vec![];
        leaves("", counters, &mut counted);
        let mut verdicts: Vec<Verdict> = counted
            .iter()
            .map(|(counter, n)| Verdict {
                forecast: self.forecasts().find(|f| f.counter == *counter).cloned(),
                counter: counter.clone(),
                counted: Some(*n),
            })
            .collect();
        let missing = self.forecasts().filter(|f| !counted.iter().any(|(c, _)| *c == f.counter));
        verdicts.extend(missing.map(|f| Verdict {
            forecast: Some(f.clone()),
            counter: f.counter.clone(),
            counted: None,
        }));
        verdicts
    }
}

fn look_up(counters: &Value, path: &str) -> Option<u64> {
    path.split('.').try_fold(counters, |v, key| v.get(key))?.as_u64()
}

/// Every integer in a tree of objects, with its path.
fn leaves(path: &str, value: &Value, out: &mut Vec<(String, u64)>) {
    if let Some(object) = value.as_object() {
        for (key, value) in object {
            leaves(&if path.is_empty() { key.clone() } else { format!("{path}.{key}") }, value, out);
        }
    } else if let Some(n) = value.as_u64() {
        out.push((path.to_owned(), n));
    }
}

/// What a film adds to an image.
fn film_pass(film: &Film, pixels: u64) -> Option<Pass> {
    film.is_transmission().then(|| Pass {
        name: "film",
        why: match film.photons {
            Some(n) => format!("film.photons = {n}"),
            None => "film.transmission".to_owned(),
        },
        reads: format!("{} pixels", grouped(pixels)),
        holds: 8 * pixels,
        work: vec![],
    })
}
