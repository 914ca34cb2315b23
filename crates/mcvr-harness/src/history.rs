//! Results over time: runs by date, machine class and commit, one curve for each class and never two classes in one.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::HarnessError;

/// Most bytes of a record.
const LARGEST: u64 = 64 << 20;

/// One run's figures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// When: `2026-11-22`, or with the time of day, UTC.
    pub date: String,
    /// Machine class: processor and cores.
    pub machine: String,
    /// Source revision.
    pub commit: String,
    /// Figures by metric.
    pub metrics: BTreeMap<String, f64>,
    /// The file it was read from.
    #[serde(skip)]
    pub file: PathBuf,
}

impl Entry {
    /// Its day.
    pub fn day(&self) -> &str {
        self.date.get(..10).unwrap_or(&self.date)
    }
}

/// One metric on one class of machines, oldest first: indices into the entries with the values.
#[derive(Clone, Debug, PartialEq)]
pub struct Course<'a> {
    /// The metric.
    pub metric: &'a str,
    /// The class.
    pub machine: &'a str,
    /// The runs that have it.
    pub points: Vec<(usize, f64)>,
}

/// Processor and cores of what [`machine()`](crate::machine) says: the memory plays no part.
pub fn machine_class(machine: &str) -> String {
    machine.split(", ").filter(|part| !part.ends_with(" GiB")).collect::<Vec<_>>().join(", ")
}

/// Text as a part of a file name: lower case, digits and hyphens.
pub fn slug(text: &str) -> String {
    let kept = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
    text.split_whitespace()
        .map(|word| word.chars().map(kept).collect::<String>().trim_matches('-').to_owned())
        .filter(|word| !word.is_empty())
        .collect::<Vec<_>>()
        .join("-")
}

/// Now, `2026-11-22T11:05:10Z`.
pub fn now() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let (day, rest) = (seconds / 86_400, seconds % 86_400);
    format!("{}T{:02}:{:02}:{:02}Z", date_of(day as i64), rest / 3600, rest / 60 % 60, rest % 60)
}

/// Calendar date of a number of days since 1970-01-01 (H. Hinnant, *chrono-compatible low-level date algorithms*).
fn date_of(day: i64) -> String {
    let z = day + 719_468;
    let era = z.div_euclid(146_097);
    let of_era = z.rem_euclid(146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * of_year + 2) / 153;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{:02}", of_year - (153 * shifted + 2) / 5 + 1)
}

/// All runs below a folder, oldest first: records of `mcvr bench --record` in it and in its folder `history`, and the
/// summaries of `mcvr converge` in `<date>-<class>/<run>/`.
///
/// # Errors
/// [`HarnessError::File`] for a folder or file that cannot be read, or a record that is none.
pub fn read(folder: &Path) -> Result<Vec<Entry>, HarnessError> {
    let mut entries = vec![];
    for place in [folder.to_owned(), folder.join("history")] {
        if place == folder || place.is_dir() {
            for file in files(&place)?.into_iter().filter(|f| f.extension().is_some_and(|e| e == "json")) {
                entries.extend(record(&file)?);
            }
        }
    }
    for dated in files(folder)?.into_iter().filter(|f| f.is_dir()) {
        if let Some(date) = dated.file_name().and_then(|n| n.to_str()).and_then(leading_date) {
            for run in files(&dated)? {
                let summary = run.join("summary.json");
                if summary.is_file() {
                    entries.push(self::summary(&summary, date)?);
                }
            }
        }
    }
    entries.sort_by(|a: &Entry, b| a.date.cmp(&b.date).then_with(|| a.file.cmp(&b.file)));
    Ok(entries)
}

/// What is in a folder, by name.
fn files(folder: &Path) -> Result<Vec<PathBuf>, HarnessError> {
    let fail = |e: std::io::Error| HarnessError::file(folder, e);
    let found: Result<Vec<PathBuf>, _> = std::fs::read_dir(folder).map_err(fail)?.map(|e| Ok(e?.path())).collect();
    let mut found = found.map_err(fail)?;
    found.sort();
    Ok(found)
}

fn json(file: &Path) -> Result<Value, HarnessError> {
    let text = mcvr_volume::read_text(file, LARGEST).map_err(|e| HarnessError::file(file, e))?;
    serde_json::from_str(&text).map_err(|e| HarnessError::file(file, format!("this is no JSON: {e}")))
}

/// A record; `None` for other JSON.
fn record(file: &Path) -> Result<Option<Entry>, HarnessError> {
    let value = json(file)?;
    if value.get("metrics").is_none() {
        return Ok(None);
    }
    let entry: Entry = serde_json::from_value(value)
        .map_err(|e| HarnessError::file(file, format!("this is no record of `mcvr bench --record`: {e}")))?;
    if leading_date(&entry.date).is_none() {
        return Err(HarnessError::file(file, format!("date: '{}' does not begin with YYYY-MM-DD", entry.date)));
    }
    Ok(Some(Entry { file: file.to_owned(), ..entry }))
}

/// The `YYYY-MM-DD` that a text begins with.
fn leading_date(text: &str) -> Option<&str> {
    let date = text.get(..10)?;
    let fits = date.bytes().enumerate().all(|(i, b)| if i == 4 || i == 7 { b == b'-' } else { b.is_ascii_digit() });
    fits.then_some(date)
}

