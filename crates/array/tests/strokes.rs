//! From patterns to strokes: exact ticks, repeats and cuts, and invariants on random patterns.

use firmware_protocol::limits;
use firmware_protocol::stroke::Stroke;
use firmware_protocol::tick::Tick;
use meissner_array::motor::SquareWave;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::strokes::{Strokes, StrokesError};
use meissner_test_support::patterns::{self, drive};
use proptest::prelude::*;

fn pattern(duration_s: Option<f64>, drives: Vec<Drive>) -> Pattern {
    patterns::pattern("test", duration_s, drives)
}

fn all(pattern: &Pattern, seconds: Option<f64>) -> Vec<Stroke> {
    Strokes::new(pattern, seconds).unwrap().map(Result::unwrap).collect()
}

/// The strokes of a pattern by the rule of the model, drive by drive and sorted at the end: what `Strokes` must return.
fn by_the_rule(pattern: &Pattern, seconds: f64) -> Vec<Stroke> {
    let ticks = |seconds: f64| (seconds * 85_000.0 + 0.5).floor() as u64;
    let end = ticks(seconds);
    let mut strokes = Vec::new();
    for repeat in 0.. {
        let begin = |repeat: i32| {
            pattern.duration_s().map(|d| (f64::from(repeat) * d * 85_000.0 + 0.5).floor() as u64)
        };
        let start = begin(repeat).unwrap_or(0);
        if start >= end || (repeat > 0 && pattern.duration_s().is_none()) {
            break;
        }
        for drive in pattern.drives() {
            let wanted = (drive.amplitude_um / (0.95 / 7.0) + 0.5).floor() as u64;
            let edge = |h: i32| {
                let tick = ((f64::from(h) / 2.0 + drive.phase) * 85_000.0) / drive.frequency_hz + 0.5;
                start + tick.floor() as u64 + drive.start_s.map_or(0, ticks)
            };
            for h in (0..).step_by(2) {
                let (up, down) = (edge(h), edge(h + 1));
                let pulses = wanted.min(down - up).min(edge(h + 2) - down);
                let stop = drive.stop_s.map_or(u64::MAX, |stop| start + ticks(stop));
                if down + pulses > stop.min(begin(repeat + 1).unwrap_or(u64::MAX)).min(end) {
                    break;
                }
                if pulses > 0 {
                    let (motor, up, down, pulses) = (drive.motor, Tick(up), Tick(down), pulses as u16);
                    strokes.push(Stroke { motor, up, up_pulses: pulses, down, down_pulses: pulses });
                }
            }
        }
    }
    strokes.sort_by_key(|stroke| (stroke.up, stroke.motor));
    strokes
}

/// Successive drives of a motor, with gaps, in at most 0.4 s.
fn drives_of(motor: u8) -> impl Strategy<Value = Vec<Drive>> {
    let drive = (0.1..300.0f64, 0.0..400.0f64, 0.0..1.0f64, 0.0..0.03f64, 0.001..0.1f64);
    (prop::collection::vec(drive, 0..4), any::<bool>()).prop_map(move |(settings, open)| {
        let mut at = 0.0;
        let count = settings.len();
        let drives = settings.into_iter().enumerate().map(|(i, (hz, amplitude_um, phase, gap, length))| {
            let start = at + gap;
            at = start + length;
            Drive {
                motor,
                // Mostly high frequencies, of which several periods fit.
                frequency_hz: (300.0 - hz).max(0.1),
                amplitude_um,
                phase,
                start_s: Some(start),
                stop_s: (!open || i + 1 < count).then_some(at),
            }
        });
        drives.collect()
    })
}

fn any_pattern() -> impl Strategy<Value = Pattern> {
    let drives = (0..24).map(drives_of).collect::<Vec<_>>();
    (drives, prop::option::of(0.4..0.7f64))
        .prop_map(|(drives, duration_s)| pattern(duration_s, drives.concat()))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_pattern_plays_by_the_rule_and_within_the_limits(pattern in any_pattern(), seconds in 0.0..2.0f64) {
        let strokes = all(&pattern, Some(seconds));
        prop_assert_eq!(&strokes, &by_the_rule(&pattern, seconds));
        let mut busy = [Tick(0); 24];
        for stroke in &strokes {
            prop_assert!(limits::check(stroke).is_ok() && stroke.up_pulses == stroke.down_pulses);
            let busy = &mut busy[usize::from(stroke.motor)];
            prop_assert!(stroke.up >= *busy);
            *busy = stroke.end();
        }
        prop_assert!(strokes.windows(2).all(|pair| (pair[0].up, pair[0].motor) < (pair[1].up, pair[1].motor)));
    }

    #[test]
    fn an_edge_is_the_nearest_tick_a_month_in(n in 103..307_200_i128, p in 0..4096_i128, h in 0..1_600_000_000_i128) {
        // Frequencies of n/1024 and phases of p/4096 are exact in f64; so is the tick wanted, as a fraction.
        let wave = SquareWave::new(n as f64 / 1024.0, 1.0, p as f64 / 4096.0).unwrap();
        let tick = i128::from(wave.edge(h as u64));
        let (numerator, denominator) = ((h * 2048 + p) * 85_000 * 1024, 4096 * n);
        prop_assert!((tick * denominator - numerator).abs() * 1000 <= 501 * denominator);
    }
}

