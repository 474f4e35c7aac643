//! Limits that the controller enforces whatever the host asks: the last guard before a finger.
//!
//! [`check`] accepts or refuses a whole stroke. [`correction`] bounds how far an amendment may change a burst. [`OnTime`]
//! counts the pulses begun in any sliding second against [`PowerLimits`], [`Pushing`] those against a lower stop. How many motors may
//! have pulses at once is in [`PowerLimits`], too; the controller keeps it.

use crate::stroke::{MOTORS, Stroke};
use crate::tick::{TICK_HZ, Tick};
use serde::{Deserialize, Serialize};

/// Most up pulses of a stroke: 407 µm, the useful travel of the paper's motors.
pub const MAX_UP_PULSES: u16 = 3_000;
/// Most down pulses of a stroke, corrections included.
pub const MAX_DOWN_PULSES: u16 = MAX_UP_PULSES + correction(MAX_UP_PULSES);
/// Most net pulses by which moves may shift a pin from where it was at rest.
pub const MAX_TRAVEL: u16 = 3_000;
/// Farthest that moves and a stroke can take a pin from the lower stop, pulses: more than twice the useful travel of the paper's
/// motors. A seek of so many pulses is always enough.
pub const WHOLE_TRAVEL: u16 = MAX_TRAVEL + MAX_DOWN_PULSES;
/// Most pulses of a seek of the lower stop. The paper's motors need 7 400 for 1 mm, twice the travel of our simulated ones.
pub const MAX_SEEK: u16 = 17_000;
/// Most pulses per sliding second that a motor may push against a lower stop: three tenths of all. Our choice, room for two seeks
/// and a play; no data on wear were found.
pub const MAX_PUSHES_PER_S: u32 = 25_500;
/// Motors that share a 30 V supply (a rail).
pub const MOTORS_PER_RAIL: usize = 6;
/// Motors that share a driver chip: 2c and 2c + 1 are those of chip c.
pub const MOTORS_PER_CHIP: usize = 2;
/// Rails of the array.
pub const RAILS: usize = MOTORS / MOTORS_PER_RAIL;

/// Least ticks from the beginning of a stroke to that of the next one of its motor: 1 ms. Strokes of a pattern are at least 1.67 ms long,
/// half a period of 300 Hz.
pub const LEAST_APART: u64 = TICK_HZ as u64 / 1_000;
/// Most strokes that begin within [`DENSE_TICKS`], of all motors together: 192 bursts. Each motor begins at most four at 300 Hz.
pub const MAX_DENSE: u8 = 4 * MOTORS as u8;
/// 10 ms, in whole blocks of what is rendered.
pub const DENSE_TICKS: u64 = 53 * 16;

/// Most pulses by which a correction may change a planned count: 30 %, at least 1.
#[must_use]
pub const fn correction(planned: u16) -> u16 {
    // Divides by ten with a multiplication, exact for 16 bits: the chip's core has no division.
    let planned = planned as u32;
    let tens = (planned * 52_429) >> 19;
    let part = tens * 3 + (((planned - tens * 10) * 3 * 52_429) >> 19);
    if part > 1 { part as u16 } else { 1 }
}

/// Whether `count` is within [`correction`] of `planned`.
#[must_use]
pub const fn within_correction(planned: u16, count: u16) -> bool {
    count.abs_diff(planned) <= correction(planned)
}

/// Least pulses of a seek of a pin that is `above` pulses above the lower stop: half as many again, because a motor's first burst
/// after half a second of rest travels 80 %, and its bursts scatter by 10 %; at most [`WHOLE_TRAVEL`].
#[must_use]
pub const fn least_seek(above: u16) -> u16 {
    if above < WHOLE_TRAVEL / 3 * 2 { above + above / 2 + 1 } else { WHOLE_TRAVEL }
}

