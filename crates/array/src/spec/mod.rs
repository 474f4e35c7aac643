//! The array as data: one description of pins, carrier, wiring and motors, read once, checked once, asked everywhere.
//!
//! A description is a TOML file (`library/arrays/*.toml`). [`ArraySpec::parse`] reads and checks it. An [`Array`] is a handle on a description
//! that stays for the rest of the program, so that patterns, plays and devices carry it by value. [`Array::named`] finds one of the
//! descriptions that the program knows: the shipped ones, and those that were added with [`Array::known`].
//!
//! Invariant: an [`ArraySpec`] has been checked: every motor has one pin, one rail and one driver chip, every number is in its range.

mod error;
mod known;
mod read;
mod write;

pub use error::{ArrayError, Problem};
pub use known::{Array, UnknownArray, names};
pub use read::TICK_HZ;
pub use write::NewArray;

use crate::units::TickRate;
use firmware_protocol::array::Layout;
pub use firmware_protocol::array::MAX_MOTORS;
use firmware_protocol::tick::Tick;
use serde::de::Error;
use serde::{Deserialize, Deserializer};
use std::ops::Range;

/// A checked description of an array.
#[derive(Clone, Debug, PartialEq)]
pub struct ArraySpec {
    text: String,
    name: String,
    positions_mm: Vec<[f64; 2]>,
    grid: Option<Grid>,
    pin_radius_mm: f64,
    rate: TickRate,
    duty: Duty,
    rails: Groups,
    chips: Groups,
    motor: MotorSpec,
    layout: Layout,
}

/// Pins in rows and columns; a motor's number is `columns * row + column`, and row 0 is the most distal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Rows, from the fingertip down.
    pub rows: u8,
    /// Columns, across the finger.
    pub columns: u8,
    /// Distance of neighbouring pins, mm.
    pub pitch_mm: f64,
}

/// The share of a tick for which a line is high.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Duty {
    /// In a pulse that moves the pin towards the finger.
    pub up: f64,
    /// In a pulse that moves it away.
    pub down: f64,
}

/// What a motor does with its pulses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorSpec {
    /// Travel of a shaft per pulse, µm.
    pub um_per_pulse: f64,
    /// The window of the moving average with which a shaft follows its pulses, half ticks.
    pub window_half_ticks: u64,
    /// The largest amplitude of a drive, µm peak to peak.
    pub travel_um: f64,
    /// The fewest pulses of a burst for which the travel per pulse is known.
    pub least_pulses: u16,
    /// The controller's limit: most up pulses of a stroke, and most pulses by which moves may shift a pin from rest.
    pub most_pulses: u16,
    /// Most pulses of a seek of the lower stop.
    pub seek_pulses: u16,
    /// Rest after which a motor's first burst is transient, ticks.
    pub transient_rest_ticks: u64,
    /// Mean gain of a transient burst.
    pub transient_gain: f64,
}

/// Motors that share a supply (a rail) or a driver chip.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Groups {
    members: Vec<Vec<u8>>,
    /// The group of each motor.
    of: Vec<u8>,
}

impl ArraySpec {
    /// The text of its file.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The name: 1 to 32 of a-z, 0-9 and -.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The number of pins, and of motors: 1 to [`MAX_MOTORS`].
    pub fn motors(&self) -> usize {
        self.positions_mm.len()
    }

    /// The motors' numbers.
    pub fn numbers(&self) -> Range<u8> {
        0..self.positions_mm.len() as u8
    }

    /// Whether there is a motor of this number.
    pub fn has(&self, motor: u8) -> bool {
        usize::from(motor) < self.motors()
    }

    /// The motors' numbers in words: `0 to 23`.
    pub fn motor_range(&self) -> String {
        format!("0 to {}", self.motors() - 1)
    }

    /// Where a motor's pin stands: `[x, y]`, mm. The origin is the middle of the array, x runs across the finger, y towards its tip.
    ///
    /// # Panics
    /// If there is no such motor.
    pub fn position_mm(&self, motor: u8) -> [f64; 2] {
        self.positions_mm[usize::from(motor)]
    }

