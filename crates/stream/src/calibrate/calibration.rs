//! The calibration: the fits of motors and how they were made. Every calibration is checked, whatever its source.
//!
//! Build one with [`Calibration::new`], or read it from a file (`file`); [`Calibration::gains`] is what position control uses.
//!
//! Invariant: a [`Calibration`] passed every check here, so each of its gains lies within [`GAIN_RANGE`].

use crate::calibrate::fit::{Fit, FitPoint, GAIN_RANGE, MAX_SLOPE_SE, MIN_BURSTS, MotorFit};
use crate::calibrate::plan::{MAX_GROUPS, Plan, PlanError, pulses_range};
use crate::control::Gains;
use firmware_protocol::stroke::Direction;
use meissner_api::Provenance;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::{Array, UnknownArray};
use meissner_input::document::{self, in_range};
use meissner_input::message::short_number;

/// The newest version of the file format: its fits may have points. This program reads older ones, too.
pub const FORMAT: u8 = 1;
/// Bytes of a calibration file at most; all motors with the longest numbers and texts take less.
pub const MAX_BYTES: usize = 256 << 10;
/// Bursts of a fit at most.
const MAX_BURSTS: usize = 1_000_000;
/// The file has 0 in place of a smaller number, which may have hundreds of digits.
const LEAST: f64 = 1e-12;
/// Characters of each text of the provenance.
const MAX_WORDS: usize = 200;
/// The largest plausible offset or travel, µm, where bursts are short: on the paper's array one of the fewest pulses moves a pin by
/// one, the longest by 41 at most.
const OFFSET_UM: f64 = 100.0;
/// How far a gain may differ from its slope, and the file's model constant from ours, because another program may write fewer
/// digits.
pub(super) const ROUNDING: f64 = 1e-6;
/// The least standard deviation of a gain that position control assumes: a motor changes as it warms up.
const LEAST_SD: f64 = 0.005;
/// The least scatter of bursts that position control assumes.
const LEAST_SCATTER: f64 = 0.002;

/// A calibration that was refused.
pub type CalibrationError = document::DocumentError<Problem>;

/// What is wrong with a calibration, and what to do. The display holds no line break.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error("{bytes} bytes are too many: a calibration file has at most {MAX_BYTES}")]
    TooLarge { bytes: usize },
    #[error("is {found}: this version reads format = {FORMAT}")]
    Format { found: u64 },
    #[error("is empty: calibrate at least one motor")]
    NoMotor,
    #[error("is {motor}, as is motor[{other}]: leave one out")]
    Twice { motor: u8, other: usize },
    #[error("is {}, but slope_um_per_pulse gives {}: edit neither by hand, calibrate again", short_number(*.found), short_number(*.slope))]
    Gain { found: f64, slope: f64 },
    #[error(
        "is {}: the array's motors have {}, so the gains do not apply; calibrate again",
        short_number(*.found), short_number(*.model)
    )]
    Model { found: f64, model: f64 },
    #[error(
        "is {found}: must be the 16 hexadecimal digits that `meissner array show` prints; leave it out if you do not know it"
    )]
    Hash { found: String },
    #[error("is unknown: {0}")]
    Array(UnknownArray),
    #[error("is not a valid plan: {0}")]
    Plan(#[source] PlanError),
    #[error("is {found}, but pulses and repetitions give {groups}")]
    Groups { found: u64, groups: usize },
    #[error("{count} points: must be at most {MAX_GROUPS}")]
    Points { count: usize },
    #[error("is {found}, after {before}: list the numbers of pulses in rising order, each once")]
    Order { found: u16, before: u16 },
    #[error("{found} bursts in all, but `blocks` is {blocks}: edit neither by hand, calibrate again")]
    Bursts { found: usize, blocks: usize },
    #[error("is {count} characters long: must be at most {MAX_WORDS}")]
    Words { count: usize },
}

/// A problem that does not know its file and line yet.
pub(super) type KeyError = document::KeyError<Problem>;

/// The fits of the calibrated motors, and how they were made.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    array: Array,
    /// The hash of the array's description when it was made. Descriptions change, also under the same name.
    array_hash: u64,
    motors: Vec<MotorFit>,
    provenance: Provenance,
}

impl Plan {
    /// The provenance of a calibration by this plan on this device, without a date.
    pub fn provenance(&self, device: &str, firmware: &str, identity: &str, telemetry: &str) -> Provenance {
        Provenance {
            device: device.to_owned(),
            firmware: firmware.to_owned(),
            identity: identity.to_owned(),
            telemetry: telemetry.to_owned(),
            pulses: self.pulses().to_vec(),
            repetitions: self.repetitions(),
            groups: self.groups() as u64,
            um_per_pulse: self.array().motor().um_per_pulse,
            date: None,
        }
    }
}

