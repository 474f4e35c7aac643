//! The running rendering, and those that have ended.
//!
//! A rendering begins without a process, so that its place is taken at once; [`State::set_rendering_process`] adds the process. The first
//! to end the rendering, its process or a client that cancels it, decides how it ended. A pattern that it has found by then stays.
//!
//! Invariants: at most one rendering runs, and [`KEPT_RENDERINGS`] that have ended are kept; the process of a running rendering was not
//! waited for, so no other process can get its id.

use crate::daemon::core::state::State;
use crate::daemon::sessions::caller::{Asker, Caller};
use crate::store::Stored;
use meissner_api::{
    Code, Event, KEPT_RENDERINGS, Problem, Rendered, Rendering, RenderingRequest, RenderingState,
};
use rustix::process::{Pid, Signal, kill_process};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

/// See the module.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Renderings {
    last_id: u64,
    running: Option<Running>,
    ended: VecDeque<Ended>,
}

#[derive(Debug)]
struct Running {
    rendering: Rendering,
    /// The client that has started it.
    caller: Caller,
    begun: Instant,
    process: Option<Pid>,
    found: Option<Stored>,
}

#[derive(Debug)]
struct Ended {
    rendering: Arc<Rendering>,
    found: Option<Stored>,
}

impl Renderings {
    /// The client that has started the running rendering.
    pub(in crate::daemon) fn caller(&self) -> Option<&Caller> {
        Some(&self.running.as_ref()?.caller)
    }

    /// The number of the newest rendering, if there was one.
    pub(in crate::daemon) fn last_id(&self) -> Option<u64> {
        Some(self.last_id).filter(|id| *id > 0)
    }

    /// The rendering with this id, or the `last` one.
    pub(in crate::daemon) fn show(&self, id: &str) -> Result<Arc<Rendering>, Problem> {
        let id = self.id(id)?;
        if let Some(Running { rendering, begun, .. }) =
            self.running.as_ref().filter(|it| it.rendering.id == id)
        {
            let mut rendering = rendering.clone();
            rendering.seconds = begun.elapsed().as_secs_f64();
            return Ok(Arc::new(rendering));
        }
        Ok(Arc::clone(&self.ended(id)?.rendering))
    }

    /// The pattern that the rendering with this id has found.
    pub(in crate::daemon) fn found(&self, id: &str) -> Result<Stored, Problem> {
        let id = self.id(id)?;
        let none = || {
            let detail =
                format!("rendering {id} has found no pattern: `GET /v1/renderings/{id}` says how it stands");
            Problem::new(Code::NotFound, detail)
        };
        if let Some(running) = self.running.as_ref().filter(|it| it.rendering.id == id) {
            return running.found.clone().ok_or_else(none);
        }
        self.ended(id)?.found.clone().ok_or_else(none)
    }

    fn ended(&self, id: u64) -> Result<&Ended, Problem> {
        let none = || {
            let detail =
                format!("there is no rendering {id}: the last {KEPT_RENDERINGS} that ended are kept");
            Problem::new(Code::NotFound, detail)
        };
        self.ended.iter().find(|ended| ended.rendering.id == id).ok_or_else(none)
    }

    fn id(&self, id: &str) -> Result<u64, Problem> {
        if id == "last" {
            let none = || Problem::new(Code::NotFound, "there is no rendering yet: start one");
            return self.last_id().ok_or_else(none);
        }
        let bad = |_| Problem::new(Code::BadRequest, "a rendering's id is a number, or `last`");
        id.parse().map_err(bad)
    }
}

