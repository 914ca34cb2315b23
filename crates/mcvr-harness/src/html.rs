//! A report as one HTML file that needs nothing beside it: no network, no other file. It reads without a script; the
//! script adds words under the pointer and the picture viewer.

use std::collections::BTreeSet;
use std::path::Path;

use crate::HarnessError;
use crate::output::narrow_name;
use crate::report::Block;

use embed::{download, picture, read};

mod embed;
mod viewer;

const STYLE: &str = include_str!("report.css");
const SCRIPT: &str = include_str!("report.js");

/// Fewer headings than this need no list of contents.
const CONTENTS_FROM: usize = 3;

/// The whole document; plots are inlined, pictures and downloads embedded. Those that are not in the folder are left
/// out.
///
/// # Errors
/// [`HarnessError::File`] when a file is there but cannot be read.
pub(crate) fn page(title: &str, blocks: &[Block], folder: &Path) -> Result<String, HarnessError> {
    let headings = headings(blocks);
    let mut body = String::new();
    let (mut section, mut about) = (0, title);
    for block in blocks {
        match block {
            Block::Lead(lead) => body.push_str(&format!("<p class=\"lead\">{}</p>\n", escape(lead))),
            Block::Heading(heading) => {
                body.push_str(if section == 0 { "</header>\n" } else { "</section>\n" });
                if section == 0 {
                    body.push_str(&contents(&headings));
                }
                let id = headings.get(section).map_or("", |(id, _)| id);
                let words = escape(heading);
                body.push_str(&format!("<section aria-labelledby=\"{id}\">\n<h2 id=\"{id}\">{words}</h2>\n"));
                (section, about) = (section + 1, heading);
            }
            Block::Subheading(heading) => {
                body.push_str(&format!("<h3>{}</h3>\n", escape(heading)));
                about = heading;
            }
            Block::Text(text) => body.push_str(&format!("<p>{}</p>\n", escape(text))),
            Block::Code(code) => {
                body.push_str(&format!("<pre tabindex=\"0\"><code>{}</code></pre>\n", escape(code)));
            }
            Block::Table { head, names, rows } => body.push_str(&table(about, head, *names, rows)),
            Block::Plot(name, what) => body.push_str(&plot(folder, name, what)?),
            Block::Pictures(list) => {
                body.push_str("<div class=\"pictures\">\n");
                for (name, what) in list {
                    body.push_str(&picture(&folder.join(name), what, "")?.unwrap_or_default());
                }
                body.push_str("</div>\n");
            }
            Block::Viewer(viewer) => body.push_str(&viewer::html(viewer, folder)?),
            Block::Downloads(list) => {
                body.push_str("<ul class=\"downloads\">\n");
                for (name, what) in list {
                    body.push_str(&download(folder, name, what)?.unwrap_or_default());
                }
                body.push_str("</ul>\n");
            }
            Block::Files(list) => {
                body.push_str("<ul>\n");
                for (name, what) in list {
                    let (name, what) = (escape(name), escape(what));
                    body.push_str(&format!("<li><a href=\"{name}\">{name}</a>: {what}</li>\n"));
                }
                body.push_str("</ul>\n");
            }
        }
    }
    body.push_str(if section == 0 { "</header>\n" } else { "</section>\n" });
    let title = escape(title);
    // File names are long words.
    let broken = title.replace('_', "_<wbr>");
    // The policy is a promise that the browser keeps: this page asks for nothing from anywhere. The empty icon keeps
    // servers from being asked for theirs.
    Ok(format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; \
         style-src 'unsafe-inline'; script-src 'unsafe-inline'\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<link rel=\"icon\" href=\"data:,\">\n\
         <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n\
         <body>\n<main>\n<header>\n<h1>{broken}</h1>\n{body}</main>\n<script>\n{SCRIPT}</script>\n</body>\n</html>\n"
    ))
}