    /// Where all pins stand, in the order of the motors.
    pub fn positions_mm(&self) -> &[[f64; 2]] {
        &self.positions_mm
    }

    /// The rows and columns, if the pins stand in such.
    pub const fn grid(&self) -> Option<Grid> {
        self.grid
    }

    /// The smallest distance of two pins, mm; of one pin, its diameter.
    pub fn pitch_mm(&self) -> f64 {
        self.grid.map_or_else(
            || self.nearest_pins().map_or(2.0 * self.pin_radius_mm, |near| near.2),
            |grid| grid.pitch_mm,
        )
    }

    /// The two pins that are nearest to each other, and their distance in mm.
    fn nearest_pins(&self) -> Option<(usize, usize, f64)> {
        let pairs = (0..self.motors()).flat_map(|second| (0..second).map(move |first| (first, second)));
        pairs
            .map(|(first, second)| {
                let ([x0, y0], [x1, y1]) = (self.positions_mm[first], self.positions_mm[second]);
                (first, second, (x1 - x0).hypot(y1 - y0))
            })
            .min_by(|a, b| a.2.total_cmp(&b.2))
    }

    /// The pin whose place is nearest to a point, and its distance in mm; of equally near ones, the first.
    ///
    /// # Panics
    /// It does not: an array has a pin.
    pub fn nearest_to(&self, [x, y]: [f64; 2]) -> (u8, f64) {
        let distances = self.numbers().map(|motor| {
            let [px, py] = self.position_mm(motor);
            (motor, (px - x).hypot(py - y))
        });
        distances.min_by(|a, b| a.1.total_cmp(&b.1)).expect("an array has a pin")
    }

    /// Radius of a pin's tip, mm.
    pub const fn pin_radius_mm(&self) -> f64 {
        self.pin_radius_mm
    }

    /// Ticks per second: the rate of the pulses.
    pub const fn rate(&self) -> TickRate {
        self.rate
    }

    /// The pulses' duty.
    pub const fn duty(&self) -> Duty {
        self.duty
    }

    /// The supplies.
    pub const fn rails(&self) -> &Groups {
        &self.rails
    }

    /// The driver chips.
    pub const fn chips(&self) -> &Groups {
        &self.chips
    }

    /// What its motors do.
    pub const fn motor(&self) -> &MotorSpec {
        &self.motor
    }

    /// A hash of everything in the description, for devices and records to compare. Comments and the order of keys do not matter.
    pub const fn hash(&self) -> u64 {
        self.layout.id().hash
    }

    /// The array as the controller and the link know it.
    pub const fn layout(&self) -> &Layout {
        &self.layout
    }
}

/// Reads the number of a motor; whether the array has it is checked later.
pub(crate) fn motor_number<'de, D: Deserializer<'de>>(source: D) -> Result<u8, D::Error> {
    let number = i64::deserialize(source)?;
    let refused = || format!("is {number}: must be the number of a motor, 0 to {} at most", MAX_MOTORS - 1);
    u8::try_from(number).map_err(|_| D::Error::custom(refused()))
}

impl MotorSpec {
    /// The window in ticks, for equations.
    pub const fn window_ticks(&self) -> f64 {
        self.window_half_ticks as f64 / 2.0
    }

    /// Whole ticks after which a shaft has followed its commanded position.
    pub const fn settled_ticks(&self) -> u64 {
        self.window_half_ticks.div_ceil(2)
    }

    /// Whether a burst that begins at `start` is a transient: the motor has rested since `last_end`, the end of its last burst
    /// (none: there was none). A motor without transients never rests for long enough.
    pub fn is_rested(&self, last_end: Option<Tick>, start: Tick) -> bool {
        let rest_ticks = self.transient_rest_ticks;
        last_end.map_or(rest_ticks < u64::MAX, |end| start - end >= rest_ticks)
    }

    /// `um` in pulses, not rounded.
    pub const fn pulses(&self, um: f64) -> f64 {
        um / self.um_per_pulse
    }
}

