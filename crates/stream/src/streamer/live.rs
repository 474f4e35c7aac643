//! Live plays: replaces strokes on the device by those of the newest update.
//!
//! One update is under way at a time; those that come meanwhile are merged into one that waits, the newest drive of each motor wins.
//! The device withdraws a motor's strokes from a tick a few milliseconds ahead and queues the new ones, or, if the frame comes
//! too late, keeps the old ones; then the motor's update is sent again, farther ahead.
//!
//! A live play is always alone: it is not queued, and nothing is queued behind it.
//!
//! Invariant: an update that is taken comes back in one [`StreamEvent::LiveUpdated`], at the latest when its play ends.

use crate::active::{Active, Phase};
use crate::queues::{Applied, CommandError, Emit, LiveResult, LiveUpdate, StreamEvent};
use crate::settings::batch_ticks;
use crate::streamer::Streamer;
use crate::streamer::feed::unsent;
use crate::streamer::updates::Live;
use crate::time::HostInstant;
use firmware_protocol::array::MotorSet;
use firmware_protocol::controller::BLOCK;
use firmware_protocol::message::{Op, State};
use firmware_protocol::tick::Tick;
use meissner_api::{EndCause, LateCause};
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::MAX_MOTORS;
use meissner_array::strokes::{LiveMotion, Step};
use meissner_array::units::TickRate;
use std::time::Duration;

/// A quarter of a millisecond, ticks: room for a wake-up, and the least room for delays.
fn wake_up(rate: TickRate) -> u64 {
    rate.of_ms(1) / 4
}
/// How much farther ahead at most, after frames that came too late, ms.
const MOST_SPARE_MS: u64 = 50;
/// A client has so long to send its first update.
const CONNECTS_WITHIN: Duration = Duration::from_secs(2);

fn is_live(active: &Active, id: u64) -> bool {
    active.play().id == id && !active.is_cut() && active.play().live.is_some()
}

impl Streamer {
    /// Takes an update of a live play.
    pub(super) fn update_live(&mut self, now: HostInstant, update: Box<LiveUpdate>, emit: &mut dyn Emit) {
        let array = self.array();
        let fits = update.motions.len() == array.motors()
            && update.motions.iter().flatten().all(|motion| motion.array() == array);
        if !self.keep_live(now, update.id, emit) || !fits {
            give_back(update, LiveResult::Over, emit);
            return;
        }
        let mut update = update;
        if let Some(old) = self.live.waiting.take() {
            for (new, old) in update.motions.iter_mut().zip(&old.motions) {
                *new = new.or(*old);
            }
            let result = match old.result {
                // Some motors have it: the others get it with the newer one.
                LiveResult::Applied(applied) => LiveResult::Applied(applied.without(self.live.kept)),
                _ => LiveResult::Merged { into: update.number },
            };
            give_back(old, result, emit);
        }
        self.live.waiting = Some(update);
    }

    /// The client of a live play is there. Returns whether the play is.
    pub(super) fn keep_live(&mut self, now: HostInstant, id: u64, emit: &mut dyn Emit) -> bool {
        let Some(active) = self.plays.iter().find(|active| is_live(active, id)) else { return false };
        let timeout = active.play().live.unwrap_or_default();
        self.follow(id, now, timeout, emit);
        self.live.deadline = now + timeout;
        true
    }

    /// Ends a live play for its client.
    pub(super) fn end_live(&mut self, id: u64) -> Result<Option<Op>, CommandError> {
        if !self.plays.iter().any(|active| is_live(active, id)) {
            return Ok(None);
        }
        self.cut_all(EndCause::Stop);
        Ok(Some(Op::Stop))
    }

    /// Ends the live play whose client is silent, and sends the update that waits.
    pub(super) fn step_live(&mut self, now: HostInstant, tick: Tick, emit: &mut dyn Emit) {
        let Some(at) = self.plays.iter().position(|active| active.play().live.is_some() && !active.is_cut())
        else {
            self.forget_live(emit);
            return;
        };
        let (id, timeout) = (self.plays[at].play().id, self.plays[at].play().live.unwrap_or_default());
        self.follow(id, now, timeout, emit);
        if now >= self.live.deadline && self.operations.is_empty() {
            self.cut_all(EndCause::ClientSilent);
            self.queue_op(now, 0, Op::Stop, emit);
            return;
        }
        // Not before the device has reported its counters at the onset: what is replaced until then would count as before it.
        let active = &self.plays[at];
        let begun = active.phase() == Phase::Streaming && active.started().is_some();
        let streams = begun && self.state() == State::Armed;
        if streams && self.operations.is_empty() && self.live.sent.is_none() {
            self.send_update(now, at, tick, emit);
        }
    }

