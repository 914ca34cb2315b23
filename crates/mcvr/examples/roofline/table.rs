//! The table.

use serde::Serialize;

use crate::clock::Row;

#[derive(Serialize)]
pub struct Table {
    pub scene: String,
    pub samples: u64,
    pub rounds: usize,
    pub rows: Vec<Row>,
}

impl Table {
    /// Nanoseconds that the limit of a row allows, of one core.
    fn allowed(&self, row: &Row) -> Option<f64> {
        let limit = self.rows.iter().find(|r| Some(r.name.as_str()) == row.limit && r.threads == row.threads)?;
        Some(limit.cpu_ns[1] * row.limit_units)
    }

    /// How many times sooner a row is done than with the fewest threads.
    fn speedup(&self, row: &Row) -> Option<f64> {
        let one = self.rows.iter().find(|r| r.name == row.name && r.threads < row.threads)?;
        Some(one.wall_ns[1] / row.wall_ns[1])
    }

    pub fn markdown(&self) -> String {
        let mut text = format!(
            "{}; 2^{} points; {} rounds; {}.\nProcessor time of all threads per unit, median (least to most); wall time, median.\n\n\
             | loop | threads | ns per unit and core | wall ns | sooner | limit, ns | share of it |\n|---|---|---|---|---|---|---|\n",
            self.scene,
            self.samples.ilog2(),
            self.rounds,
            mcvr::harness::machine()
        );
        for row in &self.rows {
            let [low, mid, high] = row.cpu_ns.map(digits);
            let sooner = self.speedup(row).map_or(String::new(), |s| format!("{s:.2}"));
            let (limit, share) = self.allowed(row).map_or((String::new(), String::new()), |ns| {
                (digits(ns), format!("{:.0} %", 100.0 * ns / row.cpu_ns[1]))
            });
            text.push_str(&format!(
                "| {} | {} | {mid} ({low} to {high}) per {} | {} | {sooner} | {limit} | {share} |\n",
                row.name,
                row.threads,
                row.unit,
                digits(row.wall_ns[1]),
            ));
        }
        text
    }
}

/// Three digits.
fn digits(v: f64) -> String {
    let places = (2 - v.abs().max(1e-9).log10().floor() as i32).clamp(0, 6) as usize;
    format!("{v:.places$}")
}
