//! The measurements as tables.

use std::fmt::Write;

use serde_json::Value;

fn number(v: &Value) -> f64 {
    v.as_f64().unwrap_or(f64::NAN)
}

/// Milliseconds: the median, and in brackets how far the others were from it in percent.
fn milliseconds(v: &Value) -> String {
    let (median, least, most) = (number(&v["median"]), number(&v["least"]), number(&v["most"]));
    format!("{:.3} ({:+.0} {:+.0})", 1e3 * median, 100.0 * (least / median - 1.0), 100.0 * (most / median - 1.0))
}

fn mib(v: &Value) -> String {
    format!("{:.1}", number(v) / f64::from(1 << 20))
}

/// A line for the terminal while measuring.
pub fn summary(m: &Value) -> String {
    format!(
        "density {} ms, image 2^20 along z {} ms, {} MiB of its own",
        milliseconds(&m["density, identity"]),
        milliseconds(&m["image, 2^20, z"]),
        mib(&m["own, image, 2^24, z"])
    )
}

fn table(out: &mut String, rows: &[Value], head: &[&str], cells: impl Fn(&Value) -> Vec<String>) {
    compared(out, rows, head, |measured, _| cells(measured));
}

/// A table whose cells are made of a row and the first of the same type and number of threads, which is the smallest.
fn compared(out: &mut String, rows: &[Value], head: &[&str], cells: impl Fn(&Value, &Value) -> Vec<String>) {
    let _ = writeln!(out, "| type | voxels | threads | {} |", head.join(" | "));
    let _ = writeln!(out, "|---|---|---|{}", "---|".repeat(head.len()));
    for row in rows {
        let kind = row["type"].as_str().unwrap_or("");
        let smallest = rows.iter().find(|r| r["type"] == row["type"] && r["threads"] == row["threads"]).unwrap_or(row);
        let cells = cells(&row["measured"], &smallest["measured"]).join(" | ");
        let _ = writeln!(out, "| {kind} | {}³ | {} | {cells} |", row["side"], row["threads"]);
    }
    out.push('\n');
}

/// All tables.
pub fn page(rows: &[Value]) -> String {
    let mut out = String::from(
        "# Seconds and memory by size\n\nThe lobster phantom, mapped from its file or, where the memory table says so, in memory. Milliseconds: median, in brackets the least and \
         the most in percent of it. Views along x, y, z have that axis innermost in the order of voxels.\n\n",
    );
    let phases = |names: &'static [&'static str]| {
        move |m: &Value| names.iter().map(|name| milliseconds(&m[*name])).collect::<Vec<_>>()
    };
    out += "## Before the first sample\n\n";
    let head = ["load (map)", "first pass", "density", "distribution x", "y", "z"];
    let names = &[
        "load",
        "first pass",
        "density, identity",
        "distribution, identity, raster",
        "distribution, identity, y",
        "distribution, identity, z",
    ];
    table(&mut out, rows, &head, phases(names));
    out += "## An image, 400×400, qmc; one ray a pixel marched\n\n";
    let head = ["2^20 x", "y", "z", "2^24 x", "y", "z", "march (with density)"];
    let names = &[
        "image, 2^20, raster",
        "image, 2^20, y",
        "image, 2^20, z",
        "image, 2^24, raster",
        "image, 2^24, y",
        "image, 2^24, z",
        "march",
    ];
    table(&mut out, rows, &head, phases(names));
    out += "## An image's time over that at the smallest size\n\nOf the processor's seconds (the least), same type and number of \
            threads.\n\n";
    let head = ["2^20 x", "y", "z", "2^24 x", "y", "z"];
    let images = ["2^20, raster", "2^20, y", "2^20, z", "2^24, raster", "2^24, y", "2^24, z"];
    compared(&mut out, rows, &head, |m, least| {
        let of = |m: &Value, image: &str| number(&m[format!("image, {image}")]["cpu"]);
        images.map(|image| format!("{:.2}", of(m, image) / of(least, image))).to_vec()
    });
    out += "## Share of the read bandwidth, pass by pass\n\nBytes of the volume over the processor's seconds (the least) of one pass, \
            over the bandwidth that all threads read memory with in the same run. Identity map.\n\n";
    let head = ["GB/s", "density", "distribution x", "y", "z"];
    table(&mut out, rows, &head, |m| {
        let rate = number(&m["read"]["bytes"]) / number(&m["read"]["seconds"]["cpu"]);
        let mut cells = vec![format!("{:.1}", rate * 1e-9)];
        for pass in [
            "density, identity",
            "distribution, identity, raster",
            "distribution, identity, y",
            "distribution, identity, z",
        ] {
            let share = number(&m["bytes"]) / number(&m[pass]["cpu"]) / rate;
            cells.push(format!("{:.0} %", 100.0 * share));
        }
        cells
    });
    out += "## Share of the read bandwidth, both passes\n\nBytes of the volume over the processor's seconds (the least) of density and distribution \
            together (x, y, z), over the bandwidth that all threads read memory with in the same run; 100 % would be one pass at that \
            speed.\n\n";
    let head = ["GB/s", "identity x", "y", "z", "linear x", "y", "z", "Hounsfield x", "y", "z"];
    table(&mut out, rows, &head, |m| {
        let rate = number(&m["read"]["bytes"]) / number(&m["read"]["seconds"]["cpu"]);
        let mut cells = vec![format!("{:.1}", rate * 1e-9)];
        for map in ["identity", "linear", "hounsfield"] {
            for order in ["raster", "y", "z"] {
                let seconds = number(&m[format!("density, {map}")]["cpu"])
                    + number(&m[format!("distribution, {map}, {order}")]["cpu"]);
                cells.push(format!("{:.0} %", 100.0 * number(&m["bytes"]) / seconds / rate));
            }
        }
        cells
    });
    out += "## Memory, MiB\n\n";
    let head = [
        "volume",
        "mapped",
        "distribution",
        "share",
        "own: before",
        "density",
        "distribution z",
        "image 2^24 z",
        "march",
        "of files",
    ];
    table(&mut out, rows, &head, |m| {
        let share = number(&m["distribution bytes"]) / number(&m["bytes"]);
        let place = if m["mapped"] == true { "yes" } else { "no" };
        let mut cells =
            vec![mib(&m["bytes"]), place.into(), mib(&m["distribution bytes"]), format!("{:.2} %", 100.0 * share)];
        let own =
            ["own, before", "own, density", "own, distribution, z", "own, image, 2^24, z", "own, march", "of files"];
        cells.extend(own.map(|phase| mib(&m[phase])));
        cells
    });
    out
}
