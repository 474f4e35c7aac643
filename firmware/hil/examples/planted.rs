//! `planted ELF...`: plays to each firmware and prints what the judge finds.
//!
//! `firmware/hil/mutants` makes firmware with planted bugs, to test the judge. Exit 0 if the judge finds nothing in the
//! firmware called `unharmed` and something in each of the others.

#[path = "../tests/play.rs"]
#[expect(dead_code, clippy::unwrap_used, reason = "it is the tests', which use the rest of it")]
mod play;

use meissner_hil::scenario::pattern;
use play::{Play, play};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::process::ExitCode;

/// Most findings printed of each firmware.
const TOLD: usize = 3;

fn main() -> ExitCode {
    let mut wrongly = Vec::new();
    for elf in std::env::args_os().skip(1).map(PathBuf::from) {
        let name = elf.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if !elf.is_file() {
            eprintln!("planted: {}: not there", elf.display());
            return ExitCode::FAILURE;
        }
        let pattern = match pattern("wave") {
            Ok(pattern) => pattern,
            Err(error) => {
                eprintln!("planted: {error}");
                return ExitCode::FAILURE;
            }
        };
        let whole = Play { elf: Some(elf), ..Play::new(pattern, 0.3) };
        // A firmware that never answers the handshake, or never ends a play, counts as found too.
        let seen = catch_unwind(AssertUnwindSafe(|| play(&whole).wrong()));
        let seen = seen.unwrap_or_else(|_| vec!["it does not even play".to_owned()]);
        let told =
            if seen.is_empty() { "nothing seen".to_owned() } else { seen[..seen.len().min(TOLD)].join("; ") };
        println!("{name}: {told}");
        if seen.is_empty() != (name == "unharmed") {
            wrongly.push(name);
        }
    }
    if wrongly.is_empty() {
        ExitCode::SUCCESS
    } else {
        eprintln!("planted: judged wrongly: {}", wrongly.join(", "));
        ExitCode::FAILURE
    }
}
