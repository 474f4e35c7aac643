//! One motor and its loop at the level of bursts: the plant's pin, delayed telemetry, wake-ups; no link, no controller.
//!
//! It is what the loop is judged by over thousands of settings: a day of device time takes seconds. Same loop,
//! same plant as in a play; the line's delay is part of how late corrections may come.

use crate::control::{BurstController, DUE, Gains, LONGEST_AGE};
use firmware_protocol::limits::MAX_UP_PULSES;
use firmware_protocol::stroke::{Burst, Direction, Stroke};
use firmware_protocol::tick::Tick;
use meissner_api::SensorFault;
use meissner_array::motor::{Excursion, MotorError};
use meissner_array::pattern::Drive;
use meissner_array::simulated::{Pin, PlantConfig};
use meissner_array::strokes::DriveStrokes;
use meissner_array::units::{TICKS_PER_MS, UM_PER_PULSE, seconds_in_ticks, seconds_to_ticks, ticks_to_ms};
use std::collections::VecDeque;

/// The loop wakes up every millisecond.
const WAKE_UP: u64 = TICKS_PER_MS;

/// What is tried.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorRun {
    /// Of the square wave.
    pub frequency_hz: f64,
    /// Of the square wave, peak to peak.
    pub amplitude_um: f64,
    /// How far ahead strokes are sent.
    pub lead_ms: f64,
    /// How old telemetry is when it comes.
    pub age_ms: f64,
    /// Samples per second.
    pub telemetry_hz: f64,
    /// Standard deviation of a burst's gain.
    pub scatter: f64,
    /// The gain up is 1 and half of this, the gain down 1 less half of it.
    pub asymmetry: f64,
    /// Mean gain of a burst after half a second of rest.
    pub transient_gain: f64,
    /// Where the pin stands at the beginning.
    pub offset_um: f64,
    /// Which draws.
    pub seed: u64,
    /// Corrections are made.
    pub closed: bool,
    /// What the loop believes of the motor at the beginning.
    pub gains: Gains,
}

impl Default for MotorRun {
    /// A motor as the paper has it, at 60 Hz and 80 µm, with telemetry as the mock's.
    fn default() -> Self {
        Self {
            frequency_hz: 60.0,
            amplitude_um: 80.0,
            lead_ms: 100.0,
            age_ms: 1.0,
            telemetry_hz: 1000.0,
            scatter: 0.1,
            asymmetry: 0.02,
            transient_gain: PlantConfig::default().transient_gain,
            offset_um: 0.0,
            seed: 0,
            closed: true,
            gains: Gains::default(),
        }
    }
}

/// One period as it was really played.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Period {
    /// When its stroke went up, ticks from the beginning.
    pub up: u64,
    /// Ideal travel of either burst as planned, µm.
    pub planned_um: f64,
    /// True position after the up burst, µm.
    pub top_um: f64,
    /// True position after the down burst: the rest error, µm.
    pub rest_um: f64,
    /// Pulses of both bursts.
    pub pulses: [u16; 2],
}

impl MotorRun {
    /// From a burst back to the newest sample that its count can go by, at the least, ms.
    #[must_use]
    pub fn delay_ms(&self) -> f64 {
        self.age_ms + ticks_to_ms(DUE)
    }

