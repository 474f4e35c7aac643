//! Sends strokes to the device ahead of time, and chooses the onset of each play.
//!
//! [`Streamer::feed`] runs at each step. It sends in batches, so that a frame carries many strokes, and at least the lead
//! ahead of now.
//!
//! Invariant: nothing follows a play's first frame before the device has accepted it.

use crate::active::{Active, Phase};
use crate::queues::{At, Emit};
use crate::settings::batch_ticks;
use crate::streamer::Streamer;
use crate::time::HostInstant;
use firmware_protocol::message::State;
use firmware_protocol::tick::Tick;
use meissner_api::{EndCause, LateCause};
use std::time::Duration;

/// The host polls a full device this often. Its strokes last longer, and keep-alives may be seconds apart.
const CREDITS_EVERY: Duration = Duration::from_millis(50);

/// Onsets of items that are sent ahead of their time, at most: the device keeps 8, and takes no frame beyond them.
const MAX_ONSETS: usize = 7;

/// The result of sending strokes.
enum Fed {
    /// All strokes up to the horizon are sent.
    Horizon,
    /// The play has no more strokes.
    Exhausted,
    /// The session takes no more strokes for now.
    Blocked,
    /// The compiler's own check failed.
    Broken,
}

/// When a waiting play starts.
enum Start {
    /// Now, with this onset.
    At(Tick),
    /// Later than the horizon.
    Later,
    /// Not at all, for this reason.
    Never(EndCause),
}

impl Streamer {
    /// Sends all strokes due at `tick`.
    pub(super) fn feed(&mut self, now: HostInstant, tick: Tick, emit: &mut dyn Emit) {
        let Some(session) = &self.session else { return };
        if self.state() != State::Armed || !self.operations.is_empty() {
            return;
        }
        let lead = self.rate().ms_in_ticks(self.settings.lead_ms) as u64;
        let batch = batch_ticks(&self.settings);
        let mut unfed =
            self.plays.iter().filter(|active| !active.is_cut() && active.phase() != Phase::Streamed);
        let fresh = unfed.next().is_some_and(|active| active.phase() == Phase::Waiting);
        let blocked = !session.has_room();
        if blocked || (!fresh && self.fed_until >= tick + lead) {
            return;
        }
        let horizon = tick + lead + batch;
        for index in 0..self.plays.len() {
            let active = &self.plays[index];
            match active.phase() {
                _ if active.is_cut() => continue,
                Phase::Streamed => continue,
                Phase::Offered => break,
                Phase::Streaming => {}
                Phase::Waiting => match self.onset_of(index, tick, horizon) {
                    Start::At(onset) => self.start(index, onset),
                    Start::Later => break,
                    Start::Never(why) => {
                        self.plays[index].cut_unsent(why);
                        continue;
                    }
                },
            }
            match self.send_steps(now, index, tick, horizon, emit) {
                Fed::Exhausted => match self.plays[index].phase() {
                    Phase::Streaming => self.plays[index].all_sent(),
                    // The onset frame still waits for its verdict.
                    Phase::Offered => break,
                    Phase::Waiting | Phase::Streamed => {}
                },
                Fed::Horizon | Fed::Blocked => break,
                Fed::Broken => {
                    self.plays[index].cut(EndCause::BrokenStrokes);
                    self.abort(now, emit);
                    break;
                }
            }
        }
        if let Some(session) = &mut self.session {
            session.seal();
        }
    }

    /// Decides when a waiting play starts.
    fn onset_of(&self, index: usize, tick: Tick, horizon: Tick) -> Start {
        let active = &self.plays[index];
        // A play sent together with the arm was taken before the link probe measured the line.
        if self.session.as_ref().is_some_and(|session| self.margin(session, active.play()).is_err()) {
            return Start::Never(EndCause::LineTooSlow);
        }
        let mut before = self.plays.iter().take(index).rev().filter(|active| !active.is_cut());
        let previous_end = before.next().and_then(Active::end);
        match choose_onset(active, previous_end, tick) {
            Some(onset) if onset > horizon => Start::Later,
            // The play before it began later than predicted when this one was taken.
            Some(onset) if previous_end.is_some_and(|end| onset < end) => Start::Never(EndCause::OnsetMissed),
            Some(onset) => Start::At(onset),
            None => Start::Later,
        }
    }

