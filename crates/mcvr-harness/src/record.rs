//! What one measured run leaves behind: a [`Record`], its append-only log and its table.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use mcvr_volume::open_regular;
use serde::{Deserialize, Serialize};

use crate::{Comparison, HarnessError, PhaseSeconds};

/// One image that was made, measured and timed. Figures that are undefined are `None` (`null`, empty).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Name of the volume and its density map.
    pub dataset: String,
    /// The camera in words, for example `azimuth 30 elevation 20`.
    pub view: String,
    /// Width x height in pixels, for example `400x400`.
    pub size: String,
    /// Reconstruction kernel: `box`, `tent`, `bspline3` or `shell`.
    pub kernel: String,
    /// What a pixel means: `count` or `line`.
    pub estimand: String,
    /// [`Method::name`](crate::Method::name) of what made the image.
    pub method: String,
    /// What one unit of `samples` is.
    pub budget_unit: String,
    /// The budget M, in `budget_unit`.
    pub samples: u64,
    /// Replicate number, from 0.
    pub replicate: u32,
    /// Seed of this replicate, below 2^53 so that every JSON reader keeps it exact.
    pub seed: u64,
    /// RMSE in the image's unit; `None` where nothing but the time was measured.
    pub rmse: Option<f64>,
    /// RMSE over the truth's mean pixel, dimensionless.
    pub rel_rmse: Option<f64>,
    /// RMSE over the truth's peak pixel, dimensionless.
    pub rel_rmse_peak: Option<f64>,
    /// Mean absolute error over the truth's mean pixel, dimensionless.
    pub mae: Option<f64>,
    /// Largest absolute error over the truth's mean pixel, dimensionless.
    pub max: Option<f64>,
    /// Peak signal-to-noise ratio, dB.
    pub psnr: Option<f64>,
    /// Mean signed error over the truth's mean pixel, dimensionless.
    pub bias: Option<f64>,
    /// Standard error of `bias` over the pixels, dimensionless; see [`Comparison`].
    pub bias_se: Option<f64>,
    /// Wall-clock time by phase, s.
    pub seconds: PhaseSeconds,
    /// Threads that the run was allowed.
    pub threads: usize,
    /// What the method counted; a JSON value of its own choice.
    pub counters: serde_json::Value,
    /// The truth's own RMSE over its mean pixel as its integrator estimates it, dimensionless.
    pub reference_error: f64,
    /// Version of the program.
    pub version: String,
    /// Source revision the program was built from, where known.
    pub commit: Option<String>,
    /// Processor, cores and memory in words.
    pub machine: String,
}

/// What the records of a run share.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Setting<'a> {
    pub(crate) threads: usize,
    pub(crate) commit: Option<&'a str>,
    pub(crate) machine: &'a str,
    /// The truth's own error; 0 without a truth.
    pub(crate) reference_error: f64,
}

impl Record {
    /// The record of one image; without a comparison it holds its time alone.
    pub(crate) fn of(
        key: RecordKey,
        replicate: u32,
        budget_unit: &str,
        (seconds, counters): (PhaseSeconds, serde_json::Value),
        comparison: Option<&Comparison>,
        setting: Setting<'_>,
    ) -> Self {
        let figure = |of: fn(&Comparison) -> Option<f64>| comparison.and_then(of);
        Self {
            dataset: key.dataset,
            view: key.view,
            size: key.size,
            kernel: key.kernel,
            estimand: key.estimand,
            method: key.method,
            budget_unit: budget_unit.to_owned(),
            samples: key.samples,
            replicate,
            seed: key.seed,
            rmse: figure(|c| Some(c.rmse)),
            rel_rmse: figure(|c| c.rel_rmse),
            rel_rmse_peak: figure(|c| c.rel_rmse_peak),
            mae: figure(|c| c.mae),
            max: figure(|c| c.max),
            psnr: figure(|c| c.psnr),
            bias: figure(|c| c.bias),
            bias_se: figure(|c| c.bias_se),
            seconds,
            threads: setting.threads,
            counters,
            reference_error: setting.reference_error,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            commit: setting.commit.map(str::to_owned),
            machine: setting.machine.to_owned(),
        }
    }