    /// Plays for so many seconds and tells of each period; `lie` may change samples (tick, 0.01 µm). Returns why the
    /// loop gave its telemetry up, if it did.
    ///
    /// # Errors
    /// A frequency or amplitude no motor can be asked for.
    pub fn run(
        &self,
        seconds: f64,
        mut lie: impl FnMut(Tick, i32) -> Option<i32>,
        mut tell: impl FnMut(&Period),
    ) -> Result<Option<SensorFault>, MotorError> {
        let Self { frequency_hz, amplitude_um, .. } = *self;
        let drive = Drive { motor: 0, frequency_hz, amplitude_um, phase: 0.0, start_s: None, stop_s: None };
        // The first stroke is late enough to be corrected.
        let strokes = DriveStrokes::of(&drive)?.shifted(2 * DUE, u64::MAX);
        let Self { seed, scatter: gain_sd, transient_gain, .. } = *self;
        let config = PlantConfig { seed, gain_sd, transient_gain, ..PlantConfig::default() };
        let pin = Pin::new(&config, 0).with_asymmetry(self.asymmetry).at(self.offset_um);
        let mut burst_controller = BurstController::new(&self.gains);
        let start = Tick::BOOT;
        let end = start + seconds_to_ticks(seconds);
        let (lead, age) = (seconds_to_ticks(self.lead_ms / 1000.0), seconds_to_ticks(self.age_ms / 1000.0));
        let mut strokes = strokes.map(|stroke| {
            let pulses = stroke.pulses.min(MAX_UP_PULSES.into());
            Excursion { pulses, ..stroke }.stroke(0, start)
        });
        let mut next = strokes.next();
        let mut motor = Motor { pin, queue: VecDeque::new(), half: 0, top_um: 0.0 };
        let mut samples: VecDeque<(Tick, i32)> = VecDeque::new();
        let (mut sampled, mut number, mut now) = (start, 0_u64, start);
        let sample_tick = |number: u64| start + (seconds_in_ticks(number as f64) / self.telemetry_hz) as u64;
        while now < end {
            now = now + WAKE_UP;
            while let Some(stroke) = next.filter(|stroke| stroke.up < now + lead.max(2 * DUE)) {
                burst_controller.sent(&stroke, self.closed, end);
                burst_controller.accepted(stroke.up);
                motor.queue.push_back((stroke, stroke.up_pulses));
                next = strokes.next();
            }
            loop {
                let sample = sample_tick(number);
                if let Some(burst) = motor.next().filter(|burst| burst.start <= sample.min(now)) {
                    if let Some(period) = motor.play(burst, start) {
                        tell(&period);
                    }
                } else if sample <= now {
                    samples.extend(lie(sample, motor.pin.quanta(sample)).map(|y| (sample, y)));
                    number += 1;
                } else {
                    break;
                }
            }
            while let Some((tick, y)) = samples.front().copied().filter(|(tick, _)| *tick + age <= now) {
                samples.pop_front();
                burst_controller.follow(tick, false, |_| (), |_| ());
                burst_controller.telemetry(tick, f64::from(y) * 0.01, |_| ());
                sampled = tick;
            }
            if burst_controller.next().is_some_and(|next| next <= now + DUE) {
                let free = || next.map_or(end, |stroke| stroke.up);
                let fresh = now - sampled <= LONGEST_AGE;
                let amend = |up, direction, pulses| motor.amend(up, direction, pulses);
                burst_controller.correct(now, free, fresh, true, amend);
            }
        }
        Ok(burst_controller.fault())
    }
}

/// The device: strokes as they will be played, and the pin.
struct Motor {
    pin: Pin,
    /// Strokes, and their pulses as planned.
    queue: VecDeque<(Stroke, u16)>,
    /// Which burst of the first stroke is next.
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
            planned_um: f64::from(planned) * UM_PER_PULSE,
            top_um: self.top_um,
            rest_um: um,
            pulses: [stroke.up_pulses, stroke.down_pulses],
        })
    }

    fn amend(&mut self, up: Tick, direction: Direction, pulses: u16) -> bool {
        let Some((stroke, _)) = self.queue.iter_mut().find(|(stroke, _)| stroke.up == up) else {
            return false;
        };
        match direction {
            Direction::Up => stroke.up_pulses = pulses,
            Direction::Down => stroke.down_pulses = pulses,
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::pattern::Pattern;
    use meissner_array::strokes::Strokes;

    #[test]
    fn a_run_plays_the_strokes_that_a_pattern_sends() {
        for (frequency_hz, amplitude_um) in [(60.0, 80.0), (7.3, 400.0), (299.0, 30.0), (150.1, 3.3)] {
            let run = MotorRun { frequency_hz, amplitude_um, closed: false, ..MotorRun::default() };
            let mut played = Vec::new();
            run.run(1.0, |_, y| Some(y), |period| played.push((period.up - 2 * DUE, period.pulses))).unwrap();
            let drive =
                Drive { motor: 0, frequency_hz, amplitude_um, phase: 0.0, start_s: None, stop_s: None };
            let pattern = Pattern::new("test", None, vec![drive], toml::Table::new()).unwrap();
            let sent = Strokes::new(&pattern, Some(1.0)).unwrap().map(Result::unwrap);
            let sent: Vec<_> =
                sent.map(|stroke| (stroke.up.0, [stroke.up_pulses, stroke.down_pulses])).collect();
            assert!(!played.is_empty() && sent.starts_with(&played), "{frequency_hz} Hz: {played:?}");
        }
    }
}
