//! The calibration plan: which bursts are played, with how many pulses, in which order, when.
//!
//! [`Plan::pattern`] is what the streamer plays, open loop; [`Plan::bursts`] lists the same bursts for the measurement.
//!
//! A group is one warm-up stroke, then [`STROKES_PER_GROUP`] measured strokes of the same number of pulses, an eighth of a
//! second from burst to burst. The warm-up stroke is the first after a longer rest and comes out short
//! (the transient of the paper's Fig. 2), so the fit leaves it out. In each round every number of pulses has one group.
//! Neighbouring groups have distant numbers, and every other round runs backwards: a motor that slowly changes then changes
//! for all numbers alike, and the slope does not absorb the change. Motors play side by side, but no two pulse at once.
//!
//! Invariant: before a measured burst its motor has settled, and has rested for less than an eighth of a second. An array whose motors
//! settle later, or whose bursts are transients after such a rest, has no plan.

use firmware_protocol::tick::Tick;
use meissner_array::pattern::{Drive, MAX_DRIVES, Pattern};
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_array::strokes::Burst;
use meissner_array::strokes::{StrokeOptions, Strokes};
use std::ops::RangeInclusive;

/// Most pulses of a burst, on any array.
const MOST_PULSES: u16 = 200;
/// Default numbers of pulses.
const DEFAULT_NUMBERS: u16 = 10;
/// The longest default burst moves a pin by so much, µm, but by no more than a fifth of the travel: shorter ones drown in what a sensor
/// cannot resolve. On the paper's array these are 140 pulses.
const FARTHEST_UM: f64 = 20.0;
/// Default rounds: they take a minute and give gains to about 1 %.
pub const DEFAULT_REPETITIONS: u16 = 2;
/// Groups of a plan at most: five minutes. A plan of many motors has fewer, so that it is still a pattern.
pub const MAX_GROUPS: usize = 100;
/// Measured strokes of a group. More strokes give better slopes from fewer groups; but a pin whose directions differ by 2 %
/// drifts by 0.2 µm a stroke, and by 2 µm with each transient.
pub const STROKES_PER_GROUP: usize = 9;
/// From group to group, s.
pub const GROUP_S: f64 = 3.0;
/// Within this time after its beginning a group plays all its bursts, s; then the motor rests.
const PLAYED_S: f64 = 2.5;
/// Strokes per second: [`PLAYED_S`] holds a whole group, and between bursts the pin rests for 28 times the motor's window.
const FREQUENCY_HZ: f64 = 4.0;
/// The same of bursts.
const BURSTS_PER_S: u64 = 2 * FREQUENCY_HZ as u64;

/// Pulses that a burst of a plan of one motor may have on this array: at least those for which a motor's travel per pulse is known, at
/// most so many that the amplitude is allowed, and 200.
pub fn pulses_range(array: Array) -> RangeInclusive<u16> {
    range_of(array, 1)
}

/// The same for a plan of so many motors, no two of which pulse at once.
fn range_of(array: Array, motors: usize) -> RangeInclusive<u16> {
    let motor = array.motor();
    // From the up burst of one motor to that of the next: see `Plan::pattern`.
    let apart = f64::from(array.rate().hz()) / FREQUENCY_HZ / (2.0 * motors as f64);
    let most = apart.min(motor.pulses(motor.travel_um)).min(MOST_PULSES.into());
    motor.least_pulses..=most as u16
}

/// Pulses that move a pin of this array by [`FARTHEST_UM`] or a fifth of its travel.
pub(super) fn farthest_pulses(array: Array) -> u16 {
    let motor = array.motor();
    // The cast saturates.
    motor.pulses(FARTHEST_UM.min(motor.travel_um / 5.0)) as u16
}

/// The default numbers of pulses: up to [`FARTHEST_UM`], or twenty times the fewest, if bursts may be so long. On the paper's array they
/// are from a fifth of the paper's 70 to twice it. A wide range makes the slope more certain: with 30 to 110 its error would be 2.4
/// times that of a line through the origin, with these it is 1.5 times.
fn default_pulses(array: Array, motors: usize) -> Vec<u16> {
    let range = range_of(array, motors);
    let step = range.start().saturating_mul(2).max(farthest_pulses(array) / DEFAULT_NUMBERS);
    let step = step.min(range.end() / DEFAULT_NUMBERS).max(1);
    (1..=DEFAULT_NUMBERS).map(|number| number * step).filter(|pulses| range.contains(pulses)).collect()
}

