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
use crate::queues::{Applied, Emit, LiveResult, LiveUpdate, StreamEvent};
use crate::settings::batch_ticks;
use crate::streamer::connected::Connected;
use crate::streamer::feed::Feed;
use crate::streamer::plays::Plays;
use crate::time::HostInstant;
use firmware_protocol::array::MotorSet;
use firmware_protocol::controller::BLOCK;
use firmware_protocol::message::{Op, State};
use firmware_protocol::tick::Tick;
use meissner_api::{EndCause, LateCause};
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::{Array, MAX_MOTORS};
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

pub(super) fn is_live(active: &Active, id: u64) -> bool {
    active.play().id == id && !active.is_cut() && active.play().live.is_some()
}

/// The updates of the live play that is playing: which is under way, and which motors have it.
#[derive(Debug, Default)]
pub(super) struct Live {
    /// The play that the rest is about.
    of: Option<u64>,
    /// The update that waits, and the one under way.
    waiting: Option<Box<LiveUpdate>>,
    sent: Option<Box<LiveUpdate>>,
    /// The motors for which the device has not answered, and those whose old strokes it kept.
    unanswered: MotorSet,
    kept: MotorSet,
    /// From which tick on the last update replaced strokes.
    replaced: Tick,
    /// Room for delays, ticks: grows when a frame came too late.
    spare: u64,
    /// The refused moves that answers have told.
    refused: u64,
    /// The play ends if its client is silent until then.
    deadline: HostInstant,
}

impl Live {
    /// The motors of which the device has not said yet if it has replaced their strokes, or keeps the old ones.
    pub(super) const fn undecided(&self) -> MotorSet {
        self.unanswered
    }

    /// The same with the moves that were refused since the last answer, of so many in all.
    const fn with_refused(&mut self, applied: Applied, refused: u64) -> LiveResult {
        let new = refused.saturating_sub(self.refused);
        self.refused = refused;
        LiveResult::Applied(Applied { refused: new, ..applied })
    }

    /// Takes an update of a live play.
    pub(super) fn update(
        &mut self,
        now: HostInstant,
        mut update: Box<LiveUpdate>,
        array: Array,
        plays: &Plays,
        emit: &mut dyn Emit,
    ) {
        let fits = update.motions.len() == array.motors()
            && update.motions.iter().flatten().all(|motion| motion.array() == array);
        if !self.keep(now, update.id, plays, emit) || !fits {
            give_back(update, LiveResult::Over, emit);
            return;
        }
        if let Some(old) = self.waiting.take() {
            for (new, old) in update.motions.iter_mut().zip(&old.motions) {
                *new = new.or(*old);
            }
            let result = match old.result {
                // Some motors have it: the others get it with the newer one.
                LiveResult::Applied(applied) => LiveResult::Applied(applied.without(self.kept)),
                _ => LiveResult::Merged { into: update.number },
            };
            give_back(old, result, emit);
        }
        self.waiting = Some(update);
    }

    /// The client of a live play is there. Returns whether the play is.
    fn keep(&mut self, now: HostInstant, id: u64, plays: &Plays, emit: &mut dyn Emit) -> bool {
        let Some(active) = plays.iter().find(|active| is_live(active, id)) else { return false };
        let timeout = active.play().live.unwrap_or_default();
        self.follow(id, now, timeout, emit);
        self.deadline = now + timeout;
        true
    }

    /// Ends the live play whose client is silent, and sends the update that waits.
    pub(super) fn step(&mut self, on: &mut Connected<'_>, feed: &mut Feed, emit: &mut dyn Emit) {
        let live = on.plays.iter().position(|active| active.play().live.is_some() && !active.is_cut());
        let Some(at) = live else {
            self.forget(emit);
            return;
        };
        let (id, timeout) = (on.plays[at].play().id, on.plays[at].play().live.unwrap_or_default());
        self.follow(id, on.now, timeout, emit);
        if on.now >= self.deadline && on.operations.is_empty() {
            on.plays.cut(&EndCause::ClientSilent);
            on.order(Op::Stop, emit);
            return;
        }
        // Not before the device has reported its counters at the onset: what is replaced until then would count as before it.
        let active = &on.plays[at];
        let begun = active.phase() == Phase::Streaming && active.started().is_some();
        let streams = begun && on.state == State::Armed;
        if streams && on.operations.is_empty() && self.sent.is_none() {
            self.send_update(on, feed, at, emit);
        }
    }

