//! The state of the device, how it leaves it, and motion that belongs to no play: returns, shifts of rest, seeks of the lower stop.
//!
//! Invariant: a fault or an e-stop latches until a reset. Shifts and seeks begin while no move waits and all pins are at rest.

mod pins;

use crate::controller::player::Player;
use crate::controller::reporting::Reporting;
use crate::limits::{PowerLimits, Refusal};
use crate::message::{Cause, Cut, LowerStop, State};
use crate::stroke::Direction;
use crate::tick::Tick;
use pins::Pins;

#[derive(Clone, Debug)]
pub(super) struct Motion {
    state: State,
    cause: Cause,
    /// The state after a return.
    then: State,
    /// End of what was rendered before an e-stop.
    off_until: Tick,
    pins: Pins,
}

impl Motion {
    /// Disarmed since the start at `now`.
    pub(super) const fn new(now: Tick) -> Self {
        Self {
            state: State::Disarmed,
            cause: Cause::Boot,
            then: State::Disarmed,
            off_until: now,
            pins: Pins::UNKNOWN,
        }
    }

    pub(super) fn state(&self) -> State {
        self.state
    }

    pub(super) fn cause(&self) -> Cause {
        self.cause
    }

    pub(super) fn set_cause(&mut self, cause: Cause) {
        self.cause = cause;
    }

    pub(super) fn is_armed(&self) -> bool {
        self.state == State::Armed
    }

    /// Whether it needs a host: armed or returning.
    pub(super) fn is_active(&self) -> bool {
        matches!(self.state, State::Armed | State::Returning)
    }

    pub(super) fn forced_off(&self, now: Tick) -> bool {
        self.state == State::Faulted || now < self.off_until
    }

    pub(super) fn pins(&self) -> &Pins {
        &self.pins
    }

    /// Nobody knows any more where the pins are.
    pub(super) fn lose_position(&mut self) {
        self.pins.lose_position();
    }

    /// Returns, then disarms.
    pub(super) fn disarm(&mut self, cause: Cause, now: Tick, player: &mut Player, reporting: &mut Reporting) {
        match self.state {
            State::Armed => self.cut(cause, State::Disarmed, now, player, reporting),
            State::Returning => (self.then, self.cause) = (State::Disarmed, cause),
            State::Disarmed | State::Faulted => {}
        }
    }

    /// Returns, and stays armed.
    pub(super) fn stop(&mut self, now: Tick, player: &mut Player, reporting: &mut Reporting) {
        if self.is_armed() {
            self.cut(Cause::Stop, State::Armed, now, player, reporting);
        }
    }

    fn cut(&mut self, cause: Cause, then: State, now: Tick, player: &mut Player, reporting: &mut Reporting) {
        let at = player.rendered().wire();
        // What is rendered is played, unless an e-stop follows.
        if let Some(shift) = player.shift_at(player.rendered()) {
            self.pins.take_back(shift);
        }
        let (flushed, outstanding) = player.cut(reporting);
        let return_ticks = Some(player.return_ticks());
        self.finish_cut(Cut { cause, at, return_ticks, flushed, outstanding }, reporting);
        (self.state, self.then) = (State::Returning, then);
        self.settle(now, player, reporting);
    }

    /// Turns all lines off; nothing from `at` on was played. Returns whether they were not off before.
    pub(super) fn off_from(
        &mut self,
        cause: Cause,
        at: Tick,
        player: &mut Player,
        reporting: &mut Reporting,
    ) -> bool {
        if self.state == State::Faulted {
            return false;
        }
        if let Some(shift) = player.shift_at(at) {
            self.pins.take_back(shift);
        }
        let flushed = player.turn_off(at, reporting);
        if self.pins.seeks() {
            player.assume_rest();
        }
        self.pins.abort_seek();
        self.off_until = player.rendered();
        self.state = State::Faulted;
        let outstanding = player.heights_total();
        self.finish_cut(Cut { cause, at: at.wire(), return_ticks: None, flushed, outstanding }, reporting);
        true
    }

