//! Edges of the trigger input: numbered, reported once each, and harmless.

use crate::bench::{Bench, FIRMWARE, PAPER, stroke};
use firmware_protocol::controller::REPORTS;
use firmware_protocol::message::{Op, Report};
use firmware_protocol::tick::Tick;

const DEAD: u64 = PAPER.edge_dead_time() as u64;

/// The edges that the host has read: tick and number.
fn edges(bench: &Bench) -> Vec<(u64, u32)> {
    let edge = |report| match report {
        Report::Edge { tick, number } => Some((tick.near(Tick(bench.now)).0, number)),
        _ => None,
    };
    bench.reports().into_iter().filter_map(edge).collect()
}

#[test]
fn edges_count_once_in_each_dead_time_and_in_any_state() {
    let mut bench = Bench::new(FIRMWARE);
    bench.hello(3);
    let first = bench.now;
    assert_eq!(DEAD, 85);
    for after in [0, 1, DEAD - 1, DEAD, DEAD + 1, 3 * DEAD] {
        bench.device.edge(Tick(first + after));
    }
    bench.run(4 * DEAD);
    bench.control(Op::EStop);
    let latched = bench.now;
    bench.device.edge(Tick(latched));
    bench.run(100);
    assert_eq!(edges(&bench), [(first, 1), (first + DEAD, 2), (first + 3 * DEAD, 3), (latched, 4)]);
}

/// The host reads nothing: edges leave the places of onsets and cuts, and their numbers show what is missing.
#[test]
fn edges_take_no_place_of_onsets_and_cuts() {
    let mut bench = Bench::armed(FIRMWARE);
    bench.reading = false;
    for _ in 0..100 {
        bench.device.edge(Tick(bench.now));
        bench.run(DEAD);
    }
    let at = bench.soon();
    bench.onset(at, &[stroke(3, at, 40, 5, 40)]);
    bench.run(200);
    bench.control(Op::Stop);
    bench.run(200);
    assert_eq!(bench.device.counters().reports_lost, 0);
    bench.reading = true;
    for token in 0..3 {
        bench.ping(token);
        bench.run(850);
    }
    let kept = edges(&bench).len() as u32;
    assert!((kept as usize) < REPORTS && kept > 10, "{kept}");
    let last: Vec<_> = bench.reports().into_iter().skip(kept as usize).collect();
    assert!(matches!(last[..], [Report::Onset { .. }, Report::Cut(_)]), "{last:?}");
    bench.device.edge(Tick(bench.now));
    bench.run(100);
    let numbers: Vec<_> = edges(&bench).into_iter().map(|(_, number)| number).collect();
    assert_eq!(numbers, (1..=kept).chain([101]).collect::<Vec<_>>());
}
