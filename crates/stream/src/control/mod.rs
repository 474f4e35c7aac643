//! Position control: holds the rest position and amplitude of each shaft by correcting bursts shortly before they begin.
//!
//! The streamer reports strokes and telemetry to [`PositionControl`] and asks it for corrections. Per motor, `estimator` tracks
//! the shaft from delayed, quantised, averaged telemetry with gaps; `telemetry_monitor` detects sensor faults; `burst_controller`
//! decides the count of each burst as late as the link allows. `replacement` keeps the strokes that the device has been asked to
//! withdraw, until it answers. `standing` keeps how high pins stand that a cut has left above rest. A motor with a sensor fault plays on in open loop. So does one that settles so slowly, and is driven so
//! fast, that the estimator cannot hold all bursts under way: status shows `dead-reckoning` as the source of its error. Without
//! telemetry the loop uses dead reckoning: it corrects what the gains of a calibrated motor predict, and the estimated error of the
//! rest position grows, up to the end stops.
//!
//! Invariant: it never allocates; counts stay within `limits::correction` of the plan and within the room between
//! bursts; it changes planned bursts only, so a motor that is not driven does not move.

mod burst_controller;
mod estimator;
mod queued;
mod replacement;
mod standing;
mod telemetry_monitor;
#[cfg(test)]
mod tests;

use burst_controller::{BurstController, Passed, Times};
pub use estimator::{Gains, MeasuredBurst};
pub(super) use queued::Cutting;

use crate::queues::{Heights, LATELY_MS, Movement, RestErrors};
use crate::settings::Settings;
use crate::sync::atomic::Ordering;
use crate::time::HostInstant;
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::Amendment;
use firmware_protocol::controller::HORIZON;
use firmware_protocol::message::State;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_api::ErrorSource;
use meissner_api::SensorFault;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::{Array, MAX_MOTORS};
use meissner_array::strokes::{Burst, Step};
use replacement::Replacement;
use standing::{Standing, Stood};

/// Without telemetry a stroke counts as played so long after it begins, ms: the device's verdict has come by then.
const REPORTED_MS: u64 = 50;
/// What a pin does now is what it did in so long a time, ms.
const SPAN_MS: u64 = 200;

/// Some of a play's strokes: those that begin at `from` or later and before `until`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub(super) from: Tick,
    pub(super) until: Tick,
    /// Those of these motors.
    pub(super) motors: MotorSet,
}

/// The position control of all motors.
#[derive(Debug)]
pub(super) struct PositionControl {
    array: Array,
    times: Times,
    motors: Vec<BurstController>,
    /// The tick of the last sample.
    last_sample: Option<Tick>,
    /// Bursts up to this tick count as played without telemetry: older samples are too late.
    advanced_to: Tick,
    /// There are on-time limits. The device may refuse strokes as they begin. Bursts do not get longer than planned: that
    /// would use up on-time.
    limited: bool,
    /// Distance of the end stops from rest, µm.
    end_stop_um: f32,
    /// The device sends telemetry: a sample may still be on its way.
    telemetry: bool,
    /// A cut or its return may move pins until then.
    cut_until: Tick,
    /// Strokes that the device has been asked to withdraw.
    replacement: Replacement,
    /// Earlier samples still show motion from before the last cut; `None`: pins are not at rest yet.
    valid_from: Option<Tick>,
    /// Telemetry shows all pins, or did until the last cut.
    seen: bool,
    /// The first status of a device at rest since the last sample.
    unseen_since: Option<Tick>,
    /// Pins that a cut may have left above rest.
    standing: Standing,
    /// When they stood.
    stood: Stood,
    /// The device seeks the lower stop, or such a seek was cut.
    seeks: bool,
}

impl PositionControl {
    pub(super) fn new(settings: &Settings) -> Self {
        let array = settings.array;
        let mut control = Self {
            array,
            times: Times::of(array),
            limited: settings.is_limited(),
            end_stop_um: settings.end_stop_um,
            telemetry: true,
            cut_until: Tick(0),
            replacement: Replacement::new(array),
            motors: array.numbers().map(|_| BurstController::new(array, &Gains::default())).collect(),
            last_sample: None,
            advanced_to: Tick(0),
            valid_from: None,
            seen: false,
            unseen_since: None,
            standing: Standing::none(array),
            stood: Stood::default(),
            seeks: false,
        };
        let has_stop = settings.lower_stop.is_some();
        control.motors.iter_mut().for_each(|motor| motor.set_lower_stop(has_stop));
        control
    }

