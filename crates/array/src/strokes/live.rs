//! The strokes of a play whose drives change while it runs: one oscillator per motor.
//!
//! [`LiveStrokes::replace`] gives a motor another drive from its next period on. The oscillator of a motor runs on when the amplitude
//! is 0, so that motors of one frequency stay in phase however often they fall silent.
//!
//! Invariant: the strokes of a motor do not overlap, and are on the grid of its drive: `replace` begins at a stroke's own beginning.
//! Strokes come in order of time, except that `replace` goes back to the new beginning, and `next_of` takes one ahead of the others.

use super::error::StrokesError;
use crate::motor::SquareWave;
use crate::per_motor::PerMotor;
use crate::strokes::Stroke;
use firmware_protocol::array::MotorSet;
use firmware_protocol::tick::Tick;

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

/// The strokes of a live play, in order of time, without end.
#[derive(Clone, Debug)]
pub struct LiveStrokes {
    onset: Tick,
    initial: PerMotor<SquareWave>,
    motors: PerMotor<Oscillator>,
    /// The motors' drives before the last change, until it is confirmed.
    before: PerMotor<Oscillator>,
    /// Motors that pause.
    paused: MotorSet,
}

impl LiveStrokes {
    /// The strokes of these drives.
    #[must_use]
    pub fn new(waves: PerMotor<SquareWave>) -> Self {
        let motors = waves.map(|wave| Oscillator { wave, zero: Tick(0), begin: Tick(0), next: 0 });
        Self { onset: Tick(0), initial: waves, motors, before: motors, paused: MotorSet::EMPTY }
    }

    /// Begins at `onset` with the first drives.
    pub fn begin(&mut self, onset: Tick) {
        self.onset = onset;
        self.motors = self.initial.map(|wave| Oscillator { wave, zero: onset, begin: onset, next: 0 });
        (self.before, self.paused) = (self.motors, MotorSet::EMPTY);
    }

    /// The onset.
    #[must_use]
    pub const fn onset(&self) -> Tick {
        self.onset
    }

    /// The drive of a motor.
    ///
    /// # Panics
    /// If there is no such motor.
    #[must_use]
    pub fn wave(&self, motor: u8) -> SquareWave {
        self.motors[usize::from(motor)].wave
    }

    /// Gives a motor another drive, from the beginning of its first period at `from` or later; returns that tick. Its next stroke is
    /// then the first of the new drive.
    ///
    /// # Panics
    /// If there is no such motor.
    pub fn replace(&mut self, motor: u8, wave: SquareWave, from: Tick) -> Tick {
        self.paused.remove(motor);
        let motor = usize::from(motor);
        self.before[motor] = self.motors[motor];
        self.motors[motor] = self.before[motor].changed(wave, from);
        let changed = &self.motors[motor];
        changed.up(changed.next)
    }

    /// Undoes the last [`Self::replace`] of this motor, because the device has kept the earlier strokes: the motor has its earlier
    /// drive and next stroke again. It pauses until its next `replace`: only [`Self::next_of`] returns its strokes.
    ///
    /// # Panics
    /// If there is no such motor.
    pub fn revert(&mut self, motor: u8) {
        self.motors[usize::from(motor)] = self.before[usize::from(motor)];
        self.paused.insert(motor);
    }

    /// Puts back the last returned stroke, which was not sent: it is the next one again.
    pub fn put_back(&mut self, stroke: &Stroke) {
        if let Some(motor) = self.motors.get_mut(usize::from(stroke.motor)) {
            motor.next = motor.next.saturating_sub(1);
        }
    }

    /// The next stroke of this motor, ahead of those of the others.
    pub fn next_of(&mut self, motor: u8) -> Option<Result<Stroke, StrokesError>> {
        let oscillator = self.motors.get_mut(usize::from(motor)).filter(|own| own.wave.moves())?;
        let stroke = oscillator.wave.excursions().number(oscillator.next).stroke(motor, oscillator.zero);
        oscillator.next += 1;
        Some(match stroke.check(oscillator.wave.array().layout()) {
            Ok(()) => Ok(stroke),
            Err(refusal) => Err(StrokesError::Limit { step: stroke.into(), refusal }),
        })
    }

