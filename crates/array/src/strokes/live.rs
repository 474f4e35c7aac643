//! The steps of a play whose motions change while it runs: one oscillator per motor, or a level that its pin goes to.
//!
//! [`LiveStrokes::replace`] gives a motor another motion from its next period on. The oscillator of a motor runs on when the amplitude
//! is 0, so that motors of one frequency stay in phase however often they fall silent. A pin glides to a level in even steps, and stays
//! there until its next motion; before it vibrates again, it comes down.
//!
//! Invariant: the steps of a motor do not overlap, and strokes are on the grid of its drive: `replace` begins at a stroke's own beginning.
//! Steps come in order of time, except that `replace` goes back to the new beginning, and `next_of` takes one ahead of the others.

use super::error::StrokesError;
use crate::motor::SquareWave;
use crate::per_motor::PerMotor;
use crate::spec::Array;
use crate::strokes::Step;
use firmware_protocol::array::MotorSet;
use firmware_protocol::moves::Move;
use firmware_protocol::tick::Tick;

/// The steps of a glide, ms: the motor averages over twice as long. Also the moves of one glide and the next are so far apart: however
/// often a level changes, the device takes the moves of all motors ([`Layout::max_dense`]).
///
/// [`Layout::max_dense`]: firmware_protocol::array::Layout::max_dense
const GLIDE_STEP_MS: u64 = 2;

/// What a motor of a live play does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LiveMotion {
    /// It vibrates.
    Wave(SquareWave),
    /// Its pin goes to a level and stays there.
    Level {
        /// The array that it is for.
        array: Array,
        /// Pulses above rest.
        pulses: u16,
        /// How long it takes to get there; 0: at full speed.
        glide_ticks: u32,
    },
}

impl From<SquareWave> for LiveMotion {
    fn from(wave: SquareWave) -> Self {
        Self::Wave(wave)
    }
}

impl LiveMotion {
    /// The array that it is for.
    pub const fn array(&self) -> Array {
        match self {
            Self::Wave(wave) => wave.array(),
            Self::Level { array, .. } => *array,
        }
    }
}

/// A way from one level to another.
#[derive(Clone, Copy, Debug)]
struct Glide {
    begin: Tick,
    from: u16,
    to: u16,
    /// Its moves, how far apart they begin, and the number of the next.
    moves: u64,
    apart: u64,
    next: u64,
    /// When the last move before it begins.
    before: Tick,
}

impl Glide {
    /// At rest.
    const REST: Self = Self { begin: Tick(0), from: 0, to: 0, moves: 0, apart: 1, next: 0, before: Tick(0) };

    fn new(array: Array, begin: Tick, from: u16, to: u16, glide_ticks: u32) -> Self {
        let step = array.rate().of_ms(GLIDE_STEP_MS);
        let way = u64::from(to.abs_diff(from));
        // No step is longer than its pulses take.
        let ticks = u64::from(glide_ticks).max(way);
        let moves = match glide_ticks {
            // A move to the present level helps if the one before it was lost.
            _ if way == 0 => 1,
            0 => 1,
            _ => ticks.div_ceil(step).min(way),
        };
        // Few pulses take as long in fewer steps.
        let apart = if moves > 1 { (ticks / moves).max(step) } else { step };
        Self { begin, from, to, moves, apart, next: 0, before: Tick(0) }
    }

    /// The level after so many of its moves.
    fn level(&self, moves: u64) -> u16 {
        let (from, to) = (i64::from(self.from), i64::from(self.to));
        let done = if self.moves == 0 { 0 } else { (to - from) * moves as i64 / self.moves as i64 };
        (from + done) as u16
    }

    /// The level that the moves before `tick` lead to, and when the last of them is over, if that is later than `tick`. It does not end
    /// before it begins.
    fn at(&self, tick: Tick) -> (u16, Tick) {
        let tick = tick.max(self.begin);
        let begun = (tick - self.begin).div_ceil(self.apart).min(self.moves);
        let level = self.level(begun);
        let Some(last) = begun.checked_sub(1) else { return (level, tick) };
        (level, tick.max(self.begin + (last * self.apart + u64::from(level.abs_diff(self.level(last))))))
    }

    /// When the last move before `tick` begins, its own or one before it.
    fn last_before(&self, tick: Tick) -> Tick {
        let begun = (tick.max(self.begin) - self.begin).div_ceil(self.apart).min(self.moves);
        begun.checked_sub(1).map_or(self.before, |last| self.begin + last * self.apart)
    }

    /// When its next move begins.
    fn next_begin(&self) -> Option<Tick> {
        (self.next < self.moves).then(|| self.begin + self.next * self.apart)
    }

