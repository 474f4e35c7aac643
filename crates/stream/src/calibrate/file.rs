//! The calibration: gains of motors, what they were fitted by, and its file.
//!
//! The file is TOML: `format = 1`, a `[[motor]]` for each motor with its `up` and `down`, and `[provenance]`. It has slopes and the gains
//! that follow from them, for people and other programs; that they agree is checked. No date is in it but one
//! that the caller hands in as words.
//!
//! Invariant: what is written is read again as the same calibration, bit for bit; no key is ignored.

use super::error::{Fault, Problem};
use super::{CalibrationError, Fit, GAIN_RANGE, MAX_SLOPE_SE, MIN_BURSTS, MotorFit, Plan};
use firmware_protocol::stroke::{Direction, MOTORS};
use meissner_api::Provenance;
use meissner_array::units::UM_PER_PULSE;
use meissner_input::document::{Keyed, from_toml, in_range, line_of};
use serde::{Deserialize, Serialize};

/// The version of the file format this program reads and writes.
pub const FORMAT: u8 = 1;
/// Bytes of a calibration file at the most; all motors and the longest words take less.
pub const MAX_BYTES: usize = 64 << 10;
/// Characters of each of the provenance's words.
pub(super) const MAX_WORDS: usize = 200;
/// Offsets that are believed, µm: a burst of the fewest pulses moves a pin by one.
const OFFSET_UM: f64 = 100.0;
/// What a gain and its slope may differ by, and the model's constant: another program may write fewer digits.
const ROUNDING: f64 = 1e-6;

/// What pins are known to do.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    motors: Vec<MotorFit>,
    provenance: Provenance,
}

impl Plan {
    /// How a calibration by this plan was made, on this device; without a date.
    #[must_use]
    pub fn provenance(&self, device: &str, firmware: &str, identity: &str, telemetry: &str) -> Provenance {
        Provenance {
            device: device.to_owned(),
            firmware: firmware.to_owned(),
            identity: identity.to_owned(),
            telemetry: telemetry.to_owned(),
            pulses: self.pulses().to_vec(),
            repetitions: self.repetitions(),
            groups: self.groups() as u64,
            um_per_pulse: UM_PER_PULSE,
            date: None,
        }
    }
}

fn check_provenance(provenance: &Provenance) -> Result<(), Fault> {
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
            return Err(Fault::key(key, Problem::Words { count }));
        }
    }
    let plan =
        Plan::new(None, pulses, *repetitions).map_err(|error| Fault::key("pulses", Problem::Plan(error)))?;
    if *groups != plan.groups() as u64 {
        return Err(Fault::key("groups", Problem::Groups { found: *groups, groups: plan.groups() }));
    }
    let same = (um_per_pulse - UM_PER_PULSE).abs() <= ROUNDING;
    if !same {
        return Err(Fault::key("um_per_pulse", Problem::Model { found: *um_per_pulse }));
    }
    Ok(())
}

impl Calibration {
    /// Makes one of fits and of what made them.
    ///
    /// # Errors
    /// The first thing that is wrong with it.
    pub fn new(mut motors: Vec<MotorFit>, provenance: Provenance) -> Result<Self, CalibrationError> {
        motors.sort_by_key(|fit| fit.motor);
        let calibration = Self { motors, provenance };
        calibration.check().map_err(|fault| fault.placed(None))?;
        Ok(calibration)
    }

    /// Reads a calibration file; `file` is what errors call it.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn parse(text: &str, file: &str) -> Result<Self, CalibrationError> {
        read(text).map_err(|fault| fault.placed(Some(file)))
    }

    /// It as a file, which [`Self::parse`] reads back as the same calibration.
    #[must_use]
    #[expect(clippy::missing_panics_doc, reason = "it does not happen")]
    pub fn to_toml(&self) -> String {
        let motor = self.motors.iter().map(|&MotorFit { motor, up, down }| RawMotor {
            motor: motor.into(),
            up: Keyed(up.into()),
            down: Keyed(down.into()),
        });
        let file = RawFile {
            format: FORMAT.into(),
            motor: motor.map(Keyed).collect(),
            provenance: Keyed(self.provenance.clone()),
        };
        toml::to_string(&file).expect("a calibration is tables of strings and numbers")
    }

    /// What the pin really does of what the model says; 1 if the motor is not calibrated.
    #[must_use]
    pub fn gain(&self, motor: u8, direction: Direction) -> f64 {
        self.motor(motor).map_or(1.0, |fit| fit.of(direction).gain())
    }

    /// A motor's fit, if it was calibrated.
    #[must_use]
    pub fn motor(&self, motor: u8) -> Option<&MotorFit> {
        self.motors.iter().find(|fit| fit.motor == motor)
    }

    /// The motors that were calibrated, in order.
    #[must_use]
    pub fn motors(&self) -> &[MotorFit] {
        &self.motors
    }

    /// What made it.
    #[must_use]
    pub const fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    fn check(&self) -> Result<(), Fault> {
        if self.motors.is_empty() {
            return Err(Fault::key("motor", Problem::NoMotor));
        }
        for (index, fit) in self.motors.iter().enumerate() {
            let (motor, of) = (fit.motor, format!("motor[{index}]"));
            in_range("motor", motor.into(), usize::from(motor) < MOTORS, "0 to 23")
                .map_err(|fault| Fault::from(fault).within(&of))?;
            if let Some(other) = self.motors[..index].iter().position(|other| other.motor == motor) {
                return Err(Fault::key("motor", Problem::Twice { motor, other }).within(&of));
            }
            for (way, fit) in [("up", &fit.up), ("down", &fit.down)] {
                fit.check().map_err(|fault| fault.within(way).within(&of))?;
            }
        }
        check_provenance(&self.provenance).map_err(|fault| fault.within("provenance"))
    }
}

