//! Reads and checks a description.
//!
//! Invariant: no key is ignored, and no value passes unchecked.

use super::error::{ArrayError, KeyError, Problem};
use super::{ArraySpec, Duty, Grid, Groups, MAX_MOTORS, MotorSpec};
use crate::units::TickRate;
use firmware_protocol::array::{ArrayId, Layout, Name};
use firmware_protocol::limits::correction;
use meissner_input::document::{Size, Table, check_size, from_toml, in_range};
use meissner_input::message::quote;
use serde::Deserialize;

/// Most bytes of a description: far more than 64 pins need.
const MAX_BYTES: usize = 1 << 16;
const MAX_SIZE: Size = Size { tokens: 1 << 14, tables: 64, values: 1 << 10 };
/// Carriers, Hz. Below 20 kHz people hear a motor. The protocol's buffers are sized for at most 200 kHz; the firmware of a Pico
/// takes less (`firmware/clock.rs`).
pub const TICK_HZ: std::ops::RangeInclusive<u32> = 20_000..=200_000;
/// The most that `least_pulses` may be: a calibration plays bursts of up to twice as many.
const MOST_LEAST_PULSES: u32 = 100;
/// Radius of a pin's tip without one given, mm.
const PIN_RADIUS_MM: f64 = 0.5;
/// `most_pulses` may be at most this many times the travel. It bounds how far a host can move a pin. A stroke of the whole travel
/// with its largest correction takes 1.3 times the travel; the rest is for a motor that goes less far per pulse than described.
const MOST_TRAVELS: u32 = 2;
/// The least mean gain of a transient burst. A seek of the lower stop goes at least 1.5 times as far as the pin is above it
/// ([`Layout::least_seek`]) and may be such a burst. Bursts scatter by 10 %, and 1.5 x 0.75 x 0.9 is just above 1.
const LEAST_TRANSIENT_GAIN: f64 = 0.75;

impl ArraySpec {
    /// Reads a description; `file` is its name in errors.
    ///
    /// # Errors
    /// The first problem, in one line.
    pub fn parse(text: &str, file: &str) -> Result<Self, ArrayError> {
        read(text).map_err(|error| error.in_text(text).in_file(Some(file)))
    }
}

fn read(text: &str) -> Result<ArraySpec, KeyError> {
    if text.len() > MAX_BYTES {
        return Err(KeyError::whole(None, Problem::TooLarge { bytes: text.len(), most: MAX_BYTES }));
    }
    check_size(text, MAX_SIZE)?;
    let Table(raw) = from_toml::<Raw, _>(text, wanted)?;
    raw.checked(text)
}

