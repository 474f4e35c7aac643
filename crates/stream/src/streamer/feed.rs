//! Sends strokes to the device ahead of time, and chooses the onset of each play.
//!
//! [`Feed::feed`] runs at each step. It sends in batches, so that a frame carries many strokes, and at least the lead
//! ahead of now.
//!
//! Invariant: nothing follows a play's first frame before the device has accepted it.

use crate::active::{Active, FIRST_MARGIN, Phase};
use crate::control::PositionControl;
use crate::link::Session;
use crate::queues::{At, CommandError, Emit, Play};
use crate::settings::batch_ticks;
use crate::streamer::connected::Connected;
use crate::streamer::known::Known;
use firmware_protocol::array::MotorSet;
use firmware_protocol::message::State;
use firmware_protocol::tick::Tick;
use meissner_api::{EndCause, LateCause};
use std::time::Duration;

/// The host polls a full device this often. Its strokes last longer, and keep-alives may be seconds apart.
const CREDITS_EVERY: Duration = Duration::from_millis(50);

/// Onsets of items that are sent ahead of their time, at most: the device keeps 8, and takes no frame beyond them.
const MAX_ONSETS: usize = 7;

/// The part of the first margin for the render horizon and a wake-up, not for the link.
const WAKE_UP: Duration = Duration::from_micros(1500);

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

/// How far strokes are sent.
#[derive(Debug, Default)]
pub(super) struct Feed {
    /// Up to this tick.
    until: Tick,
    /// The next stroke waits for credits.
    short_of_credits: bool,
}

impl Feed {
    pub(super) const fn until(&self) -> Tick {
        self.until
    }

    pub(super) const fn is_short_of_credits(&self) -> bool {
        self.short_of_credits
    }

    /// Strokes from `tick` on are to be sent again.
    pub(super) const fn back_to(&mut self, tick: Tick) {
        self.until = tick;
    }

    /// Why a stroke was not sent in time.
    pub(super) const fn unsent(&self) -> LateCause {
        if self.short_of_credits { LateCause::Device } else { LateCause::Host }
    }

    /// Sends all strokes due. The device has not said yet whether it keeps the old strokes of the `undecided` motors.
    pub(super) fn feed(&mut self, on: &mut Connected<'_>, undecided: MotorSet, emit: &mut dyn Emit) {
        if on.state != State::Armed || !on.operations.is_empty() {
            return;
        }
        let lead = on.rate().ms_in_ticks(on.settings.lead_ms) as u64;
        let batch = batch_ticks(on.settings);
        let mut unfed =
            on.plays.iter().filter(|active| !active.is_cut() && active.phase() != Phase::Streamed);
        let fresh = unfed.next().is_some_and(|active| active.phase() == Phase::Waiting);
        let blocked = !on.session.has_room();
        if blocked || (!fresh && self.until >= on.tick + lead) {
            return;
        }
        let horizon = on.tick + lead + batch;
        for index in 0..on.plays.len() {
            let active = &on.plays[index];
            match active.phase() {
                _ if active.is_cut() => continue,
                Phase::Streamed => continue,
                Phase::Offered => break,
                Phase::Streaming => {}
                Phase::Waiting => match onset_of(on, index, horizon) {
                    Start::At(onset) => start(on, index, onset),
                    Start::Later => break,
                    Start::Never(why) => {
                        on.plays[index].cut_unsent(why);
                        continue;
                    }
                },
            }
            match self.send_steps(on, index, horizon, undecided, emit) {
                Fed::Exhausted => match on.plays[index].phase() {
                    Phase::Streaming => on.plays[index].all_sent(),
                    // The onset frame still waits for its verdict.
                    Phase::Offered => break,
                    Phase::Waiting | Phase::Streamed => {}
                },
                Fed::Horizon | Fed::Blocked => break,
                Fed::Broken => {
                    on.plays[index].cut(EndCause::BrokenStrokes);
                    on.abort(emit);
                    break;
                }
            }
        }
        on.session.seal();
    }

