//! Brings all pins down, or turns all lines off.
//!
//! Invariant: what a cut flushes counts as dropped. After an e-stop each motor's height is that of the last tick that was played.

use crate::array::{CAPACITY, MotorSet, Ring};
use crate::controller::player::recent::{Begun, Rendered};
use crate::controller::player::{Lowered, Player, Shifting};
use crate::controller::reporting::Reporting;
use crate::limits::Refusal;
use crate::message::Counters;
use crate::stroke::{Direction, Lines};
use crate::tick::Tick;

/// How many motors of each rail, or of each chip, have pulses, and how many may.
struct Group {
    /// For each motor the first one of its rail or chip, whose place has the count.
    first: [u8; CAPACITY],
    busy: [u8; CAPACITY],
    most: u8,
}

impl Group {
    fn new(ring: &Ring, motors: usize, most: u8) -> Self {
        let mut first = [u8::MAX; CAPACITY];
        for motor in 0..motors {
            let mut other = motor;
            while first[other] == u8::MAX {
                first[other] = motor as u8;
                other = ring[other].into();
            }
        }
        Self { first, busy: [0; CAPACITY], most }
    }

    fn busy(&mut self, motor: u8) -> &mut u8 {
        &mut self.busy[usize::from(self.first[usize::from(motor)])]
    }
}

impl Player {
    /// Flushes all queues, and gives every pin the goal 0. Returns how many moves were flushed, and the sum of the heights.
    pub(in crate::controller) fn cut(&mut self, reporting: &mut Reporting) -> (u16, u32) {
        let flushed = self.flush(reporting);
        let now = self.rendered;
        self.lowered = Lowered::NOTHING;
        // The play is over, and so is what its mark says.
        self.set_hold(0);
        if self.shift_at(now).is_some() {
            self.shifting = None;
        }
        for motor in 0..self.layout.loop_end() {
            if self.motors[motor].running.is_some_and(|running| running.direction == Direction::Up)
                || self.motors[motor].goal() > 0
            {
                self.end(motor);
                self.motors[motor].set_goal(0);
            }
            self.change_by(motor, now);
        }
        self.marks.keep_before(now);
        (flushed, self.heights_total())
    }

    fn flush(&mut self, reporting: &mut Reporting) -> u16 {
        let flushed = (0..self.layout.loop_end()).map(|motor| self.queues.flush(motor)).sum();
        reporting.count().dropped += u64::from(flushed);
        flushed
    }

    /// Whether no move waits, no burst runs, and every pin is where it should be, in all ticks before `now`.
    pub(in crate::controller) fn is_still(&self, now: Tick) -> bool {
        self.queues.is_empty()
            && self.still_from <= now
            && self.shift_at(now).is_none()
            && self.motors[..self.layout.loop_end()].iter().all(super::motor::Motor::is_still)
    }

    /// Whether the burst that shifts where the motor's pin rests is yet to begin.
    pub(super) fn is_to_shift(&self, motor: usize) -> bool {
        self.shifting.is_some_and(|of| of.end.is_none() && usize::from(of.motor) == motor)
    }

    /// Whether no motor has been forgotten: one that should do something does it, or rendering looks at it again.
    pub(in crate::controller) fn is_consistent(&self) -> bool {
        (0..self.layout.loop_end()).all(|motor| {
            let of = &self.motors[motor];
            let waits = of.is_to_descend()
                || self.is_to_shift(motor)
                || of.running.is_some()
                || self.queues.first(motor).is_some()
                || self.lines.pulsing().contains(motor as u8);
            let may_be_below = of.running.is_some_and(|running| running.direction == Direction::Up);
            (!waits || self.changes.is_waiting(motor)) && (of.height >= of.goal() || may_be_below)
        })
    }

    /// Pulses above rest of all pins together, at the rendered end.
    pub(in crate::controller) fn heights_total(&self) -> u32 {
        let low = self.rendered.0 as u32;
        self.motors.iter().map(|motor| u32::from(motor.height(low))).sum()
    }

