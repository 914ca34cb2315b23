//! What a run found, line by line, for people and programs.

use serde::Serialize;

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Check {
    /// Images and their errors, bit for bit.
    Accuracy,
    /// Work counters.
    Work,
    /// Instructions by stage.
    Instructions,
    /// Ratios of times.
    Time,
}

impl Check {
    /// Every check, in the order of the report.
    pub const ALL: [Check; 4] = [Check::Accuracy, Check::Work, Check::Instructions, Check::Time];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Check::Accuracy => "accuracy",
            Check::Work => "work",
            Check::Instructions => "instructions",
            Check::Time => "time",
        }
    }

    /// What the check holds its lines to.
    pub fn rule(self) -> &'static str {
        match self {
            Check::Accuracy => "images and errors, identical bit for bit",
            Check::Work => "work counters, identical",
            Check::Instructions => "instructions by stage, within 2 %",
            Check::Time => "time against the other stages of the run, within 25 %, all pairs agreeing",
        }
    }
}

impl std::str::FromStr for Check {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|c| c.name() == s);
        found.ok_or_else(|| format!("unknown check '{s}'; one of {}", Self::ALL.map(Check::name).join(", ")))
    }
}

/// What became of one line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// As before, within the tolerance.
    Same,
    /// Another result, or more work, than the tolerance allows: a regression.
    Worse,
    /// In the baseline, and no longer there: a check that is lost.
    Gone,
    /// Less work than the tolerance allows: no failure, but the baseline should follow.
    Better,
    /// Not in the baseline.
    New,
    /// Reported only.
    NotJudged,
}

impl Verdict {
    /// True for what makes a run fail.
    pub fn fails(self) -> bool {
        matches!(self, Verdict::Worse | Verdict::Gone)
    }

    /// Word for people.
    pub fn word(self) -> &'static str {
        match self {
            Verdict::Same => "same",
            Verdict::Worse => "REGRESSED",
            Verdict::Gone => "GONE",
            Verdict::Better => "better",
            Verdict::New => "new",
            Verdict::NotJudged => "not judged",
        }
    }
}

/// One thing that was compared.
#[derive(Clone, Debug, Serialize)]
pub struct Line {
    /// Stage, or accuracy case.
    pub name: String,
    /// As the baseline has it.
    pub baseline: String,
    /// As it is.
    pub now: String,
    /// From the one to the other.
    pub change: String,
    /// What to think of it.
    pub verdict: Verdict,
    /// What probably changed.
    pub note: String,
}

/// One check.
#[derive(Clone, Debug, Serialize)]
pub struct Section {
    /// Which.
    pub check: Check,
    /// False when the lines are only reported.
    pub judged: bool,
    /// All lines.
    pub lines: Vec<Line>,
    /// What a reader should know besides.
    pub notices: Vec<String>,
    /// Failures that no line stands for, such as a missing baseline.
    pub problems: Vec<String>,
}

impl Section {
    /// An empty check that is judged.
    pub fn new(check: Check) -> Self {
        Self { check, judged: true, lines: vec![], notices: vec![], problems: vec![] }
    }

    /// Adds something to know.
    pub fn notice(&mut self, text: String) {
        self.notices.push(text);
    }

    /// Adds a failure.
    pub fn problem(&mut self, text: String) {
        self.judged = false;
        self.problems.push(text);
    }

    /// Lines and problems that make the run fail.
    pub fn failures(&self) -> usize {
        self.problems.len() + self.lines.iter().filter(|l| l.verdict.fails()).count()
    }

    fn count(&self, verdict: Verdict) -> usize {
        self.lines.iter().filter(|l| l.verdict == verdict).count()
    }

    /// `92 same, 2 REGRESSED`.
    pub fn counts(&self) -> String {
        use Verdict::{Better, Gone, New, NotJudged, Same, Worse};
        let words = [Same, Worse, Gone, Better, New, NotJudged].map(|v| (self.count(v), v.word()));
        let words: Vec<String> = words.iter().filter(|w| w.0 > 0).map(|(n, word)| format!("{n} {word}")).collect();
        if words.is_empty() { "nothing compared".into() } else { words.join(", ") }
    }
}

/// A whole run.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The checks that were made.
    pub sections: Vec<Section>,
    /// Wall time of the run, s.
    pub seconds: f64,
}

/// Lines of one verdict that are shown one by one to people.
const SHOWN: usize = 12;

impl Report {
    /// What makes the run fail.
    pub fn failures(&self) -> usize {
        self.sections.iter().map(Section::failures).sum()
    }

