//! What is played to calibrate: which motors, how many pulses, in which order, when.
//!
//! A group is [`STROKES_PER_GROUP`] strokes of one number of pulses, an eighth of a second from burst to burst, after one more that
//! settles the motor: it is the first after more than half a second of rest, and comes out short (the transient of the
//! paper's Fig. 2). Each number has a group in each round. Neighbouring groups have distant numbers, and every other round
//! runs backwards: a motor that slowly changes then changes for all numbers alike, and the slope does not take it for
//! its own. Motors play side by side, but no two pulse at the same time.
//!
//! Invariant: before a measured burst its motor has not rested for half a second.

use super::BurstTravel;
use firmware_protocol::stroke::{Burst, Direction, MOTORS};
use firmware_protocol::tick::Tick;
use meissner_array::motor::WINDOW_TICKS;
use meissner_array::pattern::{Drive, MAX_DRIVES, Pattern};
use meissner_array::strokes::Strokes;
use meissner_array::units::UM_PER_PULSE;

/// Pulses of a burst: a micrometre at the least, and at the most so many that no two motors pulse at the same time.
pub const PULSES_RANGE: std::ops::RangeInclusive<u16> = 7..=200;
/// Numbers of pulses if nobody says: the paper's 70, and from a fifth of it to twice it. A wide range, for how well the slope
/// is known depends on it: with 30 to 110 its error would be 2.4 times that of a line through the origin, with these it is 1.5 times.
pub const DEFAULT_PULSES: [u16; 10] = [14, 28, 42, 56, 70, 84, 98, 112, 126, 140];
/// Rounds if nobody says: a minute, and gains to about 1 %.
pub const DEFAULT_REPETITIONS: u16 = 2;
/// Groups of a plan at the most: five minutes.
pub const MAX_GROUPS: usize = 100;
/// Measured strokes of a group. More give better slopes from fewer groups; but a pin whose ways differ by 2 % goes astray by
/// 0.2 µm a stroke, and by 2 µm with each transient.
pub const STROKES_PER_GROUP: usize = 9;
/// From group to group, s.
pub const GROUP_S: f64 = 3.0;
/// A group's last burst has ended by so long after its beginning, s: the rest is rest.
const PLAYED_S: f64 = 2.5;
/// Strokes per second: at rest between bursts for 28 times the window, and as often within [`PLAYED_S`] as a group has strokes.
const FREQUENCY_HZ: f64 = 4.0;

const _: () = assert!(MAX_GROUPS * MOTORS <= MAX_DRIVES);

/// A plan no calibration can be made by.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// No such motor.
    #[error("motor {found}: must be 0 to {}", MOTORS - 1)]
    Motor {
        /// As asked for.
        found: u8,
    },
    /// Too few or too many pulses.
    #[error("bursts of {found} pulses: must be {} to {}", PULSES_RANGE.start(), PULSES_RANGE.end())]
    Pulses {
        /// As asked for.
        found: u16,
    },
    /// A slope needs two numbers of pulses.
    #[error("bursts of one length have no slope: name two numbers of pulses or more")]
    OneNumber,
    /// A number that is there already.
    #[error("bursts of {found} pulses are there twice: leave one out")]
    Twice {
        /// It.
        found: u16,
    },
    /// None, or too many groups in all.
    #[error("{found} repetitions: must be 1 to {most}, so that there are no more than {MAX_GROUPS} groups")]
    Repetitions {
        /// As asked for.
        found: u16,
        /// At the most, with so many numbers of pulses.
        most: usize,
    },
}

/// What is played to calibrate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    motor: Option<u8>,
    pulses: Vec<u16>,
    repetitions: u16,
}

impl Default for Plan {
    fn default() -> Self {
        Self { motor: None, pulses: DEFAULT_PULSES.to_vec(), repetitions: DEFAULT_REPETITIONS }
    }
}

impl Plan {
    /// A plan for one motor, or all, with bursts of these numbers of pulses, each in so many groups.
    ///
    /// # Errors
    /// What is wrong with it, in one line.
    pub fn new(motor: Option<u8>, pulses: &[u16], repetitions: u16) -> Result<Self, PlanError> {
        if let Some(found) = motor.filter(|&motor| usize::from(motor) >= MOTORS) {
            return Err(PlanError::Motor { found });
        }
        if let Some(&found) = pulses.iter().find(|pulses| !PULSES_RANGE.contains(pulses)) {
            return Err(PlanError::Pulses { found });
        }
        if pulses.len() < 2 {
            return Err(PlanError::OneNumber);
        }
        let twice = (1..pulses.len()).find(|&n| pulses[..n].contains(&pulses[n]));
        if let Some(n) = twice {
            return Err(PlanError::Twice { found: pulses[n] });
        }
        let most = MAX_GROUPS / pulses.len();
        if !(1..=most).contains(&repetitions.into()) {
            return Err(PlanError::Repetitions { found: repetitions, most });
        }
        Ok(Self { motor, pulses: pulses.to_vec(), repetitions })
    }

    /// The motors it calibrates.
    pub fn motors(&self) -> impl Iterator<Item = u8> + use<> {
        let of = self.motor;
        (0..MOTORS as u8).filter(move |&motor| of.is_none_or(|of| motor == of))
    }

    /// Its numbers of pulses.
    #[must_use]
    pub fn pulses(&self) -> &[u16] {
        &self.pulses
    }

    /// Groups of each number.
    #[must_use]
    pub const fn repetitions(&self) -> u16 {
        self.repetitions
    }

