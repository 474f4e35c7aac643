//! The page: all sections in one HTML file, without scripts or links to other sites.
//!
//! Drawings and numbers are files beside it. The page states what was computed and by which command, but neither machine
//! nor time.
//!
//! Invariant: every file that a section names is one of its files.

use crate::svg::escape;

/// The file name of the page.
pub const INDEX: &str = "index.html";

/// A file beside the page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct File {
    /// The name, without a directory.
    pub name: String,
    /// The content.
    pub text: String,
}

/// A section of the page.
#[derive(Clone, Debug)]
pub(super) struct Section {
    /// The anchor of links: a-z, 0-9 and -.
    pub(super) id: String,
    pub(super) title: String,
    /// The HTML below the title.
    pub(super) html: String,
    /// The files that it names.
    pub(super) files: Vec<File>,
    /// A small drawing for the page's overview: its file's name, and the text below it.
    overview: Option<(String, String)>,
}

impl Section {
    pub(super) fn new(id: &str, title: &str) -> Self {
        let (html, files) = Default::default();
        Self { id: id.to_owned(), title: title.to_owned(), html, files, overview: None }
    }

    /// Puts the section into the page's overview, with a small drawing and words below it.
    pub(super) fn overview(&mut self, name: &str, svg: String, words: &str) {
        let name = format!("{name}.svg");
        self.overview = Some((name.clone(), words.to_owned()));
        self.files.push(File { name, text: svg });
    }

    /// Adds a paragraph; `words` are escaped.
    pub(super) fn say(&mut self, words: &str) {
        self.html += &format!("<p>{}</p>\n", escape(words));
    }

    /// Adds a table with its heading.
    pub(super) fn table(&mut self, heading: &str, table: &str) {
        self.html += &format!("<h3>{}</h3>\n{table}", escape(heading));
    }

    /// Adds what another section has.
    pub(super) fn append(&mut self, other: Self) {
        self.html += &other.html;
        self.files.extend(other.files);
    }

    /// Adds a table that is folded under its heading.
    pub(super) fn folded(&mut self, heading: &str, table: &str) {
        self.html += &format!("<details>\n<summary>{}</summary>\n{table}</details>\n", escape(heading));
    }

    /// Adds a drawing with its numbers if there are any, its caption, and the command that makes it.
    pub(super) fn figure(
        &mut self,
        name: &str,
        svg: String,
        csv: Option<String>,
        caption: &str,
        command: &str,
    ) {
        // The first sentence of the caption is the alternative text of the image.
        let alt = escape(caption.split_inclusive(". ").next().unwrap_or_default().trim_end());
        let (caption, command) = (escape(caption), escape(command));
        let numbers = csv
            .as_ref()
            .map_or_else(String::new, |_| format!(" Numbers: <a href=\"{name}.csv\">{name}.csv</a>."));
        self.html += &format!(
            "<figure>\n<img src=\"{name}.svg\" alt=\"{alt}\"/>\n<figcaption>{caption}{numbers} Command: \
             <code>{command}</code></figcaption>\n</figure>\n"
        );
        self.files.push(File { name: format!("{name}.svg"), text: svg });
        self.files.extend(csv.map(|text| File { name: format!("{name}.csv"), text }));
    }
}

pub(crate) const STYLE: &str = "\
body { font-family: sans-serif; line-height: 1.45; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
h2 { border-top: 1px solid #ccc; padding-top: 1.2rem; margin-top: 2.5rem; }
img { max-width: 100%; height: auto; }
figure { margin: 1rem 0; }
figcaption { color: #444; font-size: 0.95rem; }
table { border-collapse: collapse; margin: 0.5rem 0; }
th, td { border: 1px solid #ccc; padding: 0.15rem 0.6rem; text-align: left; vertical-align: top; }
td { overflow-wrap: anywhere; }
td:first-child { overflow-wrap: normal; }
summary { font-weight: bold; margin: 1rem 0; cursor: pointer; }
.overview { display: grid; grid-template-columns: repeat(auto-fill, minmax(8rem, 1fr)); gap: 1rem; padding: 0; list-style: none; }
.overview a { display: block; text-align: center; color: inherit; font-size: 0.9rem; }
";

/// The page of these sections.
pub(super) fn page(sections: &[Section]) -> String {
    let mut html = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n<title>meissner: report</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n<h1>meissner: report</h1>\n\
         <p>Computed by meissner {}, from its models; nothing here was measured on hardware.</p>\n",
        env!("CARGO_PKG_VERSION")
    );
    html += &overview(sections);
    html.push_str("<ul>\n");
    for Section { id, title, .. } in sections {
        html += &format!("<li><a href=\"#{id}\">{}</a></li>\n", escape(title));
    }
    html.push_str("</ul>\n");
    for Section { id, title, html: body, .. } in sections {
        html += &format!("<section id=\"{id}\">\n<h2>{}</h2>\n{body}</section>\n", escape(title));
    }
    html + "</body>\n</html>\n"
}

/// The small drawings of the sections that have one, each a link; empty without any.
fn overview(sections: &[Section]) -> String {
    let mut items = String::new();
    for Section { id, title, overview, .. } in sections {
        let Some((file, words)) = overview else { continue };
        let (alt, words) = (escape(title), escape(words));
        items += &format!("<li><a href=\"#{id}\"><img src=\"{file}\" alt=\"{alt}\"/><br/>{words}</a></li>\n");
    }
    if items.is_empty() {
        return items;
    }
    format!(
        "<h2>Overview</h2>\n<ul class=\"overview\">\n{items}</ul>\n<p>The pins of each pattern, of a moving one at its beginning: \
         yellow moves farthest (each on its own scale), grey is off. Orange: the target. Contrasts are in impulses/s.</p>\n"
    )
}
