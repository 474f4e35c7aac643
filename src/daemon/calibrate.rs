//! The calibration: its file, whether it is the connected device's, and what makes a new one of a plan that was played.
//!
//! A file is read when the daemon starts and when a device connects; it is used if the device is the one it was made with.
//!
//! Invariant: the file is replaced whole or not at all, and only by a calibration of the connected device.

use super::engine::{Engine, Inner};
use super::predictor::Predictor;
use crate::config;
use crate::session_record::Peer;
use crate::store::{self, Stored};
use firmware_protocol::stroke::{Direction, MOTORS};
use firmware_protocol::tick::Tick;
use jiff::Timestamp;
use meissner_api::{CalibratedMotor, CalibrationReport, Code, PlayRequest, Problem};
use meissner_api::{DeviceInfo, Event, PlayState, Receipt};
use meissner_stream::Gains;
use meissner_stream::calibrate::{Calibration, Fit, MAX_BYTES, MotorFit, Plan, fit, travels_by_telemetry};
use meissner_stream::queues::{Command, MeasuredBurst, Request};
use meissner_stream::time::HostInstant;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tracing::{info, warn};

/// Measured bursts kept of a plan at the most: the longest has 48 000, and other plays may follow.
const MOST: usize = 1 << 17;
/// What to do without one.
const ADVICE: &str = "run `meissner calibrate`";

/// A plan that is being played.
#[derive(Debug)]
pub(super) struct Calibrating {
    pub(super) id: u64,
    plan: Plan,
    travels: Vec<MeasuredBurst>,
}

impl Calibrating {
    pub(super) fn new(id: u64, plan: Plan) -> Self {
        Self { id, plan, travels: Vec::new() }
    }

    pub(super) fn add(&mut self, traveled: MeasuredBurst) {
        if self.travels.len() < MOST {
            self.travels.push(traveled);
        }
    }

    /// What was measured so far; it is played on, as far as others are concerned.
    pub(super) fn take(&mut self) -> Self {
        let Self { id, plan, travels } = self;
        Self { id: *id, plan: plan.clone(), travels: std::mem::take(travels) }
    }

    /// The fits of a plan that was played, of which device.
    pub(super) fn fit(
        &self,
        receipt: &Receipt,
        device: &DeviceInfo,
        identity: &str,
    ) -> Result<Calibration, String> {
        let onset = match receipt.onset {
            Some(onset) if receipt.state == PlayState::Done => Tick(onset.actual_tick),
            _ => {
                let why = receipt.cause.as_deref().unwrap_or("it did not begin");
                return Err(format!(
                    "the calibration was cut ({why}): nothing was stored; let it play to its end"
                ));
            }
        };
        let kind = device.kind.split(':').next().unwrap_or_default();
        let firmware = format!("{} ({})", device.firmware, device.build);
        let telemetry = if device.simulated { "plant" } else { "device" };
        let mut made = self.plan.provenance(kind, &firmware, identity, telemetry);
        made.date = Some(today());
        let fits = fit(&travels_by_telemetry(&self.plan, onset, &self.travels))
            .map_err(|error| error.to_string())?;
        if fits.is_empty() {
            return Err(format!(
                "no burst of play {} was measured: see `meissner receipt`, then again",
                self.id
            ));
        }
        Calibration::new(fits, made).map_err(|error| error.to_string())
    }
}

/// UTC, to the second.
fn today() -> String {
    Timestamp::now().strftime("%FT%TZ").to_string()
}

/// What the file says, and why it is not used.
#[derive(Clone, Debug)]
pub(super) struct Kept {
    pub(super) calibration: Arc<Calibration>,
    pub(super) unused: Option<String>,
}

/// Reads the file; why there is none, and whether that is the file's fault.
pub(super) fn read(file: Option<&Path>, identity: Option<&str>) -> Result<Kept, (String, bool)> {
    let none = || (format!("nothing was calibrated yet: {ADVICE}"), false);
    let file = file.ok_or_else(none)?;
    let bytes = match config::read_regular(file, MAX_BYTES as u64) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(none()),
        bytes => {
            bytes.map_err(|error| (format!("{}: {error}; mend it, or {ADVICE}", file.display()), true))?
        }
    };
    let bad = |what: String| (format!("{what}; not used: mend it, or {ADVICE}"), true);
    let name = file.display().to_string();
    let text = String::from_utf8(bytes).map_err(|_| bad(format!("{name}: not UTF-8 text")))?;
    let calibration = Calibration::parse(&text, &name).map_err(|error| bad(error.to_string()))?;
    let unused = match identity {
        Some(identity) if identity == calibration.provenance().identity => None,
        Some(_) => Some(format!("{name} is of another device: not used; {ADVICE}")),
        None => Some("no device is connected".to_owned()),
    };
    Ok(Kept { calibration: Arc::new(calibration), unused })
}

/// Adds what an older calibration of the same device says of other motors.
pub(super) fn with_others(new: Calibration, old: Option<&Kept>) -> Calibration {
    let old = old.map(|old| &old.calibration);
    let Some(old) = old.filter(|old| old.provenance().identity == new.provenance().identity) else {
        return new;
    };
    let others = old.motors().iter().filter(|fit| new.motor(fit.motor).is_none());
    let motors: Vec<MotorFit> = new.motors().iter().chain(others).copied().collect();
    // Both were checked.
    Calibration::new(motors, new.provenance().clone()).unwrap_or(new)
}