    fn step(&self, motor: u8, number: u64) -> Step {
        let (from, level) = (self.level(number), self.level(number + 1));
        let tick = self.begin + number * self.apart;
        Step::Move { of: Move { motor, tick, level, surplus: 0 }, from }
    }
}

/// What one motor does: it glides first, then it vibrates or stays.
#[derive(Clone, Copy, Debug)]
struct LiveMotor {
    motion: LiveMotion,
    glide: Glide,
    oscillator: Oscillator,
}

/// The drive of one motor from a tick on.
#[derive(Clone, Copy, Debug)]
struct Oscillator {
    wave: SquareWave,
    /// Time 0 of the wave.
    zero: Tick,
    /// The drive's start: until then the motor has the drive before this one.
    begin: Tick,
    /// Number of the next excursion.
    next: u64,
}

impl Oscillator {
    /// When excursion `number` goes up.
    fn up(&self, number: u64) -> Tick {
        self.zero + self.wave.edge(2 * number)
    }

    /// The first excursion that goes up at `tick` or later.
    fn first_from(&self, tick: Tick) -> u64 {
        let tick = tick.max(self.begin);
        let periods = self.wave.array().rate().ticks_to_seconds(tick - self.zero) * self.wave.frequency_hz()
            - self.wave.phase();
        // Rounding shifts edges by less than a period.
        let mut number = (periods.max(1.0) - 1.0) as u64;
        while self.up(number) < tick {
            number += 1;
        }
        number
    }

    /// The same oscillator with another drive, from the beginning of its first period at `from` or later. A new phase shifts it
    /// forwards by the difference.
    fn changed(&self, wave: SquareWave, from: Tick) -> Self {
        let begin = self.up(self.first_from(from));
        if wave.frequency_hz() == self.wave.frequency_hz() {
            let same = Self { wave, begin, ..*self };
            return Self { next: same.first_from(begin), ..same };
        }
        let shift = (wave.phase() - self.wave.phase()).rem_euclid(1.0);
        let shift = wave.array().rate().seconds_to_ticks(shift / wave.frequency_hz());
        // A device's clock starts hours after 0, so the subtraction does not saturate.
        Self { wave, zero: Tick((begin + shift) - Tick(wave.edge(0))), begin, next: 0 }
    }

    /// When the next stroke goes up; `None` if the drive moves nothing.
    fn next_up(&self) -> Option<Tick> {
        self.wave.moves().then(|| self.up(self.next))
    }
}

impl LiveMotor {
    fn new(wave: SquareWave, onset: Tick) -> Self {
        let oscillator = Oscillator { wave, zero: onset, begin: onset, next: 0 };
        Self { motion: wave.into(), glide: Glide::REST, oscillator }
    }

    fn next_begin(&self) -> Option<Tick> {
        let up = || matches!(self.motion, LiveMotion::Wave(_)).then(|| self.oscillator.next_up()).flatten();
        self.glide.next_begin().or_else(up)
    }

    /// The same motor with another motion, from `from` or the beginning of its first period after that on; and that tick.
    fn changed(&self, motion: LiveMotion, from: Tick) -> (Self, Tick) {
        let array = motion.array();
        let vibrates = matches!(self.motion, LiveMotion::Wave(_));
        let last = self.glide.last_before(from);
        let (level, from) = self.glide.at(from.max(last + array.rate().of_ms(GLIDE_STEP_MS)));
        match motion {
            LiveMotion::Wave(wave) if level > 0 => {
                let glide = Glide { before: last, ..Glide::new(array, from, level, 0, 0) };
                // The third of three moves begins a millisecond after the first.
                let down = from + u64::from(level).max(array.rate().of_ms(1));
                (Self { motion, glide, oscillator: self.oscillator.changed(wave, down) }, from)
            }
            LiveMotion::Wave(wave) => {
                let oscillator = self.oscillator.changed(wave, from);
                let begin = oscillator.up(oscillator.next);
                (Self { motion, glide: Glide { before: last, ..Glide::REST }, oscillator }, begin)
            }
            LiveMotion::Level { pulses, glide_ticks, .. } => {
                // What goes up before that comes down again by itself.
                let begin = match vibrates {
                    true if self.oscillator.wave.moves() => {
                        self.oscillator.up(self.oscillator.first_from(from))
                    }
                    // The drive before this one, which moves nothing.
                    true => from.max(self.oscillator.begin),
                    false => from,
                };
                let glide = Glide { before: last, ..Glide::new(array, begin, level, pulses, glide_ticks) };
                (Self { motion, glide, oscillator: self.oscillator }, begin)
            }
        }
    }
}

