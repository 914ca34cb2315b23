//! What is wrong with a scene file, and where.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use toml::de::{DeTable, DeValue};

use super::check::{Finding, Step};

/// Why a scene file could not be read.
#[derive(Debug, thiserror::Error)]
#[error("{path}{at}: {problem}", path = path.display(), at = line.map_or(String::new(), |l| format!(", line {l}")))]
pub struct SceneFileError {
    path: PathBuf,
    line: Option<usize>,
    problem: String,
}

impl SceneFileError {
    /// The line, counted from 1, if the problem has one.
    pub fn line(&self) -> Option<usize> {
        self.line
    }

    pub(super) fn unreadable(path: &Path, error: &std::io::Error) -> Self {
        Self { path: path.to_owned(), line: None, problem: error.to_string() }
    }

    pub(super) fn of_toml(path: &Path, text: &str, error: &toml::de::Error) -> Self {
        let start = error.span().map(|s| s.start);
        let table = DeTable::parse(text).ok();
        let place = start.zip(table.as_ref()).and_then(|(o, t)| path_at(t.get_ref(), o)).unwrap_or_default();
        let nearer = table.as_ref().and_then(|t| spoken_of(t.get_ref(), &place, error.message()));
        // A message about an unknown name lists others, which are not what is wrong.
        let whole = !place.is_empty() && !error.message().starts_with("un");
        let offset = nearer.filter(|_| whole).or(start);
        let problem = explain(error.message(), &place);
        Self { path: path.to_owned(), line: offset.map(|o| line(text, o)), problem }
    }

    /// Two spellings of one key in one table.
    pub(super) fn of_twins(path: &Path, text: &str) -> Option<Self> {
        let table = DeTable::parse(text).ok()?;
        let (offset, first, second) = twins(table.get_ref())?;
        let problem = format!("`{second}` and `{first}` are one key in two spellings; keep one");
        Some(Self { path: path.to_owned(), line: Some(line(text, offset)), problem })
    }

    pub(super) fn of_finding(path: &Path, text: &str, finding: &Finding) -> Self {
        let table = DeTable::parse(text).ok();
        let offset = table.and_then(|t| offset_of(t.get_ref(), &finding.place)).map(|(at, _)| at);
        Self { path: path.to_owned(), line: offset.map(|o| line(text, o)), problem: finding.problem.clone() }
    }
}

/// The line of a byte, counted from 1.
fn line(text: &str, offset: usize) -> usize {
    1 + text.as_bytes()[..offset.min(text.len())].iter().filter(|b| **b == b'\n').count()
}

/// The keys that lead to the key or value at a byte.
fn path_at(table: &DeTable<'_>, offset: usize) -> Option<Vec<String>> {
    table.iter().find_map(|(key, value)| {
        let below = match value.get_ref() {
            DeValue::Table(t) => path_at(t, offset),
            DeValue::Array(items) => items.iter().find_map(|item| match item.get_ref() {
                DeValue::Table(t) => path_at(t, offset),
                _ => None,
            }),
            _ => None,
        };
        // Tables under a header span their header only, so what is below is asked first.
        let here = key.span().contains(&offset) || value.span().contains(&offset);
        match below {
            Some(mut path) => {
                path.insert(0, key.get_ref().to_string());
                Some(path)
            }
            None => here.then(|| vec![key.get_ref().to_string()]),
        }
    })
}

/// The first two keys of a table, at any depth, that are spellings of one key: the byte of the later one, and both.
fn twins(table: &DeTable<'_>) -> Option<(usize, String, String)> {
    let mut keys: Vec<_> = table.keys().collect();
    keys.sort_by_key(|k| k.span().start);
    let mut seen = HashMap::new();
    let here = keys.iter().find_map(|key| {
        let twin = seen.insert(plain(key.get_ref()), key.get_ref())?;
        Some((key.span().start, twin.to_string(), key.get_ref().to_string()))
    });
    here.or_else(|| {
        table.values().find_map(|value| match value.get_ref() {
            DeValue::Table(t) => twins(t),
            DeValue::Array(items) => items.iter().find_map(|item| match item.get_ref() {
                DeValue::Table(t) => twins(t),
                _ => None,
            }),
            _ => None,
        })
    })
}

