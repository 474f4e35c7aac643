//! `calibrate`: asks the daemon to measure how far each pin really moves, and shows the result.
//!
//! The daemon plays, fits and stores; the command waits. It checks that it can write to `-o` before the minute of playing.
//!
//! Invariant: it exits with 0 only if the calibration of every requested motor was stored.

use super::arguments::ClientOptions;
use super::output::give;
use super::progress::Progress;
use super::{control, files, text};
use crate::receipts::calibration_plan;
use anyhow::{Result, bail};
use clap::Args;
use meissner_api::Event;
use meissner_api::{CalibrateRequest, CalibratedMotor, CalibrationReport, PlayAccepted};
use meissner_client::Events;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// How long the daemon may take from a play's end to its fit.
const TIMEOUT: Duration = Duration::from_secs(20);

#[derive(Debug, Args)]
pub(super) struct Calibrate {
    /// Calibrate one motor, 0 to 23 [default: all]
    #[arg(long, value_name = "N")]
    motor: Option<u8>,
    /// Play each number of pulses N times; with the default numbers each time takes half a minute [default: 2]
    #[arg(long, value_name = "N")]
    repetitions: Option<u16>,
    /// Play bursts of these numbers of pulses, 7 to 200, 3 s each [default: 14,28,42,56,70,84,98,112,126,140]
    #[arg(long, value_name = "N,N,...", value_delimiter = ',')]
    pulses: Option<Vec<u16>>,
    /// Write the calibration to FILE, too
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    options: ClientOptions,
}

pub(super) fn run(asked: &Calibrate) -> Result<ExitCode> {
    let out = asked.out.as_deref().map(files::beside).transpose()?;
    let Calibrate { motor, repetitions, ref pulses, .. } = *asked;
    let request = CalibrateRequest { motor, pulses: pulses.clone(), repetitions };
    let plan = calibration_plan(&request)?;
    let mut client = asked.options.client()?;
    let mut events = client.events()?;
    let over = control::leave_on_interrupt()?;
    let PlayAccepted { id } = client.post("/v1/calibrate", &request)?;
    let json = asked.options.output.json;
    let mut progress = Progress::new(Some(plan.duration_s()), json);
    control::follow(&mut client, &mut events, id, &mut progress)?;
    over.store(true, Ordering::Relaxed);
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
