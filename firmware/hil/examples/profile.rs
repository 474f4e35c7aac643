//! `profile [ELF]`: where the firmware's cycles go while it plays 24 motors at 280 to 300 Hz, out of phase and in phase.
//!
//! Prints the share of each function, inlined ones by themselves, of each function with what it calls inline, and of each function that is
//! left after inlining; then the longest call of each function. Needs `llvm-addr2line` (Debian: llvm) on the path.

#![expect(clippy::unwrap_used, reason = "what cannot go on has failed")]

#[path = "../tests/play.rs"]
#[expect(dead_code, reason = "it is the tests', which use the rest of it")]
mod play;
#[path = "../tests/random.rs"]
#[expect(dead_code, reason = "it is the tests', which use the rest of it")]
mod random;

use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::time::MS;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::process::Command;

/// Functions printed of each list.
const TOLD: usize = 45;
/// Length of the play.
const SECONDS: f64 = 0.3;

fn main() {
    let mut options = ChipOptions::new(1);
    if let Some(elf) = std::env::args_os().nth(1) {
        options.elf = elf.into();
    }
    let elf = options.elf.clone();
    let mut rig = play::armed(options);
    let (mut elapsed, mut busy) = (0, 0);
    let (mut counts, mut longest) = (BTreeMap::<u32, u64>::new(), BTreeMap::<String, u64>::new());
    for number in [4, 1] {
        rig.order(play::job(&random::pattern(number), SECONDS));
        // The first frames are taken while the lines are quiet.
        rig.run_to(rig.now() + 30 * MS).unwrap();
        rig.chip().unwrap().profile(true).unwrap();
        let (from, busy_before) = (rig.now(), rig.chip().unwrap().busy_cycles());
        rig.run_to(rig.now() + 250 * MS).unwrap();
        elapsed += rig.now() - from;
        busy += rig.chip().unwrap().busy_cycles() - busy_before;
        let profile = rig.chip().unwrap().profile(false).unwrap();
        for (address, cycles) in profile.instructions {
            *counts.entry(address).or_default() += cycles;
        }
        for (function, cycles) in profile.longest {
            let most = longest.entry(function).or_default();
            *most = cycles.max(*most);
        }
        rig.run_to(rig.now() + 100 * MS).unwrap();
    }
    println!("busy {:.1} % of {elapsed} cycles", 100.0 * busy as f64 / elapsed as f64);

    let mut addresses = String::new();
    for address in counts.keys() {
        writeln!(addresses, "{address:#x}").unwrap();
    }
    let path = std::env::temp_dir().join(format!("profile-{}", std::process::id()));
    std::fs::write(&path, addresses).unwrap();
    let symbols = Command::new("llvm-addr2line")
        .args(["-f", "-i", "-C", "-a", "-e"])
        .arg(&elf)
        .stdin(std::fs::File::open(&path).unwrap())
        .output()
        .expect("llvm-addr2line is on the path");
    std::fs::remove_file(&path).unwrap();
    let text = String::from_utf8_lossy(&symbols.stdout).into_owned();
    let (mut own, mut whole) = (BTreeMap::<&str, u64>::new(), BTreeMap::<&str, u64>::new());
    // By the functions that are left after inlining.
    let mut left = BTreeMap::<&str, u64>::new();
    let mut blocks = text.split("0x").skip(1);
    for cycles in counts.values() {
        // The address, then pairs of function and line from the innermost function outwards.
        let functions: Vec<_> = blocks.next().unwrap_or_default().lines().skip(1).step_by(2).collect();
        *own.entry(functions.first().copied().unwrap_or("?")).or_default() += cycles;
        *left.entry(functions.last().copied().unwrap_or("?")).or_default() += cycles;
        for function in functions.into_iter().collect::<BTreeSet<_>>() {
            *whole.entry(function).or_default() += cycles;
        }
    }
    for (title, list) in [("itself", own), ("with what is inlined", whole), ("calls apart", left)] {
        let mut list: Vec<_> = list.into_iter().collect();
        list.sort_by_key(|&(_, cycles)| std::cmp::Reverse(cycles));
        println!("{title}:");
        for (function, cycles) in list.into_iter().take(TOLD) {
            println!("  {:5.2} %  {function}", 100.0 * cycles as f64 / elapsed as f64);
        }
    }
    let mut longest: Vec<_> = longest.into_iter().collect();
    longest.sort_by_key(|&(_, cycles)| std::cmp::Reverse(cycles));
    println!("longest calls, cycles:");
    for (function, cycles) in longest.into_iter().take(TOLD) {
        println!("  {cycles:7}  {function}");
    }
}
