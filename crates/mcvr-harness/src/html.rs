//! A report as one HTML file that needs nothing beside it.

use std::path::Path;

use base64::Engine;

use crate::HarnessError;
use crate::report::Block;

/// The whole document; plots are inlined, pictures embedded. Those that are not in the folder are left out.
///
/// # Errors
/// [`HarnessError::File`] when a plot or picture is there but cannot be read.
pub(crate) fn page(title: &str, blocks: &[Block], folder: &Path) -> Result<String, HarnessError> {
    let mut body = String::new();
    for block in blocks {
        match block {
            Block::Lead(lead) => body.push_str(&format!("<p class=\"lead\">{}</p>\n", escape(lead))),
            Block::Heading(heading) => body.push_str(&format!("<h2>{}</h2>\n", escape(heading))),
            Block::Subheading(heading) => body.push_str(&format!("<h3>{}</h3>\n", escape(heading))),
            Block::Text(text) => body.push_str(&format!("<p>{}</p>\n", escape(text))),
            Block::Code(code) => body.push_str(&format!("<pre><code>{}</code></pre>\n", escape(code))),
            Block::Table { head, names, rows } => body.push_str(&table(head, *names, rows)),
            Block::Plot(name, what) => {
                if let Some(bytes) = read(&folder.join(name))? {
                    // The declaration of the file has no place inside HTML.
                    let svg = String::from_utf8_lossy(&bytes);
                    let svg = svg.find("<svg").map_or("", |at| &svg[at..]).replacen(
                        " xmlns=\"http://www.w3.org/2000/svg\"",
                        "",
                        1,
                    );
                    body.push_str(&format!(
                        "<figure class=\"plot\"><div class=\"scroll\">{svg}</div><figcaption>{}</figcaption></figure>\n",
                        escape(what)
                    ));
                }
            }
            Block::Pictures(list) => {
                body.push_str("<div class=\"pictures\">\n");
                for (name, what) in list {
                    if let Some(bytes) = read(&folder.join(name))? {
                        let data = base64::engine::general_purpose::STANDARD.encode(bytes);
                        let what = escape(what);
                        body.push_str(&format!(
                            "<figure><img alt=\"{what}\" loading=\"lazy\" src=\"data:image/png;base64,{data}\">\
                             <figcaption>{what}</figcaption></figure>\n"
                        ));
                    }
                }
                body.push_str("</div>\n");
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
    let title = escape(title);
    Ok(format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n\
         <body>\n<main>\n<h1>{title}</h1>\n{body}</main>\n</body>\n</html>\n"
    ))
}

fn table(head: &[String], names: usize, rows: &[Vec<String>]) -> String {
    let class = |i: usize| if i < names { " class=\"name\"" } else { "" };
    let cells = |tag: &str, cells: &[String]| -> String {
        cells.iter().enumerate().map(|(i, c)| format!("<{tag}{}>{}</{tag}>", class(i), escape(c))).collect()
    };
    let mut text = format!("<div class=\"scroll\"><table>\n<thead><tr>{}</tr></thead>\n<tbody>\n", cells("th", head));
    let mut last = "";
    for row in rows {
        // A rule where the first column changes keeps groups of rows together.
        let first = row.first().map_or("", String::as_str);
        let class = if first == last { " class=\"same\"" } else { "" };
        text.push_str(&format!("<tr{class}>{}</tr>\n", cells("td", row)));
        last = first;
    }
    text.push_str("</tbody></table></div>\n");
    text
}

/// The file's bytes, or `None` when it is not there.
fn read(path: &Path) -> Result<Option<Vec<u8>>, HarnessError> {
    match std::fs::read(path) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(HarnessError::file(path, e)),
    }
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

const STYLE: &str = include_str!("report.css");
