//! Previews of patterns: each in a process of its own, followed by a thread.
//!
//! [`begin`] takes a place, starts the thread and returns a [`Running`] preview, whose result a request awaits.
//!
//! Bounds: one preview is computed at a time, and [`WAITING`] requests wait. Invariant: when a [`Running`] preview is dropped, its process is killed, and
//! its place is free once the process has ended.

use crate::daemon::jobs::process::RenderProcess;
use crate::render_process::{self, Job, MEMORY, Report};
use meissner_api::{Code, PatternPreview, Problem};
use rustix::process::{Pid, Signal, kill_process};
use std::process::Command;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use tokio::sync::{Semaphore, SemaphorePermit, oneshot};

/// The most requests that wait for their preview, with the one that is computed.
const WAITING: usize = 9;

static WAITS: Semaphore = Semaphore::const_new(WAITING);
static PLACE: Semaphore = Semaphore::const_new(1);

/// The process of a preview, as the request knows it.
#[derive(Debug, Default)]
enum Process {
    #[default]
    Starting,
    /// It was not waited for, so no other process can get its id.
    Runs(Pid),
    /// It has ended, or nobody wants its result.
    Over,
}

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Running {
    process: Arc<Mutex<Process>>,
    result: oneshot::Receiver<Result<Vec<u8>, String>>,
}

/// Starts a preview once the ones before it have ended. It counts among those that wait until the permit is dropped.
pub(in crate::daemon) async fn begin(job: Job) -> Result<(Running, SemaphorePermit<'static>), Problem> {
    let busy = |_| Problem::new(Code::Busy, "too many clients ask for previews: try again in a moment");
    let waits = WAITS.try_acquire().map_err(busy)?;
    let place = PLACE.acquire().await;
    let failed = |detail: String| Problem::new(Code::Store, detail);
    let command = render_process::command().ok_or_else(|| {
        failed("this program is not meissner and cannot compute previews: start `meissner daemon`".to_owned())
    })?;
    let process = Arc::default();
    let (sender, result) = oneshot::channel();
    let running = Running { process: Arc::clone(&process), result };
    let work = move || {
        let result = compute(command, &job, &process);
        drop(place);
        // The client may have hung up.
        let _ = sender.send(result);
    };
    let thread = thread::Builder::new().name("preview".into()).spawn(work);
    thread.map_err(|error| failed(format!("the preview's thread cannot start: {error}")))?;
    Ok((running, waits))
}

/// The preview as JSON; an error is one line.
fn compute(command: Command, job: &Job, shared: &Mutex<Process>) -> Result<Vec<u8>, String> {
    let started = RenderProcess::start(command);
    let mut process = started.map_err(|error| format!("the preview's process cannot start: {error}"))?;
    match &mut *lock(shared) {
        Process::Over => return Err(String::new()),
        state => *state = Process::Runs(process.pid()),
    }
    process.give(job);
    let report = process.report();
    // From here on the process may be waited for.
    *lock(shared) = Process::Over;
    match report {
        Some(Report::Previewed(preview)) => Ok(json(&preview)),
        Some(Report::Failed(problem)) => Err(problem),
        _ => {
            let mib = MEMORY >> 20;
            Err(format!(
                "the preview's process has ended without a result: it was killed, or needed more than {mib} MiB"
            ))
        }
    }
}

/// Plain data can be written.
fn json(preview: &PatternPreview) -> Vec<u8> {
    serde_json::to_vec(preview).unwrap_or_default()
}

fn lock(shared: &Mutex<Process>) -> MutexGuard<'_, Process> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Running {
    /// Waits for the preview as JSON; an error is one line.
    pub(in crate::daemon) async fn result(&mut self) -> Result<Vec<u8>, String> {
        (&mut self.result).await.unwrap_or_else(|_| Err("the preview's thread has ended".to_owned()))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let mut process = lock(&self.process);
        if let Process::Runs(pid) = *process {
            // An error means that it has just ended.
            let _ = kill_process(pid, Signal::KILL);
        }
        *process = Process::Over;
    }
}