/// A plan that no calibration can be made with.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// No such motor.
    #[error("motor {found}: must be {}", .array.motor_range())]
    Motor {
        /// As asked for.
        found: u8,
        /// The plan's array.
        array: Array,
    },
    /// Too few or too many pulses.
    #[error("bursts of {found} pulses: must be {least} to {most}")]
    Pulses {
        /// As asked for.
        found: u16,
        /// The fewest.
        least: u16,
        /// The most.
        most: u16,
    },
    /// Every burst of a plan would be a transient.
    #[error(
        "`motor.transient.rest_s` of the array {} must be above 1/{BURSTS_PER_S} s: the bursts of a calibration are so far \
         apart, and each would be a transient", .array.name()
    )]
    Transients {
        /// The plan's array.
        array: Array,
    },
    /// A slope needs two numbers of pulses.
    #[error("one number of pulses gives no slope: name two numbers of pulses or more")]
    OneNumber,
    /// A number of pulses is listed twice.
    #[error("bursts of {found} pulses are listed twice: leave one out")]
    Twice {
        /// The number.
        found: u16,
    },
    /// No repetition, or too many groups in all.
    #[error("{found} repetitions: must be 1 to {most}, so that there are at most {groups} groups")]
    Repetitions {
        /// As asked for.
        found: u16,
        /// Most repetitions for this many numbers of pulses.
        most: usize,
        /// Most groups for this many motors.
        groups: usize,
    },
}

/// The bursts that a calibration plays.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    array: Array,
    motor: Option<u8>,
    pulses: Vec<u16>,
    repetitions: u16,
}

impl Plan {
    /// The default plan: all motors of this array.
    ///
    /// # Errors
    /// If its bursts have no room for two numbers of pulses.
    pub fn of(array: Array) -> Result<Self, PlanError> {
        Self::with_defaults(array, None, None, None)
    }

    /// A plan for one motor of this array, or all, with these numbers of pulses and repetitions or the defaults.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_defaults(
        array: Array,
        motor: Option<u8>,
        pulses: Option<&[u16]>,
        repetitions: Option<u16>,
    ) -> Result<Self, PlanError> {
        let default = default_pulses(array, motor.map_or(array.motors(), |_| 1));
        Self::new(array, motor, pulses.unwrap_or(&default), repetitions.unwrap_or(DEFAULT_REPETITIONS))
    }

    /// A plan for one motor of this array, or all, with bursts of these numbers of pulses, each in `repetitions` groups.
    ///
    /// # Errors
    /// The first thing that is wrong, in one line.
    pub fn new(array: Array, motor: Option<u8>, pulses: &[u16], repetitions: u16) -> Result<Self, PlanError> {
        if let Some(found) = motor.filter(|&motor| !array.has(motor)) {
            return Err(PlanError::Motor { found, array });
        }
        let motors = motor.map_or(array.motors(), |_| 1);
        let range = range_of(array, motors);
        if let Some(&found) = pulses.iter().find(|pulses| !range.contains(pulses)) {
            return Err(PlanError::Pulses { found, least: *range.start(), most: *range.end() });
        }
        if pulses.len() < 2 {
            return Err(PlanError::OneNumber);
        }
        let twice = (1..pulses.len()).find(|&n| pulses[..n].contains(&pulses[n]));
        if let Some(n) = twice {
            return Err(PlanError::Twice { found: pulses[n] });
        }
        let spec = array.motor();
        let apart = array.rate().per_s() / BURSTS_PER_S;
        if spec.transient_rest_ticks <= apart {
            return Err(PlanError::Transients { array });
        }
        let groups = MAX_GROUPS.min(MAX_DRIVES / motors);
        let most = groups / pulses.len();
        if !(1..=most).contains(&repetitions.into()) {
            return Err(PlanError::Repetitions { found: repetitions, most, groups });
        }
        Ok(Self { array, motor, pulses: pulses.to_vec(), repetitions })
    }

    /// The array that it calibrates.
    pub const fn array(&self) -> Array {
        self.array
    }

    /// The motors it calibrates.
    pub fn motors(&self) -> impl Iterator<Item = u8> + use<> {
        let of = self.motor;
        self.array.numbers().filter(move |&motor| of.is_none_or(|of| motor == of))
    }

    /// Its numbers of pulses.
    pub fn pulses(&self) -> &[u16] {
        &self.pulses
    }

    /// Groups of each number.
    pub const fn repetitions(&self) -> u16 {
        self.repetitions
    }

    /// Groups of each motor.
    pub fn groups(&self) -> usize {
        self.pulses.len() * usize::from(self.repetitions)
    }

    /// How long it plays, s.
    pub fn duration_s(&self) -> f64 {
        self.groups() as f64 * GROUP_S
    }

    /// The number of pulses of each group, in the order they are played.
    fn order(&self) -> impl Iterator<Item = u16> {
        // Steps of the golden section: each number is far from the one before.
        let place = |n: usize| (n as f64 * 0.618_034).fract();
        let mut order: Vec<usize> = (0..self.pulses.len()).collect();
        order.sort_by(|&a, &b| place(a).total_cmp(&place(b)));
        (0..self.groups()).map(move |group| {
            let (round, n) = (group / order.len(), group % order.len());
            let n = if round % 2 == 0 { n } else { order.len() - 1 - n };
            self.pulses[order[n]]
        })
    }

    /// The plan as a pattern, to be played open loop.
    pub fn pattern(&self) -> Pattern {
        let groups = self.order().enumerate();
        let (spec, motors) = (self.array.motor(), self.array.motors() as f64);
        let drives = groups.flat_map(|(group, pulses)| {
            let start_s = group as f64 * GROUP_S;
            self.motors().map(move |motor| Drive {
                motor,
                frequency_hz: FREQUENCY_HZ,
                // The product may be rounded to above the travel.
                amplitude_um: (f64::from(pulses) * spec.um_per_pulse).min(spec.travel_um),
                // All up bursts lie in one half of the cycle, all down bursts in the other.
                phase: f64::from(motor) / (2.0 * motors),
                start_s: Some(start_s),
                stop_s: Some(start_s + PLAYED_S),
            })
        });
        Pattern::new(self.array, "calibration", Some(self.duration_s()), drives.collect(), toml::Table::new())
            .expect("a checked plan is a pattern")
    }

    /// Its bursts if it begins at `onset`, in the order of their strokes.
    pub fn bursts(&self, onset: Tick) -> impl Iterator<Item = PlannedBurst> + use<> {
        let mut strokes =
            Strokes::new(&self.pattern(), &StrokeOptions::default()).expect("a plan's drives can be played");
        strokes.begin(onset);
        let mut played = PerMotor::all(self.array, 0_usize);
        strokes.flat_map(move |step| {
            let step = step.expect("a plan's strokes are within the limits");
            let motor = step.motor();
            let played = &mut played[usize::from(motor)];
            let warm_up = played.is_multiple_of(1 + STROKES_PER_GROUP);
            *played += 1;
            step.bursts().map(move |burst| PlannedBurst { motor, burst, warm_up })
        })
    }
}