    /// The array whose motors it controls.
    pub(super) const fn array(&self) -> Array {
        self.array
    }

    /// The device has flushed the queue, and has begun nothing after `begun_by`. It returns the pins, so telemetry means nothing
    /// until they are at rest. What it played counts up to `now`; `None`: the link is lost.
    pub(super) fn cut(&mut self, begun_by: Tick, now: Option<Tick>) {
        if now.is_none() {
            (self.seen, self.unseen_since) = (false, None);
        }
        if now.is_some() {
            self.bound_standing(&self.highest(begun_by));
        }
        self.motors.iter_mut().for_each(|motor| motor.remember(begun_by));
        if let Some(now) = now {
            self.reckon_to(now);
        }
        let cut_at = now.map_or(begun_by, |now| now.min(begun_by));
        self.motors.iter_mut().for_each(|motor| motor.cut(cut_at));
        self.stood.cut_at = cut_at;
        self.cut_until = cut_at + u64::from(self.array.motor().most_pulses);
        self.replacement.clear();
        (self.last_sample, self.advanced_to) = (None, Tick(0));
        self.valid_from = None;
    }

    /// The highest level of each pin by the moves that are not over and begin before `until`.
    pub(super) fn highest(&self, until: Tick) -> PerMotor<u16> {
        PerMotor::from_fn(self.array, |motor| self.motors[usize::from(motor)].highest(until))
    }

    /// Moves were cut, or the link is lost: pins may stand so high.
    pub(super) fn bound_standing(&mut self, highest: &PerMotor<u16>) {
        self.standing.bound(highest);
    }

    /// The device has cut its moves at a tick, and had so many return pulses outstanding then.
    pub(super) fn was_cut(&mut self, cut: Cutting, outstanding: u32) {
        if self.seeks {
            return;
        }
        let Self { standing, motors, .. } = self;
        let before = *standing.heights();
        if !standing.cut(cut, outstanding, |motor| motors[usize::from(motor)].height_at(cut.at)) {
            self.lowered(&before, cut.at, cut.returned.is_some());
        }
        match cut.returned {
            None => self.stood.cut(cut.at, &before, self.standing.heights()),
            Some(end) => self.stood.end(Some(cut.at), end, &before),
        }
    }

    /// The device has cut the moves of a play. If it has returned the pins, it began with all at once, so that the highest came down last.
    pub(super) fn moves_were_cut(&mut self, cut: Cutting) {
        let down = self.motors.iter_mut().filter_map(|motor| motor.was_cut(cut.at));
        let mut down = down.collect::<heapless::Vec<_, MAX_MOTORS>>();
        let highest = down.iter().map(|down| down.from).max().unwrap_or(0);
        if let Some(end) = cut.returned {
            down.iter_mut()
                .for_each(|down| down.burst.start = cut.at.max(Tick(end.0.saturating_sub(highest.into()))));
        }
    }

    /// The device has no return pulses outstanding at `tick`, but for those that it plays within the render horizon.
    pub(super) fn are_down(&mut self, tick: Tick) {
        self.stood.end(None, tick + u64::from(HORIZON), self.standing.heights());
    }

    /// The pins that stand are lower than `before`, at `tick`.
    fn lowered(&mut self, before: &PerMotor<u16>, tick: Tick, goes_on: bool) {
        let heights = before.iter().zip(self.standing.heights());
        for (motor, (before, after)) in self.motors.iter_mut().zip(heights) {
            motor.lowered(before.saturating_sub(*after), tick, goes_on);
        }
    }

    /// The device seeks the lower stop: until that is over it knows of no heights, and each pin stands at most as high as before.
    pub(super) const fn will_seek(&mut self) {
        self.seeks = true;
    }

    /// Whether the device seeks the lower stop, or such a seek was cut.
    pub(super) const fn seeks(&self) -> bool {
        self.seeks
    }

