//! The closed loop, first version: holds each shaft's rest position by correcting bursts shortly before they begin.
//!
//! Per motor a model shaft follows the bursts as commanded. Telemetry minus the model is the *offset*: what
//! scatter and asymmetry have added so far, seen through the same moving average. Each burst is given the count
//! of pulses that leads from where the shaft is thought to be, commanded position plus offset, to where the
//! pattern wants it at the burst's end: dead beat, once per burst, as late as the link allows. The model knows
//! of the corrections, so the delay of telemetry does not make the loop ring; a correction that got lost on
//! the link turns up in the offset like any other error.
//!
//! It only computes: counts stay within `limits::correction` of the plan and within the room between bursts.

use crate::motor::{HalfTick, Ramp, Shaft};
use crate::stream::port::ErrorSource;
use crate::units::UM_PER_PULSE;
use firmware_protocol::batch::Amendment;
use firmware_protocol::controller::POOL;
use firmware_protocol::limits::{MAX_UP_PULSES, correction};
use firmware_protocol::stroke::{Burst, Direction, MOTORS, Stroke};
use firmware_protocol::tick::{TICK_HZ, Tick};
use std::collections::VecDeque;

/// A correction leaves when its burst is this near: later is fresher, but it must not come too late.
const LATEST: u64 = TICK_HZ as u64 / 1000 * 3 / 2;
/// Half of it per wake-up of 1 ms, and one to spare.
const EARLIEST: u64 = LATEST + TICK_HZ as u64 / 1000 * 2;
/// Telemetry older than this steers nothing.
const STALE: u64 = TICK_HZ as u64 / 50;
/// Displacement follows the commanded position within the moving average's window.
const WINDOW: u64 = 366;
/// Scatter of a burst's travel, for dead reckoning (the paper's Fig. 2).
const SCATTER: f64 = 0.10;

/// A stroke in the device, as far as is known.
#[derive(Clone, Copy, Debug)]
struct Queued {
    stroke: Stroke,
    /// Counts as planned.
    planned: [u16; 2],
    steered: bool,
}

impl Queued {
    fn burst(&self, half: usize) -> Burst {
        self.stroke.bursts()[half]
    }
}

#[derive(Debug)]
struct Motor {
    queue: VecDeque<Queued>,
    /// Bursts of `queue`, from its front, that the model has followed.
    modelled: usize,
    /// Bursts of `queue`, from its front, whose count is settled.
    settled: usize,
    /// Pulses commanded by all settled bursts since the last reset, up less down.
    net: i32,
    shaft: Shaft,
    /// True displacement minus the model's, µm.
    offset_um: f64,
    /// Dead reckoning's variance of the rest position, µm².
    variance: f64,
}

impl Motor {
    fn new() -> Self {
        let nothing = Stroke { motor: 0, up: Tick(0), up_pulses: 0, down: Tick(0), down_pulses: 0 };
        let mut queue = VecDeque::with_capacity(POOL + 64);
        // Touched once: memory is locked page by page, and the first touch must not fall into a play.
        queue.resize(queue.capacity(), Queued { stroke: nothing, planned: [0; 2], steered: false });
        queue.clear();
        Self {
            queue,
            modelled: 0,
            settled: 0,
            net: 0,
            shaft: Shaft::default(),
            offset_um: 0.0,
            variance: 0.0,
        }
    }

    fn pop(&mut self) {
        if let Some(done) = self.queue.pop_front() {
            // What was never looked at is settled as planned.
            for half in self.settled..2 {
                self.net += signed(done.burst(half));
            }
            self.modelled = self.modelled.saturating_sub(2);
            self.settled = self.settled.saturating_sub(2);
            let travel_um = f64::from(done.planned[0]) * UM_PER_PULSE;
            self.variance += 2.0 * (SCATTER * travel_um).powi(2);
        }
    }

