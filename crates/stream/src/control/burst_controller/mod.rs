//! The burst controller of one motor: tracks the bursts sent and decides the pulse count of each.
//!
//! `correct` decides the counts, `rest` says where the pin rests between plays and without telemetry, `trail` what the pin did lately,
//! `last_cut` which bursts a cut has found begun, `reckoned` how uncertain dead reckoning is.
//!
//! [`BurstController::correct`] finalises the count of a burst shortly before it begins. The [`Estimator`] predicts where the
//! shaft will be then; the new count leads from there to the burst's level. The control is dead-beat: it corrects the whole known error
//! at once. Where strokes fill their periods, a down burst can be shortened but not lengthened; then the controller lowers the top so
//! far that the down burst can still undo the expected scatter.
//!
//! # Stability
//! Burst k adds the error e_k, which is known when burst k + N is finalised. The estimator knows its own corrections,
//! so each count undoes exactly what has become known since the last one: u_k = −(e_{k−N} + δ u_{k−N}), where
//! δ = g/ĝ − 1 is the relative error of the gain. So z^N = −δ: N poles of radius |δ|^(1/N). All are at 0 if the gain is
//! right, and inside the unit circle for every true gain between 0 and twice the estimate, whatever the delay. The
//! filter's own poles are 1 − K, where K in (0, 1) is its weight of a sample. A count cut off by a limit does no harm:
//! the estimator gets the count that was really sent.
//!
//! The rest error is then the sum of the errors of the last N bursts: the bound of any loop with this delay.
//!
//! # With a lower stop
//! A down burst with a surplus ends at the stop, whatever scatter added up before. The controller leaves it as planned and
//! corrects up bursts only, from where telemetry shows the pin: the stop sets the rest position, the loop the amplitude. No
//! signal shows when a pin reaches the stop, so samples of that time are not used. Without telemetry, `landing` follows the mean and the
//! variance of the rest error from stroke to stroke ([`ReflectedWalk::after`]).

mod correct;
mod last_cut;
mod reckoned;
mod rest;
mod trail;

pub(crate) use correct::Times;

use super::estimator::{Estimator, Gains, Travel, gain_index, sign};
use super::queued::{Correction, Cutting, Forgotten, Queued};
use super::telemetry_monitor::{Plausibility, TelemetryMonitor};
use crate::queues::Movement;
use firmware_protocol::controller::POOL;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use last_cut::LastCut;
use meissner_api::SensorFault;
use meissner_array::motor::HalfTick;
use meissner_array::reflected_walk::Bursts;
use meissner_array::spec::Array;
use meissner_array::strokes::{Burst, Step};
use meissner_array::units::TickRate;
use reckoned::Reckoned;
use std::collections::VecDeque;
pub(crate) use trail::Passed;
use trail::Trail;

/// Bursts of one motor that may begin in [`Times::longest_age`]: strokes at 300 Hz, moves every 1.6 ms.
const PAST: usize = 800;

/// The controller of one motor.
#[derive(Debug)]
pub(crate) struct BurstController {
    times: Times,
    queue: VecDeque<Queued>,
    /// The bursts that have left the queue as played.
    trail: Trail,
    /// The bursts that have begun since the pin was last at rest.
    bursts: Bursts,
    last_cut: LastCut,
    /// How many bursts at the front of `queue` the estimator knows as begun.
    begun: usize,
    /// How many bursts at the front of `queue` have a final count.
    finalised: usize,
    /// Tenths of pulses, up and down, of bursts finalised and not begun.
    pending: [i64; 2],
    gains: Gains,
    estimator: Estimator,
    monitor: TelemetryMonitor,
    /// Telemetry has shown where the shaft is.
    anchored: bool,
    /// The last move: from this position, µm, by this expected shift, µm.
    move_from: Option<(f64, f64)>,
    /// With a lower stop: mean and variance of the rest error, µm and µm².
    landing: Option<[f64; 2]>,
    reckoned: Reckoned,
}

