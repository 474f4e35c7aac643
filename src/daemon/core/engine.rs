//! The engine: the daemon's state behind one lock, and the path of commands to the streamer.
//!
//! Request handlers, the event loop and the connector share it; what a room does with it is a function of the room. The streamer and
//! the controller decide about motors, not the engine.
//!
//! Invariant: no code waits while it holds the lock.

use crate::daemon::arm::estop::{EStops, Origin};
use crate::daemon::arm::state::Armed;
use crate::daemon::calibration::Calibration;
use crate::daemon::core::commands::{Commands, Reply};
use crate::daemon::core::connection::Connection;
use crate::daemon::core::names::Names;
use crate::daemon::core::publisher::{Publisher, frame};
use crate::daemon::core::state::State;
use crate::daemon::exposure::state::Exposure;
use crate::daemon::jobs::state::Renderings;
use crate::daemon::live::state::LivePlays;
use crate::daemon::net::gate::Gate;
use crate::daemon::plays::state::Plays;
use crate::daemon::sessions::caller::{Asker, DAEMON};
use crate::daemon::sessions::rights::Rights;
use crate::daemon::sessions::state::Sessions;
use crate::daemon::tokens::store::TokenStore;
use crate::receipts::refusal;
use crate::record::{Peer, Record, Users};
use axum::body::Bytes;
use meissner_api::{Code, Problem, Realtime};
use meissner_stream::device::mock::TruePositions;
use meissner_stream::queues::{Command, CommandError, CommandQueue, Heights};
use meissner_stream::time::HostInstant;
use meissner_stream::{Settings, longest_homing_s};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{Notify, broadcast, watch};
use tracing::{error, warn};

/// How long to wait for the streamer's answer. The streamer itself gives up after 1 s, and its answer counts: a client must not get
/// How long an order waits for the disk: less than the shortest time from an order to its requested onset.
pub(in crate::daemon) const DISK: Duration = Duration::from_millis(300);
/// a timeout while the motors are being armed.
pub(in crate::daemon) const TIMEOUT: Duration = Duration::from_millis(1250);
/// How long clients wait for the first device.
const FIRST_DEVICE: Duration = Duration::from_secs(2);
/// At shutdown the streamer itself waits for the device for a second.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_millis(1500);

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Engine {
    /// The requested device, as the configuration writes it.
    pub(in crate::daemon) wanted: String,
    /// Whether a device has answered or could not be opened.
    first_device_known: watch::Sender<bool>,
    /// Something has changed that no event of the streamer reports.
    pub(in crate::daemon) changed: Notify,
    /// A play has ended.
    pub(in crate::daemon) play_ended: Notify,
    /// The real-time rights that the system granted the streamer.
    pub(in crate::daemon) realtime: Realtime,
    /// Where the daemon listens.
    pub(in crate::daemon) socket: PathBuf,
    /// Decides about requests over the network.
    pub(in crate::daemon) gate: Arc<Gate>,
    pub(in crate::daemon) names: Names,
    pub(in crate::daemon) estops: Arc<EStops>,
    /// What the pins did lately.
    pub(in crate::daemon) heights: Heights,
    /// Held while the file of the calibration and the calibration in use change.
    pub(in crate::daemon) calibration_file: Mutex<()>,
    /// Held from the decision about a play until the streamer has it.
    pub(in crate::daemon) orders: tokio::sync::Mutex<()>,
    state: Mutex<State>,
}

impl Engine {
    /// On the paper's array, without a calibration.
    #[cfg(test)]
    pub(in crate::daemon) fn of_paper(commands: CommandQueue) -> Self {
        Self::new(commands, Settings::of(meissner_array::spec::Array::paper()), "mock".to_owned(), None)
    }

