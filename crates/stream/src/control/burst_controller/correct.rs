//! Decides the pulse count of each burst shortly before it begins, and marks it as final.
//!
//! Invariant: a count stays within [`correction`] of the plan and within the room to the next burst and the play's end.

use super::BurstController;
use crate::control::estimator::{after_rest, sign};
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
}

impl Times {
    pub(crate) fn of(array: Array) -> Self {
        let rate = array.rate();
        let one_and_a_half_ms = rate.of_ms(3) / 2;
        let (send_by, finalise_at) = (one_and_a_half_ms, 2 * one_and_a_half_ms);
        let finalise_early = finalise_at + rate.of_ms(2);
        Self { send_by, finalise_at, finalise_early, longest_age: rate.per_s() * 5 / 4 }
    }
}

/// Without room to lengthen the down burst, the top is lowered by so many standard deviations of the scatter.
const HEADROOM: f64 = 0.5;

impl BurstController {
    /// Marks the next burst's count as final.
    pub(super) fn finalise(&mut self) {
        let (at, half) = (self.finalised / 2, self.finalised % 2);
        let burst = self.queue[at].burst(half);
        let counted = if half == 1 && self.lower_stop {
            // The burst takes the pin down to the stop from wherever it is, and no further.
            let um_per_pulse = self.um_per_pulse();
            let pulses = self.position_um() / (um_per_pulse * self.estimator.gain(Direction::Down));
            (10.0 * pulses).round() as i64
        } else {
            let gain = after_rest(self.estimator.motor(), self.finalised_end(), burst.start);
            (10.0 * f64::from(burst.pulses) * gain).round() as i64
        };
        self.queue[at].counted[half] = counted;
        self.pending[half] += counted;
        self.finalised += 1;
    }

    /// When the last finalised burst ends that the device has not refused.
    pub(super) fn finalised_end(&self) -> Option<Tick> {
        if self.finalised == self.begun {
            return self.estimator.last_end();
        }
        let last = self.finalised - 1;
        Some(self.queue[last / 2].burst(last % 2).end())
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
        let motor = self.estimator.motor();
        let most_down = motor.most_pulses + correction(motor.most_pulses);
        let up_most = most(0, stroke.down - stroke.up, motor.most_pulses);
        let down_most = most(1, next - stroke.down, most_down).max(planned[1]);
        let burst = stroke.bursts()[half];
        let gain =
            self.estimator.gain(burst.direction) * after_rest(motor, self.finalised_end(), burst.start);
        let position = self.position_um() / motor.um_per_pulse;
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
        (count, (count != ideal).then_some(sign(burst.direction) * more * gain * motor.um_per_pulse))
    }

    /// When the next burst begins whose count is not final.
    pub(crate) fn next(&self) -> Option<Tick> {
        self.queue.get(self.finalised / 2).map(|queued| queued.burst(self.finalised % 2).start)
    }

    /// Finalises the counts of bursts that are due, and of one that begins within [`Times::finalise_early`].
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
        mut amend: impl FnMut(Tick, u16) -> bool,
    ) {
        let Times { send_by, finalise_at, finalise_early, .. } = self.times;
        let fresh = fresh && !self.is_blind(now);
        let mut within = finalise_early;
        while let Some(queued) = self.queue.get(self.finalised / 2).copied() {
            let half = self.finalised % 2;
            let burst = queued.burst(half);
            if burst.start > now + within {
                break;
            }
            within = finalise_at;
            let measured = fresh && self.anchored && self.monitor.allows_correction(now);
            // Calibrated gains correct without telemetry too, all but the scatter.
            let reckoned = !fresh && self.is_calibrated() && self.monitor.fault().is_none();
            let corrects = queued.closed_loop && !(half == 1 && self.lower_stop);
            if (measured || reckoned) && corrects && queued.accepted && burst.start >= now + send_by {
                let (pulses, limited_um) = self.target_pulses(&free, may_lengthen);
                let limited_um = limited_um.map(|um| um as f32);
                let correction = Correction { limited_um, rest_um: self.rest_um() as f32 };
                self.queue[self.finalised / 2].corrections[half] = Some(correction);
                // The device adds the surplus itself.
                let [up, down] = queued.planned;
                let surplus = if half == 1 { down.saturating_sub(up) } else { 0 };
                let sent = pulses.saturating_sub(surplus).max(1);
                if pulses != burst.pulses && amend(burst.start, sent) {
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
