//! The page: who is cheapest where.

use std::fmt::Write;

use serde::Serialize;
use serde_json::json;

use crate::clock::{Row, Times};

const ERRORS: [f64; 4] = [0.1, 0.03, 0.01, 0.003];

/// mcvr's own families that the others are held to.
const OWN: [&str; 3] = ["rays", "comb", "qmc"];

/// Families in the order of the page.
const FAMILIES: [&str; 11] = [
    "rays",
    "comb",
    "march",
    "qmc",
    "cv",
    "cv comb",
    "multilevel",
    "comb difference",
    "cv footprint",
    "footprint",
    "joseph",
];

#[derive(Serialize)]
pub struct Measured {
    pub scene: String,
    pub facts: Vec<String>,
    pub times: Times,
}

/// The cheapest setting of some families that reaches an error.
fn cheapest<'a>(rows: &'a [Row], families: &[&str], error: f64, cost: impl Fn(&Row) -> f64) -> Option<&'a Row> {
    rows.iter().filter(|r| families.contains(&r.family) && r.error <= error).min_by(|a, b| cost(a).total_cmp(&cost(b)))
}

fn ms(seconds: f64) -> String {
    format!("{:.2}", 1e3 * seconds)
}

/// The tables of one scene.
pub fn section(measured: &Measured) -> String {
    let rows = &measured.times.rows;
    let mut out = format!("## {}\n\n", measured.scene);
    if !measured.facts.is_empty() {
        let _ = writeln!(out, "Nested grids: {}.\n", measured.facts.join("; "));
    }
    out += "Preparation, ms: ";
    let list: Vec<String> = measured.times.preparations.iter().map(|(n, s)| format!("{n} {}", ms(*s))).collect();
    let _ = writeln!(out, "{}.\n", list.join(", "));
    for (title, prepared) in [("an image alone", 0.0), ("with all preparation", 1.0)] {
        let cost = move |r: &Row| r.seconds + prepared * r.prepared;
        let _ = writeln!(
            out,
            "Least ms of {title} by error:\n\n| family | 10 % | 3 % | 1 % | 0.3 % |\n| --- | --- | --- | --- | --- |"
        );
        for family in FAMILIES.into_iter().filter(|f| rows.iter().any(|r| r.family == *f)) {
            let _ = write!(out, "| {family} |");
            for error in ERRORS {
                let own = cheapest(rows, &OWN, error, cost).map(cost);
                let cell = cheapest(rows, &[family], error, cost).map_or("-".into(), |r| {
                    let ratio = own.map_or(String::new(), |o| format!(", {:.2} of the best", cost(r) / o));
                    format!("{} ({}{ratio})", ms(cost(r)), r.setting)
                });
                let _ = write!(out, " {cell} |");
            }
            out += "\n";
        }
        out += "\n";
    }
    out
}

/// All settings of one scene.
fn settings(measured: &Measured) -> String {
    let mut out = String::from(
        "| family | setting | ms | preparation, ms | error | work |\n| --- | --- | ---: | ---: | ---: | ---: |\n",
    );
    for r in &measured.times.rows {
        let _ = writeln!(
            out,
            "| {} | {} | {} | {} | {:.3} % | {} |",
            r.family,
            r.setting,
            ms(r.seconds),
            ms(r.prepared),
            100.0 * r.error,
            r.work
        );
    }
    out
}

pub fn markdown(all: &[Measured]) -> String {
    let mut out = String::from(include_str!("verdict.md"));
    out += "\nCheapest by scene, family and error. *Best* is the cheapest of `rays`, `comb` and `qmc`; below 1 an estimator beats them.\n\n";
    all.iter().for_each(|m| out += &section(m));
    out += "# All settings\n\n";
    for m in all {
        let _ = writeln!(out, "## {}\n\n{}", m.scene, settings(m));
    }
    out
}

pub fn json(all: &[Measured]) -> String {
    all.iter().map(|m| format!("{}\n", json!(m))).collect()
}
