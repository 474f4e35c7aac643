//! The moves that the device has accepted, and what interrupts them: read off the link in order.

use crate::oracle::expected::{CutAt, Expected};
use crate::tap::{Batch, Event, Tap};
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::Amendment;
use firmware_protocol::limits::{PowerLimits, Refusal, within_correction};
use firmware_protocol::message::{Cause, Cut, LowerStop, MarkKind, Op, Report, State};
use firmware_protocol::moves::Move;
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_test_support::paper::MOTORS;

/// A move that was sent.
#[derive(Clone, Debug)]
pub(super) struct Live {
    pub(super) to: Move,
    /// The level of the motor's move before it.
    pub(super) from: u16,
    /// It is the second move of a stroke; it belongs to one.
    pub(super) joined: bool,
    pub(super) of_stroke: bool,
    /// The tick by which it is withdrawn: its own, or that of the first move of its stroke.
    since: Tick,
    /// The number of the event that brought it.
    pub(super) order: usize,
    frame: (u16, u16),
    /// It does not repeat the level before it: the drivers are enabled for it.
    pub(super) drives: bool,
    /// The new number of pulses that an amendment gives it.
    pub(super) amended: Option<u16>,
    /// A verdict says that it was late, although its motor takes moves.
    pub(super) late: bool,
    /// It was not accepted.
    dropped: bool,
    /// Why it was refused as it began.
    pub(super) refused: Option<Refusal>,
    /// When a cut has flushed it.
    pub(super) flushed: Option<Tick>,
    /// The frames that withdraw it, with the cycle at which each was sent. A verdict may say that a frame kept it.
    withdrawn: Vec<((u16, u16), u64)>,
}

impl Live {
    /// Whether it was queued until it began or was flushed.
    pub(super) fn is_queued(&self) -> bool {
        !self.late && !self.dropped && self.withdrawn.is_empty()
    }

    pub(super) fn begins(&self) -> bool {
        self.is_queued() && self.flushed.is_none() && self.refused.is_none()
    }
}

/// What happens beside moves.
#[derive(Clone, Debug)]
pub(super) enum Step {
    /// An arming: the limits, and whether all pins count as at rest.
    Arm(PowerLimits, bool),
    /// The device has lowered goals by itself: by late moves, and because pins were held for too long. Its report is the event of this
    /// number.
    Lower { late: MotorSet, held: MotorSet, order: usize },
    /// A return, an arming that brings pins down, a seek by so many pulses (and whether positions were known before), or the end of all.
    Cut(CutAt, Option<(u16, bool)>),
}

#[derive(Clone, Debug, Default)]
pub(super) struct Plan {
    pub(super) moves: Vec<Live>,
    /// In order of time.
    pub(super) steps: Vec<(Tick, Step)>,
    /// For how many ticks plays let pins be held, and from when on.
    pub(super) holds: Vec<(Tick, u32)>,
    pub(super) out: Expected,
    /// Pulses of the seek that the last command asks for.
    seek: u16,
    /// The last arm named a lower stop.
    has_stop: bool,
    position_known: bool,
    /// The last epoch that the device has reported, and that of the last command.
    epoch: u16,
    asked: u16,
    opened: usize,
    /// A tick that has passed.
    passed: Tick,
    /// Motors whose old moves a frame has kept.
    kept: Vec<((u16, u16), MotorSet)>,
    /// The commands and their events.
    controls: Vec<(usize, Op)>,
}

impl Plan {
    pub(super) fn of(tap: &Tap) -> Self {
        let mut plan = Self::default();
        for (order, (cycle, event)) in tap.events.iter().enumerate() {
            plan.take(tap, order, *cycle, event);
        }
        for motor in 0..MOTORS as u8 {
            let mut before = (0, None);
            for at in plan.queue(motor) {
                let Live { to, flushed, of_stroke, .. } = plan.moves[at];
                let from = if before.1 == flushed || before.1.is_none() { before.0 } else { 0 };
                plan.moves[at].drives = of_stroke || to.surplus > 0 || to.level != from;
                before = (to.level, flushed);
            }
        }
        plan.steps.sort_by_key(|&(tick, _)| tick);
        let mixed = plan.mixed(tap);
        plan.out.contradictions.extend(mixed);
        let replaced = plan.moves.iter().filter(|live| !live.dropped && !live.late);
        let replaced = replaced.filter_map(|live| live.withdrawn.first().map(|by| (live.to.tick, by.1)));
        plan.out.replaced = replaced.collect();
        plan.out.moves = plan.moves.iter().filter(|live| live.begins()).map(|live| live.to).collect();
        plan
    }