    /// From here on the updates are of this play. Updates that are left from another play are given back.
    fn follow(&mut self, id: u64, now: HostInstant, timeout: Duration, emit: &mut dyn Emit) {
        if self.live.of != Some(id) {
            self.forget_live(emit);
            self.live.of = Some(id);
            self.live.deadline = now + timeout.max(CONNECTS_WITHIN);
        }
    }

    /// Gives back the updates of a play that is over.
    pub(super) fn forget_live(&mut self, emit: &mut dyn Emit) {
        let Live { waiting, sent, .. } = std::mem::take(&mut self.live);
        for update in [sent, waiting].into_iter().flatten() {
            give_back(update, LiveResult::Over, emit);
        }
    }

    /// Sends the update that waits, and again the drives of motors whose old strokes the device kept.
    fn send_update(&mut self, now: HostInstant, at: usize, tick: Tick, emit: &mut dyn Emit) {
        let Some(session) = self.session.as_ref().filter(|session| session.has_room()) else { return };
        let (array, rate) = (self.array(), self.rate());
        // What the device has rendered when the frame arrives, and the start of its drivers.
        let ahead = u64::from(array.layout().horizon()) + u64::from(BLOCK) + wake_up(rate);
        let delivery = rate.duration_to_ticks(session.delivery());
        let from = tick + ahead + delivery + self.live.spare.max(wake_up(rate));
        // A stroke before the last update's tick may belong to the drive before that one: it stays. Beyond what is sent there is
        // nothing to replace: the new strokes follow. If the link has been blocked for longer, what was due until now is missed.
        let from = from.max(self.live.replaced).min(self.fed_until.max(tick));
        let Some(mut update) = self.live.waiting.take() else { return };
        self.miss_strokes(now, at, from, emit);
        let (Some(session), active) = (&mut self.session, &mut self.plays[at]) else { return };
        if active.is_cut() {
            self.live.waiting = Some(update);
            return;
        }
        let refused = active.refused_so_far();
        let Some(strokes) = active.live_strokes() else { return };
        let from = from.max(strokes.onset());
        // What the device does not hold must be sent, even if it is as before.
        let changes = |motor: u8| {
            let is_level = |motion: &LiveMotion| matches!(motion, LiveMotion::Level { .. });
            update.motions[usize::from(motor)]
                .is_some_and(|new| is_level(&new) || new != strokes.motion(motor))
        };
        let mut changed = self.live.kept;
        array.numbers().filter(|&motor| changes(motor)).for_each(|motor| changed.insert(motor));
        let mut applied = match update.result {
            LiveResult::Applied(applied) => {
                Applied { repeats: applied.repeats + 1, replaced: from, ..applied }
            }
            _ => {
                let received = session.clock().tick_at(update.received_at).unwrap_or(tick);
                Applied {
                    received,
                    replaced: from,
                    motors: PerMotor::all(array, None),
                    repeats: 0,
                    refused: 0,
                }
            }
        };
        if changed.is_empty() {
            give_back(update, self.live.with_refused(applied, refused), emit);
            return;
        }
        let horizon = tick + rate.ms_in_ticks(self.settings.lead_ms) as u64 + batch_ticks(&self.settings);
        let mut silent = MotorSet::EMPTY;
        for motor in changed.iter() {
            let motion = update.motions[usize::from(motor)].unwrap_or_else(|| strokes.motion(motor));
            applied.motors[usize::from(motor)] = Some(strokes.replace(motor, motion, from));
            if strokes.next_up(motor).is_none_or(|up| up >= horizon) {
                silent.insert(motor);
            }
        }
        session.replace(from, changed, silent);
        self.control.replace(changed, from);
        self.push_firsts(at, changed.without(silent));
        self.fed_until = from;
        update.result = LiveResult::Applied(applied);
        self.live.sent = Some(update);
        self.live.replaced = from;
        (self.live.unanswered, self.live.kept) = (changed, MotorSet::EMPTY);
    }

