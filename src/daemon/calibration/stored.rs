//! Calibration files, and the fit of a played plan, without the daemon's state.
//!
//! [`read`] and [`write()`] are the file, [`CalibrationRun`] collects the measured bursts of a plan and fits them, [`report`] makes
//! the answer for clients.
//!
//! Invariant: the file is replaced atomically.

use crate::clock::utc_text;
use crate::daemon::sessions::caller::Caller;
use crate::file::{self, read_regular};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_api::{
    CalibratedMotor, CalibrationReport, Code, DeviceInfo, EndCause, FittedLine, MeasuredPoint, PlayState,
    Problem, Receipt,
};
use meissner_array::spec::Array;
use meissner_stream::calibrate::{
    Calibration, Fit, FitPoint, MAX_BYTES, MotorFit, Plan, fit, travels_by_telemetry,
};
use meissner_stream::queues::MeasuredBurst;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::{fs, io};

/// Measured bursts kept of a plan, at most: the longest plan has 48 000, and other plays may follow.
const MAX_BURSTS: usize = 1 << 17;
const ADVICE: &str = "run `meissner calibrate`";

/// The problem that the configuration names no file.
pub(in crate::daemon) fn no_file() -> Problem {
    let detail = "there is no file for the calibration: set `calibration` in the daemon's configuration";
    Problem::new(Code::Store, detail)
}

/// A plan that is being played, and its measured bursts.
#[derive(Debug)]
pub(in crate::daemon) struct CalibrationRun {
    pub(in crate::daemon) id: u64,
    /// The client that has ordered it.
    pub(in crate::daemon) by: Caller,
    plan: Plan,
    bursts: Vec<MeasuredBurst>,
}

impl CalibrationRun {
    pub(in crate::daemon) fn new(id: u64, by: Caller, plan: Plan) -> Self {
        Self { id, by, plan, bursts: Vec::new() }
    }

    pub(in crate::daemon) fn add(&mut self, burst: MeasuredBurst) {
        if self.bursts.len() < MAX_BURSTS {
            self.bursts.push(burst);
        }
    }

    /// Takes the measured bursts; the rest stays, so that other plays are still refused.
    pub(in crate::daemon) fn take(&mut self) -> Self {
        let Self { id, by, plan, bursts } = self;
        Self { id: *id, by: by.clone(), plan: plan.clone(), bursts: std::mem::take(bursts) }
    }

    /// Fits a plan that was played on this device.
    pub(in crate::daemon) fn fit(
        &self,
        receipt: &Receipt,
        device: &DeviceInfo,
        identity: &str,
    ) -> Result<Calibration, String> {
        let array = self.plan.array();
        let onset = match receipt.onset {
            Some(onset) if receipt.state == PlayState::Done => Tick(onset.actual_tick),
            _ => {
                let why = receipt.cause.as_ref().map_or("it did not begin", EndCause::text);
                return Err(format!(
                    "the calibration was cut ({why}): nothing was stored; let it play to its end"
                ));
            }
        };
        let kind = device.kind.split(':').next().unwrap_or_default();
        let firmware = format!("{} ({})", device.firmware, device.build);
        let telemetry = if device.simulated { "plant" } else { "device" };
        let mut provenance = self.plan.provenance(kind, &firmware, identity, telemetry);
        provenance.date = Some(utc_text());
        let fits = fit(array, &travels_by_telemetry(&self.plan, onset, &self.bursts))
            .map_err(|error| error.to_string())?;
        if fits.is_empty() {
            return Err(format!(
                "no burst of play {} was measured: see `meissner receipt`, then calibrate again",
                self.id
            ));
        }
        Calibration::new(array, fits, provenance).map_err(|error| error.to_string())
    }
}

/// The file's calibration, and why it is not in use.
#[derive(Clone, Debug)]
pub(in crate::daemon) struct StoredCalibration {
    pub(in crate::daemon) calibration: Arc<Calibration>,
    pub(in crate::daemon) unused: Option<String>,
}