    /// Groups of each motor.
    #[must_use]
    pub fn groups(&self) -> usize {
        self.pulses.len() * usize::from(self.repetitions)
    }

    /// How long it plays, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.groups() as f64 * GROUP_S
    }

    /// The number of pulses of each group, in the order they are played.
    fn order(&self) -> impl Iterator<Item = u16> {
        // Steps of the golden section: what comes next is far from what was.
        let place = |n: usize| (n as f64 * 0.618_034).fract();
        let mut order: Vec<usize> = (0..self.pulses.len()).collect();
        order.sort_by(|&a, &b| place(a).total_cmp(&place(b)));
        (0..self.groups()).map(move |group| {
            let (round, n) = (group / order.len(), group % order.len());
            let n = if round % 2 == 0 { n } else { order.len() - 1 - n };
            self.pulses[order[n]]
        })
    }

    /// It as a pattern, to be played open loop.
    #[must_use]
    #[expect(clippy::missing_panics_doc, reason = "it does not happen")]
    pub fn pattern(&self) -> Pattern {
        let groups = self.order().enumerate();
        let drives = groups.flat_map(|(group, pulses)| {
            let start_s = group as f64 * GROUP_S;
            self.motors().map(move |motor| Drive {
                motor,
                frequency_hz: FREQUENCY_HZ,
                amplitude_um: f64::from(pulses) * UM_PER_PULSE,
                // All up bursts lie in one half of the cycle, all down bursts in the other.
                phase: f64::from(motor) / (2.0 * MOTORS as f64),
                start_s: Some(start_s),
                stop_s: Some(start_s + PLAYED_S),
            })
        });
        Pattern::new("calibration", Some(self.duration_s()), drives.collect(), toml::Table::new())
            .expect("a checked plan is a pattern")
    }

    /// Its bursts if it begins at `onset`, in order of their strokes.
    #[expect(clippy::missing_panics_doc, reason = "it does not happen")]
    pub fn bursts(&self, onset: Tick) -> impl Iterator<Item = PlannedBurst> + use<> {
        let mut strokes = Strokes::new(&self.pattern(), None).expect("a plan's drives can be played");
        strokes.begin(onset);
        let mut played = [0_usize; MOTORS];
        strokes.flat_map(move |stroke| {
            let stroke = stroke.expect("a plan's strokes are within the limits");
            let played = &mut played[usize::from(stroke.motor)];
            let warm_up = *played % (1 + STROKES_PER_GROUP) == 0;
            *played += 1;
            stroke.bursts().map(|burst| PlannedBurst { motor: stroke.motor, burst, warm_up })
        })
    }
}

/// A burst of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlannedBurst {
    /// Whose.
    pub motor: u8,
    /// What is played. When it begins the pin is still at rest.
    pub burst: Burst,
    /// Whether it is of a group's first stroke.
    pub warm_up: bool,
}

impl PlannedBurst {
    /// When the pin is at rest again: the motor's window after the last pulse.
    #[must_use]
    pub fn rests_at(&self) -> Tick {
        self.burst.end() + WINDOW_TICKS
    }

    /// What became of it, by the displacements at rest before it and after it, µm, upwards.
    #[must_use]
    pub fn block(&self, before_um: f64, after_um: f64) -> BurstTravel {
        let Burst { start, direction, pulses } = self.burst;
        let travel_um = match direction {
            Direction::Up => after_um - before_um,
            Direction::Down => before_um - after_um,
        };
        BurstTravel { motor: self.motor, direction, start, pulses, travel_um, warm_up: self.warm_up }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_plan_is_refused_in_one_line() {
        for (motor, pulses, repetitions, says) in [
            (Some(24), &[30, 70][..], 1, "motor 24: must be 0 to 23"),
            (None, &[30, 6], 1, "bursts of 6 pulses: must be 7 to 200"),
            (None, &[201, 30], 1, "bursts of 201 pulses: must be 7 to 200"),
            (None, &[70], 1, "bursts of one length have no slope: name two numbers of pulses or more"),
            (None, &[], 1, "bursts of one length have no slope: name two numbers of pulses or more"),
            (None, &[30, 70, 30], 1, "bursts of 30 pulses are there twice: leave one out"),
            (None, &[30, 70], 0, "0 repetitions: must be 1 to 50, so that there are no more than 100 groups"),
            (None, &[30, 50, 70], 34, "34 repetitions: must be 1 to 33"),
        ] {
            let line = Plan::new(motor, pulses, repetitions).unwrap_err().to_string();
            assert!(line.starts_with(says) && !line.contains('\n'), "{line}");
        }
        let longest: Vec<u16> = PULSES_RANGE.take(MAX_GROUPS).collect();
        assert_eq!(Plan::new(None, &longest, 1).unwrap().pattern().drives().len(), 2400);
        assert_eq!(Plan::new(None, &DEFAULT_PULSES, DEFAULT_REPETITIONS), Ok(Plan::default()));
    }

    #[test]
    fn a_travel_is_counted_the_burst_s_way() {
        let of = |direction| PlannedBurst {
            motor: 3,
            burst: Burst { start: Tick(10), direction, pulses: 70 },
            warm_up: false,
        };
        assert_eq!(of(Direction::Up).block(1.0, 10.5).travel_um, 9.5);
        assert_eq!(of(Direction::Down).block(10.5, 1.0).travel_um, 9.5);
        // 4.3 ms are 365.5 ticks.
        assert_eq!(of(Direction::Up).rests_at(), Tick(10 + 70 + 366));
    }
}