    /// The device does nothing, knows where its pins are, and has so many return pulses outstanding.
    pub(super) fn stands(&mut self, outstanding: u32, tick: Tick) {
        self.seeks = false;
        if outstanding == 0 {
            self.returned(tick);
        } else {
            let before = *self.standing.heights();
            self.standing.bound_by(outstanding, self.array.layout().max_up_pulses());
            self.lowered(&before, tick, false);
        }
    }

    /// A move up of this motor was cut.
    pub(super) fn move_was_cut(&mut self, motor: u8, pulses: u16) {
        self.standing.raise(motor, pulses);
    }

    /// The device has brought all pins down.
    fn returned(&mut self, tick: Tick) {
        self.seeks = false;
        self.are_down(tick);
        if let Some(heights) = self.standing.end() {
            self.motors.iter_mut().zip(&heights).for_each(|(motor, &pulses)| motor.returned(pulses, tick));
        }
    }

    /// The highest pin that a cut may have left above rest, pulses; 0: none.
    pub(super) fn highest_standing(&self) -> u16 {
        self.standing.highest()
    }

    /// The device has started again, and its clock with it: it does not return the pins that stand.
    pub(super) fn restarted(&mut self) {
        self.leave_standing();
        self.motors.iter_mut().for_each(BurstController::restarted);
    }

    /// The device does not return the pins that stand, and no person has checked them: from here on their height counts as an
    /// error of their rest position, which the next sample may show.
    pub(super) fn leave_standing(&mut self) {
        self.seen &= self.standing.highest() == 0;
        for (motor, &pulses) in self.motors.iter_mut().zip(self.standing.heights()) {
            motor.stay_up(pulses);
        }
        self.standing.clear();
    }

    /// A command was sent that cuts the play, at a tick unknown until the answer.
    pub(super) fn will_be_cut(&mut self) {
        self.valid_from = None;
    }

    /// At `tick` the device takes strokes: after a cut the pins have stopped, and telemetry shows where.
    pub(super) fn at_rest(&mut self, tick: Tick) {
        self.returned(tick);
        self.valid_from = self.valid_from.or(Some(tick + self.array.motor().settled_ticks()));
        let since = *self.unseen_since.get_or_insert(tick);
        self.seen &= tick - since <= self.array.rate().per_s();
    }

    /// A device was connected, which sends telemetry or not. Its clock may have begun again.
    pub(super) fn connected(&mut self, telemetry: bool) {
        self.telemetry = telemetry;
        self.cut_until = Tick(0);
        self.stood = Stood::default();
        self.motors.iter_mut().for_each(BurstController::forget_trail);
    }

    /// Nothing is known of the pins: they may be as far off as the end stops.
    pub(super) fn lose_rest(&mut self) {
        let um = f64::from(self.end_stop_um);
        self.motors.iter_mut().for_each(|motor| motor.lose_rest(um));
    }

    /// Without telemetry: counts what was played up to `tick`, so that the estimates are those of now.
    pub(super) fn reckon_to(&mut self, tick: Tick) {
        if !self.telemetry {
            self.advance_to(tick);
        }
    }

    /// Takes all strokes up to `tick` as played, without waiting for reports.
    fn advance_to(&mut self, tick: Tick) {
        for motor in &mut self.motors {
            motor.advance(tick, None, |_| ());
        }
        self.advanced_to = self.advanced_to.max(tick);
    }

    /// The operator says that all pins are at rest.
    pub(super) fn assume_rest(&mut self) {
        self.motors.iter_mut().for_each(BurstController::assume_rest);
        self.standing.clear();
    }

    /// The operator arms: clears the sensor faults.
    pub(super) fn clear_faults(&mut self) {
        self.motors.iter_mut().for_each(BurstController::clear_faults);
    }

    /// Uses the gains of a calibration.
    pub(super) fn set_gains(&mut self, gains: &PerMotor<Gains>) {
        self.motors.iter_mut().zip(gains).for_each(|(motor, gains)| motor.set_gains(gains));
    }

    /// The sensor fault of each motor.
    pub(super) fn faults(&self) -> PerMotor<Option<SensorFault>> {
        PerMotor::from_fn(self.array, |motor| self.motors[usize::from(motor)].fault())
    }

