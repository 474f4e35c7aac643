//! `tradeoff`: compares methods and settings by measurement. It needs no daemon.
//!
//! Without a flag it compares simulation methods on a scene, time against error, and with the second model its computing times
//! ([`afferents`]); with `--stream`, leads of the streamer under recorded stalls; with `--loop`, rest errors of position control
//! with their bound; with `--stop`, rest errors above a lower stop with their theory ([`stop`]); with `--objectives`, the
//! objectives of a search ([`objectives`]). `meissner_report` measures and recommends; this module prints. Each comparison is a
//! member of the argument group `what` and a variant of [`What`].

mod afferents;
mod objectives;
mod stop;

use super::arguments::{Output, choice};
use super::output::give;
use super::simulate::{self, MODELS};
use super::text::number;
use super::{files, progress, text};
use crate::store::Store;
use anyhow::Result;
use clap::Args;
use meissner_design::YARDSTICK;
use meissner_report::{
    self, Bias, ControlGrid, ControlRow, ControlTradeoff, LEADS_MS, LeadRow, LeadTradeoff, MAX_TRACE_BYTES,
    STALLS, StopGrid, Trace, Verdict, WireRow, Worst,
};
use meissner_skin::{AnyScene, ModelName};
use meissner_stream::queues::End;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Debug, Args)]
pub(super) struct MethodTradeoff {
    /// Compare methods on this scene: a TOML or JSON file, or - for stdin [default: 24 motors at 60 Hz, 1 s]
    #[arg(group = "what")]
    scene: Option<PathBuf>,
    /// Choose the model of skin and afferents; with --objectives, that of the searches [default: the scene's key `model`, else membrane]
    #[arg(long, value_parser = choice::<ModelName>(MODELS), conflicts_with_all = ["stream", "closed_loop", "stop"])]
    model: Option<ModelName>,
    /// Compare leads of the streamer, not methods: late bursts, onsets and bytes, in virtual time under recorded stalls
    #[arg(long, group = "what")]
    stream: bool,
    /// Compare position control, not methods: rest errors and amplitudes with their bounds, at all settings (minutes)
    #[arg(long = "loop", group = "what")]
    closed_loop: bool,
    /// Compare surpluses of down bursts above a lower stop, not methods: rest errors with their theory (half a minute)
    #[arg(long, group = "what")]
    stop: bool,
    /// Compare what a search maximises, not methods: patterns by each objective and by naive rules (minutes)
    #[arg(long, group = "what", conflicts_with = "plot")]
    objectives: bool,
    /// Use the stalls in FILE, recorded with the example `record_stalls` (with --stream)
    // clap does not report a missing `--stream` where it would conflict: the conflicts are listed too.
    #[arg(long, value_name = "FILE", requires = "stream", conflicts_with_all = ["scene", "closed_loop", "stop", "objectives"])]
    trace: Option<PathBuf>,
    /// Draw the comparison into FILE (SVG)
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    output: Output,
}

/// Evaluations of each search of `--objectives`; more would hardly improve the result.
const EVALUATIONS: u64 = 1000;

/// What to compare.
enum What<'a> {
    /// Simulation methods, on a scene.
    Methods(Option<&'a Path>),
    /// Leads of the streamer, on a trace of stalls.
    Leads(Option<&'a Path>),
    /// Position control, at all settings.
    Loop,
    /// Surpluses above a lower stop, at all settings.
    Stop,
    /// What a search maximises.
    Objectives,
}

impl MethodTradeoff {
    fn what(&self) -> What<'_> {
        match (self.stream, self.closed_loop, self.stop, self.objectives) {
            (true, ..) => What::Leads(self.trace.as_deref()),
            (_, true, ..) => What::Loop,
            (_, _, true, _) => What::Stop,
            (.., true) => What::Objectives,
            _ => What::Methods(self.scene.as_deref()),
        }
    }
}

