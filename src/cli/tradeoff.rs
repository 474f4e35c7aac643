//! The command that weighs one thing against another. It asks no daemon.
//!
//! Without a flag the methods of the simulator are compared on a scene, time against error; with `--stream` the streamer's
//! leads under recorded stalls. One of these at a time: each is a member of the group `what`, and a variant of
//! [`What`]. What is measured and what is recommended is `report`'s; here it is laid out.

use super::{Output, files, give, progress, simulate, text};
use crate::optimise::YARDSTICK;
use crate::report::{self, LEADS_MS, LeadRow, LeadTradeoff, MAX_TRACE_BYTES, STALLS, Trace};
use crate::simulate::Scene;
use crate::stream::port::End;
use anyhow::Result;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Debug, Args)]
pub(super) struct Tradeoff {
    /// The scene: a TOML or JSON file, or - for stdin [default: 24 motors at 60 Hz, 306 receptors, 1 s]
    #[arg(group = "what")]
    scene: Option<PathBuf>,
    /// Not a scene: the streamer's lead against late bursts, onsets and bytes, in virtual time under recorded stalls
    #[arg(long, group = "what")]
    stream: bool,
    /// With --stream: stalls recorded on another machine, by the example `record_stalls`
    // What is required is not missed where it would conflict: so the conflict is said, too.
    #[arg(long, value_name = "FILE", requires = "stream", conflicts_with = "scene")]
    trace: Option<PathBuf>,
    /// Draw it into this file (SVG)
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    output: Output,
}

/// What is weighed.
enum What<'a> {
    /// The simulator's methods, on a scene.
    Methods(Option<&'a Path>),
    /// The streamer's leads, on a trace.
    Leads(Option<&'a Path>),
}

impl Tradeoff {
    fn what(&self) -> What<'_> {
        if self.stream { What::Leads(self.trace.as_deref()) } else { What::Methods(self.scene.as_deref()) }
    }
}

pub(super) fn run(asked: &Tradeoff) -> Result<ExitCode> {
    match asked.what() {
        What::Methods(scene) => {
            let scene = match scene {
                Some(file) => simulate::read(file)?,
                None => Scene::read(report::SIXTY_HERTZ, "sixty-hertz.toml")?,
            };
            let measure = || Ok(progress::metered(|at| report::tradeoff(&scene, at))?);
            answer(asked, measure, report::plot, methods_table)
        }
        What::Leads(trace) => {
            let trace = match trace {
                Some(file) => {
                    let text = files::text(file, MAX_TRACE_BYTES as u64, "trace")?;
                    Trace::read(&text, &file.to_string_lossy())?
                }
                None => Trace::read(STALLS, "stalls.txt")?,
            };
            let measure = || Ok(progress::metered(|at| report::lead_tradeoff(&trace, &LEADS_MS, at)));
            answer(asked, measure, report::plot_lead, leads_table)
        }
    }
}

/// Measures, draws if that was asked for, and prints.
fn answer<T: Serialize>(
    asked: &Tradeoff,
    measure: impl FnOnce() -> Result<T>,
    draw: impl FnOnce(&T) -> Result<String, report::PlotError>,
    table: impl FnOnce(&T) -> Vec<String>,
) -> Result<ExitCode> {
    // A place that cannot be written to is said before the work.
    let plot = asked.plot.as_deref().map(files::beside).transpose()?;
    let found = measure()?;
    if let Some(plot) = plot {
        plot.write(&draw(&found)?)?;
    }
    give(asked.output.json, &found, || {
        let mut lines = table(&found);
        lines.extend(asked.plot.iter().map(|file| format!("plot  {}", files::shown(file))));
        lines.join("\n")
    })?;
    Ok(ExitCode::SUCCESS)
}

fn figure(figure: Option<f64>, digits: usize) -> String {
    figure.map_or_else(|| "-".to_owned(), |figure| format!("{figure:.digits$}"))
}

fn methods_table(tradeoff: &report::Tradeoff) -> Vec<String> {
    let head =
        ["method", "us/receptor/s", "matched", "error us", "rate RMS", "rate bias", "cost error", "front"];
    let row = |row: &report::Row| {
        let front = match (&row.reason, row.pareto) {
            (Some(_), _) => "refused",
            (None, true) => "*",
            (None, false) => "",
        };
        vec![
            row.how.to_string(),
            figure(row.us_per_receptor_s, 2),
            figure(row.spikes_matched_share, 4),
            figure(row.mean_error_us, 1),
            figure(row.rate_rms_hz, 3),
            figure(row.rate_bias, 5),
            figure(row.cost_error_hz, 3),
            front.to_owned(),
        ]
    };
    let scene = format!(
        "{} receptors for {} s, {} spikes; the exact method took {:.3} s; rates and cost in impulses/s",
        tradeoff.receptors, tradeoff.duration_s, tradeoff.spikes, tradeoff.exact_wall_s
    );
    let mut lines = vec![scene, text::columns(&head, tradeoff.rows.iter().map(row))];
    lines.push(format!(
        "Cost (exact: {}): mean impulse rate of the receptors within 1.5 mm of the edge minus that of the others \
         (what `meissner optimise` maximises); the edge is the target `{YARDSTICK}`, 12 mm long, at 45 degrees through \
         the array's middle; - if one side is empty.",
        figure(tradeoff.cost_hz, 3)
    ));
    // Rows may share a reason: Euler's is the same in f32 and f64.
    for reason in tradeoff.rows.iter().filter_map(|row| row.reason.as_ref()) {
        let line = format!("Refused: {reason}.");
        if !lines.contains(&line) {
            lines.push(line);
        }
    }
    if tradeoff.rows.iter().any(|row| row.unstable) {
        lines.push(format!(
            "Explicit Euler alternates in sign between tau ({} s) and 2 tau and grows without end above 2 tau; it is \
             refused above tau.",
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
            figure(row.onset_ms_p50, 2),
            figure(row.onset_ms_p99, 2),
            figure(row.onset_ms_max, 2),
            format!("{:.2}", row.bytes_per_burst_loop),
            format!("{:.2}", row.bytes_per_burst_open),
        ]
    };
    let trace = &tradeoff.trace;
    let orders = tradeoff.rows.first().map_or(0, |row| row.orders);
    let mut lines = vec![
        format!(
            "24 motors at 60 Hz in virtual time under {} s of recorded stalls: {} wake-ups came late, {} by more than 5 ms, \
             the latest by {:.1} ms; onsets of {orders} short plays beside",
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
            "At {} ms a stall outlasted the lease, and the device ended the play: what came after it is not counted.",
            cut.join(", ")
        ));
    }
    lines.push(tradeoff.recommendation.clone());
    lines
}
