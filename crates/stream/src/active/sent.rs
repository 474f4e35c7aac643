//! How far the steps of a play are sent.
//!
//! The streamer looks at the next step ([`Sent::next`]), counts it once it is sent or too late ([`Sent::count`]), and counts each
//! verdict ([`Sent::decided`]).
//!
//! Invariant: a step taken from the source is the next one until it is counted or put back.

use crate::source::Source;
use firmware_protocol::tick::Tick;
use meissner_array::strokes::{Step, StrokesError};

/// See the module.
#[derive(Debug)]
pub(super) struct Sent {
    /// The next step, once it is taken from the source.
    next: Option<Step>,
    /// The last item that has begun.
    item: usize,
    /// Steps sent without a verdict.
    undecided: u64,
    /// The end of the last step counted.
    last_end: Tick,
}

impl Sent {
    /// Nothing is sent of a play that begins at `onset`.
    pub(super) const fn nothing(onset: Tick) -> Self {
        Self { next: None, item: 0, undecided: 0, last_end: onset }
    }

    /// The next step to send; `None`: the source has no more for now.
    pub(super) fn next(&mut self, source: &mut Source) -> Result<Option<Step>, StrokesError> {
        if self.next.is_none() {
            self.next = source.next().transpose()?;
        }
        Ok(self.next)
    }

    /// Puts the next stroke of a live play back: its drive changes.
    pub(super) fn put_back(&mut self, source: &mut Source) {
        if let Some(strokes) = source.live()
            && let Some(next) = self.next.take()
        {
            strokes.put_back(&next);
        }
    }

    /// The start of the next step, if it is taken from the source and of this motor.
    pub(super) fn next_up(&self, motor: u8) -> Option<Tick> {
        self.next.filter(|next| next.motor() == motor).map(|next| next.begin())
    }

    /// The next step, if it is taken from the source.
    pub(super) const fn pending(&self) -> Option<&Step> {
        self.next.as_ref()
    }

    /// When the next item begins, if no step before that follows.
    pub(super) fn next_onset(&self, source: &Source) -> Option<Tick> {
        if self.next.is_some() { None } else { source.next_onset() }
    }

    /// This item has begun.
    pub(super) const fn begin_item(&mut self, item: usize) {
        self.item = item;
    }

    pub(super) const fn item(&self) -> usize {
        self.item
    }

    /// Counts a step that is sent, or too late to be `sent`.
    pub(super) fn count(&mut self, step: &Step, sent: bool) {
        self.next = None;
        self.undecided += u64::from(sent);
        self.last_end = self.last_end.max(step.end());
    }

    /// The device has accepted or rejected a step.
    pub(super) const fn decided(&mut self) {
        self.undecided = self.undecided.saturating_sub(1);
    }

    /// The device has rejected all steps.
    pub(super) const fn all_rejected(&mut self) {
        self.undecided = 0;
    }

    pub(super) const fn is_decided(&self) -> bool {
        self.undecided == 0
    }

    pub(super) const fn last_end(&self) -> Tick {
        self.last_end
    }
}