    fn take(&mut self, tap: &Tap, order: usize, cycle: u64, event: &Event) {
        match event {
            Event::Opened(_) => self.opened = order,
            Event::Control(epoch, op) => {
                self.controls.push((order, *op));
                self.asked = *epoch;
                self.seek = 0;
                if let Op::Arm { lower_stop, limits, assume_rest, .. } = *op {
                    self.has_stop = lower_stop.is_some_and(|stop| stop.pulses_per_s > 0);
                    self.seek = lower_stop.map_or(0, |LowerStop { seek, .. }| seek);
                    self.steps.push((self.passed, Step::Arm(limits, assume_rest && self.seek == 0)));
                }
                if let Op::Seek { pulses } = *op {
                    self.seek = pulses;
                }
            }
            Event::Batch(batch) => self.batch(order, cycle, batch),
            Event::Amend(items) => items.iter().for_each(|item| self.amend(item)),
            Event::Greeted(hello) => {
                if let Some(cut) = hello.last_cut {
                    self.cut(tap, &cut, self.opened);
                }
            }
            Event::Status(status, tick) => {
                (self.epoch, self.passed) = (status.epoch, self.passed.max(*tick));
                // A command that the device refuses does nothing.
                if status.refusal.is_some() && status.epoch == self.asked && self.seek > 0 {
                    self.seek = 0;
                }
                if status.state != State::Returning {
                    self.position_known = status.position_known;
                }
            }
            Event::Report(report) => self.report(tap, order, report),
            Event::Board(_) | Event::SelfTest(..) | Event::NoSession => {}
        }
    }

    /// A frame withdraws moves from its base on, unless a verdict says that a motor's were kept; and it brings moves.
    fn batch(&mut self, order: usize, cycle: u64, batch: &Batch) {
        let frame = (batch.epoch, batch.seq);
        let play = batch.mark.filter(|mark| mark.kind == MarkKind::Play);
        if let Some(mark) = play {
            let array = Array::paper();
            let (least, longest) = (array.layout().least_hold(), array.layout().longest_hold());
            self.holds.push((batch.base, mark.hold.clamp(least, longest)));
        } else if let Some(withdraw) = batch.withdraw {
            let from = |live: &&mut Live| live.frame.0 == batch.epoch && live.since >= batch.base;
            for live in self.moves.iter_mut().filter(from) {
                if withdraw.motors.contains(live.to.motor) {
                    live.withdrawn.push((frame, cycle));
                }
            }
        }
        for (at, one) in batch.moves.iter().enumerate() {
            let since = if one.joined { batch.moves[at - 1].of.tick } else { one.of.tick };
            let of_stroke = one.joined || batch.moves.get(at + 1).is_some_and(|next| next.joined);
            let (to, joined, withdrawn) = (one.of, one.joined, Vec::new());
            let (from, drives, amended, late, dropped) = (0, true, None, false, false);
            let (refused, flushed) = (None, None);
            self.moves.push(Live {
                to,
                from,
                joined,
                of_stroke,
                since,
                order,
                frame,
                drives,
                amended,
                late,
                dropped,
                refused,
                flushed,
                withdrawn,
            });
        }
    }

    /// The queued moves of a motor, in order of time.
    pub(super) fn queue(&self, motor: u8) -> Vec<usize> {
        let of = |&at: &usize| self.moves[at].to.motor == motor && self.moves[at].is_queued();
        let mut queue: Vec<usize> = (0..self.moves.len()).filter(of).collect();
        queue.sort_by_key(|&at| self.moves[at].to.tick);
        queue
    }

    /// The level of the move before this one in its motor's queue.
    fn level_before(&self, at: usize) -> u16 {
        let to = self.moves[at].to;
        let before = |live: &&Live| {
            live.to.motor == to.motor
                && live.to.tick < to.tick
                && live.begins()
                && live.frame.0 == self.moves[at].frame.0
        };
        self.moves.iter().filter(before).max_by_key(|live| live.to.tick).map_or(0, |live| live.to.level)
    }

    /// Applies an amendment by the rules that can be checked from outside. The scenario makes sure that it is in time.
    fn amend(&mut self, item: &Amendment) {
        let of_motor = |live: &Live| live.begins() && live.to.motor == item.motor;
        let Some(at) = self.moves.iter().position(|live| of_motor(live) && live.to.tick == item.tick) else {
            return;
        };
        let after = self.moves.iter().filter(|live| of_motor(live) && live.to.tick > item.tick);
        let next = after.map(|live| live.to.tick).min().unwrap_or(Tick(u64::MAX));
        let (from, level) = (self.level_before(at), self.moves[at].to.level);
        let planned = from.abs_diff(level);
        let pushes = level < from && self.has_stop && item.pulses > planned;
        if within_correction(planned, item.pulses) && item.tick + u64::from(item.pulses) <= next && !pushes {
            (self.moves[at].from, self.moves[at].amended) = (from, Some(item.pulses));
        }
    }