    /// Lets the model follow all bursts that begin before `tick`, and forgets strokes that are over.
    fn follow(&mut self, tick: Tick, unheard: &mut (u64, u64)) {
        while let Some(next) = self.queue.get(self.modelled / 2) {
            let burst = next.burst(self.modelled % 2);
            if burst.start >= tick {
                break;
            }
            self.shaft.push(Ramp::new(burst.start, burst.pulses.into(), burst.direction, 1.0));
            self.modelled += 1;
        }
        while let Some(first) = self.queue.front().filter(|first| first.stroke.end() <= tick)
            && self.modelled >= 2
        {
            unheard.0 += 2;
            unheard.1 += u64::from(first.stroke.pulses());
            self.pop();
        }
    }

    /// The count that leads burst `index` to where the plan wants the shaft.
    fn wanted(&self, index: usize) -> Option<u16> {
        let queued = self.queue.get(index / 2)?;
        let half = index % 2;
        let (planned, stroke) = (queued.planned[half], queued.stroke);
        let position = f64::from(self.net) + self.offset_um / UM_PER_PULSE;
        let (count, least, room) = if half == 0 {
            let room = (stroke.down - stroke.up).min(MAX_UP_PULSES.into());
            (f64::from(planned) - position, 1, room)
        } else {
            let next = self.queue.get(index / 2 + 1);
            // Without a next stroke in sight, one may still come right behind this one.
            let room = next.map_or(planned.into(), |next| next.stroke.up - stroke.down);
            (position, 1, room)
        };
        let (low, high) =
            (planned.saturating_sub(correction(planned)), planned.saturating_add(correction(planned)));
        let high = u64::from(high).min(room) as u16;
        Some((count.round().clamp(0.0, 65_535.0) as u16).min(high).max(low.max(least)))
    }
}

fn signed(burst: Burst) -> i32 {
    match burst.direction {
        Direction::Up => i32::from(burst.pulses),
        Direction::Down => -i32::from(burst.pulses),
    }
}

/// The loop over all motors.
#[derive(Debug)]
pub(super) struct Hold {
    motors: [Motor; MOTORS],
    /// When the last telemetry was sampled.
    sampled: Option<Tick>,
    /// Bursts and pulses of strokes forgotten since the device's counters were last heard.
    unheard: (u64, u64),
    /// Samples before this still show motion from before the last cut; none if pins are not at rest yet.
    valid_from: Option<Tick>,
}

impl Hold {
    pub(super) fn new() -> Self {
        Self {
            motors: std::array::from_fn(|_| Motor::new()),
            sampled: None,
            unheard: (0, 0),
            valid_from: None,
        }
    }

    /// What was queued is flushed, pins are being returned: what telemetry shows until they are at rest means nothing.
    pub(super) fn cut(&mut self) {
        for motor in &mut self.motors {
            motor.queue.clear();
            (motor.modelled, motor.settled, motor.net) = (0, 0, 0);
            motor.shaft.reset();
        }
        self.sampled = None;
        self.valid_from = None;
    }

    /// At `tick` the device takes strokes: after a cut all pins are at rest. Where they really are, telemetry tells.
    pub(super) fn at_rest(&mut self, tick: Tick) {
        self.valid_from = self.valid_from.or(Some(tick + WINDOW));
    }

    /// Nothing is owed and nothing was moved: the person says all pins are at rest.
    pub(super) fn forget_drift(&mut self) {
        for motor in &mut self.motors {
            motor.variance = 0.0;
        }
    }

    /// A stroke was accepted by the device.
    pub(super) fn accepted(&mut self, stroke: &Stroke, steered: bool) {
        let motor = &mut self.motors[usize::from(stroke.motor)];
        // Without telemetry the past is forgotten here: the queue is as bounded as the device's pool.
        if motor.queue.len() == motor.queue.capacity() {
            motor.pop();
        }
        let planned = [stroke.up_pulses, stroke.down_pulses];
        motor.queue.push_back(Queued { stroke: *stroke, planned, steered });
    }

    /// A queued stroke was refused when it should have begun.
    pub(super) fn refused(&mut self, motor: u8, up: Tick) {
        let Some(motor) = self.motors.get_mut(usize::from(motor)) else { return };
        if let Some(at) = motor.queue.iter().position(|queued| queued.stroke.up == up) {
            if motor.modelled > 2 * at {
                // The model has gone up already: it comes down as planned, and so does `net`.
                motor.queue[at].steered = false;
                return;
            }
            for half in 0..motor.settled.saturating_sub(2 * at).min(2) {
                motor.net -= signed(motor.queue[at].burst(half));
            }
            let stroke = &mut motor.queue[at].stroke;
            (stroke.up_pulses, stroke.down_pulses) = (0, 0);
        }
    }

