//! The calibration's file: TOML with `format`, a `[[motor]]` with `up` and `down` for each motor, and `[provenance]`.
//!
//! [`Calibration::parse`] reads it, [`Calibration::to_toml`] writes it. The file has the slopes, and beside them the gains
//! that follow from them, for people and other programs; `parse` checks that they agree. It has no date but the text that the
//! caller put into the provenance.
//!
//! Invariant: a written calibration reads back as the same calibration, bit for bit; no key is ignored.

use crate::calibrate::calibration::{
    Calibration, CalibrationError, FORMAT, KeyError, MAX_BYTES, Problem, ROUNDING,
};
use crate::calibrate::fit::{Fit, FitPoint, MotorFit};
use meissner_api::Provenance;
use meissner_array::spec::{Array, MotorSpec};
use meissner_input::document::{Table, from_toml, in_range, line_of};
use meissner_input::message::quote;
use serde::{Deserialize, Serialize};

impl Calibration {
    /// Reads a calibration file; `file` is what errors call it.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn parse(text: &str, file: &str) -> Result<Self, CalibrationError> {
        read(text).map_err(|fault| fault.in_file(Some(file)))
    }

    /// The text of its file, which [`Self::parse`] reads back as the same calibration.
    pub fn to_toml(&self) -> String {
        let (array, model) = (self.array(), self.array().spec().motor());
        let motor = self.motors().iter().map(|fit| RawMotor {
            motor: fit.motor.into(),
            up: Table(RawFit::of(model, fit.up, &fit.up_points)),
            down: Table(RawFit::of(model, fit.down, &fit.down_points)),
        });
        let file = RawFile {
            format: FORMAT.into(),
            array: (array != Array::default()).then(|| array.name().to_owned()),
            array_hash: (array != Array::default()).then(|| format!("{:016x}", self.array_hash())),
            motor: motor.map(Table).collect(),
            provenance: Table(self.provenance().clone()),
        };
        toml::to_string(&file).expect("a calibration is tables of strings and numbers")
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawFile {
    format: u64,
    /// Without it: the paper's.
    #[serde(skip_serializing_if = "Option::is_none")]
    array: Option<String>,
    /// Without it: as the description is now. That of the paper's array does not change.
    #[serde(skip_serializing_if = "Option::is_none")]
    array_hash: Option<String>,
    motor: Vec<Table<RawMotor>>,
    provenance: Table<Provenance>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawMotor {
    motor: u64,
    up: Table<RawFit>,
    down: Table<RawFit>,
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
    /// Pulses, mean travel, its standard deviation, number of bursts; none if they are not known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    points: Vec<(u16, f64, f64, u64)>,
}

/// Read first, because another format may have other keys.
#[derive(Deserialize)]
struct Version {
    format: u64,
}

fn wanted(key: &str) -> &'static str {
    match key {
        "format" => "format = 1",
        "array_hash" => "the hash of the array's description, 16 hexadecimal digits in quotes",
        "motor" => "a motor's number, from 0 on, below each [[motor]]",
        "up" | "down" => "[motor.up] and [motor.down], the fits of both directions",
        "provenance" => "[provenance], how it was made",
        "device" | "firmware" | "identity" | "telemetry" => "its description, in quotes",
        "pulses" => "the numbers of pulses that were played, as [14, 28]",
        "repetitions" | "groups" => "how many were played",
        "um_per_pulse" => "the model's constant",
        _ => "a number, as `meissner calibrate` writes it",
    }
}

fn read(text: &str) -> Result<Calibration, KeyError> {
    if text.len() > MAX_BYTES {
        return Err(KeyError::whole(None, Problem::TooLarge { bytes: text.len() }));
    }
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let placed =
        |fault: KeyError| KeyError { line: fault.line.or_else(|| line_of(text, &fault.path)), ..fault };
    let Table(Version { format: found }) = from_toml(text, wanted)?;
    if found != u64::from(FORMAT) {
        return Err(placed(KeyError::key("format", Problem::Format { found })));
    }
    let Table(raw): Table<RawFile> = from_toml(text, wanted)?;
    raw.calibration().map_err(placed)
}

impl RawFile {
    fn calibration(self) -> Result<Calibration, KeyError> {
        let array = match self.array {
            None => Array::default(),
            Some(name) => {
                Array::named(&name).map_err(|unknown| KeyError::key("array", Problem::Array(unknown)))?
            }
        };
        let array_hash = match &self.array_hash {
            None => array.hash(),
            Some(hash) => u64::from_str_radix(hash, 16)
                .map_err(|_| KeyError::key("array_hash", Problem::Hash { found: quote(hash) }))?,
        };
        let motors = self.motor.into_iter().enumerate().map(|(index, Table(raw))| {
            raw.fit(array).map_err(|fault| fault.within(&format!("motor[{index}]")))
        });
        Calibration::checked(array, array_hash, motors.collect::<Result<_, _>>()?, self.provenance.0)
    }
}

impl RawMotor {
    fn fit(self, array: Array) -> Result<MotorFit, KeyError> {
        let motor = u8::try_from(self.motor).unwrap_or(u8::MAX);
        in_range("motor", self.motor as f64, array.has(motor), array.motor_range())?;
        let fit = |Table(raw): Table<RawFit>, direction| {
            raw.parts(array.motor()).map_err(|fault| fault.within(direction))
        };
        let (up, up_points) = fit(self.up, "up")?;
        let (down, down_points) = fit(self.down, "down")?;
        Ok(MotorFit { motor, up, down, up_points, down_points })
    }
}

impl RawFit {
    fn of(model: &MotorSpec, fit: Fit, points: &[FitPoint]) -> Self {
        let Fit { slope_um_per_pulse, slope_se_um_per_pulse, offset_um, relative_sd, bursts } = fit;
        let (gain, blocks) = (fit.gain(model), bursts as u64);
        let point = |at: &FitPoint| (at.pulses, at.travel_um, at.sd_um, at.bursts as u64);
        let points = points.iter().map(point).collect();
        Self { gain, slope_um_per_pulse, slope_se_um_per_pulse, offset_um, relative_sd, blocks, points }
    }

    fn parts(self, model: &MotorSpec) -> Result<(Fit, Vec<FitPoint>), KeyError> {
        let Self { gain, slope_um_per_pulse, slope_se_um_per_pulse, offset_um, relative_sd, blocks, points } =
            self;
        let count = |bursts| usize::try_from(bursts).unwrap_or(usize::MAX);
        let point =
            |(pulses, travel_um, sd_um, bursts)| FitPoint { pulses, travel_um, sd_um, bursts: count(bursts) };
        let fit =
            Fit { slope_um_per_pulse, slope_se_um_per_pulse, offset_um, relative_sd, bursts: count(blocks) };
        let slope = fit.gain(model);
        if (gain - slope).abs() <= ROUNDING || !slope.is_finite() {
            return Ok((fit, points.into_iter().map(point).collect()));
        }
        Err(KeyError::key("gain", Problem::Gain { found: gain, slope }))
    }
}
