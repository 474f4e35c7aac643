//! `calibrate`: asks the daemon to measure how far each pin really moves, and shows the result.
//!
//! The daemon plays, fits and stores; the command waits. Before the minute of playing it checks that it can write to `-o`. With
//! `--plan` or `--from` a laser measures: see `laser`.
//!
//! Invariant: it exits with 0 only if the calibration of every requested motor was stored.

use super::arguments::{ArrayOption, ClientOptions};
use super::ending::Ending;
use super::output::give;
use super::progress::Progress;
use super::{control, files, laser, session_token, text};
use crate::array::shown;
use crate::receipts::calibration_plan;
use anyhow::{Result, bail};
use clap::Args;
use meissner_api::{CalibrateRequest, CalibratedMotor, CalibrationReport, Event, PlayAccepted};
use meissner_client::Events;
use meissner_stream::calibrate::{Layout, LengthUnit, TimeUnit};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

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
    /// Write the calibration to FILE, too; with --from, add it to FILE and do not ask a daemon
    #[arg(short = 'o', long = "output", value_name = "FILE")]
    out: Option<PathBuf>,
    /// For a laser, without telemetry: play the bursts of --motor and write them with their ticks to PLAN; with --from,
    /// read them from PLAN [default: calibration-plan.json]
    #[arg(long, value_name = "PLAN", num_args = 0..=1, default_missing_value = laser::DEFAULT_PLAN)]
    plan: Option<PathBuf>,
    /// Fit the motor of the plan to a laser's recording: a CSV file of time and displacement, by any clock, or `-` for stdin
    #[arg(long, value_name = "CSV", conflicts_with_all = ["motor", "repetitions", "pulses"])]
    from: Option<PathBuf>,
    /// Read the recording's time in this unit: s, ms, us, ns or min [default: the header's, else s]
    #[arg(long, value_name = "UNIT", requires = "from")]
    time_unit: Option<TimeUnit>,
    /// Read the recording's displacement in this unit: m, mm, um or nm [default: the header's]
    #[arg(long, value_name = "UNIT", requires = "from")]
    displacement_unit: Option<LengthUnit>,
    /// Read the time from this column: its name, or its number from 0 [default: the header says it]
    #[arg(long, value_name = "COLUMN", requires = "from")]
    time_column: Option<String>,
    /// Read the displacement from this column: its name, or its number from 0 [default: the header says it]
    #[arg(long, value_name = "COLUMN", requires = "from")]
    column: Option<String>,
    /// Do not read the time: the recording has HZ rows per second
    #[arg(long, value_name = "HZ", requires = "from", conflicts_with_all = ["time_column", "time_unit"])]
    rate_hz: Option<f64>,
    #[command(flatten)]
    array: ArrayOption,
    #[command(flatten)]
    options: ClientOptions,
}

pub(super) fn run(asked: &Calibrate) -> Result<ExitCode> {
    let plan = asked.plan.as_deref();
    if let Some(recording) = &asked.from {
        // The plan names the array that it was played on.
        if asked.array.find()?.is_none() {
            asked.options.learn_array()?;
        }
        let layout = Layout {
            time_unit: asked.time_unit,
            displacement_unit: asked.displacement_unit,
            time_column: asked.time_column.clone(),
            column: asked.column.clone(),
            rate_hz: asked.rate_hz,
        };
        return laser::fit(&laser::Fit {
            recording,
            plan: plan.unwrap_or(Path::new(laser::DEFAULT_PLAN)),
            layout: &layout,
            out: asked.out.as_deref(),
            options: &asked.options,
        });
    }
    let Calibrate { motor, repetitions, ref pulses, .. } = *asked;
    let request = CalibrateRequest {
        motor,
        pulses: pulses.clone(),
        repetitions,
        laser: plan.is_some(),
        session: session_token::session(),
    };
    if let Some(plan) = plan {
        return laser::play(&request, asked.out.as_deref().unwrap_or(plan), &asked.options);
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
