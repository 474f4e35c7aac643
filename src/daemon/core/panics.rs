//! Handles panics, which our bugs cause, or a system that refuses memory or a thread.
//!
//! A panic of a connection's task ends that connection. A panic of the daemon's own work, or of a thread that the daemon needs,
//! ends the daemon as a signal does, with exit 1: a daemon without one of its parts would be worse. The streamer and the
//! thread for emergency stops are watched by [`Daemon::run`](crate::daemon::Daemon::run).

use std::future::{Future, poll_fn};
use std::panic::{self, AssertUnwindSafe};
use std::pin::pin;
use std::task::Poll;
use std::thread;
use tokio::sync::Notify;

/// The threads that the daemon needs.
const NEEDED: [&str; 7] =
    ["session record", "connector", "renderer", "usb-in", "usb-out", "usb-estop", "usb-watch"];

/// A needed thread panicked.
static PANICKED: Notify = Notify::const_new();

/// A panic ended the work. Its message was printed already.
#[derive(Debug, PartialEq, Eq)]
pub(in crate::daemon) struct Panicked;

/// Ends the daemon of this process when one of its needed threads panics.
pub fn end_on_panic() {
    let print = panic::take_hook();
    panic::set_hook(Box::new(move |info| {
        print(info);
        if thread::current().name().is_some_and(|name| NEEDED.contains(&name)) {
            PANICKED.notify_one();
        }
    }));
}

/// Resolves when a needed thread has panicked.
pub(in crate::daemon) async fn of_needed_thread() {
    PANICKED.notified().await;
}

/// Runs work, and returns an error if it panics.
pub(in crate::daemon) async fn caught<T>(work: impl Future<Output = T>) -> Result<T, Panicked> {
    let mut work = pin!(work);
    poll_fn(|context| {
        // The future is not polled again after a panic.
        match panic::catch_unwind(AssertUnwindSafe(|| work.as_mut().poll(context))) {
            Ok(Poll::Pending) => Poll::Pending,
            Ok(Poll::Ready(value)) => Poll::Ready(Ok(value)),
            Err(_) => Poll::Ready(Err(Panicked)),
        }
    })
    .await
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::core::runtime::runtime;
    use std::time::Duration;

    #[test]
    fn a_panic_of_the_work_or_of_a_needed_thread_is_told() {
        end_on_panic();
        let runtime = runtime().unwrap();
        runtime.block_on(async {
            assert_eq!(caught(async { 3 }).await, Ok(3));
            let fails = async {
                tokio::task::yield_now().await;
                panic!("as if the system gave no memory");
            };
            assert_eq!(caught(fails).await, Err::<(), _>(Panicked));
            let panics = |name: &str| {
                let thread = thread::Builder::new().name(name.to_owned()).spawn(|| panic!("as a bug does"));
                assert!(thread.unwrap().join().is_err());
            };
            panics("names");
            let wait = Duration::from_millis(20);
            assert!(tokio::time::timeout(wait, of_needed_thread()).await.is_err(), "it is not needed");
            panics("connector");
            of_needed_thread().await;
        });
    }
}
