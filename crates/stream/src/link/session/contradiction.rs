//! The ways in which a device can contradict itself, and their counts.
//!
//! `bounds` finds a [`Contradiction`]; the session ignores the message, counts it in [`Contradictions`], and closes the
//! link if they come often ([`Trust`]).

use crate::time::HostInstant;
use std::time::Duration;

/// So many contradictions within this time close the link.
const MAX_CONTRADICTIONS: usize = 5;
const CONTRADICTIONS_WITHIN: Duration = Duration::from_secs(1);

/// A message from the device, undamaged, that cannot be true.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contradiction {
    /// A hello with a clock or a number of stroke slots that no device has.
    Hello,
    /// Its clock jumps, or a tick lies where it cannot.
    Clock,
    /// It answers a command that it was not sent, or as that command cannot be answered.
    Command,
    /// It acknowledges frames that it was not sent.
    Stream,
    /// It has more free stroke slots than slots.
    Credits,
    /// Its number of reports jumps, or an announced report does not come.
    Reports,
    /// A report does not fit the strokes that it was sent.
    Report,
    /// It is in a state to which no command has led, or does not leave a return.
    State,
    /// Its counts shrink, or grow faster than motors can play.
    Counters,
    /// It sends telemetry without having sensors.
    Telemetry,
    /// Its board report changes what cannot change, or names outputs that there are not.
    Board,
}

impl Contradiction {
    /// All kinds, in the order of their declaration.
    pub const ALL: [Self; 11] = [
        Self::Hello,
        Self::Clock,
        Self::Command,
        Self::Stream,
        Self::Credits,
        Self::Reports,
        Self::Report,
        Self::State,
        Self::Counters,
        Self::Telemetry,
        Self::Board,
    ];

    /// Its name in metrics.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Hello => "hello",
            Self::Clock => "clock",
            Self::Command => "command",
            Self::Stream => "stream",
            Self::Credits => "credits",
            Self::Reports => "reports",
            Self::Report => "report",
            Self::State => "state",
            Self::Counters => "counters",
            Self::Telemetry => "telemetry",
            Self::Board => "board",
        }
    }
}

/// Contradictions since the session began, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Contradictions([u64; Contradiction::ALL.len()]);

impl Contradictions {
    /// How many of one kind.
    pub fn of(&self, kind: Contradiction) -> u64 {
        self.0[kind as usize]
    }

    /// How many of all kinds.
    pub fn total(&self) -> u64 {
        self.0.iter().sum()
    }

    /// Counts one; returns whether it is the first of its kind.
    pub(super) fn count(&mut self, kind: Contradiction) -> bool {
        let count = &mut self.0[kind as usize];
        *count += 1;
        *count == 1
    }
}

/// Whether a device is trusted: when it contradicted itself, the last times.
#[derive(Clone, Debug, Default)]
pub(super) struct Trust([Option<HostInstant>; MAX_CONTRADICTIONS]);

impl Trust {
    /// The device contradicted itself; returns whether it did so too often.
    pub(super) fn contradicted(&mut self, now: HostInstant) -> bool {
        self.0.rotate_right(1);
        self.0[0] = Some(now);
        self.0[MAX_CONTRADICTIONS - 1].is_some_and(|first| now.since(first) <= CONTRADICTIONS_WITHIN)
    }
}
