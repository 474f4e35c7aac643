//! Plays: their receipts and clients.
//!
//! Bounds: those of [`Receipts`]; clients are kept only while a play is not over.

use crate::receipts::{PlannedItem, Receipts};
use crate::record::Peer;
use meissner_api::{Code, Event, Problem, Receipt};
use meissner_array::spec::Array;
use std::collections::HashMap;
use std::sync::Arc;

/// A play that is about to be sent to the streamer.
#[derive(Debug)]
pub(in crate::daemon) struct NewPlay {
    /// Its receipt, which gets its id here.
    pub(in crate::daemon) receipt: Receipt,
    pub(in crate::daemon) items: Arc<[PlannedItem]>,
    pub(in crate::daemon) client: Peer,
}

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Plays {
    pub(in crate::daemon) receipts: Receipts,
    /// The clients of the plays that are not over.
    clients: HashMap<u64, Peer>,
    /// What the samples of plays that are not over take: the SHA-256 of their patterns, and bytes.
    memory: HashMap<u64, Vec<(String, usize)>>,
    last_id: u64,
}

/// Bytes that the samples of all plays that are not over may take, at most. Plays of one pattern share them.
const MAX_MEMORY: usize = 128 << 20;

/// Refuses a sequence whose patterns so far have samples of more bytes than one play may take.
pub(in crate::daemon) fn check_samples(bytes: usize) -> Result<(), Problem> {
    if bytes <= MAX_MEMORY {
        return Ok(());
    }
    let detail =
        format!("the samples of its patterns take more than {} MiB: play fewer at once", MAX_MEMORY >> 20);
    Err(Problem::new(Code::TooLarge, detail))
}

impl Plays {
    /// None yet, on this array.
    pub(in crate::daemon) fn new(array: Array) -> Self {
        Self { receipts: Receipts::new(array), clients: HashMap::new(), memory: HashMap::new(), last_id: 0 }
    }

    /// Gives a play an id, and adds its receipt.
    pub(in crate::daemon) fn add(&mut self, play: NewPlay) -> u64 {
        let NewPlay { receipt, items, client } = play;
        self.last_id += 1;
        let id = self.last_id;
        self.receipts.add(Receipt { id, ..receipt }, items);
        self.clients.insert(id, client);
        id
    }

    /// Takes the streamer's answer to a play. The id of a play that was not accepted goes to the next one.
    pub(in crate::daemon) fn settle(&mut self, id: u64, accepted: bool) -> Option<Event> {
        if accepted {
            return self.receipts.settle(id, true);
        }
        if id == self.last_id {
            self.last_id -= 1;
        }
        self.forget(id);
        None
    }

    /// Refuses a play whose samples have no room beside those of the plays that are not over.
    pub(in crate::daemon) fn check_memory(&self, new: &[(String, usize)]) -> Result<(), Problem> {
        let all: HashMap<&str, usize> =
            self.memory.values().flatten().chain(new).map(|(sha256, bytes)| (&**sha256, *bytes)).collect();
        let bytes: usize = all.values().sum();
        if bytes <= MAX_MEMORY || new.iter().all(|(_, bytes)| *bytes == 0) {
            return Ok(());
        }
        let detail = format!(
            "the motions of this play and of those that wait and run would take {} MiB, and the daemon has {} MiB for them: wait for the \
             end of a play, or play shorter motions, at lower rates",
            bytes.div_ceil(1 << 20),
            MAX_MEMORY >> 20
        );
        Err(Problem::new(Code::TooLarge, detail))
    }

    /// Notes what the samples of an accepted play take.
    pub(in crate::daemon) fn hold_memory(&mut self, id: u64, memory: Vec<(String, usize)>) {
        let memory: Vec<_> = memory.into_iter().filter(|(_, bytes)| *bytes > 0).collect();
        if !memory.is_empty() {
            self.memory.insert(id, memory);
        }
    }

    /// Drops a play that was never accepted.
    pub(in crate::daemon) fn forget(&mut self, id: u64) {
        self.memory.remove(&id);
        self.receipts.settle(id, false);
        self.clients.remove(&id);
    }

    /// The client of a play that is not over.
    pub(in crate::daemon) fn client(&self, id: u64) -> Option<Peer> {
        self.clients.get(&id).copied()
    }

    /// Takes the client of a play, at its end.
    pub(in crate::daemon) fn take_client(&mut self, id: u64) -> Option<Peer> {
        self.memory.remove(&id);
        self.clients.remove(&id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_samples_of_plays_that_are_not_over_are_bounded_and_shared() {
        let mut plays = Plays::new(Array::paper());
        let of = |sha256: &str, mib: usize| vec![(sha256.to_owned(), mib << 20)];
        plays.check_memory(&of("a", 48)).unwrap();
        plays.hold_memory(1, of("a", 48));
        plays.hold_memory(2, of("a", 48));
        plays.hold_memory(3, of("b", 48));
        assert!(plays.check_memory(&of("a", 48)).is_ok() && plays.check_memory(&of("c", 32)).is_ok());
        let refused = plays.check_memory(&of("c", 33)).unwrap_err();
        assert!(refused.code == "too-large" && refused.detail.contains("would take 129 MiB"), "{refused:?}");
        assert!(plays.check_memory(&of("drives", 0)).is_ok());
        plays.take_client(3);
        plays.check_memory(&of("c", 33)).unwrap();
        plays.forget(1);
        assert!(plays.check_memory(&of("c", 81)).is_err(), "play 2 has the same pattern");
        plays.take_client(2);
        plays.check_memory(&of("c", 128)).unwrap();
    }
}
