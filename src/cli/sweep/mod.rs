//! `sweep`: runs the cells of a plan, here or as a job array of a cluster, and joins the results of all runs. It needs no daemon.
//!
//! [`run`] chooses what to do: compute cells on this machine's cores, estimate their time, or submit them (module `cluster`). The
//! status, the merge and the pattern of a cell need only the directory. `sources` finds the documents that a plan names.
//!
//! Invariant: every finished cell is kept when a run ends for any reason, and the same command computes the rest.

mod cluster;
mod sources;

use super::arguments::{ArrayOption, Output};
use super::ending::on_signals;
use super::output::{give, say};
use super::progress::{self, Cells};
use super::{files, text};
use anyhow::{Result, anyhow, bail};
use clap::Args;
use meissner_sweep::{
    Axis, Directory, Domain, Estimate, MOST_BYTES, Merged, Plan, Progress, Run, RunStatus, Shard, Status,
    estimate, merge, pattern, status,
};
use serde::Serialize;
use sources::Files;
use std::env;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::{self, ExitCode};
use std::sync::Arc;
use std::thread::available_parallelism;

#[derive(Debug, Args)]
pub(super) struct Sweep {
    /// Run the cells of this plan (TOML)
    #[arg(value_name = "PLAN", required_unless_present_any = ["status", "merge", "pattern", "axes"])]
    plan: Option<PathBuf>,
    /// Keep the results in directory DIR; with a directory of this plan, compute what is missing
    #[arg(short = 'o', long = "out", value_name = "DIR", required_unless_present_any = ["status", "merge", "dry_run", "axes"])]
    out: Option<PathBuf>,
    /// Measure some cells for a few seconds, print what all of them cost, and write nothing
    #[arg(long, conflicts_with_all = ["status", "merge", "pattern", "axes", "shard"])]
    dry_run: bool,
    /// Use N threads [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=4096))]
    threads: Option<u64>,
    /// Compute part I of N equal parts [default: by SLURM_ARRAY_TASK_ID and SLURM_ARRAY_TASK_COUNT, else all]
    #[arg(long, value_name = "I/N", conflicts_with = "slurm")]
    shard: Option<Shard>,
    /// Submit the missing cells to Slurm, as a job array; options for sbatch come after --
    #[arg(long)]
    slurm: bool,
    /// Let the array have N tasks, up to 1000 and the site's limit [default: tasks of about 15 minutes, at most 500]
    #[arg(long, value_name = "N", requires = "slurm", value_parser = clap::value_parser!(u64).range(1..))]
    tasks: Option<u64>,
    /// Show how far the sweep in directory DIR is
    #[arg(long, value_name = "DIR", conflicts_with_all = ["plan", "out", "merge", "pattern", "axes", "slurm", "shard"])]
    status: Option<PathBuf>,
    /// Join all rows in directory DIR: results.csv, results.parquet, page.html and the best patterns
    #[arg(long, value_name = "DIR", conflicts_with_all = ["plan", "out", "pattern", "axes", "slurm", "shard"])]
    merge: Option<PathBuf>,
    /// Print the pattern that cell N has found
    #[arg(long, value_name = "N", requires = "out", conflicts_with_all = ["plan", "axes", "slurm", "shard"])]
    pattern: Option<u64>,
    /// List what a plan can vary
    #[arg(long, conflicts_with_all = ["plan", "out", "slurm", "shard"])]
    axes: bool,
    #[command(flatten)]
    array: ArrayOption,
    #[command(flatten)]
    output: Output,
    /// Pass these options to sbatch
    #[arg(last = true, value_name = "OPTION", requires = "slurm")]
    sbatch: Vec<String>,
}

/// The document of a run.
#[derive(Debug, Serialize)]
struct RunDocument<'a> {
    directory: &'a Path,
    plan_sha256: &'a str,
    shard: Shard,
    /// Cells of the shard, those that were done before, and those that this run has computed.
    cells: u64,
    before: u64,
    computed: u64,
    failed: u64,
}

pub(super) fn run(asked: &Sweep) -> Result<ExitCode> {
    let json = asked.output.json;
    if asked.axes {
        return axes(json);
    }
    if let Some(dir) = &asked.status {
        let (directory, plan) = Directory::open(dir)?;
        let found = status(&directory, &plan)?;
        return give(json, &found, || status_text(&found));
    }
    if let Some(dir) = &asked.merge {
        let (directory, plan) = Directory::open(dir)?;
        let merged = progress::waiting("merging", || merge(&directory, &plan))?;
        return give(json, &merged, || merged_text(dir, &merged));
    }
    if let (Some(cell), Some(dir)) = (asked.pattern, &asked.out) {
        return print_pattern(dir, cell, json);
    }
    asked.array.find()?;
    let place = asked.plan.as_deref().expect("clap wants a plan");
    let text = files::text(place, MOST_BYTES, "plan")?;
    let plan = Plan::read(&text, &place.to_string_lossy(), &Files::beside(place)?)?;
    match &asked.out {
        _ if asked.slurm => cluster::run(asked, plan),
        _ if asked.dry_run => dry_run(asked, &plan),
        Some(dir) => here(asked, plan, dir),
        None => unreachable!("clap wants --out"),
    }
}

