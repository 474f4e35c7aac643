//! Edges of the trigger input: they mark, start and stop plays, exact to the tick, over good and bad lines.

use firmware_protocol::message::{DeviceHello, DeviceMessage, Report, Trigger};
use firmware_protocol::tick::Tick;
use meissner_api::{EdgeEffect, EndCause};
use meissner_stream::Line;
use meissner_stream::queues::{At, Command, CommandError, Edge, End, Outcome, StreamEvent};
use meissner_test_support::rig::{self, Rig, answer, bad_line};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::time::Duration;

/// 1 ms, which is also the dead time of the input.
const MS: u64 = 85;

/// An edge comes so many ticks from now; returns its tick.
fn edge_in(rig: &mut Rig, ticks: u64) -> Tick {
    let tick = rig.mock.now() + ticks;
    assert!(rig.mock.edge_at(tick, 0));
    tick
}

fn edges(events: &[StreamEvent]) -> Vec<(Edge, Option<u64>, EdgeEffect)> {
    let edge = |event: &StreamEvent| match event {
        StreamEvent::Edge { edge, play, effect } => Some((*edge, *play, *effect)),
        _ => None,
    };
    events.iter().filter_map(edge).collect()
}

/// Orders a play of a pin that begins so many ticks after an edge; returns its id and the ticket.
fn start(rig: &mut Rig, delay: u64, stop_on_edge: bool) -> (u64, u64) {
    let mut play = rig.play(&rig::pattern("pin-60"), Some(0.3));
    (play.at, play.stop_on_edge) = (At::Edge((delay * 1_000_000_000).div_ceil(85_000)), stop_on_edge);
    let id = play.id;
    (id, rig.send(Command::Play(Box::new(play))))
}

/// The tick of the first pulse on the lines.
fn first_pulse(rig: &mut Rig) -> Option<Tick> {
    let trace = rig.mock.take_trace();
    trace.iter().find(|(_, run)| run.drivers && !run.lines.up.is_empty()).map(|&(tick, _)| tick)
}

fn started_by(outcome: &Outcome) -> Option<Tick> {
    outcome.started_by.map(|edge| edge.at.tick)
}

#[test]
fn a_play_begins_the_delay_after_its_edge_exact_to_the_tick() {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    for (seed, line) in [(1, Line::default()), (2, bad_line())] {
        let mut rig = Rig::armed(line, seed);
        // What the pattern waits itself, by a play without an edge.
        rig.mock.take_trace();
        rig.start(&rig::pattern("pin-60"), Some(0.3));
        rig.run_ms(600);
        let plain = rig.outcomes().pop().unwrap().onset.unwrap();
        let waits = first_pulse(&mut rig).unwrap() - plain.actual;
        for _ in 0..12 {
            // On the bad line an edge may have to be reported again.
            let delay = 100 * MS + u64::from(random.next_u32() % 20_000);
            let (id, ticket) = start(&mut rig, delay, false);
            rig.run_ms(50);
            assert_eq!(answer(&rig.take_events(), ticket), Some(Ok(())));
            let ahead = u64::from(random.next_u32() % 40_000);
            let edge = edge_in(&mut rig, ahead);
            let outcome = rig.run_to_end(id, Duration::from_secs(3)).unwrap();
            let onset = outcome.onset.unwrap();
            assert_eq!((started_by(&outcome), onset.actual), (Some(edge), edge + delay));
            assert_eq!((onset.requested, outcome.end), (onset.actual, End::Done));
            assert_eq!(first_pulse(&mut rig), Some(edge + delay + waits));
            let found = edges(&rig.take_events());
            assert_eq!(found, [(outcome.started_by.unwrap(), Some(id), EdgeEffect::Start)]);
        }
    }
}

