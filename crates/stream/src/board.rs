//! What a device's board reports say of one play.
//!
//! The streamer asks for a report when it offers a play ([`BoardAccount::begins`]) and when the play is over
//! ([`BoardAccount::ends`]), and passes each answer on ([`BoardAccount::heard`]).
//!
//! Invariant: the account covers the whole play, from the last report before its onset to the first after its end, or is `None`.

use firmware_protocol::board::{Board, Counts};
use firmware_protocol::tick::Tick;
use meissner_array::units::TickRate;

/// How long a receipt waits for the report after a play, ms. If it takes longer, the line is broken.
const WITHIN_MS: u64 = 200;

/// What the device counted while a play ran. `None`: the device does not measure it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlayBoard {
    /// Least time left to render, ticks.
    pub slack: Option<u8>,
    /// What it counted.
    pub counts: Counts,
}

/// The account of one play: see the module.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BoardAccount {
    /// The request whose answer covers the time just before the play.
    from: u16,
    before: Option<Board>,
    /// A later report has come. Kept, because numbers of windows repeat after 65 536 of them, which takes hours.
    begun: bool,
    /// The request whose answer covers the play's end, and when the streamer first saw that it is over.
    until: Option<(u16, Tick)>,
    after: Option<Board>,
    slack: Option<u8>,
}

impl BoardAccount {
    /// The play is offered. The streamer has just asked for the report `from`; `last` is the last report that came.
    pub(super) fn begins(&mut self, from: u16, last: Option<Board>) {
        *self = Self { from, before: last, ..Self::default() };
    }

    /// The play is over at `tick`; `ask` asks for a report. Returns whether to stop waiting: the account is complete, or never
    /// will be.
    pub(super) fn ends(&mut self, tick: Tick, rate: TickRate, ask: impl FnOnce() -> u16) -> bool {
        let (_, since) = *self.until.get_or_insert_with(|| (ask(), tick));
        self.after.is_some() || tick >= since + rate.of_ms(WITHIN_MS)
    }

    /// A report has come.
    pub(super) fn heard(&mut self, board: Board) {
        if self.after.is_some() {
            return;
        }
        self.begun |= (1..u16::MAX / 2).contains(&board.window.wrapping_sub(self.from));
        if self.begun {
            self.slack = match (self.slack, board.slack) {
                (Some(a), Some(b)) => Some(a.min(b)),
                (a, b) => a.or(b),
            };
        } else {
            self.before = Some(board);
        }
        if self.until.is_some_and(|(until, _)| board.window == until) {
            self.after = Some(board);
        }
    }

    /// The account, if it is complete.
    pub(super) fn close(&self) -> Option<PlayBoard> {
        let (before, after) = (self.before?, self.after?);
        Some(PlayBoard { slack: self.slack, counts: after.counts.since(&before.counts) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_protocol::board::Reset;
    use meissner_test_support::paper::RATE;

    fn report(window: u16, slack: Option<u8>, stalls: u32) -> Board {
        Board {
            window,
            reset: Reset::Power,
            uptime_s: 1,
            slack,
            slack_since_boot: slack,
            counts: Counts { stalls: Some(stalls), ..Counts::NONE },
            high_at_boot: None,
        }
    }

    #[test]
    fn an_account_covers_the_play_and_no_more() {
        let mut account = BoardAccount::default();
        account.begins(u16::MAX, Some(report(u16::MAX - 1, Some(1), 1)));
        account.heard(report(u16::MAX, Some(2), 3));
        account.heard(report(0, Some(30), 4));
        assert!(!account.ends(Tick(100), RATE, || 2));
        account.heard(report(1, Some(28), 5));
        assert!(!account.ends(Tick(101), RATE, || unreachable!("asked once")) && account.close().is_none());
        account.heard(report(2, None, 6));
        assert!(account.ends(Tick(102), RATE, || unreachable!("asked once")));
        account.heard(report(3, Some(3), 9));
        let closed = account.close().expect("a complete account");
        assert_eq!((closed.slack, closed.counts), (Some(28), Counts { stalls: Some(3), ..Counts::NONE }));
    }

    #[test]
    fn a_receipt_does_not_wait_for_ever() {
        let mut account = BoardAccount::default();
        account.begins(4, None);
        assert!(
            !account.ends(Tick(0), RATE, || 5) && !account.ends(Tick(RATE.of_ms(WITHIN_MS) - 1), RATE, || 5)
        );
        assert!(account.ends(Tick(RATE.of_ms(WITHIN_MS)), RATE, || 5) && account.close().is_none());
    }
}
