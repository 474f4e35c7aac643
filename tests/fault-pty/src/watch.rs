//! When the machine stood still, or had too much to do, as an ordinary thread sees it.
//!
//! Invariant: it has the priority of the daemon's ordinary threads: what holds those up holds it up.

use meissner_stream::time::HostInstant;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

const PERIOD: Duration = Duration::from_millis(5);

/// A running watch.
pub(crate) struct Watch {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    /// When it woke up too late, and by how much.
    late: Mutex<Vec<(HostInstant, Duration)>>,
}

impl Watch {
    pub(crate) fn start() -> Self {
        let shared = Arc::new(Shared::default());
        let of_thread = Arc::clone(&shared);
        let thread = thread::spawn(move || {
            while !of_thread.stop.load(Ordering::Relaxed) {
                let due = HostInstant::now() + PERIOD;
                thread::sleep(PERIOD);
                let late = HostInstant::now().since(due);
                if late > PERIOD {
                    of_thread.late.lock().unwrap().push((due, late));
                }
            }
        });
        Self { shared, thread: Some(thread) }
    }

    /// The longest time since then.
    pub(crate) fn worst_since(&self, begun: HostInstant) -> Duration {
        let late = self.shared.late.lock().unwrap();
        late.iter().filter(|(at, _)| *at >= begun).map(|(_, late)| *late).max().unwrap_or_default()
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}