    /// The device has told its counters.
    pub(super) fn heard(&mut self) {
        self.unheard = (0, 0);
    }

    /// Bursts and pulses played since the device's counters were heard at `heard`, if the link was lost at `lost`:
    /// what had begun by then the device has brought to its end.
    pub(super) fn played_unheard(&self, heard: Tick, lost: Tick) -> (u64, u64) {
        let queued = self.motors.iter().flat_map(|motor| &motor.queue).map(|queued| queued.stroke);
        let played = queued.filter(|stroke| stroke.end() > heard && stroke.up < lost);
        played
            .fold(self.unheard, |(bursts, pulses), stroke| (bursts + 2, pulses + u64::from(stroke.pulses())))
    }

    /// Displacements in 0.01 µm.
    pub(super) fn telemetry(&mut self, tick: Tick, y: &[i32; MOTORS]) {
        if self.valid_from.is_none_or(|from| tick < from) || self.sampled.is_some_and(|last| tick <= last) {
            return;
        }
        self.sampled = Some(tick);
        for (motor, &y) in self.motors.iter_mut().zip(y) {
            motor.follow(tick, &mut self.unheard);
            motor.offset_um = f64::from(y) * 0.01 - motor.shaft.displacement_um(HalfTick::from(tick));
            motor.variance = 0.0;
        }
    }

    /// Settles the counts of bursts that begin soon, telling those that change.
    pub(super) fn correct(&mut self, now: Tick, mut amend: impl FnMut(&Amendment) -> bool) {
        let fresh = self.sampled.is_some_and(|sampled| now - sampled <= STALE);
        for (motor, index) in self.motors.iter_mut().zip(0..) {
            if !fresh {
                motor.follow(Tick(now.0.saturating_sub(STALE)), &mut self.unheard);
            }
            while let Some(queued) = motor.queue.get(motor.settled / 2).copied() {
                let half = motor.settled % 2;
                let burst = queued.burst(half);
                if burst.start > now + EARLIEST {
                    break;
                }
                let in_time = burst.start >= now + LATEST;
                let wanted = motor.wanted(motor.settled).filter(|_| fresh && queued.steered && in_time);
                if let Some(pulses) = wanted.filter(|&pulses| pulses != burst.pulses && burst.pulses > 0) {
                    let direction = burst.direction;
                    let item = Amendment { motor: index, up: queued.stroke.up, direction, pulses };
                    if amend(&item) {
                        let stroke = &mut motor.queue[motor.settled / 2].stroke;
                        let count = if half == 0 { &mut stroke.up_pulses } else { &mut stroke.down_pulses };
                        *count = pulses;
                    }
                }
                motor.net += signed(motor.queue[motor.settled / 2].burst(half));
                motor.settled += 1;
            }
        }
    }

    /// Where each shaft is thought to rest, µm, and how that is known. By dead reckoning: one standard deviation.
    pub(super) fn rest_error_um(&self, now: Tick) -> ([f32; MOTORS], ErrorSource) {
        if self.sampled.is_some_and(|sampled| now - sampled <= u64::from(TICK_HZ)) {
            let at_rest = |motor: &Motor| {
                // The pulses of a stroke that is half settled are not rest.
                let half = if motor.settled % 2 == 1 {
                    motor.queue.get(motor.settled / 2).map_or(0, |queued| signed(queued.burst(0)))
                } else {
                    0
                };
                (f64::from(motor.net - half) * UM_PER_PULSE + motor.offset_um) as f32
            };
            (self.motors.each_ref().map(at_rest), ErrorSource::Telemetry)
        } else if self.motors.iter().any(|motor| motor.variance > 0.0) {
            (self.motors.each_ref().map(|motor| motor.variance.sqrt() as f32), ErrorSource::DeadReckoning)
        } else {
            (self.motors.each_ref().map(|motor| motor.offset_um as f32), ErrorSource::None)
        }
    }
}
