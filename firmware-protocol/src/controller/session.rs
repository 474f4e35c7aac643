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
    id: Option<u32>,
    epoch: u16,
    /// Why the command that began the epoch was refused.
    refusal: Option<Refusal>,
    /// The token of the newest ping that is not answered yet.
    token: u16,
    host_timeout: u32,
    max_host_timeout: u32,
    last_heard: Tick,
}

impl Session {
    pub(super) const fn new(layout: &Layout, now: Tick) -> Self {
        let max_host_timeout = layout.max_host_timeout();
        Self {
            id: None,
            epoch: 0,
            refusal: None,
            token: 0,
            host_timeout: max_host_timeout,
            max_host_timeout,
            last_heard: now,
        }
    }

    pub(super) fn id(&self) -> Option<u32> {
        self.id
    }

    pub(super) fn is_open(&self) -> bool {
        self.id.is_some()
    }

    pub(super) fn epoch(&self) -> u16 {
        self.epoch
    }

    pub(super) fn refusal(&self) -> Option<Refusal> {
        self.refusal
    }

    /// Opens a session, which begins an epoch.
    pub(super) fn open(&mut self, id: u32) {
        (self.id, self.epoch, self.refusal) = (Some(id), self.epoch.wrapping_add(1), None);
    }

    pub(super) fn close(&mut self) {
        self.id = None;
    }

    /// Begins the epoch of a command. Returns whether it is new, so that the command is to be carried out.
    pub(super) fn begin(&mut self, epoch: u16) -> bool {
        let is_new = newer(epoch, self.epoch);
        if is_new {
            self.epoch = epoch;
        }
        is_new
    }

    /// The command of this epoch was carried out, or refused.
    pub(super) fn carried_out(&mut self, refusal: Option<Refusal>) {
        self.refusal = refusal;
    }

    pub(super) fn ping(&mut self, token: u16) {
        self.token = token;
    }

    /// The token that the next status answers, once.
    pub(super) fn take_token(&mut self) -> u16 {
        core::mem::take(&mut self.token)
    }

    pub(super) fn set_host_timeout(&mut self, ticks: u32) {
        self.host_timeout = ticks.min(self.max_host_timeout);
    }

    pub(super) fn heard(&mut self, now: Tick) {
        self.last_heard = now;
    }

    /// Whether the host has not been heard for longer than its timeout.
    pub(super) fn is_silent(&self, now: Tick) -> bool {
        now - self.last_heard > self.host_timeout.into()
    }
}
