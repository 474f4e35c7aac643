//! Finds the clocks with which a Pico makes a carrier and its duties exactly.
//!
//! The PLL makes the system clock from the crystal; a tick has a whole number of its cycles. A tick is four words of the PIO, each 1 to
//! 32 PIO cycles long, and a PIO cycle is a whole number of system cycles: lines with an up pulse fall after the first word, those
//! with a down pulse after the second.

/// The Pico's crystal, Hz.
const CRYSTAL_HZ: u64 = 12_000_000;
/// What the PLL's oscillator may make, Hz, and its divider in the feedback.
const OSCILLATOR_HZ: std::ops::RangeInclusive<u64> = 750_000_000..=1_600_000_000;
const FEEDBACK: std::ops::RangeInclusive<u64> = 16..=320;
/// The slowest system clock, Hz: USB needs at least its own 48 MHz. And the fastest.
const SLOWEST_HZ: u64 = 48_000_000;
const FASTEST_HZ: u64 = 133_000_000;
/// The fewest system cycles per tick: what rendering, USB and the supervision of the waveform take was measured with so many, and
/// with no fewer.
pub(crate) const LEAST_CYCLES: u64 = 1_500;
/// Most PIO cycles of a word.
const WORD: u64 = 32;
/// PIO cycles that an up pulse should have: where the firmware reads which word is on the pins, it is wrong by one cycle at most.
const UP_PULSE: u64 = 5;
/// Carriers of an array, Hz.
const CARRIERS: std::ops::RangeInclusive<u64> = 20_000..=200_000;
/// Ticks of a block (`firmware_protocol::controller::BLOCK`).
const BLOCK: u64 = 16;

/// Clocks that make a carrier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Clock {
    /// Times the crystal: the PLL's oscillator.
    pub(crate) feedback: u64,
    /// It divides the oscillator by both.
    pub(crate) post: [u64; 2],
    /// System cycles per tick.
    pub(crate) cycles: u64,
    /// System cycles per PIO cycle.
    pub(crate) divider: u64,
    /// PIO cycles of each word.
    pub(crate) words: [u64; 4],
}

/// The clocks for a carrier and the duties of an up and of a down pulse, in 1/1000 of a tick: the fastest system clock.
///
/// # Errors
/// One line that says what the chip cannot make, and the nearest that it can.
pub(crate) fn exact(tick_hz: u32, duty: [u16; 2]) -> Result<Clock, String> {
    let tick_hz = u64::from(tick_hz);
    if let Some(clock) = find(tick_hz, duty) {
        return Ok(clock);
    }
    let [up, down] = duty.map(|share| f64::from(share) / 1e3);
    let mut line = format!(
        "a Pico cannot make a carrier of {tick_hz} Hz with duties of {up} and {down} exactly, with a system clock of {} to {} MHz and \
         at least {LEAST_CYCLES} of its cycles per tick",
        SLOWEST_HZ / 1_000_000,
        FASTEST_HZ / 1_000_000
    );
    let mut nearest = Vec::new();
    if let Some(carrier) = nearest_carrier(tick_hz, duty) {
        nearest.push(format!("the nearest carrier with these duties is {carrier} Hz"));
    }
    if let Some([up, down]) = nearest_duties(tick_hz, duty) {
        let [up, down] = [up, down].map(|share| f64::from(share) / 1e3);
        nearest.push(format!("the nearest duties at this carrier are {up} and {down}"));
    }
    if nearest.is_empty() {
        let other =
            duties_near(duty).into_iter().find_map(|duty| Some((nearest_carrier(tick_hz, duty)?, duty)));
        if let Some((carrier, duty)) = other {
            let [up, down] = duty.map(|share| f64::from(share) / 1e3);
            nearest.push(format!("the nearest is {carrier} Hz with duties of {up} and {down}"));
        }
    }
    if !nearest.is_empty() {
        line += ": ";
        line += &nearest.join("; ");
    }
    Err(line)
}

fn find(tick_hz: u64, duty: [u16; 2]) -> Option<Clock> {
    let lengths = lengths(duty);
    clocks(tick_hz).find_map(|(feedback, post, cycles)| {
        let length = best(lengths.iter().copied().filter(|&length| cycles.is_multiple_of(length)), duty)?;
        Some(Clock { feedback, post, cycles, divider: cycles / length, words: words(length, duty)? })
    })
}

/// The settings of the PLL that make a carrier, and the system cycles of its tick.
fn clocks(tick_hz: u64) -> impl Iterator<Item = (u64, [u64; 2], u64)> {
    settings().into_iter().filter_map(move |(oscillator, feedback, post)| {
        let parts = post[0] * post[1] * tick_hz;
        let cycles = oscillator / parts;
        (oscillator.is_multiple_of(parts) && is_possible(cycles)).then_some((feedback, post, cycles))
    })
}

/// Whether the firmware is fast enough with so many cycles of a tick, and counts them exactly.
fn is_possible(cycles: u64) -> bool {
    cycles >= LEAST_CYCLES && divides_exactly(cycles)
}

