//! Completes strokes: books those that were played, cuts those that run, or turns all lines off.
//!
//! Invariant: every slot leaves the pool here or is withdrawn, and is counted once: as played, dropped, refused or replaced.

use crate::array::MotorSet;
use crate::controller::player::changes::Changes;
use crate::controller::player::pool::Kind;
use crate::controller::player::{NEVER, Player, at_once};
use crate::controller::reporting::Reporting;
use crate::message::Report;
use crate::stroke::Lines;
use crate::tick::Tick;

/// What a stroke that was turned off leaves of its pin's way.
pub(in crate::controller) struct Left {
    /// Up pulses of a move that were not played.
    pub(in crate::controller) undone: u16,
    /// Outstanding return pulses.
    pub(in crate::controller) outstanding: u16,
    /// How many of those push against the lower stop.
    pub(in crate::controller) pushes: u16,
}

impl Player {
    /// Cuts running strokes at the rendered end, flushes the queue and plays the outstanding return pulses as soon as the
    /// drivers are ready and the limits on motors at once allow it. Tells `undo` the pulses of each motor's move that the cut takes
    /// back. Returns how many strokes were flushed, and how many return pulses are outstanding.
    pub(in crate::controller) fn cut(
        &mut self,
        reporting: &mut Reporting,
        mut undo: impl FnMut(usize, u16),
    ) -> (u16, u32) {
        let (at, ready) = (self.rendered, self.ready());
        let (mut flushed, mut outstanding, mut waiting) = (0, 0, MotorSet::EMPTY);
        for motor in 0..self.layout.loop_end() {
            let Some(slot) = self.pool.current_mut(motor) else { continue };
            undo(motor, slot.shift_undone(at));
            let begun = slot.begun(at);
            if begun {
                if at < slot.stroke.down {
                    waiting.insert(motor as u8);
                }
                outstanding += u32::from(slot.cut_at(at, ready));
            }
            let strokes = self.pool.flush(motor, begun);
            flushed += strokes;
            reporting.count().dropped += 2 * u64::from(strokes);
            self.change_by(motor, at);
        }
        let limits = self.limits();
        at_once::take_turns(&mut self.pool, &self.layout, limits, waiting, ready);
        self.next_end = self.next_end.min(at);
        self.marks.keep_before(at);
        (flushed, outstanding)
    }

    /// How many ticks after the rendered end the last return pulse is over, when nothing but returns is queued.
    pub(in crate::controller) fn return_ticks(&self) -> u32 {
        let ends = (0..self.layout.loop_end())
            .filter_map(|motor| self.pool.current(motor))
            .map(|slot| slot.stroke.end());
        ends.fold(self.rendered, Tick::max).since(self.rendered) as u32
    }

    /// Turns all lines off; nothing from `at` on was played. Tells `leave` what each stroke leaves. Returns how many strokes were
    /// flushed.
    pub(in crate::controller) fn turn_off(
        &mut self,
        at: Tick,
        reporting: &mut Reporting,
        mut leave: impl FnMut(usize, Left),
    ) -> u16 {
        self.settle_strokes(at, reporting);
        let mut flushed = 0;
        for motor in 0..self.layout.loop_end() {
            // Most slots are not rendered yet; they are flushed together.
            let strokes = self.pool.flush(motor, true);
            flushed += strokes;
            reporting.count().dropped += 2 * u64::from(strokes);
            while let Some(slot) = self.pool.pop(motor) {
                let [up, down] = slot.played_before(at);
                let (pushes, pushed) = (slot.pushes, slot.pushed_before(at));
                if let Some(charged) = slot.charged {
                    let played = u32::from(up) + u32::from(down);
                    self.allowance.end(self.rendered, motor, (charged, played), (pushes, pushed));
                }
                let begun = slot.begun(at);
                let returns = begun && matches!(slot.kind, Kind::Play | Kind::Internal);
                let outstanding = if returns { slot.outstanding_at(at) } else { 0 };
                let pushes = (pushes - pushed).min(outstanding);
                leave(motor, Left { undone: slot.shift_undone(at), outstanding, pushes });
                if slot.kind == Kind::Play {
                    let bursts = u64::from(begun) + u64::from(begun && slot.stroke.down < at);
                    let counters = reporting.count();
                    counters.played += bursts;
                    counters.dropped += 2 - bursts;
                    counters.pulses += u64::from(up) + u64::from(down);
                    flushed += u16::from(!begun);
                }
            }
        }
        self.changes = Changes::none(self.rendered);
        self.marks.turn_off();
        self.marks.keep_before(at);
        self.drivers.turn_off();
        self.lines = Lines::OFF;
        flushed
    }

    /// Books what was played before `now`, in order of time. What is not rendered was not played.
    pub(in crate::controller) fn settle(&mut self, now: Tick, reporting: &mut Reporting) {
        let now = now.min(self.rendered);
        while let Some(mark) = self.marks.pass(now, self.rendered) {
            self.settle_strokes(mark, reporting);
            reporting.report(Report::Onset { tick: mark.wire(), counters: reporting.counters() });
        }
        self.settle_strokes(now, reporting);
    }

    fn settle_strokes(&mut self, now: Tick, reporting: &mut Reporting) {
        if now < self.next_end {
            return;
        }
        // A stroke that is still being rendered ends no sooner than the rendered end.
        let all = now >= self.rendered;
        self.next_end = if all { NEVER } else { self.rendered };
        for motor in 0..self.layout.loop_end() {
            while all || !self.pool.is_rendering_head(motor) {
                let Some(slot) = self.pool.head(motor) else { break };
                let end = slot.stroke.end();
                if end > now {
                    self.next_end = self.next_end.min(end);
                    break;
                }
                self.complete(motor, reporting);
            }
        }
    }

    /// Books the oldest stroke of a motor as played. Not inlined: it is needed less often than [`Self::settle_strokes`].
    #[inline(never)]
    fn complete(&mut self, motor: usize, reporting: &mut Reporting) {
        let Some(slot) = self.pool.head(motor) else { return };
        if let Some(charged) = slot.charged {
            let (played, pushes) = (slot.stroke.pulses(), slot.pushes);
            self.allowance.end(self.rendered, motor, (charged, played), (pushes, pushes));
        }
        if slot.kind == Kind::Play {
            let played = [slot.stroke.up_pulses, slot.stroke.down_pulses];
            let counters = reporting.count();
            counters.played += 2;
            counters.pulses += u64::from(played[0]) + u64::from(played[1]);
            if !slot.cut {
                let changed = played.iter().zip(slot.planned);
                let changed = changed.filter(|&(&played, planned)| played != planned);
                counters.amended += changed.count() as u64;
            }
        }
        self.pool.drop_head(motor);
    }
}
