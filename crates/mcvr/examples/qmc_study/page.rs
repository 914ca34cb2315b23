//! The page, from the records alone.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use crate::figures::Figures;
use crate::records::{Circumstances, Record};
use crate::{Outcome, plots, sections};

const INTRODUCTION: &str = "`line` images of 400×400 pixels, kernel `tent`. **Error**: RMSE over the mean pixel without a truth: the root of \
the sample variance over independent replicates, averaged over the pixels before the root is taken, so that the variance is estimated \
without bias; 24 replicates at 2^18 samples, 16 up to 2^22, 8 at 2^24, 4 beyond. **Time**: one image on all threads, the points and whatever a method makes for \
them included, the distribution over the voxels not; methods take turns, medians. `records.jsonl` has every figure, with the standard \
errors (by jackknife) of the errors and all single times.";

pub fn write(out: &Path, records: &[Record]) -> Outcome<()> {
    let figures = Figures::of(records);
    let mut page = String::from("# Which points make the best image\n\n");
    writeln!(page, "{INTRODUCTION}\n")?;
    for (what, timed) in [("Errors", false), ("Times", true)] {
        for c in figures.circumstances(timed) {
            writeln!(page, "{what}: {}\n", described(c))?;
        }
    }
    // What people saw in the figures; no program writes it.
    match std::fs::read_to_string(out.join("notes.md")) {
        Ok(notes) => writeln!(page, "{}\n", notes.trim_end())?,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {}
        Err(e) => return Err(format!("notes.md: {e}").into()),
    }
    sections::summary(&mut page, &figures)?;
    for (name, alt) in plots::write(out, &figures)? {
        writeln!(page, "![{alt}]({name})\n")?;
    }
    sections::needed(&mut page, &figures)?;
    sections::hybrids(&mut page, &figures)?;
    sections::sequence(&mut page, &figures)?;
    sections::bias(&mut page, &figures)?;
    sections::lists(&mut page, &figures)?;
    writeln!(page, "## Every scan and view\n")?;
    for place in &figures.places {
        sections::detail(&mut page, &figures, place)?;
    }
    page.truncate(page.trim_end().len());
    page.push('\n');
    Ok(mcvr::volume::write_whole(&out.join("README.md"), |file| file.write_all(page.as_bytes()))?)
}

fn described(c: &Circumstances) -> String {
    let quick = if c.quick { ", **quick run: not for quoting**" } else { "" };
    let commit = c.commit.as_deref().unwrap_or("unknown");
    format!("{}, {} threads, source {commit}{quick}.", c.machine, c.threads)
}