/// How many threads compute.
fn threads(asked: &Sweep) -> usize {
    let cores = || available_parallelism().map_or(1, usize::from);
    asked.threads.map_or_else(cores, |threads| threads as usize)
}

fn dry_run(asked: &Sweep, plan: &Plan) -> Result<ExitCode> {
    let found = progress::waiting("measuring", || estimate(plan));
    give(asked.output.json, &found, || {
        let mut lines = plan_lines(plan);
        lines.extend(cost_lines(&found));
        let threads = threads(asked);
        let time = duration(found.work_s / threads as f64);
        lines.push(("time", format!("about {time} with {threads} threads here")));
        text::pairs(&lines)
    })
}

/// The plan, for people.
fn plan_lines(plan: &Plan) -> Vec<(&'static str, String)> {
    let varied: Vec<String> =
        plan.varied().iter().map(|(axis, count)| format!("{} {count}", axis.name())).collect();
    vec![
        ("command", plan.command().name().to_owned()),
        ("axes", varied.join(", ")),
        ("cells", plan.cells().to_string()),
    ]
}

fn cost_lines(found: &Estimate) -> Vec<(&'static str, String)> {
    let [shortest, longest] = found.cell_range_s;
    let failed = if found.failed > 0 { format!("; {} of them failed", found.failed) } else { String::new() };
    vec![
        (
            "a cell",
            format!(
                "{:.3} s on one core ({shortest:.3} to {longest:.3}, {} measured{failed})",
                found.cell_s, found.measured
            ),
        ),
        ("work", format!("{} on one core", duration(found.work_s))),
        (
            "disk",
            format!("{:.1} MB of rows, and as much again at most for the tables", found.rows_bytes / 1e6),
        ),
    ]
}

/// A duration, for people.
fn duration(seconds: f64) -> String {
    match seconds {
        ..90.0 => format!("{seconds:.0} s"),
        ..5400.0 => format!("{:.0} min", seconds / 60.0),
        ..172_800.0 => format!("{:.1} h", seconds / 3600.0),
        _ => format!("{:.1} days", seconds / 86_400.0),
    }
}

/// The shard of this process: the requested one, else that of the job array's variables, else the whole plan.
fn shard(asked: Option<Shard>, variable: impl Fn(&str) -> Option<String>) -> Result<Shard> {
    if let Some(shard) = asked {
        return Ok(shard);
    }
    let number = |name: &str| -> Option<u64> { variable(name)?.parse().ok() };
    let Some(id) = number("SLURM_ARRAY_TASK_ID") else { return Ok(Shard::WHOLE) };
    let count = number("SLURM_ARRAY_TASK_COUNT");
    let first = number("SLURM_ARRAY_TASK_MIN").unwrap_or(1);
    let last = number("SLURM_ARRAY_TASK_MAX").or(count).unwrap_or(id);
    // An array that repeats some tasks of an earlier one does not know the original number of tasks.
    match count.filter(|count| first <= id && last.checked_sub(first) == count.checked_sub(1)) {
        Some(of) if id - first < of => Ok(Shard { number: id - first + 1, of }),
        _ => bail!(
            "SLURM_ARRAY_TASK_ID is {id}, and the array's tasks are not numbered one by one: name the part with --shard I/N"
        ),
    }
}