/// Why a stroke or a command was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Refusal {
    /// The controller is not armed.
    NotArmed,
    /// Motor outside 0..24.
    Motor,
    /// No up pulses, or more than [`MAX_UP_PULSES`].
    UpPulses,
    /// The up burst runs into the down burst.
    Bursts,
    /// The down burst is shorter than the up burst, or longer by more than a correction.
    Unbalanced,
    /// The stroke begins before the one queued before it on the same motor has ended.
    Overlap,
    /// The stroke begins more than 2^30 ticks ahead.
    TooFar,
    /// No free stroke slot.
    PoolFull,
    /// Too many pulses of the motor in a sliding second.
    MotorOnTime,
    /// Too many pulses of the rail in a sliding second.
    RailOnTime,
    /// `arm` without `assume_rest` while the position is unknown.
    PositionUnknown,
    /// The state does not allow the command (arm while armed or faulted, move while strokes are queued).
    State,
    /// The move goes beyond [`MAX_TRAVEL`]; the seek is longer than [`MAX_SEEK`], or too short to reach the lower stop.
    Travel,
    /// The batch could not be read.
    Malformed,
    /// Too many pulses against the lower stop in a sliding second; without a stop there may be none.
    Pushing,
    /// Too many motors of the rail would have pulses at once.
    RailAtOnce,
    /// Too many motors of the driver chip would have pulses at once.
    ChipAtOnce,
    /// The stroke begins less than [`LEAST_APART`] after the one before it on the same motor, or after too many of all motors
    /// ([`MAX_DENSE`]).
    Dense,
}

/// What motors, drivers and supplies bear: pulses begun in a sliding second, and motors that have pulses at once. The defaults cannot
/// be reached; a site may lower them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PowerLimits {
    /// Per motor, pulses/s.
    pub motor: u32,
    /// Per rail (6 motors), pulses/s.
    pub rail: u32,
    /// Most motors of a rail with pulses in the same tick, 1 to 6; 0 counts as 1.
    pub rail_at_once: u8,
    /// Most motors of a driver chip with pulses in the same tick, 1 or 2; 0 counts as 1.
    pub chip_at_once: u8,
}

impl PowerLimits {
    /// No limit: every motor may begin a pulse in every tick.
    pub const NONE: Self = Self {
        motor: TICK_HZ,
        rail: MOTORS_PER_RAIL as u32 * TICK_HZ,
        rail_at_once: MOTORS_PER_RAIL as u8,
        chip_at_once: MOTORS_PER_CHIP as u8,
    };

    /// The lower value of each limit.
    #[must_use]
    pub fn min(self, other: Self) -> Self {
        Self {
            motor: self.motor.min(other.motor),
            rail: self.rail.min(other.rail),
            rail_at_once: self.rail_at_once.min(other.rail_at_once).max(1),
            chip_at_once: self.chip_at_once.min(other.chip_at_once).max(1),
        }
    }

    /// A return or a seek of all pins takes at most so many times its longest burst, because motors take turns.
    #[must_use]
    pub const fn turns(&self) -> u8 {
        let chips = MOTORS_PER_RAIL as u8 / MOTORS_PER_CHIP as u8;
        let at_once = if self.chip_at_once < MOTORS_PER_CHIP as u8 && self.rail_at_once > chips {
            chips
        } else if self.rail_at_once == 0 {
            1
        } else {
            self.rail_at_once
        };
        (MOTORS_PER_RAIL as u8).div_ceil(at_once)
    }
}

/// Checks a stroke by itself: motor, pulse counts, order of its bursts.
///
/// # Errors
/// The first limit it breaks.
pub fn check(stroke: &Stroke) -> Result<(), Refusal> {
    if usize::from(stroke.motor) >= MOTORS {
        return Err(Refusal::Motor);
    }
    if stroke.up_pulses == 0 || stroke.up_pulses > MAX_UP_PULSES {
        return Err(Refusal::UpPulses);
    }
    if stroke.up + u64::from(stroke.up_pulses) > stroke.down {
        return Err(Refusal::Bursts);
    }
    // A stroke may push its pin against a lower stop, but not leave it higher than it was.
    if stroke.down_pulses == stroke.up_pulses {
        return Ok(());
    }
    if stroke.down_pulses < stroke.up_pulses || !within_correction(stroke.up_pulses, stroke.down_pulses) {
        return Err(Refusal::Unbalanced);
    }
    Ok(())
}

