//! The closed loop: holds each shaft's rest position and amplitude by correcting bursts shortly before they begin.
//!
//! Per motor a `burst_controller` knows the bursts on their way and settles the count of each as late as the link allows, from
//! what its `estimator` makes of telemetry that is delayed, quantised, averaged and has gaps. `telemetry_monitor` looks whether that
//! telemetry can be the motor's at all; if not, the motor plays on in open loop. Without telemetry all is dead
//! reckoned: what a calibrated motor's gains say is corrected, and the error of the rest position is an estimate that grows.
//!
//! It only computes, and never allocates: counts stay within `limits::correction` of the plan and within the room between
//! bursts, and only bursts that are planned are changed, so a motor that is not driven does not move.

mod bound;
mod burst_controller;
mod estimator;
mod telemetry_monitor;

pub(super) use burst_controller::{BurstController, DUE, LONGEST_AGE};
pub use estimator::Gains;

use crate::queues::MeasuredBurst;
pub use bound::rest_bound_um;
use firmware_protocol::batch::Amendment;
use firmware_protocol::limits::OnTimeLimits;
use firmware_protocol::stroke::{Direction, MOTORS, Stroke};
use firmware_protocol::tick::Tick;
use meissner_api::ErrorSource;
use meissner_api::SensorFault;
use meissner_array::motor::WINDOW_TICKS;
use meissner_array::units::TICKS_PER_S;

/// The loop over all motors.
#[derive(Debug)]
pub(super) struct PositionControl {
    motors: [BurstController; MOTORS],
    /// When the last telemetry was sampled.
    sampled: Option<Tick>,
    /// Up to where bursts were taken for played without telemetry: older samples come too late.
    followed: Tick,
    /// Bursts may get longer than planned: not where a site limits on-time, which the longer ones would use up.
    longer: bool,
    /// When the device's counters were last heard.
    heard: Tick,
    /// Bursts and pulses of strokes forgotten since the device's counters were last heard.
    unheard: (u64, u64),
    /// Samples before this still show motion from before the last cut; none if pins are not at rest yet.
    valid_from: Option<Tick>,
}

impl PositionControl {
    pub(super) fn new(limits: &OnTimeLimits) -> Self {
        let mut control = Self {
            longer: false,
            heard: Tick(0),
            motors: std::array::from_fn(|_| BurstController::new(&Gains::default())),
            sampled: None,
            followed: Tick(0),
            unheard: (0, 0),
            valid_from: None,
        };
        control.limit(limits);
        control
    }

    /// The site's limits from now on.
    pub(super) fn limit(&mut self, limits: &OnTimeLimits) {
        self.longer = *limits == OnTimeLimits::NONE;
    }

    /// What was queued is flushed, pins are being returned: what telemetry shows until they are at rest means nothing.
    pub(super) fn cut(&mut self) {
        self.motors.iter_mut().for_each(BurstController::cut);
        (self.sampled, self.followed) = (None, Tick(0));
        self.valid_from = None;
    }

    /// A command was sent that cuts what is played; when, nobody knows until it is answered.
    pub(super) fn will_be_cut(&mut self) {
        self.valid_from = None;
    }

    /// At `tick` the device takes strokes: after a cut all pins are at rest. Where they really are, telemetry tells.
    pub(super) fn at_rest(&mut self, tick: Tick) {
        self.valid_from = self.valid_from.or(Some(tick + WINDOW_TICKS));
    }

    /// Nothing is owed and nothing was moved: the person says all pins are at rest.
    pub(super) fn assume_rest(&mut self) {
        self.motors.iter_mut().for_each(BurstController::assume_rest);
    }

    /// A person arms: telemetry that was not believed is given another chance.
    pub(super) fn clear_faults(&mut self) {
        self.motors.iter_mut().for_each(BurstController::clear_faults);
    }

    /// Motors have been calibrated.
    pub(super) fn calibrate(&mut self, gains: &[Gains; MOTORS]) {
        self.motors.iter_mut().zip(gains).for_each(|(motor, gains)| motor.calibrate(gains));
    }

    /// Why the telemetry of each motor is not believed.
    pub(super) fn faults(&self) -> [Option<SensorFault>; MOTORS] {
        self.motors.each_ref().map(BurstController::fault)
    }

    /// How far a pin is from its rest, µm, and whether that was measured; `None` if there is nothing to go by.
    pub(super) fn off_by_um(&self, motor: u8, now: Tick) -> Option<(f64, bool)> {
        let motor = self.motors.get(usize::from(motor)).filter(|motor| motor.fault().is_none())?;
        let measured = self.is_heard(now) && motor.is_measured();
        (measured || motor.is_calibrated()).then(|| (motor.rest_um(), measured))
    }

    /// Whether bursts may be corrected at all on a device with or without telemetry.
    pub(super) fn steers(&self, telemetry: bool) -> bool {
        telemetry || self.motors.iter().any(BurstController::is_calibrated)
    }

    /// Whether a motor's telemetry is not believed.
    pub(super) fn is_faulted(&self, motor: u8) -> bool {
        self.motors.get(usize::from(motor)).is_some_and(|motor| motor.fault().is_some())
    }

    /// Mean gain of a motor.
    pub(super) fn gain(&self, motor: u8, direction: Direction) -> f64 {
        self.motors.get(usize::from(motor)).map_or(1.0, |motor| motor.gain(direction))
    }

    /// A move of a pin is over at `until`.
    pub(super) fn moved(&mut self, motor: u8, direction: Direction, pulses: u16, until: Tick) {
        if let Some(motor) = self.motor(motor) {
            motor.moved(direction, pulses);
        }
        self.valid_from = Some(until);
    }

