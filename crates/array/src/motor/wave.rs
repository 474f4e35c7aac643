//! Turns a drive into edges at ticks and pulses between them.
//!
//! A drive is a square wave that goes up first. Each edge is computed from its number, never from the edge before, so the
//! millionth edge is as exact as the first. The `f64` result, in the order of operations written here, is the
//! definition: everything that needs the ticks of a drive gets them from this module.
//!
//! Above a lower stop a down burst may be longer than its up burst by a surplus ([`SquareWave::with_surplus`]). Where it does not
//! fit between the down edge and the next up edge, it begins before the down edge.
//!
//! Invariant: the down burst of an excursion has as many pulses as the up burst plus the surplus; the two do not overlap.

use super::model::{MAX_AMPLITUDE_UM, MotorError};
use super::shaft::Ramp;
use crate::spec::Array;
use crate::strokes::Stroke;
use firmware_protocol::limits;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;

/// A square-wave drive of one motor, in ticks of its own time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SquareWave {
    array: Array,
    frequency_hz: f64,
    phase: f64,
    pulses: u32,
    /// Pulses by which a down burst is longer than its up burst.
    surplus: u32,
}

/// One period of a drive: an up burst and the down burst that undoes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Excursion {
    /// Start of the up burst.
    pub up: u64,
    /// Start of the down burst.
    pub down: u64,
    /// Pulses of the up burst, and of the down burst without its surplus.
    pub pulses: u32,
    /// Additional pulses of the down burst, which a lower stop absorbs.
    pub surplus: u32,
}

impl Excursion {
    /// The stroke of `motor` for this excursion, in a play that began at `onset`.
    pub fn stroke(&self, motor: u8, onset: Tick) -> Stroke {
        // The controller's limits refuse more pulses than fit, as they should.
        let [up_pulses, down_pulses] = [self.pulses, self.pulses.saturating_add(self.surplus)]
            .map(|pulses| u16::try_from(pulses).unwrap_or(u16::MAX));
        let (up, down) = (onset + self.up, onset + self.down);
        Stroke { motor, up, up_pulses, down, down_pulses }
    }

    /// The ramps of both bursts on an ideal motor with this travel per pulse, from tick 0 on. The stop absorbs the whole surplus, so
    /// the surplus moves nothing.
    pub fn ramps(&self, um_per_pulse: f64) -> [Ramp; 2] {
        [(self.up, Direction::Up), (self.down, Direction::Down)]
            .map(|(start, direction)| Ramp::new(Tick(start), self.pulses, direction, um_per_pulse))
    }

    /// The first tick after the down burst. Saturates.
    pub const fn end(&self) -> u64 {
        self.down.saturating_add(self.pulses as u64).saturating_add(self.surplus as u64)
    }
}

impl SquareWave {
    /// A drive of a motor of this array, of `amplitude_um` peak to peak, whose edge 0 lies `phase` cycles after its time 0.
    ///
    /// # Errors
    /// The first argument that is out of range.
    pub fn new(array: Array, frequency_hz: f64, amplitude_um: f64, phase: f64) -> Result<Self, MotorError> {
        // One pulse up and one pulse down in turn.
        let most_hz = f64::from(array.rate().hz()) / 2.0;
        if !(frequency_hz > 0.0 && frequency_hz <= most_hz) {
            return Err(MotorError::Frequency { hz: frequency_hz, most_hz });
        }
        if !(0.0..=MAX_AMPLITUDE_UM).contains(&amplitude_um) {
            return Err(MotorError::Amplitude { um: amplitude_um });
        }
        if !(0.0..1.0).contains(&phase) {
            return Err(MotorError::Phase { cycles: phase });
        }
        let pulses = (amplitude_um / array.motor().um_per_pulse + 0.5) as u32;
        Ok(Self { array, frequency_hz, phase, pulses, surplus: 0 })
    }

    /// The same drive with down bursts that are longer than their up bursts. `surplus` gives the additional pulses for a number of
    /// pulses up, and must grow with it; the controller's [`correction`](limits::correction) bounds it. If both bursts do not fit
    /// into a period, the drive gets as many pulses as do.
    pub fn with_surplus(self, surplus: impl Fn(u32) -> u32) -> Self {
        let surplus = |pulses: u32| surplus(pulses).min(most_surplus(pulses));
        let wanted = surplus(self.pulses());
        if wanted == 0 {
            return self;
        }
        let fits = |pulses: u32| 2 * u64::from(pulses) + u64::from(surplus(pulses)) <= self.period_ticks();
        let (mut pulses, mut too_many) = (0, self.pulses());
        if fits(too_many) {
            return Self { pulses: too_many, surplus: wanted, ..self };
        }
        while pulses + 1 < too_many {
            let middle = u32::midpoint(pulses, too_many);
            if fits(middle) { pulses = middle } else { too_many = middle }
        }
        Self { pulses, surplus: surplus(pulses), ..self }
    }

    /// Pulses by which a down burst is longer than an up burst of so many pulses.
    pub fn surplus(&self, pulses: u32) -> u32 {
        if self.surplus == 0 { 0 } else { self.surplus.min(most_surplus(pulses)) }
    }

    /// The array of its motor.
    pub const fn array(&self) -> Array {
        self.array
    }

    /// Its frequency, Hz.
    pub const fn frequency_hz(&self) -> f64 {
        self.frequency_hz
    }

    /// Its phase, cycles.
    pub const fn phase(&self) -> f64 {
        self.phase
    }

