//! Searches in a process of their own: what it is told, what it answers, and its work.
//!
//! The daemon starts this program again ([`command`]) and writes a [`Job`] to its stdin; [`work`] answers on stdout with [`Report`]s, one
//! line of JSON each. A job is a search for a pattern, or searches to compare a live target's drives with (`compare`). A process keeps the search's memory, threads and faults out of the one that streams: its memory is bounded
//! ([`MEMORY`]) and not locked, it has low priority, and the daemon can kill it at any time.
//!
//! Invariant: the process ends when the other end of its stdin closes, however the daemon ends.

mod compare;
pub(crate) mod convert;
mod worker;

pub use worker::work;

pub use compare::{Compare, live_brief};

use convert::{goal, models, setting};
use meissner_api::{LiveContrast, SEARCH_S, SearchProgress, SearchRequest, SearchResult};
use meissner_design::{Budget, Request, Target};
use serde::{Deserialize, Serialize};
use std::ffi::OsStr;
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};

/// The name by which the program knows that it is to search (`argv[0]`).
const NAME: &str = "meissner-search";
/// The most memory of its data that a search may have, bytes. `docs/explanation/limits.md` names it.
pub const MEMORY: u64 = 256 << 20;
/// The longest line of either side, bytes: a pattern of 64 frames, every character escaped.
pub const MAX_LINE: u64 = 8 << 20;
/// As the daemon's predictor: on a busy machine a search still gets a ninth of a processor.
const NICE: i32 = 10;

/// Whether this executable is the program, which can search, and not another one that has a daemon in it.
static IS_PROGRAM: AtomicBool = AtomicBool::new(false);

/// What to do.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Job {
    /// The target's file.
    target: String,
    task: Task,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
enum Task {
    Search(SearchRequest),
    Compare(Compare),
}

/// What a search tells.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Report {
    /// How far it is.
    Progress(SearchProgress),
    /// What was reached at the poses so far. After the last pose the process ends.
    Contrast(LiveContrast),
    /// What it has found; the last line.
    Done(Box<SearchResult>),
    /// Why it has found nothing; the last line.
    Failed(String),
}

impl Job {
    /// A search for a pattern, whose target was found.
    #[must_use]
    pub fn search(request: SearchRequest, target: &Target) -> Self {
        Self::new(Task::Search(SearchRequest { target: serde_json::Value::Null, ..request }), target)
    }

    /// Searches to compare the drives of a live target with.
    #[must_use]
    pub fn compare(compare: Compare, target: &Target) -> Self {
        Self::new(Task::Compare(compare), target)
    }

    fn new(task: Task, target: &Target) -> Self {
        // The target goes along as its file. Strings, numbers and tables of them can be written.
        Self { target: toml::to_string(&target.definition()).unwrap_or_default(), task }
    }
}

/// The request as the search takes it.
fn design(request: &SearchRequest) -> Request {
    let SearchRequest { seconds, evaluations, seed, robust, objective, model, setting: space, .. } = *request;
    let budget = match evaluations {
        Some(evaluations) => Budget::Evaluations(vec![evaluations]),
        None => Budget::Seconds(seconds.unwrap_or(SEARCH_S.0)),
    };
    Request {
        models: models(model),
        goal: goal(objective),
        setting: setting(space),
        seed,
        robust,
        budget,
        start: None,
        rail_motors_at_once: None,
    }
}

/// Says that this executable is the program. Without it [`command`] gives none.
pub fn is_program() {
    IS_PROGRAM.store(true, Ordering::Relaxed);
}

/// Whether the program was started to search.
#[must_use]
pub fn is_asked(argv0: Option<&OsStr>) -> bool {
    argv0.is_some_and(|name| name == NAME)
}

/// The command that starts a search. The file may have been replaced meanwhile: the link leads to the one that runs. Without work
/// between fork and exec the standard library does not copy the tables of the daemon's memory, which would make its real-time thread
/// take page faults.
#[must_use]
pub fn command() -> Option<Command> {
    let mut command = Command::new("/proc/self/exe");
    command.arg0(NAME).env_clear().stdin(Stdio::piped()).stdout(Stdio::piped());
    IS_PROGRAM.load(Ordering::Relaxed).then_some(command)
}