    /// True when at least one check was judged.
    pub fn is_judged(&self) -> bool {
        self.sections.iter().any(|s| s.judged && !s.lines.is_empty())
    }

    /// The last line: what is wrong, or that nothing is.
    pub fn verdict(&self) -> String {
        let failing: Vec<String> = self.sections.iter().filter(|s| s.failures() > 0).map(failure).collect();
        if !failing.is_empty() {
            return format!("regression: {}", failing.join("; "));
        }
        if !self.is_judged() {
            return "nothing was judged".into();
        }
        let judged: Vec<&str> = self.sections.iter().filter(|s| s.judged).map(|s| s.check.name()).collect();
        format!("no regression ({}), {:.0} s", judged.join(", "), self.seconds)
    }

    /// For terminals: what moved, and how many did not.
    pub fn text(&self, all: bool) -> String {
        let mut text = String::new();
        for section in &self.sections {
            text += &format!("{}: {}\n  {}\n", section.check.name(), section.check.rule(), section.counts());
            for line in shown(section, all) {
                text += &format!("  {:11} {}: {}\n", line.verdict.word(), line.name, figures(line));
                if !line.note.is_empty() {
                    text += &format!("              {}\n", line.note);
                }
            }
            text += &left_out(section, all).map_or(String::new(), |n| format!("  … and {n} more; --all shows them\n"));
            for problem in &section.problems {
                text += &format!("  FAILED      {problem}\n");
            }
            section.notices.iter().for_each(|n| text += &format!("  note: {n}\n"));
            text.push('\n');
        }
        text + &self.verdict() + "\n"
    }

    /// The same as Markdown; every line where `all`, else those that moved.
    pub fn markdown(&self, heading: &str, all: bool) -> String {
        let cell = |s: &str| s.replace('|', "\\|").replace(['\n', '\r'], " ");
        let mut text = format!("# Regression benchmarks\n\n{heading}\n\n**{}**\n", self.verdict());
        for section in &self.sections {
            text += &format!(
                "\n## {}\n\n{}: {}.\n",
                capital(section.check.name()),
                capital(section.check.rule()),
                section.counts()
            );
            section.problems.iter().for_each(|p| text += &format!("\n**Failed:** {p}\n"));
            section.notices.iter().for_each(|n| text += &format!("\nNote: {n}.\n"));
            let lines = shown(section, all);
            if lines.is_empty() {
                continue;
            }
            text += "\n| what | baseline | now | change | verdict |\n|---|---:|---:|---|---|\n";
            for l in lines {
                let change = if l.note.is_empty() { l.change.clone() } else { format!("{} {}", l.change, l.note) };
                let cells = [&l.name, &l.baseline, &l.now, change.trim(), l.verdict.word()].map(cell);
                text += &format!("| {} |\n", cells.join(" | "));
            }
            text += &left_out(section, all).map_or(String::new(), |n| format!("\n… and {n} more.\n"));
        }
        text
    }
}

/// The check and the first names that failed in it.
fn failure(section: &Section) -> String {
    let names: Vec<&str> = section.lines.iter().filter(|l| l.verdict.fails()).map(|l| l.name.as_str()).collect();
    let name = section.check.name();
    if names.is_empty() {
        return format!("{name} ({})", section.problems.join("; "));
    }
    let rest = if names.len() > 3 { format!(" and {} more", names.len() - 3) } else { String::new() };
    format!("{name} of {}{rest}", names[..names.len().min(3)].join(", "))
}

fn capital(text: &str) -> String {
    let mut chars = text.chars();
    chars.next().map_or(String::new(), |c| c.to_uppercase().collect::<String>() + chars.as_str())
}

fn figures(line: &Line) -> String {
    let change = if line.change.is_empty() { String::new() } else { format!(" ({})", line.change) };
    match (line.baseline.as_str(), line.now.as_str()) {
        ("", now) => format!("{now}{change}"),
        (before, "") => format!("was {before}{change}"),
        (before, now) => format!("{before} → {now}{change}"),
    }
}

/// Whether a line says more than its count does.
fn speaks(line: &Line) -> bool {
    !matches!(line.verdict, Verdict::Same | Verdict::New | Verdict::NotJudged)
}

fn shown(section: &Section, all: bool) -> Vec<&Line> {
    let most = if all { usize::MAX } else { SHOWN };
    section.lines.iter().filter(|l| all || speaks(l)).take(most).collect()
}

fn left_out(section: &Section, all: bool) -> Option<usize> {
    let speaking = section.lines.iter().filter(|l| speaks(l)).count();
    (!all && speaking > SHOWN).then(|| speaking - SHOWN)
}