    fn finish_cut(&mut self, cut: Cut, reporting: &mut Reporting) {
        self.cause = cut.cause;
        reporting.report_cut(cut);
    }

    /// Leaves the latched state.
    pub(super) fn reset(&mut self) {
        if self.state == State::Faulted {
            (self.state, self.cause) = (State::Disarmed, Cause::Request);
        }
    }

    /// Books what was played before `now`. A return is over when all pins are still.
    pub(super) fn settle(&mut self, now: Tick, player: &mut Player, reporting: &mut Reporting) {
        player.settle(now, reporting);
        if self.state == State::Returning && player.is_still(now) {
            self.state = self.then;
            self.pins.finish_seek();
            reporting.pending.status = true;
        }
    }

    /// Plays the outstanding return pulses or seeks the lower stop, then takes moves.
    pub(super) fn arm(
        &mut self,
        assume_rest: bool,
        limits: PowerLimits,
        lower_stop: Option<LowerStop>,
        player: &mut Player,
        reporting: &mut Reporting,
    ) -> Result<(), Refusal> {
        if self.state != State::Disarmed {
            return Err(Refusal::State);
        }
        let LowerStop { pulses_per_s, seek } = lower_stop.unwrap_or(LowerStop { pulses_per_s: 0, seek: 0 });
        player.set_limits(limits, pulses_per_s);
        if seek > 0 {
            return self.begin_seek(seek, player, reporting);
        }
        if assume_rest {
            self.pins.assume_rest();
            player.assume_rest();
        }
        if !self.pins.position_known() {
            return Err(Refusal::PositionUnknown);
        }
        (self.state, self.cause) = (State::Armed, Cause::Request);
        player.set_hold(0);
        if player.heights_total() > 0 {
            player.bring_down();
            self.begin_return(player, reporting);
        }
        Ok(())
    }

    /// All pins come down, then the device takes moves.
    fn begin_return(&mut self, player: &Player, reporting: &mut Reporting) {
        (self.state, self.then) = (State::Returning, State::Armed);
        let (at, outstanding) = (player.rendered().wire(), player.heights_total());
        let return_ticks = Some(player.return_ticks());
        self.finish_cut(Cut { cause: Cause::Request, at, return_ticks, flushed: 0, outstanding }, reporting);
    }

    /// Shifts where a pin rests by one burst. At a lower stop a pin goes no further down: the pulses left push.
    pub(super) fn shift(
        &mut self,
        motor: u8,
        direction: Direction,
        pulses: u16,
        player: &mut Player,
    ) -> Result<(), Refusal> {
        if !self.is_idle(player) {
            return Err(Refusal::State);
        }
        let (travel, pushes) =
            self.pins.shifted(motor, direction, pulses, player.has_stop(), player.layout())?;
        if pulses > 0 {
            player.shift(motor, direction, pulses, pushes)?;
            self.pins.set_travel(motor, travel);
        }
        Ok(())
    }

    fn is_idle(&self, player: &Player) -> bool {
        self.is_armed() && player.is_at_rest()
    }

    /// Drives all pins down to the lower stop. Once they are there, the position is known and no return pulses are outstanding.
    pub(super) fn seek(
        &mut self,
        pulses: u16,
        player: &mut Player,
        reporting: &mut Reporting,
    ) -> Result<(), Refusal> {
        if !self.is_idle(player) {
            return Err(Refusal::State);
        }
        self.begin_seek(pulses, player, reporting)
    }

    fn begin_seek(
        &mut self,
        pulses: u16,
        player: &mut Player,
        reporting: &mut Reporting,
    ) -> Result<(), Refusal> {
        let layout = player.layout();
        let least = self.pins.least_seek(layout, |motor| player.height(motor));
        if !(least..=layout.max_seek()).contains(&pulses) {
            return Err(Refusal::Travel);
        }
        player.seek(pulses)?;
        player.set_hold(0);
        self.pins.begin_seek();
        self.begin_return(player, reporting);
        Ok(())
    }
}
