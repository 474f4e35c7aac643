//! When the machine stood still, or had too much to do, as an ordinary thread and a byte in a pseudo-terminal see it.
//!
//! The kernel moves such bytes by a worker of ordinary priority, which may wait when no thread does.
//!
//! Invariant: it has the priority of the daemon's ordinary threads: what holds those up holds it up.

use meissner_stream::device::{Received, Terminal};
use meissner_stream::time::HostInstant;
use rustix::event::{PollFd, PollFlags, poll};
use std::fs::OpenOptions;
use std::io::Write;
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
        let terminal = Terminal::open().unwrap();
        let mut program = OpenOptions::new().read(true).write(true).open(terminal.path()).unwrap();
        let thread = thread::spawn(move || {
            while !of_thread.stop.load(Ordering::Relaxed) {
                let due = HostInstant::now() + PERIOD;
                thread::sleep(PERIOD);
                program.write_all(&[0]).unwrap();
                while !matches!(terminal.read(&mut [0; 16]), Received::Bytes(_)) {
                    poll(&mut [PollFd::new(&terminal, PollFlags::IN)], None).unwrap();
                }
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

    /// Waits until the machine has not stood still for longer than `most` during `calm`, but no longer than `longest`.
    pub(crate) fn wait_until_calm(&self, calm: Duration, most: Duration, longest: Duration) {
        let begun = HostInstant::now();
        loop {
            let since = HostInstant::now();
            thread::sleep(calm);
            if self.worst_since(since) <= most || HostInstant::now().since(begun) > longest {
                return;
            }
        }
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}
