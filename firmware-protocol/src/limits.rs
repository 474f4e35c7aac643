//! Limits that the controller enforces whatever the host asks: the last guard before a finger.
//!
//! [`Layout::check`] accepts or refuses a move by itself. [`correction`] bounds how far an amendment may change a burst. [`OnTime`]
//! counts the pulses begun in any sliding second against [`PowerLimits`], [`Pushing`] those against a lower stop. How many motors may
//! have pulses at once is in [`PowerLimits`], too; the controller keeps it.

use crate::array::{CAPACITY, Layout, Ring};
pub use crate::array::{correction, within_correction};
use crate::moves::Move;
use crate::tick::{BLOCK, Tick};
use serde::{Deserialize, Serialize};

/// Why a move or a command was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Refusal {
    /// The controller is not armed.
    NotArmed,
    /// No motor of the array.
    Motor,
    /// The level is above [`Layout::max_up_pulses`].
    Level,
    /// A surplus at another level than 0, or longer than a correction.
    Surplus,
    /// The move begins more than 2^30 ticks ahead.
    TooFar,
    /// No free slot.
    PoolFull,
    /// Too many pulses of the motor in a sliding second.
    MotorOnTime,
    /// Too many pulses of the rail in a sliding second.
    RailOnTime,
    /// `arm` without `assume_rest` while the position is unknown.
    PositionUnknown,
    /// The state does not allow the command (arm while armed or faulted, shift while moves wait).
    State,
    /// The move goes beyond [`Layout::max_travel`]; the seek is longer than [`Layout::max_seek`], or too short to reach the lower
    /// stop.
    Travel,
    /// The batch could not be read.
    Malformed,
    /// Too many pulses against the lower stop in a sliding second; without a stop there may be none.
    Pushing,
    /// Too many motors of the rail would have pulses at once.
    RailAtOnce,
    /// Too many motors of the driver chip would have pulses at once.
    ChipAtOnce,
    /// The move begins less than [`Layout::least_apart`] after the last but one before it on the same motor, or after too many of all
    /// motors ([`Layout::max_dense`]).
    Dense,
}

/// What motors, drivers and supplies bear: pulses begun in a sliding second, and motors that have pulses at once. Those of
/// [`Layout::no_limits`] cannot be reached; a site may lower them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PowerLimits {
    /// Per motor, pulses/s.
    pub motor: u32,
    /// Per rail, pulses/s.
    pub rail: u32,
    /// Most motors of a rail with pulses in the same tick; 0 counts as 1.
    pub rail_at_once: u8,
    /// Most motors of a driver chip with pulses in the same tick; 0 counts as 1.
    pub chip_at_once: u8,
}

impl PowerLimits {
    /// The lower value of each limit.
    pub fn min(self, other: Self) -> Self {
        Self {
            motor: self.motor.min(other.motor),
            rail: self.rail.min(other.rail),
            rail_at_once: self.rail_at_once.min(other.rail_at_once).max(1),
            chip_at_once: self.chip_at_once.min(other.chip_at_once).max(1),
        }
    }
}

/// Buckets of a second in the on-time count.
const BUCKETS_PER_S: usize = 68;
/// The buckets of a second, and the one being filled.
const BUCKETS: usize = BUCKETS_PER_S + 1;

/// Counts pulses per motor of the last second.
#[derive(Clone, Debug, Hash)]
pub struct SlidingSecond {
    /// Index of the bucket being filled.
    bucket: usize,
    /// Ticks of a bucket.
    ticks: u32,
    /// When the next bucket begins.
    next: Tick,
    ended: [[u16; CAPACITY]; BUCKETS],
    /// Pulses begun, from their first until a second after the last.
    charged: [u32; CAPACITY],
}

impl SlidingSecond {
    const fn new(tick_hz: u32, now: Tick) -> Self {
        // Time passes a block at a time, so a bucket may begin and end later by as much.
        let ticks = (tick_hz + BLOCK).div_ceil(BUCKETS_PER_S as u32);
        Self {
            bucket: 0,
            ticks,
            next: Tick(now.0.saturating_add(ticks as u64)),
            ended: [[0; CAPACITY]; BUCKETS],
            charged: [0; CAPACITY],
        }
    }

    /// Lets time pass up to `now`, where what is counted next begins or ends; in steps of a block at most, so that it is never long.
    pub fn pass(&mut self, now: Tick) {
        if self.next <= now {
            self.next_buckets(now);
        }
    }

