//! Firmware with a planted bug is rejected: a judge that lets everything pass would pass everything.
//!
//! `MEISSNER_MUTANTS` names firmware files, separated by colons. Without it there is nothing to be done.

use crate::play::{Play, play};
use meissner_hil::scenario::pattern;
use std::panic::{AssertUnwindSafe, catch_unwind};

#[test]
fn planted_bugs_are_found() {
    let Some(mutants) = std::env::var_os("MEISSNER_MUTANTS") else { return };
    for elf in std::env::split_paths(&mutants) {
        assert!(elf.is_file(), "{}: not there", elf.display());
        let whole = Play { elf: Some(elf.clone()), ..Play::new(pattern("wave").unwrap(), 0.3) };
        // A mutant may also never greet, or end no play: found as well.
        let seen = catch_unwind(AssertUnwindSafe(|| play(&whole).wrong()));
        let seen = seen.unwrap_or_else(|_| vec!["it does not even play".to_owned()]);
        println!("{}: {}", elf.display(), seen.first().map_or("nothing seen", String::as_str));
        assert!(!seen.is_empty(), "{}: passes", elf.display());
    }
}