    /// What makes two records the same measurement.
    pub fn key(&self) -> RecordKey {
        RecordKey {
            dataset: self.dataset.clone(),
            view: self.view.clone(),
            size: self.size.clone(),
            kernel: self.kernel.clone(),
            estimand: self.estimand.clone(),
            method: self.method.clone(),
            samples: self.samples,
            seed: self.seed,
        }
    }
}

/// Identity of a measurement: everything that decides the image.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[expect(missing_docs, reason = "the fields are those of Record")]
pub struct RecordKey {
    pub dataset: String,
    pub view: String,
    pub size: String,
    pub kernel: String,
    pub estimand: String,
    pub method: String,
    pub samples: u64,
    pub seed: u64,
}

/// The append-only log: one JSON record a line, on disk before the next image is begun. It is locked while
/// open, so that two runs cannot mix their lines.
#[derive(Debug)]
pub struct RecordLog {
    path: PathBuf,
    file: File,
}

impl RecordLog {
    /// Opens or creates a log and returns it with the records it holds. A last line that a kill tore is cut off.
    ///
    /// # Errors
    /// [`HarnessError::File`] when the file cannot be opened, another run holds it, or a whole line is no record.
    pub fn open(path: &Path) -> Result<(Self, Vec<Record>), HarnessError> {
        let fail = |e: std::io::Error| HarnessError::file(path, e);
        if path.exists() {
            // A pipe or a device would never end.
            open_regular(path).map_err(fail)?;
        }
        let mut file = File::options().read(true).write(true).create(true).truncate(false).open(path).map_err(fail)?;
        file.try_lock().map_err(|e| match e {
            std::fs::TryLockError::WouldBlock => HarnessError::file(path, "another run is writing this file"),
            std::fs::TryLockError::Error(e) => HarnessError::file(path, format!("cannot lock: {e}")),
        })?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(fail)?;
        let (records, whole) = parse(path, &bytes)?;
        file.set_len(whole as u64).map_err(fail)?;
        file.seek(SeekFrom::Start(whole as u64)).map_err(fail)?;
        Ok((Self { path: path.to_owned(), file }, records))
    }

    /// Appends one record and waits until it is on disk.
    ///
    /// # Errors
    /// [`HarnessError::File`] when the disk is full or gone.
    pub fn append(&mut self, record: &Record) -> Result<(), HarnessError> {
        let fail = |e: std::io::Error| HarnessError::file(&self.path, e);
        let mut line = serde_json::to_vec(record).map_err(|e| HarnessError::file(&self.path, e))?;
        line.push(b'\n');
        self.file.write_all(&line).map_err(fail)?;
        self.file.sync_data().map_err(fail)
    }
}

/// Reads a log without changing it; a torn last line is ignored.
///
/// # Errors
/// [`HarnessError::File`] when the file cannot be read or a whole line is no record.
pub fn read_log(path: &Path) -> Result<Vec<Record>, HarnessError> {
    let mut bytes = Vec::new();
    open_regular(path).and_then(|mut file| file.read_to_end(&mut bytes)).map_err(|e| HarnessError::file(path, e))?;
    Ok(parse(path, &bytes)?.0)
}

/// Records of all whole lines, and the number of bytes those take. A line is whole when a newline ends it. After
/// a power cut the tail may also be whole but garbled (zeros); so a bad *last* line is dropped as well.
fn parse(path: &Path, bytes: &[u8]) -> Result<(Vec<Record>, usize), HarnessError> {
    let (mut records, mut whole) = (Vec::new(), 0);
    for (number, line) in bytes.split_inclusive(|&b| b == b'\n').enumerate() {
        let end = whole + line.len();
        if line.last() != Some(&b'\n') && torn(line, whole > 0) {
            break;
        }
        match serde_json::from_slice::<Record>(line) {
            Ok(record) => records.push(record),
            Err(_) if end == bytes.len() && torn(line, whole > 0) => break,
            Err(e) => return Err(HarnessError::file(path, format!("line {}: {e}", number + 1))),
        }
        whole = end;
    }
    Ok((records, whole))
}

