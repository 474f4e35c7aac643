//! Commands to the streamer: a ticket for each, and the calls that wait for its answer.
//!
//! Bounds: the queue (a full one is [`Code::Busy`]), and the tickets of the last [`LOST_AFTER`].
//!
//! Invariant: an emergency stop is always accepted, and always answered.

use firmware_protocol::stroke::MOTORS;
use meissner_api::{Code, Problem};
use meissner_stream::Gains;
use meissner_stream::queues::{Command, CommandError, CommandQueue, Request};
use meissner_stream::time::HostInstant;
use std::collections::HashMap;
use std::time::Duration;
use tokio::sync::oneshot;

/// An answer that is still missing after this time does not come: commands expire after a second, and homing ends before.
const LOST_AFTER: Duration = Duration::from_secs(30);

/// Where an answer arrives.
pub(in crate::daemon) type Reply = oneshot::Receiver<Result<(), CommandError>>;

/// Calls that wait for the answer to one command.
#[derive(Debug)]
struct Ticket {
    replies: Vec<oneshot::Sender<Result<(), CommandError>>>,
    issued_at: HostInstant,
    play: Option<u64>,
}

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Commands {
    queue: CommandQueue,
    last_ticket: u64,
    last_estop: u64,
    waiting: HashMap<u64, Ticket>,
    /// The daemon ends: it accepts emergency stops only.
    closing: bool,
}

impl Commands {
    pub(in crate::daemon) fn new(queue: CommandQueue) -> Self {
        Self { queue, last_ticket: 0, last_estop: 0, waiting: HashMap::new(), closing: false }
    }

    /// Whether a command may be sent now.
    pub(super) fn accepts(&self, command: &Command) -> Result<(), Problem> {
        if self.closing && !matches!(command, Command::EStop | Command::Shutdown) {
            return Err(Problem::new(Code::ShuttingDown, "the daemon is ending: start it again"));
        }
        Ok(())
    }

    /// Sends a command, and returns where its answer arrives.
    pub(super) fn send(&mut self, command: Command, play: Option<u64>) -> Result<Reply, Problem> {
        self.last_ticket += 1;
        let (ticket, issued_at) = (self.last_ticket, HostInstant::now());
        let (reply, receiver) = oneshot::channel();
        let estop = matches!(command, Command::EStop);
        if self.queue.send(Request { ticket, issued_at, command }).is_err() {
            if estop {
                // Only another emergency stop can have taken the last place: both get its answer.
                if let Some(ticket) = self.waiting.get_mut(&self.last_estop) {
                    ticket.replies.push(reply);
                }
                return Ok(receiver);
            }
            return Err(Problem::new(
                Code::Busy,
                "too many commands wait for the device: try again in a moment",
            ));
        }
        if estop {
            self.last_estop = ticket;
        }
        self.waiting.insert(ticket, Ticket { replies: vec![reply], issued_at, play });
        Ok(receiver)
    }

    /// Sends a command whose answer nothing waits for; gives it back if the queue is full.
    pub(in crate::daemon) fn send_unanswered(&mut self, command: Command) -> Result<(), Command> {
        let request = Request { ticket: 0, issued_at: HostInstant::now(), command };
        self.queue.send(request).map_err(|request| request.command)
    }

    /// Has the streamer correct by these gains.
    pub(in crate::daemon) fn set_gains(&mut self, gains: [Gains; MOTORS]) -> Result<(), Command> {
        self.send_unanswered(Command::SetGains(Box::new(gains)))
    }

    /// Passes an answer to the calls that wait for it. Returns the play it is about.
    pub(super) fn answer(&mut self, ticket: u64, result: Result<(), CommandError>) -> Option<u64> {
        let ticket = self.waiting.remove(&ticket)?;
        for reply in ticket.replies {
            // The client may have hung up meanwhile.
            let _ = reply.send(result);
        }
        ticket.play
    }

    /// Gives up tickets whose answers were lost. Returns their plays.
    pub(super) fn forget_unanswered(&mut self, now: HostInstant) -> Vec<u64> {
        let lost = self.waiting.extract_if(|_, ticket| now.since(ticket.issued_at) > LOST_AFTER);
        lost.filter_map(|(_, ticket)| ticket.play).collect()
    }

    /// Whether every command was answered.
    pub(super) fn is_idle(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Accepts emergency stops only from now on.
    pub(in crate::daemon) const fn close(&mut self) {
        self.closing = true;
    }

    pub(in crate::daemon) const fn is_closing(&self) -> bool {
        self.closing
    }

    /// How often the streamer's loop has run.
    pub(in crate::daemon) fn loop_count(&self) -> u64 {
        self.queue.loop_count()
    }

    /// Wakes the streamer, so that its loop runs once.
    pub(in crate::daemon) fn wake_streamer(&self) {
        self.queue.wake_thread();
    }
}
