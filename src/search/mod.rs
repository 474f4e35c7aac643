//! Searches in a separate process: its job, its reports, and its work.
//!
//! The daemon starts this program again ([`command`]) and writes a [`Job`] to its stdin; [`work`] answers on stdout with
//! [`Report`]s, one line of JSON each. A job is a search for a target's pattern, the rendering of an object (`render`), the preview of a
//! pattern (`preview`), or a comparison of a live target's drives with searches (`compare`). A separate process keeps the search's memory, threads and faults away from the streaming process: its memory is
//! bounded ([`MEMORY`]) and not locked, it has low priority, and the daemon can kill it at any time.
//!
//! Invariant: the process ends when the other end of its stdin closes, however the daemon ends.

mod compare;
pub(crate) mod convert;
mod finger;
mod preview;
mod render;
mod worker;

pub use worker::work;

pub use compare::{Compare, live_brief};
pub use preview::Preview;
pub use render::{Render, file_hashes};

use convert::{goal, models, setting};
use meissner_api::{
    LiveContrast, PatternPreview, Rendered, SEARCH_S, SearchProgress, SearchRequest, SearchResult,
};
use meissner_array::spec::Array;
use meissner_design::{Budget, Request, Target};
use serde::{Deserialize, Serialize};
use std::ffi::OsStr;
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};

/// The name (`argv[0]`) that tells the program to search.
const NAME: &str = "meissner-search";
/// The most data memory of a search, bytes. `docs/explanation/limits.md` names it.
pub const MEMORY: u64 = 256 << 20;
/// The longest line of either side, bytes: a pattern of 64 frames, every character escaped; or an object with its files.
pub const MAX_LINE: u64 = 8 << 20;
/// The same as the daemon's predictor: on a busy machine a search still gets a ninth of a processor.
const NICE: i32 = 10;

/// Whether this executable is the program, which can search, and not another executable that contains a daemon.
static IS_PROGRAM: AtomicBool = AtomicBool::new(false);

/// What to do.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Job {
    /// The description of its array.
    array: String,
    task: Task,
}

/// A target is its file.
#[derive(Clone, Debug, Serialize, Deserialize)]
enum Task {
    Search { request: SearchRequest, target: String },
    Compare { compare: Compare, target: String },
    Render(Render),
    Preview(Preview),
}

/// A report of a search.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Report {
    /// Its progress.
    Progress(SearchProgress),
    /// The contrast at the poses so far. After the last pose the process ends.
    Contrast(LiveContrast),
    /// The file of the pattern for an object.
    Found(String),
    /// The result of a search for a target; the last line.
    Done(Box<SearchResult>),
    /// The result of a rendering; the last line.
    Rendered(Box<Rendered>),
    /// A preview; the last line.
    Previewed(Box<PatternPreview>),
    /// Why it failed; the last line.
    Failed(String),
}

impl Job {
    /// A search for a pattern, whose target was found.
    #[must_use]
    pub fn search(request: SearchRequest, target: &Target) -> Self {
        let request = SearchRequest { target: None, ..request };
        Self::new(target.array(), Task::Search { request, target: text(target) })
    }

    /// A comparison of a live target's drives with searches.
    #[must_use]
    pub fn compare(compare: Compare, target: &Target) -> Self {
        Self::new(target.array(), Task::Compare { compare, target: text(target) })
    }

    /// The rendering of an object.
    #[must_use]
    pub fn render(render: Render, array: Array) -> Self {
        Self::new(array, Task::Render(render))
    }

    /// The preview of a pattern for this array.
    #[must_use]
    pub fn preview(preview: Preview, array: Array) -> Self {
        Self::new(array, Task::Preview(preview))
    }

    fn new(array: Array, task: Task) -> Self {
        Self { array: array.text().to_owned(), task }
    }
}

/// The target's file. Strings, numbers and tables of them can always be written.
fn text(target: &Target) -> String {
    toml::to_string(&target.definition()).unwrap_or_default()
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

/// Notes that this executable is the program. Without this call [`command`] returns none.
pub fn is_program() {
    IS_PROGRAM.store(true, Ordering::Relaxed);
}

/// Whether the program was started to search.
#[must_use]
pub fn is_asked(argv0: Option<&OsStr>) -> bool {
    argv0.is_some_and(|name| name == NAME)
}

/// The command that starts a search. The program's file may have been replaced meanwhile; the link leads to the running one. The
/// command does no work between fork and exec, so the standard library does not copy the daemon's page tables, which would cause
/// page faults in its real-time thread.
#[must_use]
pub fn command() -> Option<Command> {
    let mut command = Command::new("/proc/self/exe");
    command.arg0(NAME).env_clear().stdin(Stdio::piped()).stdout(Stdio::piped());
    IS_PROGRAM.load(Ordering::Relaxed).then_some(command)
}