    /// A pin's offset from rest, µm, and whether telemetry measured it; `None` without telemetry and calibration.
    pub(super) fn offset_um(&self, motor: u8, now: Tick) -> Option<(f64, bool)> {
        let motor = self.motors.get(usize::from(motor)).filter(|motor| motor.fault().is_none())?;
        let measured = self.has_recent_telemetry(now) && motor.is_measured() && !motor.is_blind(now);
        let stop = if measured { f64::INFINITY } else { self.end_stop_um.into() };
        (measured || motor.is_calibrated()).then(|| (motor.rest_um().clamp(-stop, stop), measured))
    }

    /// Whether any burst can be corrected; `telemetry`: the device sends it.
    pub(super) fn corrects(&self, telemetry: bool) -> bool {
        telemetry || self.motors.iter().any(BurstController::is_calibrated)
    }

    /// Whether a motor has a sensor fault.
    pub(super) fn is_faulted(&self, motor: u8) -> bool {
        self.motors.get(usize::from(motor)).is_some_and(|motor| motor.fault().is_some())
    }

    /// Mean gain of a motor's move that begins at `start`.
    pub(super) fn move_gain(&self, motor: u8, direction: Direction, start: Tick) -> f64 {
        self.motors.get(usize::from(motor)).map_or(1.0, |motor| motor.move_gain(direction, start))
    }

    /// A move of a pin begins at `start` and is over and visible at `until`.
    pub(super) fn moved(&mut self, motor: u8, direction: Direction, pulses: u16, start: Tick, until: Tick) {
        if let Some(motor) = self.motor(motor) {
            motor.moved(direction, pulses, start);
        }
        self.valid_from = Some(until);
    }

    /// Whether a sample was taken at `tick` or later.
    pub(super) fn sampled_after(&self, tick: Tick) -> bool {
        self.last_sample.is_some_and(|sampled| sampled >= tick)
    }

    /// The largest error by dead reckoning of these motors, root mean square, µm. 0 if telemetry is about to show them.
    pub(super) fn dead_reckoning_um(&self, now: Tick, motors: impl Iterator<Item = u8>) -> f32 {
        if self.seen {
            return 0.0;
        }
        let of = motors.filter_map(|motor| self.motors.get(usize::from(motor)));
        let errors = of.map(|motor| self.error_um(motor, now));
        let reckoned = errors.filter(|(_, source)| *source == ErrorSource::DeadReckoning);
        reckoned.map(|(um, _)| um).fold(0.0, f32::max)
    }

    /// The same of all motors once the pins that stand have been returned.
    pub(super) fn returned_reckoning_um(&self, now: Tick) -> f32 {
        let of = |(motor, &pulses): (u8, &u16)| {
            let short_um = self.motors[usize::from(motor)].short_um(pulses, now).max(0.0) as f32;
            self.dead_reckoning_um(now, std::iter::once(motor)) + short_um
        };
        (0..).zip(self.standing.heights()).map(of).fold(0.0, f32::max)
    }

    fn motor(&mut self, motor: u8) -> Option<&mut BurstController> {
        self.motors.get_mut(usize::from(motor))
    }

    /// A step was sent to the device; its play ends at `until`.
    pub(super) fn sent(&mut self, step: &Step, closed_loop: bool, until: Tick) {
        if let Some(motor) = self.motor(step.motor()) {
            motor.sent(step, closed_loop, until);
        }
    }

    /// When the last pulse of a play from `onset` to `until` was over; `cut` tells whether the device has cut the play. `None` if
    /// nothing was played, or if too much time has passed to know. Corrections count as sent.
    pub(super) fn over_at(&self, onset: Tick, until: Tick, cut: Option<Cutting>) -> Option<Tick> {
        let mut over = self.motors.iter().map(|motor| motor.over_at(onset, until, cut));
        over.try_fold(None, |last: Option<Tick>, over| over.map(|over| last.max(over))).ok().flatten()
    }

