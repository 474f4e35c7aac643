//! The service manager that started the daemon, if one did: it hears when the daemon is ready, how it stands, and that it lives.
//!
//! That it lives is the streamer's word: its thread has to come round between two looks. The runtime's thread passes that on, so
//! the daemon is also restarted if that one hangs; a slow client, disk or log keeps neither from its turn. All words leave by a
//! thread of their own: a manager that hangs must not control up an emergency stop.
//!
//! Invariant: no sign of life without a new turn of the streamer.

use super::engine::Engine;
use crossbeam_channel::{Receiver, Sender, bounded};
use sd_notify::NotifyState;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;
use tracing::warn;

/// Words that wait. A manager that takes none is told no more; signs of life leave half of the room to the others.
const WORDS: usize = 64;
/// Looks per watchdog interval: a turn may be seen one look late, and a sign of life may wait for the machine.
const LOOKS: u32 = 4;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Word {
    Ready,
    Reloading,
    /// The one that waits beside.
    Status,
    Alive,
    Stopping,
}

/// The manager, or nobody.
#[derive(Clone, Debug)]
pub(super) struct Manager(Option<Line>);

#[derive(Clone, Debug)]
struct Line {
    words: Sender<Word>,
    /// The newest status, if it waits: one that is older is of no use to anybody.
    status: Arc<Mutex<Option<String>>>,
}

impl Manager {
    /// The one this process was started by.
    pub(super) fn find() -> io::Result<Self> {
        if std::env::var_os("NOTIFY_SOCKET").is_none() {
            return Ok(Self(None));
        }
        let (sender, words) = bounded(WORDS);
        let status = Arc::new(Mutex::new(None));
        let line = Line { words: sender, status: Arc::clone(&status) };
        thread::Builder::new().name("manager".into()).spawn(move || pass_on(&words, &status))?;
        Ok(Self(Some(line)))
    }

    pub(super) const fn is_there(&self) -> bool {
        self.0.is_some()
    }

    /// Whether it will be told.
    pub(super) fn tell(&self, word: Word) -> bool {
        let Some(Line { words, .. }) = &self.0 else { return false };
        (word != Word::Alive || words.len() < WORDS / 2) && words.try_send(word).is_ok()
    }

    fn tell_status(&self, text: String) {
        let Some(Line { status, .. }) = &self.0 else { return };
        let mut status = status.lock().unwrap_or_else(PoisonError::into_inner);
        let waits = status.is_some();
        // One that finds no room waits for the next that is told.
        *status = (waits || self.tell(Word::Status)).then_some(text);
    }
}

/// Tells the manager how everything stands, when that has changed.
#[derive(Debug)]
pub(super) struct Teller {
    manager: Manager,
    said: String,
}

impl Teller {
    pub(super) const fn new(manager: Manager) -> Self {
        Self { manager, said: String::new() }
    }

    /// Something has changed: the manager may have to hear of it, or to start a newer program, if nobody misses this one for a moment.
    pub(super) fn look(&mut self, engine: &Engine) {
        if !self.manager.is_there() {
            return;
        }
        // A line of its protocol ends a value.
        let line = engine.line().replace(char::is_control, " ");
        if line != self.said {
            self.said.clone_from(&line);
            self.manager.tell_status(line);
        }
        if engine.is_spare() && is_replaced() {
            engine.make_way();
        }
    }
}

fn pass_on(words: &Receiver<Word>, status: &Mutex<Option<String>>) {
    let mut deaf = false;
    for word in words {
        let told = match &word {
            Word::Ready => sd_notify::notify(&[NotifyState::Ready]),
            Word::Reloading => NotifyState::monotonic_usec_now()
                .and_then(|now| sd_notify::notify(&[NotifyState::Reloading, now])),
            Word::Status => {
                let text = status.lock().unwrap_or_else(PoisonError::into_inner).take().unwrap_or_default();
                sd_notify::notify(&[NotifyState::Status(&text)])
            }
            Word::Alive => sd_notify::notify(&[NotifyState::Watchdog]),
            Word::Stopping => sd_notify::notify(&[NotifyState::Stopping]),
        };
        if let Err(error) = told
            && !std::mem::replace(&mut deaf, true)
        {
            warn!("the service manager cannot be told anything: {error}; see NotifyAccess= in the unit");
        }
    }
}

/// Gives a sign of life for each new turn of the streamer, as often as the manager wants it.
pub(super) async fn watchdog(manager: Manager, engine: Arc<Engine>) {
    match sd_notify::watchdog_enabled() {
        Some(interval) if manager.is_there() => watch(manager, engine, interval / LOOKS).await,
        _ => std::future::pending().await,
    }
}

async fn watch(manager: Manager, engine: Arc<Engine>, every: Duration) {
    let mut seen = engine.turns();
    loop {
        // An idle streamer sleeps: it is woken for a turn.
        engine.nudge();
        tokio::time::sleep(every).await;
        let turns = engine.turns();
        if std::mem::replace(&mut seen, turns) != turns {
            manager.tell(Word::Alive);
        }
    }
}

/// Whether another file is installed now where this process was started from.
fn is_replaced() -> bool {
    let program = std::fs::read_link("/proc/self/exe");
    program.is_ok_and(|program| program.as_os_str().as_encoded_bytes().ends_with(b" (deleted)"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_stream::Settings;
    use meissner_stream::queues::queues;

    #[test]
    fn there_is_no_sign_of_life_without_a_turn_of_the_streamer() {
        let (port, orders, _notices) = queues().unwrap();
        let engine = Arc::new(Engine::new(orders, Settings::default(), "mock".to_owned(), None));
        let (sender, words) = bounded(WORDS);
        let runtime = crate::daemon::runtime().unwrap();
        runtime.block_on(async {
            let every = Duration::from_millis(2);
            let line = Line { words: sender, status: Arc::default() };
            let watching = tokio::spawn(watch(Manager(Some(line)), engine, every));
            tokio::time::sleep(every * 20).await;
            assert!(words.is_empty(), "the streamer stood still");
            port.clear_wake();
            port.count_loop();
            while words.is_empty() {
                tokio::time::sleep(every).await;
            }
            assert_eq!(words.try_recv(), Ok(Word::Alive));
            tokio::time::sleep(every * 20).await;
            assert!(words.is_empty(), "it stood still again");
            watching.abort();
        });
    }
}
