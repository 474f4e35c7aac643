//! The running rendering, and those that have ended.
//!
//! A rendering begins without a process, so that its place is taken at once; [`Renderings::set_process`] adds the process. The first
//! to end the rendering, its process or a client that cancels it, decides how it ended. A pattern that it has found by then stays.
//!
//! Invariants: at most one rendering runs, and [`KEPT_RENDERINGS`] that have ended are kept; the process of a running rendering was not
//! waited for, so no other process can get its id.

use crate::daemon::sessions::caller::Caller;
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

    /// Begins a rendering for this client, if none runs. Returns it, and the event that tells of it.
    pub(in crate::daemon) fn begin(
        &mut self,
        caller: Caller,
        request: &RenderingRequest,
        name: &str,
    ) -> Result<(Rendering, Event), Problem> {
        if let Some(Running { rendering: Rendering { id, object, .. }, .. }) = &self.running {
            let detail = format!(
                "rendering {id} of `{object}` runs: wait for its end, or cancel it (`DELETE /v1/renderings/{id}`)"
            );
            return Err(Problem::new(Code::RenderingRunning, detail));
        }
        self.last_id += 1;
        let rendering = Rendering {
            id: self.last_id,
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
        self.running = Some(Running { rendering: search_of, caller, begun, process: None, found: None });
        let event = event(&rendering);
        Ok((rendering, event))
    }

    fn running(&mut self, id: u64) -> Option<&mut Running> {
        self.running.as_mut().filter(|running| running.rendering.id == id)
    }

    /// Sets the rendering's process; false if the rendering was cancelled meanwhile.
    pub(in crate::daemon) fn set_process(&mut self, id: u64, process: Pid) -> bool {
        let running = self.running(id);
        running.is_some_and(|running| {
            running.process = Some(process);
            true
        })
    }

    /// Takes the pattern that was found, and which is judged next.
    pub(in crate::daemon) fn set_found(&mut self, id: u64, found: Stored) -> Option<Event> {
        let running = self.running(id)?;
        running.found = Some(found);
        running.rendering.found = true;
        running.rendering.seconds = running.begun.elapsed().as_secs_f64();
        Some(event(&running.rendering))
    }

    /// Takes the result of the rendering's process, or its failure; has no effect if the rendering was cancelled before.
    pub(in crate::daemon) fn end(
        &mut self,
        id: u64,
        outcome: Result<Box<Rendered>, String>,
    ) -> Option<Event> {
        self.running(id)?;
        match outcome {
            Ok(rendered) => self.settle(RenderingState::Done, Some(rendered), None),
            Err(problem) => self.settle(RenderingState::Failed, None, Some(problem)),
        }
    }

    /// Ends the running rendering, if there is one.
    pub(in crate::daemon) fn cancel(&mut self) -> Option<Event> {
        if let Some(process) = self.running.as_ref()?.process {
            // An error means that it has just ended.
            let _ = kill_process(process, Signal::KILL);
        }
        self.settle(RenderingState::Cancelled, None, None)
    }

    fn settle(
        &mut self,
        state: RenderingState,
        rendered: Option<Box<Rendered>>,
        problem: Option<String>,
    ) -> Option<Event> {
        let Running { mut rendering, begun, found, .. } = self.running.take()?;
        rendering.seconds = begun.elapsed().as_secs_f64();
        (rendering.state, rendering.rendered, rendering.problem) = (state, rendered, problem);
        rendering.found = found.is_some();
        let event = event(&rendering);
        self.ended.push_back(Ended { rendering: Arc::new(rendering), found });
        if self.ended.len() > KEPT_RENDERINGS {
            self.ended.pop_front();
        }
        Some(event)
    }
}

fn event(rendering: &Rendering) -> Event {
    let Rendering { id, state, object, found, seconds, problem, .. } = rendering;
    let (object, problem) = (object.clone(), problem.clone());
    let (id, state, found, seconds) = (*id, *state, *found, *seconds);
    Event::Rendering { id, state, object, found, seconds, problem }
}
