//! What the controller holds to, whatever the host asks: the last guard before a finger.
//!
//! A stroke that breaks a limit is refused whole. Corrections stay within [`correction`] pulses of the
//! stroke as planned; rates are pulses begun in any sliding second, counted by [`OnTime`].

use crate::stroke::{MOTORS, Stroke};
use crate::tick::{TICK_HZ, Tick};
use serde::{Deserialize, Serialize};

/// Up pulses of one stroke at the most: 407 µm, the paper's motors' useful travel.
pub const MAX_UP_PULSES: u16 = 3_000;
/// Down pulses of one stroke at the most, however it is corrected.
pub const MAX_DOWN_PULSES: u16 = MAX_UP_PULSES + correction(MAX_UP_PULSES);
/// Net pulses by which moves may take a pin from where it was armed.
pub const MAX_TRAVEL: u16 = 3_000;
/// Motors that share a 30 V supply (a rail).
pub const MOTORS_PER_RAIL: usize = 6;
/// Rails of the array.
pub const RAILS: usize = MOTORS / MOTORS_PER_RAIL;

/// How far a correction may take a count of pulses from the stroke as planned: 30 %, at least 1.
#[must_use]
pub const fn correction(planned: u16) -> u16 {
    // Tenths by a multiplication, exact for 16 bits: a small chip's core has no division.
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

/// Why a stroke or a command was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refusal {
    /// The controller is not armed.
    NotArmed,
    /// Motor outside 0..24.
    Motor,
    /// No up pulses, or more than [`MAX_UP_PULSES`].
    UpPulses,
    /// The up burst runs into the down burst.
    Bursts,
    /// The down burst has no pulses, or undoes the up burst by more than a correction too little or too much.
    Unbalanced,
    /// The stroke begins before the one queued before it on the same motor has ended.
    Overlap,
    /// The stroke begins more than 2^30 ticks ahead.
    TooFar,
    /// No free slot.
    PoolFull,
    /// The motor's pulses in a sliding second.
    MotorOnTime,
    /// The rail's pulses in a sliding second.
    RailOnTime,
    /// Arm asked for while the position is unknown, without `assume_rest`.
    PositionUnknown,
    /// The command does not fit the state (arm while armed or faulted, move while strokes are queued).
    State,
    /// A move beyond [`MAX_TRAVEL`].
    Travel,
    /// The lines of a batch could not be read.
    Malformed,
}

/// Pulses begun per sliding second, at the most. The defaults can never be reached: a site lowers them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OnTimeLimits {
    /// Per motor, pulses/s.
    pub motor: u32,
    /// Per rail (6 motors), pulses/s.
    pub rail: u32,
}

impl OnTimeLimits {
    /// Every tick a pulse on every motor: no limit.
    pub const NONE: Self = Self { motor: TICK_HZ, rail: MOTORS_PER_RAIL as u32 * TICK_HZ };

    /// The lower of both, limit by limit.
    #[must_use]
    pub fn min(self, other: Self) -> Self {
        Self { motor: self.motor.min(other.motor), rail: self.rail.min(other.rail) }
    }
}

/// Checks a stroke by itself: its motor, its counts, its order.
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
    // Without a down burst, strokes could follow each other as one endless up burst.
    if stroke.down_pulses == 0 || !within_correction(stroke.up_pulses, stroke.down_pulses) {
        return Err(Refusal::Unbalanced);
    }
    Ok(())
}

/// Ticks of a bucket of the on-time account: a second has 68 of them.
const BUCKET: u64 = 1_250;
/// A second and the bucket being filled.
const BUCKETS: usize = TICK_HZ as usize / BUCKET as usize + 1;

