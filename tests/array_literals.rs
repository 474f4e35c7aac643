//! The numbers of the paper's array are in its description and in tests, and nowhere else. Doc comments with them name the paper.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

/// Motors, their highest number, pitch in mm, carrier, window in ms and in half ticks, speed in mm/s.
const NUMBERS: [&str; 10] =
    ["24", "23", "2.9", "85000", "85000.0", "4.3", "731", "11.5", "170000", "170000.0"];

/// The same digits with another meaning, by file and number.
const OTHERS: &[(&str, &str, &str)] = &[
    ("crates/api/src/array.rs", "2.9", "the example of an array in the API's document"),
    ("crates/api/src/array.rs", "85000", "as above"),
    ("crates/api/src/array.rs", "4.3", "as above"),
    ("crates/api/src/array.rs", "11.5", "as above"),
    ("crates/api/src/status.rs", "85000", "the example of a status"),
    ("crates/api/src/receipt.rs", "85000", "the example of a receipt, and a new one"),
    ("crates/api/src/receipt.rs", "11.5", "bytes per burst in the example"),
    ("crates/api/src/receipt.rs", "24", "drives and strokes that a receipt lists"),
    ("crates/api/src/live.rs", "24", "the length of the finger's pad, mm"),
    ("crates/paper/src/target/checked.rs", "24", "the length of the finger's pad, mm"),
    ("crates/skin/src/afferents/noise.rs", "23", "bits of a number"),
    ("crates/skin/src/validate/measure.rs", "24", "a range of samples"),
    ("crates/stream/src/bandwidth.rs", "24", "bytes around a frame"),
    ("crates/stream/src/diagnostics.rs", "24", "points of a line fit"),
    ("firmware-protocol/src/array.rs", "24", "lines of a Pico"),
    ("firmware/src/board.rs", "24", "lines of a Pico"),
    ("firmware/src/cable.rs", "24", "a bit of a register"),
    ("firmware/src/wave.rs", "24", "a bit of a register"),
    ("src/cli/arguments.rs", "24", "hours of a day"),
    ("src/cli/motor/amplitude.rs", "23", "frequencies of a measurement"),
    ("src/daemon/arm/estop.rs", "24", "a bit of an address"),
    ("python/src/meissner/_live.py", "24", "messages without an answer"),
    ("crates/array/src/samples/wav.rs", "24", "as above"),
];

#[test]
fn the_papers_numbers_are_in_its_description_only() {
    let mut found = BTreeSet::new();
    for (name, text) in sources() {
        let comment = match Path::new(&name).extension().and_then(OsStr::to_str) {
            Some("py") => "#",
            Some("m") => "%",
            Some("html") => "<!--",
            _ => "//",
        };
        for (line, number) in product(&text).lines().zip(1..) {
            let code = line.split(comment).next().unwrap_or_default();
            for literal in literals(code).filter(|literal| NUMBERS.contains(&literal.as_str())) {
                found.insert((name.clone(), literal, number));
            }
        }
    }
    let allowed = |name: &str, literal: &str| {
        OTHERS.iter().any(|(file, number, _)| (*file, *number) == (name, literal))
    };
    let wrong: Vec<_> = found.iter().filter(|(name, literal, _)| !allowed(name, literal)).collect();
    assert!(wrong.is_empty(), "the array's description has these numbers: {wrong:#?}");
    for (file, number, why) in OTHERS {
        let is_used =
            found.iter().any(|(name, literal, _)| (name.as_str(), literal.as_str()) == (*file, *number));
        assert!(is_used, "{file} has no {number} any more ({why}): remove its row");
    }
}

/// The names and texts of the source files, without tests.
fn sources() -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    for folder in ["src", "crates", "firmware-protocol/src", "firmware/src", "python/src", "python/matlab"] {
        list(&root.join(folder), &mut files);
    }
    assert!(files.len() > 400, "{}", files.len());
    let named = files.into_iter().map(|file| {
        let name = file.strip_prefix(root).unwrap().to_string_lossy().into_owned();
        (name, file)
    });
    let is_test =
        |name: &str| name.contains("/tests/") || name.ends_with("/tests.rs") || name.ends_with("test.js");
    named
        .filter(|(name, _)| !is_test(name))
        .map(|(name, file)| (name, fs::read_to_string(file).unwrap()))
        .collect()
}

/// The source files of a folder.
fn list(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            list(&path, files);
        } else if path
            .extension()
            .is_some_and(|extension| ["rs", "js", "py", "html", "m"].iter().any(|kind| extension == *kind))
        {
            files.push(path);
        }
    }
}

/// A text without its unit tests, which stand at the end of a file.
fn product(text: &str) -> &str {
    let mut tests = text.match_indices("#[cfg(test)]\n").map(|(at, _)| at);
    let module = |at: &usize| {
        text[*at..].lines().nth(1).is_some_and(|line| line.contains("mod ") && line.ends_with('{'))
    };
    &text[..tests.find(module).unwrap_or(text.len())]
}

/// The numbers of a line of code, without underscores and types. Dates and times are none.
fn literals(code: &str) -> impl Iterator<Item = String> {
    let is_part = |c: char| c.is_ascii_alphanumeric() || "_.-:".contains(c);
    let code = code.replace("..", " ");
    let words: Vec<String> = code.split(move |c| !is_part(c)).map(|word| word.replace('_', "")).collect();
    words.into_iter().filter(|word| word.starts_with(|c: char| c.is_ascii_digit())).map(|word| {
        let end = word.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(word.len());
        word[..end].trim_end_matches(['.', ':']).to_owned()
    })
}