/// Error and nanoseconds per sample of a run of `converge`.
fn summary(file: &Path, date: &str) -> Result<Entry, HarnessError> {
    let value = json(file)?;
    let lacks = |key: &str| HarnessError::file(file, format!("{key}: absent; this is no summary of `mcvr converge`"));
    let text = |key: &str| value["meta"][key].as_str().ok_or_else(|| lacks(&format!("meta.{key}")));
    let run = file.parent().and_then(Path::file_name).map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let mut metrics = BTreeMap::new();
    for row in value["rows"].as_array().ok_or_else(|| lacks("rows"))? {
        let (Some(method), Some(samples)) = (row["method"].as_str(), row["samples"].as_u64().filter(|s| *s > 0)) else {
            return Err(lacks("rows.method or rows.samples"));
        };
        let budget =
            if samples.is_power_of_two() { format!("2^{}", samples.trailing_zeros()) } else { samples.to_string() };
        if let Some(error) = row["error"].as_f64() {
            metrics.insert(format!("error/{run}/{method}@{budget}"), error);
        }
        if let Some(seconds) = row["complete"]["median"].as_f64() {
            metrics.insert(format!("time/{run}/{method}@{budget}"), 1e9 * seconds / samples as f64);
        }
    }
    Ok(Entry {
        date: date.to_owned(),
        machine: machine_class(text("machine")?),
        commit: text("commit").unwrap_or("unknown").to_owned(),
        metrics,
        file: file.to_owned(),
    })
}

/// The courses of all metrics whose name contains every word of a pattern, by metric, then class.
pub fn courses<'a>(entries: &'a [Entry], pattern: &str) -> Vec<Course<'a>> {
    let words: Vec<&str> = pattern.split_whitespace().collect();
    let wanted = |name: &str| words.iter().all(|w| name.contains(w));
    let keys: BTreeSet<(&str, &str)> = entries
        .iter()
        .flat_map(|e| e.metrics.keys().filter(|m| wanted(m)).map(|m| (m.as_str(), e.machine.as_str())))
        .collect();
    let points = |(metric, machine): (&str, &str)| {
        let of = |(i, e): (usize, &Entry)| Some((i, *e.metrics.get(metric).filter(|_| e.machine == machine)?));
        entries.iter().enumerate().filter_map(of).collect()
    };
    keys.into_iter().map(|key| Course { metric: key.0, machine: key.1, points: points(key) }).collect()
}

/// The unit of a metric, by its first word.
pub fn unit(metric: &str) -> &'static str {
    match metric.split('/').next() {
        Some("error") => "RMSE over the mean pixel",
        Some("time") => "ns",
        Some("instructions") => "instructions",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (day, date) in [(0, "1970-01-01"), (11_016, "2000-02-29"), (20_779, "2026-11-22"), (-1, "1969-12-31")] {
            assert_eq!(date_of(day), date);
        }
        assert!(leading_date(&now()).is_some() && now().ends_with('Z'));
    }

    #[test]
    fn a_class_is_the_processor_and_its_cores() {
        assert_eq!(machine_class("Some CPU, 2 cores, 24 GiB"), "Some CPU, 2 cores");
        assert_eq!(slug("Intel Xeon Processor, 2 cores"), "intel-xeon-processor-2-cores");
        assert_eq!(slug("../x"), "x");
    }

    fn entry(date: &str, machine: &str, metrics: &[(&str, f64)]) -> Entry {
        let metrics = metrics.iter().map(|(name, v)| ((*name).to_owned(), *v)).collect();
        Entry { date: date.into(), machine: machine.into(), commit: "abc".into(), metrics, file: PathBuf::new() }
    }

    #[test]
    fn machines_are_never_mixed_in_one_curve() {
        let entries = [
            entry("2026-01-01", "a", &[("time/x", 1.0), ("error/x", 2.0)]),
            entry("2026-01-02", "b", &[("time/x", 3.0)]),
            entry("2026-01-03", "a", &[("time/x", 4.0)]),
        ];
        let found = courses(&entries, "time x");
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].machine, found[0].points.clone()), ("a", vec![(0, 1.0), (2, 4.0)]));
        assert_eq!((found[1].machine, found[1].points.clone()), ("b", vec![(1, 3.0)]));
        assert!(courses(&entries, "nothing").is_empty());
    }

    #[test]
    fn records_and_summaries_are_read_and_ordered() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(at("history")).unwrap();
        std::fs::create_dir_all(at("2026-01-02-2core/run")).unwrap();
        let late = serde_json::json!(entry("2026-01-03T10:00:00Z", "m, 2 cores", &[("time/x", 1.5)]));
        std::fs::write(at("history/late.json"), late.to_string()).unwrap();
        let summary = serde_json::json!({
            "meta": {"machine": "m, 2 cores, 4 GiB", "commit": "def"},
            "rows": [{"method": "mc", "samples": 1024, "error": 0.5, "complete": {"median": 1e-3}}],
        });
        std::fs::write(at("2026-01-02-2core/run/summary.json"), summary.to_string()).unwrap();
        let entries = read(folder.path()).unwrap();
        assert_eq!(entries.iter().map(Entry::day).collect::<Vec<_>>(), ["2026-01-02", "2026-01-03"]);
        assert_eq!(entries[0].machine, entries[1].machine);
        assert_eq!(entries[0].metrics["error/run/mc@2^10"], 0.5);
        assert_eq!(entries[0].metrics["time/run/mc@2^10"], 1e6 / 1024.0);
    }

    #[test]
    fn what_is_no_record_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        assert!(read(&folder.path().join("absent")).is_err());
        for text in
            ["{", "{\"metrics\": 3}", "{\"metrics\": {}, \"date\": \"x\", \"machine\": \"m\", \"commit\": \"c\"}"]
        {
            std::fs::write(folder.path().join("bad.json"), text).unwrap();
            assert!(read(folder.path()).unwrap_err().to_string().contains("bad.json"), "{text}");
        }
        std::fs::write(folder.path().join("bad.json"), "{\"other\": 1}").unwrap();
        assert!(read(folder.path()).unwrap().is_empty(), "other JSON is left alone");
    }
}