    /// Sends strokes of one play up to the horizon, to its end, or until the session takes no more.
    fn send_steps(
        &mut self,
        on: &mut Connected<'_>,
        index: usize,
        horizon: Tick,
        undecided: MotorSet,
        emit: &mut dyn Emit,
    ) -> Fed {
        loop {
            let active = &mut on.plays[index];
            // A later item begins with a frame of its own, before its first stroke is due.
            if let Some(onset) = active.next_onset() {
                if onset >= horizon {
                    *self = Self { until: horizon, short_of_credits: false };
                    return Fed::Horizon;
                }
                let accepted = active.phase() == Phase::Streaming;
                if !accepted
                    || !on.session.has_room()
                    || active.onsets_ahead(on.tick, MAX_ONSETS) == MAX_ONSETS
                {
                    self.until = onset;
                    return Fed::Blocked;
                }
                on.session.mark(onset, active.send_next_item(), active.play().hold);
                continue;
            }
            let step = match active.next_step() {
                // All motors of a live play are silent.
                Ok(None) if active.play().live.is_some() => {
                    *self = Self { until: horizon, short_of_credits: false };
                    return Fed::Horizon;
                }
                Ok(None) => {
                    self.until = self.until.max(horizon);
                    return Fed::Exhausted;
                }
                Err(_) => return Fed::Broken,
                Ok(Some(step)) => step,
            };
            if step.begin() >= horizon {
                *self = Self { until: horizon, short_of_credits: false };
                return Fed::Horizon;
            }
            let is_late = step.begin() < on.tick && active.phase() == Phase::Streaming;
            if is_late && !undecided.contains(step.motor()) {
                // Too late: the device would only reject it. While it may keep the motor's old strokes, it decides whether this one
                // is missing, or an old one is played in its place.
                active.plan(&step, false);
                on.late(&step, on.tick, self.unsent(), emit);
                if on.plays[index].is_cut() {
                    return Fed::Blocked;
                }
                continue;
            }
            if !on.session.push(&step) {
                self.short_of_credits = on.session.credits() < step.moves();
                if self.short_of_credits {
                    on.session.request_status_within(CREDITS_EVERY);
                }
                self.until = step.begin();
                return Fed::Blocked;
            }
            on.control.sent(&step, !active.play().open_loop, active.until());
            active.plan(&step, true);
        }
    }
}

/// How long before its onset a play must be sent.
///
/// # Errors
/// If the line does not carry the play.
pub(super) fn margin(
    session: &Session,
    play: &Play,
    control: &PositionControl,
    known: &Known,
) -> Result<Duration, CommandError> {
    let closed_loop = !play.open_loop && control.corrects(known.telemetry);
    let required = if closed_loop { play.bandwidth.closed } else { play.bandwidth.open };
    let (needs, frames) = (required.rate, required.frames);
    let Some((carries, waits)) = session.rate_beside(frames) else { return Ok(FIRST_MARGIN) };
    let left = (f64::from(carries) * (1.0 - waits)) as u32;
    if needs > left {
        let waits = (100.0 * waits).round() as u32;
        return Err(CommandError::LineTooSlow { needs, frames, carries, waits });
    }
    // There is no lead yet: two slow answers in a row must not delay what follows the first frame.
    let waiting = 2 * session.ack_wait().unwrap_or_default();
    Ok(FIRST_MARGIN.max(WAKE_UP + waiting + required.ahead(left)))
}

/// Decides when a waiting play starts.
fn onset_of(on: &Connected<'_>, index: usize, horizon: Tick) -> Start {
    let active = &on.plays[index];
    // A play sent together with the arm was taken before the link probe measured the line.
    if margin(on.session, active.play(), on.control, on.known).is_err() {
        return Start::Never(EndCause::LineTooSlow);
    }
    let mut before = on.plays.iter().take(index).rev().filter(|active| !active.is_cut());
    let previous_end = before.next().and_then(Active::end);
    match choose_onset(active, previous_end, on.tick) {
        Some(onset) if onset > horizon => Start::Later,
        // The play before it began later than predicted when this one was taken.
        Some(onset) if previous_end.is_some_and(|end| onset < end) => Start::Never(EndCause::OnsetMissed),
        Some(onset) => Start::At(onset),
        None => Start::Later,
    }
}

/// Starts to stream a play at `onset`.
fn start(on: &mut Connected<'_>, index: usize, onset: Tick) {
    let active = &mut on.plays[index];
    active.offer(onset, on.session.traffic().bytes_out);
    active.board().begins(on.session.ask_board(), on.known.board);
    on.session.begin(onset, active.trigger(), active.play().hold);
}

/// The onset of a waiting play: as asked for, at the end of the play before it, or as soon as the link allows.
fn choose_onset(active: &Active, previous_end: Option<Tick>, tick: Tick) -> Option<Tick> {
    let soonest = active.soonest(tick);
    match active.play().at {
        At::Next => Some(previous_end.map_or(soonest, |end| end.max(soonest))),
        At::Tick(_) | At::Monotonic(_) | At::After(_) | At::Edge(_) => active.onset(),
    }
}
