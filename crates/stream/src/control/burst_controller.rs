//! The burst controller of one motor: tracks the bursts sent and decides the pulse count of each.
//!
//! [`BurstController::correct`] finalises the count of a burst shortly before it begins. The [`Estimator`] predicts where the
//! shaft will be then; the new count leads from there to the target: the top of the stroke after the up burst, 0 after
//! the down burst. The control is dead-beat: it corrects the whole known error at once. Where strokes fill their
//! periods, a down burst can be shortened but not lengthened; then the controller lowers the top so far that the down
//! burst can still undo the expected scatter.
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

use super::estimator::{Estimator, Gains, Travel, after_rest, gain_index, sign};
use super::queued::{Correction, Cutting, Forgotten, Queued};
use super::telemetry_monitor::{Plausibility, TelemetryMonitor};
use firmware_protocol::controller::POOL;
use firmware_protocol::limits::{MAX_DOWN_PULSES, MAX_UP_PULSES, correction};
use firmware_protocol::stroke::{Direction, Stroke};
use firmware_protocol::tick::Tick;
use meissner_api::SensorFault;
use meissner_array::motor::HalfTick;
use meissner_array::reflected_walk::{ReflectedWalk, Spread};
use meissner_array::units::{TICKS_PER_MS, TICKS_PER_S, UM_PER_PULSE};
use std::collections::VecDeque;

/// A correction leaves at least this long before its burst, ticks: later uses fresher telemetry, but must not be late.
pub(super) const SEND_BY: u64 = TICKS_PER_MS * 3 / 2;
/// A burst is finalised this long before it begins, ticks: one wake-up of 1 ms fits before [`SEND_BY`], with 0.5 ms to spare.
pub(crate) const FINALISE_AT: u64 = SEND_BY + TICKS_PER_MS * 3 / 2;
/// If a correction leaves anyway, those due within 2 ms leave with it: a frame costs as many bytes as three corrections.
pub(crate) const FINALISE_EARLY: u64 = FINALISE_AT + TICKS_PER_MS * 2;
/// The controller neither uses nor waits for telemetry older than this, ticks.
pub(crate) const LONGEST_AGE: u64 = TICKS_PER_S * 5 / 4;
/// Strokes of one motor that may begin in [`LONGEST_AGE`], at 300 Hz.
const PAST: usize = 400;
/// Strokes that a motor remembers after a cut: those that began until the device said when it cut. It says so within milliseconds.
const CUT: usize = 8;
/// Without room to lengthen the down burst, the top is lowered by so many standard deviations of the scatter.
const HEADROOM: f64 = 0.5;
/// Asymmetry of the gains up and down without calibration, one standard deviation.
pub(crate) const ASYMMETRY: f64 = 0.02;

/// The controller of one motor.
#[derive(Debug)]
pub(crate) struct BurstController {
    queue: VecDeque<Queued>,
    /// The last strokes that had begun when the queue was last cut.
    cut: heapless::Deque<Queued, CUT>,
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
    /// The array has a lower stop.
    lower_stop: bool,
    /// With a lower stop: mean and variance of the rest error, µm and µm².
    landing: [f64; 2],
    /// Dead reckoning since the last sample: variance by scatter, µm², and summed amplitudes, which asymmetry multiplies, µm.
    scattered: f64,
    reckoned_travel_um: f64,
    /// Travel up and down since the last sample, of whole strokes and moves at a gain of 1, µm: new gains apply to it, too.
    reckoned_um: [f64; 2],
}

