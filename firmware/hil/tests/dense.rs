//! Strokes as dense as a host can send them: the controller refuses what the chip has no time to render, and starves nothing. If a host
//! sends more than may be played, with two moves of each motor in a block, the chip may give up: lines off, one report, no restart.

use crate::hand::Hand;
use crate::margin::TIME;
use firmware_protocol::controller::{BLOCK, HORIZON};
use firmware_protocol::message::{Cause, Counters, Report, State};
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_array::strokes::Stroke;
use meissner_hil::bench::Which;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::tap::Event;
use meissner_hil::time::MS;
use meissner_test_support::paper::MOTORS;

/// Ticks of a millisecond.
const TICKS: u64 = 85;
/// Ticks from one stroke to the next in the densest play: four strokes of each motor in 10 ms.
const DENSEST: u64 = 213;

/// Strokes of one pulse of all motors.
#[derive(Clone, Copy, Debug)]
struct Dense {
    /// Ticks from each stroke of a motor to its next one.
    apart: u64,
    /// Ticks from the up pulse to the down pulse.
    held: u64,
    /// Ticks from a motor's strokes to those of the next motor, within as many as this.
    spread: (u64, u64),
}

impl Dense {
    /// Strokes for 0.2 s in order of time, or as many as a host has credits for reports.
    fn strokes(self, first: Tick) -> Vec<Stroke> {
        let each = (200 * TICKS / self.apart)
            .min(if self.apart < u64::from(Array::paper().layout().least_apart()) { 20 } else { 200 });
        let (step, within) = self.spread;
        let stroke = |number: u64, motor: u8| {
            let up = first + number * self.apart + u64::from(motor) * step % within;
            Stroke { motor, up, up_pulses: 1, down: up + self.held, down_pulses: 1 }
        };
        let mut all: Vec<_> =
            (0..each).flat_map(|number| (0..MOTORS as u8).map(move |motor| stroke(number, motor))).collect();
        all.sort_by_key(|stroke| (stroke.up, stroke.motor));
        all
    }

    /// Whether the device may turn its lines off: there are more strokes than it plays, and two moves of each motor in a block.
    fn may_starve(self) -> bool {
        self.apart < DENSEST && self.held.min(self.apart - self.held) < u64::from(BLOCK)
    }

    /// Plays them on a core slower by a tenth: each block is rendered in time.
    fn play(self) {
        let mut hand = Hand::armed(&Which::Chip(ChipOptions { slow: 1.1, ..ChipOptions::new(1) }), 25_500);
        let strokes = self.strokes(hand.tick() + 50 * TICKS);
        hand.chip().poke("SLACK_MIN", &HORIZON.to_le_bytes()).unwrap();
        // Every 5 ms, sends the strokes that begin within 45 ms.
        let mut rest = &strokes[..];
        while !rest.is_empty() {
            let until = hand.tick() + 45 * TICKS;
            let (next, later) = rest.split_at(rest.partition_point(|stroke| stroke.up < until));
            hand.append(next.to_vec());
            rest = later;
            hand.run(5 * MS);
        }
        // What waits on the line is taken, too.
        hand.run(300 * MS);
        let left = hand.chip().read("SLACK_MIN", 4).unwrap();
        let (status, sent) = (hand.status(), 2 * strokes.len() as u64);
        let Counters { played, refused, .. } = status.counters;
        println!(
            "{self:?}: of {TIME} ticks, {left} are left at least; {played} of {sent} bursts played, {refused} refused"
        );
        assert_eq!(hand.chip().resets(), 0, "{self:?}");
        if self.may_starve() && status.state == State::Faulted {
            self.has_given_up(&mut hand);
            return;
        }
        assert_eq!(status.state, State::Armed, "{self:?}: {:?}", status.cause);
        assert!(left > 0, "{self:?}");
        // If a host sends more than the device plays, frames wait on the line or find no room.
        let wanted = if self.apart < DENSEST { played > 0 && refused > 0 } else { played == sent };
        assert!(wanted, "{self:?}: {:?}", status.counters);
    }

    /// The device has turned its lines off because rendering was late, and says so once.
    fn has_given_up(self, hand: &mut Hand) {
        assert_eq!(hand.status().cause, Cause::Starved, "{self:?}");
        // The host's last strokes were sent 300 ms ago.
        assert!(hand.low_since() < hand.now() - 200 * MS, "{self:?}: a line is high");
        let cuts = hand.tap.events.iter().filter_map(|(_, event)| match event {
            Event::Report(Report::Cut(cut)) => Some(cut.cause),
            _ => None,
        });
        assert_eq!(cuts.collect::<Vec<_>>(), [Cause::Starved], "{self:?}");
    }
}

#[test]
fn strokes_of_one_pulse_starve_nothing() {
    for (apart, held) in [(3, 1), (40, 1), (85, 1), (142, 141), (DENSEST, 1), (DENSEST, DENSEST - 1)] {
        // In phase, at all ticks of a block, and out of phase.
        for spread in [(0, 1), (7, u64::from(BLOCK)), (u64::div_ceil(apart, 24), apart)] {
            Dense { apart, held, spread }.play();
        }
    }
}
