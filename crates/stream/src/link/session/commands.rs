//! The command under way, the epochs, and the last e-stops to a device that is not trusted.
//!
//! Each command begins an epoch and is repeated until a status of that epoch answers it. An e-stop is also handed out ahead of the
//! bytes that wait ([`Commands::take_e_stop`]).
//!
//! Invariant: at most one command waits for its answer, the newest, in the newest epoch.

use crate::link::session::repetition::{Repetition, Turn};
use crate::time::HostInstant;
use firmware_protocol::message::Op;
use std::time::Duration;

/// E-stops to a device that is not trusted: a tenth of a second in all.
const E_STOPS: u16 = 20;
const E_STOP_EVERY: Duration = Duration::from_millis(5);
/// Each e-stop begins an epoch a third of their range from the last, so one of three is newer, whatever the device's epoch is.
const E_STOP_EPOCHS: u16 = 0x5555;

#[derive(Clone, Copy, Debug)]
struct Command {
    op: Op,
    first_sent: Option<HostInstant>,
    sent: Option<HostInstant>,
    /// Its frame was sent, or its e-stop has gone ahead of the bytes that wait: the device may answer.
    under_way: bool,
}

/// The commands of a session.
#[derive(Clone, Debug)]
pub(super) struct Commands {
    epoch: u16,
    /// The epoch the session began with.
    first_epoch: u16,
    waiting: Option<Command>,
    /// The epoch of an e-stop that [`Self::take_e_stop`] has not returned yet.
    new_e_stop: Option<u16>,
    /// The e-stops sent to a device that is not trusted.
    last: Repetition,
}

impl Commands {
    pub(super) const fn new() -> Self {
        let last = Repetition::new(E_STOP_EVERY);
        Self { epoch: 0, first_epoch: 0, waiting: None, new_e_stop: None, last }
    }

    /// The handshake is done, and the device is in this epoch.
    pub(super) const fn open(&mut self, epoch: u16) {
        (self.epoch, self.first_epoch) = (epoch, epoch);
    }

    pub(super) const fn epoch(&self) -> u16 {
        self.epoch
    }

    /// An epoch that was over before the session began: the device ignores its strokes.
    pub(super) const fn past_epoch(&self) -> u16 {
        self.first_epoch.wrapping_sub(1)
    }

    /// Begins a command, and gives up the one that waits.
    pub(super) fn begin(&mut self, op: Op) {
        self.epoch = self.epoch.wrapping_add(1);
        self.waiting = Some(Command { op, first_sent: None, sent: None, under_way: false });
        self.new_e_stop = (op == Op::EStop).then_some(self.epoch);
    }

    /// The command that waits for its answer, and whether the device may know it.
    pub(super) fn waiting(&self) -> Option<(Op, bool)> {
        self.waiting.map(|command| (command.op, command.under_way))
    }

    pub(super) const fn is_waiting(&self) -> bool {
        self.waiting.is_some()
    }

    /// When the command that waits was first sent.
    pub(super) fn waiting_since(&self) -> Option<HostInstant> {
        self.waiting?.first_sent
    }

    /// A status of the present epoch came: the command that it answers.
    pub(super) fn answer(&mut self) -> Option<Op> {
        self.waiting.take_if(|command| command.under_way).map(|command| command.op)
    }

    /// The command to be sent at `now`, and whether it was sent before, at least `retry` ago.
    pub(super) fn next(&mut self, now: HostInstant, retry: Duration) -> Option<(Op, bool)> {
        let command = self.waiting.as_mut()?;
        if command.sent.is_some_and(|sent| now.since(sent) < retry) {
            return None;
        }
        command.first_sent.get_or_insert(now);
        command.under_way = true;
        Some((command.op, command.sent.replace(now).is_some()))
    }

    /// When [`Self::next`] has a command, if no answer comes.
    pub(super) fn due(&self, now: HostInstant, retry: Duration) -> Option<HostInstant> {
        Some(self.waiting?.sent.map_or(now, |sent| sent + retry))
    }

    /// The epoch of an e-stop that has become due, once.
    pub(super) fn take_e_stop(&mut self) -> Option<u16> {
        let epoch = self.new_e_stop.take()?;
        if let Some(command) = &mut self.waiting {
            command.under_way = true;
        }
        Some(epoch)
    }

    /// When an e-stop first left for the device, if the device has not answered it.
    pub(super) fn e_stopped_at(&self) -> Option<HostInstant> {
        let waiting = self.waiting.filter(|command| command.op == Op::EStop);
        self.last.first().or(waiting.and_then(|command| command.first_sent))
    }

    /// The device is not trusted: only e-stops are left.
    pub(super) const fn close(&mut self) {
        self.waiting = None;
        // Its frame may wait behind bytes that the device does not take.
        self.new_e_stop = Some(self.last_epoch(1));
    }

    /// The turn at `now` after [`Self::close`]; to send is an e-stop of the epoch that it names.
    pub(super) fn next_last(&mut self, now: HostInstant) -> Turn {
        let turn = self.last.next(now, E_STOPS);
        let Turn::Send(number) = turn else { return turn };
        let epoch = self.last_epoch(number);
        if number > 1 {
            self.new_e_stop = Some(epoch);
        }
        Turn::Send(epoch)
    }

    /// When [`Self::next_last`] is due.
    pub(super) fn last_due(&self, now: HostInstant) -> HostInstant {
        self.last.due(now)
    }

    const fn last_epoch(&self, number: u16) -> u16 {
        self.epoch.wrapping_add(1).wrapping_add(number.wrapping_mul(E_STOP_EPOCHS))
    }
}
