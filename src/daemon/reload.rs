//! A configuration that is read while the daemon runs: what of it is taken, from when on, and what is not.
//!
//! Patterns' directory and the logbook at once; the streamer's settings from the next `arm` on; the calibration is stored in its new
//! place from now on, and read there at the next connection.
//! The device, the socket and the mock stay what they are until the daemon is started again.
//!
//! Invariant: a configuration that would have been refused at the start changes nothing.

use super::engine::Engine;
use super::http::Shelf;
use super::service::{Manager, Word};
use super::{DaemonError, check, system};
use crate::config::{Config, Source};
use crate::session_record::Note;
use crossbeam_channel::{Sender, bounded};
use meissner_stream::Settings;
use std::sync::Arc;
use std::thread;
use std::time::Duration;
use tracing::{info, warn};

/// How long the logbook's old place may take for what it has still to write.
const TIMEOUT: Duration = Duration::from_secs(2);

/// Starts the thread on which configurations are read, as often as it is told to: it may wait for the disk for as long as that
/// takes, and nobody waits for it.
pub(super) fn spawn(
    source: Source,
    mut running: Config,
    engine: Arc<Engine>,
    shelf: Shelf,
    manager: Manager,
) -> Result<Sender<()>, DaemonError> {
    // One that waits is as good as two.
    let (again, told) = bounded(1);
    let work = move || {
        for () in told {
            manager.tell(Word::Reloading);
            reload(&source, &mut running, &engine, &shelf);
            manager.tell(Word::Ready);
        }
    };
    thread::Builder::new().name("reload".into()).spawn(work).map_err(system("thread"))?;
    Ok(again)
}

/// Reads the source and takes over what can be; `running` is what is gone by, before and after. Waits for the disk.
fn reload(source: &Source, running: &mut Config, engine: &Engine, shelf: &Shelf) {
    let mut taken = Vec::new();
    let problem = take(source, running, engine, shelf, &mut taken).err();
    if let Some(problem) = &problem {
        warn!("{problem}");
    }
    engine.lock().book.note(Note::Reloaded { changed: taken, problem });
}

/// Takes over what can be and says which; fails at the first thing that is wrong.
fn take(
    source: &Source,
    running: &mut Config,
    engine: &Engine,
    shelf: &Shelf,
    taken: &mut Vec<String>,
) -> Result<(), String> {
    const STAYS: &str = "the configuration stays as it was";
    let new = source.read().map_err(|error| format!("{error}; {STAYS}"))?;
    let file = source.file.as_ref().map_or_else(String::new, |file| format!("{}: ", file.display()));
    let store = check(&new).map_err(|error| format!("{file}{error}; {STAYS}"))?;
    if new.patterns != running.patterns {
        shelf.replace(store);
        running.patterns.clone_from(&new.patterns);
        taken.push("`patterns_dir` at once".to_owned());
    }
    if new.settings != running.settings {
        let busy = |_| "too many orders wait for the device: reload the configuration again".to_owned();
        engine.configure(new.settings).map_err(busy)?;
        running.settings = new.settings;
        let Settings { lead_ms, lease_ms, drift_warning_um, limits } = new.settings;
        taken.push(format!(
            "from the next `arm` on `lead_ms` = {lead_ms}, `lease_ms` = {lease_ms}, `drift_warning_um` = {drift_warning_um}, \
             `motor_pulses_per_s` = {}, `rail_pulses_per_s` = {}",
            limits.motor, limits.rail
        ));
    }
    if new.calibration != running.calibration {
        engine.keep_calibration_at(new.calibration.clone());
        running.calibration.clone_from(&new.calibration);
        taken.push("`calibration` for what is stored, and read at the next connection".to_owned());
    }
    if new.logbook != running.logbook {
        let (book, users) = (engine.lock().book.clone(), Arc::clone(&engine.names.users));
        let slow = |error| format!("`logbook_dir`: {error}: reload the configuration again");
        book.keep(new.logbook.clone(), users, TIMEOUT).map_err(slow)?;
        running.logbook.clone_from(&new.logbook);
        taken.push("`logbook_dir` and `logbook_days` at once".to_owned());
    }
    let fixed = [
        ("`device`", new.device != running.device),
        ("`socket`", new.socket != running.socket),
        ("[mock]", new.mock != running.mock),
    ];
    let fixed: Vec<&str> = fixed.iter().filter(|(_, changed)| *changed).map(|(key, _)| *key).collect();
    match (taken.is_empty(), fixed.is_empty()) {
        (true, true) => info!("the configuration says what it said before"),
        (false, _) => info!("the configuration was read again: {}", taken.join(", ")),
        _ => {}
    }
    if fixed.is_empty() {
        return Ok(());
    }
    Err(format!("{} cannot change while the daemon runs: restart it", fixed.join(", ")))
}

impl Engine {
    fn keep_calibration_at(&self, file: Option<std::path::PathBuf>) {
        self.lock().calibration_file = file;
    }
}
