//! The page and the table of comma-separated values, from the records alone.

use std::fmt::Write as _;
use std::path::Path;

use serde_json::{Map, Value};

use crate::Outcome;

fn number(v: &Value) -> f64 {
    v.as_f64().unwrap_or(f64::NAN)
}

fn text(v: &Value) -> &str {
    v.as_str().unwrap_or("?")
}

fn rows(v: &Value) -> &[Value] {
    v["rows"].as_array().map_or(&[], Vec::as_slice)
}

/// Seconds relative to the plain image, on one thread and on all.
fn ratios(timing: &Value, row: &Value) -> Vec<(u64, f64, f64)> {
    let same = |t: &&Value| ["effect", "kernel", "method"].iter().all(|k| t[*k] == row[*k]);
    let of = |t: &Value| (t["threads"].as_u64().unwrap_or(0), number(&t["ratio"]), number(&t["seconds"]));
    rows(&timing["effects"]).iter().filter(same).map(of).collect()
}

fn circumstances(part: &Value) -> String {
    let c = &part["circumstances"];
    let quick = if c["quick"] == true { ", **quick run: not for quoting**" } else { "" };
    let commit = c["commit"].as_str().unwrap_or("unknown");
    format!("Measured on {}, {} threads, source {commit}{quick}.", text(&c["machine"]), c["threads"])
}

pub fn write(out: &Path, store: &Map<String, Value>) -> Outcome<()> {
    let null = Value::Null;
    let part = |name: &str| store.get(name).unwrap_or(&null);
    let mut page = String::from("# Effects by method and kernel\n\n");
    writeln!(page, "{}\n", INTRODUCTION.replace('\n', " "))?;
    if store.contains_key("table") {
        table(&mut page, part("table"), part("timing"))?;
        counters(&mut page, part("table"))?;
        std::fs::write(out.join("effects.csv"), csv(part("table"), part("timing"))?)?;
    }
    if store.contains_key("timing") {
        report(&mut page, &part("timing")["report"])?;
        memory(&mut page, &part("timing")["memory"])?;
        gradients(&mut page, &part("timing")["gradients"])?;
        writeln!(page, "{}\n", circumstances(part("timing")))?;
    }
    // What people saw in the pictures and the figures; no program writes it.
    if let Ok(notes) = std::fs::read_to_string(out.join("notes.md")) {
        page += &notes;
    }
    Ok(std::fs::write(out.join("effects.md"), page)?)
}

fn table(page: &mut String, table: &Value, timing: &Value) -> Outcome<()> {
    let all = rows(table);
    let passed = all.iter().filter(|r| r["agreement"]["passed"] == true).count();
    writeln!(page, "## The table\n\n{passed} of {} comparisons agree. {}\n", all.len(), circumstances(table))?;
    writeln!(
        page,
        "Images of {0}×{0} pixels for tests, slopes and errors. Truths: asked for {1} of the mean pixel (five times \
         that under other kernels than `tent`), pixels halved at most {2} times; what each is good to by its own estimate is in the first column. An error or slope against a truth that \
         is not ten times as good would mean nothing: those marked * are taken from the spread of the replicates \
         instead, which the test shows to be unbiased at 2^16 samples.\n",
        table["side"], table["tolerance"], table["depth"]
    )?;
    let t = &timing["effects"];
    writeln!(
        page,
        "Time: one whole image (distribution, sampling, projection) of {0}×{0} pixels at 2^{1} samples over the plain image by the \
         same method and kernel, medians of {2} interleaved rounds after a warm-up.\n",
        t["side"], t["level"], t["rounds"]
    )?;
    let first = &all.first().map(|r| ratios(timing, r)).unwrap_or_default();
    let heads: String =
        first.iter().map(|(n, ..)| format!(" time, {n} thread{} |", if *n == 1 { "" } else { "s" })).collect();
    writeln!(page, "| effect | kernel | truth | method | test | slope | error at 2^22 |{heads}")?;
    writeln!(page, "|---|---|---|---|---|---|---|{}", "---|".repeat(first.len()))?;
    for r in all {
        let (a, s) = (&r["agreement"], &r["slope"]);
        let verdict = if a["passed"] == true { "passed" } else { "**failed**" };
        let mark = |v: &Value| if *v == true { "" } else { " *" };
        let times: String = ratios(timing, r).iter().map(|(_, ratio, _)| format!(" {ratio:.2} |")).collect();
        writeln!(
            page,
            "| {} | {} | {:.2} % | {} | {verdict}, {:.0} | {:.3} ± {:.3}{} | {:.2} %{} |{times}",
            text(&r["effect"]),
            text(&r["kernel"]),
            100.0 * number(&r["truth_error"]),
            text(&r["method"]),
            number(&a["p"]) / number(&a["level"]),
            number(&s["slope"]),
            number(&s["standard_error"]),
            mark(&s["against_truth"]),
            100.0 * number(&r["error"]),
            mark(&r["error_against_truth"])
        )?;
    }
    writeln!(page)?;
    Ok(())
}

