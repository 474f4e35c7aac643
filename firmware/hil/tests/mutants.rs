//! Firmware with a planted bug is rejected: a judge that lets everything pass would pass everything.
//!
//! `firmware/hil/mutants` builds it, and runs this with its names in `MEISSNER_MUTANTS`, separated by colons.

use crate::play::{Play, play};
use meissner_hil::scenario::pattern;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Findings told of each.
const TOLD: usize = 3;

#[test]
#[ignore = "firmware/hil/mutants makes what it needs"]
fn planted_bugs_are_found() {
    let mutants =
        std::env::var_os("MEISSNER_MUTANTS").expect("MEISSNER_MUTANTS names the firmware to be rejected");
    let mut passed = Vec::new();
    for elf in std::env::split_paths(&mutants) {
        assert!(elf.is_file(), "{}: not there", elf.display());
        let name = elf.file_name().unwrap().to_string_lossy().into_owned();
        let whole = Play { elf: Some(elf), ..Play::new(pattern("wave").unwrap(), 0.3) };
        // A mutant may also never greet, or end no play: found as well.
        let seen = catch_unwind(AssertUnwindSafe(|| play(&whole).wrong()));
        let seen = seen.unwrap_or_else(|_| vec!["it does not even play".to_owned()]);
        println!(
            "{name}: {}",
            if seen.is_empty() { "nothing seen".to_owned() } else { seen[..seen.len().min(TOLD)].join("; ") }
        );
        if seen.is_empty() != (name == "unharmed") {
            passed.push(name);
        }
    }
    assert!(passed.is_empty(), "judged wrongly: {passed:?}");
}
