//! Strokes as dense as a host can send them: the chip starves at none that the controller plays. If a host sends more than that, with
//! two moves of each motor in a block, the chip may give up: lines off, one report, no restart.

use crate::hand::Hand;
use crate::margin::TIME;
use firmware_protocol::controller::{BLOCK, HORIZON};
use firmware_protocol::message::{Cause, Report, State};
use meissner_array::strokes::Stroke;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::tap::Event;
use meissner_hil::time::MS;
use meissner_test_support::paper::MOTORS;

/// Ticks of a millisecond.
const TICKS: u64 = 85;
/// Ticks from one stroke to the next in the densest play: four strokes of each motor in 10 ms.
const DENSEST: u64 = 213;

/// Sends strokes of one pulse of all motors for 0.2 s to a core slower by a tenth: `apart` ticks from each of a motor to its next one,
/// `held` from the pulse up to the one down, and `step` from a motor's to those of the next motor, within as many as `within`.
fn play(apart: u64, held: u64, (step, within): (u64, u64)) {
    let what = format!("{apart} apart, {held} held, {step} in {within}");
    let mut hand = Hand::armed(&ChipOptions { slow: 1.1, ..ChipOptions::new(1) }, 25_500);
    let first = hand.tick() + 50 * TICKS;
    // As many as a host has credits for reports.
    let each = if apart < DENSEST { 20 } else { 200 * TICKS / apart };
    let stroke = |number: u64, motor: u8| {
        let up = first + number * apart + u64::from(motor) * step % within;
        Stroke { motor, up, up_pulses: 1, down: up + held, down_pulses: 1 }
    };
    let mut strokes: Vec<_> =
        (0..each).flat_map(|number| (0..MOTORS as u8).map(move |motor| stroke(number, motor))).collect();
    strokes.sort_by_key(|stroke| (stroke.up, stroke.motor));
    hand.chip.poke("SLACK_MIN", &HORIZON.to_le_bytes()).unwrap();
    // Every 5 ms, those that begin within 45 ms.
    let mut rest = &strokes[..];
    while !rest.is_empty() {
        let until = hand.tick() + 45 * TICKS;
        let (next, later) = rest.split_at(rest.partition_point(|stroke| stroke.up < until));
        hand.append(next.to_vec());
        rest = later;
        hand.run(5 * MS);
    }
    hand.run(300 * MS);
    let left = hand.chip.read("SLACK_MIN", 4).unwrap();
    let status = hand.status();
    println!("{what}: of {TIME} ticks, {left} are left at least; {:?}", status.counters);
    assert_eq!(hand.chip.resets(), 0, "{what}");
    if apart < DENSEST && held.min(apart - held) < u64::from(BLOCK) && status.state == State::Faulted {
        let cuts = hand.tap.cuts();
        let told = hand.tap.events.iter();
        let told = told.filter(|(_, event)| matches!(event, Event::Report(Report::Cut(_)))).count();
        assert_eq!((cuts[0].1.cause, cuts.len(), told), (Cause::Starved, 1, 1), "{what}");
        let low = hand.chip.pins.low_since(u64::MAX).unwrap();
        assert!(
            low < hand.now() - 200 * MS && hand.chip.pins.still_high().is_none(),
            "{what}: a line is high"
        );
        return;
    }
    assert_eq!(status.state, State::Armed, "{what}: {:?}", status.cause);
    assert!(left > 0, "{what}");
    let is_whole = status.counters.played == hand.sent;
    assert_eq!(is_whole, apart >= DENSEST, "{what}: {:?}", status.counters);
}

#[test]
fn strokes_of_one_pulse_starve_nothing() {
    for (apart, held) in [(3, 1), (40, 1), (DENSEST, 1), (DENSEST, DENSEST - 1)] {
        // In phase, at all ticks of a block, and out of phase.
        for spread in [(0, 1), (7, u64::from(BLOCK)), (u64::div_ceil(apart, 24), apart)] {
            play(apart, held, spread);
        }
    }
}