/// The byte of the last step of a path that the file has, and how many steps it has.
fn offset_of(table: &DeTable<'_>, place: &[Step]) -> Option<(usize, usize)> {
    let (first, rest) = place.split_first()?;
    let Step::Key(wanted) = first else { return None };
    let (key, value) = table.iter().find(|(k, _)| plain(k.get_ref()) == plain(wanted))?;
    let below = match (value.get_ref(), rest) {
        (DeValue::Table(t), [Step::Index(_), rest @ ..]) => offset_of(t, rest).map(|(at, n)| (at, n + 1)),
        (DeValue::Table(t), rest) => offset_of(t, rest),
        (DeValue::Array(items), [Step::Index(i), rest @ ..]) => items.get(*i).map(|item| match item.get_ref() {
            DeValue::Table(t) => offset_of(t, rest).map_or((item.span().start, 1), |(at, n)| (at, n + 1)),
            _ => (item.span().start, 1),
        }),
        _ => None,
    };
    Some(below.map_or((key.span().start, 1), |(at, n)| (at, n + 1)))
}

/// The byte of the last key below a place that a message speaks of: values that are checked as a whole know no more of
/// their place than where they start.
fn spoken_of(table: &DeTable<'_>, place: &[String], message: &str) -> Option<usize> {
    let words = message.split(|c: char| !(c.is_alphanumeric() || "._-".contains(c)));
    let steps = words.map(|w| place.iter().map(String::as_str).chain(w.split('.')).map(|k| Step::Key(k.into())));
    let found = steps.filter_map(|steps| {
        let steps: Vec<Step> = steps.collect();
        offset_of(table, &steps).filter(|(_, n)| *n == steps.len())
    });
    found.map(|(at, _)| at).max()
}

/// A key without the differences that aliases have.
fn plain(key: &str) -> String {
    key.replace('_', "-").replace("color", "colour")
}

/// The message for people: serde's for unknown fields and variants, with the nearest one that exists.
fn explain(message: &str, place: &[String]) -> String {
    let message = message.trim_end();
    let (parent, own) = place.split_at(place.len().saturating_sub(1));
    let section = if parent.is_empty() { "at the top level".into() } else { format!("in [{}]", parent.join(".")) };
    // The parser's own check of the keys of a table under an enum's variant.
    if let Some((names, valid)) =
        message.strip_prefix("unexpected keys in table: ").and_then(|m| m.split_once(", available keys: "))
    {
        let (name, valid) = (names.split(", ").next().unwrap_or(names), valid.split(", ").collect::<Vec<_>>());
        return format!("unknown key `{name}` {section}{}; valid keys: {}", nearest(name, &valid), valid.join(", "));
    }
    if let Some((name, valid)) = unknown(message, "unknown field `") {
        if valid.is_empty() {
            return format!("unknown key `{name}` {section}, where there are no keys");
        }
        return format!("unknown key `{name}` {section}{}; valid keys: {}", nearest(name, &valid), valid.join(", "));
    }
    if let Some((name, valid)) = unknown(message, "unknown variant `") {
        let key = if own.is_empty() { String::new() } else { format!(" of {}", place.join(".")) };
        return format!("unknown value `{name}`{key}{}; valid values: {}", nearest(name, &valid), valid.join(", "));
    }
    if let Some(rest) = message.strip_prefix("missing field ") {
        return format!("missing key {rest} in [{}]", place.join("."));
    }
    match place {
        [] => message.to_owned(),
        _ => format!("{}: {}", place.join("."), message.trim_start_matches("density map: ")),
    }
}

/// The unknown name and those that exist, of serde's "unknown field `x`, expected one of `a`, `b`".
fn unknown<'m>(message: &'m str, start: &str) -> Option<(&'m str, Vec<&'m str>)> {
    let (name, rest) = message.strip_prefix(start)?.split_once('`')?;
    let mut valid: Vec<&str> = rest.split('`').skip(1).step_by(2).collect();
    // Second spellings are accepted, not advertised.
    let all = valid.clone();
    valid.retain(|v| !all.iter().any(|o| o != v && plain(o) == plain(v) && (v.contains('_') || v.ends_with("color"))));
    Some((name, valid))
}

/// "; did you mean ...?" where one name is near.
fn nearest(name: &str, valid: &[&str]) -> String {
    let lower = plain(&name.to_lowercase());
    let best = valid.iter().map(|v| (strsim::osa_distance(&lower, &plain(v)), v)).min_by_key(|(d, _)| *d);
    match best {
        // Further away than half its letters, a name is another word.
        Some((distance, found)) if distance <= (found.len().max(name.len()) / 2).max(1) => {
            format!("; did you mean `{found}`?")
        }
        _ => String::new(),
    }
}
