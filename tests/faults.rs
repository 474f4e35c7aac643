//! Scripted faults against this program: a few kinds of `tests/faults`, in real time, on a board behind a pseudo-terminal.
//!
//! All kinds, with three patterns each, take minutes: `tests/faults/run pty`. In virtual time `crates/stream/tests/faults.rs` plays
//! them all.

use crate::harness::PROGRAM;
use meissner_fault_cases::{Case, Kind, cases};
use meissner_fault_pty::run;
use std::path::Path;

/// One fault of each sort: line, host, cable, board, clock, false reports, sensors, an order.
const KINDS: [(&str, &str); 10] = [
    ("line-loses", "10 %"),
    ("line-holds-back-to-host", "2000 ms"),
    ("host-hangs", "1000 ms"),
    ("host-dies", "300 ms"),
    ("unplugged", "up"),
    ("device-restarts", ""),
    ("clock-drifts", "200 ppm/s"),
    ("device-lies-about-credits", ""),
    ("telemetry-is-stuck", ""),
    ("estop-while-the-line-loses", "hold"),
];

#[test]
fn a_daemon_on_a_terminal_meets_faults_as_their_cases_say() {
    let cases = cases();
    let kinds: Vec<Kind<'_>> = cases
        .iter()
        .flat_map(Case::kinds)
        .filter(|kind| KINDS.contains(&(kind.case.name.as_str(), kind.label().as_str())))
        .collect();
    assert_eq!(kinds.len(), KINDS.len(), "each is there");
    let (shown, repeated) = run(Path::new(PROGRAM), &["edge-45"], 4, &kinds, |_| ());
    println!("{repeated} plays were repeated because the machine stood still");
    shown.iter().flat_map(|shown| &shown.unjudged).for_each(|problem| println!("not judged: {problem}"));
    let problems: Vec<String> = shown.into_iter().flat_map(|shown| shown.problems).collect();
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}
