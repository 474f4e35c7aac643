//! The page: sections, one below the other, in one HTML file without scripts and without anything from elsewhere.
//!
//! Drawings and tables of numbers are files beside it; the page names them. It says what was computed and by which command,
//! and nothing of the machine or the time.
//!
//! Invariant: every file that a section names is one of its files.

use super::svg::escape;
use std::fmt::Write;

/// The page's name.
pub const INDEX: &str = "index.html";

/// A file beside the page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct File {
    /// Its name, without a directory.
    pub name: String,
    /// All of it.
    pub text: String,
}

/// A part of the page.
#[derive(Clone, Debug)]
pub(super) struct Section {
    /// What links to it name: a-z, 0-9 and -.
    pub(super) id: String,
    pub(super) title: String,
    /// What stands below the title.
    pub(super) html: String,
    /// The drawings and numbers that it names.
    pub(super) files: Vec<File>,
}

impl Section {
    pub(super) fn new(id: &str, title: &str) -> Self {
        Self { id: id.to_owned(), title: title.to_owned(), html: String::new(), files: Vec::new() }
    }

    /// A paragraph. `words` are escaped.
    pub(super) fn say(&mut self, words: &str) {
        // Writing to a string does not fail.
        let _ = writeln!(self.html, "<p>{}</p>", escape(words));
    }

    /// A table with its heading.
    pub(super) fn table(&mut self, heading: &str, table: &str) {
        let _ = write!(self.html, "<h3>{}</h3>\n{table}", escape(heading));
    }

    /// A drawing with its caption, the numbers it was drawn from if they are given, and the command that makes it.
    pub(super) fn figure(
        &mut self,
        name: &str,
        svg: String,
        csv: Option<String>,
        caption: &str,
        command: &str,
    ) {
        // Who does not see it hears what it is; the rest is in the caption, for everybody.
        let alt = escape(caption.split_inclusive(". ").next().unwrap_or_default().trim_end());
        let (caption, command) = (escape(caption), escape(command));
        let numbers = csv
            .as_ref()
            .map_or_else(String::new, |_| format!(" Numbers: <a href=\"{name}.csv\">{name}.csv</a>."));
        let _ = writeln!(
            self.html,
            "<figure>\n<img src=\"{name}.svg\" alt=\"{alt}\"/>\n<figcaption>{caption}{numbers} Command: \
             <code>{command}</code></figcaption>\n</figure>"
        );
        self.files.push(File { name: format!("{name}.svg"), text: svg });
        self.files.extend(csv.map(|text| File { name: format!("{name}.csv"), text }));
    }
}

const STYLE: &str = "\
body { font-family: sans-serif; line-height: 1.45; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
h2 { border-top: 1px solid #ccc; padding-top: 1.2rem; margin-top: 2.5rem; }
img { max-width: 100%; height: auto; }
figure { margin: 1rem 0; }
figcaption { color: #444; font-size: 0.95rem; }
table { border-collapse: collapse; margin: 0.5rem 0; }
th, td { border: 1px solid #ccc; padding: 0.15rem 0.6rem; text-align: left; vertical-align: top; overflow-wrap: anywhere; }
";

/// The page of these sections.
pub(super) fn page(sections: &[Section]) -> String {
    let mut html = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n<title>meissner: report</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n<h1>meissner: report</h1>\n\
         <p>Computed by meissner {}, from its models; nothing here was measured on hardware.</p>\n<ul>\n",
        env!("CARGO_PKG_VERSION")
    );
    for Section { id, title, .. } in sections {
        let _ = writeln!(html, "<li><a href=\"#{id}\">{}</a></li>", escape(title));
    }
    html.push_str("</ul>\n");
    for Section { id, title, html: body, .. } in sections {
        let _ = write!(html, "<section id=\"{id}\">\n<h2>{}</h2>\n{body}</section>\n", escape(title));
    }
    html + "</body>\n</html>\n"
}