    fn report(&mut self, tap: &Tap, order: usize, report: &Report) {
        match *report {
            Report::Verdict { seq, late, refused, kept, .. } => {
                let frame = (self.epoch, seq);
                self.kept.push((frame, kept));
                for live in self.moves.iter_mut().filter(|live| kept.contains(live.to.motor)) {
                    live.withdrawn.retain(|&(by, _)| by != frame);
                }
                for (i, live) in self.moves.iter_mut().filter(|live| live.frame == frame).enumerate() {
                    let is_late = late >> i & 1 == 1;
                    live.late |= is_late && !kept.contains(live.to.motor);
                    live.dropped |= is_late || refused >> i & 1 == 1;
                }
            }
            Report::OnsetRefused { seq, .. } => {
                let frame = (self.epoch, seq);
                self.moves.iter_mut().filter(|live| live.frame == frame).for_each(|live| live.dropped = true);
            }
            Report::Onset { tick, .. } => {
                let tick = tap.tick(tick);
                if !self.out.onsets.contains(&tick) {
                    self.out.onsets.push(tick);
                    self.out.triggers.extend(tap.trigger_at(tick).map(|trigger| (tick, trigger)));
                }
            }
            Report::Refused { motor, tick, reason } => {
                let tick = tap.tick(tick);
                let same = |live: &Live| live.begins() && live.to.motor == motor && live.to.tick == tick;
                if let Some(at) = self.moves.iter().position(same) {
                    self.moves[at].refused = Some(reason);
                    // A stroke is refused as a whole.
                    if let Some(second) = self.moves.get_mut(at + 1).filter(|next| next.joined) {
                        second.dropped = true;
                    }
                } else {
                    self.out.contradictions.push(format!("motor {motor} has no move at {tick:?} to refuse"));
                }
            }
            Report::Lowered { tick, late, held } => {
                self.steps.push((tap.tick(tick), Step::Lower { late, held, order }));
            }
            // It moves no pin.
            Report::Edge { .. } => {}
            Report::Cut(cut) => {
                let by = |wanted: fn(&Op) -> bool| {
                    self.controls.iter().rev().find(|(_, op)| wanted(op)).map_or(order, |&(order, _)| order)
                };
                let limit = match cut.cause {
                    Cause::Stop => by(|op| matches!(op, Op::Stop)),
                    Cause::EStop => by(|op| matches!(op, Op::EStop)),
                    Cause::Request | Cause::Shutdown | Cause::Abort => {
                        by(|op| matches!(op, Op::Disarm(_) | Op::Arm { .. } | Op::Seek { .. }))
                    }
                    _ => order,
                };
                self.cut(tap, &cut, limit);
            }
        }
    }

    /// Cuts what events before `limit` have brought.
    fn cut(&mut self, tap: &Tap, cut: &Cut, limit: usize) {
        let Cut { cause, return_ticks, outstanding, .. } = *cut;
        let at = tap.tick(cut.at);
        let cut = CutAt { cause, at, return_ticks, outstanding };
        if self.out.cuts.contains(&cut) {
            return;
        }
        self.out.cuts.push(cut);
        self.passed = self.passed.max(at);
        for live in self.moves.iter_mut().filter(|live| live.order < limit && live.to.tick >= at) {
            live.flushed = live.flushed.or(Some(at));
        }
        let seek = std::mem::take(&mut self.seek);
        let seek = (return_ticks.is_some() && seek > 0).then_some((seek, self.position_known));
        self.steps.push((at, Step::Cut(cut, seek)));
    }

    /// Moves that the device has accepted although it keeps older ones of their motor.
    fn mixed(&self, tap: &Tap) -> Vec<String> {
        let mut mixed = Vec::new();
        for &(frame, motors) in self.kept.iter().filter(|(_, motors)| !motors.is_empty()) {
            let mut left = motors;
            let batches = tap.events.iter().filter_map(|(_, event)| match event {
                Event::Batch(batch) => Some(batch),
                _ => None,
            });
            for batch in batches.skip_while(|batch| (batch.epoch, batch.seq) != frame) {
                let of = (batch.epoch, batch.seq);
                if of != frame {
                    let ends = batch.mark.is_some_and(|mark| mark.kind == MarkKind::Play);
                    let withdrawn = batch.withdraw.map_or(MotorSet::EMPTY, |withdraw| withdraw.motors);
                    left = if ends { MotorSet::EMPTY } else { left.without(withdrawn) };
                }
                if left.is_empty() || batch.epoch != frame.0 {
                    break;
                }
                let accepted = self.moves.iter().filter(|live| live.frame == of && !live.dropped);
                mixed.extend(accepted.filter(|live| left.contains(live.to.motor)).map(|live| {
                    let (seq, motor) = (frame.1, live.to.motor);
                    format!("frame {seq} keeps what motor {motor} has queued, and frame {} adds to it", of.1)
                }));
            }
        }
        mixed
    }
}
