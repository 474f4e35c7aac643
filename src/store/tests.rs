//! Tests of the store: files, names, and refusals.

use super::*;
use meissner_api::PatternDetails;
use std::fs;

const TEXT: &str = "format = 1\nname = \"my-edge\"\nduration_s = 1.0\n\n[[drive]]\nmotor = 9\nfrequency_hz = 60.0\n\
                    amplitude_um = 40.0\n\n";

fn store() -> (tempfile::TempDir, Store) {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::new(Some(dir.path().to_owned()), false).unwrap();
    (dir, store)
}

#[test]
fn what_is_put_is_there_and_can_be_replaced() {
    let (dir, store) = store();
    let Put { stored, replaced } = store.put("my-edge", TEXT, false).unwrap();
    assert!(replaced.is_none() && stored.sha256.len() == 64);
    assert_eq!(store.get("my-edge").unwrap().sha256, stored.sha256);
    let changed = format!("# changed\n{TEXT}");
    for text in [&changed, TEXT] {
        let refused = store.put("my-edge", text, false).unwrap_err();
        assert!(refused.to_string().contains(&stored.sha256) && refused.to_string().contains("--replace"));
    }
    assert_eq!(store.get("my-edge").unwrap().sha256, stored.sha256);
    let other = store.put("my-edge", &changed, true).unwrap();
    assert_eq!(other.replaced, Some(stored.sha256.clone()));
    assert_ne!(other.stored.sha256, stored.sha256);
    // If there is nothing to replace, the pattern is new.
    assert!(store.put("other", &TEXT.replace("my-edge", "other"), true).unwrap().replaced.is_none());
    fs::remove_file(dir.path().join("other.toml")).unwrap();
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "no temporary file is left");
}