const COUNTED: [&str; 8] = [
    "samples",
    "inside",
    "line_weights",
    "gradients",
    "gradient_reads",
    "depth_cues",
    "voxel_colours",
    "depth_colours",
];

fn counters(page: &mut String, table: &Value) -> Outcome<()> {
    writeln!(page, "Work of one image (`qmc`, `tent`, 2^22 samples), per sample drawn:\n")?;
    writeln!(page, "| effect | {} |", COUNTED[1..].join(" | ").replace('_', " "))?;
    writeln!(page, "|---|{}", "---|".repeat(COUNTED.len() - 1))?;
    for r in rows(table).iter().filter(|r| r["kernel"] == "tent" && r["method"] == "qmc") {
        let c = &r["counters"];
        let cells: Vec<String> =
            COUNTED[1..].iter().map(|k| format!("{:.3}", number(&c[*k]) / number(&c["samples"]))).collect();
        writeln!(page, "| {} | {} |", text(&r["effect"]), cells.join(" | "))?;
    }
    writeln!(page)?;
    Ok(())
}

fn csv(table: &Value, timing: &Value) -> Outcome<String> {
    let mut csv =
        String::from("effect,kernel,method,truth_error,passed,p,level,tests,slope,slope_se,slope_against_truth,error,");
    csv += "error_against_truth,seconds_one_thread,ratio_one_thread,seconds_all,ratio_all,";
    writeln!(csv, "{}", COUNTED.join(","))?;
    for r in rows(table) {
        let (a, s) = (&r["agreement"], &r["slope"]);
        let name = text(&r["effect"]).replace(',', "");
        write!(csv, "{name},{},{},{},", text(&r["kernel"]), text(&r["method"]), r["truth_error"])?;
        write!(csv, "{},{},{},{},", a["passed"], a["p"], a["level"], a["tests"])?;
        write!(csv, "{},{},{},", s["slope"], s["standard_error"], s["against_truth"])?;
        write!(csv, "{},{},", r["error"], r["error_against_truth"])?;
        let times = ratios(timing, r);
        for n in [0, times.len().saturating_sub(1)] {
            let cell = |v: Option<f64>| v.map_or(String::new(), |v| format!("{v:.5}"));
            write!(csv, "{},{},", cell(times.get(n).map(|t| t.2)), cell(times.get(n).map(|t| t.1)))?;
        }
        let counts: Vec<String> = COUNTED.iter().map(|k| r["counters"][*k].to_string()).collect();
        writeln!(csv, "{}", counts.join(","))?;
    }
    Ok(csv)
}