    pub(in crate::daemon) fn new(
        commands: CommandQueue,
        settings: Settings,
        wanted: String,
        calibration: Option<PathBuf>,
    ) -> Self {
        let estops = Arc::new(EStops::new(commands.estop_switch()));
        let heights = commands.heights();
        let state = State {
            commands: Commands::new(commands, estops.switch.clone()),
            plays: Plays::new(settings.array),
            calibration: Calibration::new(calibration),
            connection: Connection::default(),
            publisher: Publisher::new(Record::none()),
            exposure: Exposure::default(),
            sessions: Sessions::default(),
            renderings: Renderings::default(),
            live: LivePlays::default(),
            rights: Rights::default(),
            armed: Armed::default(),
            last_estop: None,
            settings,
        };
        Self {
            wanted,
            first_device_known: watch::channel(false).0,
            changed: Notify::new(),
            play_ended: Notify::new(),
            realtime: Realtime::default(),
            socket: PathBuf::new(),
            gate: Arc::new(Gate::new(None, None, TokenStore::open(None))),
            names: Names::default(),
            estops,
            heights,
            calibration_file: Mutex::default(),
            orders: tokio::sync::Mutex::default(),
            state: Mutex::new(state),
        }
    }

    /// Sets its session record, and who knows the names of users.
    pub(in crate::daemon) fn recording(self, record: Record, users: Arc<Users>) -> Self {
        self.lock().publisher = Publisher::new(record);
        Self { names: Names { users, ..self.names }, ..self }
    }

    /// Sets the granted real-time rights, and its socket.
    pub(in crate::daemon) fn with(self, realtime: Realtime, socket: PathBuf) -> Self {
        Self { realtime, socket, ..self }
    }

    /// Sets the gate for network clients.
    pub(in crate::daemon) fn with_gate(self, gate: Gate) -> Self {
        self.lock().rights.set_tokens(Arc::clone(&gate.tokens));
        Self { gate: Arc::new(gate), ..self }
    }

    pub(in crate::daemon) fn lock(&self) -> MutexGuard<'_, State> {
        // Nothing panics under this lock; even if something did, an emergency stop must go through.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(in crate::daemon) fn record(&self) -> Record {
        self.lock().publisher.record.clone()
    }

    /// A device has answered, or could not be opened.
    pub(in crate::daemon) fn set_first_device_known(&self) {
        self.first_device_known.send_replace(true);
    }

    /// Waits until a device has answered or could not be opened, for [`FIRST_DEVICE`] at most.
    pub(in crate::daemon) async fn first_device(&self) {
        let mut known = self.first_device_known.subscribe();
        let _ = tokio::time::timeout(FIRST_DEVICE, known.wait_for(|known| *known)).await;
    }

    /// The true positions of the simulated motors.
    pub(in crate::daemon) fn true_positions(&self) -> Option<Arc<TruePositions>> {
        self.lock().connection.true_positions.clone()
    }

    /// Sends a command to the streamer.
    pub(in crate::daemon) fn send(&self, by: Option<&Asker>, command: Command) -> Result<Reply, Problem> {
        self.lock().send(by, command, None)
    }

    /// Sends a command and waits for its answer.
    pub(in crate::daemon) async fn carry_out(
        &self,
        by: &Asker,
        command: Command,
        timeout: Duration,
    ) -> Result<(), Problem> {
        let reply = self.send(Some(by), command)?;
        answer(reply, timeout).await
    }

    /// Waits until what counts as vibration so far is on the disk, for [`DISK`] at most: what was answered survives a kill.
    pub(in crate::daemon) async fn on_disk(&self) {
        self.record().written(DISK).await;
    }

    /// How long to wait for an answer that may come after a seek of the lower stop.
    pub(in crate::daemon) fn seek_timeout(&self) -> Duration {
        TIMEOUT + self.lock().settings.seek_time()
    }

    /// How long homing may take: what the array needs, and more, because commands travel and other work may delay them.
    pub(in crate::daemon) fn home_timeout(&self) -> Duration {
        12 * TIMEOUT + Duration::from_secs_f64(longest_homing_s(self.lock().settings.array))
    }

    /// Orders an emergency stop and waits for the device's answer.
    pub(in crate::daemon) async fn estop(&self, peer: Peer) -> Result<(), Problem> {
        self.estop_answer(self.estops.request(Origin::of(peer)), peer).await
    }

    /// Waits for the answer to the emergency stop of this number, which this client has ordered.
    pub(in crate::daemon) async fn estop_answer(&self, number: u64, by: Peer) -> Result<(), Problem> {
        let reply = {
            let mut state = self.lock();
            if state.last_estop.is_none_or(|(newest, _)| newest < number) {
                state.last_estop = Some((number, by));
            }
            state.commands.wait_for_estop(number)
        };
        // The event with the answer may be lost; the switch keeps the answer.
        let waited = answer(reply, TIMEOUT).await;
        match self.estops.switch.answer(number) {
            // The stop is latched; the status shows that no device received it.
            Some(Ok(()) | Err(CommandError::NoDevice)) => Ok(()),
            Some(Err(error)) => Err(refusal(error)),
            None => waited,
        }
    }

    /// Refuses further commands; has the streamer return the pins and switch the motors off.
    pub(in crate::daemon) async fn shut_down(&self) {
        let reply = self.send(DAEMON, Command::Shutdown);
        self.lock().commands.close();
        match reply {
            Ok(reply) => {
                if let Err(problem) = answer(reply, SHUTDOWN_TIMEOUT).await {
                    warn!("shutting down: {problem}");
                }
            }
            Err(problem) => error!("shutting down: {problem}"),
        }
    }

    /// The state now, and every event from now on; none once the daemon ends.
    pub(in crate::daemon) fn subscribe(&self) -> Option<(Bytes, broadcast::Receiver<Bytes>)> {
        let state = self.lock();
        let receiver = state.publisher.subscribe()?;
        Some((frame(&state.plays.receipts.state_event(HostInstant::now())), receiver))
    }

    /// Takes the client of a play that has ended.
    pub(in crate::daemon) fn take_client(&self, play: u64) -> Option<Peer> {
        self.lock().plays.take_client(play)
    }
}