/// Anchor and words of every heading; anchors are unique.
fn headings(blocks: &[Block]) -> Vec<(String, &str)> {
    let mut taken = BTreeSet::new();
    let words = blocks.iter().filter_map(|b| if let Block::Heading(words) = b { Some(words.as_str()) } else { None });
    words
        .map(|words| {
            let parts = words.split(|c: char| !c.is_ascii_alphanumeric()).filter(|part| !part.is_empty());
            let slug = parts.map(str::to_ascii_lowercase).collect::<Vec<_>>().join("-");
            let slug = if slug.is_empty() { "section".to_owned() } else { slug };
            let tries = std::iter::once(slug.clone()).chain((2..).map(|n| format!("{slug}-{n}")));
            let id = tries.into_iter().find(|id| !taken.contains(id)).unwrap_or_default();
            taken.insert(id.clone());
            (id, words)
        })
        .collect()
}

fn contents(headings: &[(String, &str)]) -> String {
    if headings.len() < CONTENTS_FROM {
        return String::new();
    }
    let items: String =
        headings.iter().map(|(id, words)| format!("<li><a href=\"#{id}\">{}</a></li>\n", escape(words))).collect();
    format!("<nav aria-label=\"Contents\">\n<ul>\n{items}</ul>\n</nav>\n")
}

/// The plot and, where there is one, its narrow form; the style sheet shows the one that fits.
fn plot(folder: &Path, name: &str, what: &str) -> Result<String, HarnessError> {
    let Some(wide) = read(&folder.join(name))? else { return Ok(String::new()) };
    let narrow = read(&folder.join(narrow_name(name)))?;
    let inline = |bytes: &[u8], class: &str| {
        // The declaration of the file has no place inside HTML.
        let svg = String::from_utf8_lossy(bytes);
        let svg = svg.find("<svg").map_or("", |at| &svg[at..]);
        let svg = svg.replacen(" xmlns=\"http://www.w3.org/2000/svg\"", "", 1);
        format!("<div class=\"{class}\">{}</div>", svg.trim_end())
    };
    let forms = match narrow {
        Some(narrow) => inline(&wide, "wide") + &inline(&narrow, "narrow"),
        None => inline(&wide, "scroll"),
    };
    Ok(format!("<figure class=\"plot\">{forms}<figcaption>{}</figcaption></figure>\n", escape(what)))
}

/// The first column names the rows; a table wider than the page scrolls in its own box, by keys as well.
fn table(about: &str, head: &[String], names: usize, rows: &[Vec<String>]) -> String {
    let class = |i: usize| if i < names { " class=\"name\"" } else { "" };
    let cell =
        |i: usize, tag: &str, scope: &str, text: &str| format!("<{tag}{}{scope}>{}</{}>", class(i), escape(text), tag);
    let titles: String = head.iter().enumerate().map(|(i, c)| cell(i, "th", " scope=\"col\"", c)).collect();
    let mut text = format!(
        "<div class=\"scroll\" role=\"region\" aria-label=\"Table: {}\" tabindex=\"0\"><table>\n\
         <thead><tr>{titles}</tr></thead>\n<tbody>\n",
        escape(about)
    );
    let mut last = "";
    for row in rows {
        // A rule where the first column changes keeps groups of rows together.
        let first = row.first().map_or("", String::as_str);
        let class = if first == last { " class=\"same\"" } else { "" };
        let named = names.max(1);
        let cells = row.iter().enumerate();
        let cells: String = cells
            .map(|(i, c)| if i < named { cell(i, "th", " scope=\"row\"", c) } else { cell(i, "td", "", c) })
            .collect();
        text.push_str(&format!("<tr{class}>{cells}</tr>\n"));
        last = first;
    }
    text.push_str("</tbody></table></div>\n");
    text
}

/// Text as HTML or SVG content or attribute value.
pub(crate) fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            c => escaped.push(c),
        }
    }
    escaped
}

#[cfg(test)]
mod tests;