/// Whether a last line may be what a kill or a power cut left of one, to be cut off. Without a record in front it must
/// begin as one or be zeros, and it cannot hold several: other files, and logs with other line ends, are not cut.
fn torn(line: &[u8], has_records: bool) -> bool {
    let mut values = serde_json::Deserializer::from_slice(line).into_iter::<Record>();
    let several =
        values.next().is_some_and(|v| v.is_ok()) && line[values.byte_offset()..].trim_ascii_start().starts_with(b"{");
    !several && (has_records || line.starts_with(b"{") || line.iter().all(|&b| b == 0))
}

/// Writes the records as a table with one column per figure; counters stay JSON in one column.
///
/// # Errors
/// [`HarnessError::File`] when the file cannot be written.
pub fn write_csv(records: &[Record], path: &Path) -> Result<(), HarnessError> {
    let mut table = csv::Writer::from_writer(Vec::new());
    let fail = |e: csv::Error| HarnessError::file(path, e);
    table.write_record(COLUMNS).map_err(fail)?;
    let number = |v: Option<f64>| v.map(|v| v.to_string()).unwrap_or_default();
    for r in records {
        let s = r.seconds;
        let row: [String; COLUMNS.len()] = [
            r.dataset.clone(),
            r.view.clone(),
            r.size.clone(),
            r.kernel.clone(),
            r.estimand.clone(),
            r.method.clone(),
            r.budget_unit.clone(),
            r.samples.to_string(),
            r.replicate.to_string(),
            r.seed.to_string(),
            number(r.rmse),
            number(r.rel_rmse),
            number(r.rel_rmse_peak),
            number(r.mae),
            number(r.max),
            number(r.psnr),
            number(r.bias),
            number(r.bias_se),
            s.distribution.to_string(),
            s.sampling.to_string(),
            s.projection.to_string(),
            s.complete.to_string(),
            r.threads.to_string(),
            r.counters.to_string(),
            r.reference_error.to_string(),
            r.version.clone(),
            r.commit.clone().unwrap_or_default(),
            r.machine.clone(),
        ];
        table.write_record(&row).map_err(fail)?;
    }
    let bytes = table.into_inner().map_err(|e| HarnessError::file(path, e.error()))?;
    write_file(path, &bytes)
}

/// Columns of the table, in order; `_s` marks seconds and `_db` decibels.
const COLUMNS: [&str; 28] = [
    "dataset",
    "view",
    "size",
    "kernel",
    "estimand",
    "method",
    "budget_unit",
    "samples",
    "replicate",
    "seed",
    "rmse",
    "rel_rmse",
    "rel_rmse_peak",
    "mae",
    "max",
    "psnr_db",
    "bias",
    "bias_se",
    "distribution_s",
    "sampling_s",
    "projection_s",
    "complete_s",
    "threads",
    "counters",
    "reference_error",
    "version",
    "commit",
    "machine",
];

