//! The participant's exposure: follows the plays, stops what passes a limit, and keeps the day's sum.
//!
//! The daemon learns ten times a second how long the running play has played, so it stops a play without end at most that long
//! after its limit, and the time that the stop takes. A play with an end is refused if it does not fit.
//!
//! Invariant: the daemon orders the stop once for each report in which the limit is passed, until the play ends.

use super::State;
use crate::exposure::{Account, Now, ParticipantLimits, Vibration};
use meissner_api::{Code, PlayRequest, Problem};
use meissner_array::pattern::Pattern;
use meissner_array::units::ticks_to_seconds;
use meissner_stream::queues::{Command, End, StreamEvent};
use meissner_stream::time::HostInstant;
use std::collections::HashSet;
use std::ops::{Deref, DerefMut};
use std::time::Duration;

/// The cause of a play's end that a limit ordered.
pub(in crate::daemon) const CAUSE: &str = "participant-limit";
/// How often the day's sum is saved during a play: what a crash may lose.
const SAVE_EVERY: Duration = Duration::from_secs(10);

/// See the module.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Exposure {
    account: Account,
    /// Plays that a limit stops.
    stopped: HashSet<u64>,
    saved_at: Option<HostInstant>,
}

impl Exposure {
    pub(in crate::daemon) fn new(account: Account) -> Self {
        Self { account, ..Self::default() }
    }

    /// Changes the limits.
    pub(in crate::daemon) const fn set_limits(&mut self, limits: ParticipantLimits) {
        self.account.set_limits(limits);
    }

    /// A play was not accepted.
    pub(super) fn forget(&mut self, id: u64) {
        self.account.forget(id);
        self.stopped.remove(&id);
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

fn exceeded(detail: String) -> Problem {
    Problem::new(Code::ParticipantLimit, detail)
}

impl State {
    /// Refuses a play that a participant's limit does not allow, or not now. `later`: it has an onset.
    pub(in crate::daemon) fn check_exposure(
        &self,
        request: &PlayRequest,
        pattern: &Pattern,
        vibration: &Vibration,
        later: bool,
    ) -> Result<(), Problem> {
        let scale = request.scale.unwrap_or(1.0);
        let amplitudes = pattern.drives().iter().map(|drive| drive.amplitude_um * scale);
        self.check_amplitude(&request.pattern, amplitudes.fold(0.0, f64::max))?;
        if vibration.is_endless() && !request.endless {
            return Err(exceeded(format!(
                "`{}` has no end: add `seconds` (--seconds S), or allow a play without end with `endless` (--endless)",
                request.pattern
            )));
        }
        self.check_vibration(vibration, request.replace, later)
    }

    /// Refuses an amplitude that is too large for a participant.
    pub(in crate::daemon) fn check_amplitude(&self, pattern: &str, largest_um: f64) -> Result<(), Problem> {
        let most_um = self.exposure.account.limits().max_amplitude_um;
        if largest_um > most_um {
            return Err(exceeded(format!(
                "`participant.max_amplitude_um` is {most_um} um, and `{pattern}` asks for {largest_um} um: play a weaker pattern, or \
                 raise the limit in the daemon's configuration"
            )));
        }
        Ok(())
    }

    /// Refuses vibration that does not fit behind the plays that run and wait, or `instead` of them.
    pub(in crate::daemon) fn check_vibration(
        &self,
        vibration: &Vibration,
        instead: bool,
        later: bool,
    ) -> Result<(), Problem> {
        let fits = self.exposure.account.check(Now::read(), vibration, instead, later);
        fits.map_err(|why| exceeded(why.text()))
    }

    /// Counts the vibration that an event reports. Stops a play that passes a limit, and names the limit as the cause of its end.
    pub(super) fn follow_exposure(&mut self, streamed: &mut StreamEvent) {
        match streamed {
            StreamEvent::Snapshot(snapshot) => {
                let Some((id, played_s)) = snapshot.play else { return };
                let now = Now::read();
                if self.exposure.account.played(id, played_s, now).is_some() {
                    // The queue is cleared, too. If too many commands wait, the next report orders it again.
                    let live: Vec<u64> = self.exposure.account.live().collect();
                    self.exposure.stopped.extend(live);
                    let _ = self.commands.send_unanswered(Command::Stop);
                }
                let due = self.exposure.saved_at.is_none_or(|at| now.at.since(at) >= SAVE_EVERY);
                if due {
                    self.save_exposure(now.at);
                }
            }
            StreamEvent::PlayEnded { id, outcome } => {
                let now = Now::read();
                let until_now_s = |began: HostInstant| now.at.since(began).as_secs_f64();
                let played_s = outcome.onset.map_or(0.0, |onset| match (outcome.end, outcome.cut_after) {
                    (End::Done, _) => f64::INFINITY,
                    (End::Stopped | End::Aborted, Some(ticks)) => ticks_to_seconds(ticks),
                    (End::Stopped | End::Aborted, None) => until_now_s(onset.at),
                });
                self.exposure.account.ended(*id, played_s, now);
                if self.exposure.stopped.remove(id) && outcome.cause == Some("stop") {
                    outcome.cause = Some(CAUSE);
                }
                self.save_exposure(now.at);
            }
            _ => {}
        }
    }

    fn save_exposure(&mut self, at: HostInstant) {
        self.exposure.saved_at = Some(at);
        if let Some(text) = self.exposure.account.text() {
            self.publisher.session_record.save_exposure(text);
        }
    }
}
