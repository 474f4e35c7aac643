//! The oracle on links made by hand.

use super::*;
use crate::log::Train;
use crate::tap::{Batch, Event};
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{Amendment, Unpacked};
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{Cause, Cut, LowerStop, Mark, MarkKind, Op, Report, Withdraw};
use firmware_protocol::stroke::Direction::{Down, Up};
use meissner_array::spec::Array;
use meissner_test_support::paper::{MOTORS, WHOLE_TRAVEL};

fn at(tick: u64) -> Tick {
    Tick::BOOT + tick
}

fn to(motor: u8, tick: u64, level: u16) -> Unpacked {
    Unpacked { of: Move { motor, tick: at(tick), level, surplus: 0 }, joined: false }
}

/// The two moves of a stroke.
fn stroke(motor: u8, up: u64, level: u16, down: u64) -> [Unpacked; 2] {
    [to(motor, up, level), Unpacked { joined: true, ..to(motor, down, 0) }]
}

fn arm(limits: PowerLimits, lower_stop: Option<LowerStop>, assume_rest: bool) -> Event {
    Event::Control(1, Op::Arm { assume_rest, host_timeout: 25_500, limits, lower_stop })
}

fn frame(seq: u16, hold: Option<u32>, moves: Vec<Unpacked>) -> Event {
    let mark = hold.map(|hold| Mark { kind: MarkKind::Play, trigger: None, hold });
    Event::Batch(Batch { epoch: 0, seq, mark, withdraw: None, base: at(500), moves })
}

fn replacing(seq: u16, base: u64, moves: Vec<Unpacked>) -> Event {
    let withdraw = Some(Withdraw { motors: MotorSet::from_bits(1 << 3), generation: 0 });
    Event::Batch(Batch { epoch: 0, seq, mark: None, withdraw, base: at(base), moves })
}

fn lowered(tick: u64, by_move: bool) -> Event {
    let (late, held) = if by_move {
        (MotorSet::from_bits(1 << 3), MotorSet::EMPTY)
    } else {
        (MotorSet::EMPTY, MotorSet::from_bits(1 << 3))
    };
    Event::Report(Report::Lowered { tick: at(tick).wire(), late, held })
}

fn verdict(seq: u16, late: u64, kept: u64) -> Event {
    let (refused, reason, rendered) = (0, None, Tick::BOOT.wire());
    Event::Report(Report::Verdict { seq, late, refused, kept: MotorSet::from_bits(kept), reason, rendered })
}

fn cut(cause: Cause, tick: u64, return_ticks: Option<u32>, outstanding: u32) -> Event {
    Event::Report(Report::Cut(Cut { cause, at: at(tick).wire(), return_ticks, flushed: 0, outstanding }))
}

fn expected(events: Vec<Event>) -> Expected {
    let mut tap = Tap::default();
    tap.events = (0..).zip(events).collect();
    expect(&tap, None)
}

fn train(start: u64, direction: firmware_protocol::stroke::Direction, pulses: u64) -> Train {
    Train { start: at(start), direction, pulses }
}

fn no_limits() -> PowerLimits {
    Array::paper().layout().no_limits()
}

#[test]
fn a_pin_follows_its_goal() {
    let moves = vec![to(3, 500, 60), to(3, 600, 100), to(3, 620, 30), to(3, 700, 30), to(3, 800, 0)];
    let expected = expected(vec![arm(no_limits(), None, true), frame(0, Some(0), moves)]);
    // The way to 100 is shortened.
    let wanted = [train(500, Up, 60), train(600, Up, 20), train(620, Down, 50), train(800, Down, 30)];
    assert_eq!((&expected.log.lines[3][..], expected.contradictions), (&wanted[..], vec![]));
}

/// A pin comes down by a late move to a lower level and at the end of a hold, and for no other reason.
#[test]
fn goals_are_lowered_for_a_reason() {
    let begin = || vec![arm(no_limits(), None, true), frame(0, Some(0), vec![to(3, 500, 60)])];
    let late = [frame(1, None, vec![to(3, 590, 20)]), verdict(1, 1, 0), lowered(640, true)];
    let expected_of = |more: &[Event]| expected([&begin(), more].concat());
    let by_move = expected_of(&late);
    // The drivers start up first.
    assert_eq!(by_move.log.lines[3], [train(500, Up, 60), train(683, Down, 40)]);
    assert_eq!(by_move.contradictions, Vec::<String>::new());
    let hold = u64::from(Array::paper().layout().least_hold());
    for (tick, wrong) in [(560 + hold, 1), (561 + hold, 0)] {
        let by_hold = expected_of(&[lowered(tick, false)]);
        assert_eq!(by_hold.log.lines[3], [train(500, Up, 60), train(tick + 43, Down, 60)]);
        assert_eq!(by_hold.contradictions.len(), wrong, "{:?}", by_hold.contradictions);
    }
    let forgotten = expected_of(&[frame(1, None, vec![to(3, 600 + hold + 1_200, 0)])]);
    assert_eq!(forgotten.contradictions.len(), 1, "{:?}", forgotten.contradictions);
}