fn wanted(key: &str) -> &'static str {
    match key {
        "name" => "name = \"...\", a name of your own",
        "pins" => "pins = { rows = ..., columns = ..., pitch_mm = ... }",
        "tick_hz" => "the carrier, pulses per second: 20000 to 200000",
        "duty" => "duty = { up = 0.20, down = 0.80 }",
        "up" | "down" => "the share of a tick for which a line is high",
        "motor" => "a table [motor] with step_um, window_ms, travel_um and most_pulses",
        "step_um" => "the travel of a shaft per pulse, um",
        "window_ms" => "the time over which a shaft averages its pulses, ms",
        "travel_um" => "the largest amplitude, um peak to peak",
        "most_pulses" => "the most pulses of a burst, which bounds the travel whatever a host asks",
        "rest_s" => "the rest after which a first burst falls short, s",
        _ => "the mean travel of such a burst, as a share of the full one",
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    name: String,
    pins: Table<RawPins>,
    tick_hz: u32,
    duty: Table<RawDuty>,
    rails: Option<Vec<Vec<i64>>>,
    chips: Option<Vec<Vec<i64>>>,
    motor: Table<RawMotor>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPins {
    rows: Option<u8>,
    columns: Option<u8>,
    pitch_mm: Option<f64>,
    positions_mm: Option<Vec<Vec<f64>>>,
    radius_mm: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawDuty {
    up: f64,
    down: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawMotor {
    step_um: f64,
    window_ms: f64,
    travel_um: f64,
    #[serde(default = "one")]
    least_pulses: u16,
    most_pulses: u16,
    seek_pulses: Option<u16>,
    transient: Option<Table<RawTransient>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTransient {
    rest_s: f64,
    gain: f64,
}

const fn one() -> u16 {
    1
}

impl Raw {
    fn checked(self, text: &str) -> Result<ArraySpec, KeyError> {
        let Self { name, pins: Table(pins), tick_hz, duty: Table(duty), rails, chips, motor: Table(motor) } =
            self;
        if !crate::pattern::is_new_name(&name) || name.len() > 32 {
            return Err(KeyError::key("name", Problem::Name { found: quote(&name) }));
        }
        in_range("tick_hz", tick_hz.into(), TICK_HZ.contains(&tick_hz), "20000 to 200000 Hz")?;
        let duty = duty.checked()?;
        let (positions_mm, grid, pin_radius_mm) = pins.checked().map_err(|error| error.within("pins"))?;
        let motors = positions_mm.len();
        let all = || vec![(0..motors as i64).collect()];
        let rails = groups("rails", rails.unwrap_or_else(all), motors)?;
        let each = || (0..motors as i64).map(|motor| vec![motor]).collect();
        let chips = groups("chips", chips.unwrap_or_else(each), motors)?;
        for (chip, members) in chips.members().iter().enumerate() {
            if let Some(&second) = members.iter().find(|&&motor| rails.of(motor) != rails.of(members[0])) {
                let problem = Problem::TwoRails { first: members[0], second };
                return Err(KeyError::key(&format!("chips[{chip}]"), problem));
            }
        }
        let rate = TickRate::new(tick_hz);
        let motor = motor.checked(rate).map_err(|error| error.within("motor"))?;
        // Boards keep the hash. So it is of numbers in this order, and not of how the program's structures are called.
        let values = format!(
            "{name} {positions_mm:?} {pin_radius_mm:?} {tick_hz} {:?} {:?} {:?} {}",
            [duty.up, duty.down],
            rails.members(),
            chips.members(),
            motor.numbers()
        );
        let of = |groups: &Groups| (0..motors as u8).map(|motor| groups.of(motor) as u8).collect::<Vec<_>>();
        let thousandths = |share: f64| (1000.0 * share + 0.5) as u16;
        let id = ArrayId {
            // The name was checked.
            name: Name::new(&name)
                .ok_or_else(|| KeyError::key("name", Problem::Name { found: quote(&name) }))?,
            motors: motors as u8,
            tick_hz,
            duty_up: thousandths(duty.up),
            duty_down: thousandths(duty.down),
            hash: fnv1a(&values),
        };
        let layout = Layout::new(id, &of(&rails), &of(&chips), motor.most_pulses, motor.seek_pulses)
            .map_err(|error| KeyError::whole(None, Problem::Layout { error }))?;
        let text = text.to_owned();
        let spec = ArraySpec {
            text,
            name,
            positions_mm,
            grid,
            pin_radius_mm,
            rate,
            duty,
            rails,
            chips,
            motor,
            layout,
        };
        if let Some((first, second, distance_mm)) = spec.nearest_pins()
            && distance_mm < 2.0 * pin_radius_mm
        {
            let problem = Problem::Overlap { first, second, distance_mm, radius_mm: pin_radius_mm };
            return Err(KeyError::key("pins", problem));
        }
        Ok(spec)
    }
}

impl RawDuty {
    fn checked(self) -> Result<Duty, KeyError> {
        let Self { up, down } = self;
        for (key, found) in [("duty.up", up), ("duty.down", down)] {
            in_range(key, found, (0.02..=0.98).contains(&found), "0.02 to 0.98 of a tick")?;
        }
        // The motor's rule: short high pulses move a pin up, long ones down.
        if up >= 0.5 || down <= 0.5 {
            return Err(KeyError::key("duty", Problem::Duty { up, down }));
        }
        for (key, found) in [("duty.up", up), ("duty.down", down)] {
            if (1000.0 * found).round() / 1000.0 != found {
                return Err(KeyError::key(key, Problem::Thousandths { found }));
            }
        }
        Ok(Duty { up, down })
    }
}

/// Positions, grid, radius.
type Pins = (Vec<[f64; 2]>, Option<Grid>, f64);

impl RawPins {
    fn checked(self) -> Result<Pins, KeyError> {
        let Self { rows, columns, pitch_mm, positions_mm, radius_mm } = self;
        let radius_mm = radius_mm.unwrap_or(PIN_RADIUS_MM);
        in_range("radius_mm", radius_mm, (0.05..=5.0).contains(&radius_mm), "0.05 to 5 mm")?;
        let (positions_mm, grid) = match (rows, columns, pitch_mm, positions_mm) {
            (Some(rows), Some(columns), Some(pitch_mm), None) => {
                in_range("pitch_mm", pitch_mm, (0.1..=25.0).contains(&pitch_mm), "0.1 to 25 mm")?;
                let grid = Grid { rows, columns, pitch_mm };
                count(usize::from(rows) * usize::from(columns))?;
                (grid.positions_mm(), Some(grid))
            }
            (None, None, None, Some(places)) => {
                let place = |(pin, place): (usize, Vec<f64>)| {
                    <[f64; 2]>::try_from(place).map_err(|place| {
                        let problem = Problem::Place { numbers: place.len() };
                        KeyError::key(&format!("positions_mm[{pin}]"), problem)
                    })
                };
                (places.into_iter().enumerate().map(place).collect::<Result<_, _>>()?, None)
            }
            _ => return Err(KeyError::whole(None, Problem::Pins)),
        };
        count(positions_mm.len())?;
        for (pin, place) in positions_mm.iter().enumerate() {
            for found in *place {
                let key = format!("positions_mm[{pin}]");
                in_range(&key, found, (-50.0..=50.0).contains(&found), "-50 to 50 mm")?;
            }
        }
        Ok((positions_mm, grid, radius_mm))
    }
}

fn count(pins: usize) -> Result<(), KeyError> {
    let good = (1..=MAX_MOTORS).contains(&pins);
    if good { Ok(()) } else { Err(KeyError::whole(None, Problem::TooManyPins { pins })) }
}

impl Grid {
    /// Where its pins stand, in the order of the motors.
    fn positions_mm(self) -> Vec<[f64; 2]> {
        let Self { rows, columns, pitch_mm } = self;
        let place = |row: u8, column: u8| {
            let x = f64::from(column) - f64::from(columns - 1) / 2.0;
            let y = f64::from(rows - 1) / 2.0 - f64::from(row);
            [x * pitch_mm, y * pitch_mm]
        };
        (0..rows).flat_map(|row| (0..columns).map(move |column| place(row, column))).collect()
    }
}

impl RawMotor {
    fn checked(self, rate: TickRate) -> Result<MotorSpec, KeyError> {
        let Self { step_um, window_ms, travel_um, least_pulses, most_pulses, seek_pulses, transient } = self;
        in_range("step_um", step_um, (0.001..=10.0).contains(&step_um), "0.001 to 10 um")?;
        in_range("travel_um", travel_um, (1.0..=5_000.0).contains(&travel_um), "1 to 5000 um")?;
        in_range("most_pulses", most_pulses.into(), (1..=10_000).contains(&most_pulses), "1 to 10000")?;
        let pulses = (travel_um / step_um + 0.5) as u32;
        in_range("travel_um", travel_um, pulses >= 1, format!("at least step_um, {step_um} um"))?;
        let good = (1..=pulses.min(MOST_LEAST_PULSES)).contains(&least_pulses.into());
        let range = format!("1 to {}", pulses.min(MOST_LEAST_PULSES));
        in_range("least_pulses", least_pulses.into(), good, range)?;
        if pulses > most_pulses.into() {
            let problem = Problem::Travel { found: most_pulses, travel_um, pulses };
            return Err(KeyError::key("most_pulses", problem));
        }
        let most = MOST_TRAVELS * pulses.max(1);
        if u32::from(most_pulses) > most {
            let problem = Problem::FarTravel { found: most_pulses, travel_um, pulses, most };
            return Err(KeyError::key("most_pulses", problem));
        }
        // From where moves and a stroke can take a pin at most.
        let least = 2 * most_pulses + correction(most_pulses);
        let most = i16::MAX.cast_unsigned();
        let seek_pulses = seek_pulses.unwrap_or_else(|| most.min(2 * least));
        in_range("seek_pulses", seek_pulses.into(), seek_pulses <= most, format!("at most {most}"))?;
        if seek_pulses < least {
            return Err(KeyError::key("seek_pulses", Problem::Seek { found: seek_pulses, least }));
        }
        let (rest_s, transient_gain) = match transient {
            None => (f64::INFINITY, 1.0),
            Some(Table(RawTransient { rest_s, gain })) => {
                in_range("transient.rest_s", rest_s, (0.01..=1e4).contains(&rest_s), "0.01 to 10000 s")?;
                let good = (LEAST_TRANSIENT_GAIN..=2.0).contains(&gain);
                let range = format!(
                    "{LEAST_TRANSIENT_GAIN} to 2: with less, a seek of the lower stop would end above it"
                );
                in_range("transient.gain", gain, good, range)?;
                (rest_s, gain)
            }
        };
        in_range("window_ms", window_ms, (0.1..=50.0).contains(&window_ms), "0.1 to 50 ms")?;
        let window_half_ticks = (2.0 * rate.ms_in_ticks(window_ms) + 0.5) as u64;
        let transient_rest_ticks = rate.seconds_to_ticks(rest_s);
        let um_per_pulse = step_um;
        Ok(MotorSpec {
            um_per_pulse,
            window_half_ticks,
            travel_um,
            least_pulses,
            most_pulses,
            seek_pulses,
            transient_rest_ticks,
            transient_gain,
        })
    }
}

impl MotorSpec {
    /// All its numbers, in an order that never changes.
    fn numbers(&self) -> String {
        let Self { um_per_pulse, window_half_ticks, travel_um, .. } = *self;
        let Self { least_pulses, most_pulses, seek_pulses, transient_rest_ticks, transient_gain, .. } = *self;
        let pulses = [least_pulses, most_pulses, seek_pulses];
        // Flashed boards have the hash of this text, `None` included.
        format!(
            "{um_per_pulse:?} None {window_half_ticks} {travel_um:?} {pulses:?} {transient_rest_ticks} {transient_gain:?}"
        )
    }
}

/// FNV-1a: it tells descriptions apart; it is no protection.
fn fnv1a(text: &str) -> u64 {
    let next = |hash: u64, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    text.bytes().fold(0xcbf2_9ce4_8422_2325, next)
}

/// Checks that each motor is in exactly one group.
fn groups(key: &str, lists: Vec<Vec<i64>>, motors: usize) -> Result<Groups, KeyError> {
    let mut seen: Vec<Option<usize>> = vec![None; motors];
    for (group, list) in lists.iter().enumerate() {
        let here = |problem| Err(KeyError::key(&format!("{key}[{group}]"), problem));
        if list.is_empty() {
            return here(Problem::EmptyGroup);
        }
        for &motor in list {
            let Some(seen) = usize::try_from(motor).ok().and_then(|motor| seen.get_mut(motor)) else {
                return here(Problem::NoMotor { motor, last: motors - 1 });
            };
            if let Some(other) = seen.replace(group) {
                return here(Problem::Twice { motor: motor as u8, other: format!("{key}[{other}]") });
            }
        }
    }
    if let Some(motor) = seen.iter().position(Option::is_none) {
        return Err(KeyError::key(key, Problem::Unwired { motor }));
    }
    let lists = lists.into_iter().map(|list| list.into_iter().map(|motor| motor as u8).collect());
    Ok(Groups::new(lists.collect(), motors))
}
