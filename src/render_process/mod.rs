//! Renderings and previews in a separate process: its job, its reports, and its work.
//!
//! The daemon starts this program again ([`command`]) and writes a [`Job`] to its stdin; [`work`] answers on stdout with
//! [`Report`]s, one line of JSON each. A job is the rendering of an object (`render`) or the preview of a pattern (`preview`). A separate
//! process keeps their memory, threads and faults away from the streaming process: its memory is bounded ([`MEMORY`]) and not locked, it
//! has low priority, and the daemon can kill it at any time.
//!
//! Invariant: the process ends when the other end of its stdin closes, however the daemon ends.

mod finger;
mod preview;
mod render;
mod worker;

pub use worker::work;

pub use preview::Preview;
pub use render::{Render, file_hashes};

use meissner_api::{PatternPreview, Rendered};
use meissner_array::spec::Array;
use serde::{Deserialize, Serialize};
use std::ffi::OsStr;
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};

/// The name (`argv[0]`) that tells the program to be this process.
const NAME: &str = "meissner-render";
/// The most data memory of the process, bytes. `docs/safety.md` names it.
pub const MEMORY: u64 = 256 << 20;
/// The longest line of either side, bytes: an object with its files.
pub const MAX_LINE: u64 = 8 << 20;
/// On a busy machine the process still gets a ninth of a processor.
const NICE: i32 = 10;

/// Whether this executable is the program, which can be the process, and not another executable that contains a daemon.
static IS_PROGRAM: AtomicBool = AtomicBool::new(false);

/// What to do.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Job {
    /// The description of its array.
    array: String,
    task: Task,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
enum Task {
    Render(Render),
    Preview(Preview),
}

/// A report of the process.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Report {
    /// The file of the pattern for an object.
    Found(String),
    /// The result of a rendering; the last line.
    Rendered(Box<Rendered>),
    /// A preview; the last line.
    Previewed(Box<PatternPreview>),
    /// Why it failed; the last line.
    Failed(String),
}

impl Job {
    /// The rendering of an object.
    pub fn render(render: Render, array: Array) -> Self {
        Self::new(array, Task::Render(render))
    }

    /// The preview of a pattern for this array.
    pub fn preview(preview: Preview, array: Array) -> Self {
        Self::new(array, Task::Preview(preview))
    }

    fn new(array: Array, task: Task) -> Self {
        Self { array: array.text().to_owned(), task }
    }
}

/// Notes that this executable is the program. Without this call [`command`] returns none.
pub fn is_program() {
    IS_PROGRAM.store(true, Ordering::Relaxed);
}

/// Whether the program was started to be the process.
pub fn is_asked(argv0: Option<&OsStr>) -> bool {
    argv0.is_some_and(|name| name == NAME)
}

/// The command that starts the process. The program's file may have been replaced meanwhile; the link leads to the running one. The
/// command does no work between fork and exec, so the standard library does not copy the daemon's page tables, which would cause
/// page faults in its real-time thread.
pub fn command() -> Option<Command> {
    let mut command = Command::new("/proc/self/exe");
    command.arg0(NAME).env_clear().stdin(Stdio::piped()).stdout(Stdio::piped());
    IS_PROGRAM.load(Ordering::Relaxed).then_some(command)
}