/// A device that pushes more than was planned differs from what is expected.
#[test]
fn an_amendment_lengthens_a_way_down_only_without_a_stop() {
    let stop = LowerStop { pulses_per_s: 25_500, seek: 0 };
    for (lower_stop, down) in [(Some(stop), 20), (None, 26)] {
        let amended = Event::Amend(vec![Amendment { motor: 3, tick: at(600), pulses: 26 }]);
        let events = vec![
            arm(no_limits(), lower_stop, true),
            frame(0, None, stroke(3, 500, 20, 600).to_vec()),
            amended,
        ];
        assert_eq!(expected(events).log.lines[3], [train(500, Up, 20), train(600, Down, down)]);
    }
}

/// A verdict that comes after a second replacement brings back what the first one withdrew, and the second one did not.
#[test]
fn what_a_verdict_keeps_is_played() {
    let old = [500, 600, 700, 800].map(|up| stroke(3, up, 20, up + 50));
    let new = [stroke(3, 650, 30, 700), stroke(3, 800, 40, 850)];
    let mut events = vec![
        frame(0, None, old.concat()),
        replacing(1, 600, new[0].to_vec()),
        replacing(2, 750, new[1].to_vec()),
    ];
    let moves = |strokes: &[[Unpacked; 2]]| strokes.iter().flatten().map(|one| one.of).collect::<Vec<_>>();
    let replaced =
        |strokes: &[[Unpacked; 2]], by| moves(strokes).iter().map(|to| (to.tick, by)).collect::<Vec<_>>();
    let first = expected(events.clone());
    assert_eq!((first.moves, first.replaced), (moves(&[old[0], new[0], new[1]]), replaced(&old[1..], 1)));
    events.push(verdict(1, 0b11, 1 << 3));
    let then = expected(events);
    assert_eq!(
        (then.moves, then.replaced),
        (moves(&[old[0], old[1], old[2], new[1]]), replaced(&old[3..], 2))
    );
}

/// With one motor of a rail at once, pins return one after the other: what runs, then the lowest number.
#[test]
fn returns_take_turns() {
    let limits = PowerLimits { rail_at_once: 1, ..no_limits() };
    let strokes =
        [stroke(2, 500, 20, 900), stroke(0, 520, 20, 590), stroke(1, 540, 20, 800), stroke(7, 550, 20, 700)];
    let play = frame(0, None, strokes.concat());
    for (return_ticks, wrong) in [(49, 1), (50, 0), (6 * 20, 0), (6 * 20 + 1, 1)] {
        let cut = cut(Cause::HostTimeout, 600, Some(return_ticks), 70);
        let expected = expected(vec![arm(limits, None, true), play.clone(), cut]);
        assert_eq!(expected.contradictions.len(), wrong, "{:?}", expected.contradictions);
        let downs = [0, 1, 2, 7].map(|motor: usize| expected.log.lines[motor][1]);
        let wanted = [train(590, Down, 20), train(610, Down, 20), train(630, Down, 20), train(600, Down, 20)];
        assert_eq!(downs, wanted);
    }
}

#[test]
fn pins_stay_after_an_e_stop_until_they_are_armed() {
    let mut events = vec![arm(no_limits(), None, true), frame(0, None, stroke(3, 500, 60, 600).to_vec())];
    events.extend([
        cut(Cause::EStop, 520, None, 20),
        arm(no_limits(), None, false),
        cut(Cause::Request, 2_000, Some(63), 20),
    ]);
    let expected = expected(events);
    assert_eq!(expected.log.lines[3], [train(500, Up, 20), train(2_043, Down, 20)]);
    assert_eq!(expected.contradictions, Vec::<String>::new());
    let Soft { from, to, planned } = &expected.soft[0];
    assert_eq!((*from, *to, &planned.lines[3][..]), (at(519), at(521), &[train(519, Up, 2)][..]));
}

/// A device that carries out a seek which it must refuse is found out.
#[test]
fn a_seek_that_is_too_short_contradicts_the_specification() {
    for (seek, wrong) in [(WHOLE_TRAVEL - 1, 1), (WHOLE_TRAVEL, 0)] {
        let arm = arm(no_limits(), Some(LowerStop { pulses_per_s: 25_500, seek }), false);
        let cut = cut(Cause::Request, 1_000, Some(43 + u32::from(seek)), MOTORS as u32 * u32::from(seek));
        let expected = expected(vec![arm, cut]);
        assert_eq!(expected.contradictions.len(), wrong, "{:?}", expected.contradictions);
        assert!(expected.log.lines.iter().all(|trains| trains[0].pulses == u64::from(seek)));
    }
}
