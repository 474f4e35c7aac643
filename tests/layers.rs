use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The rooms, lowest first. Those of one line do not use each other.
const ROOMS: [&[&str]; 17] = [
    &["quote", "units", "log"],
    &["draw", "keyed"],
    &["array", "motor"],
    &["pattern"],
    &["strokes"],
    &["skin"],
    &["simulate"],
    &["optimise", "link", "plant"],
    &["device"],
    &["stream", "checkup"],
    &["calibrate", "record"],
    &["store", "api", "logbook", "report"],
    &["config"],
    &["client"],
    &["daemon"],
    &["cli"],
    &["main"],
];

fn level(room: &str) -> Option<usize> {
    ROOMS.iter().position(|level| level.contains(&room))
}

/// Every source file with its room: the first part of its path.
fn files(dir: &Path, room: Option<&str>, found: &mut Vec<(String, PathBuf)>) {
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        let stem = path.file_stem().unwrap().to_str().unwrap().to_owned();
        let room = room.unwrap_or(&stem);
        if path.is_dir() {
            files(&path, Some(room), found);
        } else if path.extension().is_some_and(|extension| extension == "rs") && room != "lib" {
            found.push((room.to_owned(), path));
        }
    }
}

/// The rooms a text names, as `crate::room` or `crate::{room, …}`; `meissner::` is how `main` says `crate::`.
fn used(text: &str) -> BTreeSet<String> {
    let word = |text: &str| text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    let mut rooms = BTreeSet::new();
    for start in ["crate::", "meissner::"] {
        for (at, _) in text.match_indices(start) {
            let path = &text[at + start.len()..];
            match path.strip_prefix('{') {
                Some(group) => rooms.extend(top_level(group).iter().map(|part| word(part.trim()))),
                None => drop(rooms.insert(word(path))),
            }
        }
    }
    rooms
}

/// The parts of a braced list, up to its closing brace; what is in braces within stays with its part.
fn top_level(group: &str) -> Vec<&str> {
    let (mut depth, mut from, mut parts) = (0, 0, Vec::new());
    for (at, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth == 0 => {
                parts.push(&group[from..at]);
                break;
            }
            '}' => depth -= 1,
            ',' if depth == 0 => {
                parts.push(&group[from..at]);
                from = at + 1;
            }
            _ => {}
        }
    }
    parts
}

#[test]
fn rooms_are_found_in_nested_lists() {
    let rooms = used("use crate::{stream::{port::{A, B}, C}, daemon, cli::D};\nuse crate::link;");
    assert_eq!(rooms.into_iter().collect::<Vec<_>>(), ["cli", "daemon", "link", "stream"]);
}

fn code(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap();
    let lines = text.lines().filter(|line| !line.trim_start().starts_with("//"));
    lines.collect::<Vec<_>>().join("\n")
}

#[test]
fn a_room_uses_only_what_stands_before_it() {
    let mut found = Vec::new();
    files(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), None, &mut found);
    assert!(found.len() > 20);
    for (room, path) in found {
        let at = level(&room).unwrap_or_else(|| panic!("{}: `{room}` is no known room", path.display()));
        for other in used(&code(&path)) {
            let below =
                level(&other).unwrap_or_else(|| panic!("{}: `{other}` is no known room", path.display()));
            assert!(other == room || below < at, "{}: `{room}` must not use `{other}`", path.display());
        }
    }
}

#[test]
fn every_module_of_the_library_is_a_room() {
    let lib = code(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src/lib.rs"));
    for line in lib.lines().filter_map(|line| line.trim().strip_suffix(';')) {
        let Some((_, name)) = line.split_once("mod ") else { continue };
        assert!(level(name).is_some(), "`{name}` is no known room");
    }
}

#[test]
fn the_scan_sees_every_way_to_name_a_room() {
    let text = "use crate::units::{a, b};\nuse crate::{plant, stream::port};\nfn f(x: crate::link::Y) {}";
    let rooms: Vec<_> = used(text).into_iter().collect();
    assert_eq!(rooms, ["link", "plant", "stream", "units"]);
}
