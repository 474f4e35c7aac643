//! Bandwidth: the link probe measures the line, and the streamer refuses plays that the line does not carry.
//!
//! The tests look for the slowest line that each pattern is accepted on, and check that it then plays in time.

use meissner_array::pattern::{Drive, Pattern};
use meissner_array::spec::Array;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_stream::queues::CommandError;
use meissner_stream::{Bandwidth, Line, Settings};
use meissner_test_support::patterns::{self, drive};
use meissner_test_support::rig::{self, Rig, answer, assert_closed, last_snapshot};
use std::time::Duration;

fn all_at(frequency_hz: f64) -> Pattern {
    let drive =
        |motor: u8| Drive { phase: f64::from(motor * 7 % 24) / 24.0, ..drive(motor, frequency_hz, 20.0) };
    patterns::pattern("all-at", None, (0..24).map(drive))
}

/// Nothing for a second, then all pins at 250 Hz for 60 ms, again and again.
fn bursts() -> Pattern {
    let drive = |motor| Drive { start_s: Some(1.0), stop_s: Some(1.06), ..drive(motor, 250.0, 10.0) };
    patterns::pattern("bursts", Some(1.5), (0..24).map(drive))
}

/// Plays on a line of `bytes_per_s`: checks the play, or returns the refusal.
fn try_on(bytes_per_s: u32, pattern: &Pattern, open_loop: bool) -> Result<(), CommandError> {
    let line = Line { bytes_per_s, delay: Duration::from_micros(300), ..Line::default() };
    let mut rig = Rig::armed(line, 5);
    let play = rig.start_with(pattern, Some(4.0), |play| play.open_loop = open_loop);
    answer(&rig.take_events(), play).unwrap()?;
    let outcome = rig.run_to_end(1, Duration::from_secs(6)).expect("it ends");
    assert_closed(&outcome);
    let name = pattern.name();
    assert_eq!(outcome.bursts.played, outcome.bursts.planned, "{name} at {bytes_per_s}: {outcome:?}");
    assert!(outcome.bursts.planned > 100 && (open_loop || outcome.bursts.amended > 0));
    Ok(())
}

#[test]
fn a_line_plays_up_to_its_capacity_and_refuses_more_with_numbers() {
    let patterns =
        [rig::pattern("edge-45-paper"), rig::pattern("all-in-phase"), all_at(33.3), all_at(210.0), bursts()];
    for (pattern, open_loop) in patterns.iter().flat_map(|pattern| [(pattern, true), (pattern, false)]) {
        let strokes = Strokes::new(pattern, &StrokeOptions::lasting(4.0)).unwrap();
        let bandwidth = Bandwidth::of(&strokes, &Settings::of(Array::paper()));
        let required = if open_loop { bandwidth.open } else { bandwidth.closed };
        let wanted = required.rate;
        let mut line = wanted / 2;
        loop {
            match try_on(line, pattern, open_loop) {
                Ok(()) => break,
                Err(CommandError::LineTooSlow { needs, frames, carries, waits }) => {
                    assert_eq!((needs, frames), (wanted, required.frames));
                    let left = f64::from(carries) * (1.0 - f64::from(waits) / 100.0);
                    // Full frames wait for an answer, a millisecond or two; the simulation steps by 0.5 ms.
                    let waits = f64::from(required.frames) / f64::from((line / 500 / 256).max(1));
                    let bounds = [0.0022, 0.0006].map(|wait_s| f64::from(line) * (1.0 - waits * wait_s));
                    assert!(
                        bounds[0] * 0.95 < left && left < bounds[1] * 1.05,
                        "{left} of {line}, {bounds:?}"
                    );
                    line += line / 20;
                }
                Err(other) => panic!("{other}"),
            }
        }
        assert!(line >= wanted, "{wanted} {line}");
    }
}

/// The machine stands still at any moment of the measurement, once or again and again. No play is refused by it: what was measured meanwhile
/// does not count, and the line is measured again when the machine works.
#[test]
fn no_stall_in_the_measurement_makes_a_line_slow() {
    const MS: Duration = Duration::from_millis(1);
    let fast = Line::default();
    let uart = Line { bytes_per_s: 11_520, ..fast };
    // The handshake and the first pings take some 30 ms.
    for (at, stall) in (0..60).step_by(14).flat_map(|at| [3, 20, 120, 240].map(|stall| (at, stall))) {
        for (line, again) in [(fast, false), (fast, true), (uart, false), (uart, true)] {
            let what = format!("{stall} ms after {at} ms of {}, again: {again}", line.bytes_per_s);
            let mut rig = Rig::new(line, 7);
            rig.run(at * MS);
            for _ in 0..if again { 1_000 / stall } else { 1 } {
                rig.stall(stall * MS);
                rig.run(MS);
            }
            let measured = |rig: &mut Rig| last_snapshot(&rig.take_events()).line_bytes_per_s;
            if line == fast {
                rig.run_ms(800);
                let carried = measured(&mut rig);
                assert!(carried.is_none_or(|carried| carried > 200_000), "{what}: {carried:?}");
                rig.arm();
                let play = rig.start(&all_at(300.0), None);
                assert_eq!(answer(&rig.take_events(), play), Some(Ok(())), "{what}");
            } else {
                // Idle round trips that were held up make it seem a little faster.
                rig.run_ms(4_000);
                let carried = measured(&mut rig);
                assert!(
                    carried.is_some_and(|carried| (8_000..=20_000).contains(&carried)),
                    "{what}: {carried:?}"
                );
            }
        }
    }
}