/// The second edge comes while the first play runs and only marks: the second play waits for its end.
#[test]
fn waiting_plays_take_an_edge_each() {
    let mut rig = Rig::armed(Line::default(), 4);
    let ids = [0; 3].map(|_| start(&mut rig, 20 * MS, false).0);
    rig.run_ms(20);
    let [first, within, second] = [0, 100 * MS, 400 * MS].map(|ahead| edge_in(&mut rig, ahead));
    rig.run_ms(2000);
    let events = rig.take_events();
    let found: Vec<_> =
        edges(&events).into_iter().map(|(edge, play, does)| (edge.at.tick, play, does)).collect();
    let wanted = [
        (first, Some(ids[0]), EdgeEffect::Start),
        (within, Some(ids[0]), EdgeEffect::Mark),
        (second, Some(ids[1]), EdgeEffect::Start),
    ];
    assert_eq!(found, wanted);
    let outcomes = rig::into_outcomes(events);
    assert_eq!(outcomes.iter().map(started_by).collect::<Vec<_>>(), [Some(first), Some(second)]);
    // The third waits on, and a stop ends it: nothing was played of it.
    rig.send(Command::Stop);
    rig.run_ms(100);
    let waited = rig.outcomes().pop().unwrap();
    assert_eq!((waited.play.id, waited.end, waited.onset), (ids[2], End::Stopped, None));
    edge_in(&mut rig, 0);
    rig.mock.take_trace();
    rig.run_ms(500);
    assert_eq!(first_pulse(&mut rig), None);
}

/// An emergency stop ends what waits, and edges meanwhile only mark: nothing moves by them, neither before nor after the reset.
#[test]
fn edges_during_an_emergency_stop_mark_and_start_nothing() {
    let mut rig = Rig::armed(Line::default(), 6);
    let (id, _) = start(&mut rig, 20 * MS, true);
    rig.run_ms(20);
    rig.send(Command::EStop);
    rig.run_ms(50);
    rig.mock.take_trace();
    let latched = edge_in(&mut rig, 10);
    rig.run_ms(200);
    rig.send(Command::Reset { estops_seen: u64::MAX, keep: true });
    rig.run_ms(200);
    let disarmed = edge_in(&mut rig, 10);
    rig.run_ms(200);
    let events = rig.take_events();
    let found: Vec<_> =
        edges(&events).into_iter().map(|(edge, play, does)| (edge.at.tick, play, does)).collect();
    assert_eq!(found, [(latched, None, EdgeEffect::Mark), (disarmed, None, EdgeEffect::Mark)]);
    assert_eq!(first_pulse(&mut rig), None);
    let outcomes = rig::into_outcomes(events);
    assert_eq!(
        outcomes.iter().map(|outcome| (outcome.play.id, outcome.onset)).collect::<Vec<_>>(),
        [(id, None)]
    );
}

/// Its report may come before that of the onset.
#[test]
fn an_edge_right_after_the_onset_stops_the_play() {
    const DELAY: u64 = 20 * MS;
    for after in 1..=20 {
        let mut rig = Rig::armed(Line::default(), after);
        start(&mut rig, DELAY, true);
        rig.run_ms(20);
        let first = edge_in(&mut rig, 0);
        let last = first + DELAY + after;
        assert!(rig.mock.edge_at(last, 0));
        rig.run_ms(600);
        let outcome = rig.outcomes().pop().unwrap();
        let edges = [outcome.started_by, outcome.stopped_by].map(|edge| edge.map(|edge| edge.at.tick));
        assert_eq!((outcome.end, edges), (End::Stopped, [Some(first), Some(last)]), "{after} ticks after");
    }
}

#[test]
fn a_board_without_a_trigger_input_starts_no_play_by_an_edge() {
    let mut rig = Rig::new(Line::default(), 6);
    rig.lie(|message| {
        if let DeviceMessage::Hello(hello) = message {
            hello.features &= !DeviceHello::TRIGGER_INPUT;
        }
    });
    rig.arm();
    let (_, ticket) = start(&mut rig, 100 * MS, false);
    rig.run_ms(20);
    assert_eq!(answer(&rig.take_events(), ticket), Some(Err(CommandError::NoTriggerInput)));
}