/// Ticks of a bucket of the on-time count: a second has 68 buckets.
const BUCKET: u64 = 1_250;
/// The buckets of a second, and the one being filled.
const BUCKETS: usize = TICK_HZ as usize / BUCKET as usize + 1;

/// Counts pulses per motor of the last second.
#[derive(Clone, Debug, Hash)]
struct SlidingSecond {
    /// Index of the bucket being filled.
    bucket: usize,
    /// When the next bucket begins.
    next: Tick,
    ended: [[u16; MOTORS]; BUCKETS],
    charged: [u32; MOTORS],
}

impl SlidingSecond {
    const fn new(now: Tick) -> Self {
        Self {
            bucket: 0,
            next: Tick(now.0.saturating_add(BUCKET)),
            ended: [[0; MOTORS]; BUCKETS],
            charged: [0; MOTORS],
        }
    }

    /// Pulses begun, from their first until a second after the last.
    fn charged(&mut self, now: Tick) -> &mut [u32; MOTORS] {
        if self.next <= now {
            self.next_buckets(now);
        }
        &mut self.charged
    }

    #[inline(never)]
    fn next_buckets(&mut self, now: Tick) {
        // After a long pause, one round over the buckets clears all.
        self.next = self.next.max(Tick(now.0.saturating_sub(BUCKET * BUCKETS as u64)));
        while self.next <= now {
            self.next = self.next + BUCKET;
            self.bucket = if self.bucket + 1 < BUCKETS { self.bucket + 1 } else { 0 };
            let old = &mut self.ended[self.bucket];
            for (charged, ended) in self.charged.iter_mut().zip(old) {
                *charged = charged.saturating_sub(u32::from(core::mem::take(ended)));
            }
        }
    }

    /// Ends at `now` a stroke counted with `charged` pulses, of which `played` were played.
    fn end(&mut self, now: Tick, motor: usize, charged: u32, played: u32) {
        let sum = &mut self.charged(now)[motor];
        *sum = (*sum + played).saturating_sub(charged);
        let ended = &mut self.ended[self.bucket][motor];
        *ended = ended.saturating_add(u16::try_from(played).unwrap_or(u16::MAX));
    }
}

/// Counts pulses per motor against [`PowerLimits`].
///
/// A stroke counts from its first pulse until a second after its last one. So no sliding second ever holds more than the
/// limit, but a stroke may be refused when the sum is one stroke or 15 ms below it. [`PowerLimits::NONE`] turns a
/// limit off: a line may then pulse without rest.
#[derive(Clone, Debug, Hash)]
pub struct OnTime {
    limits: PowerLimits,
    pulses: SlidingSecond,
}

impl OnTime {
    /// An empty count at `now`.
    #[must_use]
    pub const fn new(now: Tick) -> Self {
        Self { limits: PowerLimits::NONE, pulses: SlidingSecond::new(now) }
    }

    /// Sets the limits. The pulses counted so far stay.
    pub fn set_limits(&mut self, limits: PowerLimits) {
        self.limits = limits;
    }

    /// The limits.
    #[must_use]
    pub fn limits(&self) -> PowerLimits {
        self.limits
    }