/// Waits for an answer.
pub(in crate::daemon) async fn answer(reply: Reply, timeout: Duration) -> Result<(), Problem> {
    match tokio::time::timeout(timeout, reply).await {
        Ok(Ok(result)) => result.map_err(refusal),
        Ok(Err(_)) => {
            let detail = "the daemon has ended before the device answered: the command may or may not be carried out; look at the \
                          pins, and start the daemon again";
            Err(Problem::new(Code::ShuttingDown, detail))
        }
        // Keep the ticket, so that a late answer still reaches the receipts.
        Err(_) => Err(refusal(CommandError::Timeout)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_stream::queues::{Emit, StreamEvent, queues};

    /// If the streamer does not end in time, waiting calls are answered at once, not after their own timeouts.
    #[test]
    fn calls_that_wait_at_the_end_are_answered() {
        let (_port, commands, _events) = queues().unwrap();
        let engine = Engine::of_paper(commands);
        let home = engine.send(DAEMON, Command::Home).unwrap();
        let number = engine.estops.request(Origin::UNKNOWN);
        let stop = engine.lock().commands.wait_for_estop(number);
        engine.lock().commands.abandon();
        let answers = crate::daemon::runtime().unwrap().block_on(async {
            // Far longer than the test may take.
            let long = Duration::from_secs(3600);
            [answer(home, long).await.unwrap_err(), answer(stop, long).await.unwrap_err()]
        });
        assert!(answers.iter().all(|problem| problem.code == "shutting-down"), "{answers:?}");
    }

    #[test]
    fn a_full_queue_takes_emergency_stops_and_answers_each() {
        let (mut port, commands, mut events) = queues().unwrap();
        let engine = Engine::of_paper(commands);
        let mut waiting = 0;
        let busy = loop {
            match engine.send(DAEMON, Command::Stop) {
                Ok(_) => waiting += 1,
                Err(problem) => break problem,
            }
        };
        assert_eq!(busy.code, "busy");
        let numbers = [(); 2].map(|()| engine.estops.request(Origin::UNKNOWN));
        let mut replies = numbers.map(|number| engine.lock().commands.wait_for_estop(number));
        for _ in 0..waiting {
            assert!(matches!(port.pop().unwrap().command, Command::Stop));
        }
        let estop = port.pop().unwrap();
        assert!(matches!(estop.command, Command::EStop) && port.pop().is_none(), "one does for both");
        assert_eq!(engine.estops.switch.confirmed_after(), None);
        port.event(StreamEvent::Answer { ticket: estop.ticket, result: Ok(()) });
        assert!(
            engine.estops.switch.confirmed_after().is_some(),
            "of the first, which the device has confirmed, too"
        );
        engine.lock().apply(events.pop().unwrap());
        for reply in &mut replies {
            assert_eq!(reply.try_recv(), Ok(Ok(())));
        }
        let mut late = engine.lock().commands.wait_for_estop(numbers[1]);
        assert_eq!(late.try_recv(), Ok(Ok(())), "answered already");
    }
}
