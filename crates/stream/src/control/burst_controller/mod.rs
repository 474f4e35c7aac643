//! The burst controller of one motor: tracks the bursts sent and decides the pulse count of each.
//!
//! `correct` decides the counts, `rest` says where the pin rests between plays and without telemetry.
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

mod correct;
mod rest;

pub(crate) use correct::Times;

use super::estimator::{Estimator, Gains, Travel, gain_index};
use super::queued::{Correction, Cutting, Forgotten, Queued};
use super::telemetry_monitor::{Plausibility, TelemetryMonitor};
use firmware_protocol::controller::POOL;
use firmware_protocol::tick::Tick;
use meissner_api::SensorFault;
use meissner_array::motor::HalfTick;
use meissner_array::spec::Array;
use meissner_array::strokes::Stroke;
use std::collections::VecDeque;

/// Strokes of one motor that may begin in [`Times::longest_age`], at 300 Hz.
const PAST: usize = 400;
/// Strokes that a motor remembers after a cut: those that began until the device said when it cut. It says so within milliseconds.
const CUT: usize = 8;
/// The controller of one motor.
#[derive(Debug)]
pub(crate) struct BurstController {
    times: Times,
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
    /// The controller of a motor of this array.
    pub(crate) fn new(array: Array, gains: &Gains) -> Self {
        let mut queue = VecDeque::with_capacity(POOL + PAST);
        // Touch every page now: pages are locked at their first touch, which must not fall into a play.
        queue.resize(queue.capacity(), Queued::NOTHING);
        queue.clear();
        Self {
            times: Times::of(array),
            queue,
            cut: heapless::Deque::new(),
            begun: 0,
            finalised: 0,
            pending: [0; 2],
            gains: *gains,
            estimator: Estimator::new(array.motor(), gains),
            monitor: TelemetryMonitor::new(array.rate()),
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

    /// Takes the strokes with an up tick from `from` on that the estimator does not know as begun, and passes each to `taken`, the last
    /// first.
    pub(in crate::control) fn take_from(&mut self, from: Tick, mut taken: impl FnMut(Queued)) {
        while let Some(last) = self.queue.back().copied().filter(|last| last.stroke.up >= from) {
            let at = self.queue.len() - 1;
            if self.begun > 2 * at {
                break;
            }
            self.remove(at);
            taken(Queued { counted: [0; 2], corrections: [None; 2], ..last });
        }
    }

    /// Queues a stroke again that [`Self::take_from`] has taken.
    pub(in crate::control) fn put_back(&mut self, queued: Queued) {
        // There is room: as many were taken, and the newer ones are gone.
        self.queue.push_back(queued);
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

    /// When the last pulse is over of the strokes that began at `from` or later and before `until`. If the device cut
    /// them at `cut`, nothing of them comes after it but, if the pins return, their outstanding return pulses. [Strokes that have
    /// left the queue](Self::advance) are not among them. `Err`: too many strokes began after that cut.
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

    /// Strokes that the device has accepted.
    pub(crate) fn in_device(&self) -> impl Iterator<Item = Stroke> {
        self.queue.iter().filter(|queued| queued.accepted).map(|queued| queued.stroke)
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
                let um_per_pulse = self.um_per_pulse();
                let um = f64::from(next.planned[0]) * um_per_pulse;
                self.scattered += 2.0 * (self.estimator.scatter() * um).powi(2);
                self.reckoned_travel_um += um;
                for (reckoned_um, counted) in self.reckoned_um.iter_mut().zip(counted) {
                    *reckoned_um += counted as f64 / 10.0 * um_per_pulse;
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
        self.forget_reckoned();
        if self.monitor.fault().is_some() {
            // Forget what the faulty telemetry taught.
            self.estimator.relearn(&self.gains);
        }
    }
}
