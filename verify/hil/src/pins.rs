//! Records the chip's pins to the cycle: level changes in, pulses of each line out.
//!
//! It neither judges nor rounds. Pulses of one width that rise exactly a tick apart form one [`PinTrain`], so an hour of clean
//! pulses is short, and each flaw is a train of its own.

use crate::time::TICK;
use meissner_test_support::paper::MOTORS;

/// Rises at a play's onset.
pub const TRIGGER: usize = 27;
/// The drivers' supply.
pub const ENABLE: usize = 28;
/// Shows what [`ENABLE`] does.
pub const LED: usize = 25;
const PINS: usize = 30;
/// An input that the board feeds from the cable's 5 V (GP24).
const VBUS_SENSE: u32 = 1 << 24;

/// The pin of a line. The board uses GP23 to GP25 itself, so line 23 is on GP26.
pub const fn pin_of(line: usize) -> usize {
    if line < 23 { line } else { line + 3 }
}

const fn line_of(pin: usize) -> Option<usize> {
    match pin {
        0..=22 => Some(pin),
        26 => Some(23),
        _ => None,
    }
}

/// Pulses of one width, each a tick after the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PinTrain {
    /// Cycle at which the first rises.
    pub cycle: u64,
    /// Cycles for which each is high.
    pub width: u64,
    /// Their number.
    pub pulses: u64,
}

impl PinTrain {
    /// Cycle at which the last falls.
    pub const fn end(&self) -> u64 {
        self.cycle + (self.pulses - 1) * TICK + self.width
    }
}

/// An interval in which a pin was high. It ends at `u64::MAX` while the pin still is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct High {
    /// Cycle at which it rose.
    pub from: u64,
    /// Cycle at which it fell.
    pub to: u64,
}

/// The pins of one boot.
#[derive(Clone, Debug)]
pub struct Pins {
    levels: u32,
    rises: [u64; PINS],
    /// Per line.
    pub lines: [Vec<PinTrain>; MOTORS],
    /// GP27.
    pub trigger: Vec<High>,
    /// GP28.
    pub enable: Vec<High>,
    /// GP25.
    pub led: Vec<High>,
    /// Pins that rose and are not outputs.
    pub strays: Vec<(usize, u64)>,
}

impl Default for Pins {
    fn default() -> Self {
        Self {
            levels: 0,
            rises: [0; PINS],
            lines: Default::default(),
            trigger: Vec::new(),
            enable: Vec::new(),
            led: Vec::new(),
            strays: Vec::new(),
        }
    }
}

impl Pins {
    /// Records the levels of the pins from `cycle` on.
    pub fn change(&mut self, cycle: u64, levels: u32) {
        let mut changed = (self.levels ^ levels) & !VBUS_SENSE;
        self.levels = levels;
        while changed != 0 {
            let pin = changed.trailing_zeros() as usize;
            changed &= changed - 1;
            if pin >= PINS {
                continue;
            }
            let high = levels >> pin & 1 == 1;
            match (line_of(pin), self.highs(pin)) {
                (Some(_), _) if high => self.rises[pin] = cycle,
                (Some(line), _) => self.pulse(line, self.rises[pin], cycle),
                (None, Some(highs)) if high => highs.push(High { from: cycle, to: u64::MAX }),
                (None, Some(highs)) => {
                    if let Some(last) = highs.last_mut() {
                        last.to = cycle;
                    }
                }
                (None, None) if high => self.strays.push((pin, cycle)),
                (None, None) => {}
            }
        }
    }

    fn highs(&mut self, pin: usize) -> Option<&mut Vec<High>> {
        match pin {
            TRIGGER => Some(&mut self.trigger),
            ENABLE => Some(&mut self.enable),
            LED => Some(&mut self.led),
            _ => None,
        }
    }

    fn pulse(&mut self, line: usize, rise: u64, fall: u64) {
        let width = fall - rise;
        match self.lines[line].last_mut() {
            Some(last) if last.width == width && last.cycle + last.pulses * TICK == rise => last.pulses += 1,
            _ => self.lines[line].push(PinTrain { cycle: rise, width, pulses: 1 }),
        }
    }

    /// A line that is high now, and since which cycle. No pulse lasts longer than a tick.
    pub fn still_high(&self) -> Option<(usize, u64)> {
        (0..MOTORS)
            .map(|line| (line, pin_of(line)))
            .find_map(|(line, pin)| (self.levels >> pin & 1 == 1).then_some((line, self.rises[pin])))
    }

    /// Cycle of the first rise of all lines.
    pub fn first(&self) -> Option<u64> {
        self.lines.iter().filter_map(|line| line.first()).map(|train| train.cycle).min()
    }

    /// Cycle at which the last pulse that rose before `before` has fallen.
    pub fn low_since(&self, before: u64) -> Option<u64> {
        let ends = self.lines.iter().flatten().filter(|train| train.cycle < before).map(|train| {
            let rises = (before - 1 - train.cycle) / TICK + 1;
            PinTrain { pulses: train.pulses.min(rises), ..*train }.end()
        });
        ends.max()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pulses_of_a_tick_are_one_train_and_a_flaw_is_its_own() {
        let mut pins = Pins::default();
        for rise in [1_000, 2_500, 4_000, 5_501] {
            pins.change(rise, 1 << 26);
            pins.change(rise + 300, 0);
        }
        let clean = PinTrain { cycle: 1_000, width: 300, pulses: 3 };
        assert_eq!(pins.lines[23], [clean, PinTrain { cycle: 5_501, width: 300, pulses: 1 }]);
        assert_eq!((clean.end(), pins.first()), (4_300, Some(1_000)));
        assert_eq!((pins.low_since(2_501), pins.low_since(u64::MAX)), (Some(2_800), Some(5_801)));
    }

    #[test]
    fn trigger_enable_and_strays_are_kept_apart() {
        let mut pins = Pins::default();
        pins.change(10, 1 << 28 | 1 << 25);
        pins.change(20, 1 << 28 | 1 << 27 | 1 << 23);
        pins.change(30, 1 << 5);
        assert_eq!(pins.enable, [High { from: 10, to: 30 }]);
        assert_eq!(
            (&pins.led[..], &pins.trigger[..]),
            (&[High { from: 10, to: 20 }][..], &[High { from: 20, to: 30 }][..])
        );
        assert_eq!((pins.strays, pins.lines[5].len()), (vec![(23, 20)], 0));
    }
}