#[test]
fn a_stroke_that_a_repeat_is_too_short_for_is_left_out() {
    // One saturated period in a repeat: whether it fits depends on how the ends of the repeat round.
    for hz in [299.0, 150.5, 201.3, 290.1, 233.0, 77.7] {
        for ticks in [-1.0, -0.6, -0.3, 0.0, 0.3] {
            let period = pattern(
                Some(1.0 / hz + ticks / 85_000.0),
                vec![drive(0, hz, 400.0), drive(1, hz / 2.0, 9.0)],
            );
            assert_eq!(all(&period, Some(3.0)), by_the_rule(&period, 3.0), "{hz} Hz, {ticks}");
        }
    }
}

#[test]
fn a_play_can_begin_anywhere_and_again() {
    let pattern = pattern(None, vec![drive(3, 60.0, 80.0), drive(9, 47.0, 30.0)]);
    let mut strokes = Strokes::new(&pattern, Some(1.0)).unwrap();
    let first: Vec<_> = strokes.by_ref().map(Result::unwrap).collect();
    assert_eq!((first.len(), strokes.end()), (60 + 47, Some(85_000)));
    strokes.begin(Tick::BOOT);
    strokes.nth(5);
    strokes.begin(Tick(1 << 40));
    for (a, b) in first.into_iter().zip(strokes) {
        let onset = 1 << 40;
        assert_eq!(Stroke { up: a.up + onset, down: a.down + onset, ..a }, b.unwrap());
    }
}

#[test]
fn repeats_follow_without_a_gap() {
    let pattern = pattern(Some(0.1), vec![drive(0, 50.0, 80.0)]);
    let ups: Vec<_> = all(&pattern, Some(2.0)).iter().map(|stroke| stroke.up.0).collect();
    assert_eq!(ups, (0..100).map(|k| k * 1700).collect::<Vec<_>>());
}

#[test]
fn a_rare_repeat_that_is_long_enough_is_found_at_once() {
    // A saturated period of 425 ticks in repeats of 424, but one in ten thousand million of 425.
    let duration_s = (424.0 + 1e-10) / 85_000.0;
    let begin = |repeat: u64| (repeat as f64 * duration_s * 85_000.0 + 0.5).floor() as u64;
    let mut strokes =
        Strokes::new(&pattern(Some(duration_s), vec![drive(0, 200.0, 80.0)]), Some(1e8)).unwrap();
    let ups: Vec<_> = strokes.by_ref().map(|stroke| stroke.unwrap().up.0).collect();
    assert_eq!(ups.len(), 2);
    for up in ups {
        let repeat = up / 424;
        assert_eq!((begin(repeat - 1), begin(repeat), begin(repeat + 1)), (up - 424, up, up + 425));
    }
}

#[test]
fn seconds_truncate_and_a_stroke_is_whole_or_absent() {
    let once = pattern(Some(1.0), vec![drive(0, 10.0, 80.0)]);
    assert_eq!(all(&once, None).len(), 10);
    // The sixth stroke comes down from tick 46 750 to 47 339.
    assert_eq!(all(&once, Some(47_339.0 / 85_000.0)).len(), 6);
    assert_eq!(all(&once, Some(47_338.0 / 85_000.0)).len(), 5);
    assert_eq!(all(&once, Some(0.0)), []);
    assert_eq!(all(&once, Some(2.5)).len(), 25);
}

#[test]
fn a_pattern_without_strokes_ends() {
    let silent = drive(0, 60.0, 0.05);
    assert_eq!(all(&pattern(None, vec![silent]), None), []);
    assert_eq!(all(&pattern(Some(0.01), vec![silent]), Some(1e8)), []);
    // Too short for one stroke, repeated for three years.
    assert_eq!(all(&pattern(Some(0.01), vec![drive(0, 10.0, 80.0)]), Some(1e8)), []);
    assert_eq!(all(&pattern(None, vec![]), None), []);
    let ends = |pattern: &Pattern| Strokes::new(pattern, None).unwrap().end();
    assert_eq!(ends(&pattern(None, vec![])), Some(0));
    assert_eq!(ends(&pattern(None, vec![drive(0, 60.0, 80.0)])), None);
    let stops = Drive { stop_s: Some(0.5), ..drive(0, 60.0, 80.0) };
    assert_eq!(ends(&pattern(None, vec![stops])), Some(42_500));
    assert_eq!(all(&pattern(None, vec![stops]), None).len(), 30);
    assert_eq!(ends(&pattern(None, vec![stops, drive(1, 60.0, 80.0)])), None);
}

#[test]
fn a_duration_out_of_range_is_refused() {
    for seconds in [-1.0, f64::NAN, f64::INFINITY] {
        let refused = Strokes::new(&pattern(None, vec![]), Some(seconds));
        assert!(matches!(refused, Err(StrokesError::Seconds { .. })));
    }
}

#[test]
fn nothing_is_allocated_while_it_plays() {
    let drives = (0..24).map(|motor| drive(motor, 60.0 + f64::from(motor), 20.0)).collect();
    let mut strokes = Strokes::new(&pattern(Some(0.5), drives), Some(60.0)).unwrap();
    let count = assert_no_alloc::assert_no_alloc(|| {
        strokes.begin(Tick::BOOT);
        strokes.by_ref().filter(Result::is_ok).count()
    });
    assert!(count > 24 * 60 * 60);
}