    /// Of the strokes of `span` that the device has accepted: the first start of those not known to be over, and the last end of
    /// all.
    pub(super) fn span(&self, span: Span) -> [Option<Tick>; 2] {
        let Span { from, until, motors } = span;
        let of_item = || self.motors.iter().zip(0..).filter(|(_, motor)| motors.contains(*motor));
        let queued = of_item().flat_map(|(motor, _)| motor.in_device()).map(|passed| passed.burst);
        let gone = of_item().filter_map(|(motor, _)| motor.trail().last(from, until).ok().flatten());
        let gone = gone.map(|passed| passed.burst.end()).max();
        let [first, last] = ends(queued.filter(|burst| burst.start >= from && burst.start < until));
        [first, last.max(gone)]
    }

    /// Of what a motor has after a tick in the device: the first start and the last end.
    pub(super) fn queued(&self, motor: u8, after: Tick) -> [Option<Tick>; 2] {
        let of_motor = self.motors.get(usize::from(motor)).into_iter().flat_map(BurstController::in_device);
        ends(of_motor.map(|passed| passed.burst).filter(|burst| burst.start > after))
    }

    /// The device has been asked to withdraw the strokes of these motors that begin at `from` or later. Until it answers,
    /// [`Self::replaced`], they count neither as queued nor as gone. Those that take their place are [`sent`](Self::sent) next.
    pub(super) fn replace(&mut self, motors: MotorSet, from: Tick) {
        self.replacement.begin(motors, from);
        for motor in self.motors.iter_mut().zip(0..).filter(|(_, index)| motors.contains(*index)) {
            motor.0.take_from(from, |queued| self.replacement.hold(queued));
        }
    }

    /// The device has withdrawn the old strokes of `motors`, and none of the motors `kept`: the old strokes of these are queued
    /// again in place of those sent since.
    pub(super) fn replaced(&mut self, motors: MotorSet, kept: MotorSet) {
        let from = self.replacement.from();
        for (motor, index) in self.motors.iter_mut().zip(0..).filter(|(_, index)| kept.contains(*index)) {
            motor.take_from(from, |_| ());
            self.replacement.of(index).for_each(|queued| motor.put_back(queued));
        }
        self.replacement.end(motors | kept);
    }

    /// The device has accepted a stroke.
    pub(super) fn accepted(&mut self, motor: u8, up: Tick) {
        if self.replacement.accepted(motor, up) {
            return;
        }
        if let Some(motor) = self.motor(motor) {
            motor.accepted(up);
        }
    }

    /// The device will not play a stroke.
    pub(super) fn withdrawn(&mut self, motor: u8, up: Tick) {
        if self.replacement.withdrawn(motor, up) {
            return;
        }
        if let Some(motor) = self.motor(motor) {
            motor.withdrawn(up);
        }
    }

    /// A step came too late: the device does not play it, but brings the pin down from `rendered` on if it was a move down.
    pub(super) fn late(&mut self, motor: u8, begin: Tick, rendered: Tick) {
        if self.replacement.withdrawn(motor, begin) {
            return;
        }
        if let Some(motor) = self.motor(motor) {
            motor.late(begin, rendered);
        }
    }

    /// The device has brought pins down that were held for too long.
    pub(super) fn hold_ended(&mut self, motors: MotorSet, tick: Tick) {
        for (motor, index) in self.motors.iter_mut().zip(0..).filter(|(_, index)| motors.contains(*index)) {
            motor.hold_ended(index, tick);
        }
    }

    /// The device has refused a step as it began. Returns how many moves it had.
    pub(super) fn refused_as_begun(&mut self, motor: u8, up: Tick) -> u64 {
        // The one that it replaced may have begun at the same tick: neither is played.
        self.replacement.withdrawn(motor, up);
        let Some(motor) = self.motor(motor) else { return 0 };
        let moves = motor.moves_at(up);
        motor.withdrawn(up);
        moves as u64
    }

    /// The device took no stroke with an up tick from `onset` on.
    pub(super) fn withdraw_from(&mut self, onset: Tick) {
        self.motors.iter_mut().for_each(|motor| motor.withdraw_from(onset));
    }

