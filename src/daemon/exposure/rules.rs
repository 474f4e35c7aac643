//! The participant's exposure: reserves the time of plays, follows them, stops those that reach a limit, and keeps the sums on the
//! disk.
//!
//! Ten times a second the daemon learns how long the running play has played. It stops a play without end before
//! that can exceed a limit. It refuses a play with an end that does not fit.
//!
//! Invariant: the daemon orders the stop again at each report beyond the limit, until the play ends.

use crate::daemon::core::commands::LOST_AFTER;
use crate::daemon::core::state::State;
use crate::daemon::exposure::state::{Exposure, exceeded};
use crate::exposure::{Limit, Now, Onset, Vibration};
use crate::receipts::state_name;
use firmware_protocol::message::State as DeviceState;
use meissner_api::{EndCause, Problem};
use meissner_stream::queues::{At, Command, End, StreamEvent};
use std::time::Duration;
use tokio::sync::oneshot::Receiver;

/// How often the sums are saved during a play: half of the time that the file reserves for a play without end.
const SAVE_EVERY: Duration = Duration::from_secs(5);

impl State {
    /// Refuses a pattern that plays without end although its client has not said that it may.
    pub(in crate::daemon) fn check_end(&self, pattern: &str, unexpected: bool) -> Result<(), Problem> {
        if unexpected {
            return Err(exceeded(format!(
                "`{pattern}` has no end: add `seconds` (--seconds S), or allow a play without end with `endless` (--endless)"
            )));
        }
        Ok(())
    }

    /// Refuses vibration that does not fit after the running and waiting plays, or instead of them; otherwise reserves its time.
    pub(in crate::daemon) fn hold_vibration(
        &mut self,
        vibration: &Vibration,
        replaces: bool,
        at: At,
    ) -> Result<u64, Problem> {
        let now = Now::read();
        let at_s = now.at.as_ns() as f64 / 1e9;
        let onset = match at {
            // When an edge comes nobody knows.
            At::Next | At::Edge(_) => Onset::Next,
            At::After(ns) => Onset::At(at_s + ns as f64 / 1e9),
            At::Monotonic(at) => Onset::At(at.as_ns() as f64 / 1e9),
            // Without a clock the time of this tick is unknown.
            At::Tick(tick) => {
                self.plays.receipts.clock(now.at).map_or(Onset::Next, |(at, uncertainty_us)| {
                    let ahead_s = (tick.0 as f64 - at.0 as f64) / f64::from(self.settings.array.rate().hz());
                    Onset::At(at_s + ahead_s - uncertainty_us / 1e6)
                })
            }
        };
        let Exposure { account, .. } = &mut self.exposure;
        account.hold(now, vibration.clone(), onset, replaces).map_err(|why| {
            let unknown = account.unknown().filter(|_| why.limit == Limit::Day);
            exceeded(unknown.map_or_else(|| why.text(), str::to_owned))
        })
    }

    /// Reserves the time of a command that brings pins home: of a homing as of a play without end, of a seek of the lower stop its own.
    pub(in crate::daemon) fn hold_homing(&mut self, command: &Command) -> Result<Option<u64>, Problem> {
        let (settings, now) = (self.settings, Now::read());
        let arms = matches!(command, Command::Arm { .. } | Command::ArmUnchecked);
        if matches!(command, Command::Reset { .. }) && self.is_faulted() {
            // Of what was cut before this daemon began, too.
            self.exposure.account.stand(Vibration::without_end(&settings).return_s());
        }
        // What a cut has left up comes down now.
        let returns = arms || matches!(command, Command::Reset { keep: false, .. });
        if returns && self.exposure.account.come_down(now) {
            let _ = self.save_exposure(now);
        }
        let vibration = if matches!(command, Command::Home) {
            Vibration::without_end(&settings)
        } else if arms && settings.lower_stop.is_some() {
            let seek_s = settings.seek_time().as_secs_f64();
            Vibration::new([(0.0, seek_s)], Some(seek_s))
        } else {
            return Ok(None);
        };
        self.hold_vibration(&vibration, false, At::Next).map(Some)
    }

    fn is_faulted(&self) -> bool {
        self.plays.receipts.device_state().state == state_name(DeviceState::Faulted)
    }

    /// The command was sent, or not.
    pub(in crate::daemon) fn begin_homing(&mut self, held: Option<u64>, sent: bool) {
        let Some(number) = held else { return };
        let now = Now::read();
        if sent {
            self.exposure.account.began(number, now.at);
            self.exposure.homings.push((self.commands.last_ticket(), number, now.at));
            let _ = self.save_exposure(now);
        } else {
            self.exposure.account.forget(number);
        }
    }