impl Groups {
    /// Groups with these members. Each motor must be in exactly one.
    fn new(members: Vec<Vec<u8>>, motors: usize) -> Self {
        let mut of = vec![0; motors];
        for (group, motor) in
            (0..).zip(&members).flat_map(|(group, members)| members.iter().map(move |motor| (group, *motor)))
        {
            of[usize::from(motor)] = group;
        }
        Self { members, of }
    }

    /// The motors of each group.
    pub fn members(&self) -> &[Vec<u8>] {
        &self.members
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.members.len()
    }

    /// The group of a motor.
    ///
    /// # Panics
    /// If there is no such motor.
    pub fn of(&self, motor: u8) -> usize {
        self.of[usize::from(motor)].into()
    }

    /// Motors of the largest group.
    pub fn largest(&self) -> usize {
        self.members.iter().map(Vec::len).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_test_support::documents::assert_changes_refused;

    const GOOD: &str = r#"
name = "mine"
pins = { rows = 2, columns = 3, pitch_mm = 1.8 }
tick_hz = 70000
duty = { up = 0.25, down = 0.75 }
rails = [[0, 1, 2, 3, 4], [5]]
chips = [[0, 4], [1, 2], [3], [5]]
[motor]
step_um = 0.2
window_ms = 3.0
travel_um = 300.0
most_pulses = 2000
"#;

    #[test]
    fn a_description_gives_pins_wiring_and_motors() {
        let array = ArraySpec::parse(GOOD, "mine.toml").unwrap();
        assert_eq!(
            (array.name(), array.motors(), array.numbers(), array.rate().hz()),
            ("mine", 6, 0..6, 70_000)
        );
        assert_eq!(array.position_mm(0), [-1.8, 0.9]);
        assert_eq!(array.position_mm(5), [1.8, -0.9]);
        assert_eq!((array.rails().of(5), array.rails().count(), array.rails().largest()), (1, 2, 5));
        assert_eq!(
            (array.chips().of(4), array.chips().of(2), array.chips().members()[2].as_slice()),
            (0, 1, &[3][..])
        );
        let motor = array.motor();
        assert_eq!((motor.window_half_ticks, motor.window_ticks(), motor.settled_ticks()), (420, 210.0, 210));
        assert_eq!((motor.least_pulses, motor.seek_pulses, motor.transient_gain), (1, 9_200, 1.0));
        assert_eq!(array.nearest_to([1.0, 1.0]), (2, (0.8_f64 * 0.8 + 0.01).sqrt()));
        let places = GOOD.replace(
            "pins = { rows = 2, columns = 3, pitch_mm = 1.8 }",
            "pins = { positions_mm = [[0.0, 0.0], [3.0, 0.0], [0.0, 2.5], [9.0, 9.0], [-4.0, 1.0], [-4.0, -4.0]], radius_mm = 0.4 }",
        );
        let places = ArraySpec::parse(&places, "mine.toml").unwrap();
        assert_eq!((places.grid(), places.pitch_mm(), places.pin_radius_mm()), (None, 2.5, 0.4));
        assert_ne!(places.hash(), array.hash());
    }

    #[test]
    fn the_papers_array_has_the_papers_numbers() {
        let array = Array::paper();
        assert_eq!((array.motors(), array.rate().hz(), array.pitch_mm()), (24, 85_000, 2.9));
        for (motor, place) in
            [(0, [-4.35, 7.25]), (3, [4.35, 7.25]), (20, [-4.35, -7.25]), (23, [4.35, -7.25])]
        {
            let [x, y] = array.position_mm(motor);
            assert!((x - place[0]).abs() < 1e-12 && (y - place[1]).abs() < 1e-12, "{motor}: {x} {y}");
        }
        assert_eq!(
            (array.rails().count(), array.rails().of(6), array.chips().count(), array.chips().of(23)),
            (4, 1, 12, 11)
        );
        let motor = array.motor();
        assert_eq!(motor.um_per_pulse.to_bits(), (0.95_f64 / 7.0).to_bits());
        assert_eq!(
            (motor.window_half_ticks, motor.settled_ticks(), motor.transient_rest_ticks),
            (731, 366, 42_500)
        );
        // 11.5 mm/s.
        assert!((motor.um_per_pulse * 85.0 - 11.5).abs() < 0.05);
    }

    /// A board has the hash of its description. If this fails, boards that have been flashed refuse this host.
    #[test]
    fn the_hash_of_a_description_does_not_change() {
        // FNV-1a of the numbers as text, by a few lines of Python.
        assert_eq!(Array::paper().hash(), 0xee37_5a9f_832b_c958);
    }

    #[test]
    fn a_hash_is_of_values_and_not_of_the_text() {
        let hash = |text: &str| ArraySpec::parse(text, "mine.toml").unwrap().hash();
        assert_eq!(
            hash(GOOD),
            hash(&GOOD.replace("0.25, down", "0.250,   down").replace("[motor]", "# mine\n[motor]"))
        );
        for (from, to) in [
            ("70000", "70001"),
            ("0.25", "0.26"),
            ("[3], [5]", "[5], [3]"),
            ("1.8", "1.9"),
            ("2000", "2001"),
            ("mine", "ours"),
        ] {
            assert_ne!(hash(GOOD), hash(&GOOD.replace(from, to)), "{from}");
        }
    }

    const MISTAKES: &str = r#"
pitch_mm = 1.8 => pitch_mm = 0.9 => 3: `pins` are too near: 0 and 1 overlap…
rows = 2, columns = 3, pitch_mm = 1.8 => rows = 2 => 3: `pins` needs either rows…
rows = 2, columns = 3, pitch_mm = 1.8 => positions_mm = [] => 3: `pins` are 0 pins: must be 1 to 64…
rows = 2, columns = 3, pitch_mm = 1.8 => positions_mm = [[0.0, 99.0]] => …`pins.positions_mm[0]` is 99: must be…
rows = 2 => rows = 0 => …`pins` are 0 pins…
[[0, 4], [1, 2] => [[0, 4], [1, 2, 4] => 7: `chips[1]` has motor 4, as chips[0] has: a motor…
[[0, 4], [1, 2], [3], [5]] => [[0, 4], [1, 2], [3, 5]] => …`chips[2]` has motors 3 and 5, which are on different rails…
[[0, 4], [1, 2], [3], [5]] => [[0, 4], [1, 2], [5]] => …`chips` have no motor 3: add it…
[5]]⏎chips => [6]]⏎chips => …`rails[1]` has motor 6: the array has motors 0 to 5…
[5]]⏎chips => []]⏎chips => …`rails[1]` has no motors…
up = 0.25 => up = 0.0 => …`duty.up` is 0: must be 0.02 to 0.98…
up = 0.25 => up = 0.75 => …`duty`: up is 0.75 and down is 0.75: make up less than 0.5…
up = 0.25, down = 0.75 => up = 0.02, down = 0.20 => …`duty`: up is 0.02 and down is 0.2: make…
up = 0.25 => up = 0.5 => …`duty`: up is 0.5 and down is 0.75: make up less than 0.5 and down more…
up = 0.25 => up = 0.2504 => …`duty.up` is 0.2504: boards take thousandths of a tick; give at most…
down = 0.75 => down = 0.66667 => …`duty.down` is 0.66667: boards take thousandths…
tick_hz = 70000 => tick_hz = 4294967295 => …`tick_hz` is 4294967295: must be 20000 to 200000 Hz…
tick_hz = 70000 => tick_hz = 4294967296 => …`tick_hz`…
tick_hz = 70000⏎ =>  => …`tick_hz` is missing: add the carrier…
window_ms = 3.0 => window_ms = nan => …`motor.window_ms` is NaN: must be 0.1 to 50 ms…
window_ms = 3.0⏎ =>  => …`motor.window_ms` is missing: add the time over which…
step_um = 0.2 => step_um = 0.1 => …`motor.most_pulses` is 2000: 300 um are 3000 pulses…
most_pulses = 2000 => most_pulses = 60000 => …`motor.most_pulses` is 60000: must be 1 to 10000…
most_pulses = 2000 => most_pulses = 3001 => …`motor.most_pulses` is 3001: 300 um are 1500 pulses of step_um, and this limit may be at most twice that; lower it to 3000 or less…
most_pulses = 2000 => most_pulses = 2000⏎transient = { rest_s = 0.5, gain = 0.74 } => …`motor.transient.gain` is 0.74: must be 0.75 to 2: with less, a seek of the lower stop…
most_pulses = 2000 => most_pulses = 2000⏎seek_pulses = 2000 => …`motor.seek_pulses` is 2000: from its highest place…
name = "mine" => name = "My array" => …`name` is `My array`: must be 1 to 32 of a-z…
tick_hz => carrier = 1⏎tick_hz => …unknown key `carrier`…
rows = 2, columns = 3 => rows = 5, columns = 13 => …`pins` are 65 pins: must be 1 to 64…
"#;

    #[test]
    fn each_bad_description_is_refused_in_one_line_with_its_key() {
        assert_changes_refused(GOOD, MISTAKES, ArraySpec::parse);
    }

    #[test]
    fn the_bounds_themselves_are_good() {
        for (from, to) in [
            ("up = 0.25, down = 0.75", "up = 0.499, down = 0.501"),
            ("most_pulses = 2000", "most_pulses = 3000"),
            ("most_pulses = 2000", "most_pulses = 2000\ntransient = { rest_s = 0.5, gain = 0.75 }"),
        ] {
            let spec = ArraySpec::parse(&GOOD.replace(from, to), "mine.toml");
            assert!(spec.is_ok(), "{to}: {spec:?}");
        }
        // The least seek of a first burst that scatters downward by a standard deviation.
        let layout = Array::paper().spec().layout();
        for above in [10, 100, 1_000, 3_000] {
            assert!(f64::from(layout.least_seek(above)) * 0.75 * 0.9 >= f64::from(above));
        }
    }

    #[test]
    fn a_motor_without_transients_never_rests() {
        let (paper, other) = (Array::paper(), ArraySpec::parse(GOOD, "mine.toml").unwrap());
        let (paper, other) = (paper.motor(), other.motor());
        assert!(paper.is_rested(None, Tick(0)) && paper.is_rested(Some(Tick(5)), Tick(42_505)));
        assert!(!paper.is_rested(Some(Tick(5)), Tick(42_504)));
        assert!(!other.is_rested(None, Tick(0)) && !other.is_rested(Some(Tick(5)), Tick(u64::MAX)));
    }

    #[test]
    fn a_name_stands_for_one_description() {
        let spec = |text: &str| ArraySpec::parse(text, "mine.toml").unwrap();
        let mine = GOOD.replace("mine", "known-once");
        let array = Array::known(spec(&mine)).unwrap();
        assert_eq!(Array::known(spec(&mine)), Ok(array));
        assert_eq!(Array::named("known-once"), Ok(array));
        let other = spec(&mine.replace("70000", "71000"));
        let line = Array::known(other).unwrap_err().to_string();
        assert_eq!(line, "is known-once, which is known with other values: give yours another name");
        let line = Array::named("nobodys").unwrap_err().to_string();
        assert!(
            line.starts_with("no array is called `nobodys`: known are tula35-6x4, ubi-pen-3x3, "),
            "{line}"
        );
        assert_eq!((names()[0], Array::default()), ("tula35-6x4", Array::paper()));
    }

    #[test]
    fn a_new_array_is_read_as_asked_for_and_has_the_default_motors() {
        let new = NewArray { name: "lab-3".into(), rows: 3, columns: 3, pitch_mm: 1.8, tick_hz: None };
        let array = ArraySpec::parse(&new.to_toml(), "lab-3.toml").unwrap();
        assert_eq!(
            (array.name(), array.motors(), array.pitch_mm(), array.rate()),
            ("lab-3", 9, 1.8, Array::paper().rate())
        );
        assert_eq!((array.motor(), array.duty()), (Array::paper().motor(), Array::paper().duty()));
        assert_eq!((array.rails().members()[1].as_slice(), array.chips().count()), (&[6, 7, 8][..], 5));
        let slow = ArraySpec::parse(&NewArray { tick_hz: Some(70_000), ..new }.to_toml(), "").unwrap();
        assert_eq!((slow.rate().hz(), slow.motor().window_half_ticks), (70_000, 602));
    }
}
