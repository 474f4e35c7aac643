//! Computes what the lines have to do from what went over the link: the strokes sent and amended, without those that the
//! device reports as not accepted, without those that later frames replace, and cut where the device reports a cut.
//!
//! It implements the rules a second time, from the specification. At the edge of an e-stop or a failure a pulse cannot be
//! predicted: there a [`Soft`] interval allows it to be missing.

use crate::log::{Log, Train};
use crate::tap::{Batch, Event, Tap};
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::Amendment;
use firmware_protocol::controller::DRIVER_TAIL;
use firmware_protocol::limits::{PowerLimits, within_correction};
use firmware_protocol::message::{Cause, Cut, LowerStop, MarkKind, Op, Report, State, Trigger};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_array::strokes::Stroke;
use meissner_test_support::paper::{DRIVER_LEAD, MOTORS, WHOLE_TRAVEL};

/// Ticks before an e-stop's cut in which a planned pulse may be missing, and ticks after it in which one may still begin: the
/// tick being played counts as played, whether it was cut off or not.
const FORCE: (u64, u64) = (1, 1);
/// Ticks after a failure of the core in which rendered pulses may still be played.
pub const HORIZON: u64 = 64;

/// An interval in which any part of the plan may have been played.
#[derive(Clone, Debug)]
pub struct Soft {
    /// The first tick.
    pub from: Tick,
    /// The first tick after it.
    pub to: Tick,
    /// The plan within it.
    pub planned: Log,
}

/// A cut as the device reports it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CutAt {
    /// The reason.
    pub cause: Cause,
    /// The first tick in which nothing of the queue was played.
    pub at: Tick,
    /// How many ticks the return took from `at` on; `None` if the pins stayed.
    pub return_ticks: Option<u32>,
    /// Outstanding return pulses.
    pub outstanding: u32,
}

/// What is expected of the lines in one boot.
#[derive(Clone, Debug, Default)]
pub struct Expected {
    /// The pulses, exact outside of the soft intervals.
    pub log: Log,
    /// Intervals in which pulses may be missing.
    pub soft: Vec<Soft>,
    /// Onsets of the plays that have begun.
    pub onsets: Vec<Tick>,
    /// What the trigger output gives, by the tick at which it begins.
    pub triggers: Vec<(Tick, Trigger)>,
    /// The cuts, in order.
    pub cuts: Vec<CutAt>,
    /// Contradictions between the device's reports.
    pub contradictions: Vec<String>,
    /// The strokes behind `log`, in the order in which they were sent.
    pub strokes: Vec<Stroke>,
    /// The accepted strokes that were replaced: when each was to begin, and the cycle at which its replacement was sent.
    pub replaced: Vec<(Tick, u64)>,
}

#[derive(Clone, Debug)]
struct Live {
    stroke: Stroke,
    planned: [u16; 2],
    /// The number of the event that brought it.
    order: usize,
    frame: (u16, u16),
    /// It seeks the lower stop.
    seeks: bool,
    /// It was accepted, as far as is known, and no cut has flushed it.
    alive: bool,
    /// The frames that withdraw it, with the cycle at which each was sent. A verdict may say that a frame kept it.
    withdrawn: Vec<((u16, u16), u64)>,
}

impl Live {
    /// Whether it is played.
    fn plays(&self) -> bool {
        self.alive && self.withdrawn.is_empty()
    }

    /// Outstanding return pulses after `up` up pulses and `down` down pulses.
    fn outstanding(&self, up: u16, down: u16) -> u16 {
        if up < self.stroke.up_pulses {
            up + self.planned[1].saturating_sub(self.planned[0])
        } else {
            self.stroke.down_pulses - down
        }
    }
}

#[derive(Debug, Default)]
struct Oracle {
    live: Vec<Live>,
    outstanding: [u16; MOTORS],
    /// Pulses of the seek that the last command asks for.
    seek: u16,
    /// Motors of a rail and of a chip that may have pulses at once, by the last arm.
    at_once: Option<(u8, u8)>,
    /// The last arm named a lower stop.
    has_stop: bool,
    /// Whether the device knew the positions when it last rested.
    position_known: bool,
    /// The last epoch that the device has reported, and that of the last command.
    epoch: u16,
    asked: u16,
    opened: usize,
    /// Frames that came too late for these motors.
    kept: Vec<((u16, u16), MotorSet)>,
    /// The last command and its event.
    controls: Vec<(usize, Op)>,
    out: Expected,
}