    /// How many pulses a motor's pin is above rest.
    pub(in crate::controller) fn height(&self, motor: usize) -> u16 {
        self.motors.get(motor).map_or(0, |motor| motor.height(self.rendered.0 as u32))
    }

    /// All pins are at rest.
    pub(in crate::controller) fn assume_rest(&mut self) {
        self.motors.iter_mut().for_each(|motor| motor.place(0, 0));
    }

    /// All pins come down to rest, in turns.
    pub(in crate::controller) fn bring_down(&mut self) {
        let now = self.rendered;
        for motor in 0..self.layout.loop_end() {
            self.motors[motor].set_goal(0);
            self.change_by(motor, now);
        }
    }

    /// Whether no move waits, and every pin is still at rest, up to the rendered end.
    pub(in crate::controller) fn is_at_rest(&self) -> bool {
        self.is_still(self.rendered) && self.shifting.is_none() && self.heights_total() == 0
    }

    /// Every pin counts as `pulses` above rest, and comes down against the lower stop.
    pub(in crate::controller) fn seek(&mut self, pulses: u16) -> Result<(), Refusal> {
        if !self.pushing.allows_all(pulses.into()) {
            return Err(Refusal::Pushing);
        }
        for motor in 0..self.layout.motors() {
            self.pushing.pulses.end(motor, 0, pulses.into());
            self.motors[motor].place(pulses, pulses);
        }
        self.bring_down();
        Ok(())
    }

    /// Drives one pin by a burst after which it is at rest again, unless a limit refuses it; `pushes` of its pulses are against the lower
    /// stop. All pins are at rest.
    pub(in crate::controller) fn shift(
        &mut self,
        motor: u8,
        direction: Direction,
        pulses: u16,
        pushes: u16,
    ) -> Result<(), Refusal> {
        let (now, index) = (self.rendered, usize::from(motor));
        self.on_time.begin(index, pulses.into(), [0; 2], &self.layout)?;
        // It counts when it begins.
        self.on_time.pulses.end(index, pulses.into(), 0);
        if u32::from(pushes) > self.pushing.room(index) {
            return Err(Refusal::Pushing);
        }
        match direction {
            Direction::Up => self.shifting = Some(Shifting { motor, pulses, end: None }),
            Direction::Down => {
                self.motors[index].place(pulses - pushes, 0);
                self.motors[index].surplus = pushes;
            }
        }
        self.change_by(index, now);
        Ok(())
    }

    /// How many ticks after the rendered end all pins are down, if nothing but their way down is to be played: pins wait for the drivers, and
    /// in order of motor for each other where the limits on motors at once say so.
    #[inline(never)]
    pub(in crate::controller) fn return_ticks(&self) -> u32 {
        let (low, layout, limits) = (self.rendered.0 as u32, &self.layout, self.limits());
        let (mut ends, mut running, mut waiting) = ([0; CAPACITY], MotorSet::EMPTY, MotorSet::EMPTY);
        for (motor, of) in self.motors[..layout.motors()].iter().enumerate() {
            // A burst may have more pulses than the pin is high: a correction, or a surplus.
            ends[motor] = of.left(low);
            if ends[motor] > 0 {
                (if of.running.is_some() { &mut running } else { &mut waiting }).insert(motor as u8);
            }
        }
        let mut now = if waiting.is_empty() { 0 } else { (self.ready() - self.rendered) as u32 };
        let unless = |limit: u8, size: u8| if limit < size { limit } else { u8::MAX };
        let on_rail = unless(limits.rail_at_once, layout.motors_per_rail());
        let on_chip = unless(limits.chip_at_once, layout.motors_per_chip());
        let mut groups = [
            Group::new(layout.next_on_rail(), layout.motors(), on_rail),
            Group::new(layout.next_on_chip(), layout.motors(), on_chip),
        ];
        running.iter().for_each(|motor| groups.iter_mut().for_each(|group| *group.busy(motor) += 1));
        loop {
            for motor in running.iter().filter(|&motor| ends[usize::from(motor)] <= now) {
                running.remove(motor);
                groups.iter_mut().for_each(|group| *group.busy(motor) -= 1);
            }
            for motor in waiting.iter() {
                if groups.iter_mut().all(|group| *group.busy(motor) < group.most) {
                    waiting.remove(motor);
                    running.insert(motor);
                    ends[usize::from(motor)] += now;
                    groups.iter_mut().for_each(|group| *group.busy(motor) += 1);
                }
            }
            let next = running.iter().map(|motor| ends[usize::from(motor)]);
            match if waiting.is_empty() { None } else { next.min() } {
                Some(next) => now = next,
                None => return ends.into_iter().max().unwrap_or(0),
            }
        }
    }

