//! The running search, and those that have ended.
//!
//! A search begins without a process, so that its place is taken at once; [`State::set_search_process`] adds the process. The first
//! to end the search, its process or a client that cancels it, decides how it ended. A pattern that it has found by then stays.
//!
//! Invariants: at most one search runs, and [`KEPT_SEARCHES`] that have ended are kept; the process of a running search was not
//! waited for, so no other process can get its id.

use crate::daemon::state::{Asker, Caller, State};
use crate::store::Stored;
use meissner_api::{
    Code, Event, KEPT_SEARCHES, Problem, Rendered, Search, SearchProgress, SearchRequest, SearchResult,
    SearchState,
};
use rustix::process::{Pid, Signal, kill_process};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

/// See the module.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Searches {
    last_id: u64,
    running: Option<Running>,
    ended: VecDeque<Ended>,
}

#[derive(Debug)]
struct Running {
    search: Search,
    /// The client that has started it; none: the daemon itself.
    caller: Option<Caller>,
    begun: Instant,
    process: Option<Pid>,
    found: Option<Stored>,
}

#[derive(Debug)]
struct Ended {
    search: Arc<Search>,
    found: Option<Stored>,
}

/// The result of a search.
#[derive(Debug)]
pub(in crate::daemon) enum Found {
    /// For a target: as the API shows it, and the pattern.
    Target(Box<SearchResult>, Stored),
    /// For an object, whose pattern came before.
    Object(Box<Rendered>),
}

impl Searches {
    /// The client that has started the running search.
    pub(super) fn caller(&self) -> Option<&Caller> {
        self.running.as_ref()?.caller.as_ref()
    }

    /// The number of the newest search, if there was one.
    pub(in crate::daemon) fn last_id(&self) -> Option<u64> {
        Some(self.last_id).filter(|id| *id > 0)
    }

    /// The search with this id, or the `last` one.
    pub(in crate::daemon) fn show(&self, id: &str) -> Result<Arc<Search>, Problem> {
        let id = self.id(id)?;
        if let Some(Running { search, begun, .. }) = self.running.as_ref().filter(|it| it.search.id == id) {
            let mut search = search.clone();
            search.progress.seconds = begun.elapsed().as_secs_f64();
            return Ok(Arc::new(search));
        }
        Ok(Arc::clone(&self.ended(id)?.search))
    }

    /// The pattern that the search with this id has found.
    pub(in crate::daemon) fn found(&self, id: &str) -> Result<Stored, Problem> {
        let id = self.id(id)?;
        let none = || {
            let detail =
                format!("search {id} has found no pattern: `GET /v1/searches/{id}` says how it stands");
            Problem::new(Code::NotFound, detail)
        };
        if let Some(running) = self.running.as_ref().filter(|it| it.search.id == id) {
            return running.found.clone().ok_or_else(none);
        }
        self.ended(id)?.found.clone().ok_or_else(none)
    }

    fn ended(&self, id: u64) -> Result<&Ended, Problem> {
        let none = || {
            let detail = format!("there is no search {id}: the last {KEPT_SEARCHES} that ended are kept");
            Problem::new(Code::NotFound, detail)
        };
        self.ended.iter().find(|ended| ended.search.id == id).ok_or_else(none)
    }

    fn id(&self, id: &str) -> Result<u64, Problem> {
        if id == "last" {
            let none = || Problem::new(Code::NotFound, "there is no search yet: start one");
            return self.last_id().ok_or_else(none);
        }
        let bad = |_| Problem::new(Code::BadRequest, "a search's id is a number, or `last`");
        id.parse().map_err(bad)
    }
}

