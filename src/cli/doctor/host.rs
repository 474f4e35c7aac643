//! The doctor's look at this machine: real-time rights, how late timers wake a thread, and how fast processors run.
//!
//! What is measured is measured alone: nothing else of the doctor runs beside it. Rights are this user's; a daemon's
//! own are asked of it, elsewhere.
//!
//! Invariant: what is asked for goes with the thread it was asked for.

use super::Finding;
use meissner_api::Realtime;
use meissner_stream::time::HostInstant;
use rustix::thread::{ClockId, Timespec, clock_nanosleep_absolute};
use serde::Serialize;
use std::fs;
use std::path::Path;
use std::thread;
use std::time::Duration;

/// MethodLabel often a thread is woken.
const PERIOD: Duration = Duration::from_millis(1);
/// Half the default lead: beyond it, a second stall in a row is late.
const LATE_US: f64 = 50_000.0;
const CPUS: &str = "sys/devices/system/cpu";
const FAST: &str = "performance";

/// What gives a user real-time rights, where no service manager does.
pub(super) const LIMITS: &str = "`printf '%s - rtprio 60\\n%s - memlock unlimited\\n' $USER $USER | sudo tee \
                                 /etc/security/limits.d/90-meissner.conf`, then log in again";

/// MethodLabel late timers woke a thread.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct WakeUp {
    p50_us: f64,
    p99_us: f64,
    p999_us: f64,
    max_us: f64,
    /// MethodLabel often it was woken.
    count: usize,
    /// Under SCHED_FIFO, as the streamer is.
    fifo: bool,
}

/// Which rights this user gets, and how late timers wake a thread that has them, on a thread of its own.
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
        sleep_until(wanted);
        late_us.push(HostInstant::now().since(wanted).as_secs_f64() * 1e6);
    }
    late_us
}

fn sleep_until(wanted: HostInstant) {
    let seconds = (wanted.as_ns() / 1_000_000_000).cast_signed();
    let time = Timespec { tv_sec: seconds, tv_nsec: (wanted.as_ns() % 1_000_000_000).cast_signed() };
    // Interrupted by a signal, it measures a wake-up that was early: 0.
    let _ = clock_nanosleep_absolute(ClockId::Monotonic, &time);
}

impl WakeUp {
    fn of(mut late_us: Vec<f64>, fifo: bool) -> Self {
        late_us.sort_by(f64::total_cmp);
        let last = late_us.len().saturating_sub(1);
        let at = |per_mille: usize| {
            late_us.get((late_us.len() * per_mille / 1000).min(last)).copied().unwrap_or(f64::NAN)
        };
        let count = late_us.len();
        Self { p50_us: at(500), p99_us: at(990), p999_us: at(999), max_us: at(1000), count, fifo }
    }
}

pub(super) fn timers(wake_up: &WakeUp) -> Finding {
    let WakeUp { p50_us, p99_us, p999_us, max_us, count, fifo } = wake_up;
    let with = if *fifo { "with" } else { "without" };
    let found = format!(
        "late by {p50_us:.0} us (p50), {p99_us:.0} (p99), {p999_us:.0} (p99.9), {max_us:.0} (max) of {count}, \
         {with} SCHED_FIFO"
    );
    if *max_us < LATE_US {
        return Finding::ok("timers", found);
    }
    let advice = if *fifo {
        "raise lead_ms above twice the worst, or use a machine with less beside it"
    } else {
        "`sudo meissner doctor` measures as a daemon with real-time rights would; if that is no better, raise \
         lead_ms above twice the worst"
    };
    Finding::warn("timers", found, advice)
}

/// This user's rights. They count for a daemon that this user may start: not where one runs, or is `installed`.
pub(super) fn rights(ours: Realtime, daemons: Option<Realtime>, installed: bool) -> [Finding; 2] {
    let finding = |what, ours, daemons| match (ours, daemons) {
        (true, _) => Finding::ok(what, "granted"),
        (false, Some(true)) => Finding::ok(what, "not granted to you, but to the daemon"),
        (false, Some(false)) => Finding::ok(what, "not granted to you; it is the daemon's that counts"),
        (false, None) if installed => {
            Finding::ok(what, "not granted to you; it is the service's that counts")
        }
        (false, None) => {
            let advice = format!("for a daemon of yours: {LIMITS}; without it strokes may come late");
            Finding::warn(what, "not granted", advice)
        }
    };
    [
        finding("SCHED_FIFO", ours.fifo, daemons.map(|of| of.fifo)),
        finding("mlockall", ours.mlock, daemons.map(|of| of.mlock)),
    ]
}

