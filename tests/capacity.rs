use crate::rig::{self, Rig, assert_closed};
use meissner::pattern::{Drive, Pattern};
use meissner::stream::port::{Job, Notice, Refused};
use meissner::stream::{Line, Need, Settings};
use meissner::strokes::Strokes;
use std::time::Duration;

fn all_at(frequency_hz: f64) -> Pattern {
    let drive = |motor| Drive {
        motor,
        frequency_hz,
        amplitude_um: 20.0,
        phase: f64::from(motor * 7 % 24) / 24.0,
        start_s: None,
        stop_s: None,
    };
    Pattern::new("all-at", None, (0..24).map(drive).collect(), toml::Table::new()).unwrap()
}

/// Nothing for a second, then all pins at 250 Hz for 60 ms, again and again.
fn bursts() -> Pattern {
    let drive = |motor| Drive {
        motor,
        frequency_hz: 250.0,
        amplitude_um: 10.0,
        phase: 0.0,
        start_s: Some(1.0),
        stop_s: Some(1.06),
    };
    Pattern::new("bursts", Some(1.5), (0..24).map(drive).collect(), toml::Table::new()).unwrap()
}

fn slow(bytes_per_s: u32) -> Rig {
    let mut rig = Rig::new(Line { bytes_per_s, delay: Duration::from_micros(300), ..Line::default() }, 5);
    rig.arm();
    rig
}

/// Plays on a line of `bytes_per_s`: the refusal, or what came of it.
fn try_on(bytes_per_s: u32, pattern: &Pattern, open_loop: bool) -> Result<(), Refused> {
    let mut rig = slow(bytes_per_s);
    let mut play = rig.play(pattern, Some(4.0));
    play.open_loop = open_loop;
    rig.order(Job::Play(Box::new(play)));
    let answer = rig.take_notices().into_iter().find_map(|notice| match notice {
        Notice::Answer { result, .. } => Some(result),
        _ => None,
    });
    answer.unwrap()?;
    let outcome = rig.run_to_end(1, Duration::from_secs(6)).expect("it ends");
    assert_closed(&outcome);
    let name = pattern.name();
    assert_eq!(outcome.bursts.played, outcome.bursts.planned, "{name} at {bytes_per_s}: {outcome:?}");
    assert!(outcome.bursts.planned > 100 && (open_loop || outcome.bursts.amended > 0));
    Ok(())
}

#[test]
fn what_a_line_carries_just_so_is_played_without_lateness_and_what_it_does_not_is_refused_with_numbers() {
    let patterns =
        [rig::pattern("edge-45"), rig::pattern("all-in-phase"), all_at(33.3), all_at(210.0), bursts()];
    for (pattern, open_loop) in patterns.iter().flat_map(|pattern| [(pattern, true), (pattern, false)]) {
        let strokes = Strokes::new(pattern, Some(4.0)).unwrap();
        let need = Need::of(&strokes, &Settings::default());
        let wanted = if open_loop { need.open.rate } else { need.closed.rate };
        let mut line = wanted / 2;
        loop {
            match try_on(line, pattern, open_loop) {
                Ok(()) => break,
                Err(Refused::LineTooSlow { needs, carries }) => {
                    assert_eq!(needs, wanted);
                    // Whole frames on their way, for a millisecond there and back. (A rehearsal measures by half
                    // milliseconds.)
                    let frames = f64::from((line / 500 / 256).max(1)) * 256.0;
                    let expected = (frames / (0.001 + 256.0 / f64::from(line))).min(line.into());
                    let share = f64::from(carries) / expected;
                    assert!(
                        (0.85..=1.15).contains(&share) && carries <= line,
                        "{carries} of {line}, {expected}"
                    );
                    line += line / 20;
                }
                Err(other) => panic!("{other}"),
            }
        }
        println!("{} {open_loop}: needs {wanted}, accepted at {line}", pattern.name());
        assert!(line >= wanted, "{wanted} {line}");
    }
}

#[test]
fn what_a_play_needs_covers_what_it_sends() {
    for pattern in rig::shipped() {
        for open_loop in [true, false] {
            let mut rig = Rig::new(Line::default(), 6);
            rig.arm();
            let mut play = rig.play(&pattern, Some(4.0));
            play.open_loop = open_loop;
            let need = if open_loop { play.need.open } else { play.need.closed };
            rig.order(Job::Play(Box::new(play)));
            let outcome = rig.run_to_end(1, Duration::from_secs(6)).expect("it ends");
            // The lead's worth is sent in the first instant.
            let mean = outcome.wire_bytes as f64 / 4.1;
            assert!(f64::from(need.rate) > mean, "{}: {} of {mean}", pattern.name(), need.rate);
        }
    }
}

#[test]
fn a_uart_is_measured_and_says_what_it_carries() {
    let mut rig = Rig::new(Line { bytes_per_s: 11_520, ..Line::default() }, 7);
    rig.run(Duration::from_millis(600));
    let carried = rig.take_notices().into_iter().rev().find_map(|notice| match notice {
        Notice::Snapshot(snapshot) => snapshot.line_bytes_per_s,
        _ => None,
    });
    let carried = carried.expect("it was measured");
    assert!((10_500..=11_520).contains(&carried), "{carried}");
    rig.arm();
    let play = rig.play(&all_at(300.0), None);
    rig.order(Job::Play(Box::new(play)));
    let line = rig.take_notices().into_iter().find_map(|notice| match notice {
        Notice::Answer { result: Err(refused), .. } => Some(refused.to_string()),
        _ => None,
    });
    let line = line.expect("it is refused");
    assert!(
        line.starts_with("the pattern needs ") && line.contains("kB/s at its peak, the line carries 11."),
        "{line}"
    );
}

/// What is measured costs no more than a few frames, and a lossy line is measured too.
#[test]
fn measuring_is_bounded_and_deterministic() {
    for line in [Line::default(), rig::bad_line(), Line { bytes_per_s: 5_000, ..Line::default() }] {
        let run = || {
            let mut rig = Rig::new(line, 8);
            rig.run(Duration::from_millis(900));
            let last = rig.take_notices().into_iter().rev().find_map(|notice| match notice {
                Notice::Snapshot(snapshot) => Some((snapshot.line_bytes_per_s, snapshot.bytes_out)),
                _ => None,
            });
            last.unwrap()
        };
        let (carried, bytes) = run();
        assert!(carried.is_some() && bytes < 12_000, "{line:?}: {carried:?}, {bytes} bytes");
        assert_eq!(run(), (carried, bytes));
    }
}
