//! Job arrays of Slurm: the number of tasks, and the script that each runs.
//!
//! A task is a shard of the plan. It takes minutes, so that the scheduler has little to do. The script is for `sbatch`. It can be
//! submitted again by hand, also for some of its tasks, because it names its shard itself.
//!
//! Invariant: an array has no more tasks than the site allows, and no more than there are cells.

use crate::directory::LOG;
use std::path::Path;

/// The intended duration of a task, s.
pub const TASK_S: f64 = 900.0;
/// The most tasks by default: sites allow 500 to 1000.
const USUAL: u64 = 500;
/// The most tasks.
pub const MOST_TASKS: u64 = 1000;

/// The most tasks of an array by `scontrol show config`: one less than `MaxArraySize`, and [`MOST_TASKS`] at most.
#[must_use]
pub fn most_tasks(config: &str) -> u64 {
    let of_line = |line: &str| {
        let (key, value) = line.split_once('=')?;
        if key.trim() == "MaxArraySize" { value.trim().parse::<u64>().ok() } else { None }
    };
    // The size limits the largest number of a task; ours count from 1.
    config.lines().find_map(of_line).map_or(MOST_TASKS, |size| size.saturating_sub(1).min(MOST_TASKS))
}

/// The number of tasks for `work_s` seconds of work on one core.
#[must_use]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
pub fn tasks(work_s: f64, cells: u64, most: u64) -> u64 {
    ((work_s / TASK_S).ceil() as u64).clamp(1, most.min(USUAL).min(cells).max(1))
}

/// The script of an array of `tasks` tasks. `program` and `directory` are absolute.
#[must_use]
pub fn script(program: &Path, directory: &Path, tasks: u64) -> String {
    let (program, shown) = (quoted(program), quoted(directory));
    // In the name of a log file Slurm takes % as the beginning of a field.
    let log = directory.join(LOG).to_string_lossy().replace('%', "%%");
    format!(
        "#!/bin/sh\n\
         #SBATCH --job-name=meissner-sweep\n\
         #SBATCH --array=1-{tasks}\n\
         #SBATCH --requeue\n\
         #SBATCH --open-mode=append\n\
         #SBATCH --output=\"{log}/%A_%a.log\"\n\
         # Written by meissner sweep. Options on the command line of sbatch come before those here.\n\
         exec {program} sweep {shown}/plan.toml --out {shown} --shard \"$SLURM_ARRAY_TASK_ID/{tasks}\" \\\n    \
         --threads \"${{SLURM_CPUS_PER_TASK:-1}}\"\n"
    )
}

/// The log of this process's task, in the sweep's directory, from the variables of Slurm.
#[must_use]
pub fn log(variable: impl Fn(&str) -> Option<String>) -> Option<String> {
    let (job, task) = (variable("SLURM_ARRAY_JOB_ID")?, variable("SLURM_ARRAY_TASK_ID")?);
    let plain = |text: &str| !text.is_empty() && text.chars().all(|c| c.is_ascii_digit());
    (plain(&job) && plain(&task)).then(|| format!("{LOG}/{job}_{task}.log"))
}

/// A path as one word of a shell.
fn quoted(path: &Path) -> String {
    format!("'{}'", path.to_string_lossy().replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_of_the_site_is_kept() {
        assert_eq!(most_tasks("MaxArraySize            = 501\nMaxJobCount = 10000\n"), 500);
        assert_eq!(most_tasks("MaxArraySize = 4000001\n"), MOST_TASKS);
        assert_eq!(most_tasks("nothing"), MOST_TASKS);
    }

    #[test]
    fn a_task_takes_minutes() {
        assert_eq!(tasks(0.0, 10, 1000), 1);
        assert_eq!(tasks(9000.0, 100, 1000), 10);
        assert_eq!(tasks(9000.0, 4, 1000), 4, "no task without a cell");
        assert_eq!(tasks(1e9, 100_000, 1000), USUAL);
        assert_eq!(tasks(1e9, 100_000, 100), 100);
    }

    #[test]
    fn paths_of_a_script_are_words() {
        let text = script(Path::new("/opt/it's/meissner"), Path::new("/data/100 %"), 7);
        assert!(text.contains(r"exec '/opt/it'\''s/meissner' sweep '/data/100 %'/plan.toml"), "{text}");
        assert!(
            text.contains("--array=1-7\n") && text.contains("--shard \"$SLURM_ARRAY_TASK_ID/7\""),
            "{text}"
        );
        assert!(text.contains("--output=\"/data/100 %%/log/%A_%a.log\""), "{text}");
    }

    #[test]
    fn a_log_has_the_numbers_of_job_and_task() {
        let of = |job: &'static str, task: &'static str| {
            log(move |key| Some(if key.contains("JOB") { job } else { task }.to_owned()))
        };
        assert_eq!(of("12", "3").as_deref(), Some("log/12_3.log"));
        assert_eq!(of("../12", "3"), None);
        assert_eq!(log(|_| None), None);
    }
}