    /// The command with this ticket was answered: pins are still.
    pub(in crate::daemon) fn end_homing(&mut self, ticket: u64) {
        let now = Now::read();
        let Exposure { account, homings, .. } = &mut self.exposure;
        let before = homings.len();
        for (_, number, sent) in
            homings.extract_if(.., |&mut (of, _, sent)| of == ticket || now.at.since(sent) > LOST_AFTER)
        {
            account.ended(number, Some(now.at.since(sent).as_secs_f64()), now);
        }
        if self.exposure.homings.len() < before {
            let _ = self.save_exposure(now);
        }
    }

    /// Counts the homings under way; returns whether a limit must stop them now.
    fn count_homings(&mut self, now: Now) -> bool {
        let Exposure { account, homings, .. } = &mut self.exposure;
        let passed = homings.iter().filter(|&&(_, number, sent)| {
            account.played(number, now.at.since(sent).as_secs_f64(), now).is_some()
        });
        passed.count() > 0
    }

    /// Counts the vibration that an event reports. Stops a play that passes a limit, and names the limit as the cause of its end.
    pub(in crate::daemon) fn follow_exposure(&mut self, streamed: &mut StreamEvent) {
        match streamed {
            StreamEvent::PlayStarted { id, onset } => self.exposure.account.began(*id, onset.at),
            StreamEvent::Snapshot(snapshot) => {
                let now = Now::read().at(snapshot.at);
                if self.count_homings(now) {
                    let _ = self.commands.send_unanswered(Command::Stop);
                }
                let Some((id, played_s)) = snapshot.play else { return };
                if self.exposure.account.played(id, played_s, now).is_some() {
                    // The stop also clears the queue. If too many commands wait, the next report orders the stop again.
                    let live: Vec<u64> = self.exposure.account.live().collect();
                    self.exposure.stopped.extend(live);
                    let _ = self.commands.send_unanswered(Command::Stop);
                }
                let due = |(at, date)| now.at.since(at) >= SAVE_EVERY || date != now.date;
                if self.exposure.saved.is_none_or(due) {
                    let _ = self.save_exposure(now);
                }
            }
            StreamEvent::PlayEnded { id, outcome } => {
                let (now, rate) = (Now::read(), self.settings.array.rate());
                let played_s = outcome.onset.map_or(Some(0.0), |onset| {
                    self.exposure.account.began(*id, onset.at);
                    let until_now_s = now.at.since(onset.at).as_secs_f64();
                    match outcome.end {
                        End::Done => None,
                        End::Stopped | End::Aborted => {
                            Some(outcome.cut_after.map_or(until_now_s, |ticks| rate.ticks_to_seconds(ticks)))
                        }
                    }
                });
                let return_s = self.exposure.account.return_s(*id);
                self.exposure.account.ended(*id, played_s, now);
                if let (Some(onset), Some(played_s)) = (outcome.onset, played_s) {
                    let over = outcome.offset.map(|offset| rate.ticks_to_seconds(offset.tick - onset.actual));
                    // After a lost link the device brings the pins down, and does not say so.
                    let back_s = over.map_or(return_s, |over_s| (over_s - played_s).max(0.0));
                    let (cut, faulted) = (onset.at + Duration::from_secs_f64(played_s), self.is_faulted());
                    let account = &mut self.exposure.account;
                    if back_s > 0.0 {
                        account.moved(cut, back_s, now);
                    } else if faulted || outcome.cause == Some(EndCause::EStop) {
                        account.left_up(cut, return_s, now);
                    }
                }
                if self.exposure.stopped.remove(id) && outcome.cause == Some(EndCause::Stop) {
                    outcome.cause = Some(EndCause::ParticipantLimit);
                }
                let _ = self.save_exposure(now);
            }
            _ => {}
        }
    }

    /// Gives back the time of a play that was not accepted.
    pub(in crate::daemon) fn forget_exposure(&mut self, id: u64) {
        self.exposure.stopped.remove(&id);
        if self.exposure.account.forget(id) {
            let _ = self.save_exposure(Now::read());
        }
    }

    /// Saves the sums. Returns where the disk's answer arrives, if there is a file.
    pub(in crate::daemon) fn save_exposure(&mut self, now: Now) -> Option<Receiver<bool>> {
        self.exposure.saved = Some((now.at, now.date));
        let text = self.exposure.account.text(now)?;
        self.publisher.record.save_exposure(text)
    }
}
