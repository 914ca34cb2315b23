//! A plan in words, aligned for terminals of 110 columns.

use std::fmt::Write;

use mcvr::plan::{Plan, Verdict, grouped};

use super::setup::Setup;

/// Columns of the text.
const WIDTH: usize = 110;
/// Where the words of a pass begin.
const INDENT: usize = 30;

/// What is planned, the passes, what is left out, and the memory.
pub fn describe(setup: &Setup, camera: Option<&str>, plan: &Plan) -> String {
    let mut out = String::new();
    head(&mut out, setup, camera);
    line(&mut out, "", "pass", "holds", "asked for by, reads, counts");
    for (i, pass) in plan.passes.iter().enumerate() {
        let held = if pass.holds == 0 { "-".to_owned() } else { bytes(pass.holds) };
        line(&mut out, &(i + 1).to_string(), pass.name, &held, &pass.why);
        line(&mut out, "", "", "", &format!("reads {}", pass.reads));
        if !pass.work.is_empty() {
            line(&mut out, "", "", "", &joined(&pass.work));
        }
    }
    line(&mut out, "", "all together", &bytes(plan.bytes), "");
    out.push('\n');
    line(&mut out, "", "left out", "", "because");
    for left in &plan.left_out {
        let counts = if left.work.is_empty() { String::new() } else { format!(": {}", joined(&left.work)) };
        line(&mut out, "", left.name, "", &format!("{}{counts}", left.why));
    }
    out
}

/// Which image of which volume.
fn head(out: &mut String, setup: &Setup, camera: Option<&str>) {
    let (volume, r) = (&setup.scenery.volume, &setup.request);
    let dims = volume.grid().dims().map(|n| n.to_string()).join(" x ");
    let budget = match r.method {
        mcvr::Method::Footprint if r.step < 1.0 => format!("all voxels, in parts of {:.2}", r.step),
        mcvr::Method::Footprint => "all voxels".to_owned(),
        mcvr::Method::Exact => format!("tolerance {}", r.tolerance),
        mcvr::Method::March | mcvr::Method::Rays => format!("{} rays at most", grouped(r.samples)),
        mcvr::Method::Comb => format!("{} rays at most, {:.2} voxels apart", grouped(r.samples), r.step),
        _ => format!("{} samples", grouped(r.samples)),
    };
    let name = camera.map_or(String::new(), |c| format!(" {c}"));
    let rows = [
        ("volume", format!("{}, {dims} voxels of {}", setup.input, volume.voxel_type())),
        ("camera", format!("{}, {} pixels", setup.view, setup.scenery.camera.extent())),
        ("method", format!("{}, {budget}, seed {}, kernel {}, {}", r.method, r.seed, r.kernel, r.estimand)),
    ];
    for (what, text) in rows {
        let name = if what == "camera" { &name[..] } else { "" };
        let _ = writeln!(out, "{:<INDENT$}{text}", format!("{what}{name}"));
    }
    out.push('\n');
}

/// Forecasts on one line.
fn joined(work: &[mcvr::plan::Forecast]) -> String {
    work.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
}

/// A row; words that do not fit are continued below.
fn line(out: &mut String, number: &str, name: &str, held: &str, words: &str) {
    let mut start = format!("{number:>2}  {name:<14} {held:>9}");
    for part in wrapped(words, WIDTH - INDENT) {
        let _ = writeln!(out, "{}", format!("{start:<INDENT$}{part}").trim_end());
        start.clear();
    }
}

/// Lines of at most `width` characters, broken between words (after a semicolon where there are any).
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let separator = if text.contains("; ") { "; " } else { " " };
    let mut lines = vec![String::new()];
    let parts: Vec<&str> = text.split_inclusive(separator).collect();
    for part in parts {
        let last =
            lines.last_mut().filter(|l| l.is_empty() || (l.chars().count() + part.trim_end().chars().count()) <= width);
        match last {
            Some(last) => last.push_str(part),
            None => lines.push(part.to_owned()),
        }
    }
    lines
}

/// Bytes as people read them.
fn bytes(n: u64) -> String {
    let (mut value, mut unit) = (n as f64, "B");
    for next in ["KiB", "MiB", "GiB", "TiB"] {
        if value < 1023.95 {
            break;
        }
        (value, unit) = (value / 1024.0, next);
    }
    if unit == "B" { format!("{n} B") } else { format!("{value:.1} {unit}") }
}

/// Forecast against count, one row a counter.
pub fn table(verdicts: &[Verdict]) -> String {
    let forecast = |v: &Verdict| match &v.forecast {
        None => "unknown".to_owned(),
        Some(f) => match f.at_most {
            Some(most) if most == f.at_least => grouped(most),
            Some(most) => format!("{} to {}", grouped(f.at_least), grouped(most)),
            None => format!("at least {}", grouped(f.at_least)),
        },
    };
    let widest = |texts: &mut dyn Iterator<Item = usize>, least: usize| texts.max().unwrap_or(0).max(least);
    let first = widest(&mut verdicts.iter().map(|v| v.counter.len()), 7);
    let second = widest(&mut verdicts.iter().map(|v| forecast(v).len()), 8);
    let mut out = format!("{:<first$}  {:>second$}  {:>15}\n", "counter", "forecast", "counted");
    for v in verdicts {
        let counted = v.counted.map_or("not counted".into(), grouped);
        let exact = v.forecast.as_ref().is_some_and(|f| f.is_exact());
        let verdict = match (v.holds(), exact) {
            (true, true) => "as forecast",
            (true, false) => "within",
            (false, _) => "WRONG",
        };
        let _ = writeln!(out, "{:<first$}  {:>second$}  {counted:>15}  {verdict}", v.counter, forecast(v));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_readable() {
        for (n, text) in [(0, "0 B"), (1023, "1023 B"), (1024, "1.0 KiB"), (1_048_575, "1.0 MiB"), (5 << 30, "5.0 GiB")]
        {
            assert_eq!(bytes(n), text);
        }
        assert_eq!(bytes(u64::MAX), "16777216.0 TiB");
    }

    #[test]
    fn long_words_are_continued_and_nothing_is_lost() {
        let text = "one 1; two 2; three 3; four 4";
        let lines = wrapped(text, 14);
        assert_eq!(lines.concat(), text);
        assert!(lines.len() > 1 && lines.iter().all(|l| l.trim_end().len() <= 14), "{lines:?}");
        assert_eq!(wrapped("", 10), [""]);
    }
}