    /// Pulses that the amplitude asks for, whether or not they fit into half a period.
    pub const fn wanted_pulses(&self) -> u32 {
        self.pulses
    }

    /// Whether it moves a pin: its amplitude is at least half a pulse.
    pub const fn moves(&self) -> bool {
        self.pulses > 0
    }

    /// Pulses of a burst: those the amplitude asks for, or as many as fit into half a period of whole ticks.
    /// (Where the edges round that way, an excursion of a saturated drive has one more.)
    pub fn pulses(&self) -> u32 {
        u32::try_from(self.half_period_ticks()).map_or(self.pulses, |room| room.min(self.pulses))
    }

    /// The mean gain of its bursts after the first: if each begins after a long rest (below about 1 Hz), all fall short.
    pub fn mean_gain(&self) -> f64 {
        let rest = self.half_period_ticks().saturating_sub(self.pulses().into());
        let motor = self.array.motor();
        if rest >= motor.transient_rest_ticks { motor.transient_gain } else { 1.0 }
    }

    /// Half a period in ticks, rounded down. The added billionth keeps a whole number of ticks whole despite the rounding of `f64`.
    pub(super) fn half_period_ticks(&self) -> u64 {
        (f64::from(self.array.rate().hz()) / 2.0 / self.frequency_hz + 1e-9) as u64
    }

    /// A period in ticks, rounded down as [`Self::half_period_ticks`].
    fn period_ticks(&self) -> u64 {
        (f64::from(self.array.rate().hz()) / self.frequency_hz + 1e-9) as u64
    }

    /// The tick of edge `h`; even edges go up, odd edges down.
    pub fn edge(&self, h: u64) -> u64 {
        (((h as f64 / 2.0 + self.phase) * f64::from(self.array.rate().hz())) / self.frequency_hz + 0.5) as u64
    }

    /// The drive's excursions from its beginning, in order of time, without end.
    pub fn excursions(self) -> impl Iterator<Item = Excursion> + Clone {
        (0..).map(move |number| self.excursion(number))
    }

    /// The excursion of this number, counted from the beginning of the drive.
    #[inline]
    pub fn excursion(&self, number: u64) -> Excursion {
        let [up, down, next_up] = [0, 1, 2].map(|more| self.edge((2 * number).saturating_add(more)));
        self.between(up, down, next_up)
    }

    /// The excursion between edges at these ticks.
    #[inline]
    fn between(&self, up: u64, down: u64, next_up: u64) -> Excursion {
        // An edge whose tick saturates never comes, so it limits nothing.
        let room = if next_up == u64::MAX { u64::MAX } else { next_up - down };
        let mut pulses = u64::from(self.pulses).min(down - up).min(room) as u32;
        if self.surplus == 0 {
            return Excursion { up, down, pulses, surplus: 0 };
        }
        let mut surplus = self.surplus(pulses);
        // Rounding shortens a period by a tick at most.
        while pulses > 0 && 2 * u64::from(pulses) + u64::from(surplus) > next_up - up {
            pulses -= 1;
            surplus = self.surplus(pulses);
        }
        let latest = next_up.saturating_sub(u64::from(pulses) + u64::from(surplus));
        Excursion { up, down: down.min(latest), pulses, surplus }
    }
}

/// The controller's bound on the difference of the bursts of a stroke.
fn most_surplus(pulses: u32) -> u32 {
    limits::correction(u16::try_from(pulses).unwrap_or(u16::MAX)).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_drive_plays_all_its_pulses_and_a_fast_one_as_many_as_fit() {
        let slow = SquareWave::new(Array::paper(), 60.0, 20.0, 0.0).unwrap();
        assert_eq!((slow.wanted_pulses(), slow.pulses()), (147, 147));
        let first: Vec<_> = slow.excursions().take(2).collect();
        assert_eq!(first[0], Excursion { up: 0, down: 708, pulses: 147, surplus: 0 });
        assert_eq!(first[1], Excursion { up: 1417, down: 2125, pulses: 147, surplus: 0 });
        let fast = SquareWave::new(Array::paper(), 300.0, 80.0, 0.0).unwrap();
        assert_eq!((fast.wanted_pulses(), fast.pulses()), (589, 141));
        assert!(fast.excursions().take(1000).all(|e| (141..=142).contains(&e.pulses)));
        let fastest = SquareWave::new(Array::paper(), 42_500.0, 80.0, 0.0).unwrap();
        assert!(fastest.excursions().take(1000).all(|e| e.pulses == 1 && e.end() == e.up + 2));
    }

    #[test]
    fn an_impossible_drive_is_refused_in_one_line() {
        let refused = [
            SquareWave::new(Array::paper(), 0.0, 1.0, 0.0),
            SquareWave::new(Array::paper(), 42_500.1, 1.0, 0.0),
            SquareWave::new(Array::paper(), f64::NAN, 1.0, 0.0),
            SquareWave::new(Array::paper(), 60.0, -1.0, 0.0),
            SquareWave::new(Array::paper(), 60.0, f64::INFINITY, 0.0),
            SquareWave::new(Array::paper(), 60.0, 1.0, 1.0),
            SquareWave::new(Array::paper(), 60.0, 1.0, f64::NAN),
        ];
        for wave in refused {
            let line = wave.unwrap_err().to_string();
            assert!(line.contains("must be") && !line.contains('\n'), "{line}");
        }
    }
}
