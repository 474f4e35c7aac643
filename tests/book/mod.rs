//! The README and the book in `docs/`: their commands run, their snippets parse, their links have targets.
//!
//! `pages` reads the pages; `run` runs commands.

mod pages;
mod run;

use meissner::config::{Config, PatternsDir};
use meissner::record::Location;
use meissner_api::Order;
use meissner_array::pattern::Pattern;
use meissner_paper::Target;
use meissner_skin::{AnyScene, Scene};
use meissner_stream::calibrate::Calibration;
use meissner_stream::device::Spec;
use meissner_touch::Object;
use pages::{Page, book, documents, read, root};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The example holds every key at its default, with a comment about its meaning.
#[test]
fn the_example_configuration_is_the_default() {
    let file = root().join("deploy/meissner.toml");
    let mut config = Config::read(&file).unwrap();
    let default = Config::default();
    assert_eq!(config.patterns, PatternsDir::Configured(PathBuf::from("/var/lib/meissner/patterns")));
    assert_eq!(config.socket, PathBuf::from("/run/meissner/meissner.sock"));
    assert_eq!(config.device, Spec::Auto);
    assert_eq!(config.calibration, Some(PathBuf::from("/var/lib/meissner/calibration.toml")));
    assert_eq!(config.tokens, Some(PathBuf::from("/var/lib/meissner/tokens.toml")));
    let dir = PathBuf::from("/var/lib/meissner/logbook");
    assert_eq!(config.logbook, Some(Location { dir, make_parents: false }));
    config.logbook.clone_from(&default.logbook);
    (config.patterns, config.socket) = (default.patterns.clone(), default.socket.clone());
    config.calibration.clone_from(&default.calibration);
    config.tokens.clone_from(&default.tokens);
    // Without the key, that of the array's description: the same.
    assert_eq!(config.mock.transient_gain.take(), Some(config.settings.array.motor().transient_gain));
    assert_eq!(config, default);
}

/// Reads a TOML block as the kind of file that its keys imply.
fn read_toml(text: &str, place: &str) -> Result<&'static str, String> {
    let has = |key: &str| text.lines().any(|line| line.starts_with(key));
    let word = |error: &dyn std::fmt::Display| error.to_string();
    if has("[[drive]]") || has("[[ramp]]") {
        // A file that a wave names.
        let mut file = |_: &str| Ok(b"time_s,touch_um\n0,0\n0.1,2\n0.2,0\n".to_vec());
        Pattern::parse_with_files(text, place, &mut file).map(|_| "pattern").map_err(|error| word(&error))
    } else if has("[[items]]") {
        Order::parse_file(text).map(|_| "order").map_err(|error| word(&error))
    } else if has("shape =") && has("[touch]") {
        let mut file = |_: &str| Ok(b"0,1\n".to_vec());
        Object::read(text, place, &mut file).map(|_| "object").map_err(|error| word(&error))
    } else if has("shape =") {
        Target::read(text, place).map(|_| "target").map_err(|error| word(&error))
    } else if has("[[motor]]") {
        Calibration::parse(text, place).map(|_| "calibration").map_err(|error| word(&error))
    } else if has("[[drives]]") || has("model =") {
        AnyScene::read(text, place, None).map(|_| "scene").map_err(|error| word(&error))
    } else {
        Config::parse(text, Path::new(place)).map(|_| "configuration").map_err(|error| word(&error))
    }
}

#[test]
fn every_toml_and_json_snippet_is_good() {
    let mut kinds = BTreeSet::new();
    for page in book() {
        for block in page.blocks() {
            let place = format!("{}:{}", page.name, block.line);
            match block.language {
                "toml" => {
                    kinds.insert(read_toml(block.text, &place).unwrap_or_else(|line| panic!("{line}")));
                }
                "json" if block.text.contains("\"afferents\"") && block.text.contains("\"duration_s\"") => {
                    Scene::read(block.text, &place).unwrap();
                }
                "json" => {
                    serde_json::from_str::<Value>(block.text)
                        .unwrap_or_else(|error| panic!("{place}: {error}"));
                }
                language => {
                    let known = ["sh", "bash", "python", "py", "matlab", "text"].contains(&language);
                    assert!(known, "{place}: a block marked `{language}`, which no test runs");
                }
            }
        }
    }
    let all =
        BTreeSet::from(["pattern", "target", "object", "calibration", "scene", "order", "configuration"]);
    assert_eq!(kinds, all, "the book has an example of each kind of file");
}

/// A link's page, and a heading in it, if it names one.
fn assert_link(page: &Page, link: &str) {
    let (file, heading) = link.split_once('#').unwrap_or((link, ""));
    let path = if file.is_empty() { page.path() } else { page.path().parent().unwrap().join(file) };
    assert!(path.exists(), "{} links to {link}, which is not there", page.name);
    if !heading.is_empty() {
        let target = pages::read_path(&path);
        let anchors = target.anchors();
        assert!(anchors.contains(heading), "{} links to {link}: no such heading of {anchors:?}", page.name);
    }
}

#[test]
fn every_link_has_a_target() {
    let mut links = 0;
    for page in documents() {
        for link in page.links().filter(|link| !link.contains("://")) {
            links += 1;
            assert_link(&page, link);
        }
    }
    assert!(links > 100, "{links}");
}

/// A renamed or removed test would prove nothing.
#[test]
fn every_test_that_the_safety_case_names_is_there() {
    let (mut sources, mut browser) = (String::new(), String::new());
    let mut folders: Vec<PathBuf> = ["tests", "src", "crates", "firmware-protocol", "verify/hil"]
        .map(|folder| root().join(folder))
        .into();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() && !path.ends_with("target") && !path.ends_with("node_modules") {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                sources += &fs::read_to_string(path).unwrap();
            } else if path.to_str().is_some_and(|path| path.ends_with(".test.js")) {
                // Names of the browser tests are sentences; a mark says which of them `.ci/run` plays.
                browser += &fs::read_to_string(path).unwrap().replace(" (smoke)", "");
            }
        }
    }
    let page = read("docs/dev/safety-case.md");
    for name in page.text.split('“').skip(1).filter_map(|rest| rest.split_once('”')) {
        assert!(browser.contains(&format!("test(\"{}\"", name.0)), "there is no test “{}”", name.0);
    }
    let is_name = |word: &&str| {
        word.matches('_').count() > 2 && word.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    let named: Vec<&str> = page.code_words().filter(is_name).collect();
    for name in &named {
        assert!(sources.contains(&format!("fn {name}(")), "there is no test `{name}`");
    }
    assert!(named.len() > 20, "{named:?}");
}
