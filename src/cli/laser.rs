//! Calibration with a laser: `calibrate --plan` plays the bursts of one motor, `calibrate --from` fits a recording of them.
//!
//! The daemon plays; this command writes the plan, and later fits. Then the daemon stores the gains, or `-o` names a file.
//!
//! Invariant: a plan is written only if every one of its bursts was played.

use super::arguments::ClientOptions;
use super::ending::Ending;
use super::output::give;
use super::progress::Progress;
use super::{control, files, text};
use crate::array::shown;
use crate::receipts::calibration_plan;
use crate::session_record::utc_now;
use anyhow::{Result, anyhow, bail};
use firmware_protocol::tick::Tick;
use meissner_api::{CalibrateRequest, CalibrationReport, PlayAccepted, Status};
use meissner_stream::calibrate::{
    Calibration, Figure, LaserFit, Layout, MAX_BYTES, MAX_PLAN_BYTES, MAX_RECORDING_BYTES, PlayedOn,
    PlayedPlan, Recording, fit_recording,
};
use serde::Serialize;
use std::path::Path;
use std::process::ExitCode;

/// The plan's file if the command line names none.
pub(super) const DEFAULT_PLAN: &str = "calibration-plan.json";

/// Plays a plan and writes what was played.
pub(super) fn play(request: &CalibrateRequest, out: &Path, options: &ClientOptions) -> Result<ExitCode> {
    if request.motor.is_none() {
        bail!("--motor is missing: name the one motor whose pin the laser measures");
    }
    let file = files::beside(out)?;
    let mut client = options.client()?;
    let plan = calibration_plan(shown(&client.get("/v1/array")?)?, request)?;
    let before: Status = client.get("/v1/status")?;
    let mut events = client.events()?;
    let ending = Ending::listen(options)?;
    let PlayAccepted { id, .. } = ending.order(|| client.post("/v1/calibrate", request))?;
    let mut progress = Progress::new(Some(plan.duration_s()), options.output.json);
    let receipt = control::follow(&mut client, &mut events, id, &mut progress)?;
    ending.set_over();
    let after: Status = client.get("/v1/status")?;
    let boot = |status: &Status| status.device.as_ref().map(|device| device.boot);
    let (Some(device), Some(onset)) = (&after.device, receipt.onset) else {
        bail!("the plan was not played: see `meissner receipt {id}`; nothing was written");
    };
    if !receipt.all_played() || boot(&before) != boot(&after) {
        bail!(
            "not every burst was played: see `meissner receipt {id}`; nothing was written, play the plan again"
        );
    }
    let motor = request.motor.unwrap_or_default();
    let on = PlayedOn {
        device: device.kind.split(':').next().unwrap_or_default().to_owned(),
        firmware: format!("{} ({})", device.firmware, device.build),
        identity: after.device_identity.clone(),
        boot: device.boot,
        date: utc_now(),
    };
    let played = PlayedPlan::new(&plan, motor, Tick(onset.actual_tick), on);
    file.write(&played.to_json())?;
    give(options.output.json, &played, || {
        let bursts =
            format!("{} of motor {motor} in {:.0} s, all played", played.bursts().len(), played.duration_s());
        let next = format!("meissner calibrate --from RECORDING.csv --plan {}", files::shown(out));
        text::pairs(&[("bursts", bursts), ("written", files::shown(out)), ("next", next)])
    })
}

/// The arguments of `calibrate --from`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit<'a> {
    pub(super) recording: &'a Path,
    pub(super) plan: &'a Path,
    pub(super) layout: &'a Layout,
    pub(super) out: Option<&'a Path>,
    pub(super) options: &'a ClientOptions,
}

/// The document of `--json`.
#[derive(Serialize)]
struct Fitted<'a> {
    #[serde(flatten)]
    fit: &'a LaserFit,
    /// Where the gains are stored.
    file: &'a str,
}

/// Fits a recording, and stores the gains.
pub(super) fn fit(asked: &Fit<'_>) -> Result<ExitCode> {
    let at = |file: &Path, error: &dyn std::fmt::Display| anyhow!("{}: {error}", files::shown(file));
    let plan = files::text(asked.plan, MAX_PLAN_BYTES as u64, "plan")?;
    let plan = PlayedPlan::parse(&plan).map_err(|error| at(asked.plan, &error))?;
    let bytes = files::bytes(asked.recording, MAX_RECORDING_BYTES as u64, "CSV")?;
    let recording = Recording::read(&bytes, asked.layout).map_err(|error| at(asked.recording, &error))?;
    drop(bytes);
    let found = fit_recording(&plan, &recording).map_err(|error| at(asked.recording, &error))?;
    let new = found.calibration(&plan).map_err(|error| at(asked.plan, &error))?;
    let file = match asked.out {
        Some(out) => add_to(out, new)?,
        None => asked.options.client()?.put::<CalibrationReport>("/v1/calibration", new.to_toml())?.file,
    };
    let fitted = Fitted { fit: &found, file: &file };
    give(asked.options.output.json, &fitted, || summary(&found, &file))
}

/// Adds a motor to a calibration file of the same device, or makes the file.
fn add_to(out: &Path, new: Calibration) -> Result<String> {
    let file = files::beside(out)?;
    let all = if out.exists() {
        let text = files::text(out, MAX_BYTES as u64, "calibration")?;
        let old = Calibration::parse(&text, &files::shown(out))?;
        if !new.is_of_same_device(&old) {
            bail!("{}: belongs to another device: name another file", files::shown(out));
        }
        new.with_other_motors(&old)
    } else {
        new
    };
    file.write(&all.to_toml())?;
    Ok(files::shown(out))
}

fn summary(found: &LaserFit, file: &str) -> String {
    let gain = |gain: Figure| format!("{:.4} +- {:.4}", gain.value, gain.sd);
    let percent = |figure: Figure| format!("{:.1} +- {:.1} %", figure.value * 100.0, figure.sd * 100.0);
    let counts = if found.reversed { "; it counts downwards, which was turned round" } else { "" };
    let Figure { value: drift, sd } = found.drift_um_per_s;
    let clock = found.clock_error_ppm;
    let mut lines = vec![
        ("motor", found.motor.to_string()),
        ("gain up", gain(found.gain_up)),
        ("gain down", gain(found.gain_down)),
        ("scatter up", percent(found.scatter_up)),
        ("scatter down", percent(found.scatter_down)),
        (
            "recording",
            format!(
                "{} samples, {} rows without a value, {} of {} bursts, correlation {:.3}",
                found.samples, found.dropouts, found.bursts_covered, found.bursts_planned, found.correlation
            ),
        ),
        ("sensor", format!("noise {:.3} um, drift {drift:.3} +- {sd:.3} um/s{counts}", found.noise_um)),
        (
            "sensor's clock",
            format!(
                "{:+.1} +- {:.1} ppm; the first burst began at {:.4} s",
                clock.value, clock.sd, found.first_burst_s.value
            ),
        ),
    ];
    if let Some(um) = found.pin_shift_um {
        let way = if um < 0.0 { "below" } else { "above" };
        lines.push(("pin", format!("ended {:.1} um {way} its place before the first burst", um.abs())));
    }
    lines.push(("stored", file.to_owned()));
    text::pairs(&lines)
}
