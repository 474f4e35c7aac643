//! The time that rendering has left, over random patterns: with line noise, floods and e-stops, on a core a tenth slower.
//!
//! The example `margin` runs the same over more patterns.

use crate::play::{armed_with, job, job_of, pattern as named};
use crate::random::{pattern, taking_turns};
use firmware_protocol::controller::{BLOCK, HORIZON};
use firmware_protocol::frame::{MAX_FRAME, encode};
use firmware_protocol::message::{Cause, HostMessage, State};
use meissner_array::pattern::Pattern;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::rig::{Rig, RigOptions};
use meissner_hil::time::MS;
use meissner_stream::faulty::Line;
use meissner_stream::queues::{Command, StreamEvent};
use meissner_stream::{Gains, LowerStopSettings};
use meissner_test_support::paper::MOTORS;

/// Patterns per condition in a test.
#[cfg(test)]
const PATTERNS: u64 = 8;
/// Seconds of each.
const SECONDS: f64 = 0.12;
/// Ticks from the moment at which a block can be rendered to the fetch of its first word.
pub(crate) const TIME: u64 = (HORIZON - BLOCK - 3) as u64;

/// What goes on besides the play.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Beside {
    Nothing,
    /// Frames lost, damaged and repeated.
    Noise,
    /// 44 kB/s of valid pings between the host's frames.
    Pings,
    /// An e-stop in the middle, then reset and `arm`.
    EStops,
    /// A limit of three motors at once in each rail. The patterns keep it, and each stroke is compared with those of five motors.
    KeptLimit,
    /// The same, with patterns that break it; a daemon would refuse them.
    BrokenLimit,
}

/// Two pings.
fn pings() -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let len = encode(&HostMessage::Ping { token: 0, seen: 0 }, &mut frame).unwrap();
    frame[..len].iter().copied().cycle().take(2 * len).collect()
}

/// Plays pattern `number` and returns the least time left, in ticks.
fn least(rig: &mut Rig, number: u64, beside: Beside) -> u64 {
    rig.chip.poke("SLACK_MIN", &HORIZON.to_le_bytes()).unwrap();
    rig.notices.clear();
    let played = if beside == Beside::KeptLimit { taking_turns(number) } else { pattern(number) };
    rig.order(job(&played, SECONDS));
    let end = rig.now() + ((SECONDS + 0.1) * 1000.0) as u64 * MS;
    let e_stop = rig.now() + (30 + number * 37 % 60) * MS + number * 7_919 % MS;
    let mut stopped = beside != Beside::EStops;
    while rig.now() < end {
        if beside == Beside::Pings {
            rig.raw(&pings());
        }
        if !stopped && rig.now() >= e_stop {
            stopped = true;
            rig.order(Command::EStop);
        }
        rig.run_to(rig.now() + MS / 2).unwrap();
    }
    let status = rig.tap().status().unwrap();
    let left = rig.chip.read("SLACK_MIN", 4).unwrap();
    if beside == Beside::EStops {
        assert_eq!((status.state, status.cause), (State::Faulted, Cause::EStop), "pattern {number}");
        rig.order(Command::Reset { estops_seen: u64::MAX, keep: true });
        rig.run_to(rig.now() + 10 * MS).unwrap();
        rig.order(Command::Arm { assume_rest: false });
        // The return of all pins.
        rig.run_to(rig.now() + 60 * MS).unwrap();
    } else {
        assert_eq!(status.state, State::Armed, "pattern {number}: {:?}, {left} ticks left", status.cause);
        let ended = rig.notices.iter().find_map(|notice| match notice {
            StreamEvent::PlayEnded { outcome, .. } => Some(outcome.bursts),
            _ => None,
        });
        let bursts = ended.unwrap_or_else(|| panic!("pattern {number} has not ended"));
        // Frames that are sent again, or wait behind pings or reports of refusals, may come late; none is lost.
        let waits = matches!(beside, Beside::Noise | Beside::Pings | Beside::BrokenLimit);
        let late = if waits { bursts.late } else { 0 };
        let refused = if beside == Beside::BrokenLimit { bursts.refused } else { 0 };
        assert!(
            bursts.planned > 0 && bursts.played + late + refused == bursts.planned,
            "pattern {number}: {bursts:?}"
        );
    }
    left
}

/// How long the pins are still before a start, ms.
const RESTS: [u64; 4] = [0, 100, 1_000, 10_000];

/// What begins after a rest, for how many seconds it plays, and how many ticks must be left: bursts of all motors, in the same tick. Those of
/// less than 16 pulses begin and end in the same block, and leave less than half.
fn starts() -> Vec<(&'static str, Pattern, f64, u64)> {
    let all = |name, format, table: &str| {
        let tables: String = (0..MOTORS).map(|motor| format!("[[{table}\nmotor = {motor}\n")).collect();
        Pattern::parse(&format!("format = {format}\nname = \"{name}\"\n{tables}"), name).unwrap()
    };
    let strokes = |um| format!("drive]]\nfrequency_hz = 300.0\nphase = 0.0\namplitude_um = {um}");
    let hold = "ramp]]\nto_um = 40.0\nrise_s = 0.0\nhold_s = 1.5\nfall_s = 0.0";
    vec![
        ("8 um at 300 Hz", all("eight", 1, &strokes(8.0)), 0.05, 22),
        ("2 um at 300 Hz", all("two", 1, &strokes(2.0)), 0.05, 20),
        ("0.14 um at 300 Hz", all("least", 1, &strokes(0.14)), 0.05, 13),
        ("a hold of 1.5 s at 40 um", all("hold", 2, hold), 1.6, 22),
        ("all-in-phase", named("all-in-phase"), 0.05, 22),
        ("rough-noise", named("motions/rough-noise"), 0.3, 18),
    ]
}