    /// Turns all lines off; nothing from `at` on was played. Pins stay where they are. Returns how many moves were flushed.
    pub(in crate::controller) fn turn_off(&mut self, at: Tick, reporting: &mut Reporting) -> u16 {
        let flushed = self.flush(reporting);
        let now = self.rendered;
        (self.shifting, self.lowered, self.hold) = (None, Lowered::NOTHING, None);
        for motor in 0..self.layout.loop_end() {
            self.end(motor);
        }
        let (mut left, mut undone) = ((now - at) as u32, 0);
        while left > 0 {
            let Some(run) = self.recent.take_back(left) else { break };
            left -= run.ticks;
            let (ticks, begin) = (run.ticks as u16, (at.0 as u32).wrapping_add(left));
            for (direction, lines) in [(Direction::Up, run.lines.up), (Direction::Down, run.lines.down)] {
                for motor in lines.iter().map(usize::from) {
                    let pushes = self.motors[motor].undo(direction, ticks, begin);
                    self.on_time.pulses.take_back(motor, ticks);
                    if pushes > 0 {
                        self.pushing.pulses.take_back(motor, pushes);
                    }
                }
            }
            let counters = reporting.count();
            counters.pulses -= u64::from(run.lines.pulsing().len()) * u64::from(run.ticks);
            let begun = run.begun.take_back(counters);
            counters.dropped += u64::from(begun);
            undone += begun;
        }
        // These ticks are not taken back again.
        if at < now {
            self.recent.push(Rendered {
                lines: Lines::OFF,
                ticks: (now - at) as u32,
                begun: Begun::default(),
            });
        }
        for motor in &mut self.motors {
            let height = motor.height(now.0 as u32);
            motor.place(height, height);
            motor.forget_bursts();
        }
        self.changes = super::Changes::none(now);
        self.marks.turn_off();
        let _ = self.marks.take_hold();
        self.marks.keep_before(at);
        self.drivers.turn_off();
        (self.lines, self.still_from) = (Lines::OFF, now);
        flushed + undone
    }

    /// Of these counts, those of the ticks before `now`: an e-stop takes back what is rendered and not played.
    pub(in crate::controller) fn played(&self, counters: Counters, now: Tick) -> Counters {
        self.recent.without_last((self.rendered - now) as u32, counters)
    }

    /// The shift of rest upwards that is not over in the ticks before `now`.
    pub(in crate::controller) fn shift_at(&self, now: Tick) -> Option<Shifting> {
        self.shifting.filter(|of| of.end.is_none_or(|end| end > now))
    }

    /// Reports the marks that lie before `now`, and forgets a shift of rest that is over.
    pub(in crate::controller) fn settle(&mut self, now: Tick, reporting: &mut Reporting) {
        self.shifting = self.shift_at(now.min(self.rendered));
        while let Some((tick, counters)) = self.marks.pass(now.min(self.rendered)) {
            reporting.report(crate::message::Report::Onset { tick: tick.wire(), counters });
        }
    }
}
