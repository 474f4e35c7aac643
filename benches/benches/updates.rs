//! How soon updates of a live play reach the pins: `cargo bench -p meissner-benches --bench updates`.
//!
//! A client on the socket of a daemon on the simulated array drives all motors at 60 Hz. It sends `UPDATES` updates [10 000] at
//! 100 per second, each with another amplitude for every motor: once on an idle machine, once beside four busy loops. Then it moves
//! a pressed edge at 30 mm/s and turns it at 90 degrees/s, 50 poses per second. It prints the times of the receipt, by
//! the device's clock: from the message to the tick from which strokes are replaced, and to the first motor's first new stroke. It
//! also prints late strokes and the daemon's memory. It asserts nothing.

use meissner_api::{LiveAccepted, LiveAnswer, LiveRecord, Receipt, Status, UpdateTimes};
use meissner_benches::daemon::Daemon;
use meissner_test_support::paper::MOTORS;
use serde_json::{Value, json};
use std::error::Error;
use std::hint::black_box;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Poses of an edge: ten seconds.
const POSES: u64 = 500;

type Done<T = ()> = Result<T, Box<dyn Error>>;

fn main() -> Done {
    let daemon = Daemon::start("")?;
    daemon.client()?.post::<Status>("/v1/arm", &json!({"assume_rest": true}))?;
    let updates = std::env::var("UPDATES").ok().map_or(Ok(10_000), |updates| updates.parse())?;
    for loops in [0, 4] {
        let over = Arc::new(AtomicBool::new(false));
        let busy: Vec<_> = (0..loops)
            .map(|_| {
                let over = Arc::clone(&over);
                thread::spawn(move || {
                    while !over.load(Ordering::Relaxed) {
                        for number in 0..10_000_u64 {
                            black_box(number);
                        }
                    }
                })
            })
            .collect();
        let drives = |number: u64| -> Vec<Value> {
            let um = |motor: u64| 40.0 + ((number * 7 + motor * 13) % 400) as f64 / 10.0;
            (0..MOTORS as u64)
                .map(|motor| json!({"motor": motor, "frequency_hz": 60, "amplitude_um": um(motor)}))
                .collect()
        };
        let start = json!({"drives": drives(0), "updates_hz": 100, "timeout_ms": 5000});
        let message = |number: u64| json!({"seq": number, "drives": drives(number)});
        play(&daemon, &format!("{loops} busy loops, drives"), &start, updates, 100.0, message)?;
        over.store(true, Ordering::Relaxed);
        busy.into_iter().for_each(|thread| drop(thread.join()));
    }
    let start = json!({"object": "edge-45", "timeout_ms": 5000});
    let message = |number: u64| {
        let s = number as f64 / 50.0;
        // To and fro over 12 mm.
        let way = (30.0 * s) % 24.0;
        json!({"seq": number, "pose": {"x_mm": (way - 12.0).abs() - 6.0, "angle_deg": 90.0 * s}})
    };
    play(&daemon, "an edge", &start, POSES, 50.0, message)?;
    let [now, peak] = daemon.memory_mb()?;
    println!("memory of the daemon: {now} MB, {peak} MB at most");
    Ok(())
}

/// Plays and updates at this rate; prints the receipt.
fn play(
    daemon: &Daemon,
    what: &str,
    start: &Value,
    updates: u64,
    rate_hz: f64,
    message: impl Fn(u64) -> Value,
) -> Done {
    let mut client = daemon.client()?;
    let LiveAccepted { id, path } = client.post("/v1/live", start)?;
    let mut to = UnixStream::connect(daemon.socket())?;
    write!(to, "GET {path} HTTP/1.1\r\nhost: x\r\nconnection: upgrade\r\nupgrade: meissner-live\r\n\r\n")?;
    let from = BufReader::new(to.try_clone()?);
    let reader = thread::spawn(move || -> Result<u64, String> {
        let mut answers = 0;
        for line in from.lines().skip_while(|line| line.as_ref().is_ok_and(|line| !line.is_empty())).skip(1) {
            let line = line.map_err(|error| error.to_string())?;
            let answer: LiveAnswer = serde_json::from_str(&line).map_err(|error| error.to_string())?;
            if let Some(problem) = answer.problem {
                return Err(problem.to_string());
            }
            answers += 1;
        }
        Ok(answers)
    });
    let begun = Instant::now();
    for number in 1..=updates {
        let due = Duration::from_secs_f64(number as f64 / rate_hz);
        thread::sleep(due.saturating_sub(begun.elapsed()));
        to.write_all(format!("{}\n", message(number)).as_bytes())?;
    }
    thread::sleep(Duration::from_millis(300));
    to.write_all(format!("{}\n", json!({"seq": updates + 1, "end": true})).as_bytes())?;
    reader.join().map_err(|_| "the reader panicked")??;
    let receipt: Receipt = client.get(&format!("/v1/plays/{id}?wait=10"))?;
    let (Some(live), Some(bursts)) = (receipt.live, receipt.bursts) else { return Err("no receipt".into()) };
    let LiveRecord { updates, applied, merged, repeats, decided, first_motor, last_motor, .. } = live;
    let times = |times: Option<UpdateTimes>| {
        times.map_or_else(String::new, |UpdateTimes { p50_ms, p99_ms, longest_ms }| {
            format!("p50 {p50_ms:.1}, p99 {p99_ms:.1}, longest {longest_ms:.1} ms")
        })
    };
    println!(
        "{what}: {updates} updates at {rate_hz} Hz, {applied} applied, {merged} merged, {repeats} sent again; {} of {} bursts late, {} \
         replaced",
        bursts.late, bursts.planned, bursts.replaced
    );
    println!("  decided: {}", times(decided));
    println!("  first motor's new stroke: {}", times(first_motor));
    println!("  last motor's new stroke: {}", times(last_motor));
    Ok(())
}