impl State {
    /// Begins a rendering, if none runs.
    pub(in crate::daemon) fn begin_rendering(
        &mut self,
        by: &Asker,
        request: &RenderingRequest,
        name: &str,
    ) -> Result<Rendering, Problem> {
        self.check_asker(Some(by))?;
        if self.commands.is_closing() {
            return Err(Problem::new(Code::ShuttingDown, "the daemon is ending: start it again"));
        }
        if let Some(Running { rendering: Rendering { id, object, .. }, .. }) = &self.renderings.running {
            let detail = format!(
                "rendering {id} of `{object}` runs: wait for its end, or cancel it (`DELETE /v1/renderings/{id}`)"
            );
            return Err(Problem::new(Code::RenderingRunning, detail));
        }
        self.renderings.last_id += 1;
        let caller = by.caller.clone();
        let rendering = Rendering {
            id: self.renderings.last_id,
            state: RenderingState::Running,
            object: name.to_owned(),
            method: request.method,
            seed: request.seed,
            found: false,
            seconds: 0.0,
            problem: None,
            rendered: None,
        };
        let (search_of, begun) = (rendering.clone(), Instant::now());
        self.renderings.running =
            Some(Running { rendering: search_of, caller, begun, process: None, found: None });
        self.publish_rendering(&rendering);
        Ok(rendering)
    }

    /// Sets the rendering's process; false if the rendering was cancelled meanwhile.
    pub(in crate::daemon) fn set_rendering_process(&mut self, id: u64, process: Pid) -> bool {
        let running = self.renderings.running.as_mut().filter(|it| it.rendering.id == id);
        running.is_some_and(|running| {
            running.process = Some(process);
            true
        })
    }

    /// Takes the pattern that was found, and which is judged next.
    pub(in crate::daemon) fn set_rendering_found(&mut self, id: u64, found: Stored) {
        let Some(running) = self.renderings.running.as_mut().filter(|it| it.rendering.id == id) else {
            return;
        };
        running.found = Some(found);
        running.rendering.found = true;
        running.rendering.seconds = running.begun.elapsed().as_secs_f64();
        let rendering = running.rendering.clone();
        self.publish_rendering(&rendering);
    }

    /// Takes the result of the rendering's process, or its failure; has no effect if the rendering was cancelled before.
    pub(in crate::daemon) fn end_rendering(&mut self, id: u64, outcome: Result<Box<Rendered>, String>) {
        if self.renderings.running.as_ref().is_none_or(|it| it.rendering.id != id) {
            return;
        }
        match outcome {
            Ok(rendered) => self.settle_rendering(RenderingState::Done, Some(rendered), None),
            Err(problem) => self.settle_rendering(RenderingState::Failed, None, Some(problem)),
        }
    }

    /// Ends the rendering with this id, or the `last` one, if it runs.
    pub(in crate::daemon) fn cancel_rendering(
        &mut self,
        by: &Asker,
        id: &str,
    ) -> Result<Arc<Rendering>, Problem> {
        self.check_asker(Some(by))?;
        let shown = self.renderings.show(id)?;
        if shown.state == RenderingState::Running {
            self.cancel_running_rendering();
        }
        self.renderings.show(&shown.id.to_string())
    }

    /// Ends the running rendering, if there is one.
    pub(in crate::daemon) fn cancel_running_rendering(&mut self) {
        let Some(running) = &self.renderings.running else { return };
        if let Some(process) = running.process {
            // An error means that it has just ended.
            let _ = kill_process(process, Signal::KILL);
        }
        self.settle_rendering(RenderingState::Cancelled, None, None);
    }

    fn settle_rendering(
        &mut self,
        state: RenderingState,
        rendered: Option<Box<Rendered>>,
        problem: Option<String>,
    ) {
        let Some(Running { mut rendering, begun, found, .. }) = self.renderings.running.take() else {
            return;
        };
        rendering.seconds = begun.elapsed().as_secs_f64();
        (rendering.state, rendering.rendered, rendering.problem) = (state, rendered, problem);
        rendering.found = found.is_some();
        self.publish_rendering(&rendering);
        self.renderings.ended.push_back(Ended { rendering: Arc::new(rendering), found });
        if self.renderings.ended.len() > KEPT_RENDERINGS {
            self.renderings.ended.pop_front();
        }
    }

    fn publish_rendering(&mut self, rendering: &Rendering) {
        let Rendering { id, state, object, found, seconds, problem, .. } = rendering;
        let (object, problem) = (object.clone(), problem.clone());
        let (id, state, found, seconds) = (*id, *state, *found, *seconds);
        self.publish(&Event::Rendering { id, state, object, found, seconds, problem });
    }
}
