//! A report as Markdown that links the files beside it.

use std::path::Path;

use crate::report::Block;

/// The whole document; pictures and plots that are not in the folder are left out.
pub(crate) fn page(title: &str, blocks: &[Block], folder: &Path) -> String {
    let mut text = format!("# {}\n", escape(title));
    let present = |name: &str| folder.join(name).is_file();
    for block in blocks {
        text.push('\n');
        match block {
            Block::Lead(lead) => text.push_str(&format!("**{}**\n", escape(lead))),
            Block::Heading(heading) => text.push_str(&format!("## {}\n", escape(heading))),
            Block::Subheading(heading) => text.push_str(&format!("### {}\n", escape(heading))),
            Block::Text(paragraph) => text.push_str(&format!("{}\n", escape(paragraph))),
            Block::Code(code) => code.lines().for_each(|line| text.push_str(&format!("    {line}\n"))),
            Block::Table { head, names, rows } => table(&mut text, head, *names, rows),
            Block::Plot(name, what) if present(name) => text.push_str(&format!("![{}]({name})\n", escape(what))),
            Block::Plot(..) => {}
            Block::Pictures(list) => {
                let there: Vec<_> = list.iter().filter(|(name, _)| present(name)).collect();
                let columns = there.iter().map(|(name, what)| (what.clone(), vec![(name.clone(), what.clone())]));
                pictures(&mut text, &columns.collect::<Vec<_>>());
            }
            Block::Viewer(viewer) => {
                let (name, what) = &viewer.truth;
                if present(name) {
                    text.push_str(&format!("![{}]({name})\n\n{}\n", escape(what), escape(what)));
                }
                for series in &viewer.series {
                    let shots = series.shots.iter().filter(|s| present(&s.image) && present(&s.difference));
                    let columns = shots.map(|s| {
                        let pair = [
                            (s.image.clone(), s.caption.clone()),
                            (s.difference.clone(), format!("{}, difference", s.caption)),
                        ];
                        (s.caption.clone(), pair.to_vec())
                    });
                    let columns: Vec<_> = columns.collect();
                    if !columns.is_empty() {
                        text.push_str(&format!("\n### {}\n\n", escape(&series.label)));
                        pictures(&mut text, &columns);
                    }
                }
            }
            Block::Downloads(list) | Block::Files(list) => {
                list.iter().for_each(|(name, what)| text.push_str(&format!("- [{name}]({name}): {}\n", escape(what))));
            }
        }
    }
    text
}

/// A table with a picture, or one above another, below each caption; every column has equally many.
fn pictures(text: &mut String, columns: &[(String, Vec<(String, String)>)]) {
    if columns.is_empty() {
        return;
    }
    text.push_str(&row(columns.iter().map(|(head, _)| escape(head))));
    text.push_str(&row(columns.iter().map(|_| "---".to_owned())));
    for i in 0..columns.iter().map(|(_, list)| list.len()).min().unwrap_or(0) {
        text.push_str(&row(columns.iter().map(|(_, list)| format!("![{}]({})", escape(&list[i].1), list[i].0))));
    }
}

fn table(text: &mut String, head: &[String], names: usize, rows: &[Vec<String>]) {
    text.push_str(&row(head.iter().map(|h| escape(h))));
    text.push_str(&row((0..head.len()).map(|i| if i < names { "---" } else { "---:" }.to_owned())));
    rows.iter().for_each(|cells| text.push_str(&row(cells.iter().map(|c| escape(c)))));
}

fn row(cells: impl Iterator<Item = String>) -> String {
    format!("| {} |\n", cells.collect::<Vec<_>>().join(" | "))
}

/// Keeps characters that Markdown or HTML would read as markup.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '\n' | '\r' => escaped.push(' '),
            '\\' | '`' | '*' | '_' | '[' | ']' | '<' | '>' | '|' | '#' | '&' => escaped.extend(['\\', c]),
            c => escaped.push(c),
        }
    }
    escaped
}