pub(super) fn run(asked: &MethodTradeoff) -> Result<ExitCode> {
    match asked.what() {
        What::Methods(scene) => {
            let scene = match scene {
                Some(file) => simulate::read(file, asked.model)?,
                None => AnyScene::read(meissner_report::SIXTY_HERTZ, "sixty-hertz.toml", asked.model)?,
            };
            match scene {
                AnyScene::Membrane(scene) => {
                    let measure = || Ok(progress::metered(|at| meissner_report::tradeoff(&scene, at))?);
                    answer(asked, measure, meissner_report::plot, methods_table)
                }
                AnyScene::Afferents(scene) => afferents::compare(asked, &scene),
            }
        }
        What::Leads(trace) => {
            let trace = match trace {
                Some(file) => {
                    let text = files::text(file, MAX_TRACE_BYTES as u64, "trace")?;
                    Trace::read(&text, &file.to_string_lossy())?
                }
                None => Trace::read(STALLS, "stalls.txt")?,
            };
            let measure =
                || Ok(progress::metered(|at| meissner_report::lead_tradeoff(&trace, &LEADS_MS, at)));
            answer(asked, measure, meissner_report::plot_lead, leads_table)
        }
        What::Loop => {
            let measure = || {
                Ok(progress::metered(|at| meissner_report::control_tradeoff(&ControlGrid::default(), at))?)
            };
            answer(asked, measure, meissner_report::plot_control, loop_table)
        }
        What::Stop => {
            let measure =
                || Ok(progress::metered(|at| meissner_report::stop_tradeoff(&StopGrid::default(), at))?);
            answer(asked, measure, meissner_report::plot_stop, stop::table)
        }
        What::Objectives => {
            let store = Store::new(None, false)?;
            let model = asked.model.unwrap_or_default();
            let library = |name: &str| store.library(name).map(|stored| stored.pattern.drives().to_vec());
            let found = progress::metered(|at| {
                meissner_report::objective_tradeoff(EVALUATIONS, model, &library, at)
            })?;
            give(asked.output.json, &found, || objectives::table(&found).join("\n"))
        }
    }
}

/// Measures, draws if requested, and prints.
fn answer<T: Serialize>(
    asked: &MethodTradeoff,
    measure: impl FnOnce() -> Result<T>,
    draw: impl FnOnce(&T) -> Result<String, meissner_report::PlotError>,
    table: impl FnOnce(&T) -> Vec<String>,
) -> Result<ExitCode> {
    // This reports an unwritable place before the work.
    let plot = asked.plot.as_deref().map(files::beside).transpose()?;
    let found = measure()?;
    if let Some(plot) = plot {
        plot.write(&draw(&found)?)?;
    }
    give(asked.output.json, &found, || {
        let mut lines = table(&found);
        lines.extend(asked.plot.iter().map(|file| format!("plot  {}", files::shown(file))));
        lines.join("\n")
    })
}

fn methods_table(tradeoff: &meissner_report::MethodTradeoff) -> Vec<String> {
    let head = [
        "method",
        "us/afferent/s",
        "matched",
        "error us",
        "rate RMS",
        "rate bias",
        "contrast error",
        "front",
    ];
    let row = |row: &meissner_report::Row| {
        let front = match (&row.reason, row.pareto) {
            (Some(_), _) => "refused",
            (None, true) => "*",
            (None, false) => "",
        };
        vec![
            row.method.to_string(),
            number(row.us_per_afferent_s, 2),
            number(row.difference.spikes_matched_share, 4),
            number(row.difference.mean_error_us, 1),
            number(row.difference.rate_rms_hz, 3),
            number(row.difference.rate_bias, 5),
            number(row.difference.cost_error_hz, 3),
            front.to_owned(),
        ]
    };
    let scene = format!(
        "{} afferents for {} s, {} spikes; the exact method took {:.3} s; rates and contrast in impulses/s",
        tradeoff.afferents, tradeoff.duration_s, tradeoff.spikes, tradeoff.exact_wall_s
    );
    let mut lines = vec![scene, text::columns(&head, tradeoff.rows.iter().map(row))];
    lines.push(format!(
        "Contrast (exact: {}): mean rate of the afferents within 1.5 mm of the edge minus mean rate of the others, which \
         `meissner optimise` maximises. The edge is the target `{YARDSTICK}`, 12 mm long, at 45 degrees through the \
         array's middle; - if there are no afferents on one side.",
        number(tradeoff.cost_hz, 3)
    ));
    // Rows may share a reason, for example Euler's in f32 and f64.
    for reason in tradeoff.rows.iter().filter_map(|row| row.reason.as_ref()) {
        let line = format!("Refused: {reason}.");
        if !lines.contains(&line) {
            lines.push(line);
        }
    }
    if tradeoff.rows.iter().any(|row| row.unstable) {
        lines.push(format!(
            "With steps between tau ({} s) and 2 tau explicit Euler alternates in sign; above 2 tau it diverges. Steps \
             above tau are refused.",
            tradeoff.tau_s
        ));
    }
    if let Some(left_out) = &tradeoff.left_out {
        let steps: Vec<_> = left_out.steps_us.iter().map(ToString::to_string).collect();
        lines.push(format!("Left out: {} us, {}.", steps.join(", "), left_out.why));
    }
    lines.push(tradeoff.recommendation.clone());
    lines
}