/// Whether processors slow down when they have little to do: then every wake-up begins slowly.
pub(super) fn governor(root: &Path) -> Finding {
    let cpus = fs::read_dir(root.join(CPUS)).into_iter().flatten().flatten();
    let is_cpu = |name: &str| {
        name.strip_prefix("cpu")
            .is_some_and(|number| !number.is_empty() && number.bytes().all(|c| c.is_ascii_digit()))
    };
    let governors = cpus.filter(|cpu| cpu.file_name().to_str().is_some_and(is_cpu));
    let governors =
        governors.filter_map(|cpu| fs::read_to_string(cpu.path().join("cpufreq/scaling_governor")).ok());
    let governors: Vec<String> = governors.map(|governor| governor.trim().to_owned()).collect();
    let slow: Vec<&String> = governors.iter().filter(|governor| *governor != FAST).collect();
    match slow.iter().min() {
        None if governors.is_empty() => Finding::ok("governor", "no frequency scaling here"),
        None => Finding::ok("governor", FAST),
        Some(name) => {
            let found = format!("`{name}` on {} of {} processors", slow.len(), governors.len());
            let advice = format!(
                "`echo {FAST} | sudo tee /{CPUS}/cpu*/cpufreq/scaling_governor`, until the next boot"
            );
            Finding::warn("governor", found, advice)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::fake;
    use super::*;

    #[test]
    fn processors_that_slow_down_are_told_of() {
        let dir = tempfile::tempdir().unwrap();
        let governor = || fake::line(&governor(dir.path()));
        assert_eq!(governor(), "Ok governor: no frequency scaling here -> ");
        let set = |cpu, text| {
            fake::write(dir.path(), &format!("{CPUS}/{cpu}/cpufreq/scaling_governor"), text);
        };
        set("cpu0", "performance\n");
        set("cpu11", "performance\n");
        set("cpufreq", "powersave\n");
        assert_eq!(governor(), "Ok governor: performance -> ");
        set("cpu11", "schedutil\n");
        assert_eq!(
            governor(),
            "Warn governor: `schedutil` on 1 of 2 processors -> `echo performance | sudo tee \
             /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor`, until the next boot"
        );
    }

    #[test]
    fn rights_count_for_a_daemon_of_ones_own() {
        let (none, all) = (Realtime::default(), Realtime { fifo: true, mlock: true });
        let lines = |ours, daemons, installed| rights(ours, daemons, installed).each_ref().map(fake::line);
        assert_eq!(lines(all, None, false)[0], "Ok SCHED_FIFO: granted -> ");
        assert_eq!(lines(none, Some(all), true)[1], "Ok mlockall: not granted to you, but to the daemon -> ");
        // What is wrong with the daemon's is told with the daemon.
        assert!(
            lines(none, Some(none), false)[0].starts_with("Ok SCHED_FIFO: not granted to you; it is the d")
        );
        assert!(
            lines(none, None, true)[0].starts_with("Ok SCHED_FIFO: not granted to you; it is the service's")
        );
        for line in lines(none, None, false) {
            assert!(
                line.starts_with("Warn ") && line.contains("rtprio 60\\n") && line.contains("log in again")
            );
        }
    }

    #[test]
    fn late_timers_are_told_of_with_what_they_were_measured_under() {
        let wake_up = WakeUp::of((1..=5000).map(f64::from).collect(), true);
        assert_eq!(
            fake::line(&timers(&wake_up)),
            "Ok timers: late by 2501 us (p50), 4951 (p99), 4996 (p99.9), 5000 (max) of 5000, with SCHED_FIFO -> "
        );
        let line = |fifo| fake::line(&timers(&WakeUp::of(vec![10.0, 60_000.0], fifo)));
        assert!(line(true).starts_with("Warn timers") && line(true).contains("-> raise lead_ms"));
        assert!(line(false).contains("without SCHED_FIFO -> `sudo meissner doctor`"));
        let (_, measured) = measure(Duration::from_millis(20));
        assert!(measured.count == 20 && measured.p50_us <= measured.max_us, "{measured:?}");
        assert!(WakeUp::of(Vec::new(), false).max_us.is_nan());
    }
}