    #[inline(never)]
    fn next_buckets(&mut self, now: Tick) {
        // After a long pause, one round over the buckets clears all.
        let ticks = u64::from(self.ticks);
        self.next = self.next.max(Tick(now.0.saturating_sub(ticks * BUCKETS as u64)));
        while self.next <= now {
            self.next = self.next + ticks;
            self.bucket = if self.bucket + 1 < BUCKETS { self.bucket + 1 } else { 0 };
            let old = &mut self.ended[self.bucket];
            for (charged, ended) in self.charged.iter_mut().zip(old) {
                if *ended > 0 {
                    *charged = charged.saturating_sub(u32::from(core::mem::take(ended)));
                }
            }
        }
    }

    /// Counts a burst that no limit may refuse.
    pub fn count(&mut self, motor: usize, pulses: u32) {
        self.charged[motor] += pulses;
    }

    /// Ends a move counted with `charged` pulses, of which `played` were played.
    pub fn end(&mut self, motor: usize, charged: u32, played: u32) {
        let sum = &mut self.charged[motor];
        *sum = (*sum + played).saturating_sub(charged);
        let ended = &mut self.ended[self.bucket][motor];
        *ended = ended.saturating_add(u16::try_from(played).unwrap_or(u16::MAX));
    }

    /// Counts no longer the last `pulses` that have ended, at most a bucket's time ago: they were not played.
    pub fn take_back(&mut self, motor: usize, pulses: u16) {
        let sum = &mut self.charged[motor];
        *sum = sum.saturating_sub(pulses.into());
        let before = if self.bucket > 0 { self.bucket - 1 } else { BUCKETS - 1 };
        let mut left = pulses;
        for bucket in [self.bucket, before] {
            let ended = &mut self.ended[bucket][motor];
            let some = left.min(*ended);
            (*ended, left) = (*ended - some, left - some);
        }
    }
}

/// Counts pulses per motor against [`PowerLimits`].
///
/// A move counts from its first pulse until a second after its last one. So no sliding second ever holds more than the
/// limit, but a move may be refused when the sum is one move or 15 ms below it. The array's own limits
/// ([`Layout::no_limits`]) turn a limit off: a line may then pulse without rest.
#[derive(Clone, Debug, Hash)]
pub struct OnTime {
    limits: PowerLimits,
    /// Whether the pulses per motor, and per rail, are limited.
    limits_motor: bool,
    limits_rail: bool,
    /// The pulses.
    pub pulses: SlidingSecond,
}

impl OnTime {
    /// An empty count at `now`, without limits.
    pub const fn new(layout: &Layout, now: Tick) -> Self {
        Self {
            limits: layout.no_limits(),
            limits_motor: false,
            limits_rail: false,
            pulses: SlidingSecond::new(layout.tick_hz(), now),
        }
    }

    /// Sets the limits. The pulses counted so far stay.
    pub fn set_limits(&mut self, limits: PowerLimits, layout: &Layout) {
        let off = layout.no_limits();
        (self.limits_motor, self.limits_rail) = (limits.motor < off.motor, limits.rail < off.rail);
        self.limits = limits;
    }

    /// The limits.
    pub fn limits(&self) -> PowerLimits {
        self.limits
    }

    /// Whether there are limits on pulses.
    pub fn is_limited(&self) -> bool {
        self.limits_motor || self.limits_rail
    }

    /// Counts a move of `pulses` that begins.
    ///
    /// # Errors
    /// The limit that the move would break; then nothing is counted.
    pub fn begin(
        &mut self,
        motor: usize,
        pulses: u32,
        [back, back_on_rail]: [u32; 2],
        layout: &Layout,
    ) -> Result<(), Refusal> {
        let charged = &mut self.pulses.charged;
        if self.limits_motor && charged[motor] + pulses + back > self.limits.motor {
            return Err(Refusal::MotorOnTime);
        }
        let rail = || sum(charged, motor, layout.next_on_rail()) + back_on_rail;
        if self.limits_rail && rail() + pulses > self.limits.rail {
            return Err(Refusal::RailOnTime);
        }
        charged[motor] += pulses;
        Ok(())
    }

    /// The most pulses for which [`Self::begin`] would succeed.
    pub fn room(&self, motor: usize, [back, back_on_rail]: [u32; 2], layout: &Layout) -> u32 {
        let charged = &self.pulses.charged;
        let (mut room, limits) = (u32::MAX, self.limits);
        if self.limits_motor {
            room = limits.motor.saturating_sub(charged[motor] + back);
        }
        if self.limits_rail {
            let begun = sum(charged, motor, layout.next_on_rail());
            room = room.min(limits.rail.saturating_sub(begun + back_on_rail));
        }
        room
    }
}

/// The sum over the group of `motor`.
fn sum(charged: &[u32; CAPACITY], motor: usize, ring: &Ring) -> u32 {
    let (mut sum, mut other) = (charged[motor], usize::from(ring[motor]));
    while other != motor {
        sum += charged[other];
        other = ring[other].into();
    }
    sum
}