/// Writes a file that is whole or unchanged.
///
/// # Errors
/// [`HarnessError::File`] when the folder is missing or not writable, or the disk is full.
pub(crate) fn write_file(path: &Path, bytes: &[u8]) -> Result<(), HarnessError> {
    mcvr_volume::write_whole(path, |out| out.write_all(bytes)).map_err(|e| HarnessError::file(path, e))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A record with the given identity and figures, everything else fixed.
    pub(crate) fn record(method: &str, samples: u64, replicate: u32, rel_rmse: f64, complete: f64) -> Record {
        Record {
            dataset: "phantom, \"quoted\"".into(),
            view: "azimuth 30".into(),
            size: "64x48".into(),
            kernel: "tent".into(),
            estimand: "line".into(),
            method: method.into(),
            budget_unit: "samples".into(),
            samples,
            replicate,
            seed: u64::from(replicate) + 7,
            rmse: Some(rel_rmse * 3.0),
            rel_rmse: Some(rel_rmse),
            rel_rmse_peak: Some(rel_rmse / 10.0),
            mae: Some(rel_rmse / 2.0),
            max: Some(rel_rmse * 4.0),
            psnr: None,
            bias: Some(0.0),
            bias_se: Some(1e-3),
            seconds: PhaseSeconds { distribution: 0.1, sampling: 0.2, projection: 0.3, complete },
            threads: 2,
            counters: serde_json::json!({ "outside": 12 }),
            reference_error: 1e-6,
            version: "0.0.0".into(),
            commit: None,
            machine: "test".into(),
        }
    }

    #[test]
    fn a_log_gives_back_every_bit_of_its_records() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.jsonl");
        let (mut log, empty) = RecordLog::open(&path).unwrap();
        assert!(empty.is_empty());
        let records: Vec<_> = (0..50).map(|i| record("mc", 1 << i, i, 1.0 / f64::from(i + 3), 0.1 * 0.3)).collect();
        records.iter().for_each(|r| log.append(r).unwrap());
        drop(log);
        assert_eq!(RecordLog::open(&path).unwrap().1, records);
        assert_eq!(read_log(&path).unwrap(), records);
    }

    #[test]
    fn a_torn_last_line_is_dropped_wherever_the_kill_fell() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.jsonl");
        let (mut log, _) = RecordLog::open(&path).unwrap();
        for i in 0..2 {
            log.append(&record("mc", 10, i, 0.5, 1.0)).unwrap();
        }
        drop(log);
        let bytes = std::fs::read(&path).unwrap();
        let first = bytes.iter().position(|&b| b == b'\n').unwrap() + 1;
        for cut in first..bytes.len() {
            std::fs::write(&path, &bytes[..cut]).unwrap();
            let (mut log, records) = RecordLog::open(&path).unwrap();
            assert_eq!(records.len(), 1, "cut at byte {cut}");
            log.append(&record("mc", 10, 1, 0.5, 1.0)).unwrap();
            drop(log);
            assert_eq!(std::fs::read(&path).unwrap(), bytes, "cut at byte {cut}");
        }
    }

    #[test]
    fn a_damaged_line_in_the_middle_is_an_error_that_names_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.jsonl");
        let good = serde_json::to_string(&record("mc", 10, 0, 0.5, 1.0)).unwrap();
        std::fs::write(&path, format!("{good}\nnonsense\n{good}\n")).unwrap();
        let message = RecordLog::open(&path).unwrap_err().to_string();
        assert!(message.contains("r.jsonl") && message.contains("line 2"), "{message}");
    }

    #[test]
    fn two_runs_cannot_write_the_same_log() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.jsonl");
        let _first = RecordLog::open(&path).unwrap();
        assert!(RecordLog::open(&path).unwrap_err().to_string().contains("another run"));
    }

    #[test]
    fn the_table_has_a_column_for_every_figure() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.csv");
        write_csv(&[record("mc", 10, 0, 0.5, 1.25)], &path).unwrap();
        let mut table = csv::Reader::from_path(&path).unwrap();
        let headers = table.headers().unwrap().clone();
        let row = table.records().next().unwrap().unwrap();
        let cell = |name: &str| &row[headers.iter().position(|h| h == name).unwrap()];
        assert_eq!(cell("dataset"), "phantom, \"quoted\"");
        assert_eq!((cell("rel_rmse"), cell("complete_s"), cell("psnr_db")), ("0.5", "1.25", ""));
        assert_eq!(cell("counters"), "{\"outside\":12}");
        assert!(write_csv(&[], &folder.path().join("no/where.csv")).is_err());
    }
}
