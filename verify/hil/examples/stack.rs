//! `stack [ELF]`: how much of its stack the firmware uses, at most, while it plays 24 motors at 300 Hz, returns them under a limit on
//! motors at once, and tests itself.
//!
//! It fills the stack with a pattern after the start, and looks how much of it is left.

#![expect(clippy::unwrap_used, reason = "what cannot go on has failed")]

#[path = "../tests/play.rs"]
#[expect(dead_code, reason = "it is the tests', which use the rest of it")]
mod play;
#[path = "../tests/random.rs"]
mod random;

use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::rig::RigOptions;
use meissner_hil::time::MS;
use meissner_stream::queues::Command;

/// Bytes of the stack, and those at its end that are filled: the rest may be in use.
const STACK: usize = 32_768;
const FILLED: usize = STACK - 2_048;
const PATTERN: u64 = 0x5ac3_5ac3_5ac3_5ac3;

fn main() {
    let mut options = ChipOptions::new(1);
    if let Some(elf) = std::env::args_os().nth(1) {
        options.elf = elf.into();
    }
    let mut settings = RigOptions::default();
    settings.settings.limits.rail_at_once = 3;
    let mut rig = play::armed_with(options, settings);
    rig.chip.poke("_stack_end", &PATTERN.to_le_bytes().repeat(FILLED / 8)).unwrap();
    for number in [1, 4, 5] {
        let played = if number == 4 { random::taking_turns(number) } else { random::pattern(number) };
        rig.order(play::job(&played, 0.3));
        rig.run_to(rig.now() + 200 * MS).unwrap();
        rig.order(Command::EStop);
        rig.run_to(rig.now() + 20 * MS).unwrap();
        rig.order(Command::Reset { estops_seen: u64::MAX, keep: true });
        rig.run_to(rig.now() + 20 * MS).unwrap();
        rig.order(Command::Arm { assume_rest: false });
        rig.run_to(rig.now() + 100 * MS).unwrap();
    }
    let left = rig.chip.memory("_stack_end", FILLED).unwrap();
    let left = left.chunks_exact(8).take_while(|word| **word == PATTERN.to_le_bytes()).count() * 8;
    println!("{} of {STACK} bytes of the stack used at most", STACK - left);
}