fn leads_table(tradeoff: &LeadTradeoff) -> Vec<String> {
    let head =
        ["lead ms", "late", "of bursts", "share %", "onset p50 ms", "p99", "longest", "B/burst loop", "open"];
    let row = |row: &LeadRow| {
        vec![
            row.lead_ms.to_string(),
            row.late_bursts.to_string(),
            row.planned_bursts.to_string(),
            format!("{:.4}", 100.0 * row.late_share),
            number(row.onset_ms_p50, 2),
            number(row.onset_ms_p99, 2),
            number(row.onset_ms_max, 2),
            format!("{:.2}", row.bytes_per_burst_loop),
            format!("{:.2}", row.bytes_per_burst_open),
        ]
    };
    let trace = &tradeoff.trace;
    let orders = tradeoff.rows.first().map_or(0, |row| row.orders);
    let mut lines = vec![
        format!(
            "24 motors at 60 Hz in virtual time under {} s of recorded stalls: {} wake-ups came late, {} by more than 5 ms, \
             the latest by {:.1} ms. Onsets of {orders} short plays.",
            trace.seconds,
            trace.late_wake_ups,
            trace.late_by_5_ms,
            trace.longest_us as f64 / 1000.0
        ),
        text::columns(&head, tradeoff.rows.iter().map(row)),
    ];
    let cut: Vec<_> =
        tradeoff.rows.iter().filter(|row| row.end != End::Done).map(|row| row.lead_ms.to_string()).collect();
    if !cut.is_empty() {
        lines.push(format!(
            "At {} ms a stall was longer than the host watchdog timeout, and the device ended the play: later bursts are not \
             counted.",
            cut.join(", ")
        ));
    }
    lines.push(tradeoff.recommendation.clone());
    lines
}

/// Most settings that miss their limit and get a line.
const LISTED: usize = 8;

fn loop_table(tradeoff: &ControlTradeoff) -> Vec<String> {
    let head = [
        "Hz",
        "scatter",
        "within limit",
        "of",
        "rest/bound",
        "limit",
        "worst at: um",
        "age ms",
        "asymmetry",
        "amplitude %",
    ];
    let row = |worst: &Worst| {
        vec![
            worst.frequency_hz.to_string(),
            worst.scatter.to_string(),
            worst.hold.to_string(),
            worst.cells.to_string(),
            format!("{:.2}", worst.ratio),
            format!("{:.1}", worst.limit),
            worst.amplitude_um.to_string(),
            worst.age_ms.to_string(),
            worst.asymmetry.to_string(),
            number(worst.amplitude_error.map(|share| 100.0 * share), 2),
        ]
    };
    let summary = &tradeoff.summary;
    let leads = if summary.leads_alike {
        "The lead makes no difference, to the last bit."
    } else {
        "The lead makes a difference."
    };
    let mut lines = vec![
        format!(
            "Position control at {} settings, one motor in device time. For each frequency and scatter, the worst setting: \
             rest error RMS divided by its lower bound (without scatter: in pulses), and the error of the mean amplitude \
             where half a period is 1.3 bursts or longer. {leads}",
            summary.cells
        ),
        text::columns(&head, summary.worst.iter().map(row)),
        format!(
            "{} of {} settings are within their limits. At {} more the amplitude is off by more than 1 % or half a pulse, but \
             within 2.5 standard errors. {} miss their limit: {} by rest error, {} by amplitude, {} by a sensor fault found \
             in correct telemetry.",
            summary.hold,
            summary.cells,
            summary.chance,
            summary.miss,
            summary.rest_misses,
            summary.amplitude_misses,
            summary.doubts
        ),
    ];
    lines.push(format!(
        "If samples were a millisecond fresher, as they can be between two wake-ups, {} rest errors would exceed the limit.",
        summary.strict_rest_misses
    ));
    let bias = |bias: &Bias| {
        let (mean, error) = (100.0 * bias.amplitude_error, 100.0 * bias.amplitude_se);
        format!("{mean:+.2} % at scatter {} (+-{error:.2})", bias.scatter)
    };
    let biases: Vec<_> = summary.biases.iter().map(bias).collect();
    lines.push(format!("On average, unsaturated amplitudes are off by {}.", biases.join(", ")));
    lines.extend(worst_cells(tradeoff));
    let head = ["Hz", "samples/s", "rest um", "bound um", "ratio"];
    let row = |row: &ControlRow| {
        vec![
            row.run.frequency_hz.to_string(),
            row.run.telemetry_hz.to_string(),
            format!("{:.2}", row.rest_rms_um),
            format!("{:.2}", row.bound_um),
            format!("{:.2}", row.ratio()),
        ]
    };
    lines.push("By telemetry rate, at 80 um and 10 % scatter:".to_owned());
    lines.push(text::columns(&head, tradeoff.rates.iter().map(row)));
    let head = ["wire", "B/burst", "B/s", "bursts", "corrected", "rest um"];
    let row = |(name, row): (&str, &WireRow)| {
        vec![
            name.to_owned(),
            format!("{:.2}", row.bytes_per_burst),
            format!("{:.0}", row.bytes_per_s),
            row.bursts.to_string(),
            row.amended.to_string(),
            format!("{:.2}", row.rest_rms_um),
        ]
    };
    let wire = &tradeoff.wire;
    lines.push(format!(
        "Bytes on the wire, 24 motors at 60 Hz for {} s through link and controller:",
        wire.seconds
    ));
    lines.push(text::columns(&head, [("closed loop", &wire.on), ("open loop", &wire.off)].map(row)));
    lines.push(tradeoff.recommendation.clone());
    lines
}

