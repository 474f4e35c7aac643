//! Reloads the configuration while the daemon runs.
//!
//! - The patterns' directory, the participant's limits and the session record change at once.
//! - The streamer's settings change at the next `arm`.
//! - A calibration is stored in its new place at once, and read there at the next connection.
//! - The device, the sockets, the file of the tokens and the mock change when the daemon is restarted.
//!
//! Invariant: a configuration that the daemon would refuse at its start changes nothing.

use crate::config::{Config, Source};
use crate::daemon::beside::service::{Manager, Notification};
use crate::daemon::engine::Engine;
use crate::daemon::engine::patterns::SharedStore;
use crate::daemon::system::check::check;
use crate::daemon::system::error::{DaemonError, system};
use crate::daemon::system::sums;
use crate::exposure::Now;
use crate::session_record::Note;
use crossbeam_channel::{Sender, bounded};
use meissner_stream::Settings;
use meissner_stream::queues::Command;
use std::sync::Arc;
use std::thread;
use std::time::Duration;
use tracing::{info, warn};

/// How long the old disk of the session record may take to write waiting entries.
const TIMEOUT: Duration = Duration::from_secs(2);

/// Starts the thread that reads the configuration whenever it gets a message. It may wait for the disk; nothing waits for it.
pub(in crate::daemon) fn spawn(
    source: Source,
    mut running: Config,
    engine: Arc<Engine>,
    store: SharedStore,
    manager: Manager,
) -> Result<Sender<()>, DaemonError> {
    // One unread message is enough.
    let (sender, requests) = bounded(1);
    let work = move || {
        for () in requests {
            manager.notify(Notification::Reloading);
            reload(&source, &mut running, &engine, &store);
            manager.notify(Notification::Ready);
        }
    };
    thread::Builder::new().name("reload".into()).spawn(work).map_err(system("thread"))?;
    Ok(sender)
}

/// Reads the configuration and applies what can change; `running` is the configuration in use.
fn reload(source: &Source, running: &mut Config, engine: &Engine, store: &SharedStore) {
    let mut applied = Vec::new();
    // A person may have corrected the file of the vibration sums.
    if let Some(location) = &running.logbook
        && engine.lock().exposure.unknown().is_some()
    {
        let read = sums::read(&location.dir);
        sums::restore(&mut engine.lock().exposure, &read);
    }
    let problem = apply(source, running, engine, store, &mut applied).err();
    engine.session_record().add(Note::Reloaded { changed: applied.clone(), problem: problem.clone() });
    // Who reads this in the log finds the entry in the record.
    match (&*applied, &problem) {
        ([], None) => info!("the configuration has not changed"),
        ([], Some(_)) => {}
        _ => info!("the configuration was read again: {}", applied.join(", ")),
    }
    if let Some(problem) = &problem {
        warn!("{problem}");
    }
    // Save this after the first entry in a new directory, which opens it.
    let _ = engine.lock().save_exposure(Now::read());
}

/// Applies what can change and lists it; fails at the first problem.
fn apply(
    source: &Source,
    running: &mut Config,
    engine: &Engine,
    store: &SharedStore,
    applied: &mut Vec<String>,
) -> Result<(), String> {
    const STAYS: &str = "the configuration stays as it was";
    let new = source.read().map_err(|error| format!("{error}; {STAYS}"))?;
    let file = source.file.as_ref().map_or_else(String::new, |file| format!("{}: ", file.display()));
    if new.settings.array != running.settings.array {
        return Err(format!("{file}`array.description` changes only with a restart of the daemon; {STAYS}"));
    }
    let new_store = check(&new).map_err(|error| format!("{file}{error}; {STAYS}"))?;
    if new.patterns != running.patterns {
        store.replace(new_store);
        running.patterns.clone_from(&new.patterns);
        applied.push("`patterns_dir` at once".to_owned());
    }
    if new.settings != running.settings {
        let busy = |_| "too many commands wait for the device: reload the configuration again".to_owned();
        engine.configure(new.settings).map_err(busy)?;
        running.settings = new.settings;
        let Settings {
            lead_ms,
            lease_ms,
            drift_warning_um,
            drift_limit_um,
            end_stop_um,
            limits,
            lower_stop,
            array: _,
        } = new.settings;
        let array = lower_stop.map_or("no lower stop".to_owned(), |stop| {
            let surplus = stop.surplus_um.map_or("auto".to_owned(), |um| format!("{um} um"));
            format!("a lower stop, surplus {surplus}")
        });
        applied.push(format!(
            "from the next `arm` on `lead_ms` = {lead_ms}, `lease_ms` = {lease_ms}, `drift_warning_um` = {drift_warning_um}, \
             `drift_limit_um` = {drift_limit_um}, `end_stop_um` = {end_stop_um}, `motor_pulses_per_s` = {}, `rail_pulses_per_s` = {}, \
             `rail_motors_at_once` = {}, `chip_motors_at_once` = {}, {array}",
            limits.motor, limits.rail, limits.rail_at_once, limits.chip_at_once
        ));
    }
    if new.session_silence_s != running.session_silence_s {
        engine.lock().sessions.set_silence(Duration::from_secs_f64(new.session_silence_s));
        running.session_silence_s = new.session_silence_s;
        applied.push("`session_silence_s` at once".to_owned());
    }
    if new.armed_silence_s != running.armed_silence_s {
        engine.lock().armed.set_default(Duration::from_secs_f64(new.armed_silence_s));
        running.armed_silence_s = new.armed_silence_s;
        applied.push("`armed_silence_s` from the next `arm` on".to_owned());
    }
    if new.participant != running.participant {
        let mut state = engine.lock();
        state.exposure.set_limits(new.participant);
        // The amplitude of running and queued plays was checked when they were ordered.
        if new.participant.max_amplitude_um < running.participant.max_amplitude_um {
            let _ = state.commands.send_unanswered(Command::Stop);
        }
        drop(state);
        running.participant = new.participant;
        applied.push("[participant] at once".to_owned());
    }
    if new.calibration != running.calibration {
        engine.set_calibration_file(new.calibration.clone());
        running.calibration.clone_from(&new.calibration);
        applied
            .push("`calibration`: new calibrations go there; it is read at the next connection".to_owned());
    }
    if new.logbook != running.logbook {
        let users = Arc::clone(&engine.names.users);
        let slow = |error| format!("`logbook_dir`: {error}: reload the configuration again");
        engine.session_record().move_to(new.logbook.clone(), users, TIMEOUT).map_err(slow)?;
        running.logbook.clone_from(&new.logbook);
        applied.push("`logbook_dir` and `logbook_days` at once".to_owned());
    }
    let fixed = [
        ("`device`", new.device != running.device),
        ("`socket`", new.socket != running.socket),
        ("`listen`, `listen_hosts`, `listen_origins`, `listen_token`", new.listen != running.listen),
        ("`tokens`", new.tokens != running.tokens),
        ("[mock]", new.mock != running.mock),
    ];
    let fixed: Vec<&str> = fixed.iter().filter(|(_, changed)| *changed).map(|(key, _)| *key).collect();
    if fixed.is_empty() {
        return Ok(());
    }
    Err(format!("{} cannot change while the daemon runs: restart it", fixed.join(", ")))
}