impl BurstController {
    pub(crate) fn new(gains: &Gains) -> Self {
        let nothing = Stroke { motor: 0, up: Tick(0), up_pulses: 0, down: Tick(0), down_pulses: 0 };
        let empty = Queued {
            stroke: nothing,
            planned: [0; 2],
            counted: [0; 2],
            accepted: false,
            closed_loop: false,
            corrections: [None; 2],
            until: Tick(0),
        };
        let mut queue = VecDeque::with_capacity(POOL + PAST);
        // Touch every page now: pages are locked at their first touch, which must not fall into a play.
        queue.resize(queue.capacity(), empty);
        queue.clear();
        Self {
            queue,
            cut: heapless::Deque::new(),
            begun: 0,
            finalised: 0,
            pending: [0; 2],
            gains: *gains,
            estimator: Estimator::new(gains),
            monitor: TelemetryMonitor::default(),
            anchored: false,
            move_from: None,
            lower_stop: false,
            landing: [0.0; 2],
            scattered: 0.0,
            reckoned_travel_um: 0.0,
            reckoned_um: [0.0; 2],
        }
    }

    /// Whether the array has a lower stop.
    pub(crate) fn set_lower_stop(&mut self, lower_stop: bool) {
        self.lower_stop = lower_stop;
    }

    /// Tracks a stroke sent; its play ends at `until`. Strokes come in order. Calls `gone` as [`Self::advance`] does.
    pub(crate) fn sent(
        &mut self,
        stroke: &Stroke,
        closed_loop: bool,
        until: Tick,
        gone: impl FnMut(&Stroke, Tick),
    ) {
        // Without telemetry past strokes leave the queue here: it is as bounded as the device's pool.
        if self.queue.len() == self.queue.capacity()
            && let Some(first) = self.queue.front()
        {
            self.advance(first.stroke.end() + 1, None, |_| (), gone);
        }
        let planned = [stroke.up_pulses, stroke.down_pulses];
        let (counted, accepted, corrections) = ([0; 2], false, [None; 2]);
        let stroke = *stroke;
        self.queue.push_back(Queued { stroke, planned, counted, accepted, closed_loop, corrections, until });
    }

    fn find(&self, up: Tick) -> Option<usize> {
        self.queue.binary_search_by_key(&up, |queued| queued.stroke.up).ok()
    }

    /// The device has accepted the stroke.
    pub(crate) fn accepted(&mut self, up: Tick) {
        if let Some(at) = self.find(up) {
            self.queue[at].accepted = true;
        }
    }

    /// The device will not play the stroke.
    pub(crate) fn withdrawn(&mut self, up: Tick) {
        self.cut.retain(|queued| queued.stroke.up != up);
        let Some(at) = self.find(up) else { return };
        if self.begun > 2 * at {
            // The estimator took it as played: the position is unknown until the next sample.
            (self.queue[at].closed_loop, self.queue[at].accepted) = (false, false);
            self.estimator.lose_position();
            return;
        }
        self.remove(at);
    }

    /// Removes a stroke that the estimator does not know yet.
    fn remove(&mut self, at: usize) {
        let finalised = self.finalised.saturating_sub(2 * at).min(2);
        for half in 0..finalised {
            self.pending[half] -= self.queue[at].counted[half];
        }
        self.finalised -= finalised;
        self.queue.remove(at);
    }

    /// The device took no stroke with an up tick from `onset` on.
    pub(crate) fn withdraw_from(&mut self, onset: Tick) {
        while let Some(up) = self.queue.back().map(|last| last.stroke.up).filter(|&up| up >= onset) {
            let before = self.queue.len();
            self.withdrawn(up);
            if self.queue.len() == before {
                break;
            }
        }
    }

    /// Remembers the last strokes that have begun by `tick`, when the device has cut them or shortly after.
    pub(crate) fn remember(&mut self, tick: Tick) {
        if self.queue.is_empty() {
            return;
        }
        self.cut.clear();
        let begun = self.queue.iter().filter(|queued| queued.stroke.up < tick);
        for queued in begun.rev().take(CUT) {
            // Cannot fail: there is room for as many.
            let _ = self.cut.push_front(*queued);
        }
    }

