//! The plays taken and not ended, in the order in which they are played.
//!
//! It closes their accounts one by one; when a play that runs is over, `connected` decides.
//!
//! Invariant: a play leaves it with exactly one [`StreamEvent::PlayEnded`].

use crate::active::{Active, Ending, Phase};
use crate::control::PositionControl;
use crate::link::Session;
use crate::queues::{CommandError, Emit, MAX_QUEUED_PLAYS, Stamp, StreamEvent};
use firmware_protocol::message::Counters;
use firmware_protocol::tick::Tick;
use meissner_api::{EndCause, LateCause, LatePolicy};
use meissner_array::strokes::Step;
use meissner_array::units::TickRate;
use std::collections::{VecDeque, vec_deque};
use std::ops::{Index, IndexMut};

/// See the module.
#[derive(Debug)]
pub(super) struct Plays {
    queue: VecDeque<Active>,
}

impl Index<usize> for Plays {
    type Output = Active;

    fn index(&self, at: usize) -> &Active {
        &self.queue[at]
    }
}

impl IndexMut<usize> for Plays {
    fn index_mut(&mut self, at: usize) -> &mut Active {
        &mut self.queue[at]
    }
}

impl Plays {
    pub(super) fn new() -> Self {
        Self { queue: VecDeque::with_capacity(2 * MAX_QUEUED_PLAYS + 2) }
    }

    pub(super) fn iter(&self) -> vec_deque::Iter<'_, Active> {
        self.queue.iter()
    }

    pub(super) fn iter_mut(&mut self) -> vec_deque::IterMut<'_, Active> {
        self.queue.iter_mut()
    }

    pub(super) fn len(&self) -> usize {
        self.queue.len()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.queue.is_empty()
    }

    /// Takes a play that follows the others.
    pub(super) fn take(&mut self, active: Active) {
        self.queue.push_back(active);
    }

    /// The play that a step with this first tick belongs to.
    pub(super) fn owner(&mut self, up: Tick) -> Option<&mut Active> {
        self.queue.iter_mut().rev().find(|active| {
            active.phase() != Phase::Waiting && active.onset().is_some_and(|onset| onset <= up)
        })
    }

    /// Cuts all plays, for this reason unless they have one already.
    pub(super) fn cut(&mut self, cause: &EndCause) {
        for active in self.queue.iter_mut().filter(|active| !active.is_cut()) {
            active.cut(cause.clone());
        }
    }

    /// Counts and reports a late step; `free` was the first tick that could be played. Returns whether the plays end by it.
    pub(super) fn late(
        &mut self,
        step: &Step,
        free: Tick,
        cause: LateCause,
        rate: TickRate,
        emit: &mut dyn Emit,
    ) -> bool {
        let late_ms = rate.ticks_to_ms(free - step.begin());
        let Some(active) = self.owner(step.begin()) else { return false };
        let counts = active.late(step, late_ms, cause);
        let (id, policy, cut) = (active.play().id, active.play().late, active.is_cut());
        let (motor, up) = (step.motor(), step.begin());
        emit.event(StreamEvent::StrokeLate { id, motor, up, late_ms, cause, counts });
        let aborts = policy == LatePolicy::Abort && !cut;
        if aborts {
            self.cut(&EndCause::LateStrokes);
        }
        aborts
    }

    /// Ends a play of which nothing was sent, if it is there; `after`: the device's counters; `at`: the tick of its last status.
    pub(super) fn withdraw(
        &mut self,
        id: u64,
        after: Option<Counters>,
        at: Tick,
        control: &PositionControl,
        emit: &mut dyn Emit,
    ) -> Result<(), CommandError> {
        let found = self.queue.iter().position(|active| active.play().id == id && !active.is_cut());
        let Some(index) = found else { return Ok(()) };
        let waits = |active: &Active| active.phase() == Phase::Waiting && active.play().live.is_none();
        if !waits(&self.queue[index]) {
            return Err(CommandError::Begun);
        }
        let Some(mut active) = self.queue.remove(index) else { return Ok(()) };
        active.cut_unsent(EndCause::Withdrawn);
        let rest = control.rest_error_um(at);
        close(active, Ending { after, wire: 0, offset: None, cut: None, rest, estimated: false }, emit);
        Ok(())
    }

    /// Ends the first play.
    pub(super) fn close_first(&mut self, ending: Ending, emit: &mut dyn Emit) {
        if let Some(active) = self.queue.pop_front() {
            close(active, ending, emit);
        }
    }

    /// Ends all plays with the counters known. Without a report of a cut, they count as cut when the link was `lost`.
    pub(super) fn close_all(
        &mut self,
        after: Option<Counters>,
        link: Option<(&Session, Tick)>,
        control: &PositionControl,
        emit: &mut dyn Emit,
    ) {
        let lost = link.map(|(_, lost)| lost);
        let wire = link.map_or(0, |(session, _)| session.traffic().bytes_out);
        let rest = control.rest_error_um(lost.unwrap_or_default());
        while let Some(active) = self.queue.pop_front() {
            let next = self.queue.iter().find_map(Active::counters_at_onset);
            let (after, estimated) = (next.or(after), next.is_none() && lost.is_some());
            let over = active.cut_at().and_then(|(_, over)| over);
            let clock = link.and_then(|(session, _)| session.clock().estimate());
            let offset = over.zip(clock).map(|(tick, clock)| Stamp::new(tick, &clock));
            let lost = lost.filter(|&lost| active.until() > lost);
            let cut = active.cut_at().map(|(at, _)| at).or(lost);
            close(active, Ending { after, wire, offset, cut, rest, estimated }, emit);
        }
    }
}

fn close(active: Active, ending: Ending, emit: &mut dyn Emit) {
    let (id, outcome) = active.close(ending);
    emit.event(StreamEvent::PlayEnded { id, outcome });
}
