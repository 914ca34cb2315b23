//! The table of claims as text, Markdown and JSON.

use mcvr::claims::{Claim, Finding, Options, Outcome};
use mcvr::harness;
use serde_json::{Value, json};

use super::setup::Setup;

/// A claim and what came of it.
pub type Tested<'a> = (&'a Claim, Outcome);

/// What every table states: where and with what it was measured.
pub fn about(setup: &Setup, options: &Options) -> Value {
    let (scenery, request) = (&setup.scenery, &setup.request);
    let extent = scenery.camera.extent();
    // Results name no folder of a machine.
    let dataset = std::path::Path::new(&setup.input).file_name().map(|n| n.to_string_lossy().into_owned());
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "commit": harness::git_commit(),
        "machine": harness::machine(),
        "threads": rayon::current_num_threads(),
        "dataset": dataset.unwrap_or_else(|| setup.input.clone()),
        "dims": scenery.volume.grid().dims(),
        "type": scenery.volume.voxel_type().name(),
        "map": scenery.map,
        "view": setup.view,
        "width": extent.width,
        "height": extent.height,
        "kernel": request.kernel.name(),
        "estimand": request.estimand.name(),
        "order": request.order.resolve(&scenery.camera, scenery.volume.grid()).name(),
        "scramble": request.scramble.name(),
        "cull": request.cull,
        "seed": request.seed,
        "tolerance": request.tolerance,
        "repeats": options.repeats,
        "sizes": options.sizes,
    })
}

/// The same in one sentence.
fn sentence(about: &Value) -> String {
    let text = |key: &str| match &about[key] {
        Value::String(s) => s.clone(),
        Value::Null => "unknown".into(),
        other => other.to_string(),
    };
    format!(
        "{} ({} voxels, {}), {}, {}×{} pixels, kernel {}, estimand {}, voxel order {}, scramble {}, seed {}; truth to a tolerance of {}; \
         medians of {} repeats with their extremes, 95 % intervals of exponents; {} threads unless said otherwise; {}; version {}, \
         commit {}.",
        text("dataset"),
        text("dims").trim_matches(['[', ']']).replace(',', "×"),
        text("type"),
        text("view"),
        text("width"),
        text("height"),
        text("kernel"),
        text("estimand"),
        text("order"),
        text("scramble"),
        text("seed"),
        text("tolerance"),
        text("repeats"),
        text("threads"),
        text("machine"),
        text("version"),
        text("commit"),
    )
}

/// Names, quotes, tests and criteria.
pub fn list(claims: &[&Claim]) -> String {
    let one =
        |c: &&Claim| format!("{}: “{}”\n    tested:  {}\n    verdict: {}\n", c.name, c.quote, c.tested, c.criterion);
    claims.iter().map(one).collect()
}

/// The verdict in words, with a mark where the figures reach across a limit.
fn verdict(outcome: &Outcome) -> String {
    match &outcome.finding {
        Some(Finding { verdict, uncertain: true, .. }) => format!("{} (uncertain)", verdict.words()),
        Some(finding) => finding.verdict.words().into(),
        None => "failed".into(),
    }
}

fn figures(outcome: &Outcome) -> Vec<String> {
    outcome.finding.iter().flat_map(|f| &f.figures).map(ToString::to_string).collect()
}

/// What else there is to say: the note, or why a measurement failed.
fn note(outcome: &Outcome) -> &str {
    outcome.error.as_deref().or(outcome.finding.as_ref().map(|f| f.note.as_str())).unwrap_or_default()
}