#[test]
fn a_removed_pattern_is_gone_and_its_holders_keep_it() {
    let (dir, store) = store();
    let held = store.put("my-edge", TEXT, false).unwrap().stored;
    assert_eq!(store.remove("my-edge").unwrap(), held.sha256);
    assert!(matches!(store.get("my-edge"), Err(StoreError::Unknown { .. })));
    assert_eq!(held.pattern.name(), "my-edge");
    for name in ["my-edge", "../my-edge", "no"] {
        assert!(matches!(store.remove(name), Err(StoreError::Unknown { .. })), "{name}");
    }
    let error = store.remove("edge-45").unwrap_err();
    assert!(matches!(error, StoreError::InLibrary { .. }) && error.to_string().contains("removed"));
    // A file that does not parse can be removed, too.
    fs::write(dir.path().join("bad.toml"), "nane = 1").unwrap();
    store.remove("bad").unwrap();
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn a_file_dropped_in_by_hand_shows_up_and_a_bad_one_is_a_line() {
    let (dir, store) = store();
    fs::write(dir.path().join("my-edge.toml"), TEXT).unwrap();
    fs::write(dir.path().join("other.toml"), TEXT).unwrap();
    fs::write(dir.path().join("bad.toml"), "format = 1\nnane = \"bad\"\n").unwrap();
    fs::create_dir(dir.path().join("folder.toml")).unwrap();
    fs::write(dir.path().join("Upper.toml"), TEXT).unwrap();
    fs::write(dir.path().join("binary.toml"), [0xff, 0xfe]).unwrap();
    let list = store.list();
    assert!(list.patterns.iter().any(|entry| entry.name == "my-edge" && !entry.library));
    assert_eq!(list.errors.len(), 5, "{:?}", list.errors);
    assert!(list.errors.iter().all(|line| !line.contains('\n')));
    assert!(list.errors.iter().any(|line| line.contains("bad.toml:2") && line.contains("`name`")));
}

#[test]
fn all_who_hold_a_pattern_share_it_and_it_goes_with_the_last() {
    let (dir, store) = store();
    let put = store.put("my-edge", TEXT, false).unwrap().stored;
    let [first, second] = [(); 2].map(|()| store.get("my-edge").unwrap());
    assert!([&put, &first].iter().all(|held| Arc::ptr_eq(&held.pattern, &second.pattern)));
    fs::write(dir.path().join("my-edge.toml"), format!("# changed\n{TEXT}")).unwrap();
    let changed = store.get("my-edge").unwrap();
    assert!(!Arc::ptr_eq(&changed.pattern, &first.pattern) && changed.sha256 != first.sha256);
    drop((put, first, second));
    store.get("my-edge").unwrap();
    store.put("other", &TEXT.replace("my-edge", "other"), false).unwrap();
    assert_eq!((store.in_use.len(), Arc::strong_count(&changed.pattern)), (2, 1));
    let library = store.get("edge-45").unwrap();
    assert!(Arc::ptr_eq(&library.json(), &store.get("edge-45").unwrap().made_json().unwrap()));
}

#[test]
fn the_json_of_a_pattern_is_bounded_and_is_its_details() {
    let (_dir, store) = store();
    let drive = |number: usize| {
        let (motor, start_s) = (number % 24, (number / 24) as f64 + 0.123_456_789_012);
        format!(
            "[[drive]]\nmotor = {motor}\nfrequency_hz = 123.456789012345\namplitude_um = 399.123456789\n\
             phase = 0.0123456789\nstart_s = {start_s}\nstop_s = {}\n",
            start_s + 0.5
        )
    };
    let text = "format = 1\nname = \"long\"\nduration_s = 1000.0\n";
    let text = format!("{text}[provenance]\ntext = \"{}\"\n", "\\u0001".repeat(1 << 16));
    let drives: String = (0..4096).map(drive).collect();
    let text = text.replace("[prov", &format!("{drives}[prov"));
    let stored = store.put("long", &text, false).unwrap().stored;
    let json = stored.json();
    assert!(json.len() < 2 << 20, "{} bytes", json.len());
    let details: PatternDetails = serde_json::from_slice(&json).unwrap();
    assert_eq!(details.pattern, serde_json::to_value(&*stored.pattern).unwrap());
    assert_eq!((details.sha256, details.library), (stored.sha256, false));
    assert_eq!(
        (details.warnings.len(), &*details.warnings[100]),
        (101, "3996 more drives may not do what is meant")
    );
}

#[test]
fn an_unknown_name_offers_the_nearest_and_no_name_leads_out() {
    let (dir, store) = store();
    fs::write(dir.path().join("my-edge.toml"), TEXT).unwrap();
    let line = store.get("my-egde").unwrap_err().to_string();
    assert!(line.contains("did you mean `my-edge`"), "{line}");
    assert!(line.ends_with("`? `meissner list` shows all"), "{line}");
    let line = store.get("0").unwrap_err().to_string();
    assert_eq!(line, "no pattern is called `0`; `meissner list` shows all");
    for name in ["../my-edge", "", "a/b", "my-edge.toml", "\n", &"x".repeat(100_000)] {
        let line = store.get(name).unwrap_err();
        assert!(matches!(line, StoreError::Unknown { .. }));
        assert!(!line.to_string().contains('\n') && line.to_string().len() < 400);
    }
    assert!(matches!(store.put("../x", TEXT, false), Err(StoreError::File(FileError::Name { .. }))));
}

#[test]
fn what_is_no_pattern_of_that_name_is_not_stored() {
    let (dir, store) = store();
    assert!(matches!(store.put("edge", TEXT, false), Err(StoreError::File(FileError::Name { .. }))));
    let error = store.put("edge", "name = 3", false).unwrap_err();
    assert!(error.to_string().starts_with("edge.toml:"), "{error}");
    let large = "#".repeat(meissner_array::pattern::MAX_FILE_BYTES + 1);
    assert!(store.put("edge", &large, false).unwrap_err().to_string().contains("too many"));
    fs::write(dir.path().join("edge.toml"), &large).unwrap();
    assert!(store.get("edge").unwrap_err().to_string().contains("too many"));
    fs::remove_file(dir.path().join("edge.toml")).unwrap();
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn a_directory_that_cannot_be_read_is_a_line() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let store = Store::new(Some(file.path().to_owned()), false).unwrap();
    assert!(store.check_dir().unwrap_err().to_string().contains(&file.path().display().to_string()));
    assert_eq!(store.list().errors.len(), 1);
    assert!(matches!(store.put("my-edge", TEXT, false), Err(StoreError::File(FileError::Io { .. }))));
    assert!(matches!(
        Store::new(None, false).unwrap().put("my-edge", TEXT, false),
        Err(StoreError::File(FileError::NoDirectory))
    ));
}

#[test]
fn a_directory_of_our_own_is_made_when_it_is_needed() {
    let outer = tempfile::tempdir().unwrap();
    let dir = outer.path().join("a/b");
    assert_eq!(Store::new(Some(dir.clone()), false).unwrap().list().errors.len(), 1);
    let store = Store::new(Some(dir.clone()), true).unwrap();
    assert!(store.check_dir().is_ok() && store.list().errors.is_empty() && !dir.exists());
    store.put("my-edge", TEXT, false).unwrap();
    assert!(store.get("my-edge").is_ok());
}

#[test]
fn the_library_is_read_only() {
    let (_dir, store) = store();
    for name in store.library.keys() {
        assert!(matches!(store.put(name, TEXT, false), Err(StoreError::InLibrary { .. })));
        assert!(store.get(name).unwrap().library);
    }
}

#[test]
fn a_pattern_that_never_gives_a_stroke_is_not_stored() {
    let (dir, store) = store();
    let drive = "[[drive]]\nmotor = 9\nfrequency_hz = 60.0\namplitude_um = 40.0\n";
    for (changed, says) in [
        ("", "every drive is off"),
        ("[[drive]]\nmotor = 9\nfrequency_hz = 60.0\namplitude_um = 0.0\n", "every drive is off"),
        (
            &drive.replace("40.0", "0.05"),
            "drive 1 (motor 9) gives no stroke: 0.05 um is less than half a pulse",
        ),
        (
            &format!("{drive}stop_s = 0.01\n"),
            "drive 1 (motor 9) gives no stroke: none at 60 Hz is over before",
        ),
    ] {
        let text = TEXT.replace(drive, changed);
        let error = store.put("my-edge", &text, false).unwrap_err();
        assert!(matches!(error, StoreError::Empty { .. }) && error.to_string().contains(says), "{error}");
    }
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    // One working drive of two is enough; the other gives a warning.
    let second = drive.replace("= 9", "= 10").replace("40.0", "0.05");
    let stored = store.put("my-edge", &format!("{TEXT}{second}"), false).unwrap().stored;
    let [warning] = &*stored.run().listed_warnings() else { panic!("{:?}", stored.run()) };
    assert!(warning.starts_with("drive 2 (motor 10) gives no stroke"), "{warning}");
}

/// Every shipped pattern moves pins, and each of its drives reaches its amplitude.
#[test]
fn the_library_is_what_it_says() {
    for stored in Store::new(None, false).unwrap().library.values() {
        let (name, run) = (stored.pattern.name(), stored.run());
        assert!(run.empty().is_none(), "{name}");
        assert_eq!(run.warnings, Vec::<String>::new(), "{name}");
        assert!(stored.entry().highest_um > 0.0, "{name}");
        let shown: Value = serde_json::from_slice(&stored.json()).unwrap();
        let likeness = &shown["pattern"]["provenance"]["likeness"];
        assert_eq!(likeness["press"].is_f64(), name.ends_with("-rendered"), "{name}: {likeness}");
    }
}

#[test]
fn a_list_tells_what_drives_reach_and_how_long_whole_strokes_last() {
    let (_dir, store) = store();
    store.put("my-edge", &TEXT.replace("1.0", "0.3").replace("40.0", "80.0"), false).unwrap();
    let list = store.list();
    let entry = list.patterns.iter().find(|entry| entry.name == "my-edge").unwrap();
    // 18 strokes of 60 Hz; the last goes up at 17/60 s, comes down half a period later, in 589 ticks.
    let over_ms = 1000.0 * (17.5 / 60.0 + 589.0 / 85_000.0);
    assert!((entry.compiled_ms.unwrap() - over_ms).abs() < 0.02, "{entry:?}");
    assert!((68.0..70.0).contains(&entry.highest_um), "{entry:?}");
    let shown = &store.get("my-edge").unwrap().json();
    let shown: Value = serde_json::from_slice(shown).unwrap();
    let highest_um = shown["highest_um"].as_array().unwrap();
    assert_eq!((highest_um.len(), &highest_um[0]), (24, &0.0.into()), "pin 0 does not move");
    assert_eq!(highest_um[9], entry.highest_um);
    let endless = list.patterns.iter().find(|entry| entry.duration_s.is_none()).unwrap();
    assert!(endless.compiled_ms.is_none() && endless.highest_um > 0.0);
}

/// A command line takes `-` for stdin and `--help` for an option. Existing files with such names can be listed and removed.
#[test]
fn no_new_name_begins_with_a_dash_and_old_ones_stay() {
    let (dir, store) = store();
    for name in ["-", "--help", "-x"] {
        let text = TEXT.replace("my-edge", name);
        let error = store.put(name, &text, false).unwrap_err();
        assert!(matches!(error, StoreError::File(FileError::NewName { .. })), "{name}: {error}");
        assert!(error.to_string().contains("begins with a letter or a digit"), "{error}");
        fs::write(dir.path().join(format!("{name}.toml")), &text).unwrap();
        assert!(store.list().patterns.iter().any(|pattern| pattern.name == name));
        store.remove(name).unwrap();
    }
    for name in [".", "..", "", "a/b", "a b"] {
        assert!(store.put(name, &TEXT.replace("my-edge", name), false).is_err(), "{name}");
    }
}
