//! The daemon's state: eleven parts with one job each, behind the engine's one lock.
//!
//! - [`Commands`]: commands to the streamer, and the calls that wait for their answers.
//! - [`Plays`]: receipts, and the clients of plays.
//! - [`Calibration`]: the stored calibration, and a calibration that is being measured.
//! - [`Connection`]: the connected device, or the reason why there is none.
//! - [`Publisher`]: events to listeners and to the session record.
//! - [`Exposure`]: the participant's vibration, and the limits for it.
//! - [`Sessions`]: the running session, and who may act meanwhile.
//! - [`Rights`]: the client by whose right each play was ordered, and what a client may do ([`Caller`]).
//! - [`Armed`]: the client for which the motors are armed, and the silence that disarms them.
//! - [`Renderings`]: the running rendering, and the results of earlier ones.
//! - [`LivePlays`]: live plays, and the channels to their clients.
//!
//! A part uses no other part; a rule that concerns several is a method of [`State`]: here, in `sessions/rules.rs` and in
//! `exposure/rules.rs`. What one room does with it is a function of the room. There is one lock because such rules hold
//! across parts: a play is in the receipts before the streamer reports anything about it, and events are published in the order of the
//! receipts.
//!
//! Invariant: nothing here waits: the lock is held for microseconds.

use crate::daemon::arm::state::Armed;
use crate::daemon::calibration::Calibration;
use crate::daemon::core::commands::{Commands, Reply};
use crate::daemon::core::connection::{Connection, ConnectorMessage};
use crate::daemon::core::publisher::Publisher;
use crate::daemon::exposure::state::Exposure;
use crate::daemon::jobs::state::Renderings;
use crate::daemon::live::state::LivePlays;
use crate::daemon::plays::state::Plays;
use crate::daemon::sessions::caller::{Asker, Caller};
use crate::daemon::sessions::rights::Rights;
use crate::daemon::sessions::state::Sessions;
use crate::receipts::refusal;
use crate::record::Peer;
use meissner_api::{EndCause, Event, ItemState, MAX_ITEMS_LISTED, Problem};
use meissner_array::per_motor::PerMotor;
use meissner_array::strokes::Surplus;
use meissner_stream::queues::{Command, CommandError, StreamEvent};
use meissner_stream::time::HostInstant;
use meissner_stream::{Gains, Settings};

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct State {
    pub(in crate::daemon) commands: Commands,
    pub(in crate::daemon) plays: Plays,
    pub(in crate::daemon) calibration: Calibration,
    pub(in crate::daemon) connection: Connection,
    pub(in crate::daemon) publisher: Publisher,
    /// The streamer's settings, as it reported them last.
    pub(in crate::daemon) settings: Settings,
    pub(in crate::daemon) exposure: Exposure,
    pub(in crate::daemon) sessions: Sessions,
    pub(in crate::daemon) renderings: Renderings,
    pub(in crate::daemon) live: LivePlays,
    pub(in crate::daemon) rights: Rights,
    pub(in crate::daemon) armed: Armed,
    /// The number of the newest emergency stop that was noted, and who has ordered it.
    pub(in crate::daemon) last_estop: Option<(u64, Peer)>,
}

impl State {
    /// Sends a command, for the play of that id if it is about one.
    pub(in crate::daemon) fn send(
        &mut self,
        by: Option<&Asker>,
        mut command: Command,
        play: Option<u64>,
    ) -> Result<Reply, Problem> {
        self.check_asker(by)?;
        self.commands.accepts(&command)?;
        self.forget_unanswered();
        let held = self.hold_homing(&command)?;
        let caller = by.map(|by| by.caller.clone());
        let homes = caller.clone().filter(|_| matches!(command, Command::Home));
        match &mut command {
            Command::Arm { .. } | Command::ArmUnchecked => self.connection.armed_once = true,
            Command::Home => self.moves(caller),
            Command::Edge { by, .. } => *by = caller.map_or(0, |caller| self.rights.edges_of(caller)),
            _ => {}
        }
        let sent = self.commands.send(command, play);
        self.begin_homing(held, sent.is_ok());
        let reply = sent?;
        if let Some(caller) = homes {
            self.rights.set_homing(self.commands.last_ticket(), caller);
        }
        Ok(reply)
    }