    /// Starts to stream a play at `onset`.
    fn start(&mut self, index: usize, onset: Tick) {
        let wire = self.session.as_ref().map_or(0, |session| session.traffic().bytes_out);
        let active = &mut self.plays[index];
        active.offer(onset, wire);
        if let Some(session) = &mut self.session {
            active.board().begins(session.ask_board(), self.known.board);
            session.begin(onset, active.trigger(), active.play().hold);
        }
    }

    /// Sends strokes of one play up to the horizon, to its end, or until the session takes no more.
    fn send_steps(
        &mut self,
        now: HostInstant,
        index: usize,
        tick: Tick,
        horizon: Tick,
        emit: &mut dyn Emit,
    ) -> Fed {
        loop {
            let (Some(session), Some(active)) = (&mut self.session, self.plays.get_mut(index)) else {
                return Fed::Blocked;
            };
            // A later item begins with a frame of its own, before its first stroke is due.
            if let Some(onset) = active.next_onset() {
                if onset >= horizon {
                    (self.fed_until, self.short_of_credits) = (horizon, false);
                    return Fed::Horizon;
                }
                let accepted = active.phase() == Phase::Streaming;
                if !accepted || !session.has_room() || active.onsets_ahead(tick, MAX_ONSETS) == MAX_ONSETS {
                    self.fed_until = onset;
                    return Fed::Blocked;
                }
                session.mark(onset, active.send_next_item(), active.play().hold);
                continue;
            }
            let step = match active.next_step() {
                // All motors of a live play are silent.
                Ok(None) if active.play().live.is_some() => {
                    (self.fed_until, self.short_of_credits) = (horizon, false);
                    return Fed::Horizon;
                }
                Ok(None) => {
                    self.fed_until = self.fed_until.max(horizon);
                    return Fed::Exhausted;
                }
                Err(_) => return Fed::Broken,
                Ok(Some(step)) => step,
            };
            if step.begin() >= horizon {
                self.fed_until = horizon;
                self.short_of_credits = false;
                return Fed::Horizon;
            }
            let is_late = step.begin() < tick && active.phase() == Phase::Streaming;
            if is_late && !self.live.is_undecided(step.motor()) {
                // Too late: the device would only reject it. While it may keep the motor's old strokes, it decides whether this one
                // is missing, or an old one is played in its place.
                let cause = unsent(self.short_of_credits);
                active.plan(&step, false);
                self.late(now, &step, tick, cause, emit);
                if self.plays[index].is_cut() {
                    return Fed::Blocked;
                }
                continue;
            }
            if !session.push(&step) {
                self.short_of_credits = session.credits() < step.moves();
                if self.short_of_credits {
                    session.request_status_within(CREDITS_EVERY);
                }
                self.fed_until = step.begin();
                return Fed::Blocked;
            }
            self.control.sent(&step, !active.play().open_loop, active.until());
            active.plan(&step, true);
        }
    }
}

/// Why a stroke was not sent in time.
pub(super) const fn unsent(short_of_credits: bool) -> LateCause {
    if short_of_credits { LateCause::Device } else { LateCause::Host }
}

/// The onset of a waiting play: as asked for, at the end of the play before it, or as soon as the link allows.
fn choose_onset(active: &Active, previous_end: Option<Tick>, tick: Tick) -> Option<Tick> {
    let soonest = active.soonest(tick);
    match active.play().at {
        At::Next => Some(previous_end.map_or(soonest, |end| end.max(soonest))),
        At::Tick(_) | At::Monotonic(_) | At::After(_) | At::Edge(_) => active.onset(),
    }
}