/// Counts pulses per motor against [`OnTimeLimits`].
///
/// A stroke counts from its first pulse until a second after its last one, so no sliding second ever holds
/// more than the limit; it may refuse one stroke and 15 ms early. A limit of [`OnTimeLimits::NONE`] is off: a line
/// that never rests is allowed then.
#[derive(Debug)]
pub struct OnTime {
    limits: OnTimeLimits,
    /// Index of the bucket being filled.
    bucket: usize,
    /// When the next one begins.
    next: Tick,
    ended: [[u16; MOTORS]; BUCKETS],
    charged: [u32; MOTORS],
}

impl OnTime {
    /// An empty account at `now`.
    #[must_use]
    pub const fn new(now: Tick) -> Self {
        Self {
            limits: OnTimeLimits::NONE,
            bucket: 0,
            next: Tick(now.0.saturating_add(BUCKET)),
            ended: [[0; MOTORS]; BUCKETS],
            charged: [0; MOTORS],
        }
    }

    /// Sets the limits; what is charged stays.
    pub fn set_limits(&mut self, limits: OnTimeLimits) {
        self.limits = limits;
    }

    /// Charges a stroke of `pulses` that begins at `now`.
    ///
    /// # Errors
    /// The limit it would break; nothing is charged then.
    pub fn begin(&mut self, now: Tick, motor: usize, pulses: u32) -> Result<(), Refusal> {
        self.forget(now);
        let off = OnTimeLimits::NONE;
        if self.limits.motor < off.motor && self.charged[motor] + pulses > self.limits.motor {
            return Err(Refusal::MotorOnTime);
        }
        if self.limits.rail < off.rail {
            let first = motor - motor % MOTORS_PER_RAIL;
            let rail: u32 = self.charged[first..first + MOTORS_PER_RAIL].iter().sum();
            if rail + pulses > self.limits.rail {
                return Err(Refusal::RailOnTime);
            }
        }
        self.charged[motor] += pulses;
        Ok(())
    }

    /// A stroke charged with `charged` pulses has ended at `now` after `played` of them.
    pub fn end(&mut self, now: Tick, motor: usize, charged: u32, played: u32) {
        self.forget(now);
        let ended = &mut self.ended[self.bucket][motor];
        *ended = ended.saturating_add(u16::try_from(played).unwrap_or(u16::MAX));
        self.charged[motor] = (self.charged[motor] + played).saturating_sub(charged);
    }

    /// Takes what is a second old off the account.
    fn forget(&mut self, now: Tick) {
        // After a longer pause, one round clears all.
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
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;

    const GOOD: Stroke = Stroke { motor: 0, up: Tick(100), up_pulses: 10, down: Tick(110), down_pulses: 10 };

    #[test]
    fn each_limit_of_a_stroke_has_its_edge() {
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
        assert_eq!(check(&Stroke { down_pulses: 6, ..GOOD }), Err(Refusal::Unbalanced));
    }

    #[test]
    fn corrections_are_thirty_percent_and_at_least_one() {
        for planned in 0..=u16::MAX {
            let exact = u32::from(planned) * 3 / 10;
            assert_eq!(u32::from(correction(planned)), exact.max(1));
        }
    }

    proptest! {
        /// The account against a plain list of pulses: no sliding second holds more than the limits.
        #[test]
        fn no_sliding_second_breaks_a_limit(strokes in prop::collection::vec((0usize..6, 0u64..2000, 1u32..400), 1..300)) {
            let limits = OnTimeLimits { motor: 2_000, rail: 5_000 };
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
    fn after_a_second_of_rest_the_account_is_empty() {
        let mut account = OnTime::new(Tick(0));
        account.set_limits(OnTimeLimits { motor: 100, rail: 600 });
        assert_eq!(account.begin(Tick(0), 5, 100), Ok(()));
        account.end(Tick(100), 5, 100, 100);
        assert_eq!(account.begin(Tick(84_000), 5, 1), Err(Refusal::MotorOnTime));
        assert_eq!(account.begin(Tick(100 + 85_000 + BUCKET), 5, 100), Ok(()));
        assert_eq!(account.begin(Tick(1 << 40), 4, 100), Ok(()));
    }
}