impl Fit {
    fn check(&self) -> Result<(), Fault> {
        let Self { slope_um_per_pulse, slope_se_um_per_pulse, offset_um, relative_sd, bursts } = *self;
        let good = GAIN_RANGE.contains(&self.gain());
        in_range("slope_um_per_pulse", slope_um_per_pulse, good, "0.5 to 1.5 times the model's, 0.95/7")?;
        let good = (0.0..=MAX_SLOPE_SE * slope_um_per_pulse).contains(&slope_se_um_per_pulse);
        in_range("slope_se_um_per_pulse", slope_se_um_per_pulse, good, "0 to 5 % of the slope")?;
        in_range("offset_um", offset_um, offset_um.abs() <= OFFSET_UM, "-100 to 100 um")?;
        in_range("relative_sd", relative_sd, (0.0..=1.0).contains(&relative_sd), "0 to 1")?;
        in_range("blocks", bursts as f64, bursts >= MIN_BURSTS, "10 or more")?;
        Ok(())
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawFile {
    format: u64,
    motor: Vec<Keyed<RawMotor>>,
    provenance: Keyed<Provenance>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawMotor {
    motor: u64,
    up: Keyed<RawFit>,
    down: Keyed<RawFit>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawFit {
    gain: f64,
    slope_um_per_pulse: f64,
    slope_se_um_per_pulse: f64,
    offset_um: f64,
    relative_sd: f64,
    blocks: u64,
}

/// Read first: another format may have other keys.
#[derive(Deserialize)]
struct Version {
    format: u64,
}

fn wanted(key: &str) -> &'static str {
    match key {
        "format" => "format = 1",
        "motor" => "a motor's number, 0 to 23, below each [[motor]]",
        "up" | "down" => "[motor.up] and [motor.down], what the motor does either way",
        "provenance" => "[provenance], what made it",
        "device" | "firmware" | "identity" | "telemetry" => "which it was, in quotes",
        "pulses" => "the numbers of pulses that were played, as [14, 28]",
        "repetitions" | "groups" => "how many were played",
        "um_per_pulse" => "the model's constant",
        _ => "a number, as `meissner calibrate` writes it",
    }
}

fn read(text: &str) -> Result<Calibration, Fault> {
    if text.len() > MAX_BYTES {
        return Err(Fault::whole(None, Problem::TooLarge { bytes: text.len() }));
    }
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let placed = |fault: Fault| Fault { line: fault.line.or_else(|| line_of(text, &fault.path)), ..fault };
    let Keyed(Version { format: found }) = from_toml(text, wanted)?;
    if found != u64::from(FORMAT) {
        return Err(placed(Fault::key("format", Problem::Format { found })));
    }
    let Keyed(raw): Keyed<RawFile> = from_toml(text, wanted)?;
    raw.calibration().map_err(placed)
}

impl RawFile {
    fn calibration(self) -> Result<Calibration, Fault> {
        let motors = self.motor.into_iter().enumerate();
        let motors = motors
            .map(|(index, Keyed(raw))| raw.fit().map_err(|fault| fault.within(&format!("motor[{index}]"))));
        let mut calibration =
            Calibration { motors: motors.collect::<Result<_, _>>()?, provenance: self.provenance.0 };
        calibration.check()?;
        calibration.motors.sort_by_key(|fit| fit.motor);
        Ok(calibration)
    }
}

impl RawMotor {
    fn fit(self) -> Result<MotorFit, Fault> {
        let motor = u8::try_from(self.motor).unwrap_or(u8::MAX);
        in_range("motor", self.motor as f64, usize::from(motor) < MOTORS, "0 to 23")?;
        let fit = |Keyed(raw): Keyed<RawFit>, way| raw.fit().map_err(|fault| fault.within(way));
        Ok(MotorFit { motor, up: fit(self.up, "up")?, down: fit(self.down, "down")? })
    }
}

impl RawFit {
    fn fit(self) -> Result<Fit, Fault> {
        let Self { gain, slope_um_per_pulse, slope_se_um_per_pulse, offset_um, relative_sd, blocks } = self;
        let bursts = usize::try_from(blocks).unwrap_or(usize::MAX);
        let fit = Fit { slope_um_per_pulse, slope_se_um_per_pulse, offset_um, relative_sd, bursts };
        let slope = fit.gain();
        if (gain - slope).abs() <= ROUNDING || !slope.is_finite() {
            return Ok(fit);
        }
        Err(Fault::key("gain", Problem::Gain { found: gain, slope }))
    }
}

impl From<Fit> for RawFit {
    fn from(fit: Fit) -> Self {
        let Fit { slope_um_per_pulse, slope_se_um_per_pulse, offset_um, relative_sd, bursts } = fit;
        let (gain, blocks) = (fit.gain(), bursts as u64);
        Self { gain, slope_um_per_pulse, slope_se_um_per_pulse, offset_um, relative_sd, blocks }
    }
}
