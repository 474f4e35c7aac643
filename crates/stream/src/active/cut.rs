//! Why a play was cut, and what the device has reported of the cut.
//!
//! [`Cut::order`] takes the host's cause. [`Cut::report`] and [`Cut::note_at`] take the device's report, which may come before the
//! cause or after it.
//!
//! Invariant: the first cause stays, and so does the first report.

use firmware_protocol::tick::Tick;
use meissner_api::EndCause;

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Cut {
    cause: Option<EndCause>,
    /// The device has reported a cut.
    reported: bool,
    /// When the device cut the play, and when its last pulse was over.
    at: Option<(Tick, Option<Tick>)>,
}

impl Cut {
    /// Cuts the play for this cause, unless it is cut.
    pub(super) fn order(&mut self, cause: EndCause) {
        self.cause.get_or_insert(cause);
    }

    /// The device has reported a cut; returns whether this is the first report.
    pub(super) const fn report(&mut self) -> bool {
        !std::mem::replace(&mut self.reported, true)
    }

    /// The device cut the play at this time, and its last pulse was over at `over`.
    pub(super) fn note_at(&mut self, at: Tick, over: Option<Tick>) {
        self.at.get_or_insert((at, over));
    }

    /// The device cut the return, too: no pulse comes after that.
    pub(super) fn note_return_at(&mut self, at: Tick) {
        if let Some((_, Some(over))) = &mut self.at {
            *over = at.min(*over);
        }
    }

    /// Whether the play has a cause to end.
    pub(super) const fn is_ordered(&self) -> bool {
        self.cause.is_some()
    }

    /// Whether the device may still play: there is neither a cause nor a report.
    pub(super) const fn is_open(&self) -> bool {
        self.cause.is_none() && !self.reported
    }

    pub(super) const fn at(&self) -> Option<(Tick, Option<Tick>)> {
        self.at
    }

    pub(super) fn into_cause(self) -> Option<EndCause> {
        self.cause
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_cause_and_the_first_report_stay() {
        let mut cut = Cut::default();
        assert!(cut.is_open());
        assert!(cut.report() && !cut.report());
        assert!(!cut.is_open() && !cut.is_ordered());
        for (at, over) in [(Tick(7), Some(Tick(9))), (Tick(8), None)] {
            cut.note_at(at, over);
        }
        assert_eq!(cut.at(), Some((Tick(7), Some(Tick(9)))));
        for (at, over) in [(Tick(12), Tick(9)), (Tick(8), Tick(8))] {
            cut.note_return_at(at);
            assert_eq!(cut.at(), Some((Tick(7), Some(over))));
        }
        cut.order(EndCause::Stop);
        cut.order(EndCause::EStop);
        assert!(cut.is_ordered());
        assert_eq!(cut.into_cause(), Some(EndCause::Stop));
    }
}