impl BurstController {
    /// The controller of a motor of this array.
    pub(crate) fn new(array: Array, gains: &Gains) -> Self {
        let mut queue = VecDeque::with_capacity(POOL + PAST);
        // Touch every page now: pages are locked at their first touch, which must not fall into a play.
        queue.resize(queue.capacity(), Queued::NOTHING);
        queue.clear();
        Self {
            times: Times::of(array),
            queue,
            trail: Trail::new(),
            bursts: Bursts::default(),
            last_cut: LastCut::default(),
            begun: 0,
            finalised: 0,
            pending: [0; 2],
            gains: *gains,
            estimator: Estimator::new(array.motor(), gains),
            monitor: TelemetryMonitor::new(array.rate()),
            anchored: false,
            move_from: None,
            landing: None,
            reckoned: Reckoned::default(),
        }
    }

    /// Whether the array has a lower stop; then the pin is at it.
    pub(crate) fn set_lower_stop(&mut self, lower_stop: bool) {
        self.landing = lower_stop.then_some([0.0; 2]);
    }

    const fn has_lower_stop(&self) -> bool {
        self.landing.is_some()
    }

    /// Tracks a step sent; its play ends at `until`. Steps come in order.
    pub(crate) fn sent(&mut self, step: &Step, closed_loop: bool, until: Tick) {
        // Without telemetry past bursts leave the queue here: it is as bounded as the device's pool.
        while self.queue.len() + 2 > self.queue.capacity()
            && let Some(first) = self.queue.front()
        {
            let len = self.queue.len();
            let end = self.queue.get(1).filter(|next| next.joined).unwrap_or(first).burst.end();
            self.advance(end + 1, None, |_| ());
            if self.queue.len() == len {
                break;
            }
        }
        for mut queued in Queued::of(step, closed_loop, until) {
            // The step before may not have been sent, or not been taken: the device goes to this level from where it is.
            let level = self.level_before(self.queue.len());
            if !queued.joined {
                queued.begin_at(level);
            }
            if queued.planned > 0 || queued.joined {
                self.queue.push_back(queued);
            }
        }
    }

    /// The place of the step that begins at `begin`, and the number of its bursts.
    fn find(&self, begin: Tick) -> Option<(usize, usize)> {
        let at = self.queue.binary_search_by_key(&begin, |queued| queued.burst.start).ok()?;
        Some((at, self.step_at(at)))
    }

    /// How many bursts the step has that begins at this place.
    fn step_at(&self, at: usize) -> usize {
        1 + usize::from(self.queue.get(at + 1).is_some_and(|next| next.joined))
    }

    /// How many moves the step has that begins at this tick, also after a cut; of an unknown one, as many as a stroke.
    pub(crate) fn moves_at(&self, begin: Tick) -> usize {
        let queued = self.find(begin).map(|(_, bursts)| bursts);
        queued.or_else(|| self.last_cut.moves_at(begin)).unwrap_or(2)
    }

    /// The level before the burst at this place, pulses above rest.
    fn level_before(&self, at: usize) -> u16 {
        at.checked_sub(1).map_or_else(|| self.trail.level(), |before| self.queue[before].level)
    }

    /// The device has accepted the step that begins at this tick.
    pub(crate) fn accepted(&mut self, begin: Tick) {
        if let Some((at, bursts)) = self.find(begin) {
            self.queue.range_mut(at..at + bursts).for_each(|queued| queued.accepted = true);
        }
    }

    /// The device will not play the step that begins at this tick.
    pub(crate) fn withdrawn(&mut self, begin: Tick) {
        if let Some(moves) = self.last_cut.moves_at(begin) {
            self.last_cut.withdrawn(begin);
            self.trail.withdrawn(begin, moves);
        }
        let Some((at, bursts)) = self.find(begin) else { return };
        if self.begun > at {
            // The estimator took it as played: the position is unknown until the next sample.
            for queued in self.queue.range_mut(at..at + bursts) {
                (queued.closed_loop, queued.accepted) = (false, false);
            }
            self.estimator.lose_position();
            return;
        }
        self.remove(at, bursts);
        self.replan(at);
    }

    /// The step that begins at this tick is late: a move down is played from `rendered` on, anything else not at all.
    pub(crate) fn late(&mut self, begin: Tick, rendered: Tick) {
        if let Some((at, 1)) = self.find(begin)
            && self.begun <= at
            && self.queue[at].burst.direction == Direction::Down
            && self.queue.get(at + 1).is_none_or(|next| next.burst.start > rendered)
        {
            self.open(at);
            (self.queue[at].burst.start, self.queue[at].accepted) = (rendered, true);
            self.estimator.plays_of_its_own(&self.queue[at].burst, self.times.drivers);
        } else {
            self.withdrawn(begin);
        }
    }

