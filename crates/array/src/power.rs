//! How many motors have pulses at once, and the current that they draw.
//!
//! [`PulsingMotors`] takes strokes in the order of their up ticks and counts, per rail and driver chip, the motors that have pulses
//! in the same tick. [`current_ma`] is the current that one motor draws from its 30 V rail while it has pulses.
//!
//! Invariant: counts are exact in every tick; of two bursts that touch, the first has ended when the second begins.

use crate::spec::{Array, ArraySpec};
use crate::strokes::{Step, Strokes};
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::tick::Tick;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// The supply of a rail, V.
const RAIL_V: f64 = 30.0;
/// Default capacitance of a motor, nF. It yields the 50 mA that the LT3572's typical application needs at 30 V for two motors at 70
/// kHz.
pub const CAPACITANCE_NF: f64 = 3.0;
/// How much of a play [`rail_pulses`] counts, s.
pub const SHOWN_S: u64 = 10;

/// Mean current of a motor with pulses, mA. Its bridge reverses the voltage twice in a period, and the rail supplies the charge
/// 2·C·V each time, so I = 4·C·V·f.
pub fn current_ma(array: Array, capacitance_nf: f64) -> f64 {
    4.0 * capacitance_nf * 1e-9 * RAIL_V * f64::from(array.rate().hz()) * 1e3
}

/// Motors that share a supply or a driver chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// The motors of a supply.
    Rail(u8),
    /// The motors of a driver chip.
    Chip(u8),
}

impl Group {
    /// Its motors.
    ///
    /// # Panics
    /// If the array has no such group.
    pub fn motors(self, array: &ArraySpec) -> &[u8] {
        let (groups, number) = match self {
            Self::Rail(number) => (array.rails(), number),
            Self::Chip(number) => (array.chips(), number),
        };
        &groups.members()[usize::from(number)]
    }

    /// Its name, its number and its motors in words: `rail 0 (motors 0 to 5)`.
    ///
    /// # Panics
    /// If the array has no such group.
    pub fn in_words(self, array: &ArraySpec) -> String {
        let (name, number) = match self {
            Self::Rail(number) => ("rail", number),
            Self::Chip(number) => ("driver chip", number),
        };
        let motors = self.motors(array);
        let list = || motors.iter().map(u8::to_string).collect::<Vec<_>>().join(", ");
        let motors = match motors {
            [motor] => format!("motor {motor}"),
            [first, .., last] if motors.windows(2).all(|pair| pair[0] + 1 == pair[1]) => {
                format!("motors {first} to {last}")
            }
            _ => format!("motors {}", list()),
        };
        format!("{name} {number} ({motors})")
    }
}

/// A tick in which more motors have pulses than the limits allow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooMany {
    /// The rail or chip.
    pub group: Group,
    /// The first such tick.
    pub tick: u64,
    /// How many have pulses then.
    pub at_once: u8,
}

/// Pulses of a rail.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RailPulses {
    /// Most motors that have pulses in the same tick.
    pub most_at_once: u8,
    /// The first tick in which that is so.
    pub at: u64,
    /// Pulses of all its motors.
    pub pulses: u64,
}

/// See the module.
#[derive(Clone, Debug)]
pub struct PulsingMotors {
    array: Array,
    limits: PowerLimits,
    /// Future starts and ends of bursts: tick, whether a burst starts, motor.
    edges: BinaryHeap<Reverse<(u64, bool, u8)>>,
    rails: Vec<RailPulses>,
    on_rail: Vec<u8>,
    on_chip: Vec<u8>,
    too_many: Option<TooMany>,
}

impl PulsingMotors {
    /// A count without strokes. [`Self::too_many`] compares with these limits.
    pub fn new(array: Array, limits: PowerLimits) -> Self {
        Self {
            array,
            limits,
            edges: BinaryHeap::new(),
            rails: vec![RailPulses::default(); array.rails().count()],
            on_rail: vec![0; array.rails().count()],
            on_chip: vec![0; array.chips().count()],
            too_many: None,
        }
    }

    /// Takes the next step.
    ///
    /// # Panics
    /// If the array has no such motor.
    pub fn push(&mut self, step: &Step) {
        // No later step begins before this one.
        self.pass(step.begin().0);
        for burst in step.bursts() {
            self.edges.push(Reverse((burst.start.0, true, step.motor())));
            self.edges.push(Reverse((burst.end().0, false, step.motor())));
        }
        self.rails[self.array.rails().of(step.motor())].pulses += u64::from(step.pulses());
    }

    /// Counts what begins and ends before `tick`.
    fn pass(&mut self, tick: u64) {
        while let Some(&Reverse((at, begins, motor))) = self.edges.peek()
            && at < tick
        {
            self.edges.pop();
            let (rail, chip) = (self.array.rails().of(motor), self.array.chips().of(motor));
            if !begins {
                self.on_rail[rail] -= 1;
                self.on_chip[chip] -= 1;
                continue;
            }
            self.on_rail[rail] += 1;
            self.on_chip[chip] += 1;
            let at_once = self.on_rail[rail];
            if at_once > self.rails[rail].most_at_once {
                (self.rails[rail].most_at_once, self.rails[rail].at) = (at_once, at);
            }
            let too_many =
                |group, at_once, most| (at_once > most).then_some(TooMany { group, tick: at, at_once });
            self.too_many = self
                .too_many
                .or(too_many(Group::Rail(rail as u8), at_once, self.limits.rail_at_once))
                .or(too_many(Group::Chip(chip as u8), self.on_chip[chip], self.limits.chip_at_once));
        }
    }