/// What the lines had to do, if the core failed at tick `death` or not at all.
#[must_use]
pub fn expect(tap: &Tap, death: Option<Tick>) -> Expected {
    let mut oracle = Oracle::default();
    for (order, (cycle, event)) in tap.events.iter().enumerate() {
        oracle.take(tap, order, *cycle, event);
    }
    let mut log = oracle.log();
    oracle.out.contradictions.extend(oracle.mixed(tap));
    let replaced = oracle.live.iter().filter(|live| live.alive);
    let replaced =
        replaced.filter_map(|live| live.withdrawn.first().map(|&(_, cycle)| (live.stroke.up, cycle)));
    oracle.out.replaced = replaced.collect();
    oracle.out.strokes = oracle.live.iter().filter(|live| live.plays()).map(|live| live.stroke).collect();
    if let Some(death) = death {
        // The tick of the failure may be cut short.
        let (from, to) = (Tick(death.0 - 1), death + HORIZON);
        let planned = log.within(from, to);
        log = log.within(Tick(0), to);
        oracle.out.soft.push(Soft { from, to, planned });
    }
    Expected { log, ..oracle.out }
}

impl Oracle {
    fn take(&mut self, tap: &Tap, order: usize, cycle: u64, event: &Event) {
        match event {
            Event::Opened(_) => self.opened = order,
            Event::Control(epoch, op) => {
                self.controls.push((order, *op));
                self.asked = *epoch;
                self.seek = match *op {
                    Op::Arm { lower_stop: Some(LowerStop { seek, .. }), .. } => seek,
                    Op::Seek { pulses } => pulses,
                    _ => 0,
                };
                if let Op::Arm {
                    lower_stop, limits: PowerLimits { rail_at_once, chip_at_once, .. }, ..
                } = op
                {
                    self.at_once = Some((*rail_at_once, *chip_at_once));
                    self.has_stop = lower_stop.is_some_and(|stop| stop.pulses_per_s > 0);
                }
                if matches!(op, Op::Arm { assume_rest: true, .. }) {
                    self.outstanding = [0; MOTORS];
                }
            }
            Event::Batch(batch) => {
                self.withdraw(cycle, batch);
                self.live.extend(batch.strokes.iter().map(|&stroke| Live {
                    stroke,
                    planned: [stroke.up_pulses, stroke.down_pulses],
                    order,
                    frame: (batch.epoch, batch.seq),
                    seeks: false,
                    alive: true,
                    withdrawn: Vec::new(),
                }));
            }
            Event::Amend(items) => items.iter().for_each(|item| self.amend(item)),
            Event::Greeted(hello) => {
                if let Some(cut) = hello.last_cut {
                    self.cut(tap, &cut, self.opened);
                }
            }
            Event::Status(status, _) => {
                self.epoch = status.epoch;
                // A seek that the device refuses is none.
                if status.refusal.is_some() && status.epoch == self.asked {
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

    /// The frame withdraws what begins at its base or later, unless a verdict says that a motor's strokes were kept.
    fn withdraw(&mut self, cycle: u64, batch: &Batch) {
        let begins_play = batch.mark.is_some_and(|mark| mark.kind == MarkKind::Play);
        let Some(withdraw) = batch.withdraw.filter(|_| !begins_play) else { return };
        let named = |live: &&mut Live| withdraw.motors.contains(live.stroke.motor);
        let from = |live: &&mut Live| live.frame.0 == batch.epoch && live.stroke.up >= batch.base;
        for live in self.live.iter_mut().filter(named).filter(from) {
            live.withdrawn.push(((batch.epoch, batch.seq), cycle));
        }
    }

    /// Strokes that the device has accepted although it keeps an older queue of their motor.
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
                let accepted = self.live.iter().filter(|live| live.frame == of && live.alive);
                mixed.extend(accepted.filter(|live| left.contains(live.stroke.motor)).map(|live| {
                    let (seq, motor) = (frame.1, live.stroke.motor);
                    format!("frame {seq} keeps what motor {motor} has queued, and frame {} adds to it", of.1)
                }));
            }
        }
        mixed
    }

    fn report(&mut self, tap: &Tap, order: usize, report: &Report) {
        match *report {
            Report::Verdict { seq, late, refused, kept, .. } => {
                let frame = (self.epoch, seq);
                self.kept.push((frame, kept));
                for live in self.live.iter_mut().filter(|live| kept.contains(live.stroke.motor)) {
                    live.withdrawn.retain(|&(by, _)| by != frame);
                }
                let strokes = self.live.iter_mut().filter(|live| live.frame == frame);
                for (i, live) in strokes.enumerate() {
                    live.alive &= (late | refused) >> i & 1 == 0;
                }
            }
            Report::OnsetRefused { seq, .. } => {
                let frame = (self.epoch, seq);
                self.live.iter_mut().filter(|live| live.frame == frame).for_each(|live| live.alive = false);
            }
            Report::Onset { tick, .. } => {
                let tick = tap.tick(tick);
                if !self.out.onsets.contains(&tick) {
                    self.out.onsets.push(tick);
                    self.out.triggers.extend(tap.trigger_at(tick).map(|trigger| (tick, trigger)));
                }
            }
            Report::Refused { motor, up, .. } => {
                let up = tap.tick(up);
                let same =
                    |live: &&mut Live| live.plays() && live.stroke.motor == motor && live.stroke.up == up;
                self.live.iter_mut().filter(same).for_each(|live| live.alive = false);
            }
            Report::Cut(cut) => {
                let by = |wanted: fn(&Op) -> bool| {
                    self.controls.iter().rev().find(|(_, op)| wanted(op)).map_or(order, |&(order, _)| order)
                };
                let limit = match cut.cause {
                    Cause::Stop => by(|op| matches!(op, Op::Stop)),
                    Cause::EStop => by(|op| matches!(op, Op::EStop)),
                    Cause::Request | Cause::Shutdown | Cause::Abort => {
                        by(|op| matches!(op, Op::Disarm(_) | Op::Arm { .. }))
                    }
                    _ => order,
                };
                self.cut(tap, &cut, limit);
            }
        }
    }

    /// Applies an amendment by the rules that can be checked from outside. The scenario makes sure that it is in time.
    fn amend(&mut self, item: &Amendment) {
        let same = |live: &Live| live.plays() && live.stroke.motor == item.motor;
        let after = self.live.iter().filter(|live| same(live) && live.stroke.up > item.up);
        let room_after = after.map(|live| live.stroke.up).min().unwrap_or(Tick(u64::MAX));
        let Some(live) = self.live.iter_mut().find(|live| same(live) && live.stroke.up == item.up) else {
            return;
        };
        let half = usize::from(item.direction == Direction::Down);
        let room = if half == 0 { live.stroke.down } else { room_after };
        let start = live.stroke.bursts()[half].start;
        let pushes = half == 1 && self.has_stop && item.pulses > live.planned[1];
        let fits =
            within_correction(live.planned[half], item.pulses) && start + u64::from(item.pulses) <= room;
        if fits && !pushes {
            let stroke = &mut live.stroke;
            *(if half == 0 { &mut stroke.up_pulses } else { &mut stroke.down_pulses }) = item.pulses;
        }
    }

    /// Cuts the strokes of events before `limit`.
    fn cut(&mut self, tap: &Tap, cut: &Cut, limit: usize) {
        let Cut { cause, return_ticks, outstanding, .. } = *cut;
        let at = tap.tick(cut.at);
        let cut = CutAt { cause, at, return_ticks, outstanding };
        if self.out.cuts.contains(&cut) {
            return;
        }
        self.out.cuts.push(cut);
        let (found, took) = if return_ticks.is_some() {
            let (found, over) = self.cut_and_return(at, limit);
            (found, Some((over - at) as u32))
        } else {
            (self.force(at, limit), None)
        };
        if (found, took) != (outstanding, return_ticks) {
            let text = format!(
                "{cause:?} at tick BOOT+{}: the device reports {outstanding} outstanding return pulses and a return of {return_ticks:?} \
                 ticks, the strokes give {found} and {took:?}",
                at.since(Tick::BOOT)
            );
            self.out.contradictions.push(text);
        }
    }

    /// The outstanding return pulses, and when the last of them is over.
    fn cut_and_return(&mut self, at: Tick, limit: usize) -> (u32, Tick) {
        let ready = self.ready(at);
        let (mut outstanding, mut waiting) = (0, Vec::new());
        let cut = |(_, live): &(usize, &mut Live)| live.plays() && live.order < limit;
        for (index, live) in self.live.iter_mut().enumerate().filter(cut) {
            let returns = live.outstanding((at - live.stroke.up).min(u16::MAX.into()) as u16, 0);
            let stroke = &mut live.stroke;
            if stroke.up < at && at < stroke.down {
                waiting.push(index);
            }
            if stroke.up >= at {
                live.alive = false;
            } else if at < stroke.up + u64::from(stroke.up_pulses) {
                stroke.up_pulses = (at - stroke.up) as u16;
                (stroke.down, stroke.down_pulses) = (ready, returns);
                outstanding += u32::from(stroke.down_pulses);
            } else if at < stroke.end() {
                outstanding += u32::from(stroke.down_pulses) - (at - stroke.down) as u32;
                stroke.down = if at < stroke.down { ready } else { stroke.down };
            }
        }
        // The next arm plays the return pulses that an e-stop left outstanding, and reports it as a cut; or it seeks the stop.
        let seek = std::mem::take(&mut self.seek);
        // The scenarios move no pins.
        let height = self.outstanding.iter().copied().max().unwrap_or(0);
        let least =
            if self.position_known { Array::paper().layout().least_seek(height) } else { WHOLE_TRAVEL };
        if seek > 0 && seek < least {
            let text = format!(
                "the device seeks with {seek} pulses, where {least} are needed to reach the lower stop"
            );
            self.out.contradictions.push(text);
        }
        for motor in 0..MOTORS {
            let left = std::mem::take(&mut self.outstanding[motor]);
            let pulses = if seek > 0 { seek } else { left };
            if pulses > 0 {
                let stroke =
                    Stroke { motor: motor as u8, up: ready, up_pulses: 0, down: ready, down_pulses: pulses };
                let planned = [0, pulses];
                let (frame, seeks) = ((0, u16::MAX), seek > 0);
                let withdrawn = Vec::new();
                waiting.push(self.live.len());
                self.live.push(Live { stroke, planned, order: 0, frame, seeks, alive: true, withdrawn });
                outstanding += u32::from(pulses);
            }
        }
        self.take_turns(at, ready, limit, &waiting);
        let cut =
            |&(index, live): &(usize, &Live)| waiting.contains(&index) || live.plays() && live.order < limit;
        let ends = self.live.iter().enumerate().filter(cut).map(|(_, live)| live.stroke.end());
        (outstanding, ends.fold(at, Tick::max))
    }

    /// Schedules the bursts of `waiting` in turns from `ready` on. A rail has as many places as bursts may run at once: each
    /// burst waits for a free place and, if the motors of its chip take turns, for the burst before it in its chip. Bursts that
    /// run have a place.
    fn take_turns(&mut self, at: Tick, ready: Tick, limit: usize, waiting: &[usize]) {
        let (rail_at_once, chip_at_once) = self.at_once.unwrap_or((6, 2));
        for rail in 0..MOTORS / 6 {
            let of_rail = |live: &Live| live.plays() && usize::from(live.stroke.motor) / 6 == rail;
            let of_rail = |&index: &usize| of_rail(&self.live[index]);
            let to_come =
                |&index: &usize| self.live[index].order < limit && self.live[index].stroke.end() > at;
            let motor = |index: usize| self.live[index].stroke.motor;
            let all = (0..self.live.len()).filter(of_rail).filter(to_come);
            let running: Vec<usize> = all.filter(|index| !waiting.contains(index)).collect();
            let mut left: Vec<usize> = waiting.iter().copied().filter(of_rail).collect();
            left.sort_by_key(|&index| motor(index));
            // First one of each chip that has no burst, then those of chips that have one, then the others.
            let runs = |chip: u8| running.iter().any(|&index| motor(index) / 2 == chip);
            let (follow, others): (Vec<_>, Vec<_>) =
                left.into_iter().partition(|&index| runs(motor(index) / 2));
            let leads =
                |&index: &usize| others.iter().find(|&&of| motor(of) / 2 == motor(index) / 2) == Some(&index);
            let (first, last): (Vec<_>, Vec<_>) = others.iter().partition(|index| leads(index));
            let mut places = vec![ready; rail_at_once.clamp(1, 6).into()];
            let mut chips = [ready; MOTORS / 2];
            for index in running.iter().copied().chain(first).chain(follow).chain(last) {
                let waits = !running.contains(&index);
                let stroke = &mut self.live[index].stroke;
                let chip = usize::from(stroke.motor) / 2;
                places.sort_unstable();
                if waits {
                    stroke.down = if chip_at_once < 2 { places[0].max(chips[chip]) } else { places[0] };
                }
                (places[0], chips[chip]) = (stroke.end(), stroke.end());
            }
        }
    }

    /// The first tick, from `at` on, in which the drivers have been enabled for their lead: they are on from the lead before a
    /// burst to the tail after it.
    fn ready(&self, at: Tick) -> Tick {
        let strokes = self.live.iter().filter(|live| live.plays()).map(|live| live.stroke);
        let bursts = strokes.flat_map(|stroke| stroke.bursts()).filter(|burst| burst.pulses > 0);
        let lead = u64::from(DRIVER_LEAD);
        let mut on: Vec<_> = bursts
            .map(|burst| (Tick(burst.start.0 - lead), burst.end() + u64::from(DRIVER_TAIL)))
            .filter(|&(from, _)| from < at)
            .collect();
        on.sort_unstable();
        let mut last: Option<(Tick, Tick)> = None;
        for (from, to) in on {
            last = match last {
                Some((since, until)) if from <= until => Some((since, until.max(to))),
                _ => Some((from, to)),
            };
        }
        match last {
            Some((since, until)) if until >= at => at.max(since + lead),
            _ => at + lead,
        }
    }

    fn force(&mut self, at: Tick, limit: usize) -> u32 {
        let (from, to) = (Tick(at.0 - FORCE.0), at + FORCE.1);
        self.out.soft.push(Soft { from, to, planned: self.log().within(from, to) });
        for live in self.live.iter_mut().filter(|live| live.plays() && live.order < limit) {
            let stroke = &mut live.stroke;
            if stroke.end() <= at {
                continue;
            }
            let returns = stroke.up_pulses == 0;
            if stroke.up >= at && !returns {
                live.alive = false;
                continue;
            }
            let (up, down) =
                ((at - stroke.up).min(stroke.up_pulses.into()) as u16, (at - stroke.down) as u16);
            let motor = usize::from(stroke.motor);
            self.outstanding[motor] += if live.seeks { 0 } else { live.outstanding(up, down) };
            (live.stroke.up_pulses, live.stroke.down_pulses) = (up, down);
        }
        self.outstanding.iter().map(|&outstanding| u32::from(outstanding)).sum()
    }

    fn log(&self) -> Log {
        let strokes = self.live.iter().filter(|live| live.plays()).map(|live| live.stroke);
        let trains = strokes.flat_map(|stroke| {
            stroke.bursts().map(|burst| {
                let train =
                    Train { start: burst.start, direction: burst.direction, pulses: burst.pulses.into() };
                (usize::from(stroke.motor), train)
            })
        });
        Log::of(trains.collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_protocol::message::Withdraw;

    /// A device that pushes more than was planned differs from what is expected.
    #[test]
    fn an_amendment_lengthens_a_down_burst_only_without_a_stop() {
        let stroke =
            Stroke { motor: 3, up: Tick::BOOT + 500, up_pulses: 20, down: Tick::BOOT + 600, down_pulses: 20 };
        let stop = LowerStop { pulses_per_s: 25_500, seek: 0 };
        for (lower_stop, down_pulses) in [(Some(stop), 20), (None, 26)] {
            let mut oracle = Oracle::default();
            let arm = Op::Arm {
                assume_rest: true,
                host_timeout: 25_500,
                limits: Array::paper().layout().no_limits(),
                lower_stop,
            };
            oracle.take(&Tap::default(), 0, 0, &Event::Control(1, arm));
            let planned = [stroke.up_pulses, stroke.down_pulses];
            let (frame, withdrawn) = ((1, 0), Vec::new());
            oracle.live.push(Live { stroke, planned, order: 1, frame, seeks: false, alive: true, withdrawn });
            oracle.amend(&Amendment { motor: 3, up: stroke.up, direction: Direction::Down, pulses: 26 });
            assert_eq!(oracle.live[0].stroke, Stroke { down_pulses, ..stroke });
        }
    }

    /// A verdict that comes after a second replacement brings back what the first one withdrew, and the second one did not.
    #[test]
    fn what_a_verdict_keeps_is_played() {
        let stroke = |up: u64, up_pulses| {
            let up = Tick::BOOT + up;
            Stroke { motor: 3, up, up_pulses, down: up + 50, down_pulses: up_pulses }
        };
        let batch = |seq, from: Option<u64>, strokes: &[Stroke]| {
            let withdraw = from.map(|_| Withdraw { motors: MotorSet::from_bits(1 << 3), generation: 0 });
            let base = Tick::BOOT + from.unwrap_or(500);
            Event::Batch(Batch { epoch: 0, seq, mark: None, withdraw, base, strokes: strokes.to_vec() })
        };
        let rendered = Tick::BOOT.wire();
        let verdict = Report::Verdict {
            seq: 1,
            late: 1,
            refused: 0,
            kept: MotorSet::from_bits(1 << 3),
            reason: None,
            rendered,
        };
        let old = [500, 600, 700, 800].map(|up| stroke(up, 20));
        let new = [stroke(650, 30), stroke(800, 40)];
        let mut tap = Tap::default();
        tap.events = vec![
            (0, batch(0, None, &old)),
            (7, batch(1, Some(600), &new[..1])),
            (9, batch(2, Some(750), &new[1..])),
        ];
        let expected = expect(&tap, None);
        assert_eq!(expected.strokes, [old[0], new[0], new[1]]);
        assert_eq!(expected.replaced, [(old[1].up, 7), (old[2].up, 7), (old[3].up, 7)]);
        tap.events.push((20, Event::Report(verdict)));
        let expected = expect(&tap, None);
        assert_eq!(expected.strokes, [old[0], old[1], old[2], new[1]]);
        assert_eq!(expected.replaced, [(old[3].up, 9)]);
    }

    /// With one motor of a rail at once, pins return one after the other: what runs, then the first of another chip.
    #[test]
    fn returns_take_turns() {
        let limits = PowerLimits { rail_at_once: 1, ..Array::paper().layout().no_limits() };
        let arm = Op::Arm { assume_rest: true, host_timeout: 25_500, limits, lower_stop: None };
        let stroke = |motor, up: u64, down: u64| {
            let (up, down) = (Tick::BOOT + up, Tick::BOOT + down);
            Stroke { motor, up, up_pulses: 20, down, down_pulses: 20 }
        };
        let strokes = [stroke(2, 500, 900), stroke(0, 520, 590), stroke(1, 540, 800), stroke(7, 550, 700)];
        let batch = Batch {
            epoch: 0,
            seq: 0,
            mark: None,
            withdraw: None,
            base: Tick::BOOT,
            strokes: strokes.to_vec(),
        };
        let at = (Tick::BOOT + 600).wire();
        let cut = Cut { cause: Cause::HostTimeout, at, return_ticks: Some(50), flushed: 0, outstanding: 70 };
        let mut tap = Tap::default();
        tap.events =
            vec![(0, Event::Control(1, arm)), (0, Event::Batch(batch)), (0, Event::Report(Report::Cut(cut)))];
        let expected = expect(&tap, None);
        assert_eq!(expected.contradictions, Vec::<String>::new());
        let downs = |motor: u8| expected.strokes.iter().find(|one| one.motor == motor).map(|one| one.down);
        let after = |ticks: u64| Some(Tick::BOOT + ticks);
        assert_eq!([downs(0), downs(1), downs(2)], [after(590), after(630), after(610)]);
        assert_eq!(downs(7), after(600));
    }

    /// A device that carries out a seek which it must refuse is found out.
    #[test]
    fn a_seek_that_is_too_short_contradicts_the_specification() {
        for (seek, wrong) in [(WHOLE_TRAVEL - 1, 1), (WHOLE_TRAVEL, 0)] {
            let lower_stop = Some(LowerStop { pulses_per_s: 25_500, seek });
            let arm = Op::Arm {
                assume_rest: false,
                host_timeout: 25_500,
                limits: Array::paper().layout().no_limits(),
                lower_stop,
            };
            let outstanding = MOTORS as u32 * u32::from(seek);
            let at = (Tick::BOOT + 1_000).wire();
            let cut = Cut {
                cause: Cause::Request,
                at,
                return_ticks: Some(43 + u32::from(seek)),
                flushed: 0,
                outstanding,
            };
            let mut tap = Tap::default();
            tap.events = vec![(0, Event::Control(1, arm)), (0, Event::Report(Report::Cut(cut)))];
            let expected = expect(&tap, None);
            assert_eq!(expected.contradictions.len(), wrong, "{:?}", expected.contradictions);
            assert!(expected.log.lines.iter().all(|trains| trains[0].pulses == u64::from(seek)));
        }
    }
}
