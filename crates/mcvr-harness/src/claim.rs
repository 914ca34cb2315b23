//! Whose folder it is: nobody else's, from before the first byte is written.

use mcvr_scene::Extent;

use crate::record::RecordLog;
use crate::{ConvergeOptions, HarnessError, Record, Truth, folder};

/// A folder that belongs to this run and to no other process, from before the truth is made. The lock goes with it.
#[derive(Debug)]
pub struct Claim {
    pub(crate) log: RecordLog,
    pub(crate) records: Vec<Record>,
}

impl Claim {
    /// Makes the folder where it is absent, locks it, and checks that what it holds is of the same run, as far as that is known
    /// without the truth. Another run's folder is left as it was.
    ///
    /// # Errors
    /// [`HarnessError::OtherRun`] when the folder belongs to something else, [`HarnessError::File`] when another process works
    /// in it or it cannot be written.
    pub fn lay(options: &ConvergeOptions, truth: Extent) -> Result<Self, HarnessError> {
        let out = &options.out;
        std::fs::create_dir_all(out).map_err(|e| HarnessError::file(out, e))?;
        let mut settings = folder::fingerprint(&options.meta, options.seed, truth, "");
        settings.remove("truth");
        folder::check(out, &settings)?;
        let (log, records) = RecordLog::open(&out.join("records.jsonl"))?;
        folder::tidy(out)?;
        Ok(Self { log, records })
    }

    /// Writes the folder's header, or checks that the one there names this truth. Nothing else should be written before.
    ///
    /// # Errors
    /// As [`Claim::lay`].
    pub fn confirm(&self, options: &ConvergeOptions, truth: &Truth) -> Result<(), HarnessError> {
        let hash = folder::sha256(&truth.image);
        let settings = folder::fingerprint(&options.meta, options.seed, truth.image.extent(), &hash);
        folder::claim(&options.out, &options.meta, settings)
    }
}
