//! Simulated run of one motor and its burst controller: a pin, delayed telemetry and wake-ups, without a link.
//!
//! [`MotorRun::run`] plays a square wave and reports each period. Tests judge the position control with it over
//! thousands of settings: a day of device time takes seconds. Controller and pin are those of a real play; the
//! deadline for corrections includes the delay of the link.

use crate::control::Gains;
use crate::control::burst_controller::{BurstController, Times};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_api::SensorFault;
use meissner_array::motor::{Excursion, MotorError};
use meissner_array::pattern::Drive;
use meissner_array::simulated::{Pin, SimulatedMotorsConfig};
use meissner_array::spec::Array;
use meissner_array::strokes::{Burst, DriveStrokes, Stroke};
use std::collections::VecDeque;

/// The settings of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MotorRun {
    /// The array of the motor.
    pub(super) array: Array,
    /// Of the square wave.
    pub(super) frequency_hz: f64,
    /// Of the square wave, peak to peak.
    pub(super) amplitude_um: f64,
    /// How far ahead strokes are sent, ms.
    pub(super) lead_ms: f64,
    /// Age of telemetry at its arrival, ms.
    pub(super) age_ms: f64,
    /// Telemetry samples per second.
    pub(super) telemetry_hz: f64,
    /// Standard deviation of a burst's gain.
    pub(super) scatter: f64,
    /// Gain up minus gain down; their mean is 1.
    pub(super) asymmetry: f64,
    /// Mean gain of a burst after a rest.
    pub(super) transient_gain: f64,
    /// Position of the pin at the beginning, µm.
    pub(super) offset_um: f64,
    /// Seed of the random draws.
    pub(super) seed: u64,
    /// Correct bursts.
    pub(super) closed: bool,
    /// The controller's initial gains.
    pub(super) gains: Gains,
}

impl MotorRun {
    /// A motor of this array at 60 Hz and 80 µm, with the mock's telemetry.
    pub(super) fn of(array: Array) -> Self {
        Self {
            array,
            frequency_hz: 60.0,
            amplitude_um: 80.0,
            lead_ms: 100.0,
            age_ms: 1.0,
            telemetry_hz: 1000.0,
            scatter: 0.1,
            asymmetry: 0.02,
            transient_gain: array.motor().transient_gain,
            offset_um: 0.0,
            seed: 0,
            closed: true,
            gains: Gains::default(),
        }
    }
}

/// One period as played.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Period {
    /// When its stroke went up, ticks from the beginning.
    pub(super) up: u64,
    /// Ideal travel of either burst as planned, µm.
    pub(super) planned_um: f64,
    /// True position after the up burst, µm.
    pub(super) top_um: f64,
    /// True position after the down burst: the rest error, µm.
    pub(super) rest_um: f64,
    /// Pulses of both bursts.
    pub(super) pulses: [u16; 2],
}

impl MotorRun {
    /// Least time from the newest sample that a burst's count can use to the burst, ms.
    pub(super) fn delay_ms(&self) -> f64 {
        self.age_ms + self.array.rate().ticks_to_ms(Times::of(self.array).finalise_at)
    }

