//! Feeding: which strokes go to the device now, and at which onset a play begins.
//!
//! Strokes are handed over in stretches (`batch`), so that a frame carries many, and always at least the lead
//! ahead. A play's first frame waits for the device's verdict before anything follows.

use crate::active::{Active, Phase};
use crate::batch_ticks;
use crate::queues::{At, End};
use crate::streamer::{Streamer, Tell};
use crate::time::HostInstant;
use firmware_protocol::message::State;
use firmware_protocol::tick::Tick;
use meissner_api::LateCause;
use meissner_array::units::{duration_to_ticks, ms_in_ticks};
use std::time::Duration;

/// A device that was full is asked for room so often. Its strokes last for longer, and keep-alives may be seconds apart.
const CREDITS_EVERY: Duration = Duration::from_millis(50);

/// What came of trying to hand over strokes.
enum Fed {
    /// All up to the horizon.
    Horizon,
    /// The play has no more.
    Exhausted,
    /// The session takes no more for now.
    Blocked,
    /// The compiler's own check failed.
    Broken,
}

impl Streamer {
    /// Hands over all strokes due at `tick`.
    pub(super) fn feed(&mut self, now: HostInstant, tick: Tick, tell: Tell<'_>) {
        let Some(session) = &self.session else { return };
        if self.state() != State::Armed || !self.may_feed() {
            return;
        }
        let lead = ms_in_ticks(self.settings.lead_ms) as u64;
        let batch = batch_ticks(&self.settings);
        let mut unfed =
            self.plays.iter().filter(|active| active.cut.is_none() && active.phase != Phase::Streamed);
        let fresh = unfed.next().is_some_and(|active| active.phase == Phase::Waiting);
        let blocked = !session.has_room();
        if blocked || (!fresh && self.fed >= tick + lead) {
            return;
        }
        let horizon = tick + lead + batch;
        for index in 0..self.plays.len() {
            let mut before = self.plays.iter().take(index).rev().filter(|active| active.cut.is_none());
            let previous_end = before.next().and_then(Active::end);
            let wire = self.session.as_ref().map_or(0, |session| session.traffic().bytes_out);
            let carried = session_carries(self, index);
            let active = &mut self.plays[index];
            if active.cut.is_some() || active.phase == Phase::Streamed {
                continue;
            }
            if active.phase == Phase::Waiting && !carried {
                // Ordered together with the arm, before the line was measured.
                active.cut = Some((End::Aborted, "the line does not carry the pattern"));
                active.onset = None;
                continue;
            }
            if active.phase == Phase::Offered {
                break;
            }
            if active.phase == Phase::Waiting {
                let Some(onset) = choose_onset(active, previous_end, tick) else { break };
                if onset > horizon {
                    break;
                }
                if previous_end.is_some_and(|end| onset < end) {
                    // The play before it began later than could be known when this one was taken.
                    active.cut = Some((End::Aborted, "the onset could not be kept"));
                    active.onset = None;
                    continue;
                }
                active.offer(onset, wire);
                if let Some(session) = &mut self.session {
                    session.begin(onset);
                }
            }
            match self.hand_over(now, index, tick, horizon, tell) {
                Fed::Exhausted => {
                    // The onset frame still waits for its verdict: it is not streaming yet.
                    if self.plays[index].phase == Phase::Streaming {
                        self.plays[index].phase = Phase::Streamed;
                    }
                    if self.plays[index].phase == Phase::Offered {
                        break;
                    }
                }
                Fed::Horizon | Fed::Blocked => break,
                Fed::Broken => {
                    let cut = (
                        End::Aborted,
                        "the compiled strokes failed their own check: a bug, please report it",
                    );
                    self.plays[index].cut = Some(cut);
                    self.abort(now, tell);
                    break;
                }
            }
        }
        if let Some(session) = &mut self.session {
            session.seal();
        }
    }

    /// Hands over strokes of one play until the horizon, its end, or until the session takes no more.
    fn hand_over(
        &mut self,
        now: HostInstant,
        index: usize,
        tick: Tick,
        horizon: Tick,
        tell: Tell<'_>,
    ) -> Fed {
        loop {
            let (Some(session), Some(active)) = (&mut self.session, self.plays.get_mut(index)) else {
                return Fed::Blocked;
            };
            if active.next.is_none() {
                active.next = match active.play.strokes.next() {
                    None => {
                        self.fed = self.fed.max(horizon);
                        return Fed::Exhausted;
                    }
                    Some(Err(_)) => return Fed::Broken,
                    Some(Ok(stroke)) => Some(stroke),
                };
            }
            let Some(stroke) = active.next else { continue };
            if stroke.up >= horizon {
                self.fed = horizon;
                self.short_of_credits = false;
                return Fed::Horizon;
            }
            if stroke.up < tick && active.phase == Phase::Streaming {
                // The device could only say that it is late: not worth its bytes.
                let cause = if self.short_of_credits { LateCause::Device } else { LateCause::Host };
                active.plan(&stroke);
                active.next = None;
                self.late(now, &stroke, tick, cause, tell);
                if self.plays[index].cut.is_some() {
                    return Fed::Blocked;
                }
                continue;
            }
            if !session.push(&stroke) {
                self.short_of_credits = session.credits() == 0;
                if self.short_of_credits {
                    session.request_status_within(CREDITS_EVERY);
                }
                self.fed = stroke.up;
                return Fed::Blocked;
            }
            let until = active.end().unwrap_or(Tick(u64::MAX));
            self.control.sent(&stroke, !active.play.open_loop, until);
            active.plan(&stroke);
            active.undecided += 1;
            active.next = None;
        }
    }
}

/// Whether the line carries a play, as far as is known.
fn session_carries(streamer: &Streamer, index: usize) -> bool {
    let play = streamer.plays.get(index).map(|active| &active.play);
    let both = streamer.session.as_ref().zip(play);
    both.is_none_or(|(session, play)| streamer.margin(session, play).is_ok())
}

/// Where a play that waits can begin: as asked for, right behind the one before it, or as soon as the link allows.
fn choose_onset(active: &Active, previous_end: Option<Tick>, tick: Tick) -> Option<Tick> {
    let soonest = tick + duration_to_ticks(active.margin);
    match active.play.at {
        At::Next => Some(previous_end.map_or(soonest, |end| end.max(soonest))),
        At::Tick(_) | At::After(_) => active.onset,
    }
}