    /// The device has brought this motor's pin down at `tick`, because it was held for too long.
    pub(crate) fn hold_ended(&mut self, motor: u8, tick: Tick) {
        let at = self.queue.partition_point(|queued| queued.burst.start < tick);
        let (level, last) = (self.level_before(at), at.checked_sub(1).map(|last| self.queue[last]));
        if level == 0 || at < self.begun {
            return;
        }
        self.open(at);
        let burst = Burst { start: tick, direction: Direction::Down, pulses: level };
        let until = last.or(self.queue.get(at).copied()).map_or(burst.end(), |near| near.until);
        let down = Queued { motor, burst, planned: level, accepted: true, until, ..Queued::NOTHING };
        if self.queue.len() < self.queue.capacity() {
            self.queue.insert(at, down);
            self.replan(at + 1);
            // Samples may have shown the way down before the report of it.
            self.estimator.plays_of_its_own(&burst, self.times.drivers);
        }
    }

    /// Removes bursts that the estimator does not know yet.
    fn remove(&mut self, at: usize, bursts: usize) {
        self.open(at);
        self.queue.drain(at..at + bursts);
    }

    /// The bursts from this place on are not final any more.
    fn open(&mut self, at: usize) {
        while self.finalised > at.max(self.begun) {
            self.finalised -= 1;
            let Queued { burst, counted, .. } = self.queue[self.finalised];
            self.pending[gain_index(burst.direction)] -= counted;
        }
    }

    /// The burst at this place goes to its level from that of the burst now before it; none is needed if that is the same.
    fn replan(&mut self, at: usize) {
        let level = self.level_before(at);
        if let Some(queued) = self.queue.get_mut(at) {
            queued.begin_at(level);
            let is_step = self.step_at(at) == 1;
            if is_step && self.queue[at].planned == 0 {
                self.queue.remove(at);
            }
        }
    }

    /// The device took no step that begins at `onset` or later.
    pub(crate) fn withdraw_from(&mut self, onset: Tick) {
        self.take_from(onset, |_| ());
        // The estimator took what is left as played.
        while let Some(at) = self.last_step().filter(|&at| self.queue[at].burst.start >= onset) {
            self.open(at);
            self.queue.truncate(at);
            (self.begun, self.finalised) = (self.begun.min(at), self.finalised.min(at));
            self.estimator.lose_position();
        }
    }

    /// The place of the last step.
    fn last_step(&self) -> Option<usize> {
        let last = self.queue.len().checked_sub(1)?;
        Some(if self.queue[last].joined { last.saturating_sub(1) } else { last })
    }

    /// Takes the steps that begin at `from` or later and that the estimator does not know as begun, and passes each burst to `taken`, the
    /// last first.
    pub(in crate::control) fn take_from(&mut self, from: Tick, mut taken: impl FnMut(Queued)) {
        while let Some(at) = self.last_step().filter(|&at| self.queue[at].burst.start >= from) {
            if self.begun > at {
                break;
            }
            self.open(at);
            while self.queue.len() > at
                && let Some(last) = self.queue.pop_back()
            {
                taken(Queued { counted: 0, correction: None, ..last });
            }
        }
    }

    /// Queues a burst again that [`Self::take_from`] has taken.
    pub(in crate::control) fn put_back(&mut self, queued: Queued) {
        // There is room: as many were taken, and the newer ones are gone.
        self.queue.push_back(queued);
    }

    /// Remembers the last bursts that have begun by `tick`, when the device has cut them or shortly after.
    pub(crate) fn remember(&mut self, tick: Tick) {
        let level = self.trail.level();
        if self.queue.is_empty() && level == 0 {
            return;
        }
        let begun = self.queue.iter().filter(|queued| queued.burst.start < tick);
        self.last_cut.remember(begun, level);
    }

    /// The highest level that the pin may have had since bursts last left the queue and until `tick`, pulses above rest.
    pub(crate) fn highest(&self, tick: Tick) -> u16 {
        let begun = self.queue.iter().take_while(|queued| queued.burst.start < tick);
        begun.map(|queued| queued.level).fold(self.trail.level(), u16::max)
    }