impl Calibration {
    /// A calibration of motors of this array from these fits, in any order.
    ///
    /// # Errors
    /// The first thing that is wrong with it.
    pub fn new(
        array: Array,
        mut motors: Vec<MotorFit>,
        provenance: Provenance,
    ) -> Result<Self, CalibrationError> {
        motors.sort_by_key(|fit| fit.motor);
        Self::checked(array, array.hash(), motors, provenance).map_err(|fault| fault.in_file(None))
    }

    /// Like [`Self::new`], but an error numbers the motors in the order given, and the description may have had another hash.
    pub(super) fn checked(
        array: Array,
        array_hash: u64,
        motors: Vec<MotorFit>,
        provenance: Provenance,
    ) -> Result<Self, KeyError> {
        let mut calibration = Self { array, array_hash, motors, provenance };
        calibration.motors.iter_mut().for_each(shorten);
        calibration.check()?;
        calibration.motors.sort_by_key(|fit| fit.motor);
        Ok(calibration)
    }

    /// The array of its motors.
    pub const fn array(&self) -> Array {
        self.array
    }

    /// The pin's travel over the model's; 1 if the motor is not calibrated.
    pub fn gain(&self, motor: u8, direction: Direction) -> f64 {
        self.motor(motor).map_or(1.0, |fit| fit.of(direction).gain(self.array.motor()))
    }

    /// A motor's fit, if it was calibrated.
    pub fn motor(&self, motor: u8) -> Option<&MotorFit> {
        self.motors.iter().find(|fit| fit.motor == motor)
    }

    /// The motors that were calibrated, in order.
    pub fn motors(&self) -> &[MotorFit] {
        &self.motors
    }

    /// How it was made.
    pub const fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// The hash of the array's description when it was made.
    pub(super) const fn array_hash(&self) -> u64 {
        self.array_hash
    }

    /// Whether it was made with the array's description as it is now.
    pub fn is_of_description(&self) -> bool {
        self.array_hash == self.array.hash()
    }

    /// Whether both are of the same device, with the same description of its array.
    pub fn is_of_same_device(&self, other: &Self) -> bool {
        self.array == other.array
            && self.array_hash == other.array_hash
            && self.provenance.identity == other.provenance.identity
    }

    /// This calibration with the other motors of an older one of the same device. Another device's is left out.
    pub fn with_other_motors(self, old: &Self) -> Self {
        if !self.is_of_same_device(old) {
            return self;
        }
        let others = old.motors.iter().filter(|fit| self.motor(fit.motor).is_none());
        let mut motors: Vec<MotorFit> = self.motors.iter().chain(others).cloned().collect();
        motors.sort_by_key(|fit| fit.motor);
        Self { motors, ..self }
    }

    /// The gains for position control; an uncalibrated motor gets the default.
    pub fn gains(&self) -> PerMotor<Gains> {
        let model = self.array.motor();
        PerMotor::from_fn(self.array, |motor| {
            self.motor(motor).map_or_else(Gains::default, |fit| {
                let both = [Direction::Up, Direction::Down].map(|direction| fit.of(direction));
                let squares = both.map(|fit| fit.relative_sd * fit.relative_sd);
                Gains {
                    mean: both.map(|fit| fit.gain(model)),
                    sd: both.map(|fit| (fit.slope_se_um_per_pulse / model.um_per_pulse).max(LEAST_SD)),
                    scatter: ((squares[0] + squares[1]) / 2.0).sqrt().max(LEAST_SCATTER),
                }
            })
        })
    }

    fn check(&self) -> Result<(), KeyError> {
        if self.motors.is_empty() {
            return Err(KeyError::key("motor", Problem::NoMotor));
        }
        for (index, fit) in self.motors.iter().enumerate() {
            let (motor, of) = (fit.motor, format!("motor[{index}]"));
            in_range("motor", motor.into(), self.array.has(motor), self.array.motor_range())
                .map_err(|fault| KeyError::from(fault).within(&of))?;
            if let Some(other) = self.motors[..index].iter().position(|other| other.motor == motor) {
                return Err(KeyError::key("motor", Problem::Twice { motor, other }).within(&of));
            }
            let directions = [("up", &fit.up, &fit.up_points), ("down", &fit.down, &fit.down_points)];
            for (direction, fit, points) in directions {
                let checked =
                    fit.check(self.array).and_then(|()| check_points(self.array, points, fit.bursts));
                checked.map_err(|fault| fault.within(direction).within(&of))?;
            }
        }
        check_provenance(self.array, &self.provenance).map_err(|fault| fault.within("provenance"))
    }
}

