//! Names of users, by their numbers.
//!
//! The system may ask a directory service far away, so a name is looked up by whoever can wait, and remembered for whoever cannot.
//! Nobody is let in or kept out by it.
//!
//! Invariant: nothing is looked up under the lock.

use nix::unistd::{Uid, User};
use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Users that are remembered: more than a lab has.
const MOST: usize = 1000;
/// How long a name is taken to stay the same.
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
pub struct Users(Mutex<HashMap<u32, Known>>);

impl Users {
    fn lock(&self) -> MutexGuard<'_, HashMap<u32, Known>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is known of a user, without asking anybody: outer none if they were not looked up lately.
    #[must_use]
    pub fn known(&self, uid: u32) -> Option<Option<String>> {
        let known = self.lock();
        known.get(&uid).filter(|known| Instant::now() < known.until).map(|known| known.name.clone())
    }

    /// A user's name, if they have one. May take as long as the system's directory of users takes.
    #[must_use]
    pub fn name(&self, uid: u32) -> Option<String> {
        if let Some(known) = self.known(uid) {
            return known;
        }
        let found = User::from_uid(Uid::from_raw(uid)).ok().flatten();
        let name: Option<String> = found.map(|user| user.name);
        let good_for = if name.is_some() { GOOD_FOR } else { UNKNOWN_FOR };
        let mut known = self.lock();
        if known.len() >= MOST {
            known.clear();
        }
        known.insert(uid, Known { name: name.clone(), until: Instant::now() + good_for });
        name
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_looked_up_once_and_nobody_has_none() {
        let users = Users::default();
        assert_eq!(users.known(0), None);
        assert_eq!(users.name(0).as_deref(), Some("root"));
        assert_eq!(users.known(0), Some(Some("root".to_owned())));
        assert_eq!(users.name(4_000_000_001), None);
        assert_eq!(users.known(4_000_000_001), Some(None));
    }
}