    /// Bursts and pulses played after the counters of tick `heard`, if the link was lost at `lost`: the device brings all pins down then.
    /// With `stopped` an e-stop left the host at that tick: nothing later was played.
    pub(super) fn played_since_counters(&self, heard: Tick, lost: Tick, stopped: bool) -> (u64, u64) {
        let (mut bursts, mut pulses) = (0, 0);
        let until = if stopped { lost } else { Tick(u64::MAX) };
        for motor in &self.motors {
            let begun = || motor.in_device().take_while(|passed| passed.burst.start < lost);
            let above = begun().last().map_or_else(|| motor.trail().level(), |last| last.to);
            let uncounted = motor.trail().played().rev().take_while(|passed| passed.burst.end() > heard);
            for Passed { burst, .. } in uncounted.chain(begun()) {
                bursts += u64::from(burst.start >= heard);
                pulses += burst.end().min(until) - burst.start.max(heard);
            }
            pulses += if stopped { 0 } else { above.into() };
        }
        (bursts, pulses)
    }

    /// Takes a sample of all displacements, 0.01 µm. Calls `over` with each burst measured.
    ///
    /// The device has reported which strokes before `known_to` it refused. A motor with a later stroke that may have begun
    /// does not use the sample; then it returns false.
    pub(super) fn telemetry(
        &mut self,
        tick: Tick,
        y: &[i32],
        known_to: Tick,
        mut over: impl FnMut(MeasuredBurst),
    ) -> bool {
        let old = self.last_sample.is_some_and(|last| tick <= last) || tick < self.advanced_to;
        if old || self.valid_from.is_none_or(|from| tick < from) {
            return true;
        }
        self.last_sample = Some(tick);
        let known_to = Some(if self.limited { known_to } else { tick });
        let mut known = true;
        for ((motor, &y), index) in self.motors.iter_mut().zip(y).zip(0..) {
            let mut over = |travel: estimator::Travel| over(travel.of(index));
            if motor.advance(tick, known_to, &mut over) {
                motor.telemetry(tick, f64::from(y) * 0.01, &mut over);
            } else {
                known = false;
            }
        }
        let shown = |motor: &BurstController| motor.fault().is_none() && !motor.is_blind(tick);
        (self.seen, self.unseen_since) = (self.motors.iter().all(shown), None);
        known
    }

    /// Finalises the counts of bursts that begin soon, and calls `amend` with those that change. Strokes of a motor that
    /// are not sent yet do not begin before `free`.
    pub(super) fn correct(
        &mut self,
        now: Tick,
        free: impl Fn(u8) -> Tick,
        mut amend: impl FnMut(&Amendment) -> bool,
    ) {
        let fresh = self.last_sample.is_some_and(|sampled| now - sampled <= self.times.longest_age);
        if !fresh {
            let reported = self.array.rate().of_ms(REPORTED_MS);
            let late = if self.telemetry { self.times.longest_age } else { reported };
            self.advance_to(Tick(now.0.saturating_sub(late)));
        }
        let mut next = self.motors.iter().filter_map(BurstController::next);
        if next.all(|next| next > now + self.times.finalise_at) {
            return;
        }
        let may_lengthen = !self.limited;
        for (motor, index) in self.motors.iter_mut().zip(0..) {
            motor.correct(
                now,
                || free(index),
                fresh,
                may_lengthen,
                |tick, pulses| amend(&Amendment { motor: index, tick, pulses }),
            );
        }
    }

    /// Whether no burst is left to finalise.
    pub(super) fn is_idle(&self) -> bool {
        self.motors.iter().all(|motor| motor.next().is_none())
    }

    /// Whether telemetry shows all pins, or did until the last cut. Then it is expected to show them as soon as the motors are
    /// armed again. If it does not, this ends after a second.
    pub(super) const fn sees_all(&self) -> bool {
        self.seen
    }

    /// Whether the last sample is less than a second old.
    fn has_recent_telemetry(&self, now: Tick) -> bool {
        self.last_sample.is_some_and(|sampled| now - sampled <= self.array.rate().per_s())
    }

