//! Completes strokes: books those that were played, cuts and returns them, or turns them off with return pulses outstanding.
//!
//! Every slot leaves the pool here, counted once as played or dropped.

use crate::controller::changes::Changes;
use crate::controller::drivers::Drivers;
use crate::controller::pool::Kind;
use crate::controller::{Controller, NEVER};
use crate::message::{Cause, Cut, Report, State};
use crate::stroke::{Lines, MOTORS};
use crate::tick::Tick;

impl Controller {
    pub(super) fn disarm(&mut self, cause: Cause) {
        match self.state {
            State::Armed => self.cut(cause, State::Disarmed),
            State::Returning => (self.then, self.cause) = (State::Disarmed, cause),
            State::Disarmed | State::Faulted => {}
        }
    }

    /// Cuts running strokes at the rendered end, flushes the queue and plays the outstanding return pulses as soon as the
    /// drivers are ready and the limits on motors at once allow it.
    pub(super) fn cut(&mut self, cause: Cause, then: State) {
        let (at, ready) = (self.rendered, self.ready());
        let (mut flushed, mut outstanding, mut waiting) = (0, 0, 0);
        for motor in 0..MOTORS {
            let index = self.pool.queues[motor].cursor;
            let Some(slot) = self.pool.get_mut(index) else { continue };
            self.travel[motor] -= slot.shift_undone(at).cast_signed();
            let begun = slot.begun(at);
            if begun {
                waiting |= u32::from(at < slot.stroke.down) << motor;
                outstanding += u32::from(slot.cut_at(at, ready));
            }
            let strokes = self.pool.flush(motor, begun);
            flushed += strokes;
            self.reporting.count().dropped += 2 * u64::from(strokes);
            self.change_by(motor, at);
        }
        self.take_turns(waiting, ready);
        self.next_end = self.next_end.min(at);
        self.finish_cut(cause, true, flushed, outstanding, at);
        (self.state, self.then) = (State::Returning, then);
        self.settle();
    }

    /// Turns all lines off after the tick being played, for an e-stop or a fault.
    pub(super) fn off(&mut self, cause: Cause) {
        self.off_from(cause, (self.now + 1).min(self.rendered));
    }

    /// Turns all lines off; nothing from `at` on was played.
    pub(super) fn off_from(&mut self, cause: Cause, at: Tick) {
        if self.state == State::Faulted {
            return;
        }
        self.board.off(cause);
        self.settle_strokes(at);
        let mut flushed = 0;
        for motor in 0..MOTORS {
            // Most slots are not rendered yet; they are flushed together.
            let strokes = self.pool.flush(motor, true);
            flushed += strokes;
            self.reporting.count().dropped += 2 * u64::from(strokes);
            while let Some(slot) = self.pool.pop(motor) {
                let [up, down] = slot.played_before(at);
                let (pushes, pushed) = (slot.pushes, slot.pushed_before(at));
                if let Some(charged) = slot.charged {
                    let played = u32::from(up) + u32::from(down);
                    self.allowance.end(self.rendered, motor, (charged, played), (pushes, pushed));
                }
                self.travel[motor] -= slot.shift_undone(at).cast_signed();
                let begun = slot.begun(at);
                if begun && matches!(slot.kind, Kind::Play | Kind::Internal) {
                    let outstanding = slot.outstanding_at(at);
                    let left = [
                        (&mut self.outstanding, outstanding),
                        (&mut self.outstanding_pushes, (pushes - pushed).min(outstanding)),
                    ];
                    for (sums, pulses) in left {
                        sums[motor] = sums[motor].saturating_add(pulses);
                    }
                }
                if slot.kind == Kind::Play {
                    let bursts = u64::from(begun) + u64::from(begun && slot.stroke.down < at);
                    self.reporting.count().played += bursts;
                    self.reporting.count().dropped += 2 - bursts;
                    self.reporting.count().pulses += u64::from(up) + u64::from(down);
                    flushed += u16::from(!begun);
                }
            }
        }
        self.changes = Changes::none(self.rendered);
        self.marks.turn_off();
        self.drivers = Drivers::OFF;
        // A seek that was not finished leaves the position unknown.
        self.seeks = false;
        self.lines = Lines::OFF;
        self.off_until = self.rendered;
        self.state = State::Faulted;
        self.finish_cut(cause, false, flushed, self.outstanding_total(), at);
    }

    fn finish_cut(&mut self, cause: Cause, returns: bool, flushed: u16, outstanding: u32, at: Tick) {
        self.marks.keep_before(at);
        self.cause = cause;
        self.report_cut(cause, returns, flushed, outstanding, at);
    }

    pub(super) fn report_cut(
        &mut self,
        cause: Cause,
        returns: bool,
        flushed: u16,
        outstanding: u32,
        at: Tick,
    ) {
        self.reporting.report_cut(Cut { cause, at: at.wire(), returns, flushed, outstanding });
    }

    /// Books what was played before now, in order of time. What is not rendered was not played.
    pub(super) fn settle(&mut self) {
        let now = self.now.min(self.rendered);
        while let Some(mark) = self.marks.pass(now, self.rendered) {
            self.settle_strokes(mark);
            self.reporting.report(Report::Onset { tick: mark.wire(), counters: self.reporting.counters() });
        }
        self.settle_strokes(now);
        if self.state == State::Returning && self.pool.is_empty() {
            self.state = self.then;
            self.position_known |= core::mem::take(&mut self.seeks);
            self.reporting.send_status();
        }
    }

    fn settle_strokes(&mut self, now: Tick) {
        if now < self.next_end {
            return;
        }
        // A stroke that is still being rendered ends no sooner than the rendered end.
        let all = now >= self.rendered;
        self.next_end = if all { NEVER } else { self.rendered };
        for motor in 0..MOTORS {
            while all || !self.pool.is_rendering_head(motor) {
                let Some(slot) = self.pool.head(motor) else { break };
                let end = slot.stroke.end();
                if end > now {
                    self.next_end = self.next_end.min(end);
                    break;
                }
                if let Some(charged) = slot.charged {
                    let (played, pushes) = (slot.stroke.pulses(), slot.pushes);
                    self.allowance.end(self.rendered, motor, (charged, played), (pushes, pushes));
                }
                if slot.kind == Kind::Play {
                    let played = [slot.stroke.up_pulses, slot.stroke.down_pulses];
                    self.reporting.count().played += 2;
                    self.reporting.count().pulses += u64::from(played[0]) + u64::from(played[1]);
                    if !slot.cut {
                        let changed = played.iter().zip(slot.planned);
                        let changed = changed.filter(|&(&played, planned)| played != planned);
                        self.reporting.count().amended += changed.count() as u64;
                    }
                }
                self.pool.drop_head(motor);
            }
        }
    }
}