    /// Counts a stroke of `pulses` that begins at `now`.
    ///
    /// # Errors
    /// The limit that the stroke would break; then nothing is counted.
    pub fn begin(&mut self, now: Tick, motor: usize, pulses: u32) -> Result<(), Refusal> {
        let (off, charged) = (PowerLimits::NONE, self.pulses.charged(now));
        if self.limits.motor < off.motor && charged[motor] + pulses > self.limits.motor {
            return Err(Refusal::MotorOnTime);
        }
        if self.limits.rail < off.rail {
            let first = motor - motor % MOTORS_PER_RAIL;
            let rail: u32 = charged[first..first + MOTORS_PER_RAIL].iter().sum();
            if rail + pulses > self.limits.rail {
                return Err(Refusal::RailOnTime);
            }
        }
        charged[motor] += pulses;
        Ok(())
    }

    /// Counts a burst that no limit may refuse.
    pub fn count(&mut self, now: Tick, motor: usize, pulses: u32) {
        self.pulses.charged(now)[motor] += pulses;
    }

    /// Ends at `now` a stroke counted with `charged` pulses, of which `played` were played.
    pub fn end(&mut self, now: Tick, motor: usize, charged: u32, played: u32) {
        self.pulses.end(now, motor, charged, played);
    }
}

/// Counts the pulses that a motor pushes against a lower stop: the surplus of its strokes, and seeks.
///
/// It counts the pulses by which the down burst is longer than the up burst, from the stroke's first pulse until a second after
/// its last. An up burst amended to be longer counts as planned. If an e-stop cuts a stroke, the pulses played count; those left
/// count when they are returned.
#[derive(Clone, Debug, Hash)]
pub struct Pushing {
    /// 0: there is no stop.
    limit: u32,
    pulses: SlidingSecond,
}

impl Pushing {
    /// An empty count at `now`, without a stop.
    #[must_use]
    pub const fn new(now: Tick) -> Self {
        Self { limit: 0, pulses: SlidingSecond::new(now) }
    }

    /// Sets the limit, at most [`MAX_PUSHES_PER_S`]; 0 without a stop. The pulses counted so far stay.
    pub fn set_limit(&mut self, pulses_per_s: u32) {
        self.limit = pulses_per_s.min(MAX_PUSHES_PER_S);
    }

    /// Whether there is a stop.
    #[must_use]
    pub fn is_allowed(&self) -> bool {
        self.limit > 0
    }

    /// Whether every motor may push `pulses` more at `now`.
    #[must_use]
    pub fn allows_all(&mut self, now: Tick, pulses: u32) -> bool {
        let limit = self.limit;
        self.pulses.charged(now).iter().all(|charged| charged + pulses <= limit)
    }

    /// Counts a surplus that begins at `now`.
    ///
    /// # Errors
    /// [`Refusal::Pushing`] if it would break the limit; then nothing is counted.
    pub fn begin(&mut self, now: Tick, motor: usize, pulses: u32) -> Result<(), Refusal> {
        // A stroke that pushes nothing breaks no limit, even one that was lowered.
        if pulses == 0 {
            return Ok(());
        }
        let charged = &mut self.pulses.charged(now)[motor];
        if *charged + pulses > self.limit {
            return Err(Refusal::Pushing);
        }
        *charged += pulses;
        Ok(())
    }

    /// Counts pulses that no limit may refuse.
    pub fn count(&mut self, now: Tick, motor: usize, pulses: u32) {
        self.pulses.charged(now)[motor] += pulses;
    }

