//! Sweeps: thousands of searches, simulations or comparisons by one plan, on one machine or on many with a common file system.
//!
//! The modules in the order of the data path, each after those it uses:
//!
//! 1. `axis`: the quantities that can be varied, and their values. `documents`: the targets and patterns that the values name.
//! 2. `plan`: a [`Plan`] is read from a file; it says which values each [`Cell`] has.
//! 3. `command`: computes a cell: a row of results beside those of the baseline, and perhaps a pattern.
//! 4. `directory`: one directory for one plan. `run_file`: the rows of a run, one line each, which survive a kill.
//! 5. `run`: a [`Run`] computes the cells of a [`Shard`] that are missing. `estimate`: the time and size of a sweep.
//! 6. `job_array`: the script of an array of Slurm, a shard each. `status`: the progress of all runs.
//! 7. `merge`: [`merge()`] joins the rows of all runs to CSV, Parquet, a page, and the best patterns.
//!
//! There is no server and no lock: runs share a directory, each appends to its own file, and a cell's row does not depend on the
//! run that computes it.
//!
//! Invariant: merged files depend on the plan alone, not on threads, shards, machines, kills or any order of work.

mod axis;
mod command;
mod directory;
mod documents;
mod estimate;
mod job_array;
mod merge;
mod plan;
mod run;
mod run_file;
mod shard;
mod status;

pub use axis::{Axis, Command, Document, Domain, Value};
pub use command::{Column, Figure, Figures, Kind, Outcome, columns, compute, figures};
pub use directory::{Directory, LOG, SweepError};
pub use estimate::{Estimate, estimate};
pub use job_array::{MOST_TASKS, TASK_S, log, most_tasks, script, tasks};
pub use merge::{Merged, merge, pattern};
pub use plan::{Cell, MOST_BYTES, MOST_CELLS, Plan, PlanError, PlanProblem, Program, Sources};
pub use run::{Progress, Run};
pub use run_file::{End, HEARTBEAT, Header};
pub use shard::Shard;
pub use status::{RunState, RunStatus, Status, status};
