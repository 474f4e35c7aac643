//! Every shipped pattern on the chip, open loop: its pulses are the compiled strokes, tick for tick.

use crate::play::{Play, play};
use meissner_hil::scenario::{pattern, pattern_names};

/// Long enough for every motor of every pattern to play. A pattern that ends sooner is played once.
const SECONDS: f64 = 0.6;

fn shipped(share: usize, of: usize) {
    for name in pattern_names().unwrap().into_iter().skip(share).step_by(of) {
        let pattern = pattern(&name).unwrap();
        let seconds = pattern.duration_s().unwrap_or(SECONDS).min(SECONDS);
        let played = play(&Play { seed: share as u64 + 1, ..Play::new(pattern, seconds) });
        played.assert_whole();
        println!("{name}: {} pulses over {seconds} s as compiled", played.pulses);
    }
}

macro_rules! shares {
    ($($name:ident: $share:literal,)*) => {
        $(#[test] fn $name() { shipped($share, 4) })*
    };
}

// Four tests, to use up to four cores.
shares! {
    shipped_patterns_1_of_4: 0,
    shipped_patterns_2_of_4: 1,
    shipped_patterns_3_of_4: 2,
    shipped_patterns_4_of_4: 3,
}
