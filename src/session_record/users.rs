//! Names of users, by their numbers.
//!
//! The system may ask a directory service far away, so a name is looked up by whoever can wait, and remembered for whoever cannot.
//! Nobody is let in or kept out by it.
//!
//! Invariants: nothing is looked up under the lock; one name at a time, so that a directory that hangs costs one thread.

use nix::unistd::{Uid, User};
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Users that are remembered: more than a lab has.
const MOST: usize = 1000;
/// How long a name is not asked for again.
const GOOD_FOR: Duration = Duration::from_secs(3600);
/// How long nobody is asked again for a name that was not found.
const UNKNOWN_FOR: Duration = Duration::from_secs(60);

#[derive(Debug)]
struct Known {
    name: Option<String>,
    until: Instant,
}

/// The names that were looked up.
#[derive(Debug, Default)]
pub struct Users {
    known: Mutex<HashMap<u32, Known>>,
    asking: AtomicBool,
}

impl Users {
    fn lock(&self) -> MutexGuard<'_, HashMap<u32, Known>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is known of a user, without asking anybody: outer none if they were never looked up.
    #[must_use]
    pub fn known(&self, uid: u32) -> Option<Option<String>> {
        self.lock().get(&uid).map(|known| known.name.clone())
    }

    /// Has a user looked up, if that was not done lately or is being done for another: a number is told until their next time then.
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
        // A thread of its own: it may be as slow as it likes.
        if thread::Builder::new().name("names".into()).spawn(work).is_err() {
            self.asking.store(false, Ordering::Relaxed);
        }
    }

    /// Takes as long as the system's directory of users takes.
    fn ask(&self, uid: u32) {
        let found = User::from_uid(Uid::from_raw(uid)).ok().flatten();
        let name: Option<String> = found.map(|user| user.name);
        let good_for = if name.is_some() { GOOD_FOR } else { UNKNOWN_FOR };
        let mut known = self.lock();
        if known.len() >= MOST {
            known.clear();
        }
        known.insert(uid, Known { name, until: Instant::now() + good_for });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_looked_up_once_and_nobody_has_none() {
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