    /// The level at the tick of a cut, pulses above rest, before [`Self::cut`] or after it.
    pub(crate) fn height_at(&self, tick: Tick) -> u16 {
        let level = self.trail.level();
        if self.queue.is_empty() && level == 0 {
            return self.last_cut.height_at(tick);
        }
        let last = self.queue.iter().rev().find(|queued| queued.burst.start < tick);
        last.map_or(level, |last| last.level_at(tick))
    }

    /// The device's clock has begun again: no tick of the past means anything.
    pub(crate) fn restarted(&mut self) {
        self.last_cut = LastCut::default();
        self.estimator.ended(None);
    }

    /// When the last pulse is over of the bursts that began at `from` or later and before `until`. If the device cut
    /// them at `cut`, nothing of them comes after it but, if the pins return, their way down. `Err`: too many bursts began since.
    pub(crate) fn over_at(
        &self,
        from: Tick,
        until: Tick,
        cut: Option<Cutting>,
    ) -> Result<Option<Tick>, Forgotten> {
        let at = cut.map_or(Tick(u64::MAX), |cut| cut.at);
        let before = self.last_cut.since(at.max(from))?;
        let queued = self.queue.iter().filter(|queued| queued.accepted || cut.is_some());
        let mut played = before.chain(queued).filter(|queued| {
            let start = queued.burst.start;
            start >= from && start < until.min(at)
        });
        let last = match played.next_back() {
            Some(last) => Some((last.burst.end(), last.level)),
            None => self.trail.last(from, until.min(at))?.map(|last| (last.burst.end(), last.to)),
        };
        let returned = cut.and_then(|cut| cut.returned);
        Ok(last.map(|(end, level)| returned.filter(|_| level > 0 || end > at).unwrap_or(end.min(at))))
    }

    /// Clears a sensor fault, and forgets what the faulty telemetry taught.
    pub(crate) fn clear_faults(&mut self) {
        if self.monitor.fault().is_some() {
            self.estimator.relearn(&self.gains);
        }
        self.monitor.clear();
    }

    /// Whether its gains come from a calibration.
    pub(crate) fn is_calibrated(&self) -> bool {
        self.gains.are_calibrated()
    }

    /// Whether plausible telemetry has shown where the shaft is.
    pub(crate) fn is_measured(&self) -> bool {
        self.anchored && self.monitor.fault().is_none()
    }

    /// Whether telemetry of `tick` says nothing: see [`Estimator::is_blind`].
    pub(crate) fn is_blind(&self, tick: Tick) -> bool {
        self.estimator.is_blind(tick)
    }

    /// The sensor fault, if there is one.
    pub(crate) fn fault(&self) -> Option<SensorFault> {
        self.monitor.fault()
    }

    /// The bursts that the device has accepted and that are not known to be over.
    pub(crate) fn in_device(&self) -> impl Iterator<Item = Passed> {
        self.queue.iter().filter(|queued| queued.accepted).scan(self.trail.level(), |level, queued| {
            let to = queued.level;
            Some(Passed { burst: queued.burst, from: std::mem::replace(level, to), to })
        })
    }

    /// What it has played, as far as it is kept.
    pub(crate) const fn trail(&self) -> &Trail {
        &self.trail
    }

    /// What the pin did from the first tick to the second, as planned.
    pub(crate) fn movement(&self, span: [Tick; 2], rate: TickRate) -> Movement {
        self.trail.movement(self.in_device(), span, rate)
    }

    /// Calls `level` with each of these ticks, which are in order, and the level as planned.
    pub(crate) fn course(&self, ticks: impl Iterator<Item = Tick>, level: impl FnMut(Tick, u16)) {
        self.trail.course(self.in_device(), ticks, level);
    }

    /// The device has cut the moves at this tick, not later than known. Returns the pin's way down, if it came down then.
    pub(crate) fn was_cut(&mut self, at: Tick) -> Option<&mut Passed> {
        self.trail.was_cut(at);
        self.trail.way_down().filter(|down| down.burst.start == at)
    }

    /// Forgets what the pin did: the device's clock may have begun again.
    pub(crate) fn forget_trail(&mut self) {
        self.trail.clear();
    }