    /// Estimated rest error of each shaft, µm, and its source. By the lower stop and by dead reckoning: root
    /// mean square to expect; by dead reckoning at most the distance of the end stops, because no shaft can be farther off.
    /// The height of a pin that a cut has left above rest is part of it, unless telemetry shows it.
    pub(super) fn rest_error_um(&self, now: Tick) -> RestErrors {
        let um_per_pulse = self.array.motor().um_per_pulse as f32;
        let mut errors = RestErrors::none(self.array);
        let of = self.motors.iter().zip(self.standing.heights());
        for ((motor, &pulses), (um, source)) in of.zip(errors.um.iter_mut().zip(&mut errors.source)) {
            (*um, *source) = self.error_um(motor, now);
            if pulses > 0 && *source != ErrorSource::Telemetry {
                (*um, *source) = (*um + f32::from(pulses) * um_per_pulse, ErrorSource::DeadReckoning);
            }
        }
        errors
    }

    /// What each pin does now: how far and how often it moved in the last [`SPAN_MS`], as planned. The device's state says whether
    /// pins that a cut has left above rest stand or are on their way down.
    pub(super) fn movements(&self, now: Tick, state: State) -> PerMotor<Movement> {
        let rate = self.array.rate();
        let span = [Tick(now.0.saturating_sub(rate.of_ms(SPAN_MS))), now];
        PerMotor::from_fn(self.array, |motor| {
            let index = usize::from(motor);
            let (moved, high) = (self.motors[index].movement(span, rate), self.standing.heights()[index]);
            match state {
                State::Disarmed if high == 0 => moved,
                State::Disarmed | State::Faulted => Movement { low: high, high, hz: 0.0 },
                State::Armed | State::Returning => Movement { high: high.max(moved.high), ..moved },
            }
        })
    }

    /// Writes what each pin did lately until `tick`, as planned; none: it is not known. `stands`: the device does nothing and has return
    /// pulses outstanding.
    pub(super) fn write_heights(
        &self,
        heights: &Heights,
        now: HostInstant,
        tick: Option<Tick>,
        stands: bool,
    ) {
        let rate = self.array.rate();
        let (tick, most) = tick.map_or((Tick(0), 0), |tick| (tick, LATELY_MS));
        let before = move |ms| Some(Tick(tick.0.checked_sub(rate.of_ms(ms as u64))?));
        let steps = (0..most).take_while(|ms| before(*ms).is_some()).count();
        // Until the device has said when it cut, they stand since then at the latest.
        let since = self.stood.since.or(stands.then_some(self.stood.cut_at));
        heights.write(now, tick, steps, self.motors.len(), |motor, places| {
            let mut places = places.iter();
            self.motors[motor].course((0..steps).rev().filter_map(before), |tick, moved| {
                let stands = since.filter(|since| *since <= tick).map(|_| self.standing.heights()[motor]);
                let height = stands.or_else(|| self.stood.height(motor, tick)).unwrap_or(moved);
                if let Some(place) = places.next() {
                    place.store(height, Ordering::Relaxed);
                }
            });
        });
    }

    /// Whether a pin may have moved in the last [`SPAN_MS`]. Moves that are still queued do not count.
    pub(super) fn moved_lately(&self, now: Tick) -> bool {
        let still_from = self.motors.iter().map(|motor| motor.trail().still_from());
        now < still_from.fold(self.cut_until, Tick::max) + self.array.rate().of_ms(SPAN_MS)
    }

    /// [`Self::rest_error_um`] of one motor.
    #[inline]
    fn error_um(&self, motor: &BurstController, now: Tick) -> (f32, ErrorSource) {
        if self.has_recent_telemetry(now) && motor.fault().is_none() && !motor.is_blind(now) {
            return (motor.rest_um() as f32, ErrorSource::Telemetry);
        }
        if let Some(landing) = motor.landing_rms_um() {
            return (landing as f32, ErrorSource::LowerStop);
        }
        match motor.dead_reckoning_um() {
            0.0 => (motor.rest_um() as f32, ErrorSource::None),
            um => ((um as f32).min(self.end_stop_um), ErrorSource::DeadReckoning),
        }
    }
}

/// The first start and the last end of these bursts.
fn ends(bursts: impl Iterator<Item = Burst>) -> [Option<Tick>; 2] {
    bursts.fold([None, None], |[first, last], burst| {
        let start = burst.start;
        [Some(first.map_or(start, |first: Tick| first.min(start))), last.max(Some(burst.end()))]
    })
}