/// A burst of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlannedBurst {
    /// Its motor.
    pub motor: u8,
    /// The burst; the pin rests when it begins.
    pub burst: Burst,
    /// Whether it belongs to a group's warm-up stroke.
    pub warm_up: bool,
}

impl PlannedBurst {
    /// When the pin of this array rests again: the motor's window after the last pulse.
    pub fn rests_at(&self, array: Array) -> Tick {
        self.burst.end() + array.motor().settled_ticks()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::spec::names;

    #[test]
    fn an_invalid_plan_is_refused_in_one_line() {
        for (motor, pulses, repetitions, message) in [
            (Some(24), &[30, 70][..], 1, "motor 24: must be 0 to 23"),
            (None, &[30, 6], 1, "bursts of 6 pulses: must be 7 to 200"),
            (None, &[201, 30], 1, "bursts of 201 pulses: must be 7 to 200"),
            (None, &[70], 1, "one number of pulses gives no slope: name two numbers of pulses or more"),
            (None, &[], 1, "one number of pulses gives no slope: name two numbers of pulses or more"),
            (None, &[30, 70, 30], 1, "bursts of 30 pulses are listed twice: leave one out"),
            (None, &[30, 70], 0, "0 repetitions: must be 1 to 50, so that there are at most 100 groups"),
            (None, &[30, 50, 70], 34, "34 repetitions: must be 1 to 33"),
        ] {
            let line = Plan::new(Array::paper(), motor, pulses, repetitions).unwrap_err().to_string();
            assert!(line.starts_with(message) && !line.contains('\n'), "{line}");
        }
        let longest: Vec<u16> = pulses_range(Array::paper()).take(MAX_GROUPS).collect();
        assert_eq!(Plan::new(Array::paper(), None, &longest, 1).unwrap().pattern().drives().len(), 2400);
        let default = Plan::of(Array::paper()).unwrap();
        assert_eq!(default.pulses(), [14, 28, 42, 56, 70, 84, 98, 112, 126, 140]);
    }

    #[test]
    fn plans_of_every_array_play_one_motor_at_a_time() {
        let arrays = names().into_iter().map(|name| Array::named(name).unwrap());
        for array in arrays {
            let longest = *range_of(array, array.motors()).end();
            for plan in
                [Plan::of(array).unwrap(), Plan::new(array, None, &[longest, longest - 1], 1).unwrap()]
            {
                let mut bursts: Vec<Burst> = plan.bursts(Tick::BOOT).map(|planned| planned.burst).collect();
                assert_eq!(bursts.len(), 2 * 10 * plan.groups() * array.motors(), "{array:?}");
                bursts.sort_by_key(|burst| burst.start);
                let apart = |pair: &[Burst]| pair[0].end() <= pair[1].start;
                assert!(bursts.windows(2).all(apart), "{array:?}: {:?}", plan.pulses());
            }
        }
    }
}