    /// The device has flushed the queue and returns the pin.
    pub(crate) fn cut(&mut self) {
        let rest_um = self.rest_um();
        // A cut stroke scatters like any other.
        let unsure = self
            .queue
            .front()
            .map_or(0.0, |first| self.estimator.scatter() * f64::from(first.planned[0]) * UM_PER_PULSE);
        self.queue.clear();
        (self.begun, self.finalised, self.pending) = (0, 0, [0; 2]);
        if self.lower_stop {
            // The return ends at the stop, too.
            let [mean, variance] = self.landing;
            self.estimator.rest_at(mean, variance);
        } else {
            self.estimator.rest_at(rest_um, self.estimator.variance() + 2.0 * unsure * unsure);
            self.scattered += 2.0 * unsure * unsure;
        }
        (self.anchored, self.move_from) = (false, None);
    }

    /// When the last pulse is over of the strokes that began at `from` or later and before `until`, and that the device has not
    /// played whole when it cut at `cut`, if it did; `returns`: it then plays their outstanding return pulses. [`Strokes`
    /// that have left the queue](Self::advance) are not among them. `Err`: too many strokes began after that cut.
    pub(crate) fn over_at(
        &self,
        from: Tick,
        until: Tick,
        cut: Option<Cutting>,
    ) -> Result<Option<Tick>, Forgotten> {
        let at = cut.map_or(Tick(u64::MAX), |cut| cut.at);
        if self.cut.is_full() && self.cut.front().is_some_and(|first| first.stroke.up >= at.max(from)) {
            return Err(Forgotten);
        }
        let queued = self.queue.iter().filter(|queued| queued.accepted || cut.is_some());
        let played = self.cut.iter().chain(queued).filter(|queued| {
            let up = queued.stroke.up;
            up >= from && up < until.min(at)
        });
        Ok(played.map(|queued| cut.map_or(queued.stroke.end(), |cut| queued.over_at(cut))).max())
    }

    /// The operator says that the pin is at rest.
    pub(crate) fn assume_rest(&mut self) {
        self.estimator.rest_at(0.0, 1.0);
        self.landing = [0.0; 2];
        self.forget_reckoned();
    }

    /// The pin may be anywhere up to `um` from rest, one standard deviation.
    pub(crate) fn lose_rest(&mut self, um: f64) {
        self.estimator.rest_at(0.0, um * um);
        self.landing = [0.0, um * um];
        self.forget_reckoned();
        self.scattered = um * um;
    }

    /// What was reckoned is over: something has shown where the pin is.
    fn forget_reckoned(&mut self) {
        (self.scattered, self.reckoned_travel_um, self.reckoned_um) = (0.0, 0.0, [0.0; 2]);
    }

    /// Clears a sensor fault, and forgets what the faulty telemetry taught.
    pub(crate) fn clear_faults(&mut self) {
        if self.monitor.fault().is_some() {
            self.estimator.relearn(&self.gains);
        }
        self.monitor = TelemetryMonitor::default();
    }

    /// Uses the gains of a calibration, also for what was reckoned so far: the offset that they explain is known from now on,
    /// and less is uncertain. The bursts have scattered as they have.
    pub(crate) fn set_gains(&mut self, gains: &Gains) {
        let before = [Direction::Up, Direction::Down].map(|direction| self.estimator.gain(direction));
        self.gains = *gains;
        self.estimator.relearn(gains);
        let explained = [Direction::Up, Direction::Down].into_iter().zip(before).zip(self.reckoned_um);
        let explained = explained.map(|((direction, before), um)| {
            sign(direction) * (self.estimator.gain(direction) - before) * um
        });
        self.estimator.shift(explained.sum());
    }

    /// Mean gain of a move that begins at `start`: less after half a second of rest.
    pub(crate) fn move_gain(&self, direction: Direction, start: Tick) -> f64 {
        self.estimator.gain(direction) * after_rest(self.estimator.last_end(), start)
    }