/// Puts it in its place.
pub(super) fn write(file: &Path, calibration: &Calibration) -> Result<(), String> {
    let dir = file.parent().filter(|dir| !dir.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let written = fs::create_dir_all(dir);
    let written = written.and_then(|()| store::replace(dir, file, calibration.to_toml().as_bytes()));
    written.map_err(|error| {
        format!(
            "{}: cannot be written: {error}; set `calibration` in the daemon's configuration",
            file.display()
        )
    })
}

/// What clients are told of it.
pub(super) fn report(
    file: Option<&PathBuf>,
    kept: &Result<Kept, String>,
) -> Result<CalibrationReport, Problem> {
    let Kept { calibration, unused } =
        kept.as_ref().map_err(|detail| Problem::new(Code::NotFound, detail.clone()))?;
    let motor = |fit: &MotorFit| {
        let both = [Direction::Up, Direction::Down].map(|direction| fit.of(direction));
        let [gain_up, gain_down] = both.map(Fit::gain);
        let [gain_up_se, gain_down_se] =
            both.map(|fit| fit.slope_se_um_per_pulse / fit.slope_um_per_pulse * fit.gain());
        let [relative_sd_up, relative_sd_down] = both.map(|fit| fit.relative_sd);
        CalibratedMotor {
            motor: fit.motor,
            gain_up,
            gain_up_se,
            gain_down,
            gain_down_se,
            relative_sd_up,
            relative_sd_down,
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

impl Engine {
    /// Reads what is known of a device's motors, or of nobody's yet, and says what is wrong with it: once, if that stays.
    pub(super) fn recall(&self, identity: Option<&str>) {
        let file = self.lock().calibration_file.clone();
        let (found, bad) = match read(file.as_deref(), identity) {
            Ok(kept) => (Ok(kept), false),
            Err((why, bad)) => (Err(why), bad),
        };
        let why = |found: &Result<Kept, String>| match found {
            Ok(kept) => kept.unused.clone(),
            Err(why) => Some(why.clone()),
        };
        let old = {
            let mut inner = self.lock();
            inner.identity = identity.unwrap_or_default().to_owned();
            std::mem::replace(&mut inner.calibration, found.clone())
        };
        match why(&found) {
            why_not if why_not == why(&old) => {}
            Some(why_not) if bad || identity.is_some() && found.is_ok() => warn!("{why_not}"),
            Some(_) => {}
            None => {
                info!("{} motors are calibrated", found.map_or(0, |kept| kept.calibration.motors().len()));
            }
        }
    }

    /// CommandQueue the play of a plan, open loop, and waits for its being taken.
    pub(super) async fn calibrate(&self, plan: Plan, who: Peer) -> Result<u64, Problem> {
        if self.lock().calibration_file.is_none() {
            let detail =
                "there is no place for a calibration: set `calibration` in the daemon's configuration";
            return Err(Problem::new(Code::Store, detail));
        }
        let stored = Stored::made(plan.pattern());
        let pattern = stored.pattern.name().to_owned();
        let request = PlayRequest { pattern, open_loop: true, ..PlayRequest::default() };
        self.begin(&request, &stored, who, Some(plan)).await
    }

    /// `GET /v1/calibration`.
    pub(super) fn calibration(&self) -> Result<CalibrationReport, Problem> {
        let inner = self.lock();
        report(inner.calibration_file.as_ref(), &inner.calibration)
    }

    /// Has a plan fitted that has been played.
    pub(super) fn fit(self: &Arc<Self>, feeler: &Predictor, id: u64) {
        let mut inner = self.lock();
        let Some(receipt) = inner.receipts.receipt(id).filter(|receipt| receipt.state.is_over()).cloned()
        else {
            return;
        };
        let calibrating = inner.calibrating.as_mut().filter(|calibrating| calibrating.id == id);
        let Some(calibrating) = calibrating.map(Calibrating::take) else { return };
        let (device, identity) = (inner.receipts.device(), inner.identity.clone());
        drop(inner);
        let engine = Arc::clone(self);
        feeler.compute(move || {
            let fitted = device.ok_or_else(|| "the device is gone: nothing was stored".to_owned());
            let fitted = fitted.and_then(|device| calibrating.fit(&receipt, &device, &identity));
            engine.keep(id, fitted);
        });
    }

    /// Stores a calibration and goes by it from now on; or says why there is none.
    fn keep(&self, id: u64, fitted: Result<Calibration, String>) {
        let motors = fitted.iter().flat_map(|new| new.motors().iter().map(|fit| fit.motor)).collect();
        let stored = fitted.and_then(|new| {
            let (file, all) = {
                let inner = self.lock();
                let file = inner.calibration_file.clone().ok_or("there is no place for it")?;
                (file, with_others(new, inner.calibration.as_ref().ok()))
            };
            write(&file, &all)?;
            Ok(Kept { calibration: Arc::new(all), unused: None })
        });
        let mut inner = self.lock();
        inner.calibrating = None;
        let problem = match stored {
            Ok(kept) => {
                let sent = inner.teach(kept.calibration.gains());
                inner.taught = true;
                inner.calibration = Ok(kept);
                sent.err().map(|_| {
                    "it is stored, but too many orders wait: it is used from the next connection on"
                        .to_owned()
                })
            }
            Err(problem) => Some(problem),
        };
        let event = Event::Calibrated { id, motors, problem };
        inner.publish(&event);
        drop(inner);
        self.log(&event);
        self.stirred.notify_one();
    }
}

impl Inner {
    /// The calibration that is used.
    pub(super) fn used(&self) -> Option<&Kept> {
        self.calibration.as_ref().ok().filter(|kept| kept.unused.is_none())
    }

    /// Has the streamer go by these gains.
    pub(super) fn teach(&mut self, gains: [Gains; MOTORS]) -> Result<(), Request> {
        let job = Command::SetGains(Box::new(gains));
        self.orders.send(Request { ticket: 0, issued_at: HostInstant::now(), command: job })
    }
}