    /// Plays for `seconds` and calls `on_period` with each period; `alter` may change or drop samples (tick, 0.01 µm).
    /// Returns the sensor fault, if the controller found one.
    ///
    /// # Errors
    /// If the frequency or amplitude is out of range.
    pub(super) fn run(
        &self,
        seconds: f64,
        mut alter: impl FnMut(Tick, i32) -> Option<i32>,
        mut on_period: impl FnMut(&Period),
    ) -> Result<Option<SensorFault>, MotorError> {
        let Self { array, frequency_hz, amplitude_um, .. } = *self;
        let (rate, times) = (array.rate(), Times::of(array));
        let drive = Drive { motor: 0, frequency_hz, amplitude_um, phase: 0.0, start_s: None, stop_s: None };
        // The first stroke is late enough to be corrected.
        let strokes = DriveStrokes::of(array, &drive)?.shifted(2 * times.finalise_at, u64::MAX);
        let Self { seed, scatter: gain_sd, transient_gain, .. } = *self;
        let config = SimulatedMotorsConfig {
            seed,
            gain_sd,
            transient_gain: Some(transient_gain),
            ..SimulatedMotorsConfig::default()
        };
        let pin = Pin::new(array, &config, 0).with_asymmetry(self.asymmetry).at(self.offset_um);
        let mut controller = BurstController::new(array, &self.gains);
        let start = Tick::BOOT;
        let end = start + rate.seconds_to_ticks(seconds);
        let (lead, age) =
            (rate.seconds_to_ticks(self.lead_ms / 1000.0), rate.seconds_to_ticks(self.age_ms / 1000.0));
        let mut strokes = strokes.map(|stroke| {
            let pulses = stroke.pulses.min(array.motor().most_pulses.into());
            Excursion { pulses, ..stroke }.stroke(0, start)
        });
        let mut next = strokes.next();
        let um_per_pulse = array.motor().um_per_pulse;
        let mut motor = Motor { pin, um_per_pulse, queue: VecDeque::new(), half: 0, top_um: 0.0 };
        let mut samples: VecDeque<(Tick, i32)> = VecDeque::new();
        let (mut sampled, mut number, mut now) = (start, 0_u64, start);
        let sample_tick =
            |number: u64| start + (rate.seconds_in_ticks(number as f64) / self.telemetry_hz) as u64;
        // The loop wakes up every millisecond.
        let wake_up = rate.of_ms(1);
        while now < end {
            now = now + wake_up;
            while let Some(stroke) = next.filter(|stroke| stroke.up < now + lead.max(2 * times.finalise_at)) {
                controller.sent(&stroke.into(), self.closed, end);
                controller.accepted(stroke.up);
                motor.queue.push_back((stroke, stroke.up_pulses));
                next = strokes.next();
            }
            loop {
                let sample = sample_tick(number);
                if let Some(burst) = motor.next().filter(|burst| burst.start <= sample.min(now)) {
                    if let Some(period) = motor.play(burst, start) {
                        on_period(&period);
                    }
                } else if sample <= now {
                    samples.extend(alter(sample, motor.pin.quanta(sample)).map(|y| (sample, y)));
                    number += 1;
                } else {
                    break;
                }
            }
            while let Some((tick, y)) = samples.front().copied().filter(|(tick, _)| *tick + age <= now) {
                samples.pop_front();
                controller.advance(tick, Some(tick), |_| ());
                controller.telemetry(tick, f64::from(y) * 0.01, |_| ());
                sampled = tick;
            }
            if controller.next().is_some_and(|next| next <= now + times.finalise_at) {
                let free = || next.map_or(end, |stroke| stroke.up);
                let fresh = now - sampled <= times.longest_age;
                let amend = |tick, pulses| motor.amend(tick, pulses);
                controller.correct(now, free, fresh, true, amend);
            }
        }
        Ok(controller.fault())
    }
}

/// The simulated device: strokes as they will be played, and the pin.
struct Motor {
    pin: Pin,
    um_per_pulse: f64,
    /// Strokes with their planned pulses.
    queue: VecDeque<(Stroke, u16)>,
    /// The next burst of the first stroke: 0 up, 1 down.
    half: usize,
    top_um: f64,
}

impl Motor {
    fn next(&self) -> Option<Burst> {
        self.queue.front().map(|(stroke, _)| stroke.bursts()[self.half])
    }

    /// Plays the next burst; a down burst ends a period.
    fn play(&mut self, burst: Burst, start: Tick) -> Option<Period> {
        self.pin.play(burst);
        let um = self.pin.position_um(burst.end());
        self.half = 1 - self.half;
        if burst.direction == Direction::Up {
            self.top_um = um;
            return None;
        }
        let (stroke, planned) = self.queue.pop_front()?;
        Some(Period {
            up: stroke.up - start,
            planned_um: f64::from(planned) * self.um_per_pulse,
            top_um: self.top_um,
            rest_um: um,
            pulses: [stroke.up_pulses, stroke.down_pulses],
        })
    }

    /// These strokes have no surplus: the pulses of a way down are all of its burst.
    fn amend(&mut self, tick: Tick, pulses: u16) -> bool {
        for (stroke, _) in &mut self.queue {
            if stroke.up == tick {
                stroke.up_pulses = pulses;
                return true;
            }
            if stroke.down == tick {
                stroke.down_pulses = pulses;
                return true;
            }
        }
        false
    }
}