/// Plays each start after each of the rests, prints the least time left and returns whether it is enough.
pub(crate) fn after_rests(slow: f64, has_stop: bool) -> bool {
    let mut options = RigOptions::default();
    options.settings.lower_stop = has_stop.then(|| LowerStopSettings::of(Array::paper()));
    let settings = options.settings;
    let mut rig = armed_with(ChipOptions { slow, ..ChipOptions::new(1) }, options);
    rig.run_to(rig.now() + 150 * MS).unwrap();
    let mut enough = true;
    for (name, pattern, seconds, least) in starts() {
        let surplus = settings.surplus(&PerMotor::all(Array::paper(), Gains::default()));
        let options = StrokeOptions { surplus, ..StrokeOptions::lasting(seconds) };
        let strokes = Strokes::new(&pattern, &options).unwrap();
        for rest in RESTS {
            rig.chip.poke("SLACK_MIN", &HORIZON.to_le_bytes()).unwrap();
            rig.notices.clear();
            rig.run_to(rig.now() + rest * MS).unwrap();
            rig.order(job_of(strokes.clone()));
            rig.run_to_end(1, (seconds * 1000.0) as u64 + 200).unwrap();
            let left = rig.chip.read("SLACK_MIN", 4).unwrap();
            let state = rig.tap().status().unwrap().state;
            let ended = rig.notices.iter().find_map(|notice| match notice {
                StreamEvent::PlayEnded { outcome, .. } => Some(outcome.bursts),
                _ => None,
            });
            let bursts = ended.unwrap();
            println!(
                "core at {:.0} %, {}stop, {name} after {rest} ms: of {TIME} ticks, {left} are left at least; {} of {} bursts \
                 played, then {state:?}",
                100.0 / slow,
                if has_stop { "" } else { "no " },
                bursts.played,
                bursts.planned,
            );
            assert_eq!(
                (state, bursts.played),
                (State::Armed, bursts.planned),
                "{name} after {rest} ms: {bursts:?}"
            );
            enough &= left >= least;
        }
    }
    enough
}

#[test]
fn time_is_left_after_rests() {
    assert!(after_rests(1.1, false));
}

#[test]
fn time_is_left_after_rests_at_a_lower_stop() {
    assert!(after_rests(1.1, true));
}

/// Plays so many patterns, prints the least time left and returns whether it is half of all.
pub(crate) fn sweep(slow: f64, beside: Beside, patterns: std::ops::Range<u64>) -> bool {
    let mut options = RigOptions::default();
    if matches!(beside, Beside::KeptLimit | Beside::BrokenLimit) {
        options.settings.limits.rail_at_once = 3;
    }
    let mut rig = armed_with(ChipOptions { slow, ..ChipOptions::new(1) }, options);
    if beside == Beside::Noise {
        rig.set_line(Line { loss: 0.02, repeat: 0.05, corrupt: 0.02, ..Line::default() });
    }
    let mut left: Vec<_> = patterns.map(|number| (least(&mut rig, number, beside), number)).collect();
    left.sort_unstable();
    let ((least, number), (median, _)) = (left[0], left[left.len() / 2]);
    println!(
        "core at {:.0} %, {beside:?}: of {TIME} ticks, {least} are left at least (pattern {number}) and {median} in the median of \
         {} patterns",
        100.0 / slow,
        left.len(),
    );
    assert_eq!(rig.chip.read("STALLS", 4).unwrap(), 0, "the executor counts as hung");
    let (boots, _) = rig.finish();
    assert_eq!(boots.len(), 1, "the chip has restarted");
    2 * least >= TIME
}

#[test]
fn half_of_the_time_is_left_to_a_core_a_tenth_slower() {
    assert!(sweep(1.1, Beside::Nothing, 0..PATTERNS));
}

#[test]
fn half_of_the_time_is_left_on_a_noisy_line() {
    assert!(sweep(1.1, Beside::Noise, 0..PATTERNS));
}

#[test]
fn half_of_the_time_is_left_under_a_flood_of_pings() {
    assert!(sweep(1.1, Beside::Pings, 0..PATTERNS));
}

#[test]
fn half_of_the_time_is_left_under_a_limit_on_motors_at_once() {
    assert!(sweep(1.1, Beside::KeptLimit, 0..PATTERNS));
}

/// The controller refuses strokes, and still renders in time.
#[test]
fn plays_that_break_a_limit_on_motors_at_once_starve_nothing() {
    sweep(1.1, Beside::BrokenLimit, 0..PATTERNS);
}

#[test]
fn half_of_the_time_is_left_around_e_stops() {
    assert!(sweep(1.1, Beside::EStops, 0..PATTERNS));
}
