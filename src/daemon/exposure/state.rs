//! The participant's account, and whether the disk has it. [`rules`](super::rules) follow plays by it.
//!
//! A disk that fails, or does not answer, does not stop plays: the sums in memory apply, and the status reports the problem.

use crate::exposure::{Account, Now};
use jiff::civil::Date;
use meissner_api::{Code, Problem};
use meissner_stream::time::HostInstant;
use std::collections::HashSet;
use std::ops::{Deref, DerefMut};
use tokio::sync::oneshot::Receiver;
use tokio::sync::oneshot::error::TryRecvError;

/// See the module.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Exposure {
    pub(super) account: Account,
    /// Plays that a limit stops.
    pub(super) stopped: HashSet<u64>,
    /// Commands that bring pins home: ticket, number in the account, and when they were sent.
    pub(super) homings: Vec<(u64, u64, HostInstant)>,
    /// The time and day of the last save.
    pub(super) saved: Option<(HostInstant, Date)>,
    /// Receives the disk's late answer, after a play has waited for it in vain.
    silent: Option<Receiver<bool>>,
}

impl Exposure {
    pub(in crate::daemon) fn new(account: Account) -> Self {
        Self { account, ..Self::default() }
    }

    /// The problem with the sums or their file, unless the disk has refused them: the record says that.
    pub(in crate::daemon) fn problem(&self) -> Option<String> {
        let silent = || {
            self.silent.as_ref().filter(|silent| silent.is_empty() && !silent.is_terminated()).map(|_| {
                "the disk of the session record is silent: after a kill the day's vibration would count too little".to_owned()
            })
        };
        self.account.problem(Now::read()).or_else(silent)
    }

    /// Whether the disk has not answered yet since a play waited for it in vain.
    pub(in crate::daemon) fn is_disk_silent(&mut self) -> bool {
        let silent = self.silent.as_mut().is_some_and(|silent| silent.try_recv() == Err(TryRecvError::Empty));
        if !silent {
            self.silent = None;
        }
        silent
    }

    /// Notes that a play has waited in vain for the disk to take the sums; `late` receives its answer.
    pub(in crate::daemon) fn disk_is_silent(&mut self, late: Receiver<bool>) {
        self.silent = Some(late);
    }

    /// Refuses an amplitude that is too large for a participant.
    pub(in crate::daemon) fn check_amplitude(
        &self,
        pattern: &str,
        [asked_um, reached_um]: [f64; 2],
    ) -> Result<(), Problem> {
        let most_um = self.account.limits().max_amplitude_um;
        let what = if asked_um > most_um {
            format!("asks for {asked_um} um")
        } else if reached_um > most_um {
            format!(
                "asks for {asked_um} um, whose pulses reach {reached_um:.1} um with the calibration in use"
            )
        } else {
            return Ok(());
        };
        Err(exceeded(format!(
            "limit for participants: `participant.max_amplitude_um` is {most_um} um, and `{pattern}` {what}: play a weaker pattern, or \
             raise the limit in the daemon's configuration"
        )))
    }

    /// The largest amplitude that participants may get, µm.
    pub(in crate::daemon) fn most_amplitude_um(&self) -> f64 {
        self.account.limits().max_amplitude_um
    }
}

impl Deref for Exposure {
    type Target = Account;

    fn deref(&self) -> &Account {
        &self.account
    }
}

impl DerefMut for Exposure {
    fn deref_mut(&mut self) -> &mut Account {
        &mut self.account
    }
}

pub(super) fn exceeded(detail: String) -> Problem {
    Problem::new(Code::ParticipantLimit, detail)
}
