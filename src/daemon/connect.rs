//! The connector: a thread that opens the device, hands it to the streamer, and opens it again when it is gone.
//!
//! Opening may block, and dropping what the streamer gives back may too, so both happen here and nowhere
//! else. While there is no device it looks four times a second, and at once when a board is plugged in, where the
//! system tells; it sleeps while there is one. A device that comes back is disarmed: arming it again is a person's
//! business. What was found by `auto` stays what it is: a board that was pulled out is waited for. A mock that is in use because
//! there was no board gives way to one, as after a boot that was faster than the bus, until somebody has armed it; from then on it
//! stays, or what a person takes for a simulation would move pins.
//!
//! Invariant: at most one board is open; the old one is closed before the next is looked for.

use super::engine::Engine;
use crossbeam_channel::{Receiver, RecvError, Sender, bounded, never, select};
use meissner_array::simulated::PlantConfig;
use meissner_stream::device::{self, Device, Spec};
use std::io;
use std::sync::Arc;
use std::thread;
use std::time::Duration;
use tracing::{debug, info, warn};

/// How often it looks while there is no device.
const LOOK_EVERY: Duration = Duration::from_millis(250);
/// So long after it was plugged in a board has its names and rights.
const SETTLED: Duration = Duration::from_millis(500);

/// How often it is tried to open one for the mock's place: at boot that may take seconds.
const TRIES: usize = 10;

/// What the connector is told.
#[derive(Debug)]
pub(super) enum Word {
    /// The device is gone; what is left of it.
    Gone(Option<Box<Device>>),
    /// The daemon ends.
    Quit,
}

/// Starts the connector. The daemon does not wait for its end: it may be stuck in the system.
pub(super) fn spawn(spec: Spec, plant: PlantConfig, engine: Arc<Engine>) -> io::Result<Sender<Word>> {
    let (sender, words) = bounded(4);
    engine.hire(sender.clone());
    let connector =
        Connector { spec, plant, engine, words, plugged: never(), said: None, opened: String::new() };
    thread::Builder::new().name("connector".into()).spawn(move || connector.run())?;
    Ok(sender)
}

struct Connector {
    spec: Spec,
    plant: PlantConfig,
    engine: Arc<Engine>,
    words: Receiver<Word>,
    /// Something with a board's ids was plugged in.
    plugged: Receiver<()>,
    /// Why nothing could be opened the last time, and whether that was said.
    said: Option<(String, bool)>,
    /// What was opened last.
    opened: String,
}

impl Connector {
    fn run(mut self) {
        self.watch();
        loop {
            let gone = match device::open(&self.spec, &self.plant) {
                Ok(device) => {
                    self.found(&device);
                    match self.engine.connect(Box::new(device)) {
                        Ok(()) => self.sleep(),
                        Err(device) => Some(Word::Gone(Some(device))),
                    }
                }
                Err(error) => {
                    self.failed(error.to_string());
                    None
                }
            };
            match gone {
                Some(Word::Quit) => return,
                // Closed before it is looked for again: its name would be taken.
                Some(Word::Gone(device)) => drop(device),
                None => {}
            }
            select! {
                recv(self.words) -> word => match word {
                    Ok(Word::Gone(device)) => drop(device),
                    Ok(Word::Quit) | Err(_) => return,
                },
                recv(self.plugged) -> news => {
                    self.heard(news);
                }
                default(LOOK_EVERY) => {}
            }
        }
    }

    /// Has arrivals of boards told, if a board may come.
    fn watch(&mut self) {
        let Some(wanted) = self.spec.board() else { return };
        let (tell, plugged) = bounded(1);
        let arrived = move || {
            // One that waits to be read is as good as two.
            let _ = tell.try_send(());
        };
        if device::watch(&wanted, arrived).unwrap_or(false) {
            self.plugged = plugged;
        }
    }

