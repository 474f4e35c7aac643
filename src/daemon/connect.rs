//! The connector: a thread that opens the device, hands it to the streamer, and opens it again when it is gone.
//!
//! Opening may block, and dropping what the streamer gives back may too, so both happen here and nowhere
//! else. It looks every second while there is no device and sleeps while there is one. A device that comes back
//! is disarmed: arming it again is a person's business.
//!
//! Invariant: at most one device is open.

use super::engine::Engine;
use crate::device::{self, Device, Spec};
use crate::plant::PlantConfig;
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use std::io;
use std::sync::Arc;
use std::thread;
use std::time::Duration;
use tracing::{info, warn};

/// How long after a failure it is tried again.
const RETRY: Duration = Duration::from_secs(1);

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
    thread::Builder::new().name("connector".into()).spawn(move || run(&spec, &plant, &engine, &words))?;
    Ok(sender)
}

fn run(spec: &Spec, plant: &PlantConfig, engine: &Engine, words: &Receiver<Word>) {
    let mut said = String::new();
    loop {
        match device::open(spec, plant) {
            Ok(device) => {
                said.clear();
                let kind = device.kind();
                if *spec == Spec::Auto && kind == "mock" {
                    warn!("no board was found: using the mock, no real pin moves; name one with --device");
                } else {
                    info!("opened {kind}");
                }
                match engine.connect(Box::new(device)) {
                    Ok(()) => match words.recv() {
                        Ok(Word::Gone(device)) => drop(device),
                        Ok(Word::Quit) | Err(_) => return,
                    },
                    Err(device) => drop(device),
                }
            }
            Err(error) => {
                // Once per reason: a board that is not plugged in is not news every second.
                let line = error.to_string();
                if line != said {
                    warn!("{line}; it is tried again every second");
                    said = line;
                }
            }
        }
        match words.recv_timeout(RETRY) {
            Ok(Word::Gone(device)) => drop(device),
            Err(RecvTimeoutError::Timeout) => {}
            Ok(Word::Quit) | Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}
