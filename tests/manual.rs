use crate::harness::{complaint, offline, printed};
use std::fs;
use std::path::Path;

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// Packages and `deploy/install` take what the program writes.
#[test]
fn the_program_writes_its_manual() {
    let folder = tempfile::tempdir().unwrap();
    printed(offline().arg("manual").arg(folder.path()));
    let pages = names(&folder.path().join("man"));
    for page in ["meissner.1", "meissner-play.1", "meissner-session-start.1"] {
        assert!(pages.iter().any(|name| name == page), "{pages:?}");
    }
    for page in &pages {
        let text = fs::read_to_string(folder.path().join("man").join(page)).unwrap();
        assert!(text.contains(".SH NAME") && text.contains(".SH SYNOPSIS"), "{page}");
    }
    assert_eq!(names(&folder.path().join("completions")), ["_meissner", "meissner.bash", "meissner.fish"]);
    let document: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.path().join("openapi.json")).unwrap()).unwrap();
    assert_eq!(document, meissner_api::openapi::document());
    // Somewhere that cannot be written.
    let file = folder.path().join("man/meissner.1");
    complaint(offline().arg("manual").arg(&file));
}
