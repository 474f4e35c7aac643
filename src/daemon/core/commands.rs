//! Commands to the streamer: a ticket for each, and the calls that wait for their answers.
//!
//! Emergency stops go to the streamer by a separate switch; this module only holds the calls that wait for their answers.
//!
//! Bounds: the queue (a full one is [`Code::Busy`]), and the tickets of the last [`LOST_AFTER`].
//!
//! Invariant: each call gets an answer, or an error that there is none.

use meissner_api::{Code, Problem};
use meissner_array::per_motor::PerMotor;
use meissner_stream::Gains;
use meissner_stream::queues::{Command, CommandError, CommandQueue, ESTOP_TICKETS, EStopSwitch, Request};
use meissner_stream::time::HostInstant;
use std::collections::HashMap;
use std::time::Duration;
use tokio::sync::oneshot;

/// An answer that is still missing after this time will not come: commands expire after a second, and homing ends earlier.
pub(in crate::daemon) const LOST_AFTER: Duration = Duration::from_secs(30);

/// Where an answer arrives.
pub(in crate::daemon) type Reply = oneshot::Receiver<Result<(), CommandError>>;

/// A call that waits for the answer to a command.
#[derive(Debug)]
struct Ticket {
    reply: oneshot::Sender<Result<(), CommandError>>,
    issued_at: HostInstant,
    play: Option<u64>,
}

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Commands {
    queue: CommandQueue,
    last_ticket: u64,
    waiting: HashMap<u64, Ticket>,
    estop: EStopSwitch,
    /// The newest emergency stop whose answer has come as an event. The status then shows it, because events come in order.
    reported_estop: u64,
    /// Calls that wait for the emergency stop of this number.
    waiting_estops: Vec<(u64, oneshot::Sender<Result<(), CommandError>>)>,
    /// Whether the daemon is ending: then it accepts only emergency stops.
    closing: bool,
    /// The number of commands so far that cancel plays ordered before them.
    breaks: u64,
}

impl Commands {
    pub(in crate::daemon) fn new(queue: CommandQueue, estop: EStopSwitch) -> Self {
        let (waiting, waiting_estops) = Default::default();
        Self {
            queue,
            last_ticket: 0,
            waiting,
            estop,
            reported_estop: 0,
            waiting_estops,
            closing: false,
            breaks: 0,
        }
    }

    /// Whether a command may be sent now.
    pub(in crate::daemon) fn accepts(&self, command: &Command) -> Result<(), Problem> {
        if self.closing && !matches!(command, Command::Shutdown) {
            return Err(Problem::new(Code::ShuttingDown, "the daemon is ending: start it again"));
        }
        Ok(())
    }

    /// Sends a command, and returns where its answer arrives.
    pub(in crate::daemon) fn send(&mut self, command: Command, play: Option<u64>) -> Result<Reply, Problem> {
        self.note(&command);
        self.last_ticket += 1;
        let (ticket, issued_at) = (self.last_ticket, HostInstant::now());
        let (reply, receiver) = oneshot::channel();
        if self.queue.send(Request { ticket, issued_at, command }).is_err() {
            return Err(Problem::new(
                Code::Busy,
                "too many commands wait for the device: try again in a moment",
            ));
        }
        self.waiting.insert(ticket, Ticket { reply, issued_at, play });
        Ok(receiver)
    }

    /// The ticket of the command that was sent last.
    pub(in crate::daemon) const fn last_ticket(&self) -> u64 {
        self.last_ticket
    }

    const fn note(&mut self, command: &Command) {
        if matches!(command, Command::Stop | Command::Disarm | Command::Reset { .. }) {
            self.breaks += 1;
        }
    }

    /// The number of stops, disarms and resets of emergency stops so far.
    pub(in crate::daemon) const fn breaks(&self) -> u64 {
        self.breaks
    }

    /// Returns where the answer to the emergency stop of this number arrives, once the status shows it.
    pub(in crate::daemon) fn wait_for_estop(&mut self, number: u64) -> Reply {
        let (reply, receiver) = oneshot::channel();
        self.waiting_estops.retain(|(_, reply)| !reply.is_closed());
        self.waiting_estops.push((number, reply));
        self.answer_estops();
        receiver
    }

    fn answer_estops(&mut self) {
        for (number, reply) in std::mem::take(&mut self.waiting_estops) {
            match self.estop.answer(number) {
                // Ignore an error: the client may have hung up.
                Some(answer) if number <= self.reported_estop => drop(reply.send(answer)),
                _ => self.waiting_estops.push((number, reply)),
            }
        }
    }

    /// Sends a command for whose answer nothing waits; returns it if the queue is full.
    pub(in crate::daemon) fn send_unanswered(&mut self, command: Command) -> Result<(), Command> {
        self.note(&command);
        let request = Request { ticket: 0, issued_at: HostInstant::now(), command };
        self.queue.send(request).map_err(|request| request.command)
    }

    /// Makes the streamer correct bursts by these gains.
    pub(in crate::daemon) fn set_gains(&mut self, gains: PerMotor<Gains>) -> Result<(), Command> {
        self.send_unanswered(Command::SetGains(Box::new(gains)))
    }

    /// Passes an answer to the call that waits for it. Returns the play it is about.
    pub(in crate::daemon) fn answer(&mut self, ticket: u64, result: Result<(), CommandError>) -> Option<u64> {
        if let Some(number) = ticket.checked_sub(ESTOP_TICKETS) {
            self.reported_estop = self.reported_estop.max(number);
            self.answer_estops();
            return None;
        }
        let ticket = self.waiting.remove(&ticket)?;
        // Ignore an error: the client may have hung up.
        let _ = ticket.reply.send(result);
        ticket.play
    }

    /// Gives up tickets whose answers were lost. Returns their plays.
    pub(in crate::daemon) fn forget_unanswered(&mut self, now: HostInstant) -> Vec<u64> {
        let lost = self.waiting.extract_if(|_, ticket| now.since(ticket.issued_at) > LOST_AFTER);
        lost.filter_map(|(_, ticket)| ticket.play).collect()
    }

    /// Gives up every waiting call, because the streamer has ended, or did not end in time.
    pub(in crate::daemon) fn abandon(&mut self) {
        self.waiting.clear();
        self.waiting_estops.clear();
    }

    /// From now on accepts only emergency stops.
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
