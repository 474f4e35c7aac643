//! `sweep --slurm`: submits the missing cells of a plan as a job array.
//!
//! The array's script is in the sweep's directory, and names program and directory by their absolute paths, so all nodes must find
//! both there. `--dry-run` prints script and command, and writes nothing.
//!
//! Invariant: an array has at most as many tasks as the site allows.

use super::{Sweep, cost_lines, duration, plan_lines};
use crate::cli::output::give;
use crate::cli::{files, progress, text};
use anyhow::{Result, anyhow, bail};
use meissner_input::message::cut;
use meissner_sweep::{
    Directory, LOG, MOST_TASKS, Plan, RunState, estimate, most_tasks, script, status, tasks,
};
use serde::Serialize;
use std::env;
use std::path::Path;
use std::process::{Command, ExitCode};

/// The script in the sweep's directory.
const SCRIPT: &str = "job.sh";

#[derive(Debug, Serialize)]
struct Submitted<'a> {
    directory: &'a Path,
    cells: u64,
    missing: u64,
    tasks: u64,
    /// The command that submits, word by word.
    command: &'a [String],
    /// The array's script.
    script: &'a str,
    /// The number of the job; none of a dry run.
    job: Option<&'a str>,
}

pub(super) fn run(asked: &Sweep, plan: Plan) -> Result<ExitCode> {
    let dir =
        asked.out.as_deref().ok_or_else(|| anyhow!("--slurm: name the sweep's directory with --out DIR"))?;
    let absolute = std::path::absolute(dir)
        .map_err(|error| anyhow!("{}: cannot be made absolute ({error})", files::shown(dir)))?;
    if absolute.to_string_lossy().contains('\n') {
        bail!("{}: a line break cannot be in the script of a job: name another directory", files::shown(dir));
    }
    let most = site_limit();
    if let Some(tasks) = asked.tasks.filter(|tasks| *tasks > most) {
        bail!(
            "--tasks {tasks}: this site allows {most} tasks of an array (MaxArraySize, and {MOST_TASKS} at most)"
        );
    }
    let directory = if asked.dry_run { None } else { Some(Directory::of_plan(dir, &plan)?) };
    let mut missing = plan.cells();
    if let Some(directory) = &directory {
        let found = status(directory, &plan)?;
        missing = found.missing;
        if missing > 0 && found.runs.iter().any(|run| run.state == RunState::Running) {
            bail!(
                "{}: runs of an earlier command are computing its cells: wait for them (--status), or cancel them",
                files::shown(dir)
            );
        }
    }
    if missing == 0 {
        return give(
            asked.output.json,
            &Submitted {
                directory: dir,
                cells: plan.cells(),
                missing,
                tasks: 0,
                command: &[],
                script: "",
                job: None,
            },
            || format!("all {} cells are done: meissner sweep --merge {}", plan.cells(), files::shown(dir)),
        );
    }
    let mut lines = plan_lines(&plan);
    let count = match asked.tasks {
        Some(tasks) => tasks.min(plan.cells()),
        None => {
            let cost = progress::waiting("measuring", || estimate(&plan));
            let work_s = cost.cell_s * missing as f64;
            let count = tasks(work_s, plan.cells(), most);
            lines.extend(cost_lines(&cost));
            lines.push(("a task", format!("about {}", duration(work_s / count as f64))));
            count
        }
    };
    lines.push(("tasks", count.to_string()));
    let program =
        env::current_exe().map_err(|error| anyhow!("the program's own path is not known ({error})"))?;
    let text = script(&program, &absolute, count);
    let command = command(&asked.sbatch, &absolute.join(SCRIPT));
    let job = if directory.is_some() { Some(submit(&absolute, &text, &command)?) } else { None };
    let document = Submitted {
        directory: dir,
        cells: plan.cells(),
        missing,
        tasks: count,
        command: &command,
        script: &text,
        job: job.as_deref(),
    };
    give(asked.output.json, &document, || {
        lines.push(("command", command.join(" ")));
        match &job {
            Some(job) => {
                lines.push(("job", job.clone()));
                lines.push(("next", format!("meissner sweep --status {}", files::shown(dir))));
                text::pairs(&lines)
            }
            None => format!("{}\n\n{SCRIPT}:\n{}", text::pairs(&lines), text.trim_end()),
        }
    })
}

/// The command that submits a script.
fn command(options: &[String], script: &Path) -> Vec<String> {
    let mut words = vec!["sbatch".to_owned(), "--parsable".to_owned()];
    words.extend_from_slice(options);
    words.push(script.to_string_lossy().into_owned());
    words
}

/// The most tasks of an array on this site, if Slurm says it.
fn site_limit() -> u64 {
    let asked = Command::new("scontrol").args(["show", "config"]).output();
    most_tasks(
        &asked.map_or_else(|_| String::new(), |said| String::from_utf8_lossy(&said.stdout).into_owned()),
    )
}

/// Writes the script and submits it; returns the number of the job.
fn submit(dir: &Path, script: &str, command: &[String]) -> Result<String> {
    files::directory(&dir.join(LOG))?;
    files::beside(&dir.join(SCRIPT))?.write(script)?;
    let said = Command::new(&command[0]).args(&command[1..]).output();
    let said = said.map_err(|error| {
        anyhow!("sbatch: cannot be started; submit from a node with Slurm, or run the parts by --shard I/N ({error})")
    })?;
    if !said.status.success() {
        let why = String::from_utf8_lossy(&said.stderr);
        bail!("sbatch: {}", cut(why.trim(), 300));
    }
    // With --parsable: the number of the job, and after a semicolon the name of the cluster.
    let text = String::from_utf8_lossy(&said.stdout);
    Ok(text.trim().split(';').next().unwrap_or_default().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_come_before_the_script() {
        let words = command(&["--partition=long".to_owned()], Path::new("/data/a b/job.sh"));
        assert_eq!(words, ["sbatch", "--parsable", "--partition=long", "/data/a b/job.sh"]);
    }
}
