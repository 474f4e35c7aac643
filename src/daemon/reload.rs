//! A configuration that is read while the daemon runs: what of it is taken, from when on, and what is not.
//!
//! Patterns' directory at once; the streamer's settings from the next `arm` on; where the calibration is kept from the next connection on.
//! The device, the socket and the mock stay what they are until the daemon is started again.
//!
//! Invariant: a configuration that would have been refused at the start changes nothing.

use super::engine::Engine;
use super::http::Shelf;
use super::store;
use crate::config::{Config, Source};
use crate::stream::port::{Job, Order};
use crate::units::HostInstant;
use tracing::{info, warn};

/// Reads the source and takes over what can be; `running` is what is gone by, before and after. Waits for the disk.
pub(super) fn reload(source: &Source, running: &mut Config, engine: &Engine, shelf: &Shelf) {
    let new = match source.read() {
        Ok(new) => new,
        Err(error) => return warn!("{error}; the configuration stays as it was"),
    };
    let mut taken: Vec<&str> = Vec::new();
    if new.patterns != running.patterns {
        match store(&new) {
            Ok(store) => shelf.replace(store),
            Err(error) => return warn!("`patterns_dir`: {error}; the configuration stays as it was"),
        }
        running.patterns.clone_from(&new.patterns);
        taken.push("`patterns_dir` at once");
    }
    if new.settings != running.settings {
        if engine.configure(new.settings).is_err() {
            return warn!("too many orders wait for the device: reload the configuration again");
        }
        running.settings = new.settings;
        taken.push("`lead_ms`, `lease_ms`, `drift_warning_um` and [limits] from the next `arm` on");
    }
    if new.calibration != running.calibration {
        engine.keep_calibration_at(new.calibration.clone());
        running.calibration.clone_from(&new.calibration);
        taken.push("`calibration` from the next connection on");
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
    if !fixed.is_empty() {
        warn!("{} cannot change while the daemon runs: restart it", fixed.join(", "));
    }
}

impl Engine {
    /// Goes by these settings from the next `arm` on; gives the order back if too many wait.
    fn configure(&self, settings: crate::stream::Settings) -> Result<(), Order> {
        let mut inner = self.lock();
        let job = Job::Configure(settings);
        inner.orders.send(Order { ticket: 0, given: HostInstant::now(), job })?;
        inner.settings = settings;
        Ok(())
    }

    fn keep_calibration_at(&self, file: Option<std::path::PathBuf>) {
        self.lock().calibration_file = file;
    }
}