    /// A move between plays, which begins at `start`, shifts the rest position: down to a lower stop and no further.
    pub(crate) fn moved(&mut self, direction: Direction, pulses: u16, start: Tick) {
        let rest = after_rest(self.estimator.last_end(), start);
        let um = f64::from(pulses) * UM_PER_PULSE * self.move_gain(direction, start);
        self.estimator.moved(start + u64::from(pulses));
        let (shift, scatter) = (sign(direction) * um, self.estimator.scatter() * um);
        let before = self.estimator.position_um();
        let (mut after, variance) = (before + shift, self.estimator.variance() + scatter * scatter);
        if self.lower_stop {
            after = after.max(0.0);
            self.landing = [after, variance];
        }
        self.move_from = self.anchored.then_some((before, after - before));
        self.estimator.rest_at(after, variance);
        // A move is one way: what its gain is not known by counts whole.
        let ideal_um = rest * f64::from(pulses) * UM_PER_PULSE;
        let unsure = self.gains.sd[gain_index(direction)] * ideal_um;
        self.scattered += scatter * scatter + unsure * unsure;
        self.reckoned_um[gain_index(direction)] += ideal_um;
        self.anchored = false;
    }

    /// Whether its gains come from a calibration.
    pub(crate) fn is_calibrated(&self) -> bool {
        self.gains.are_calibrated()
    }

    /// Whether plausible telemetry has shown where the shaft is.
    pub(crate) fn is_measured(&self) -> bool {
        self.anchored && self.monitor.fault().is_none()
    }

    /// The sensor fault, if there is one.
    pub(crate) fn fault(&self) -> Option<SensorFault> {
        self.monitor.fault()
    }

    /// Strokes that the device has accepted.
    pub(crate) fn in_device(&self) -> impl Iterator<Item = Stroke> {
        self.queue.iter().filter(|queued| queued.accepted).map(|queued| queued.stroke)
    }

    /// Marks the next burst's count as final.
    fn finalise(&mut self) {
        let (at, half) = (self.finalised / 2, self.finalised % 2);
        let burst = self.queue[at].burst(half);
        let counted = if half == 1 && self.lower_stop {
            // It takes the pin down from wherever it is, and no further.
            let pulses = self.position_um() / (UM_PER_PULSE * self.estimator.gain(Direction::Down));
            (10.0 * pulses).round() as i64
        } else {
            let tenths = if after_rest(self.finalised_end(), burst.start) < 1.0 { 8 } else { 10 };
            i64::from(burst.pulses) * tenths
        };
        self.queue[at].counted[half] = counted;
        self.pending[half] += counted;
        self.finalised += 1;
    }

    /// When the last finalised burst ends that the device has not refused.
    fn finalised_end(&self) -> Option<Tick> {
        if self.finalised == self.begun {
            return self.estimator.last_end();
        }
        let last = self.finalised - 1;
        Some(self.queue[last / 2].burst(last % 2).end())
    }

    /// Advances to `tick`: takes bursts that have begun as played, and removes strokes that are over.
    ///
    /// The device has reported which strokes before `known_to` it refused. At a stroke without a verdict, or that begins
    /// later, it stops and returns false. With `None` it waits for no report: it removes a stroke without a verdict, and
    /// takes the others as played. Calls `over` with each burst that has left the moving average, and `gone` with each
    /// stroke removed as played and the end of its play.
    pub(crate) fn advance(
        &mut self,
        tick: Tick,
        known_to: Option<Tick>,
        mut over: impl FnMut(Travel),
        mut gone: impl FnMut(&Stroke, Tick),
    ) -> bool {
        let mut known = true;
        while let Some(next) = self.queue.get(self.begun / 2).copied() {
            let half = self.begun % 2;
            let burst = next.burst(half);
            if burst.start >= tick {
                break;
            }
            if half == 0 {
                if known_to.is_some_and(|known_to| !next.accepted || burst.start >= known_to) {
                    known = false;
                    break;
                }
                if !next.accepted {
                    self.remove(self.begun / 2);
                    continue;
                }
            }
            if self.finalised == self.begun {
                self.finalise();
            }
            let Queued { counted, corrections, .. } = self.queue[self.begun / 2];
            self.pending[half] -= counted[half];
            if let Some(Correction { limited_um, rest_um }) = corrections[half] {
                self.monitor.corrected(limited_um.map(f64::from), rest_um.into());
            }
            self.estimator.forget(HalfTick::from(burst.start), &mut over);
            let merged = if half == 1 && self.lower_stop {
                self.landing = self.walk(&next.planned).after(self.landing);
                self.estimator.begin_stopped(burst, self.landing)
            } else {
                self.estimator.begin(burst)
            };
            if let Some(travel) = merged {
                over(travel);
            }
            self.begun += 1;
            if half == 1 && !self.lower_stop {
                let um = f64::from(next.planned[0]) * UM_PER_PULSE;
                self.scattered += 2.0 * (self.estimator.scatter() * um).powi(2);
                self.reckoned_travel_um += um;
                for (reckoned_um, counted) in self.reckoned_um.iter_mut().zip(counted) {
                    *reckoned_um += counted as f64 / 10.0 * UM_PER_PULSE;
                }
            }
        }
        while self.begun >= 2
            && let Some(first) = self.queue.front().filter(|first| first.stroke.end() <= tick)
        {
            gone(&first.stroke, first.until);
            self.queue.pop_front();
            self.begun -= 2;
            self.finalised -= 2;
        }
        known
    }

