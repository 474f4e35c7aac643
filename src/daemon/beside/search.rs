//! The thread that follows a search's process.
//!
//! It starts the process ([`crate::search`]), sends it its job and reads its reports until it ends. No handler waits for it.

use crate::daemon::beside::search_process::SearchProcess;
use crate::daemon::engine::Engine;
use crate::daemon::state::Found;
use crate::search::{self, Job, MEMORY, Render, Report};
use crate::store::Stored;
use meissner_api::{Code, Problem, Search, SearchRequest};
use meissner_array::pattern::Pattern;
use meissner_design::Target;
use meissner_input::message::cut;
use std::process::Command;
use std::sync::Arc;
use std::thread;

/// Characters of a failed search's problem, at most.
const MAX_PROBLEM: usize = 300;

impl Engine {
    /// Starts a search for a target on a separate thread.
    pub(in crate::daemon) fn start_search(
        self: &Arc<Self>,
        request: &SearchRequest,
        target: &Target,
    ) -> Result<Search, Problem> {
        let job = Job::search(request.clone(), target);
        self.start_job(request, target.name(), job)
    }

    /// Starts the rendering of an object of this name on a separate thread.
    pub(in crate::daemon) fn start_rendering(
        self: &Arc<Self>,
        request: &SearchRequest,
        name: &str,
        render: Render,
    ) -> Result<Search, Problem> {
        let array = self.lock().settings.array;
        self.start_job(request, name, Job::render(render, array))
    }

    fn start_job(self: &Arc<Self>, request: &SearchRequest, name: &str, job: Job) -> Result<Search, Problem> {
        let failed = |detail: String| Problem::new(Code::Store, detail);
        let command = search::command().ok_or_else(|| {
            failed("this program is not meissner and cannot search: start `meissner daemon`".to_owned())
        })?;
        let search = self.lock().begin_search(request, name)?;
        let (engine, id) = (Arc::clone(self), search.id);
        let work = move || {
            engine.run_search(id, command, job);
            engine.changed.notify_one();
        };
        if let Err(error) = thread::Builder::new().name("search".into()).spawn(work) {
            let detail = format!("the search's thread cannot start: {error}");
            self.lock().end_search(id, Err(detail.clone()));
            return Err(failed(detail));
        }
        Ok(search)
    }

    fn run_search(&self, id: u64, command: Command, job: Job) {
        let mut process = match SearchProcess::start(command) {
            Ok(process) => process,
            Err(error) => {
                return self
                    .lock()
                    .end_search(id, Err(format!("the search's process cannot start: {error}")));
            }
        };
        if self.lock().set_search_process(id, process.pid()) {
            process.give(&job);
            // An object's files are large.
            drop(job);
            let outcome = self.follow_search(id, &mut process);
            self.lock().end_search(id, outcome);
        }
    }

    /// Reads the process's reports up to its result.
    fn follow_search(&self, id: u64, process: &mut SearchProcess) -> Result<Found, String> {
        let ended = || {
            let mib = MEMORY >> 20;
            format!(
                "the search's process has ended without a result: it was killed, or needed more than {mib} MiB"
            )
        };
        loop {
            match process.report().ok_or_else(ended)? {
                Report::Progress(progress) => self.lock().set_search_progress(id, progress),
                Report::Contrast(_) | Report::Previewed(_) => return Err(ended()),
                Report::Failed(problem) => return Err(cut(&problem, MAX_PROBLEM)),
                Report::Found(text) => {
                    let found = stored(&text)?;
                    self.lock().set_search_found(id, found);
                }
                Report::Done(result) => {
                    let found = stored(&result.pattern)?;
                    return Ok(Found::Target(result, found));
                }
                Report::Rendered(rendered) => return Ok(Found::Object(rendered)),
            }
        }
    }
}

fn stored(text: &str) -> Result<Stored, String> {
    let pattern = Pattern::parse(text, "the found pattern").map_err(|error| error.to_string())?;
    Ok(Stored::made(pattern))
}
