//! Checks whether the daemon can run with a configuration: at its start, and for `meissner daemon --check-config`.
//!
//! It does not make or change anything.

use crate::config::{Config, PatternsDir};
use crate::daemon::core::error::DaemonError;
use crate::daemon::net::socket;
use crate::file::dir_of;
use crate::record::Location;
use crate::store::{Store, StoreError};
use rustix::process::{Resource, getrlimit};

/// The most memory that the daemon takes, bytes. `docs/safety.md` adds it up;
/// `cargo bench -p meissner-benches --bench memory` measures it under load.
pub const MEMORY_BOUND: usize = 1440 << 20;

/// Checks a configuration and opens its patterns.
///
/// # Errors
/// The first problem that would keep the daemon from starting.
pub fn check(config: &Config) -> Result<Store, DaemonError> {
    socket::check(&config.socket)?;
    if let Some(Location { dir, make_parents: false, .. }) = &config.logbook
        && !dir.is_dir()
        && (dir.exists() || !dir_of(dir).is_dir())
    {
        return Err(DaemonError::Record { dir: dir.clone() });
    }
    Ok(store(config)?)
}

/// Opens the patterns that a configuration names.
///
/// # Errors
/// If their directory cannot be read.
pub(in crate::daemon) fn store(config: &Config) -> Result<Store, StoreError> {
    let (dir, make_dir) = match &config.patterns {
        PatternsDir::Configured(dir) => (Some(dir.clone()), false),
        PatternsDir::Default(dir) => (Some(dir.clone()), true),
        PatternsDir::None => (None, false),
    };
    let store = Store::new(dir, make_dir)?;
    store.check_dir()?;
    Ok(store)
}

/// Checks that the process may use the most memory that the daemon takes, so that the daemon refuses to start rather than fails
/// later.
///
/// # Errors
/// If the limit of its address space is lower.
pub fn check_memory() -> Result<(), DaemonError> {
    let needed = MEMORY_BOUND as u64;
    match getrlimit(Resource::As).current {
        Some(bytes) if bytes < needed => Err(DaemonError::AddressSpace { bytes, needed }),
        _ => Ok(()),
    }
}
