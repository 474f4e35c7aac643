//! Bounds the lines of a kind: [`BURST`] at once, and [`PER_S`] a second. Omitted lines are counted, and a line reports their
//! number.
//!
//! A kind is a log statement in the program, together with the value of the field `kind`, if the event has one. Errors, and events
//! with the field `always`, are not bounded.
//!
//! Bounds: [`KINDS`].
//!
//! Invariant: nothing waits. A line that comes while another thread checks the bounds is written.

use std::collections::HashMap;
use std::fmt;
use std::mem;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use tracing::callsite::Identifier;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber, warn};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;

/// Lines of a kind at once: a busy hour of a lab.
const BURST: f64 = 200.0;
/// Lines of a kind per second: at most some 15 MB a day.
const PER_S: f64 = 1.0;
/// Kinds with a separate bound: far more than the program has. Further kinds share one.
const KINDS: usize = 1000;
/// How long lines are omitted before a line reports that.
const REPORT_AFTER: Duration = Duration::from_secs(10);
/// Characters shown of an example of the omitted lines.
const EXAMPLE: usize = 200;

/// A layer whose events are bounded.
pub(super) struct Limited<L> {
    inner: L,
    kinds: Arc<Kinds>,
}

impl<L> Limited<L> {
    pub(super) fn new(inner: L) -> Self {
        Self { inner, kinds: Arc::default() }
    }
}

impl<S: Subscriber, L: Layer<S>> Layer<S> for Limited<L> {
    fn on_event(&self, event: &Event<'_>, context: Context<'_, S>) {
        if *event.metadata().level() == Level::ERROR || self.kinds.takes(event, Instant::now()) {
            self.inner.on_event(event, context);
        }
    }
}

type Key = Option<(Identifier, String)>;

#[derive(Debug, Default)]
struct Kinds {
    kinds: Mutex<HashMap<Key, Kind>>,
    /// Whether a thread will report the omitted lines.
    reports: AtomicBool,
}

/// Lines of one kind.
#[derive(Debug)]
struct Kind {
    room: f64,
    at: Instant,
    left_out: u64,
    /// The first omitted line.
    example: String,
}

impl Kind {
    /// Whether there is room for one more.
    fn takes(&mut self, now: Instant) -> bool {
        let new = PER_S * now.saturating_duration_since(self.at).as_secs_f64();
        (self.room, self.at) = ((self.room + new).min(BURST), now);
        let takes = self.room >= 1.0;
        self.room -= if takes { 1.0 } else { 0.0 };
        self.left_out += u64::from(!takes);
        takes
    }
}

impl Kinds {
    fn takes(self: &Arc<Self>, event: &Event<'_>, now: Instant) -> bool {
        let mut seen = Seen::default();
        event.record(&mut seen);
        if seen.always {
            return true;
        }
        let Ok(mut kinds) = self.kinds.try_lock() else { return true };
        let own = Some((event.metadata().callsite(), seen.kind));
        let key = if kinds.len() < KINDS || kinds.contains_key(&own) { own } else { None };
        let new = || Kind { room: BURST, at: now, left_out: 0, example: String::new() };
        let kind = kinds.entry(key).or_insert_with(new);
        let takes = kind.takes(now);
        if kind.left_out == 1 && kind.example.is_empty() {
            let mut message = Message(String::new());
            event.record(&mut message);
            kind.example = message.0.chars().take(EXAMPLE).collect();
        }
        drop(kinds);
        if !takes && !self.reports.swap(true, Ordering::Relaxed) {
            let kinds = Arc::clone(self);
            let report = move || {
                thread::sleep(REPORT_AFTER);
                kinds.report();
            };
            // If no thread can start, the next omitted line tries again.
            let begun = thread::Builder::new().name("log".into()).spawn(report);
            self.reports.store(begun.is_ok(), Ordering::Relaxed);
        }
        takes
    }

    fn report(&self) {
        self.reports.store(false, Ordering::Relaxed);
        for (lines, example) in self.left_out() {
            warn!(always = true, "{lines} lines of the log were left out, of the kind: {example}");
        }
    }

    fn left_out(&self) -> Vec<(u64, String)> {
        let mut kinds = self.kinds.lock().unwrap_or_else(PoisonError::into_inner);
        let left_out = kinds.values_mut().filter(|kind| kind.left_out > 0);
        left_out.map(|kind| (mem::take(&mut kind.left_out), mem::take(&mut kind.example))).collect()
    }
}

/// The fields of an event that decide whether it is bounded.
#[derive(Default)]
struct Seen {
    always: bool,
    kind: String,
}

impl Visit for Seen {
    fn record_debug(&mut self, _: &Field, _: &dyn fmt::Debug) {}

    fn record_bool(&mut self, field: &Field, value: bool) {
        self.always |= value && field.name() == "always";
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        if field.name() == "kind" {
            value.clone_into(&mut self.kind);
        }
    }
}

/// The message of an event.
struct Message(String);

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "message" {
            self.0 = format!("{value:?}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tracing_subscriber::layer::SubscriberExt;

    /// Counts the lines that pass.
    #[derive(Clone, Default)]
    struct Passed(Arc<Mutex<HashMap<String, usize>>>);

    impl<S: Subscriber> Layer<S> for Passed {
        fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
            let mut message = Message(String::new());
            event.record(&mut message);
            *self.0.lock().unwrap().entry(message.0).or_default() += 1;
        }
    }

    #[test]
    fn a_flood_of_one_kind_is_bounded_and_counted_and_e_stops_and_errors_stay() {
        const FLOOD: usize = 20_000;
        let passed = Passed::default();
        let layer = Limited::new(passed.clone());
        let kinds = Arc::clone(&layer.kinds);
        // Keep the reporting thread out of this test.
        kinds.reports.store(true, Ordering::Relaxed);
        let begun = Instant::now();
        tracing::subscriber::with_default(tracing_subscriber::registry().with(layer), || {
            for _ in 0..FLOOD {
                tracing::info!(kind = "stop", "stop refused");
                tracing::error!("our bug");
                tracing::info!(always = true, "e-stop");
            }
            tracing::info!(kind = "arm", "arm refused");
            tracing::info!("another place");
        });
        let most = BURST as usize + begun.elapsed().as_secs() as usize + 1;
        let passed = passed.0.lock().unwrap().clone();
        let of = |line: &str| passed.get(line).copied().unwrap_or(0);
        assert_eq!((of("e-stop"), of("our bug")), (FLOOD, FLOOD));
        assert_eq!((of("arm refused"), of("another place")), (1, 1));
        assert!((BURST as usize..=most).contains(&of("stop refused")), "{passed:?}");
        let left_out = (FLOOD - of("stop refused")) as u64;
        assert_eq!(kinds.left_out(), [(left_out, "stop refused".to_owned())]);
        assert_eq!(kinds.left_out(), []);
    }

    #[test]
    fn room_comes_back_with_time() {
        let begun = Instant::now();
        let mut kind = Kind { room: BURST, at: begun, left_out: 0, example: String::new() };
        let taken = |kind: &mut Kind, at: u64| {
            (0..1000).filter(|_| kind.takes(begun + Duration::from_secs(at))).count()
        };
        assert_eq!([0, 5, 10_000].map(|at| taken(&mut kind, at)), [200, 5, 200]);
        assert_eq!(kind.left_out, 3 * 1000 - 405);
    }
}