    /// The first tick that breaks the limits. All ticks before the last stroke's up tick have been counted.
    pub const fn too_many(&self) -> Option<TooMany> {
        self.too_many
    }

    /// Counts the rest; returns the pulses of each rail, and the first tick that breaks the limits.
    pub fn finish(mut self) -> (Vec<RailPulses>, Option<TooMany>) {
        self.pass(u64::MAX);
        (self.rails, self.too_many)
    }
}

impl RailPulses {
    /// Mean over `ticks` of the number of motors that have pulses.
    pub fn mean_at_once(&self, ticks: u64) -> f64 {
        if ticks == 0 { 0.0 } else { self.pulses as f64 / ticks as f64 }
    }
}

/// The pulses of each rail in the first [`SHOWN_S`] of these strokes, or up to their end, and the number of ticks covered.
pub fn rail_pulses(strokes: &Strokes) -> (Vec<RailPulses>, u64) {
    let mut strokes = strokes.clone();
    strokes.begin(Tick(0));
    let most = SHOWN_S * strokes.array().rate().per_s();
    let ticks = strokes.end().unwrap_or(most).min(most);
    let mut motors = PulsingMotors::new(strokes.array(), strokes.array().layout().no_limits());
    for step in strokes.map_while(Result::ok).take_while(|step| step.begin().0 < ticks) {
        motors.push(&step);
    }
    (motors.finish().0, ticks)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::strokes::Stroke;
    use proptest::prelude::*;

    #[test]
    fn a_motor_of_3_nf_draws_31_ma() {
        // 4 · 3 nF · 30 V · 85 kHz.
        assert!((current_ma(Array::paper(), 3.0) - 30.6).abs() < 1e-9);
        assert!(
            (current_ma(Array::paper(), 7.0) - 71.4).abs() < 1e-9
                && (current_ma(Array::paper(), 20.0) - 204.0).abs() < 1e-9
        );
        // Two motors at the 70 kHz of the typical application: 50 mA.
        let typical_ma = 2.0 * current_ma(Array::paper(), CAPACITANCE_NF) * 70.0 / 85.0;
        assert!((typical_ma - 50.0).abs() < 1.0, "{typical_ma}");
    }

    proptest! {
        /// Compared with a plain count per tick.
        #[test]
        fn counts_are_those_of_every_tick(
            sent in prop::collection::vec((0u8..24, 0u64..40, 1u16..60, 0u64..90), 1..60),
            rail_at_once in 1u8..=6,
            chip_at_once in 1u8..=2,
        ) {
            let limits = PowerLimits { rail_at_once, chip_at_once, ..Array::paper().layout().no_limits() };
            let (mut up, mut free) = (0, [0; 24]);
            let mut strokes = Vec::new();
            for (motor, after, pulses, hold) in sent {
                up += after;
                let from: u64 = up.max(free[usize::from(motor)]);
                let down = Tick(from + u64::from(pulses) + hold);
                let stroke = Stroke { motor, up: Tick(from), up_pulses: pulses, down, down_pulses: pulses };
                free[usize::from(motor)] = stroke.end().0;
                strokes.push(stroke);
            }
            strokes.sort_by_key(|stroke| (stroke.up, stroke.motor));
            let mut counted = PulsingMotors::new(Array::paper(), limits);
            strokes.iter().for_each(|stroke| counted.push(&(*stroke).into()));
            let (rails, too_many) = counted.finish();
            let end = strokes.iter().map(|stroke| stroke.end().0).max().unwrap_or(0);
            let (mut most, mut first) = ([0; 4], None);
            for tick in 0..end {
                let on = |motors: std::ops::Range<u8>| strokes.iter().filter(|stroke| motors.contains(&stroke.motor)
                    && stroke.bursts().iter().any(|burst| (burst.start.0..burst.end().0).contains(&tick))).count() as u8;
                for rail in 0..4_u8 {
                    most[usize::from(rail)] = on(6 * rail..6 * rail + 6).max(most[usize::from(rail)]);
                }
                let breaks = (0..4_u8).any(|rail| on(6 * rail..6 * rail + 6) > rail_at_once)
                    || (0..12_u8).any(|chip| on(2 * chip..2 * chip + 2) > chip_at_once);
                first = first.or(breaks.then_some(tick));
            }
            prop_assert_eq!(rails.iter().map(|rail| rail.most_at_once).collect::<Vec<_>>(), most);
            prop_assert_eq!(too_many.map(|found| found.tick), first);
            let pulses: u64 = strokes.iter().map(|stroke| u64::from(stroke.pulses())).sum();
            prop_assert_eq!(rails.iter().map(|rail| rail.pulses).sum::<u64>(), pulses);
        }
    }
}
