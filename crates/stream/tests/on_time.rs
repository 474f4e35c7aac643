//! Plays under on-time limits: the device refuses strokes as they begin, and the host learns of each.
//!
//! The tests play in virtual time and compare position control and accounts with the simulated pins and the device's counts.

use firmware_protocol::limits::PowerLimits;
use meissner_api::ErrorSource;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::spec::Array;
use meissner_stream::queues::{Command, End, Outcome, StreamEvent};
use meissner_stream::{Line, Settings};
use meissner_test_support::paper::MOTORS;
use meissner_test_support::patterns::{drive, pattern};
use meissner_test_support::rig::{Rig, assert_closed, into_outcomes, last_snapshot};
use std::time::Duration;

/// All motors at 80 um; each is `shift` cycles behind the one before.
fn all_motors(frequency_hz: f64, shift: f64) -> Pattern {
    let drives = (0..MOTORS as u8)
        .map(|motor| Drive { phase: f64::from(motor) * shift, ..drive(motor, frequency_hz, 80.0) });
    pattern("all", None, drives)
}

fn rig(motor: u32, line: Line, seed: u64) -> Rig {
    let limits = PowerLimits { motor, ..Array::paper().layout().no_limits() };
    let mut rig = Rig::with(Settings { limits, ..Settings::of(Array::paper()) }, line, seed);
    rig.arm();
    rig
}

/// Plays in closed loop; stops after `stop_ms`, or lets the play of `seconds` end by itself. Returns the outcome, the number
/// of sensor faults, and of motors that do not use telemetry at the end.
fn play(rig: &mut Rig, pattern: &Pattern, seconds: f64, stop_ms: Option<u64>) -> (Outcome, usize, usize) {
    rig.start_closed(pattern, Some(seconds));
    if let Some(ms) = stop_ms {
        rig.run_ms(ms);
        rig.send(Command::Stop);
        rig.run_ms(500);
    } else {
        rig.run(Duration::from_secs_f64(seconds + 0.5));
    }
    rig.mock.take_trace();
    let events = rig.take_events();
    let faults = events.iter().filter(|event| matches!(event, StreamEvent::SensorFault { .. })).count();
    let source = last_snapshot(&events).pins.rest.source;
    let blind = source.iter().filter(|&&source| source != ErrorSource::Telemetry).count();
    let outcome = into_outcomes(events).remove(0);
    assert_closed(&outcome);
    (outcome, faults, blind)
}

/// Thousands of refused strokes a second, 24 of them in one tick: no sensor fault, and pins as near to rest as without limits.
#[test]
fn position_control_holds_pins_under_every_on_time_limit() {
    let limits = [2_000, 10_000, 15_000, 17_000, 85_000];
    for (frequency_hz, shift, limits) in
        [(60.0, 0.0, &limits[..]), (60.0, 1.0 / 24.0, &limits[..2]), (300.0, 0.0, &limits[..1])]
    {
        for &motor in limits {
            let mut rig = rig(motor, Line::default(), 1);
            let (outcome, faults, blind) = play(&mut rig, &all_motors(frequency_hz, shift), 6.0, None);
            let (bursts, counters) = (outcome.bursts, rig.mock.controller().counters());
            let farthest = (0..24).map(|motor| rig.mock.position_um(motor).abs()).fold(0.0, f64::max);
            let rms = rig.mock.true_positions().rest().rms_um();
            assert_eq!((faults, blind, outcome.end), (0, 0, End::Done));
            assert_eq!((bursts.played, bursts.refused), (counters.played, counters.refused));
            assert_eq!((bursts.dropped, bursts.late, counters.reports_lost), (0, 0, 0));
            // The first burst after half a second of rest scatters more: at 2000 pulses/s there is no other.
            let least = if motor == 2_000 { 20.0 } else { 14.0 };
            assert!(rms < least && farthest < 60.0, "{rms} um rms, {farthest} um");
        }
    }
}

/// A line that loses reports: they come later, and position control waits for them.
#[test]
fn lost_reports_of_refused_strokes_do_not_mislead_position_control() {
    let line = Line { loss: 0.002, jitter: Duration::from_micros(500), ..Line::default() };
    for seed in 0..3 {
        let mut rig = rig(10_000, line, seed);
        let (outcome, faults, blind) = play(&mut rig, &all_motors(60.0, 0.0), 9.0, None);
        let (bursts, rms) = (outcome.bursts, rig.mock.true_positions().rest().rms_um());
        assert_eq!((faults, blind), (0, 0), "seed {seed}");
        assert_eq!(bursts.refused, rig.mock.controller().counters().refused);
        assert!(rms < 14.0, "{rms} um");
    }
}

/// The same play, stopped and ended by itself: what was played, refused and dropped is what the device counted.
#[test]
fn the_account_of_a_stopped_play_says_what_happened() {
    for motor in [2_000, 10_000] {
        for (seconds, stop_ms) in [(9.0, None), (60.0, Some(9_000)), (60.0, Some(20_000))] {
            let mut rig = rig(motor, Line::default(), 3);
            let (outcome, ..) = play(&mut rig, &all_motors(60.0, 0.0), seconds, stop_ms);
            let (bursts, counters) = (outcome.bursts, rig.mock.controller().counters());
            assert_eq!((bursts.played, bursts.refused), (counters.played, counters.refused));
            // 24 motors for the lead and a batch, 112 ms: at most 7 strokes each.
            let most = if stop_ms.is_some() { 2 * 24 * 7 } else { 0 };
            assert!(bursts.dropped <= most && bursts.late == 0, "{bursts:?}");
            assert_eq!(bursts.dropped > 0, stop_ms.is_some());
        }
    }
}

/// A line that becomes slow makes strokes late; the stop comes before their verdicts. They still count as late.
#[test]
fn verdicts_under_way_at_a_stop_still_count() {
    let mut rig = Rig::armed(Line::default(), 3);
    rig.start_closed(&all_motors(60.0, 0.0), Some(5.0));
    rig.run_ms(500);
    rig.set_line(Line { delay: Duration::from_millis(150), ..Line::default() });
    rig.run_ms(200);
    rig.send(Command::Stop);
    rig.run_ms(1500);
    let outcome = rig.outcomes().remove(0);
    let (bursts, counters) = (outcome.bursts, rig.mock.controller().counters());
    assert_closed(&outcome);
    assert!(counters.late > 0);
    assert_eq!((bursts.played, bursts.late), (counters.played, counters.late));
}