/// Leaves out digits that no measurement has, so that the file stays short.
fn shorten(motor: &mut MotorFit) {
    motor.up_points.iter_mut().chain(&mut motor.down_points).for_each(|point| *point = point.rounded());
    for fit in [&mut motor.up, &mut motor.down] {
        for number in [&mut fit.slope_se_um_per_pulse, &mut fit.offset_um, &mut fit.relative_sd] {
            if number.abs() < LEAST {
                *number = 0.0;
            }
        }
    }
}

/// The largest plausible offset or travel on this array, µm, and its range in words.
fn most_um(array: Array) -> (f64, String) {
    let longest_um = f64::from(*pulses_range(array).end()) * array.motor().um_per_pulse;
    let most_um = OFFSET_UM.max(2.0 * GAIN_RANGE.end() * longest_um);
    (most_um, format!("-{} to {0} um", short_number(most_um)))
}

/// `blocks`: the bursts of the fit.
fn check_points(array: Array, points: &[FitPoint], blocks: usize) -> Result<(), KeyError> {
    if points.len() > MAX_GROUPS {
        return Err(KeyError::key("points", Problem::Points { count: points.len() }));
    }
    for (index, &FitPoint { pulses, travel_um, sd_um, bursts }) in points.iter().enumerate() {
        let key = |place| format!("points[{index}][{place}]");
        let (range, (most_um, um_range)) = (pulses_range(array), most_um(array));
        let pulses_in_words = format!("{} to {}", range.start(), range.end());
        in_range(&key(0), pulses.into(), range.contains(&pulses), pulses_in_words)?;
        in_range(&key(1), travel_um, travel_um.abs() <= most_um, um_range)?;
        let sd_in_words = format!("0 to {} um", short_number(most_um));
        in_range(&key(2), sd_um, (0.0..=most_um).contains(&sd_um), sd_in_words)?;
        in_range(&key(3), bursts as f64, (1..=MAX_BURSTS).contains(&bursts), "1 to 1000000")?;
        if let Some(before) =
            index.checked_sub(1).map(|before| points[before].pulses).filter(|&of| of >= pulses)
        {
            return Err(KeyError::key(&key(0), Problem::Order { found: pulses, before }));
        }
    }
    let found = points.iter().map(|point| point.bursts).sum();
    if points.is_empty() || found == blocks {
        return Ok(());
    }
    Err(KeyError::key("points", Problem::Bursts { found, blocks }))
}

fn check_provenance(array: Array, provenance: &Provenance) -> Result<(), KeyError> {
    let Provenance { device, firmware, identity, telemetry, pulses, repetitions, groups, um_per_pulse, date } =
        provenance;
    let words = [
        ("device", Some(device)),
        ("firmware", Some(firmware)),
        ("identity", Some(identity)),
        ("telemetry", Some(telemetry)),
        ("date", date.as_ref()),
    ];
    for (key, words) in words {
        let count = words.map_or(0, |words| words.chars().count());
        if count > MAX_WORDS {
            return Err(KeyError::key(key, Problem::Words { count }));
        }
    }
    // A plan of one motor may have longer bursts and more groups than one of all motors.
    let plan = Plan::new(array, Some(0), pulses, *repetitions)
        .map_err(|error| KeyError::key("pulses", Problem::Plan(error)))?;
    if *groups != plan.groups() as u64 {
        return Err(KeyError::key("groups", Problem::Groups { found: *groups, groups: plan.groups() }));
    }
    let model = array.motor().um_per_pulse;
    let same = (um_per_pulse - model).abs() <= ROUNDING;
    if !same {
        return Err(KeyError::key("um_per_pulse", Problem::Model { found: *um_per_pulse, model }));
    }
    Ok(())
}

impl Fit {
    fn check(&self, array: Array) -> Result<(), KeyError> {
        let (model, (most_um, um_range)) = (array.motor(), most_um(array));
        let Self { slope_um_per_pulse, slope_se_um_per_pulse, offset_um, relative_sd, bursts } = *self;
        let good = GAIN_RANGE.contains(&self.gain(model));
        let in_words = format!("0.5 to 1.5 times the model's, {}", short_number(model.um_per_pulse));
        in_range("slope_um_per_pulse", slope_um_per_pulse, good, in_words)?;
        let good = (0.0..=MAX_SLOPE_SE * slope_um_per_pulse).contains(&slope_se_um_per_pulse);
        in_range("slope_se_um_per_pulse", slope_se_um_per_pulse, good, "0 to 5 % of the slope")?;
        in_range("offset_um", offset_um, offset_um.abs() <= most_um, um_range)?;
        in_range("relative_sd", relative_sd, (0.0..=1.0).contains(&relative_sd), "0 to 1")?;
        in_range("blocks", bursts as f64, (MIN_BURSTS..=MAX_BURSTS).contains(&bursts), "10 to 1000000")?;
        Ok(())
    }
}
