//! Reads the pages: their code blocks, links, headings and words in backquotes.
//!
//! Invariant: text in a code block is neither a link nor a heading.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The repository.
pub(super) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A page of Markdown.
pub(super) struct Page {
    /// Its path from the root.
    pub(super) name: String,
    pub(super) text: String,
}

/// A fenced block.
pub(super) struct Block<'p> {
    pub(super) language: &'p str,
    /// The line of its first line, from 1.
    pub(super) line: usize,
    pub(super) text: &'p str,
}

pub(super) fn read(name: &str) -> Page {
    let text = fs::read_to_string(root().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    Page { name: name.to_owned(), text }
}

pub(super) fn read_path(path: &Path) -> Page {
    let path = path.canonicalize().unwrap();
    read(path.strip_prefix(root().canonicalize().unwrap()).unwrap().to_str().unwrap())
}

fn markdown(folder: &str) -> Vec<String> {
    let mut found = Vec::new();
    for entry in fs::read_dir(root().join(folder)).unwrap() {
        let entry = entry.unwrap();
        let name = format!("{folder}/{}", entry.file_name().to_str().unwrap());
        if entry.file_type().unwrap().is_dir() {
            found.extend(markdown(&name));
        } else if name.ends_with(".md") {
            found.push(name);
        }
    }
    found.sort();
    found
}

/// The README and every page of the book.
pub(super) fn book() -> impl Iterator<Item = Page> {
    let pages = markdown("docs").into_iter().filter(|name| !name.ends_with("SUMMARY.md"));
    std::iter::once("README.md".to_owned()).chain(pages).map(|name| read(&name))
}

/// The book, and the documents beside the code.
pub(super) fn documents() -> impl Iterator<Item = Page> {
    let others = [
        "docs/SUMMARY.md",
        "deploy/README.md",
        "python/README.md",
        "python/psychopy/README.md",
        "verify/install/README.md",
        "verify/realtime/README.md",
        "verify/usb/README.md",
        "firmware/README.md",
        "verify/hil/README.md",
        "verify/fuzz/README.md",
        "verify/emulator/README.md",
    ];
    book().chain(others.into_iter().map(read))
}

impl Page {
    pub(super) fn path(&self) -> PathBuf {
        root().join(&self.name)
    }

    pub(super) fn blocks(&self) -> impl Iterator<Item = Block<'_>> {
        let mut fence = 1;
        // Parts alternate: text, block, text, ...
        self.text.split("\n```").enumerate().filter_map(move |(index, part)| {
            let line = fence + 1;
            fence += part.matches('\n').count() + 1;
            let (language, text) = part.split_once('\n').filter(|_| index % 2 == 1)?;
            Some(Block { language, line, text })
        })
    }

    /// The text between code blocks.
    fn prose(&self) -> impl Iterator<Item = &str> {
        self.text.split("\n```").step_by(2)
    }

    pub(super) fn links(&self) -> impl Iterator<Item = &str> {
        self.prose().flat_map(|part| part.split("](").skip(1).filter_map(|rest| rest.split(')').next()))
    }

    /// Headings as links name them.
    pub(super) fn anchors(&self) -> BTreeSet<String> {
        let headings = self.prose().flat_map(str::lines).filter(|line| line.starts_with('#'));
        let anchor = |heading: &str| {
            let kept = heading.trim_start_matches('#').trim().to_lowercase();
            let kept = kept.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
            kept.map(|c| if c == ' ' { '-' } else { c }).collect()
        };
        headings.map(anchor).collect()
    }

    /// Words in backquotes, outside of code blocks.
    pub(super) fn code_words(&self) -> impl Iterator<Item = &str> {
        self.prose().flat_map(|part| part.split('`').skip(1).step_by(2))
    }
}