/// Settings that miss their limit, the worst first. If leads make no difference, settings of one lead only.
fn worst_cells(tradeoff: &ControlTradeoff) -> Vec<String> {
    let lead_ms = tradeoff.rows.first().map(|row| row.run.lead_ms);
    let listed = |row: &&ControlRow| !tradeoff.summary.leads_alike || Some(row.run.lead_ms) == lead_ms;
    let missed = tradeoff.rows.iter().filter(|row| row.verdict == Verdict::Misses);
    let mut missed: Vec<_> = missed.filter(listed).collect();
    missed.sort_by(|a, b| b.over_limit().total_cmp(&a.over_limit()));
    let line = |row: &&ControlRow| {
        let fault = row.doubt.map_or_else(String::new, |fault| format!("; sensor fault: {}", fault.text()));
        format!(
            "Misses its limit: {} Hz, {} um, telemetry {} ms old, scatter {}, asymmetry {}, lead {} ms: rest {:.3} um (limit \
             {:.3}), amplitude {:+.2} % (+-{:.2}){fault}.",
            row.run.frequency_hz,
            row.run.amplitude_um,
            row.run.age_ms,
            row.run.scatter,
            row.run.asymmetry,
            row.run.lead_ms,
            row.rest_rms_um,
            row.limit_um,
            100.0 * row.amplitude_error,
            100.0 * row.amplitude_se
        )
    };
    let mut lines: Vec<_> = missed.iter().take(LISTED).map(line).collect();
    if missed.len() > LISTED {
        lines.push(format!("{} more miss their limit; --json lists all.", missed.len() - LISTED));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_api::SensorFault;

    #[test]
    fn settings_that_miss_their_limit_are_listed_the_worst_first() {
        let grid = ControlGrid {
            frequencies_hz: vec![60.0],
            amplitudes_um: vec![80.0],
            leads_ms: vec![20.0, 100.0],
            ages_ms: vec![1.0, 20.0],
            scatters: vec![0.1],
            asymmetries: vec![0.02],
            telemetry_hz: vec![1000.0],
            seconds: 4.0,
            periods: 0.0,
        };
        let mut found = meissner_report::control_tradeoff(&grid, &|_| ()).unwrap();
        let text = loop_table(&found).join("\n");
        assert!(
            !text.contains("Misses its limit") && text.contains("The lead makes no difference"),
            "{text}"
        );
        assert!(text.contains(" 0 miss their limit") && text.ends_with(&found.recommendation), "{text}");
        for row in &mut found.rows {
            (row.verdict, row.rest_rms_um) = (Verdict::Misses, 2.0 * row.limit_um);
        }
        found.rows[1].doubt = Some(SensorFault::Gain);
        // Of two leads that make no difference, one is listed.
        let lines = worst_cells(&found);
        assert_eq!(lines.len(), 2, "{lines:?}");
        assert!(
            lines[0].contains("telemetry 20 ms old") && lines[0].contains("sensor fault: its telemetry"),
            "{lines:?}"
        );
        assert!(lines[1].contains("60 Hz, 80 um, telemetry 1 ms old, scatter 0.1"), "{lines:?}");
        found.summary.leads_alike = false;
        assert_eq!(worst_cells(&found).len(), 4);
    }
}