/// The steps of a live play, in order of time, without end.
#[derive(Clone, Debug)]
pub struct LiveStrokes {
    onset: Tick,
    initial: PerMotor<SquareWave>,
    motors: PerMotor<LiveMotor>,
    /// The motors before the last change, until it is confirmed.
    before: PerMotor<LiveMotor>,
    /// Motors that pause.
    paused: MotorSet,
}

impl LiveStrokes {
    /// The strokes of these drives.
    pub fn new(waves: PerMotor<SquareWave>) -> Self {
        let motors = waves.map(|wave| LiveMotor::new(wave, Tick(0)));
        Self { onset: Tick(0), initial: waves, motors, before: motors, paused: MotorSet::EMPTY }
    }

    /// Begins at `onset` with the first drives.
    pub fn begin(&mut self, onset: Tick) {
        self.onset = onset;
        self.motors = self.initial.map(|wave| LiveMotor::new(wave, onset));
        (self.before, self.paused) = (self.motors, MotorSet::EMPTY);
    }

    /// The array that they are for.
    pub fn array(&self) -> Array {
        self.motors[0].motion.array()
    }

    /// The onset.
    pub const fn onset(&self) -> Tick {
        self.onset
    }

    /// The motion of a motor.
    ///
    /// # Panics
    /// If there is no such motor.
    pub fn motion(&self, motor: u8) -> LiveMotion {
        self.motors[usize::from(motor)].motion
    }

    /// Gives a motor another motion, from `from` on, or from the beginning of its first period after that if it vibrates; returns that
    /// tick. Its next step is then the first of the new motion.
    ///
    /// # Panics
    /// If there is no such motor.
    pub fn replace(&mut self, motor: u8, motion: LiveMotion, from: Tick) -> Tick {
        self.paused.remove(motor);
        let motor = usize::from(motor);
        self.before[motor] = self.motors[motor];
        let (changed, begin) = self.before[motor].changed(motion, from);
        self.motors[motor] = changed;
        begin
    }

    /// The device has brought this motor's pin down at `tick`, because it was held for too long: the motor's motion is to be at rest now, unless it has
    /// changed meanwhile.
    pub fn hold_ended(&mut self, motor: u8, tick: Tick) {
        let Some(own) = self.motors.get_mut(usize::from(motor)) else { return };
        if let LiveMotion::Level { array, .. } = own.motion
            && own.glide.next_begin().is_none()
            && tick >= own.glide.at(own.glide.begin + own.glide.moves * own.glide.apart).1
        {
            own.motion = LiveMotion::Level { array, pulses: 0, glide_ticks: 0 };
            own.glide = Glide { begin: tick, ..Glide::REST };
        }
    }

    /// Undoes the last [`Self::replace`] of this motor, because the device has kept the earlier steps: the motor has its earlier
    /// motion and next step again. It pauses until its next `replace`: only [`Self::next_of`] returns its steps.
    ///
    /// # Panics
    /// If there is no such motor.
    pub fn revert(&mut self, motor: u8) {
        self.motors[usize::from(motor)] = self.before[usize::from(motor)];
        self.paused.insert(motor);
    }

    /// Puts back the last returned step, which was not sent: it is the next one again.
    pub fn put_back(&mut self, step: &Step) {
        if let Some(motor) = self.motors.get_mut(usize::from(step.motor())) {
            match step {
                Step::Stroke(_) => motor.oscillator.next = motor.oscillator.next.saturating_sub(1),
                Step::Move { .. } => motor.glide.next = motor.glide.next.saturating_sub(1),
            }
        }
    }

    /// The next step of this motor, ahead of those of the others.
    pub fn next_of(&mut self, motor: u8) -> Option<Result<Step, StrokesError>> {
        let own = self.motors.get_mut(usize::from(motor))?;
        own.next_begin()?;
        let step = if own.glide.next < own.glide.moves {
            own.glide.next += 1;
            own.glide.step(motor, own.glide.next - 1)
        } else {
            let oscillator = &mut own.oscillator;
            oscillator.next += 1;
            let number = oscillator.next - 1;
            oscillator.wave.excursion(number).stroke(motor, oscillator.zero).into()
        };
        Some(match step.check(own.motion.array().layout()) {
            Ok(()) => Ok(step),
            Err(refusal) => Err(StrokesError::Limit { step, refusal }),
        })
    }

    /// When the next step of a motor begins; `None` if its motion moves nothing for now.
    pub fn next_up(&self, motor: u8) -> Option<Tick> {
        self.motors.get(usize::from(motor)).and_then(LiveMotor::next_begin)
    }
}