fn counts(tested: &[Tested<'_>]) -> String {
    let mut counts: Vec<(String, usize)> = vec![];
    for (_, outcome) in tested {
        let words = outcome.finding.as_ref().map_or("failed", |f| f.verdict.words());
        match counts.iter_mut().find(|(w, _)| w == words) {
            Some((_, n)) => *n += 1,
            None => counts.push((words.into(), 1)),
        }
    }
    let seconds: f64 = tested.iter().map(|(_, o)| o.seconds).sum();
    let counts: Vec<String> = counts.into_iter().map(|(words, n)| format!("{n} {words}")).collect();
    format!("{} claims: {}; {seconds:.0} s", tested.len(), counts.join(", "))
}

/// For a terminal.
pub fn plain(tested: &[Tested<'_>], about: &Value) -> String {
    let mut text = String::new();
    for (claim, outcome) in tested {
        text += &format!("{}: “{}”\n  verdict  {}\n", claim.name, claim.quote, verdict(outcome).to_uppercase());
        text += &format!("  by       {}\n  tested   {}\n", claim.criterion, claim.tested);
        for (i, figure) in figures(outcome).iter().enumerate() {
            text += &format!("  {}  {figure}\n", if i == 0 { "figures" } else { "       " });
        }
        text += &format!("  note     {}\n  took     {:.1} s\n\n", note(outcome), outcome.seconds);
    }
    for (claim, outcome) in tested {
        text += &format!("{:32} {}\n", verdict(outcome), claim.quote);
    }
    text + &format!("\n{}\n{}\n", counts(tested), sentence(about))
}

/// One row a claim.
pub fn markdown(tested: &[Tested<'_>], about: &Value) -> String {
    let cell = |s: &str| s.replace('|', "\\|").replace(['\n', '\r'], " ").replace('*', "\\*");
    let mut text = format!(
        "# The report's claims\n\nA. Law and E. Blythe, Monte Carlo Volume Rendering, tested by `mcvr claims --markdown`. {}\n\n{}.\n\n",
        cell(&sentence(about)),
        counts(tested)
    );
    text += "| claim | verdict | figures | how it was tested | criterion, fixed beforehand |\n|---|---|---|---|---|\n";
    for (claim, outcome) in tested {
        let figures = figures(outcome).iter().map(|f| cell(f)).chain([cell(note(outcome))]).collect::<Vec<_>>();
        let cells = [
            format!("“{}”", cell(claim.quote)),
            format!("**{}**", cell(&verdict(outcome))),
            figures.join("<br>"),
            cell(claim.tested),
            cell(claim.criterion),
        ];
        text += &format!("| {} |\n", cells.join(" | "));
    }
    text
}

/// Everything, for a program.
pub fn json(tested: &[Tested<'_>], about: &Value) -> serde_json::Result<String> {
    let claims: Vec<Value> =
        tested.iter().map(|(claim, outcome)| json!({ "claim": claim, "outcome": outcome })).collect();
    let mut text = serde_json::to_string_pretty(&json!({ "about": about, "claims": claims }))?;
    text.push('\n');
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr::claims::{CATALOGUE, Figure, Unit, Verdict};

    fn three() -> Vec<Tested<'static>> {
        let finding = |verdict, uncertain| {
            let figures = vec![Figure::plain("a | b", 2.0, Unit::Ratio)];
            Some(Finding { verdict, uncertain, figures, note: "x".into() })
        };
        let outcome = |finding, error: Option<&str>| Outcome { finding, error: error.map(Into::into), seconds: 1.0 };
        let outcomes = [
            outcome(finding(Verdict::Holds, true), None),
            outcome(finding(Verdict::DoesNotHold, false), None),
            outcome(None, Some("no disk")),
        ];
        CATALOGUE.iter().zip(outcomes).collect()
    }

    #[test]
    fn a_table_says_verdicts_doubts_and_failures() {
        let text = plain(&three(), &json!({ "dataset": "blob", "dims": [2, 3, 4] }));
        for part in ["HOLDS (UNCERTAIN)", "DOES NOT HOLD", "FAILED", "no disk", "2×3×4 voxels", "a | b: 2.00×"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(text.contains("3 claims: 1 holds, 1 does not hold, 1 failed; 3 s"), "{text}");
    }

    #[test]
    fn markdown_keeps_its_columns() {
        let text = markdown(&three(), &json!({}));
        let rows: Vec<&str> = text.lines().filter(|l| l.starts_with("| “")).collect();
        assert_eq!(rows.len(), 3);
        for row in rows {
            assert_eq!(row.replace("\\|", "").matches('|').count(), 6, "{row}");
        }
    }
}