/// Counts the pulses that a motor pushes against a lower stop: the surplus of its moves, shifts, seeks, and pulses down that corrections of
/// ways up have left to push.
///
/// They count from the first pulse of their burst until a second after its last. If an e-stop cuts it, the pulses played count; those left
/// count when they are returned.
#[derive(Clone, Debug, Hash)]
pub struct Pushing {
    /// 0: there is no stop.
    limit: u32,
    /// The highest limit.
    most: u32,
    /// The pulses that push.
    pub pulses: SlidingSecond,
}

impl Pushing {
    /// An empty count at `now`, without a stop.
    pub const fn new(layout: &Layout, now: Tick) -> Self {
        let most = layout.max_pushes_per_s();
        Self { limit: 0, most, pulses: SlidingSecond::new(layout.tick_hz(), now) }
    }

    /// Sets the limit, at most [`Layout::max_pushes_per_s`]; 0 without a stop. The pulses counted so far stay.
    pub fn set_limit(&mut self, pulses_per_s: u32) {
        self.limit = pulses_per_s.min(self.most);
    }

    /// Whether there is a stop.
    pub fn is_allowed(&self) -> bool {
        self.limit > 0
    }

    /// Whether every motor may push `pulses` more.
    pub fn allows_all(&self, pulses: u32) -> bool {
        self.pulses.charged.iter().all(|charged| charged + pulses <= self.limit)
    }

    /// Counts a surplus that begins.
    ///
    /// # Errors
    /// [`Refusal::Pushing`] if it would break the limit; then nothing is counted.
    pub fn begin(&mut self, motor: usize, pulses: u32) -> Result<(), Refusal> {
        // A move that pushes nothing breaks no limit, even one that was lowered.
        if pulses == 0 {
            return Ok(());
        }
        let charged = &mut self.pulses.charged[motor];
        if *charged + pulses > self.limit {
            return Err(Refusal::Pushing);
        }
        *charged += pulses;
        Ok(())
    }

    /// How many pulses more a motor may push.
    pub fn room(&self, motor: usize) -> u32 {
        self.limit.saturating_sub(self.pulses.charged[motor])
    }
}

impl Layout {
    /// No limit: every motor may begin a pulse in every tick.
    pub const fn no_limits(&self) -> PowerLimits {
        PowerLimits {
            motor: self.tick_hz(),
            rail: self.motors_per_rail() as u32 * self.tick_hz(),
            rail_at_once: self.motors_per_rail(),
            chip_at_once: self.motors_per_chip(),
        }
    }

    /// Whether bursts of all motors may not have pulses together.
    pub const fn takes_turns(&self, limits: &PowerLimits) -> bool {
        limits.rail_at_once < self.motors_per_rail() || limits.chip_at_once < self.motors_per_chip()
    }

    /// A return or a seek of all pins takes at most so many times its longest burst, because motors take turns.
    ///
    /// A pin waits only while its rail is full of others, or its chip. Each of them has one burst: so the last pin waits for the rail for at
    /// most a burst of all others on it, as many at once as may, and for its chip alike.
    pub const fn turns(&self, limits: &PowerLimits) -> u8 {
        let (of_rail, of_chip) = (self.motors_per_rail(), self.motors_per_chip());
        let (rail, chip) = (limits.rail_at_once, limits.chip_at_once);
        let full_rail =
            if rail < of_rail { (of_rail - 1).div_ceil(if rail == 0 { 1 } else { rail }) } else { 0 };
        let full_chip =
            if chip < of_chip { (of_chip - 1).div_ceil(if chip == 0 { 1 } else { chip }) } else { 0 };
        1 + full_rail + full_chip
    }

