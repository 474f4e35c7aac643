//! A message that the session repeats without an answer: hellos, and the last e-stops to a device that is not trusted.
//!
//! Invariant: two of them leave no closer than the interval, and never more than the caller allows.

use crate::time::HostInstant;
use std::time::Duration;

/// How often such a message was sent, and when.
#[derive(Clone, Debug)]
pub(super) struct Repetition {
    every: Duration,
    sent: u16,
    first: Option<HostInstant>,
    last: Option<HostInstant>,
}

/// What to do at an instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub(super) enum Turn {
    Wait,
    /// Send the message of this number, from 1.
    Send(u16),
    /// All were sent, and the last has had its time.
    Spent,
}

impl Repetition {
    pub(super) const fn new(every: Duration) -> Self {
        Self { every, sent: 0, first: None, last: None }
    }

    /// The turn at `now`, of `most` messages.
    pub(super) fn next(&mut self, now: HostInstant, most: u16) -> Turn {
        if self.last.is_some_and(|last| now.since(last) < self.every) {
            return Turn::Wait;
        }
        if self.sent >= most {
            return Turn::Spent;
        }
        self.sent += 1;
        self.first.get_or_insert(now);
        self.last = Some(now);
        Turn::Send(self.sent)
    }

    /// When the first was sent.
    pub(super) const fn first(&self) -> Option<HostInstant> {
        self.first
    }

    /// When the next turn is due.
    pub(super) fn due(&self, now: HostInstant) -> HostInstant {
        self.last.map_or(now, |last| last + self.every)
    }
}
