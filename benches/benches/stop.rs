//! How long a stop takes beside busy programs: `cargo bench -p meissner-benches --bench stop`.
//!
//! Emergency stops have a real-time thread of the daemon; `stop` and `disarm` wait for its other threads. This plays, stops, and prints the
//! time from the request to its answer, beside more and more busy loops: once with the niceness of the shell, once with that of
//! deploy/meissner.service, which needs root. `ROUNDS` [50] sets the stops per row. The client runs in real time where the system
//! allows it, so that it does not wait itself. It asserts nothing.

use meissner_api::{PlayAccepted, Status};
use meissner_benches::daemon::Daemon;
use meissner_stream::device::priority;
use rustix::process::setpriority_process;
use serde_json::json;
use std::error::Error;
use std::hint::black_box;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// `Nice` of the unit.
const UNIT: i32 = -10;
const LOOPS: [usize; 4] = [0, 2, 10, 40];

fn main() -> Result<(), Box<dyn Error>> {
    let rounds = std::env::var("ROUNDS").ok().map_or(Ok(50), |rounds| rounds.parse())?;
    println!(
        "{:>6} {:>6} {:>9} {:>9} {:>9}   ms from the request to the answer",
        "nice", "loops", "p50", "p90", "max"
    );
    for nice in [0, UNIT] {
        // A child begins with the niceness of the thread that starts it.
        setpriority_process(None, nice).map_err(|error| format!("nice {nice}: {error}"))?;
        let daemon = Daemon::start("")?;
        setpriority_process(None, 0)?;
        for loops in LOOPS {
            let mut took_ms = beside(loops, || {
                thread::scope(|scope| {
                    let measured = scope.spawn(|| {
                        let _ = priority::fifo(priority::FIFO_PRIORITY);
                        stops(&daemon, rounds).map_err(|error| error.to_string())
                    });
                    measured.join().map_err(|_| "the measuring thread panicked".to_owned())?
                })
            })?;
            took_ms.sort_by(f64::total_cmp);
            let at = |part: f64| took_ms[((took_ms.len() - 1) as f64 * part) as usize];
            println!("{nice:>6} {loops:>6} {:>9.2} {:>9.2} {:>9.2}", at(0.5), at(0.9), at(1.0));
        }
    }
    Ok(())
}

/// Does something while so many loops keep the processors busy.
fn beside<T>(loops: usize, work: impl FnOnce() -> T) -> T {
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        for _ in 0..loops {
            scope.spawn(|| {
                while !over.load(Ordering::Relaxed) {
                    black_box(());
                }
            });
        }
        let done = work();
        over.store(true, Ordering::Relaxed);
        done
    })
}

fn stops(daemon: &Daemon, rounds: usize) -> Result<Vec<f64>, Box<dyn Error>> {
    let mut client = daemon.client()?;
    client.post::<Status>("/v1/arm", &json!({"assume_rest": true, "checked": "a benchmark"}))?;
    (0..rounds)
        .map(|round| {
            client.post::<PlayAccepted>("/v1/play", &json!({"pattern": "edge-45", "seconds": 5.0}))?;
            thread::sleep(Duration::from_millis(200 + round as u64 * 37 % 100));
            let asked = Instant::now();
            client.post::<Status>("/v1/stop", &json!({}))?;
            Ok(asked.elapsed().as_secs_f64() * 1e3)
        })
        .collect()
}