    /// From here on the updates are of this play. Updates that are left from another play are given back.
    fn follow(&mut self, id: u64, now: HostInstant, timeout: Duration, emit: &mut dyn Emit) {
        if self.of != Some(id) {
            self.forget(emit);
            self.of = Some(id);
            self.deadline = now + timeout.max(CONNECTS_WITHIN);
        }
    }

    /// Gives back the updates of a play that is over.
    pub(super) fn forget(&mut self, emit: &mut dyn Emit) {
        let Live { waiting, sent, .. } = std::mem::take(self);
        for update in [sent, waiting].into_iter().flatten() {
            give_back(update, LiveResult::Over, emit);
        }
    }

    /// Sends the update that waits, and again the drives of motors whose old strokes the device kept.
    fn send_update(&mut self, on: &mut Connected<'_>, feed: &mut Feed, at: usize, emit: &mut dyn Emit) {
        if !on.session.has_room() {
            return;
        }
        let (array, rate, tick) = (on.settings.array, on.rate(), on.tick);
        // What the device has rendered when the frame arrives, and the start of its drivers.
        let ahead = u64::from(array.layout().horizon()) + u64::from(BLOCK) + wake_up(rate);
        let delivery = rate.duration_to_ticks(on.session.delivery());
        let from = tick + ahead + delivery + self.spare.max(wake_up(rate));
        // A stroke before the last update's tick may belong to the drive before that one: it stays. Beyond what is sent there is
        // nothing to replace: the new strokes follow. If the link has been blocked for longer, what was due until now is missed.
        let from = from.max(self.replaced).min(feed.until().max(tick));
        let Some(mut update) = self.waiting.take() else { return };
        self.miss_strokes(on, feed, at, from, emit);
        let active = &mut on.plays[at];
        if active.is_cut() {
            self.waiting = Some(update);
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
        let mut changed = self.kept;
        array.numbers().filter(|&motor| changes(motor)).for_each(|motor| changed.insert(motor));
        let mut applied = match update.result {
            LiveResult::Applied(applied) => {
                Applied { repeats: applied.repeats + 1, replaced: from, ..applied }
            }
            _ => {
                let received = on.session.clock().tick_at(update.received_at).unwrap_or(tick);
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
            give_back(update, self.with_refused(applied, refused), emit);
            return;
        }
        let horizon = tick + rate.ms_in_ticks(on.settings.lead_ms) as u64 + batch_ticks(on.settings);
        let mut silent = MotorSet::EMPTY;
        for motor in changed.iter() {
            let motion = update.motions[usize::from(motor)].unwrap_or_else(|| strokes.motion(motor));
            applied.motors[usize::from(motor)] = Some(strokes.replace(motor, motion, from));
            if strokes.next_up(motor).is_none_or(|up| up >= horizon) {
                silent.insert(motor);
            }
        }
        on.session.replace(from, changed, silent);
        on.control.replace(changed, from);
        push_firsts(on, at, changed.without(silent));
        feed.back_to(from);
        update.result = LiveResult::Applied(applied);
        self.sent = Some(update);
        self.replaced = from;
        (self.unanswered, self.kept) = (changed, MotorSet::EMPTY);
    }

    /// Counts as late the strokes before `from` that were not sent. They were due while the link was blocked, or they follow the
    /// old strokes of a motor that the device kept: since it was asked to replace these, it takes none.
    fn miss_strokes(&self, on: &mut Connected<'_>, feed: &Feed, at: usize, from: Tick, emit: &mut dyn Emit) {
        let active = &mut on.plays[at];
        active.put_back_next();
        for motor in on.settings.array.numbers() {
            let cause = if self.kept.contains(motor) { LateCause::Link } else { feed.unsent() };
            loop {
                let active = &mut on.plays[at];
                let Some(strokes) = active.live_strokes() else { return };
                let missed = strokes.next_up(motor).filter(|&up| up < from);
                let Some(Ok(step)) = missed.and_then(|_| strokes.next_of(motor)) else { break };
                active.plan(&step, false);
                on.late(&step, from, cause, emit);
            }
        }
    }

    /// The device has answered a frame of the update under way.
    pub(super) fn replaced(
        &mut self,
        motors_done: MotorSet,
        kept: MotorSet,
        plays: &mut Plays,
        rate: TickRate,
        emit: &mut dyn Emit,
    ) {
        let of = self.of;
        let Some(active) = plays.iter_mut().find(|active| of.is_some_and(|id| is_live(active, id))) else {
            return;
        };
        active.put_back_next();
        if let Some(strokes) = active.live_strokes() {
            kept.iter().for_each(|motor| strokes.revert(motor));
        }
        let refused = active.refused_so_far();
        let (least_spare, most_spare) = (wake_up(rate), rate.of_ms(MOST_SPARE_MS));
        self.unanswered = self.unanswered.without(motors_done | kept);
        self.kept |= kept;
        if !self.unanswered.is_empty() {
            return;
        }
        let Some(mut update) = self.sent.take() else { return };
        if self.kept.is_empty() {
            self.spare = (self.spare / 2).max(least_spare);
            let result = match update.result {
                LiveResult::Applied(applied) => self.with_refused(applied, refused),
                result => result,
            };
            give_back(update, result, emit);
            return;
        }
        self.spare = (2 * self.spare).clamp(least_spare, most_spare);
        match &mut self.waiting {
            // The newer one has the motors' drives, or takes over these.
            Some(newer) => {
                let LiveResult::Applied(applied) = update.result else { return };
                for motor in self.kept.iter().map(usize::from) {
                    newer.motions[motor] = newer.motions[motor].or(update.motions[motor]);
                }
                let applied = applied.without(self.kept);
                give_back(update, self.with_refused(applied, refused), emit);
            }
            None => {
                // Of the others the result is known.
                for (motion, motor) in update.motions.iter_mut().zip(0..) {
                    if !self.kept.contains(motor) {
                        *motion = None;
                    }
                }
                self.waiting = Some(update);
            }
        }
    }
}

/// Sends the first stroke of each of these motors, in one frame or two: with it the device withdraws the motor's old ones.
fn push_firsts(on: &mut Connected<'_>, at: usize, of: MotorSet) {
    let active = &mut on.plays[at];
    let Some(strokes) = active.live_strokes() else { return };
    let ups = of.iter().filter_map(|motor| Some((strokes.next_up(motor)?, motor)));
    let mut firsts: heapless::Vec<(Tick, u8), MAX_MOTORS> = ups.collect();
    firsts.sort_unstable();
    let mut pushed = heapless::Vec::<Step, MAX_MOTORS>::new();
    for (_, motor) in firsts {
        // A stroke that breaks a limit is found again by the feed, which ends the play.
        let Some(Ok(step)) = strokes.next_of(motor) else { continue };
        if !on.session.push(&step) {
            strokes.put_back(&step);
            break;
        }
        let _ = pushed.push(step);
    }
    for step in pushed {
        on.control.sent(&step, !active.play().open_loop, active.until());
        active.plan(&step, true);
    }
}

fn give_back(mut update: Box<LiveUpdate>, result: LiveResult, emit: &mut dyn Emit) {
    update.result = result;
    emit.event(StreamEvent::LiveUpdated(update));
}
