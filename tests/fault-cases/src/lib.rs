//! Faults by script: the cases of `tests/faults`, and how a play that meets one is judged.
//!
//! The runner (`crates/stream/tests/faults.rs`) takes [`cases`], does what each [`Fault`] says when [`Kind::begins`] says, fills in
//! [`Seen`] and [`Observed`], and asks [`Expect::judge`].
//!
//! - [`case`]: the format of a file.
//! - [`judge`]: what a run has shown, and whether that is what the case expects.
//! - [`bytes`]: what a device must never send.
//! - [`plays`]: kinds with patterns, many at once.
//!
//! Invariant: nothing here knows how the runner makes time pass.

#![expect(missing_docs, missing_debug_implementations, reason = "only tests use it")]
#![expect(clippy::unwrap_used, clippy::missing_panics_doc, reason = "a test that panics has failed")]

pub mod bytes;
pub mod case;
pub mod judge;
pub mod plays;

pub use case::{
    Case, Ends, Evidence, Expect, Fault, Kind, Lie, LineFault, Moment, Number, ONSET, OfKind, Order,
    PHASE_AFTER, Phase, Telemetry, To, What,
};
pub use judge::{Observed, Seen, high_until};
pub use plays::{jobs, run};

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::Duration;
use toml::{Table, Value};

/// One amplitude everywhere; bursts at many phases; motors that follow each other.
pub const PATTERNS: [&str; 3] = ["pin-60", "edge-45", "wave"];
/// How long a play lasts.
pub const PLAY: Duration = Duration::from_secs(2);

/// All cases, by their names: a table each in the files of `tests/faults`.
pub fn cases() -> Vec<Case> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../faults");
    let files = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let files = files.filter(|path| path.extension().is_some_and(|ext| ext == "toml"));
    let mut cases: Vec<Case> = files.flat_map(|path| family(&fs::read_to_string(path).unwrap())).collect();
    cases.sort_by(|a, b| a.name.cmp(&b.name));
    assert!(cases.is_sorted_by(|a, b| a.name < b.name), "a name stands twice in tests/faults");
    cases
}

/// The cases of a file. Each has what the table `each` has, unless it says otherwise; the faults of `each` come after its own.
fn family(text: &str) -> Vec<Case> {
    let mut tables: BTreeMap<String, Table> = toml::from_str(text).unwrap();
    let each = tables.remove("each").unwrap_or_default();
    let case = |(name, mut table): (String, Table)| {
        inherit(&mut table, &each);
        let case = table.try_into().unwrap_or_else(|error| panic!("tests/faults: {name}: {error}"));
        Case { name, ..case }
    };
    tables.into_iter().map(case).collect()
}

fn inherit(own: &mut Table, each: &Table) {
    for (key, value) in each {
        match (own.get_mut(key), value) {
            (None, _) => drop(own.insert(key.clone(), value.clone())),
            (Some(Value::Table(own)), Value::Table(each)) => inherit(own, each),
            (Some(Value::Array(own)), Value::Array(each)) if key == "fault" => {
                own.extend(each.iter().cloned());
            }
            _ => {}
        }
    }
}