    /// Takes a sample of the displacement, µm, after [`Self::advance`] to its tick. Calls `over` with each burst measured.
    pub(crate) fn telemetry(&mut self, tick: Tick, um: f64, mut over: impl FnMut(Travel)) {
        if self.monitor.fault().is_some() || self.estimator.is_stopping(tick) {
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
        self.forget_reckoned();
        if self.monitor.fault().is_some() {
            // Forget what the faulty telemetry taught.
            self.estimator.relearn(&self.gains);
        }
    }

    /// Expected position after all finalised bursts, µm.
    fn position_um(&self) -> f64 {
        let pending = |direction| {
            let tenths = self.pending[gain_index(direction)] as f64;
            sign(direction) * tenths / 10.0 * UM_PER_PULSE * self.estimator.gain(direction)
        };
        self.estimator.position_um() + pending(Direction::Up) + pending(Direction::Down)
    }

    /// Expected rest position, µm: leaves out an up burst whose down burst is not finalised.
    pub(crate) fn rest_um(&self) -> f64 {
        let half = if self.finalised % 2 == 1 {
            let up = self.queue[self.finalised / 2].counted[0] as f64 / 10.0;
            up * UM_PER_PULSE * self.estimator.gain(Direction::Up)
        } else {
            0.0
        };
        self.position_um() - half
    }

    /// Distance from rest to expect by dead reckoning, root mean square, µm: the expected offset and what is uncertain. 0 if
    /// nothing was reckoned since the last sample.
    pub(crate) fn dead_reckoning_um(&self) -> f64 {
        match self.dead_reckoning_sd_um() {
            0.0 => 0.0,
            sd => sd.hypot(self.rest_um()),
        }
    }

    /// Error of the rest position since the last sample, one standard deviation, µm.
    fn dead_reckoning_sd_um(&self) -> f64 {
        let drift = ASYMMETRY.min(self.estimator.asymmetry_sd()) * self.reckoned_travel_um;
        (self.scattered + drift * drift).sqrt()
    }

    /// The rest error of strokes with these planned counts, from one to the next.
    fn walk(&self, planned: &[u16; 2]) -> ReflectedWalk {
        let [up, down] = planned.map(|pulses| f64::from(pulses) * UM_PER_PULSE);
        let Gains { mean, scatter, .. } = self.gains;
        let spread = if self.is_calibrated() {
            Spread::measured(scatter, mean, [0.0; 2])
        } else {
            Spread { scatter, asymmetry: ASYMMETRY }
        };
        ReflectedWalk::new(up, down - up, spread)
    }

    /// With a lower stop: root mean square of the rest error to expect, µm.
    pub(crate) fn landing_rms_um(&self) -> Option<f64> {
        let [mean, variance] = self.landing;
        self.lower_stop.then(|| (mean * mean + variance).sqrt())
    }

    /// The count that takes the next burst to its planned end point; if a limit cuts it, also the correction made, µm.
    ///
    /// No stroke yet to be queued begins before `free`. `may_lengthen` allows more pulses than planned.
    fn target_pulses(&self, free: impl Fn() -> Tick, may_lengthen: bool) -> (u16, Option<f64>) {
        let (at, half) = (self.finalised / 2, self.finalised % 2);
        let Queued { stroke, planned, until, .. } = self.queue[at];
        let next = self.queue.get(at + 1).map_or_else(free, |next| next.stroke.up).min(until);
        let most = |half: usize, room: u64, limit: u16| {
            let more = if may_lengthen { correction(planned[half]) } else { 0 };
            let most = planned[half].saturating_add(more).min(limit);
            most.min(u16::try_from(room).unwrap_or(u16::MAX))
        };
        let up_most = most(0, stroke.down - stroke.up, MAX_UP_PULSES);
        let down_most = most(1, next - stroke.down, MAX_DOWN_PULSES).max(planned[1]);
        let burst = stroke.bursts()[half];
        let gain = self.estimator.gain(burst.direction) * after_rest(self.finalised_end(), burst.start);
        let position = self.position_um() / UM_PER_PULSE;
        let (way, most) = match burst.direction {
            Direction::Up if self.lower_stop => (f64::from(planned[0]) - position, up_most),
            Direction::Up => {
                let down = f64::from(down_most) * self.estimator.gain(Direction::Down);
                let top = down / (1.0 + HEADROOM * self.estimator.scatter());
                (top.min(planned[0].into()) - position, up_most)
            }
            Direction::Down => (position, down_most),
        };
        let least = planned[half].saturating_sub(correction(planned[half])).max(1);
        let ideal = (way / gain).round().clamp(0.0, 65_535.0) as u16;
        let count = ideal.min(most).max(least);
        let more = f64::from(count) - f64::from(planned[half]);
        (count, (count != ideal).then_some(sign(burst.direction) * more * gain * UM_PER_PULSE))
    }

    /// When the next burst begins whose count is not final.
    pub(crate) fn next(&self) -> Option<Tick> {
        self.queue.get(self.finalised / 2).map(|queued| queued.burst(self.finalised % 2).start)
    }

    /// Finalises the counts of bursts that are due, and of one that begins within [`FINALISE_EARLY`].
    ///
    /// Calls `amend` with each change (the stroke's up tick, direction, count); it returns whether the change was sent. No
    /// stroke yet to be queued begins before `free`. `fresh`: telemetry is recent. `may_lengthen` allows more pulses than
    /// planned.
    pub(crate) fn correct(
        &mut self,
        now: Tick,
        free: impl Fn() -> Tick,
        fresh: bool,
        may_lengthen: bool,
        mut amend: impl FnMut(Tick, Direction, u16) -> bool,
    ) {
        let mut within = FINALISE_EARLY;
        while let Some(queued) = self.queue.get(self.finalised / 2).copied() {
            let half = self.finalised % 2;
            let burst = queued.burst(half);
            if burst.start > now + within {
                break;
            }
            within = FINALISE_AT;
            let measured = fresh && self.anchored && self.monitor.allows_correction(now);
            // Calibrated gains correct without telemetry too, all but the scatter.
            let reckoned = !fresh && self.is_calibrated() && self.monitor.fault().is_none();
            let corrects = queued.closed_loop && !(half == 1 && self.lower_stop);
            if (measured || reckoned) && corrects && queued.accepted && burst.start >= now + SEND_BY {
                let (pulses, limited_um) = self.target_pulses(&free, may_lengthen);
                let limited_um = limited_um.map(|um| um as f32);
                let correction = Correction { limited_um, rest_um: self.rest_um() as f32 };
                self.queue[self.finalised / 2].corrections[half] = Some(correction);
                if pulses != burst.pulses && amend(queued.stroke.up, burst.direction, pulses) {
                    let stroke = &mut self.queue[self.finalised / 2].stroke;
                    match burst.direction {
                        Direction::Up => stroke.up_pulses = pulses,
                        Direction::Down => stroke.down_pulses = pulses,
                    }
                }
            }
            self.finalise();
        }
    }
}