    /// Checks a move by itself: motor, level, surplus.
    ///
    /// # Errors
    /// The first limit it breaks.
    pub fn check(&self, to: &Move) -> Result<(), Refusal> {
        if usize::from(to.motor) >= self.motors() {
            return Err(Refusal::Motor);
        }
        if to.level > self.max_up_pulses() {
            return Err(Refusal::Level);
        }
        if to.surplus > 0 && (to.level > 0 || to.surplus > correction(self.max_up_pulses())) {
            return Err(Refusal::Surplus);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;

    const PAPER: Layout = Layout::PAPER;
    const WHOLE_TRAVEL: u16 = PAPER.whole_travel();
    const GOOD: Move = Move { motor: 0, tick: Tick(100), level: 10, surplus: 0 };

    #[test]
    fn each_limit_of_a_move_is_exact() {
        assert_eq!(PAPER.check(&GOOD), Ok(()));
        assert_eq!(PAPER.check(&Move { level: 0, ..GOOD }), Ok(()));
        assert_eq!(PAPER.check(&Move { motor: 23, ..GOOD }), Ok(()));
        assert_eq!(PAPER.check(&Move { motor: 24, ..GOOD }), Err(Refusal::Motor));
        assert_eq!(PAPER.check(&Move { motor: 255, ..GOOD }), Err(Refusal::Motor));
        assert_eq!(PAPER.check(&Move { level: 3_000, ..GOOD }), Ok(()));
        assert_eq!(PAPER.check(&Move { level: 3_001, ..GOOD }), Err(Refusal::Level));
        assert_eq!(PAPER.check(&Move { level: u16::MAX, ..GOOD }), Err(Refusal::Level));
        let surplus = |level, surplus| PAPER.check(&Move { level, surplus, ..GOOD });
        assert_eq!((surplus(0, 1), surplus(0, 900)), (Ok(()), Ok(())));
        assert_eq!((surplus(0, 901), surplus(0, u16::MAX)), (Err(Refusal::Surplus), Err(Refusal::Surplus)));
        assert_eq!((surplus(1, 1), surplus(10, 900)), (Err(Refusal::Surplus), Err(Refusal::Surplus)));
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
            let least = PAPER.least_seek(above);
            let enough = u32::from(least) > u32::from(above) * 3 / 2;
            assert!(least == WHOLE_TRAVEL || (enough && least < WHOLE_TRAVEL), "{above}: {least}");
        }
        assert_eq!(
            (PAPER.least_seek(0), PAPER.least_seek(100), PAPER.least_seek(WHOLE_TRAVEL)),
            (1, 151, WHOLE_TRAVEL)
        );
    }

    /// Lets time pass from the block of `passed` to that of `now`.
    fn pass(account: &mut OnTime, passed: &mut u64, now: u64) {
        while *passed + u64::from(BLOCK) <= now {
            *passed += u64::from(BLOCK);
            account.pulses.pass(Tick(*passed));
        }
    }

    proptest! {
        /// Compared with a plain list of bursts. Pins come down whatever was counted: no way up begins without room for its way back.
        #[test]
        fn no_sliding_second_breaks_a_limit(moves in prop::collection::vec((0usize..6, 0u64..2000, 0u32..400), 1..300)) {
            let limits = PowerLimits { motor: 2_000, rail: 5_000, ..PAPER.no_limits() };
            let mut account = OnTime::new(&PAPER, Tick(0));
            account.set_limits(limits, &PAPER);
            let (mut now, mut passed, mut bursts, mut heights) = (0, 0, std::vec::Vec::new(), [0_u32; 6]);
            // In the end all pins come down.
            let ends = (0..6).map(|motor| (motor, 0, 0));
            for (motor, wait, level) in moves.into_iter().chain(ends) {
                now += wait;
                pass(&mut account, &mut passed, now);
                let (height, pulses) = (heights[motor], level.abs_diff(heights[motor]));
                if level > height {
                    let back = [level, heights.iter().sum::<u32>() + pulses];
                    if let Err(reason) = account.begin(motor, pulses, back, &PAPER) {
                        // A burst counts until a second, a bucket of 15 ms and a block after its end.
                        let recent = bursts.iter().filter(|&&(_, _, end)| end + 86_335 > now);
                        let of = |&&(of, _, _): &&(usize, u64, u64)| reason == Refusal::RailOnTime || of == motor;
                        let played: u64 = recent.filter(of).map(|&(_, from, end)| end - from).sum();
                        let (back, limit) = match reason {
                            Refusal::MotorOnTime => (back[0], limits.motor),
                            reason => {
                                prop_assert_eq!(reason, Refusal::RailOnTime);
                                (back[1], limits.rail)
                            }
                        };
                        prop_assert!(played + u64::from(pulses + back) > limit.into(), "refused without need");
                        continue;
                    }
                } else {
                    account.pulses.count(motor, pulses);
                }
                heights[motor] = level;
                bursts.push((motor, now, now + u64::from(pulses)));
                now += u64::from(pulses);
                pass(&mut account, &mut passed, now);
                account.pulses.end(motor, pulses, pulses);
            }
            for &(_, _, end) in &bursts {
                let mut second = [0; 6];
                for &(motor, from, to) in &bursts {
                    second[motor] += to.min(end).saturating_sub(from.max(end.saturating_sub(85_000)));
                }
                prop_assert!(second.iter().all(|&pulses| pulses <= limits.motor.into()));
                prop_assert!(second.iter().sum::<u64>() <= limits.rail.into());
            }
        }
    }
}
