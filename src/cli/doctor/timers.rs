//! Checks this machine's timers: how late they wake a thread.
//!
//! [`measure`] runs first and alone, so that no other check disturbs it.
//!
//! Invariant: the real-time rights that [`measure`] requests end with its thread.

use meissner_api::{Finding, Realtime};
use meissner_stream::diagnostics::quantile;
use meissner_stream::time::HostInstant;
use serde::Serialize;
use std::thread;
use std::time::Duration;

/// How often the thread is due: as often as the streamer while it plays.
const PERIOD: Duration = Duration::from_millis(1);
/// Half the default lead: after a longer stall, a second one makes strokes late.
const LATE_US: f64 = 50_000.0;

/// How late timers woke a thread.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct WakeUp {
    p50_us: f64,
    p99_us: f64,
    p999_us: f64,
    max_us: f64,
    /// How often they woke it.
    count: usize,
    /// Whether the thread ran under SCHED_FIFO, as the streamer does.
    fifo: bool,
}

/// Requests real-time rights on a separate thread; returns those granted, and how late timers then wake that thread.
pub(super) fn measure(time: Duration) -> (Realtime, WakeUp) {
    let measured = thread::spawn(move || {
        let realtime = meissner_stream::request_realtime();
        (realtime, WakeUp::of(lateness_us(time), realtime.fifo))
    });
    measured.join().unwrap_or_else(|_| (Realtime::default(), WakeUp::of(Vec::new(), false)))
}

fn lateness_us(time: Duration) -> Vec<f64> {
    let wake_ups = (time.as_secs_f64() / PERIOD.as_secs_f64()).round() as u32;
    let mut late_us = Vec::with_capacity(wake_ups as usize);
    let begun = HostInstant::now();
    for count in 1..=wake_ups {
        let wanted = begun + PERIOD * count;
        wanted.sleep_until();
        late_us.push(HostInstant::now().since(wanted).as_secs_f64() * 1e6);
    }
    late_us
}

impl WakeUp {
    fn of(mut late_us: Vec<f64>, fifo: bool) -> Self {
        late_us.sort_by(f64::total_cmp);
        let at = |per_mille| quantile(&late_us, per_mille);
        let count = late_us.len();
        Self { p50_us: at(500), p99_us: at(990), p999_us: at(999), max_us: at(1000), count, fifo }
    }
}

pub(super) fn finding(wake_up: &WakeUp) -> Finding {
    let WakeUp { p50_us, p99_us, p999_us, max_us, count, fifo } = wake_up;
    let with = if *fifo { "with" } else { "without" };
    let found = format!(
        "wake-ups came late by {p50_us:.0} us (p50), {p99_us:.0} (p99), {p999_us:.0} (p99.9), {max_us:.0} (max) of {count}, \
         {with} SCHED_FIFO"
    );
    if *max_us < LATE_US {
        return Finding::ok("timers", found);
    }
    let advice = if *fifo {
        "raise lead_ms above twice the longest, or run less on this machine"
    } else {
        "run `sudo meissner doctor`, which measures with real-time rights, as a daemon may have them; if that is no \
         better, raise lead_ms above twice the longest"
    };
    Finding::warn("timers", found, advice)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::fake;

    #[test]
    fn late_timers_are_reported_with_the_scheduler_they_ran_under() {
        let wake_up = WakeUp::of((1..=5000).map(f64::from).collect(), true);
        assert_eq!(
            fake::line(&finding(&wake_up)),
            "Ok timers: wake-ups came late by 2501 us (p50), 4951 (p99), 4996 (p99.9), 5000 (max) of 5000, with SCHED_FIFO -> "
        );
        let line = |fifo| fake::line(&finding(&WakeUp::of(vec![10.0, 60_000.0], fifo)));
        assert!(line(true).starts_with("Warn timers") && line(true).contains("-> raise lead_ms"));
        assert!(line(false).contains("without SCHED_FIFO -> run `sudo meissner doctor`"));
        let (_, measured) = measure(Duration::from_millis(20));
        assert!(measured.count == 20 && measured.p50_us <= measured.max_us, "{measured:?}");
        assert!(WakeUp::of(Vec::new(), false).max_us.is_nan());
    }
}
