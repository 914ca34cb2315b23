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
                let list: Vec<_> = list.iter().filter(|(name, _)| present(name)).collect();
                let head: Vec<String> = list.iter().map(|(_, what)| what.clone()).collect();
                let cells: Vec<String> =
                    list.iter().map(|(name, what)| format!("![{}]({name})", escape(what))).collect();
                text.push_str(&row(head.iter().map(|h| escape(h))));
                text.push_str(&row(head.iter().map(|_| "---".to_owned())));
                text.push_str(&row(cells.into_iter()));
            }
            Block::Files(list) => {
                list.iter().for_each(|(name, what)| text.push_str(&format!("- [{name}]({name}): {}\n", escape(what))));
            }
        }
    }
    text
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
