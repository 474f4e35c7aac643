//! The session of the host: its number, its epoch, the last command, and whether the host is still heard.
//!
//! Invariant: an epoch begins once, with the session or with a command of a newer epoch.

use crate::array::Layout;
use crate::controller::newer;
use crate::limits::Refusal;
use crate::tick::Tick;

#[derive(Clone, Debug)]
pub(super) struct Session {
    /// Its number, while one is open.
    pub(super) id: Option<u32>,
    epoch: u16,
    /// Why the command that began the epoch was refused.
    pub(super) refusal: Option<Refusal>,
    /// The token of the newest ping that is not answered yet.
    pub(super) token: u16,
    pub(super) host_timeout: u32,
    pub(super) last_heard: Tick,
}

impl Session {
    pub(super) const fn new(layout: &Layout, now: Tick) -> Self {
        let host_timeout = layout.max_host_timeout();
        Self { id: None, epoch: 0, refusal: None, token: 0, host_timeout, last_heard: now }
    }

    pub(super) fn epoch(&self) -> u16 {
        self.epoch
    }

    pub(super) fn is_open(&self) -> bool {
        self.id.is_some()
    }

    /// Opens a session, which begins an epoch.
    pub(super) fn open(&mut self, id: u32) {
        (self.id, self.epoch, self.refusal) = (Some(id), self.epoch.wrapping_add(1), None);
    }

    /// Begins the epoch of a command. Returns whether it is new, so that the command is to be carried out.
    pub(super) fn begin(&mut self, epoch: u16) -> bool {
        let is_new = newer(epoch, self.epoch);
        if is_new {
            self.epoch = epoch;
        }
        is_new
    }

    /// Whether the host has not been heard for longer than its timeout.
    pub(super) fn is_silent(&self, now: Tick) -> bool {
        now - self.last_heard > self.host_timeout.into()
    }
}