    /// Whether something was plugged in. From a watch that has ended nothing is heard any more, or it would always be
    /// ready.
    fn heard(&mut self, news: Result<(), RecvError>) -> bool {
        if news.is_err() {
            debug!("the system tells of no arrivals any more");
            self.plugged = never();
            return false;
        }
        debug!("something was plugged in");
        true
    }

    fn found(&mut self, device: &Device) {
        self.said = None;
        let kind = device.kind();
        if kind != self.opened {
            match (&self.spec, device) {
                (Spec::Auto, Device::Mock(_)) => {
                    warn!("no board was found: using the mock, no real pin moves; name one with --device");
                }
                _ => info!("opened {kind}"),
            }
        }
        if self.spec == Spec::Auto {
            self.spec = if matches!(device, Device::Mock(_)) { Spec::Mock } else { Spec::Board };
        }
        self.opened = kind;
    }

    /// Says why there is no device, once per reason, and not before it has lasted: a board that has just been plugged
    /// in gets its rights a moment later.
    fn failed(&mut self, line: String) {
        self.engine.miss(&line);
        match &mut self.said {
            Some((before, said)) if *before == line => {
                if !std::mem::replace(said, true) {
                    warn!("{line}; looking every {} s", LOOK_EVERY.as_secs_f64());
                }
            }
            _ => self.said = Some((line, false)),
        }
    }

    /// Waits until the device is gone or the daemon ends, and lets a board take the mock's place.
    fn sleep(&mut self) -> Option<Word> {
        loop {
            select! {
                recv(self.words) -> word => match word.unwrap_or(Word::Quit) {
                    Word::Gone(Some(device)) if self.has_given_way(&device) => drop(device),
                    word => return Some(word),
                },
                recv(self.plugged) -> news => {
                    let mock = self.heard(news) && self.spec == Spec::Mock;
                    let Some(board) = Spec::Board.board().filter(|_| mock) else { continue };
                    thread::sleep(SETTLED);
                    if device::is_plugged(&board) {
                        self.replace_mock();
                    }
                }
            }
        }
    }

    /// Whether it is the mock that a board has replaced.
    fn has_given_way(&self, device: &Device) -> bool {
        matches!(device, Device::Mock(_)) && self.spec == Spec::Board
    }

    fn replace_mock(&mut self) {
        let mut why_not = String::new();
        for _ in 0..TRIES {
            if self.engine.was_armed() {
                "it has been armed".clone_into(&mut why_not);
                break;
            }
            match device::open(&Spec::Board, &self.plant) {
                Ok(device) => {
                    let kind = device.kind();
                    if self.engine.replace_mock(Box::new(device)).is_ok() {
                        info!("opened {kind}, in the mock's place");
                        (self.spec, self.opened) = (Spec::Board, kind);
                        return;
                    }
                    "too many orders wait".clone_into(&mut why_not);
                }
                Err(error) => why_not = error.to_string(),
            }
            thread::sleep(SETTLED);
        }
        warn!(
            "a board was plugged in, the mock stays in use ({why_not}): restart the daemon to use the board"
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crossbeam_channel::TryRecvError;
    use meissner_stream::Settings;
    use meissner_stream::queues::queues;

    #[test]
    fn a_watch_that_has_ended_is_not_heard_any_more() {
        let (_port, orders, _notices) = queues().unwrap();
        let spec = Spec::Serial("/nonexistent/tty".into());
        let engine = Arc::new(Engine::new(orders, Settings::default(), spec.to_string(), None));
        let ((tell, plugged), (word, words)) = (bounded(1), bounded(4));
        let mut connector = Connector {
            spec,
            plant: PlantConfig::default(),
            engine,
            words,
            plugged,
            said: None,
            opened: String::new(),
        };
        tell.send(()).unwrap();
        let news = connector.plugged.recv();
        assert!(connector.heard(news));
        drop(tell);
        let news = connector.plugged.recv();
        assert!(!connector.heard(news));
        assert_eq!(connector.plugged.try_recv(), Err(TryRecvError::Empty));
        word.send(Word::Gone(None)).unwrap();
        assert!(matches!(connector.sleep(), Some(Word::Gone(None))));
    }
}