    /// When the next stroke of a motor goes up; `None` if its drive moves nothing.
    #[must_use]
    pub fn next_up(&self, motor: u8) -> Option<Tick> {
        self.motors.get(usize::from(motor)).and_then(Oscillator::next_up)
    }
}

impl Iterator for LiveStrokes {
    type Item = Result<Stroke, StrokesError>;

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
        let own = strokes.map(Result::unwrap).filter(|stroke| stroke.motor == motor);
        own.take(count).map(|stroke| stroke.up - ONSET).collect()
    }

    #[test]
    fn another_amplitude_keeps_the_grid_also_after_silence() {
        let mut plain = live(wave(60.0, 80.0, 0.25));
        let grid = ups(&mut plain, 3, 40);
        let mut strokes = live(wave(60.0, 80.0, 0.25));
        assert_eq!(strokes.replace(3, wave(60.0, 0.0, 0.25), ONSET + grid[2]), ONSET + grid[2]);
        assert_eq!(strokes.next_up(3), None);
        let from = ONSET + (grid[7] + 1);
        assert_eq!(strokes.replace(3, wave(60.0, 20.0, 0.25), from), ONSET + grid[8]);
        assert_eq!(ups(&mut strokes, 3, 30), grid[8..38]);
    }

    #[test]
    fn another_frequency_begins_where_the_next_period_would_have_begun() {
        let mut strokes = live(wave(60.0, 80.0, 0.25));
        let grid = ups(&mut live(wave(60.0, 80.0, 0.25)), 3, 5);
        strokes.replace(3, wave(100.0, 80.0, 0.25), ONSET + (grid[3] - 700));
        let changed = ups(&mut strokes, 3, 4);
        assert_eq!(changed, [0, 850, 1_700, 2_550].map(|ticks| grid[3] + ticks));
        // A phase of half a cycle more shifts the stroke by half a period.
        strokes.replace(3, wave(100.0, 80.0, 0.75), ONSET + changed[2]);
        assert_eq!(ups(&mut strokes, 3, 2), [2_125, 2_975].map(|ticks| grid[3] + ticks));
        strokes.replace(3, wave(50.0, 80.0, 0.0), ONSET + (grid[3] + 3_000));
        assert_eq!(ups(&mut strokes, 3, 1), [grid[3] + 3_825 + 425]);
    }

    #[test]
    fn a_reverted_motor_is_on_its_old_grid() {
        let mut strokes = live(wave(60.0, 80.0, 0.0));
        strokes.replace(3, wave(90.0, 10.0, 0.0), ONSET + 5_000);
        strokes.revert(3);
        assert_eq!(strokes.wave(3), wave(60.0, 80.0, 0.0));
        assert_eq!(strokes.replace(3, wave(60.0, 70.0, 0.0), ONSET + 9_000), ONSET + 9_917);
    }

    proptest! {
        /// Changes at random times: the strokes sent before a change and those after it do not overlap.
        #[test]
        fn strokes_never_overlap(changes in prop::collection::vec((1u64..20_000, 0.2..300.0, 0.0..400.0, 0.0..1.0), 1..30)) {
            let mut strokes = live(wave(60.0, 80.0, 0.0));
            let (mut now, mut busy) = (ONSET, ONSET);
            for (wait, hz, um, phase) in changes {
                // Every second change keeps the frequency.
                let hz = if wait % 2 == 0 { strokes.wave(3).frequency_hz() } else { hz };
                let until = now + wait;
                while let Some(next) = strokes.next_up(3).filter(|next| *next < until) {
                    prop_assert!(next >= busy);
                    let own = strokes.find_map(|stroke| stroke.ok().filter(|stroke| stroke.motor == 3)).unwrap();
                    busy = own.end();
                }
                now = until;
                let from = strokes.replace(3, wave(hz, um, phase), now);
                prop_assert!(from >= now && from >= busy);
            }
        }
    }
}
