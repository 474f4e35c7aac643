//! `estop [TRIES]`: the time from an e-stop's packet to all lines low, over so many tries (1000) of each kind.
//!
//! Exit 0 if the promises are kept. Takes minutes.

#![expect(clippy::unwrap_used, reason = "what cannot go on has failed")]

#[path = "../tests/estop.rs"]
mod estop;
#[path = "../tests/play.rs"]
mod play;
#[path = "../tests/random.rs"]
#[expect(dead_code, reason = "it is the tests', which use the rest of it")]
mod random;

use estop::{BY_FRAME, BY_FRAME_SHARED, BY_REQUEST, Channel, Traffic, sweep};
use std::process::ExitCode;
use std::thread;

fn main() -> ExitCode {
    let tries: u64 = std::env::args().nth(1).map_or(1000, |number| number.parse().unwrap());
    // A tenth of the tries with the frame behind a flood: from its packet on, the promise holds there, too.
    let kinds = [
        (Traffic::Shared, Channel::Frame, tries, BY_FRAME_SHARED),
        (Traffic::Quiet, Channel::Frame, tries, BY_FRAME),
        (Traffic::Shared, Channel::Request, tries, BY_REQUEST),
        (Traffic::Quiet, Channel::Request, tries, BY_REQUEST),
        (Traffic::Flood(120_000), Channel::Request, tries, BY_REQUEST),
        (Traffic::Flood(800_000), Channel::Request, tries, BY_REQUEST),
        (Traffic::Flood(120_000), Channel::Frame, tries.div_ceil(10), BY_FRAME_SHARED),
        (Traffic::Contrived, Channel::Frame, tries, BY_FRAME_SHARED),
        (Traffic::Flood(800_000), Channel::Frame, tries.div_ceil(10), BY_FRAME_SHARED),
    ];
    let mut kept = true;
    // Two at a time.
    for pair in kinds.chunks(2) {
        let runs = pair.iter().map(|&(traffic, way, tries, promise)| {
            thread::spawn(move || sweep("full-load", traffic, way, tries, 7) <= promise)
        });
        let runs: Vec<_> = runs.collect();
        for run in runs {
            kept &= run.join().unwrap_or(false);
        }
    }
    if kept { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
