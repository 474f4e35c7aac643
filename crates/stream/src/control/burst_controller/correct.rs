//! Decides the pulse count of each burst shortly before it begins, and marks it as final.
//!
//! Invariant: a count stays within [`correction`] of the plan and within the room to the next burst and the play's end.

use super::BurstController;
use crate::control::estimator::{after_rest, gain_index, sign};
use crate::control::queued::{Correction, Queued};
use firmware_protocol::limits::correction;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;

/// The times of corrections, in ticks of an array.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Times {
    /// A correction leaves at least this long before its burst: later uses fresher telemetry, but must not be late.
    send_by: u64,
    /// A burst is finalised this long before it begins: one wake-up of 1 ms fits before `send_by`, with 0.5 ms to spare.
    pub(crate) finalise_at: u64,
    /// If a correction leaves anyway, those due within 2 ms leave with it: a frame costs as many bytes as three corrections.
    finalise_early: u64,
    /// The controller neither uses nor waits for telemetry older than this.
    pub(crate) longest_age: u64,
    /// A burst that the device decides on may wait so long for the drivers.
    pub(super) drivers: u64,
}

impl Times {
    pub(crate) fn of(array: Array) -> Self {
        let rate = array.rate();
        let one_and_a_half_ms = rate.of_ms(3) / 2;
        let (send_by, finalise_at) = (one_and_a_half_ms, 2 * one_and_a_half_ms);
        let finalise_early = finalise_at + rate.of_ms(2);
        let drivers = array.layout().driver_lead().into();
        Self { send_by, finalise_at, finalise_early, longest_age: rate.per_s() * 5 / 4, drivers }
    }
}

/// Without room to lengthen the down burst, the top is lowered by so many standard deviations of the scatter.
const HEADROOM: f64 = 0.5;

impl BurstController {
    /// Marks the next burst's count as final.
    pub(super) fn finalise(&mut self) {
        let Queued { burst, level, .. } = self.queue[self.finalised];
        let counted = if level == 0 && self.has_lower_stop() {
            // The burst takes the pin down to the stop from wherever it is, and no further.
            let um_per_pulse = self.um_per_pulse();
            let pulses = self.position_um() / (um_per_pulse * self.estimator.gain(Direction::Down));
            (10.0 * pulses).round() as i64
        } else {
            let gain = after_rest(self.estimator.motor(), self.finalised_end(), burst.start);
            (10.0 * f64::from(burst.pulses) * gain).round() as i64
        };
        self.queue[self.finalised].counted = counted;
        self.pending[gain_index(burst.direction)] += counted;
        self.finalised += 1;
    }

    /// When the last finalised burst ends that the device has not refused.
    pub(super) fn finalised_end(&self) -> Option<Tick> {
        if self.finalised == self.begun {
            return self.estimator.last_end();
        }
        Some(self.queue[self.finalised - 1].burst.end())
    }

    /// The count that takes the next burst to its level; if a limit cuts it, also the correction made, µm.
    ///
    /// No step yet to be queued begins before `free`. `may_lengthen` allows more pulses than planned.
    fn target_pulses(&self, free: impl Fn() -> Tick, may_lengthen: bool) -> (u16, Option<f64>) {
        let at = self.finalised;
        let motor = self.estimator.motor();
        let most = |at: usize| {
            let Queued { burst, planned, until, .. } = self.queue[at];
            let next = self.queue.get(at + 1).map_or_else(&free, |next| next.burst.start).min(until);
            let more = if may_lengthen { correction(planned) } else { 0 };
            let limit = match burst.direction {
                Direction::Up => motor.most_pulses,
                Direction::Down => motor.most_pulses + correction(motor.most_pulses),
            };
            let room = u16::try_from(next - burst.start).unwrap_or(u16::MAX);
            let most = planned.saturating_add(more).min(limit).min(room);
            if burst.direction == Direction::Up { most } else { most.max(planned) }
        };
        let Queued { burst, planned, level, .. } = self.queue[at];
        let gain =
            self.estimator.gain(burst.direction) * after_rest(motor, self.finalised_end(), burst.start);
        let position = self.position_um() / motor.um_per_pulse;
        let way = match burst.direction {
            Direction::Down => position - f64::from(level),
            Direction::Up => {
                let is_down =
                    |next: &&Queued| next.burst.direction == Direction::Down && !self.has_lower_stop();
                // What the next burst can undo at most.
                let top = self.queue.get(at + 1).filter(is_down).map_or(f64::INFINITY, |next| {
                    let down = f64::from(most(at + 1)) * self.estimator.gain(Direction::Down);
                    f64::from(next.level) + down / (1.0 + HEADROOM * self.estimator.scatter())
                });
                top.min(level.into()) - position
            }
        };
        let least = planned.saturating_sub(correction(planned)).max(1);
        let ideal = (way / gain).round().clamp(0.0, 65_535.0) as u16;
        let count = ideal.min(most(at)).max(least);
        let more = f64::from(count) - f64::from(planned);
        (count, (count != ideal).then_some(sign(burst.direction) * more * gain * motor.um_per_pulse))
    }

    /// When the next burst begins whose count is not final.
    pub(crate) fn next(&self) -> Option<Tick> {
        self.queue.get(self.finalised).map(|queued| queued.burst.start)
    }

    /// Finalises the counts of bursts that are due, and of one that begins within [`Times::finalise_early`].
    ///
    /// Calls `amend` with each change (the tick of the burst, its count); it returns whether the change was sent. No step yet to be queued
    /// begins before `free`. `fresh`: telemetry is recent. `may_lengthen` allows more pulses than
    /// planned.
    pub(crate) fn correct(
        &mut self,
        now: Tick,
        free: impl Fn() -> Tick,
        fresh: bool,
        may_lengthen: bool,
        mut amend: impl FnMut(Tick, u16) -> bool,
    ) {
        let Times { send_by, finalise_at, finalise_early, .. } = self.times;
        let fresh = fresh && !self.is_blind(now);
        let mut within = finalise_early;
        while let Some(queued) = self.queue.get(self.finalised).copied() {
            let Queued { burst, surplus, .. } = queued;
            if burst.start > now + within {
                break;
            }
            within = finalise_at;
            let measured = fresh && self.anchored && self.monitor.allows_correction(now);
            // Calibrated gains correct without telemetry too, all but the scatter.
            let reckoned = !fresh && self.is_calibrated() && self.monitor.fault().is_none();
            let corrects = queued.closed_loop && !(queued.lands() && self.has_lower_stop());
            if (measured || reckoned) && corrects && queued.accepted && burst.start >= now + send_by {
                let (pulses, limited_um) = self.target_pulses(&free, may_lengthen);
                let limited_um = limited_um.map(|um| um as f32);
                let correction = Correction { limited_um, rest_um: self.rest_um() as f32 };
                self.queue[self.finalised].correction = Some(correction);
                // The device adds the surplus itself.
                let sent = pulses.saturating_sub(surplus).max(1);
                if pulses != burst.pulses && amend(burst.start, sent) {
                    self.queue[self.finalised].burst.pulses = pulses;
                }
            }
            self.finalise();
        }
    }
}
