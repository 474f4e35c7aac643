//! Records how late this machine wakes a thread that is due every millisecond, as the streamer's is while it plays.
//!
//! `cargo run --release --example record_stalls -- 60 > FILE` records for a minute; `lead --trace FILE` of `meissner-research`
//! reads the recording (`research/src/lead/trace.rs` describes its lines).
//!
//! The thread requests SCHED_FIFO and locked memory as the streamer does. In the second half of the time two busy loops per
//! core run beside it. Only wake-ups more than [`MIN_LATE_US`] late are written.

use meissner_stream::request_realtime;
use meissner_stream::time::HostInstant;
use std::error::Error;
use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use std::{env, fs, hint, io, thread};

/// How often the thread is due: as often as the streamer while it plays.
const PERIOD: Duration = Duration::from_millis(1);
/// Wake-ups that are later than this are written.
const MIN_LATE_US: u64 = 200;
const MOST_S: u64 = 3600;

/// When a wake-up was due, and how much later it came, us.
type Late = (u64, u64);

fn main() -> Result<(), Box<dyn Error>> {
    let asked = env::args().nth(1).and_then(|text| text.parse().ok());
    let seconds = asked
        .filter(|seconds| (2..=MOST_S).contains(seconds))
        .ok_or_else(|| format!("name how long to record: a whole number of seconds, 2 to {MOST_S}"))?;
    let cores = thread::available_parallelism()?.get();
    let over = AtomicBool::new(false);
    let (realtime, late) = thread::scope(|scope| {
        let recorder = scope.spawn(|| (request_realtime(), record(Duration::from_secs(seconds))));
        thread::sleep(Duration::from_secs(seconds) / 2);
        for _ in 0..2 * cores {
            scope.spawn(|| {
                while !over.load(Ordering::Relaxed) {
                    hint::spin_loop();
                }
            });
        }
        let recorded = recorder.join();
        over.store(true, Ordering::Relaxed);
        recorded.map_err(|_| "the recording thread panicked")
    })?;
    let kernel = fs::read_to_string("/proc/sys/kernel/osrelease")?;
    let yes = |granted| if granted { "yes" } else { "no" };
    let mut out = io::stdout().lock();
    writeln!(
        out,
        "# How late a thread woke up that was due every millisecond: `cargo run --release --example record_stalls -- \
         {seconds}`.\n\
         # Each line: when it was due, us since the start, and by how much later it came, us; left out where at most \
         {MIN_LATE_US}.\n\
         # SCHED_FIFO {}, memory locked {}; {cores} cores, Linux {}; the second half beside {} busy loops.\n\
         seconds {seconds}",
        yes(realtime.fifo),
        yes(realtime.mlock),
        kernel.trim(),
        2 * cores,
    )?;
    for (due_us, late_us) in late {
        writeln!(out, "{due_us} {late_us}")?;
    }
    Ok(out.flush()?)
}

fn record(length: Duration) -> Vec<Late> {
    // Room for every wake-up; memory that is not used is not touched.
    let mut late = Vec::with_capacity((length.as_micros() / PERIOD.as_micros()) as usize);
    let begun = HostInstant::now();
    let mut due = Duration::ZERO;
    loop {
        due += PERIOD;
        if due > length {
            return late;
        }
        // A signal ends a sleep early: then sleep on.
        while HostInstant::now() < begun + due {
            (begun + due).sleep_until();
        }
        let came = HostInstant::now().since(begun);
        let by_us = (came - due).as_micros() as u64;
        if by_us > MIN_LATE_US {
            late.push((due.as_micros() as u64, by_us));
        }
        // Skip the wake-ups that were missed meanwhile.
        due += PERIOD * ((came - due).as_micros() / PERIOD.as_micros()) as u32;
    }
}
