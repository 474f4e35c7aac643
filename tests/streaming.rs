//! The streamer against the mock in virtual time: what comes out of the lines is what was compiled.

use crate::rig;
use meissner::stream::Line;
use meissner::stream::port::End;
use std::time::Duration;

#[test]
fn every_shipped_pattern_is_played_tick_for_tick() {
    for pattern in rig::shipped() {
        let mut rig = rig::Rig::new(Line::default(), 1);
        rig.arm();
        let outcome = rig.play_exactly(&pattern, 60.0);
        assert_eq!(outcome.end, End::Done, "{}", pattern.name());
        assert_eq!(outcome.bursts.played, outcome.bursts.planned);
        assert_eq!(outcome.pulses.played, outcome.pulses.planned);
    }
}

#[test]
fn a_bad_line_changes_nothing_as_long_as_the_lead_covers_it() {
    let line = Line {
        loss: 0.05,
        repeat: 0.05,
        corrupt: 0.05,
        delay: Duration::from_micros(300),
        jitter: Duration::from_millis(2),
    };
    for (seed, pattern) in (2..).zip(rig::shipped()) {
        let mut rig = rig::Rig::new(line, seed);
        rig.arm();
        let outcome = rig.play_exactly(&pattern, 60.0);
        assert_eq!(outcome.end, End::Done, "{}", pattern.name());
        assert_eq!(outcome.bursts.played, outcome.bursts.planned, "{}: {outcome:?}", pattern.name());
    }
}
