//! The maximum load: 24 motors, each reversing 600 times a second.

use crate::play::{Play, play};
use meissner_hil::scenario::pattern;

const SECONDS: f64 = 1.2;

fn full_load(slow: f64) {
    let played = play(&Play { slow, ..Play::new(pattern("full-load").unwrap(), SECONDS) });
    let bursts = played.outcome.bursts;
    println!(
        "slow {slow}: {} bursts in {SECONDS} s, {} late; load {:.1} %; least slack of a block {} ticks",
        bursts.played,
        bursts.late,
        100.0 * played.load,
        played.slack,
    );
    played.assert_whole();
    assert!(played.slack > 0, "a block came too late");
}

#[test]
fn full_load_is_played_whole() {
    full_load(1.0);
}

#[test]
fn full_load_is_played_whole_by_a_core_a_tenth_slower() {
    full_load(1.1);
}
