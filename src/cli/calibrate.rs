//! `calibrate`: asks the daemon to measure how far each pin really moves, and shows the result.
//!
//! The daemon plays, fits and stores; the command waits. Before the minute of playing it checks that it can write to `-o`. With
//! `--plan` a laser measures: the command writes the bursts that were played.
//!
//! Invariant: it exits with 0 only if the calibration of every requested motor was stored. A plan is written only if every one of its
//! bursts was played.

use super::arguments::ClientOptions;
use super::ending::Ending;
use super::output::give;
use super::progress::Progress;
use super::{control, files, session_token, text};
use crate::array::shown;
use crate::clock::utc_text;
use crate::receipts::calibration_plan;
use anyhow::{Result, bail};
use clap::Args;
use firmware_protocol::tick::Tick;
use meissner_api::{CalibrateRequest, CalibratedMotor, CalibrationReport, Event, PlayAccepted, Status};
use meissner_client::Events;
use meissner_stream::calibrate::{PlayedOn, PlayedPlan};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

/// The plan's file if the command line names none.
const DEFAULT_PLAN: &str = "calibration-plan.json";
/// How long the daemon may take from a play's end to its fit.
const TIMEOUT: Duration = Duration::from_secs(20);

#[derive(Debug, Args)]
pub(super) struct Calibrate {
    /// Calibrate one motor, by its number [default: all]
    #[arg(long, value_name = "N")]
    motor: Option<u8>,
    /// Play each number of pulses N times; with the default numbers each time takes half a minute [default: 2]
    #[arg(long, value_name = "N")]
    repetitions: Option<u16>,
    /// Play bursts of these numbers of pulses, up to 200, 3 s each [default: ten numbers, for the paper's motors 14,28,42,56,70,84,98,112,126,140]
    #[arg(long, value_name = "N,N,...", value_delimiter = ',')]
    pulses: Option<Vec<u16>>,
    /// Write the calibration to FILE, too
    #[arg(short = 'o', long = "output", value_name = "FILE")]
    out: Option<PathBuf>,
    /// For a laser, without telemetry: play the bursts of --motor and write them with their ticks to PLAN [default:
    /// calibration-plan.json]
    #[arg(long, value_name = "PLAN", num_args = 0..=1, default_missing_value = DEFAULT_PLAN)]
    plan: Option<PathBuf>,
    #[command(flatten)]
    options: ClientOptions,
}

pub(super) fn run(asked: &Calibrate) -> Result<ExitCode> {
    let plan = asked.plan.as_deref();
    let Calibrate { motor, repetitions, ref pulses, .. } = *asked;
    let request = CalibrateRequest {
        motor,
        pulses: pulses.clone(),
        repetitions,
        laser: plan.is_some(),
        session: session_token::session(),
    };
    if let Some(plan) = plan {
        return play_for_laser(&request, asked.out.as_deref().unwrap_or(plan), &asked.options);
    }
    let out = asked.out.as_deref().map(files::beside).transpose()?;
    let mut client = asked.options.client()?;
    let plan = calibration_plan(shown(&client.get("/v1/array")?)?, &request)?;
    let mut events = client.events()?;
    let ending = Ending::listen(&asked.options)?;
    let PlayAccepted { id, .. } = ending.order(|| client.post("/v1/calibrate", &request))?;
    let json = asked.options.output.json;
    let mut progress = Progress::new(Some(plan.duration_s()), json);
    control::follow(&mut client, &mut events, id, &mut progress)?;
    ending.set_over();
    let measured = outcome(&mut events, id)?;
    let report: CalibrationReport = client.get("/v1/calibration")?;
    if let Some(out) = out {
        out.write(&report.toml)?;
    }
    let missing: Vec<String> =
        plan.motors().filter(|motor| !measured.contains(motor)).map(|motor| motor.to_string()).collect();
    give(json, &report, || summary(&report, &measured, &missing, asked.out.as_deref()))?;
    Ok(if missing.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Plays a plan and writes what was played.
fn play_for_laser(request: &CalibrateRequest, out: &Path, options: &ClientOptions) -> Result<ExitCode> {
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
        identity: after.link.identity.clone(),
        boot: device.boot,
        date: utc_text(),
    };
    let played = PlayedPlan::new(&plan, motor, Tick(onset.actual_tick), on);
    file.write(&played.to_json())?;
    give(options.output.json, &played, || {
        let bursts =
            format!("{} of motor {motor} in {:.0} s, all played", played.bursts().len(), played.duration_s());
        let next = "fit the recording by `meissner.laser` of Python: docs/board.md".to_owned();
        text::pairs(&[("bursts", bursts), ("written", files::shown(out)), ("next", next)])
    })
}

/// Waits until the daemon has stored the calibration; returns the motors it measured.
fn outcome(events: &mut Events, id: u64) -> Result<Vec<u8>> {
    loop {
        match events.next(Some(TIMEOUT))? {
            Some(Event::Calibrated { id: of, motors, problem }) if of == id => match problem {
                None => return Ok(motors),
                Some(problem) => bail!("{problem}"),
            },
            Some(_) => {}
            None => bail!("the daemon ended before it fitted play {id}: read its log"),
        }
    }
}

fn summary(report: &CalibrationReport, measured: &[u8], missing: &[String], out: Option<&Path>) -> String {
    let head = ["motor", "gain up", "gain down", "SD"];
    let row = |of: &CalibratedMotor| {
        let CalibratedMotor { motor, gain_up, gain_up_se, gain_down, gain_down_se, .. } = of;
        let sd = (of.relative_sd_up + of.relative_sd_down) / 2.0;
        vec![
            motor.to_string(),
            format!("{gain_up:.3} +- {gain_up_se:.3}"),
            format!("{gain_down:.3} +- {gain_down_se:.3}"),
            format!("{:.1} %", sd * 100.0),
        ]
    };
    let rows = report.motors.iter().filter(|of| measured.contains(&of.motor)).map(row);
    let mut lines = vec![("stored", report.file.clone())];
    if !missing.is_empty() {
        lines.push(("not measured", format!("{}; see `meissner receipt`", missing.join(", "))));
    }
    lines.extend(out.map(|out| ("written", files::shown(out))));
    format!("{}\n{}", text::columns(&head, rows), text::pairs(&lines))
}