fn here(asked: &Sweep, plan: Plan, dir: &Path) -> Result<ExitCode> {
    let variable = |name: &str| env::var(name).ok();
    let shard = shard(asked.shard, variable)?;
    let directory = Directory::of_plan(dir, &plan)?;
    let run = Arc::new(Run::begin(&directory, Arc::new(plan), shard, meissner_sweep::log(variable))?);
    let stopped = Arc::clone(&run);
    let place = files::shown(dir);
    on_signals(move |number| {
        let name = match number {
            2 => "SIGINT",
            15 => "SIGTERM",
            _ => "SIGHUP",
        };
        stopped.stop(&format!("stopped by {name}"));
        // If stderr is closed, no one can read the message.
        let _ = writeln!(
            io::stderr(),
            "\nstopped; {place} has every finished cell, and the same command computes the rest"
        );
        process::exit(128 + number);
    })?;
    let shown = Cells::new(run.before(), run.before() + run.missing(), asked.output.json);
    let done =
        run.work(threads(asked), &|progress| shown.show(progress.before + progress.done, progress.cells));
    drop(shown);
    let Progress { before, done, failed, cells } = done.inspect_err(|_| run.stop("an error"))?;
    let document = RunDocument {
        directory: dir,
        plan_sha256: directory.plan_sha256(),
        shard,
        cells,
        before,
        computed: done,
        failed,
    };
    give(asked.output.json, &document, || {
        let mut lines =
            vec![("cells", format!("{cells}: {before} were done before, {done} are new, {failed} failed"))];
        if shard != Shard::WHOLE {
            lines.insert(0, ("part", shard.to_string()));
        }
        let place = files::shown(dir);
        lines.push(("next", format!("meissner sweep --status {place}, meissner sweep --merge {place}")));
        text::pairs(&lines)
    })?;
    Ok(if failed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn status_text(found: &Status) -> String {
    let Status { cells, done, failed, missing, damaged, .. } = found;
    let mut lines = format!("{done} of {cells} cells are done, {failed} failed, {missing} are missing");
    if *damaged > 0 {
        lines += &format!("; {damaged} lines cannot be read, and their cells count as missing");
    }
    let row = |run: &RunStatus| {
        vec![
            run.shard.map_or_else(|| "-".to_owned(), |shard| shard.to_string()),
            run.state.name().to_owned(),
            run.cells.to_string(),
            run.host.clone().unwrap_or_default(),
            format!("{} ago", duration(run.silent_s)),
            run.last.clone().unwrap_or_default(),
        ]
    };
    if !found.runs.is_empty() {
        let head = ["part", "state", "cells", "machine", "last sign", "last line"];
        lines += &format!("\n\n{}", text::columns(&head, found.runs.iter().map(row)));
    }
    lines
}

fn merged_text(dir: &Path, merged: &Merged) -> String {
    let Merged { cells, done, failed, missing, damaged, files: made } = merged;
    let mut lines = vec![("cells", format!("{done} of {cells}, {failed} failed"))];
    if *missing > 0 {
        lines.push(("note", format!("{missing} cells are missing: run the plan again to compute them")));
    }
    if *damaged > 0 {
        lines.push(("note", format!("{damaged} lines cannot be read: their cells are missing")));
    }
    let best = made.iter().filter(|file| file.starts_with("best/")).count();
    let others: Vec<&str> =
        made.iter().map(String::as_str).filter(|file| !file.starts_with("best/")).collect();
    lines.push(("written", format!("{} in {}", others.join(", "), files::shown(dir))));
    if best > 0 {
        lines.push(("patterns", format!("{best} in {}", files::shown(&dir.join("best")))));
    }
    text::pairs(&lines)
}

/// The document of `--pattern`.
#[derive(Debug, Serialize)]
struct PatternDocument<'a> {
    cell: u64,
    pattern: &'a str,
}

fn print_pattern(dir: &Path, cell: u64, json: bool) -> Result<ExitCode> {
    let (directory, plan) = Directory::open(dir)?;
    if cell >= plan.cells() {
        bail!("--pattern {cell}: the plan has cells 0 to {}", plan.cells() - 1);
    }
    let found = pattern(&directory, &plan, cell)?;
    let found = found.ok_or_else(|| {
        anyhow!(
            "{}: has no pattern of cell {cell}: it is missing or has failed, or its command makes none",
            files::shown(dir)
        )
    })?;
    give(json, &PatternDocument { cell, pattern: &found }, || found.trim_end().to_owned())
}

/// A row of `--axes`.
#[derive(Debug, Serialize)]
struct AxisDocument {
    command: &'static str,
    axis: &'static str,
    values: String,
    about: &'static str,
}

fn axes(json: bool) -> Result<ExitCode> {
    use meissner_sweep::Command::{Discriminate, Optimise, Simulate};
    let all: Vec<AxisDocument> = [Optimise, Simulate, Discriminate]
        .into_iter()
        .flat_map(|command| {
            Axis::of(command).map(move |axis| AxisDocument {
                command: command.name(),
                axis: axis.name(),
                values: match axis.domain(command) {
                    Domain::Document(kind) => format!("{}s, by name or file", kind.name()),
                    domain => domain.to_string(),
                },
                about: axis.about(command),
            })
        })
        .collect();
    if !json {
        let row = |of: &AxisDocument| [of.command, of.axis, of.about, &of.values].map(str::to_owned).to_vec();
        return say(&text::columns(&["command", "axis", "meaning", "values"], all.iter().map(row)))
            .map(|()| ExitCode::SUCCESS);
    }
    give(json, &all, String::new)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(variables: &[(&str, &str)]) -> Result<Shard> {
        shard(None, |name| {
            variables.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn a_task_of_an_array_is_a_shard() {
        assert_eq!(of(&[]).unwrap(), Shard::WHOLE);
        let array = |id, count, first, last| {
            of(&[
                ("SLURM_ARRAY_TASK_ID", id),
                ("SLURM_ARRAY_TASK_COUNT", count),
                ("SLURM_ARRAY_TASK_MIN", first),
                ("SLURM_ARRAY_TASK_MAX", last),
            ])
        };
        assert_eq!(array("3", "7", "1", "7").unwrap(), Shard { number: 3, of: 7 });
        assert_eq!(array("0", "7", "0", "6").unwrap(), Shard { number: 1, of: 7 });
        let holes = array("5", "2", "3", "5").unwrap_err().to_string();
        assert!(holes.contains("--shard I/N"), "{holes}");
        assert_eq!(shard(Some(Shard { number: 2, of: 3 }), |_| Some("9".to_owned())).unwrap().number, 2);
    }

    #[test]
    fn durations_have_the_unit_that_people_use() {
        let shown = [20.0, 600.0, 7200.0, 864_000.0].map(duration);
        assert_eq!(shown, ["20 s", "10 min", "2.0 h", "10.0 days"]);
    }
}