/// A board whose trigger pin is the input gives no pulse, and the account says so.
#[test]
fn without_a_trigger_output_no_trigger_is_recorded_and_a_code_is_refused() {
    let mut rig = Rig::new(Line::default(), 7);
    rig.lie(|message| {
        if let DeviceMessage::Hello(hello) = message {
            hello.features |= DeviceHello::NO_TRIGGER_OUTPUT;
        }
    });
    rig.arm();
    let mut given = |code| {
        let mut play = rig.play(&rig::pattern("pin-60"), Some(0.1));
        play.items[0].trigger = Some(Trigger { width: 85, code });
        let ticket = rig.send(Command::Play(Box::new(play)));
        rig.run_ms(400);
        let events = rig.take_events();
        let triggers: Vec<_> = events
            .iter()
            .filter_map(|event| match event {
                StreamEvent::PlayEnded { outcome, .. } => Some(outcome.play.items[0].trigger),
                _ => None,
            })
            .collect();
        (answer(&events, ticket), triggers)
    };
    assert_eq!(given(0), (Some(Ok(())), vec![None]));
    assert_eq!(given(5), (Some(Err(CommandError::NoTriggerOutput)), vec![]));
}

/// The host stands still while the edge comes: too late for its onset, the play ends, and nothing moves.
#[test]
fn an_onset_that_the_host_has_missed_is_never_played_later() {
    let mut rig = Rig::armed(Line::default(), 8);
    let (id, _) = start(&mut rig, 20 * MS, false);
    rig.run_ms(20);
    rig.mock.take_trace();
    let edge = edge_in(&mut rig, 0);
    rig.stall(Duration::from_millis(30));
    let outcome = rig.run_to_end(id, Duration::from_secs(1)).unwrap();
    assert_eq!((outcome.end, &outcome.cause), (End::Aborted, &Some(EndCause::OnsetMissed)));
    assert_eq!((started_by(&outcome), outcome.onset), (Some(edge), None));
    assert_eq!(first_pulse(&mut rig), None);
}

/// Untrue edges start nothing: one without the input, two in a dead time, one from the future.
#[test]
fn edges_that_cannot_be_true_are_ignored() {
    for lie in 0..3 {
        let mut rig = Rig::new(Line::default(), 11);
        let mut lies = 1;
        rig.lie(move |message| match message {
            DeviceMessage::Hello(hello) if lie == 0 => hello.features &= !DeviceHello::TRIGGER_INPUT,
            DeviceMessage::Report { report: Report::Edge { tick, number }, .. } if lies > 0 => {
                match (lie, *number) {
                    (1, 2) => (*number, lies) = (900, 0),
                    (2, _) => (*tick, lies) = ((tick.near(Tick::BOOT) + 85_000).wire(), 0),
                    _ => {}
                }
            }
            _ => {}
        });
        rig.arm();
        edge_in(&mut rig, 0);
        rig.run_ms(20);
        edge_in(&mut rig, 0);
        rig.run_ms(100);
        assert!(rig.contradictions() >= 1, "{lie}");
        // The device repeats a report that was not read: the second time it is true.
        let wanted = if lie == 0 { 0 } else { 2 };
        assert_eq!(edges(&rig.take_events()).len(), wanted, "{lie}");
    }
}

#[test]
fn edges_to_come_are_withdrawn_for_one_client_alone() {
    let mut rig = Rig::armed(Line::default(), 1);
    let at = [1, 2, 3, 4].map(|ms| rig.mock.now() + 100 * ms * MS);
    for (number, tick) in (0..).zip(at) {
        assert!(rig.mock.edge_at(tick, number % 2));
    }
    rig.mock.withdraw_edges(1);
    rig.run_ms(600);
    let came: Vec<Tick> = edges(&rig.take_events()).iter().map(|(edge, ..)| edge.at.tick).collect();
    assert_eq!(came, [at[0], at[2]]);
    let later = rig.mock.now() + MS;
    assert!(rig.mock.edge_at(later, 1), "it may order others");
    rig.run_ms(100);
    assert_eq!(edges(&rig.take_events()).len(), 1);
}
