//! Claims about pages.

use std::io::Read;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::embed::PLAIN_MOST;
use super::*;
use crate::report::{Series, Shot, Viewer};

fn text(words: &str) -> String {
    words.to_owned()
}

#[test]
fn no_words_become_markup() {
    let folder = tempfile::tempdir().unwrap();
    let evil = "</title><script>alert(\"1\")</script>&amp; 'x'";
    let shot = Shot { setting: 1, caption: text(evil), image: text("p.png"), difference: text("p.png") };
    let blocks = [
        Block::Lead(text(evil)),
        Block::Heading(text(evil)),
        Block::Subheading(text(evil)),
        Block::Text(text(evil)),
        Block::Code(text(evil)),
        Block::Table { head: vec![text(evil); 2], names: 1, rows: vec![vec![text(evil); 2]] },
        Block::Files(vec![(text(evil), text(evil))]),
        Block::Pictures(vec![(text("p.png"), text(evil))]),
        Block::Viewer(Viewer {
            truth: (text("p.png"), text(evil)),
            setting: text(evil),
            series: vec![Series { label: text(evil), shots: vec![shot] }],
        }),
    ];
    std::fs::write(folder.path().join("p.png"), b"no picture").unwrap();
    let page = page(evil, &blocks, folder.path()).unwrap();
    assert_eq!((page.matches("<script").count(), page.matches("</title>").count()), (1, 1));
    assert!(!page.contains("alert(\"1\")"), "quotes are escaped, so attributes stay whole");
    assert!(page.matches("&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt;&amp;amp; 'x'").count() >= 14);
}

#[test]
fn a_download_holds_every_byte_and_large_ones_are_packed() {
    let folder = tempfile::tempdir().unwrap();
    let data: Vec<u8> = (0..2 * PLAIN_MOST).map(|i| b'a' + (i * i % 23) as u8).collect();
    for (name, bytes) in [("small.csv", &data[..PLAIN_MOST]), ("large.csv", &data[..PLAIN_MOST + 1])] {
        std::fs::write(folder.path().join(name), bytes).unwrap();
        let item = download(folder.path(), name, "what <it> is").unwrap().unwrap();
        let part =
            |start: &str, end: &str| item.split(start).nth(1).and_then(|t| t.split(end).next()).unwrap().to_owned();
        let held = STANDARD.decode(part(";base64,", "\"")).unwrap();
        let packed = name == "large.csv";
        assert_eq!(part("download=\"", "\""), if packed { "large.csv.gz" } else { "small.csv" });
        let mut whole = Vec::new();
        if packed {
            assert!(held.len() < bytes.len() / 2);
            flate2::read::GzDecoder::new(&held[..]).read_to_end(&mut whole).unwrap();
        } else {
            whole = held;
        }
        assert!(whole == bytes, "{name}");
        assert!(item.contains("what &lt;it&gt; is"));
    }
    assert_eq!(download(folder.path(), "none.csv", "").unwrap(), None);
    assert!(download(folder.path(), ".", "").is_err(), "what is there but no file is an error");
}

#[test]
fn contents_lead_to_headings_and_anchors_are_unique() {
    let folder = tempfile::tempdir().unwrap();
    let heading = |words: &str| Block::Heading(text(words));
    let blocks = [Block::Lead(text("x")), heading("Time, by M"), heading("Time by M!"), heading("Größe"), heading("±")];
    let page = page("t", &blocks, folder.path()).unwrap();
    for id in ["time-by-m", "time-by-m-2", "gr-e", "section"] {
        assert_eq!(page.matches(&format!("href=\"#{id}\"")).count(), 1, "{id}");
        assert_eq!(page.matches(&format!("<h2 id=\"{id}\">")).count(), 1, "{id}");
    }
    assert!(page.find("class=\"lead\"") < page.find("<nav") && page.find("<nav") < page.find("<h2"));
    assert_eq!(page.matches("<section").count(), page.matches("</section>").count());
    let short = super::page("t", &blocks[..2], folder.path()).unwrap();
    assert!(!short.contains("<nav") && short.matches("</header>").count() == 1);
    let none = super::page("t", &blocks[..1], folder.path()).unwrap();
    assert!(none.matches("</header>").count() == 1 && none.matches("</section>").count() == 0);
}

#[test]
fn tables_name_their_columns_and_rows() {
    let rows = vec![vec![text("a"), text("1")], vec![text("a"), text("2")]];
    let html = table("About", &[text("M"), text("E")], 0, &rows);
    assert_eq!((html.matches("<th scope=\"col\">").count(), html.matches("<th scope=\"row\">").count()), (2, 2));
    assert!(html.contains("<tr><th scope=\"row\">a</th><td>1</td></tr>") && html.contains("<tr class=\"same\">"));
    assert!(html.contains("aria-label=\"Table: About\" tabindex=\"0\""));
}

#[test]
fn pictures_and_plots_that_are_missing_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let plot = |name: &str| Block::Plot(text(name), text("what"));
    std::fs::write(folder.path().join("wide.svg"), "<?xml?><svg id=\"w\"></svg>\n").unwrap();
    std::fs::write(folder.path().join("both.svg"), "<svg id=\"b\"></svg>").unwrap();
    std::fs::write(folder.path().join("both-narrow.svg"), "<svg id=\"n\"></svg>").unwrap();
    let blocks =
        [plot("wide.svg"), plot("both.svg"), plot("none.svg"), Block::Pictures(vec![(text("no.png"), text("x"))])];
    let page = page("t", &blocks, folder.path()).unwrap();
    assert!(page.contains("<div class=\"scroll\"><svg id=\"w\"></svg></div>"));
    assert!(
        page.contains("<div class=\"wide\"><svg id=\"b\"></svg></div><div class=\"narrow\"><svg id=\"n\"></svg></div>")
    );
    assert!(page.matches("<figure").count() == 2 && !page.contains("<img") && !page.contains("<?xml"));
}
