//! Test builds check for overflows in every crate, so that an overflow that a device can cause fails a test, not a play.

use std::hint::black_box;
use toml::{Table, Value};

const CHECKS: [&str; 2] = ["overflow-checks", "debug-assertions"];

/// The settings of a check in a table of profiles or packages.
fn settings<'a>(table: &'a Table, check: &str) -> Vec<&'a Value> {
    let inner = table.values().filter_map(Value::as_table).flat_map(|inner| settings(inner, check));
    table.get(check).into_iter().chain(inner).collect()
}

#[test]
fn the_profile_of_tests_has_all_checks_on_and_no_crate_without() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
    let manifest: Table = std::fs::read_to_string(path).unwrap().parse().unwrap();
    let profiles = manifest["profile"].as_table().unwrap();
    for check in CHECKS {
        assert_eq!(profiles["dev"].get(check), Some(&Value::Boolean(true)), "profile.dev.{check}");
        let tested = ["dev", "test"].map(|name| profiles.get(name).and_then(Value::as_table));
        let all: Vec<_> = tested.into_iter().flatten().flat_map(|profile| settings(profile, check)).collect();
        assert!(all.iter().all(|value| **value == Value::Boolean(true)), "{check} is off in {all:?}");
    }
}

#[test]
fn this_build_checks_for_overflows() {
    assert!(std::panic::catch_unwind(|| debug_assert!(black_box(false))).is_err());
    assert!(std::panic::catch_unwind(|| black_box(u8::MAX) + black_box(1)).is_err());
}
