//! The thread that follows a rendering's process.
//!
//! It starts the process ([`crate::render_process`]), sends it its job and reads its reports until it ends. No handler waits for it.

use crate::daemon::core::engine::Engine;
use crate::daemon::jobs::process::RenderProcess;
use crate::daemon::sessions::caller::Asker;
use crate::render_process::{self, Job, MEMORY, Render, Report};
use crate::store::Stored;
use meissner_api::{Code, Problem, Rendered, Rendering, RenderingRequest};
use meissner_array::pattern::Pattern;
use meissner_input::message::cut;
use std::process::Command;
use std::sync::Arc;
use std::thread;

/// Characters of a failed rendering's problem, at most.
const MAX_PROBLEM: usize = 300;

/// Starts the rendering of an object of this name on a separate thread.
pub(in crate::daemon) fn start_rendering(
    engine: &Arc<Engine>,
    by: &Asker,
    request: &RenderingRequest,
    name: &str,
    render: Render,
) -> Result<Rendering, Problem> {
    let job = Job::render(render, engine.lock().settings.array);
    let failed = |detail: String| Problem::new(Code::Store, detail);
    let command = render_process::command().ok_or_else(|| {
        failed("this program is not meissner and cannot render: start `meissner daemon`".to_owned())
    })?;
    let rendering = {
        let mut state = engine.lock();
        state.check_asker(Some(by))?;
        if state.commands.is_closing() {
            return Err(Problem::new(Code::ShuttingDown, "the daemon is ending: start it again"));
        }
        let (rendering, event) = state.renderings.begin(by.caller.clone(), request, name)?;
        state.publish(&event);
        rendering
    };
    let (works, id) = (Arc::clone(engine), rendering.id);
    let work = move || {
        run_rendering(&works, id, command, job);
        works.changed.notify_one();
    };
    if let Err(error) = thread::Builder::new().name("rendering".into()).spawn(work) {
        let detail = format!("the rendering's thread cannot start: {error}");
        end(engine, id, Err(detail.clone()));
        return Err(failed(detail));
    }
    Ok(rendering)
}

fn run_rendering(engine: &Engine, id: u64, command: Command, job: Job) {
    let mut process = match RenderProcess::start(command) {
        Ok(process) => process,
        Err(error) => {
            return end(engine, id, Err(format!("the rendering's process cannot start: {error}")));
        }
    };
    if engine.lock().renderings.set_process(id, process.pid()) {
        process.give(&job);
        // An object's files are large.
        drop(job);
        let outcome = follow_rendering(engine, id, &mut process);
        end(engine, id, outcome);
    }
}

fn end(engine: &Engine, id: u64, outcome: Result<Box<Rendered>, String>) {
    let mut state = engine.lock();
    if let Some(event) = state.renderings.end(id, outcome) {
        state.publish(&event);
    }
}

/// Reads the process's reports up to its result.
fn follow_rendering(engine: &Engine, id: u64, process: &mut RenderProcess) -> Result<Box<Rendered>, String> {
    let ended = || {
        let mib = MEMORY >> 20;
        format!(
            "the rendering's process has ended without a result: it was killed, or needed more than {mib} MiB"
        )
    };
    loop {
        match process.report().ok_or_else(ended)? {
            Report::Previewed(_) => return Err(ended()),
            Report::Failed(problem) => return Err(cut(&problem, MAX_PROBLEM)),
            Report::Found(text) => {
                let found = stored(&text)?;
                let mut state = engine.lock();
                if let Some(event) = state.renderings.set_found(id, found) {
                    state.publish(&event);
                }
            }
            Report::Rendered(rendered) => return Ok(rendered),
        }
    }
}

fn stored(text: &str) -> Result<Stored, String> {
    let pattern = Pattern::parse(text, "the found pattern").map_err(|error| error.to_string())?;
    Ok(Stored::made(pattern))
}