    /// Whether telemetry has told how things stand since `tick`.
    pub(super) fn sampled_after(&self, tick: Tick) -> bool {
        self.sampled.is_some_and(|sampled| sampled >= tick)
    }

    /// The largest error by dead reckoning, one standard deviation, µm.
    pub(super) fn reckoned_um(&self, now: Tick) -> f32 {
        let all = self.rest_error_um(now).into_iter();
        let reckoned = all.filter(|(_, source)| *source == ErrorSource::DeadReckoning);
        reckoned.map(|(um, _)| um).fold(0.0, f32::max)
    }

    fn motor(&mut self, motor: u8) -> Option<&mut BurstController> {
        self.motors.get_mut(usize::from(motor))
    }

    /// A stroke of a play that ends at `until` was sent to the device.
    pub(super) fn sent(&mut self, stroke: &Stroke, steered: bool, until: Tick) {
        if let Some(motor) = self.motor(stroke.motor) {
            motor.sent(stroke, steered, until);
        }
    }

    /// The device has accepted it.
    pub(super) fn accepted(&mut self, motor: u8, up: Tick) {
        if let Some(motor) = self.motor(motor) {
            motor.accepted(up);
        }
    }

    /// The device will not play it.
    pub(super) fn withdrawn(&mut self, motor: u8, up: Tick) {
        if let Some(motor) = self.motor(motor) {
            motor.withdrawn(up);
        }
    }

    /// Nothing sent with an up tick from `onset` on was taken.
    pub(super) fn withdraw_from(&mut self, onset: Tick) {
        self.motors.iter_mut().for_each(|motor| motor.withdraw_from(onset));
    }

    /// The device has told its counters as they stood at `tick`.
    pub(super) fn heard(&mut self, tick: Tick) {
        (self.heard, self.unheard) = (tick, (0, 0));
    }

    /// Bursts and pulses played since the device's counters were heard at `heard`, if the link was lost at `lost`:
    /// what had begun by then the device has brought to its end.
    pub(super) fn played_unheard(&self, heard: Tick, lost: Tick) -> (u64, u64) {
        let queued = self.motors.iter().flat_map(BurstController::in_device);
        let played = queued.filter(|stroke| stroke.end() > heard && stroke.up < lost);
        played
            .fold(self.unheard, |(bursts, pulses), stroke| (bursts + 2, pulses + u64::from(stroke.pulses())))
    }

    /// Displacements in 0.01 µm. Tells what bursts have come to.
    pub(super) fn telemetry(&mut self, tick: Tick, y: &[i32; MOTORS], mut over: impl FnMut(MeasuredBurst)) {
        let old = self.sampled.is_some_and(|last| tick <= last) || tick < self.followed;
        if old || self.valid_from.is_none_or(|from| tick < from) {
            return;
        }
        self.sampled = Some(tick);
        let (unheard, heard) = (&mut self.unheard, self.heard);
        for ((motor, &y), index) in self.motors.iter_mut().zip(y).zip(0..) {
            let mut over = |travel: estimator::Travel| over(travel.of(index));
            if motor.follow(tick, false, &mut over, |stroke| count(unheard, heard, stroke)) {
                motor.telemetry(tick, f64::from(y) * 0.01, &mut over);
            }
        }
    }

    /// Settles the counts of bursts that begin soon, telling those that change. Strokes of a motor that were not sent yet
    /// do not begin before `free`.
    pub(super) fn correct(
        &mut self,
        now: Tick,
        free: impl Fn(u8) -> Tick,
        mut amend: impl FnMut(&Amendment) -> bool,
    ) {
        let fresh = self.sampled.is_some_and(|sampled| now - sampled <= LONGEST_AGE);
        if !fresh {
            let (unheard, heard) = (&mut self.unheard, self.heard);
            let past = Tick(now.0.saturating_sub(LONGEST_AGE));
            for motor in &mut self.motors {
                motor.follow(past, true, |_| (), |stroke| count(unheard, heard, stroke));
            }
            self.followed = past;
        }
        let mut next = self.motors.iter().filter_map(BurstController::next);
        if next.all(|next| next > now + DUE) {
            return;
        }
        let longer = self.longer;
        for (motor, index) in self.motors.iter_mut().zip(0..) {
            motor.correct(
                now,
                || free(index),
                fresh,
                longer,
                |up, direction, pulses| amend(&Amendment { motor: index, up, direction, pulses }),
            );
        }
    }

    /// Whether no stroke is on its way.
    pub(super) fn is_idle(&self) -> bool {
        self.motors.iter().all(|motor| motor.next().is_none())
    }

    /// Whether telemetry was taken within a second.
    fn is_heard(&self, now: Tick) -> bool {
        self.sampled.is_some_and(|sampled| now - sampled <= TICKS_PER_S)
    }

    /// Where each shaft is thought to rest, µm, and how that is known. By dead reckoning: one standard deviation.
    pub(super) fn rest_error_um(&self, now: Tick) -> [(f32, ErrorSource); MOTORS] {
        let fresh = self.is_heard(now);
        self.motors.each_ref().map(|motor| match (fresh && motor.fault().is_none(), motor.reckoned_um()) {
            (true, _) => (motor.rest_um() as f32, ErrorSource::Telemetry),
            (false, 0.0) => (motor.rest_um() as f32, ErrorSource::None),
            (false, reckoned) => (reckoned as f32, ErrorSource::DeadReckoning),
        })
    }
}

/// Counts a stroke that is forgotten, unless the device's counters already control it.
fn count(unheard: &mut (u64, u64), heard: Tick, stroke: &Stroke) {
    if stroke.end() > heard {
        unheard.0 += 2;
        unheard.1 += u64::from(stroke.pulses());
    }
}