    /// Ends at `now` a surplus of `pulses`, of which `played` keep counting.
    pub fn end(&mut self, now: Tick, motor: usize, pulses: u32, played: u32) {
        if pulses > 0 || played > 0 {
            self.pulses.end(now, motor, pulses, played);
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;

    const GOOD: Stroke = Stroke { motor: 0, up: Tick(100), up_pulses: 10, down: Tick(110), down_pulses: 10 };

    #[test]
    fn each_limit_of_a_stroke_is_exact() {
        assert_eq!(check(&GOOD), Ok(()));
        assert_eq!(check(&Stroke { motor: 23, ..GOOD }), Ok(()));
        assert_eq!(check(&Stroke { motor: 24, ..GOOD }), Err(Refusal::Motor));
        assert_eq!(check(&Stroke { up_pulses: 0, ..GOOD }), Err(Refusal::UpPulses));
        let long = Stroke { up_pulses: 3000, down: Tick(9000), down_pulses: 3000, ..GOOD };
        assert_eq!(check(&long), Ok(()));
        let longer = Stroke { up_pulses: 3001, down_pulses: 3001, ..long };
        assert_eq!(check(&longer), Err(Refusal::UpPulses));
        assert_eq!(check(&Stroke { down: Tick(109), ..GOOD }), Err(Refusal::Bursts));
        assert_eq!(check(&Stroke { down_pulses: 13, ..GOOD }), Ok(()));
        assert_eq!(check(&Stroke { down_pulses: 14, ..GOOD }), Err(Refusal::Unbalanced));
        assert_eq!(check(&Stroke { down_pulses: 9, ..GOOD }), Err(Refusal::Unbalanced));
    }

    #[test]
    fn corrections_are_thirty_percent_and_at_least_one() {
        for planned in 0..=u16::MAX {
            let exact = u32::from(planned) * 3 / 10;
            assert_eq!(u32::from(correction(planned)), exact.max(1));
        }
    }

    #[test]
    fn a_seek_goes_beyond_the_pin_and_at_most_the_whole_travel() {
        for above in 0..=u16::MAX {
            let least = least_seek(above);
            let enough = u32::from(least) > u32::from(above) * 3 / 2;
            assert!(least == WHOLE_TRAVEL || (enough && least < WHOLE_TRAVEL), "{above}: {least}");
        }
        assert_eq!((least_seek(0), least_seek(100), least_seek(WHOLE_TRAVEL)), (1, 151, WHOLE_TRAVEL));
    }

    proptest! {
        /// Compared with a plain list of bursts.
        #[test]
        fn no_sliding_second_breaks_a_limit(strokes in prop::collection::vec((0usize..6, 0u64..2000, 1u32..400), 1..300)) {
            let limits = PowerLimits { motor: 2_000, rail: 5_000, ..PowerLimits::NONE };
            let mut account = OnTime::new(Tick(0));
            account.set_limits(limits);
            let (mut now, mut bursts, mut refused) = (0, std::vec::Vec::new(), 0);
            for (motor, wait, count) in strokes {
                now += wait;
                if account.begin(Tick(now), motor, count).is_err() {
                    refused += 1;
                    continue;
                }
                bursts.push((motor, now, now + u64::from(count)));
                now += u64::from(count);
                account.end(Tick(now), motor, count, count);
            }
            let mut played = 0;
            for &(_, _, end) in &bursts {
                let mut second = [0; 6];
                for &(motor, from, to) in &bursts {
                    second[motor] += to.min(end).saturating_sub(from.max(end.saturating_sub(85_000)));
                }
                prop_assert!(second.iter().all(|&pulses| pulses <= limits.motor.into()));
                prop_assert!(second.iter().sum::<u64>() <= limits.rail.into());
                played = played.max(second.iter().sum());
            }
            prop_assert!(refused == 0 || played > 1_500);
        }
    }

    #[test]
    fn after_a_second_of_rest_nothing_counts() {
        let mut account = OnTime::new(Tick(0));
        account.set_limits(PowerLimits { motor: 100, rail: 600, ..PowerLimits::NONE });
        assert_eq!(account.begin(Tick(0), 5, 100), Ok(()));
        account.end(Tick(100), 5, 100, 100);
        assert_eq!(account.begin(Tick(84_000), 5, 1), Err(Refusal::MotorOnTime));
        assert_eq!(account.begin(Tick(100 + 85_000 + BUCKET), 5, 100), Ok(()));
        assert_eq!(account.begin(Tick(1 << 40), 4, 100), Ok(()));
    }
}