    /// Applies an event of the streamer. Returns the API's event, and whether the log needs it.
    pub(in crate::daemon) fn apply(&mut self, mut streamed: StreamEvent) -> (Option<Event>, bool) {
        if let StreamEvent::Snapshot(snapshot) = &streamed {
            self.settings = snapshot.settings;
        }
        self.follow_exposure(&mut streamed);
        self.armed.follow(&mut streamed);
        self.live.follow(&streamed);
        let mut event = match &streamed {
            StreamEvent::Answer { ticket, result } => {
                self.end_homing(*ticket);
                self.rights.answered(*ticket);
                let play = self.commands.answer(*ticket, *result);
                play.and_then(|id| self.settle_play(id, result.is_ok()))
            }
            StreamEvent::Connected(_) => {
                self.connection.established();
                self.plays.receipts.apply(&streamed)
            }
            // A port without a board is opened again and again: report that only once.
            StreamEvent::Disconnected { reason, .. } => {
                let is_new = self.connection.lost(self.plays.receipts.kind(), reason);
                self.plays.receipts.apply(&streamed).filter(|_| is_new)
            }
            other => self.plays.receipts.apply(other),
        };
        if let Some(event) = &mut event {
            if let Event::Ended { receipt } = event {
                let warning = self.record_warning(receipt);
                receipt.reach.warnings.extend(warning);
            }
            self.publish_items(event);
            self.publish(event);
        }
        match &streamed {
            StreamEvent::Snapshot(_) => {
                if !self.is_armed() {
                    self.armed.end();
                }
                // Retry to end plays that could not be ended before, because too many commands waited.
                self.end_forbidden();
            }
            StreamEvent::PlayEnded { id, .. } => self.rights.forget_play(*id),
            _ => {}
        }
        if let StreamEvent::Disconnected { device, .. } = streamed {
            self.connection.tell_connector(ConnectorMessage::Gone(device));
        }
        // At its end, the daemon itself closes the device. One that is lost then has not confirmed that its lines are off.
        let expected =
            matches!(&event, Some(Event::Disconnected { reason }) if *reason == EndCause::Shutdown);
        (event, !expected)
    }

    /// Publishes the items that have begun of an ended play, unless the event has them.
    fn publish_items(&self, event: &Event) {
        let Event::Ended { receipt: ended } = event else { return };
        if ended.items.is_some() {
            return;
        }
        let receipt = self.plays.receipts.receipt(ended.id);
        let Some(items) = receipt.and_then(|receipt| receipt.items.clone()) else { return };
        let begun = items.iter().rposition(|item| item.state != ItemState::NotBegun).map_or(0, |at| at + 1);
        for items in items[..begun].chunks(MAX_ITEMS_LISTED) {
            let session = ended.session().map(str::to_owned);
            self.publisher.publish(&Event::Items { id: ended.id, session, items: items.to_vec() }, None);
        }
    }

    /// Publishes an event; the session record gets it with the user who ordered the play.
    pub(in crate::daemon) fn publish(&mut self, event: &Event) {
        let client = match event {
            Event::Ended { receipt } => self.plays.client(receipt.id),
            _ => None,
        };
        self.publisher.publish(event, client);
    }

    /// Takes the streamer's answer to a play. The id of a play that was not accepted goes to the next one.
    pub(in crate::daemon) fn settle_play(&mut self, id: u64, accepted: bool) -> Option<Event> {
        if !accepted {
            self.calibration.cancel(id);
            self.forget_exposure(id);
            self.live.forget(id);
            self.rights.forget_play(id);
        }
        let event = self.plays.settle(id, accepted);
        if accepted {
            self.moves(self.rights.of_play(id).cloned());
            // Count it here, not where the client is answered: the answer may come after the client's timeout.
            let session = self.plays.receipts.receipt(id).and_then(|receipt| receipt.session());
            self.sessions.count_play(session);
        }
        event
    }

    /// Gives up calls whose answers were lost, and their plays.
    pub(in crate::daemon) fn forget_unanswered(&mut self) {
        for id in self.commands.forget_unanswered(HostInstant::now()) {
            self.calibration.cancel(id);
            self.forget_exposure(id);
            self.live.forget(id);
            self.rights.forget_play(id);
            self.plays.forget(id);
        }
    }

    /// Notes that a client has ordered motion.
    fn moves(&mut self, caller: Option<Caller>) {
        if let Some(caller) = caller {
            self.armed.moves(caller);
        }
    }

    pub(in crate::daemon) fn is_armed(&self) -> bool {
        matches!(self.plays.receipts.device_state().state, "armed" | "returning")
    }

    /// Ends the running rendering, if there is one.
    pub(in crate::daemon) fn cancel_rendering(&mut self) {
        if let Some(event) = self.renderings.cancel() {
            self.publish(&event);
        }
    }

    /// The gains of the calibration in use, or those of motors without one.
    pub(in crate::daemon) fn gains(&self) -> PerMotor<Gains> {
        let gains = self.calibration.in_use().map(|stored| stored.calibration.gains());
        gains.unwrap_or_else(|| PerMotor::all(self.settings.array, Gains::default()))
    }

    /// How many times as far as ordered a play may take each pin, with these gains.
    pub(in crate::daemon) fn reach(&self, open_loop: bool) -> PerMotor<f64> {
        self.gains().map(|gains| gains.reach(open_loop))
    }

    /// The surplus of plays, from these gains.
    pub(in crate::daemon) fn surplus(&self) -> Surplus {
        self.settings.surplus(&self.gains())
    }

    /// Refuses a play during a calibration.
    pub(in crate::daemon) fn check_not_calibrating(&self) -> Result<(), Problem> {
        if self.calibration.running.is_some() { Err(refusal(CommandError::Playing)) } else { Ok(()) }
    }
}