/// Reads the file for the device of that identity, whose array this is. The error says why there is no calibration, and whether the file is at fault.
pub(in crate::daemon) fn read(
    array: Array,
    file: Option<&Path>,
    identity: Option<&str>,
) -> Result<StoredCalibration, (String, bool)> {
    let none = || (format!("nothing was calibrated yet: {ADVICE}"), false);
    let file = file.ok_or_else(none)?;
    let bytes = match read_regular(file, MAX_BYTES as u64) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(none()),
        bytes => {
            bytes.map_err(|error| (format!("{}: {error}; correct it, or {ADVICE}", file.display()), true))?
        }
    };
    let bad = |what: String| (format!("{what}; not used: correct it, or {ADVICE}"), true);
    let name = file.display().to_string();
    let text = String::from_utf8(bytes).map_err(|_| bad(format!("{name}: not UTF-8 text")))?;
    let calibration = Calibration::parse(&text, &name).map_err(|error| bad(error.to_string()))?;
    let its = calibration.array();
    let unused = match identity {
        _ if its != array => Some(format!(
            "{name} is for the array {}, and this one is {}: not used; {ADVICE}",
            its.name(),
            array.name()
        )),
        Some(identity)
            if identity == calibration.provenance().identity && calibration.is_of_description() =>
        {
            None
        }
        Some(_) => Some(format!("{name} belongs to another device: not used; {ADVICE}")),
        None => Some("no device is connected".to_owned()),
    };
    Ok(StoredCalibration { calibration: Arc::new(calibration), unused })
}

/// Adds the other motors of an older calibration of the same device.
pub(in crate::daemon) fn with_other_motors(new: Calibration, old: Option<&StoredCalibration>) -> Calibration {
    match old {
        Some(old) => new.with_other_motors(&old.calibration),
        None => new,
    }
}

/// Replaces the file. One of another device or array, or one that cannot be read, is kept beside it.
pub(in crate::daemon) fn write(file: &Path, calibration: &Calibration) -> Result<(), String> {
    let written = file::make_dirs(file::dir_of(file), file::LISTED_BY_ALL);
    let written = written
        .and_then(|()| keep_other(file, calibration))
        .and_then(|()| file::replace(file, calibration.to_toml().as_bytes(), file::READABLE_BY_ALL));
    written.map_err(|error| {
        format!(
            "{}: cannot be written: {error}; set `calibration` in the daemon's configuration",
            file.display()
        )
    })
}

/// Renames a file that `new` does not continue to the first free name of `NAME.1.toml`, `NAME.2.toml` and so on.
fn keep_other(file: &Path, new: &Calibration) -> io::Result<()> {
    let old = match read_regular(file, MAX_BYTES as u64) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        bytes => bytes.ok().and_then(|bytes| String::from_utf8(bytes).ok()),
    };
    let old = old.and_then(|text| Calibration::parse(&text, "").ok());
    let continues = old.is_some_and(|old| {
        let same = old.array() == new.array() && old.provenance().identity == new.provenance().identity;
        same && old.is_of_description()
    });
    if continues {
        return Ok(());
    }
    let names = (1..).map(|number: u32| file.with_extension(format!("{number}.toml")));
    let Some(kept) = names.into_iter().find(|kept| !kept.exists()) else { return Ok(()) };
    fs::rename(file, &kept)?;
    tracing::warn!(
        "{}: was of another device or could not be read; kept as {}",
        file.display(),
        kept.display()
    );
    Ok(())
}

/// The calibration for clients.
pub(in crate::daemon) fn report(
    array: Array,
    file: Option<&PathBuf>,
    stored: &Result<StoredCalibration, String>,
) -> Result<CalibrationReport, Problem> {
    let StoredCalibration { calibration, unused } =
        stored.as_ref().map_err(|detail| Problem::new(Code::NotFound, detail.clone()))?;
    let point = |&FitPoint { pulses, travel_um, sd_um, bursts }: &FitPoint| MeasuredPoint {
        pulses,
        travel_um,
        sd_um,
        bursts: bursts as u64,
    };
    let line = |fit: &Fit, points: &[FitPoint]| FittedLine {
        slope_um_per_pulse: fit.slope_um_per_pulse,
        offset_um: fit.offset_um,
        bursts: fit.bursts as u64,
        points: points.iter().map(point).collect(),
    };
    let motor_spec = array.motor();
    let motor = |fit: &MotorFit| {
        let both = [Direction::Up, Direction::Down].map(|direction| fit.of(direction));
        let [gain_up, gain_down] = both.map(|fit| fit.gain(motor_spec));
        let [gain_up_se, gain_down_se] =
            both.map(|fit| fit.slope_se_um_per_pulse / fit.slope_um_per_pulse * fit.gain(motor_spec));
        let [relative_sd_up, relative_sd_down] = both.map(|fit| fit.relative_sd);
        CalibratedMotor {
            motor: fit.motor,
            gain_up,
            gain_up_se,
            gain_down,
            gain_down_se,
            relative_sd_up,
            relative_sd_down,
            up: line(&fit.up, &fit.up_points),
            down: line(&fit.down, &fit.down_points),
        }
    };
    Ok(CalibrationReport {
        file: file.map(|file| file.display().to_string()).unwrap_or_default(),
        used: unused.is_none(),
        unused: unused.clone(),
        motors: calibration.motors().iter().map(motor).collect(),
        provenance: calibration.provenance().clone(),
        toml: calibration.to_toml(),
    })
}
