//! Names of users, by their numbers. They are only for display, never for access decisions.
//!
//! The system may ask a remote directory service, so [`Users::look_up`] asks on a separate thread, and [`Users::known`] never
//! waits.
//!
//! Invariants: no look-up runs under the lock; only one runs at a time, so that a hung directory service blocks one thread.

use nix::unistd::{Uid, User};
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Users kept: more than a lab has.
const MOST: usize = 1000;
/// How long a name is valid.
const GOOD_FOR: Duration = Duration::from_secs(3600);
/// How long a user without a name is not looked up again.
const UNKNOWN_FOR: Duration = Duration::from_secs(60);

#[derive(Debug)]
struct CachedName {
    name: Option<String>,
    until: Instant,
}

/// The names that were looked up.
#[derive(Debug, Default)]
pub struct Users {
    known: Mutex<HashMap<u32, CachedName>>,
    asking: AtomicBool,
}

impl Users {
    fn lock(&self) -> MutexGuard<'_, HashMap<u32, CachedName>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A user's name, without a look-up; the outer `None` means that the user was never looked up.
    pub fn known(&self, uid: u32) -> Option<Option<String>> {
        self.lock().get(&uid).map(|known| known.name.clone())
    }

    /// Starts looking a user up, unless the name is still valid or another look-up runs.
    pub fn look_up(self: &Arc<Self>, uid: u32) {
        let lately = self.lock().get(&uid).is_some_and(|known| Instant::now() < known.until);
        if lately || self.asking.swap(true, Ordering::Relaxed) {
            return;
        }
        let users = Arc::clone(self);
        let work = move || {
            users.ask(uid);
            users.asking.store(false, Ordering::Relaxed);
        };
        // Use a separate thread, because the look-up may take long.
        if thread::Builder::new().name("names".into()).spawn(work).is_err() {
            self.asking.store(false, Ordering::Relaxed);
        }
    }

    /// Waits for the system's directory of users.
    fn ask(&self, uid: u32) {
        let found = User::from_uid(Uid::from_raw(uid)).ok().flatten();
        let name: Option<String> = found.map(|user| user.name);
        let good_for = if name.is_some() { GOOD_FOR } else { UNKNOWN_FOR };
        let mut known = self.lock();
        if known.len() >= MOST {
            known.clear();
        }
        known.insert(uid, CachedName { name, until: Instant::now() + good_for });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_looked_up_once_and_an_unknown_user_has_none() {
        let users = Arc::new(Users::default());
        assert_eq!(users.known(0), None);
        for (uid, name) in [(0, Some("root".to_owned())), (4_000_000_001, None)] {
            while users.known(uid).is_none() {
                users.look_up(uid);
                thread::yield_now();
            }
            assert_eq!(users.known(uid), Some(name));
        }
    }
}