    /// Sends the first stroke of each of these motors, in one frame or two: with it the device withdraws the motor's old ones.
    fn push_firsts(&mut self, at: usize, of: MotorSet) {
        let (Some(session), active) = (&mut self.session, &mut self.plays[at]) else { return };
        let Some(strokes) = active.live_strokes() else { return };
        let ups = of.iter().filter_map(|motor| Some((strokes.next_up(motor)?, motor)));
        let mut firsts: heapless::Vec<(Tick, u8), MAX_MOTORS> = ups.collect();
        firsts.sort_unstable();
        let mut pushed = heapless::Vec::<Step, MAX_MOTORS>::new();
        for (_, motor) in firsts {
            // A stroke that breaks a limit is found again by the feed, which ends the play.
            let Some(Ok(step)) = strokes.next_of(motor) else { continue };
            if !session.push(&step) {
                strokes.put_back(&step);
                break;
            }
            let _ = pushed.push(step);
        }
        for step in pushed {
            self.control.sent(&step, !active.play().open_loop, active.until());
            active.plan(&step, true);
        }
    }

    /// Counts as late the strokes before `from` that were not sent. They were due while the link was blocked, or they follow the
    /// old strokes of a motor that the device kept: since it was asked to replace these, it takes none.
    fn miss_strokes(&mut self, now: HostInstant, at: usize, from: Tick, emit: &mut dyn Emit) {
        let active = &mut self.plays[at];
        active.put_back_next();
        for motor in self.array().numbers() {
            let cause =
                if self.live.kept.contains(motor) { LateCause::Link } else { unsent(self.short_of_credits) };
            loop {
                let active = &mut self.plays[at];
                let Some(strokes) = active.live_strokes() else { return };
                let missed = strokes.next_up(motor).filter(|&up| up < from);
                let Some(Ok(step)) = missed.and_then(|_| strokes.next_of(motor)) else { break };
                active.plan(&step, false);
                self.late(now, &step, from, cause, emit);
            }
        }
    }

    /// The device has answered a frame of the update under way.
    pub(super) fn replaced(&mut self, motors_done: MotorSet, kept: MotorSet, emit: &mut dyn Emit) {
        self.control.replaced(motors_done, kept);
        let of = self.live.of;
        let Some(active) = self.plays.iter_mut().find(|active| of.is_some_and(|id| is_live(active, id)))
        else {
            return;
        };
        active.put_back_next();
        if let Some(strokes) = active.live_strokes() {
            kept.iter().for_each(|motor| strokes.revert(motor));
        }
        let refused = active.refused_so_far();
        let rate = self.rate();
        let (least_spare, most_spare) = (wake_up(rate), rate.of_ms(MOST_SPARE_MS));
        let live = &mut self.live;
        live.unanswered = live.unanswered.without(motors_done | kept);
        live.kept |= kept;
        if !live.unanswered.is_empty() {
            return;
        }
        let Some(mut update) = live.sent.take() else { return };
        if live.kept.is_empty() {
            live.spare = (live.spare / 2).max(least_spare);
            let result = match update.result {
                LiveResult::Applied(applied) => live.with_refused(applied, refused),
                result => result,
            };
            give_back(update, result, emit);
            return;
        }
        live.spare = (2 * live.spare).clamp(least_spare, most_spare);
        match &mut live.waiting {
            // The newer one has the motors' drives, or takes over these.
            Some(newer) => {
                let LiveResult::Applied(applied) = update.result else { return };
                for motor in live.kept.iter().map(usize::from) {
                    newer.motions[motor] = newer.motions[motor].or(update.motions[motor]);
                }
                let applied = applied.without(live.kept);
                give_back(update, live.with_refused(applied, refused), emit);
            }
            None => {
                // Of the others the result is known.
                for (motion, motor) in update.motions.iter_mut().zip(0..) {
                    if !live.kept.contains(motor) {
                        *motion = None;
                    }
                }
                live.waiting = Some(update);
            }
        }
    }
}

fn give_back(mut update: Box<LiveUpdate>, result: LiveResult, emit: &mut dyn Emit) {
    update.result = result;
    emit.event(StreamEvent::LiveUpdated(update));
}