/// All settings of the PLL: oscillator, feedback, dividers. Those with the fastest system clock first, and among these those with the
/// fastest oscillator, which has the least jitter.
fn settings() -> Vec<(u64, u64, [u64; 2])> {
    let mut settings = Vec::new();
    for feedback in FEEDBACK {
        let oscillator = CRYSTAL_HZ * feedback;
        for first in 1..=7 {
            for second in 1..=first {
                let product = first * second;
                let in_range = (SLOWEST_HZ * product..=FASTEST_HZ * product).contains(&oscillator);
                if OSCILLATOR_HZ.contains(&oscillator) && in_range {
                    settings.push((oscillator, feedback, [first, second]));
                }
            }
        }
    }
    let order = |&(oscillator, _, [first, second]): &(u64, u64, [u64; 2])| {
        // The clock as a fraction of 420 Hz steps: all products of two dividers divide 7! squared.
        (oscillator * (5_040 * 5_040) / (first * second), oscillator, first)
    };
    settings.sort_by_key(|setting| std::cmp::Reverse(order(setting)));
    settings
}

/// The PIO cycles that a tick may have for these duties.
fn lengths(duty: [u16; 2]) -> Vec<u64> {
    (4..=4 * WORD).filter(|&length| words(length, duty).is_some()).collect()
}

/// The words of a tick of so many PIO cycles, if these duties are whole numbers of them.
fn words(length: u64, duty: [u16; 2]) -> Option<[u64; 4]> {
    let share = |thousandths: u16| {
        let cycles = length * u64::from(thousandths);
        cycles.is_multiple_of(1_000).then_some(cycles / 1_000)
    };
    let (up, down) = (share(duty[0])?, share(duty[1])?);
    let low = length.checked_sub(down)?;
    let words = [up, down.checked_sub(up)?, low.div_ceil(2), low / 2];
    words.iter().all(|word| (1..=WORD).contains(word)).then_some(words)
}

/// The shortest tick in which an up pulse has [`UP_PULSE`] PIO cycles; without one, the longest.
fn best(lengths: impl Iterator<Item = u64>, duty: [u16; 2]) -> Option<u64> {
    let mut longest = None;
    for length in lengths {
        if length * u64::from(duty[0]) >= UP_PULSE * 1_000 {
            return Some(length);
        }
        longest = Some(length);
    }
    longest
}

/// Whether the firmware divides by so many cycles of a tick exactly (`RECIPROCAL` in `src/wave.rs`).
fn divides_exactly(cycles: u64) -> bool {
    let shift = 27;
    let reciprocal = (1_u64 << shift).div_ceil(cycles);
    (1..=BLOCK).all(|ticks| {
        let begin = ticks * cycles;
        let product = begin * reciprocal;
        product <= u64::from(u32::MAX)
            && product >> shift == ticks
            && ((begin - 1) * reciprocal) >> shift == ticks - 1
    })
}

fn nearest_carrier(tick_hz: u64, duty: [u16; 2]) -> Option<u64> {
    let lengths = lengths(duty);
    let mut nearest: Option<u64> = None;
    for (oscillator, _, [first, second]) in settings() {
        let most = oscillator / (first * second * CARRIERS.start());
        for cycles in LEAST_CYCLES..=most {
            let parts = first * second * cycles;
            let carrier = oscillator / parts;
            if oscillator.is_multiple_of(parts)
                && nearest.is_none_or(|nearest| carrier.abs_diff(tick_hz) < nearest.abs_diff(tick_hz))
                && lengths.iter().any(|&length| cycles.is_multiple_of(length))
                && is_possible(cycles)
            {
                nearest = Some(carrier);
            }
        }
    }
    nearest
}

fn nearest_duties(tick_hz: u64, duty: [u16; 2]) -> Option<[u16; 2]> {
    let mut cycles: Vec<_> = clocks(tick_hz).map(|(_, _, cycles)| cycles).collect();
    cycles.dedup();
    let exact = |length: u64| cycles.iter().any(|cycles| cycles.is_multiple_of(length));
    if cycles.is_empty() {
        None
    } else {
        duties_near(duty).into_iter().find(|&duty| lengths(duty).into_iter().any(exact))
    }
}

/// All duties that some tick has and a description may have, the nearest first.
fn duties_near(duty: [u16; 2]) -> Vec<[u16; 2]> {
    let mut all = Vec::new();
    for length in 4..=4 * WORD {
        for up in 1..=WORD.min(length - 1) {
            for down in up + 1..length {
                let share =
                    |cycles: u64| (cycles * 1_000).is_multiple_of(length).then_some(cycles * 1_000 / length);
                if let (Some(up @ ..500), Some(down @ 501..)) = (share(up), share(down)) {
                    all.push([up as u16, down as u16]);
                }
            }
        }
    }
    all.sort_by_key(|&[up, down]| (up.abs_diff(duty[0]) + down.abs_diff(duty[1]), up, down));
    all.dedup();
    all
}