impl State {
    /// Begins a search, if none runs.
    pub(in crate::daemon) fn begin_search(
        &mut self,
        request: &SearchRequest,
        name: &str,
    ) -> Result<Search, Problem> {
        self.check_asker()?;
        if self.commands.is_closing() {
            return Err(Problem::new(Code::ShuttingDown, "the daemon is ending: start it again"));
        }
        if let Some(Running { search: Search { id, target, .. }, .. }) = &self.searches.running {
            let detail = format!(
                "search {id} for `{target}` runs: wait for its end, or cancel it (`DELETE /v1/searches/{id}`)"
            );
            return Err(Problem::new(Code::SearchRunning, detail));
        }
        self.searches.last_id += 1;
        let caller = Asker::find().map(|asker| asker.caller);
        let SearchRequest { objective, model, setting, seed, robust, .. } = *request;
        let search = Search {
            id: self.searches.last_id,
            state: SearchState::Running,
            target: name.to_owned(),
            objective,
            model,
            setting,
            seed,
            robust,
            method: request.object.as_ref().map(|_| request.method.unwrap_or_default()),
            found: false,
            progress: SearchProgress::default(),
            problem: None,
            result: None,
            rendered: None,
        };
        let (search_of, begun) = (search.clone(), Instant::now());
        self.searches.running =
            Some(Running { search: search_of, caller, begun, process: None, found: None });
        self.publish_search(&search);
        Ok(search)
    }

    /// Sets the search's process; false if the search was cancelled meanwhile.
    pub(in crate::daemon) fn set_search_process(&mut self, id: u64, process: Pid) -> bool {
        let running = self.searches.running.as_mut().filter(|it| it.search.id == id);
        running.is_some_and(|running| {
            running.process = Some(process);
            true
        })
    }

    /// Sets the search's progress.
    pub(in crate::daemon) fn set_search_progress(&mut self, id: u64, progress: SearchProgress) {
        let Some(running) = self.searches.running.as_mut().filter(|it| it.search.id == id) else { return };
        let seconds = running.begun.elapsed().as_secs_f64();
        running.search.progress = SearchProgress { seconds, ..progress };
        let search = running.search.clone();
        self.publish_search(&search);
    }

    /// Takes the pattern that the search has found for an object, and which it judges next.
    pub(in crate::daemon) fn set_search_found(&mut self, id: u64, found: Stored) {
        let Some(running) = self.searches.running.as_mut().filter(|it| it.search.id == id) else { return };
        running.found = Some(found);
        running.search.found = true;
        running.search.progress.seconds = running.begun.elapsed().as_secs_f64();
        let search = running.search.clone();
        self.publish_search(&search);
    }

    /// Takes the result of the search's process, or its failure; has no effect if the search was cancelled before.
    pub(in crate::daemon) fn end_search(&mut self, id: u64, outcome: Result<Found, String>) {
        if self.searches.running.as_ref().is_none_or(|it| it.search.id != id) {
            return;
        }
        match outcome {
            Ok(found) => self.settle_search(SearchState::Done, Some(found), None),
            Err(problem) => self.settle_search(SearchState::Failed, None, Some(problem)),
        }
    }

    /// Ends the search with this id, or the `last` one, if it runs.
    pub(in crate::daemon) fn cancel_search(&mut self, id: &str) -> Result<Arc<Search>, Problem> {
        self.check_asker()?;
        let shown = self.searches.show(id)?;
        if shown.state == SearchState::Running {
            self.cancel_running_search();
        }
        self.searches.show(&shown.id.to_string())
    }

    /// Ends the running search, if there is one.
    pub(in crate::daemon) fn cancel_running_search(&mut self) {
        let Some(running) = &self.searches.running else { return };
        if let Some(process) = running.process {
            // An error means that it has just ended.
            let _ = kill_process(process, Signal::KILL);
        }
        self.settle_search(SearchState::Cancelled, None, None);
    }

    fn settle_search(&mut self, state: SearchState, result: Option<Found>, problem: Option<String>) {
        let Some(Running { mut search, begun, mut found, .. }) = self.searches.running.take() else { return };
        search.progress.seconds = begun.elapsed().as_secs_f64();
        (search.state, search.problem) = (state, problem);
        match result {
            Some(Found::Target(result, pattern)) => (search.result, found) = (Some(result), Some(pattern)),
            Some(Found::Object(rendered)) => search.rendered = Some(rendered),
            None => {}
        }
        search.found = found.is_some();
        self.publish_search(&search);
        self.searches.ended.push_back(Ended { search: Arc::new(search), found });
        if self.searches.ended.len() > KEPT_SEARCHES {
            self.searches.ended.pop_front();
        }
    }

    fn publish_search(&mut self, search: &Search) {
        let Search { id, state, target, found, progress, problem, .. } = search;
        let (target, problem) = (target.clone(), problem.clone());
        let (id, state, found, progress) = (*id, *state, *found, *progress);
        self.publish(&Event::Search { id, state, target, found, progress, problem });
    }
}