    /// Advances to `tick`: takes bursts that have begun as played, and removes those that are over.
    ///
    /// The device has reported which steps before `known_to` it refused. At a step without a verdict, or that begins
    /// later, it stops and returns false. With `None` it waits for no report: it removes a step without a verdict, and
    /// takes the others as played. Calls `over` with each burst that has left the moving average.
    pub(crate) fn advance(
        &mut self,
        tick: Tick,
        known_to: Option<Tick>,
        mut over: impl FnMut(Travel),
    ) -> bool {
        let mut known = true;
        while let Some(next) = self.queue.get(self.begun).copied().filter(|next| next.burst.start < tick) {
            if !next.joined {
                if known_to.is_some_and(|known_to| !next.accepted || next.burst.start >= known_to) {
                    known = false;
                    break;
                }
                if !next.accepted {
                    self.remove(self.begun, self.step_at(self.begun));
                    self.replan(self.begun);
                    continue;
                }
            }
            if self.finalised == self.begun {
                self.finalise();
            }
            self.begin(&mut over);
        }
        while let bursts = self.step_at(0)
            && self.begun >= bursts
            && self.queue[bursts - 1].burst.end() <= tick
        {
            for queued in self.queue.drain(..bursts).filter(|queued| queued.accepted) {
                let (burst, from, to) = (queued.burst, self.trail.level(), queued.level);
                self.trail.passed(Passed { burst, from, to });
            }
            self.begun -= bursts;
            self.finalised -= bursts;
        }
        known
    }

    /// The estimator gets the next burst, whose count is final.
    fn begin(&mut self, over: &mut impl FnMut(Travel)) {
        let next = self.queue[self.begun];
        let Queued { burst, counted, .. } = next;
        self.pending[gain_index(burst.direction)] -= counted;
        if let Some(Correction { limited_um, rest_um }) = next.correction {
            self.monitor.corrected(limited_um.map(f64::from), rest_um.into());
        }
        self.estimator.forget(HalfTick::from(burst.start), &mut *over);
        let planned = next.planned - next.surplus;
        self.bursts.add(sign(burst.direction) * f64::from(planned) * self.um_per_pulse());
        let merged = match self.landing.filter(|_| next.lands()) {
            Some(before) => {
                let landing = self.walk(next.surplus).after(before);
                self.landing = Some(landing);
                self.estimator.begin_stopped(burst, landing)
            }
            None => self.estimator.begin(burst),
        };
        if next.lands() {
            self.bursts = Bursts::default();
        }
        if let Some(travel) = merged {
            over(travel);
        }
        self.begun += 1;
        if !self.has_lower_stop() {
            let um_per_pulse = self.um_per_pulse();
            let [um, counted_um] =
                [planned.into(), counted as f64 / 10.0].map(|pulses| pulses * um_per_pulse);
            self.reckoned.burst(burst.direction, um, counted_um, self.estimator.scatter());
        }
    }

    /// Takes a sample of the displacement, µm, after [`Self::advance`] to its tick. Calls `over` with each burst measured.
    pub(crate) fn telemetry(&mut self, tick: Tick, um: f64, mut over: impl FnMut(Travel)) {
        if self.monitor.fault().is_some() || self.estimator.is_stopping(tick) || self.is_blind(tick) {
            return;
        }
        if !self.anchored {
            if let Some((from, expected)) = self.move_from.take() {
                self.monitor.moved(um - from, expected);
            }
            self.estimator.lose_position();
            self.anchored = true;
        }
        let mut sample = self.estimator.compare(tick, um);
        match self.monitor.check(tick, &sample) {
            Plausibility::Outlier => return,
            Plausibility::Moved => {
                self.estimator.lose_position();
                sample = self.estimator.compare(tick, um);
            }
            Plausibility::Plausible => {}
        }
        let (monitor, gains) = (&mut self.monitor, &self.gains);
        let mut travels = heapless::Vec::<Travel, 8>::new();
        self.estimator.update(&sample, |travel| {
            let _ = travels.push(travel);
        });
        for travel in travels {
            monitor.travel(&travel, gains.mean[gain_index(travel.burst.direction)], &self.estimator);
            over(travel);
        }
        self.reckoned = Reckoned::default();
        if self.monitor.fault().is_some() {
            // Forget what the faulty telemetry taught.
            self.estimator.relearn(&self.gains);
        }
    }
}