fn report(page: &mut String, report: &Value) -> Outcome<()> {
    writeln!(page, "## The report's shaded figure\n")?;
    writeln!(
        page,
        "One million samples, `tent`, {0}×{0} pixels, the whole lobster, loading the scan included in the last column alone; \
         medians of {1}. The report: 2.297 s of sampling and 3.51 s in all shaded, 1.192 s in all plain (`mc` with sorting).\n",
        report["side"], report["rounds"]
    )?;
    writeln!(
        page,
        "| method | threads | image | sampling | sampling + projection | complete | with loading | shaded over plain |"
    )?;
    writeln!(page, "|---|---|---|---|---|---|---|---|")?;
    let ms = |v: &Value| format!("{:.1} ms", 1e3 * number(v));
    for r in rows(report) {
        let plain = rows(report)
            .iter()
            .find(|p| p["image"] == "plain" && p["method"] == r["method"] && p["threads"] == r["threads"])
            .unwrap_or(r);
        writeln!(
            page,
            "| {} | {} | {} | {} | {} | {} | {} | {:.2} |",
            text(&r["method"]),
            r["threads"],
            text(&r["image"]),
            ms(&r["sampling"]),
            ms(&r["sampling_and_projection"]),
            ms(&r["complete"]),
            ms(&r["with_loading"]),
            number(&r["complete"]) / number(&plain["complete"])
        )?;
    }
    writeln!(page)?;
    Ok(())
}

fn memory(page: &mut String, memory: &Value) -> Outcome<()> {
    let mib = |b: f64| b / 1024.0 / 1024.0;
    let (voxels, samples) = (number(&memory["voxels"]), number(&memory["samples"]));
    let (field, copies) = (12.0 * voxels, 36.0 * samples);
    writeln!(page, "## Memory\n\nPeak of the whole program, the CT head at {samples:.0} samples, `qmc`:\n")?;
    for r in rows(memory) {
        writeln!(page, "- {}: {:.0} MiB", text(&r["image"]), mib(number(&r["peak_memory_bytes"])))?;
    }
    writeln!(
        page,
        "- the scan itself: {:.0} MiB\n- what the report's approach would hold besides the scan, at 32-bit floats: a gradient for every voxel, \
         3 × 4 B × {voxels:.0} = {:.0} MiB, and a position, a normal and a colour for every sample, 3 × 3 × 4 B × {samples:.0} = \
         {:.0} MiB; {:.0} MiB together (computed, not measured)\n",
        mib(number(&memory["volume_bytes"])),
        mib(field),
        mib(copies),
        mib(field + copies)
    )?;
    Ok(())
}

fn gradients(page: &mut String, gradients: &Value) -> Outcome<()> {
    writeln!(page, "## Gradients: read for each sample, or stored for each voxel first\n")?;
    writeln!(
        page,
        "One shaded image (`qmc`, `tent`, one-sided, {0}×{0} pixels), {1} threads, the distribution built before; medians of 3. \
         Voxels drawn: the expected share of all voxels that M independent samples draw at least once.\n",
        gradients["side"], gradients["threads"]
    )?;
    writeln!(
        page,
        "| scan | M | voxels drawn | lazy | stored | stored takes | lazy over stored |\n|---|---|---|---|---|---|---|"
    )?;
    for r in rows(gradients) {
        let (lazy, stored) = (number(&r["lazy"]), number(&r["stored"]));
        writeln!(
            page,
            "| {} | 2^{} | {:.1} % | {:.1} ms | {:.1} ms | {:.0} MiB | {:.2} |",
            text(&r["scan"]),
            r["level"],
            100.0 * number(&r["voxels_hit"]),
            1e3 * lazy,
            1e3 * stored,
            number(&r["stored_bytes"]) / 1024.0 / 1024.0,
            lazy / stored
        )?;
    }
    writeln!(page)?;
    Ok(())
}

const INTRODUCTION: &str = "Every effect of METHOD section 5 on the real lobster (view 30,60; isovalues below 50, the resin, weigh
nothing), `line` images. **Test**: 32 replicates of 2^16 samples against ray casting of the same, Student's t over pixels, rows,
columns and the whole, level by Šidák so that a false alarm anywhere in the table has probability 1e-3; the number is the
smallest p over its level (below 1 fails). **Slope**: least squares of log RMSE over log samples, 2^12 to 2^20 by factors
of 4, 8 replicates each, with its standard error (jackknife over replicates); -0.5 is expected of `mc`. **Error**: RMSE over the mean pixel. The `shell`
kernel is left out: ray casting has no truth of it.";