impl Iterator for LiveStrokes {
    type Item = Result<Step, StrokesError>;

    fn next(&mut self) -> Option<Self::Item> {
        let plays = |motor: &u8| !self.paused.contains(*motor);
        let ups = (0..)
            .take(self.motors.len())
            .filter(plays)
            .filter_map(|motor| Some((self.next_up(motor)?, motor)));
        let (_, motor) = ups.min()?;
        self.next_of(motor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::Array;
    use proptest::prelude::*;

    const ONSET: Tick = Tick::BOOT;

    fn wave(frequency_hz: f64, amplitude_um: f64, phase: f64) -> SquareWave {
        SquareWave::new(Array::paper(), frequency_hz, amplitude_um, phase).unwrap()
    }

    fn live(wave: SquareWave) -> LiveStrokes {
        let mut strokes = LiveStrokes::new(PerMotor::all(Array::paper(), wave));
        strokes.begin(ONSET);
        strokes
    }

    fn ups(strokes: &mut LiveStrokes, motor: u8, count: usize) -> Vec<u64> {
        let own = strokes.map(Result::unwrap).filter(|step| step.motor() == motor);
        own.take(count).map(|step| step.begin() - ONSET).collect()
    }

    #[test]
    fn another_amplitude_keeps_the_grid_also_after_silence() {
        let mut plain = live(wave(60.0, 80.0, 0.25));
        let grid = ups(&mut plain, 3, 40);
        let mut strokes = live(wave(60.0, 80.0, 0.25));
        assert_eq!(strokes.replace(3, wave(60.0, 0.0, 0.25).into(), ONSET + grid[2]), ONSET + grid[2]);
        assert_eq!(strokes.next_up(3), None);
        let from = ONSET + (grid[7] + 1);
        assert_eq!(strokes.replace(3, wave(60.0, 20.0, 0.25).into(), from), ONSET + grid[8]);
        assert_eq!(ups(&mut strokes, 3, 30), grid[8..38]);
    }

    #[test]
    fn another_frequency_begins_where_the_next_period_would_have_begun() {
        let mut strokes = live(wave(60.0, 80.0, 0.25));
        let grid = ups(&mut live(wave(60.0, 80.0, 0.25)), 3, 5);
        strokes.replace(3, wave(100.0, 80.0, 0.25).into(), ONSET + (grid[3] - 700));
        let changed = ups(&mut strokes, 3, 4);
        assert_eq!(changed, [0, 850, 1_700, 2_550].map(|ticks| grid[3] + ticks));
        // A phase of half a cycle more shifts the stroke by half a period.
        strokes.replace(3, wave(100.0, 80.0, 0.75).into(), ONSET + changed[2]);
        assert_eq!(ups(&mut strokes, 3, 2), [2_125, 2_975].map(|ticks| grid[3] + ticks));
        strokes.replace(3, wave(50.0, 80.0, 0.0).into(), ONSET + (grid[3] + 3_000));
        assert_eq!(ups(&mut strokes, 3, 1), [grid[3] + 3_825 + 425]);
    }

    #[test]
    fn a_reverted_motor_is_on_its_old_grid() {
        let mut strokes = live(wave(60.0, 80.0, 0.0));
        strokes.replace(3, wave(90.0, 10.0, 0.0).into(), ONSET + 5_000);
        strokes.revert(3);
        assert_eq!(strokes.motion(3), wave(60.0, 80.0, 0.0).into());
        assert_eq!(strokes.replace(3, wave(60.0, 70.0, 0.0).into(), ONSET + 9_000), ONSET + 9_917);
    }

    #[test]
    fn a_pin_glides_to_its_level_stays_and_comes_down_before_it_vibrates() {
        let array = Array::paper();
        let level = |pulses, glide_ticks| LiveMotion::Level { array, pulses, glide_ticks };
        let mut strokes = live(wave(60.0, 0.0, 0.0));
        assert_eq!(strokes.replace(3, level(1_000, 1_700), ONSET + 100), ONSET + 100);
        let moves: Vec<_> = std::iter::from_fn(|| strokes.next_of(3)).map(Result::unwrap).collect();
        assert_eq!((moves.len(), moves[0].begin(), moves[0].level()), (10, ONSET + 100, 100));
        assert_eq!((moves[9].begin(), moves[9].level()), (ONSET + (100 + 9 * 170), 1_000));
        // A short way takes as long.
        let mut short = live(wave(60.0, 0.0, 0.0));
        short.replace(3, level(100, 85_000), ONSET);
        let moves: Vec<_> = std::iter::from_fn(|| short.next_of(3)).map(Result::unwrap).collect();
        assert!(moves.len() == 100 && (83_000..85_000).contains(&(moves[99].begin() - ONSET)), "{moves:?}");
        // The same level again is a move, in case the last one was lost.
        short.replace(3, level(100, 0), ONSET + 100_000);
        assert_eq!(short.next_of(3).unwrap().unwrap().level(), 100);
        // In the middle of a glide it goes on from where it is then.
        strokes.replace(3, level(0, 1_700), ONSET + 5_000);
        strokes.replace(3, level(500, 0), ONSET + (5_000 + 3 * 170));
        let back = strokes.next_of(3).unwrap().unwrap();
        assert!(matches!(back, Step::Move { from: 700, of } if of.level == 500), "{back:?}");
        assert_eq!(strokes.next_up(3), None);
        strokes.replace(3, wave(60.0, 80.0, 0.0).into(), ONSET + 9_000);
        let [down, up] = [(); 2].map(|()| strokes.next_of(3).unwrap().unwrap());
        assert_eq!((down.begin(), down.level(), up.moves()), (ONSET + 9_000, 0, 2));
        assert!(up.begin() >= ONSET + 9_500);
    }

    proptest! {
        /// Changes at random times: the steps sent before a change and those after it do not overlap, and each begins at the level at which
        /// the one before it ended.
        #[test]
        fn steps_never_overlap_and_levels_follow(changes in prop::collection::vec((1u64..20_000, 0.2..300.0, 0.0..400.0, 0.0..1.0, 0u8..4), 1..30)) {
            let mut strokes = live(wave(60.0, 80.0, 0.0));
            let (mut now, mut busy, mut level) = (ONSET, ONSET, 0);
            for (wait, hz, um, phase, kind) in changes {
                let until = now + wait;
                while let Some(next) = strokes.next_up(3).filter(|next| *next < until) {
                    prop_assert!(next >= busy);
                    let own = strokes.find_map(|step| step.ok().filter(|step| step.motor() == 3)).unwrap();
                    match own {
                        Step::Move { from, .. } => prop_assert_eq!(from, level),
                        Step::Stroke(_) => prop_assert_eq!(level, 0),
                    }
                    level = own.level();
                    // A move may be cut short by the next one.
                    busy = if own.moves() == 2 { own.end() } else { own.begin() };
                }
                now = until;
                let array = Array::paper();
                let motion = match (kind, strokes.motion(3)) {
                    (0, _) => LiveMotion::Level { array, pulses: um as u16 * 7, glide_ticks: (phase * 5_000.0) as u32 },
                    (1, _) => LiveMotion::Level { array, pulses: um as u16 * 7, glide_ticks: 0 },
                    // Every second change keeps the frequency.
                    (2, LiveMotion::Wave(before)) => wave(before.frequency_hz(), um, phase).into(),
                    _ => wave(hz, um, phase).into(),
                };
                let from = strokes.replace(3, motion, now);
                prop_assert!(from >= now && from >= busy);
            }
        }
    }

    proptest! {
        /// The device takes them then: each begins a millisecond after the last but one before it, and at most eight in 10 ms.
        #[test]
        fn moves_are_no_denser_than_the_device_takes_them_however_often_the_motion_changes(
            changes in prop::collection::vec((1_u64..400, 0_u8..6, 0_u16..700), 1..120),
        ) {
            let array = Array::paper();
            let mut strokes = live(wave(60.0, 0.0, 0.0));
            let (mut from, mut begun) = (ONSET, Vec::new());
            for (after, kind, pulses) in changes {
                let next = from + after;
                while let Some(begin) = strokes.next_up(3).filter(|begin| *begin < next) {
                    let step = strokes.next_of(3).unwrap().unwrap();
                    begun.push(begin.0);
                    if let Step::Stroke(stroke) = step {
                        begun.push(stroke.down.0);
                    }
                }
                from = next;
                let motion = match kind {
                    0 => wave(300.0, 20.0, 0.0).into(),
                    1 => wave(60.0, 0.0, 0.0).into(),
                    _ => LiveMotion::Level { array, pulses, glide_ticks: [0, 85, 425, 1_700][usize::from(kind) - 2] },
                };
                strokes.replace(3, motion, from);
            }
            let least = u64::from(array.layout().least_apart());
            prop_assert!(begun.windows(3).all(|three| three[2] >= three[0] + least), "{begun:?}");
            let most = u64::from(array.layout().dense_ticks());
            prop_assert!(begun.windows(9).all(|nine| nine[8] > nine[0] + most), "{begun:?}");
        }
    }
}
