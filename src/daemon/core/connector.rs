//! The connector: a thread that opens the device, hands it to the streamer, and opens it again when it is gone.
//!
//! Opening and dropping a device may block; both happen only here. While there is no device, the connector tries every
//! [`RETRY_EVERY`], and at once when the system reports that a board was plugged in. While there is one, it sleeps.
//!
//! - A device that comes back is disarmed: a person arms it again.
//! - `auto` chooses once: the connector waits for a board that was pulled out, and does not replace it by the mock.
//! - If `auto` chose the mock, a board that comes later replaces it (a boot may be faster than the bus), until a client has armed
//!   the mock. From then on the mock stays: a user who works with a simulation must not suddenly move real pins.
//!
//! Invariant: at most one board is open; the old one is closed before the next is opened.

use crate::daemon::calibration::apply;
use crate::daemon::core::connection::ConnectorMessage;
use crate::daemon::core::engine::Engine;
use crate::daemon::core::state::State;
use crossbeam_channel::{Receiver, RecvError, Sender, bounded, never, select};
use meissner_array::per_motor::PerMotor;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_stream::Gains;
use meissner_stream::device::{self, Device, Spec};
use meissner_stream::queues::Command;
use std::io;
use std::sync::{Arc, MutexGuard};
use std::thread;
use std::time::Duration;
use tracing::{debug, info, warn};

/// Time between tries while there is no device.
const RETRY_EVERY: Duration = Duration::from_millis(250);
/// Time until a plugged-in board has its device files and rights.
const SETTLED: Duration = Duration::from_millis(500);
/// How often the connector tries to open a board in place of the mock: at boot that may take seconds.
const TRIES: usize = 10;

/// Starts the connector. The daemon does not wait for its end: a system call may hold it.
pub(in crate::daemon) fn spawn(
    spec: Spec,
    array: Array,
    motors: SimulatedMotorsConfig,
    engine: Arc<Engine>,
) -> io::Result<Sender<ConnectorMessage>> {
    let (sender, messages) = bounded(4);
    engine.lock().connection.set_connector(sender.clone());
    let connector = Connector {
        spec,
        array,
        motors,
        engine,
        messages,
        plugged: never(),
        failure: None,
        opened: String::new(),
    };
    thread::Builder::new().name("connector".into()).spawn(move || connector.run())?;
    Ok(sender)
}

struct Connector {
    spec: Spec,
    array: Array,
    motors: SimulatedMotorsConfig,
    engine: Arc<Engine>,
    messages: Receiver<ConnectorMessage>,
    /// A device with a board's ids was plugged in.
    plugged: Receiver<()>,
    /// Why the last try failed, and whether that was logged.
    failure: Option<(String, bool)>,
    /// The kind of the device that was opened last.
    opened: String,
}

impl Connector {
    fn run(mut self) {
        self.watch();
        loop {
            let gone = match device::open(&self.spec, self.array, &self.motors) {
                Ok(device) => {
                    self.note_opened(&device);
                    match connect(&self.engine, Box::new(device)) {
                        Ok(()) => self.wait_until_gone(),
                        Err(device) => Some(ConnectorMessage::Gone(Some(device))),
                    }
                }
                Err(error) => {
                    self.note_failure(error.to_string());
                    None
                }
            };
            match gone {
                Some(ConnectorMessage::Quit) => return,
                // Close it before the next try, which may use the same name.
                Some(ConnectorMessage::Gone(device)) => drop(device),
                None => {}
            }
            select! {
                recv(self.messages) -> message => match message {
                    Ok(ConnectorMessage::Gone(device)) => drop(device),
                    Ok(ConnectorMessage::Quit) | Err(_) => return,
                },
                recv(self.plugged) -> arrival => {
                    self.is_arrival(arrival);
                }
                default(RETRY_EVERY) => {}
            }
        }
    }

    /// Watches for boards that are plugged in, if the device may be one.
    fn watch(&mut self) {
        let Some(wanted) = self.spec.board() else { return };
        let (sender, plugged) = bounded(1);
        let arrived = move || {
            // One unread message is enough.
            let _ = sender.try_send(());
        };
        if device::watch(&wanted, arrived).unwrap_or(false) {
            self.plugged = plugged;
        }
    }

    /// Whether something was plugged in. A watch that has ended would always be ready, so it is replaced by one that never reports.
    fn is_arrival(&mut self, arrival: Result<(), RecvError>) -> bool {
        if arrival.is_err() {
            debug!("the system reports no more arrivals");
            self.plugged = never();
            return false;
        }
        debug!("something was plugged in");
        true
    }

    fn note_opened(&mut self, device: &Device) {
        self.failure = None;
        let kind = device.kind();
        if kind != self.opened {
            match (&self.spec, device) {
                (Spec::Auto, Device::Mock(_)) => {
                    warn!("no board was found: using the mock, no real pin moves; name one with --device");
                }
                _ => info!("opened {kind}"),
            }
        }
        if self.spec == Spec::Auto {
            self.spec = if matches!(device, Device::Mock(_)) { Spec::Mock } else { Spec::Board };
        }
        self.opened = kind;
    }

    /// Logs why there is no device: once per reason, at the second try, because a board that has just been plugged in gets its
    /// rights a moment later.
    fn note_failure(&mut self, line: String) {
        self.engine.lock().connection.missing = Some(line.clone());
        self.engine.set_first_device_known();
        match &mut self.failure {
            Some((before, logged)) if *before == line => {
                if !std::mem::replace(logged, true) {
                    warn!("{line}; looking every {} s", RETRY_EVERY.as_secs_f64());
                }
            }
            _ => self.failure = Some((line, false)),
        }
    }

    /// Waits until the device is gone or the daemon ends. Meanwhile a board may replace the mock.
    fn wait_until_gone(&mut self) -> Option<ConnectorMessage> {
        loop {
            select! {
                recv(self.messages) -> message => match message.unwrap_or(ConnectorMessage::Quit) {
                    ConnectorMessage::Gone(Some(device)) if self.is_replaced_mock(&device) => drop(device),
                    message => return Some(message),
                },
                recv(self.plugged) -> arrival => {
                    let mock = self.is_arrival(arrival) && self.spec == Spec::Mock;
                    let Some(board) = Spec::Board.board().filter(|_| mock) else { continue };
                    thread::sleep(SETTLED);
                    if device::is_plugged(&board) {
                        self.replace_mock();
                    }
                }
            }
        }
    }

    /// Whether this device is the mock that a board has replaced.
    fn is_replaced_mock(&self, device: &Device) -> bool {
        matches!(device, Device::Mock(_)) && self.spec == Spec::Board
    }

    fn replace_mock(&mut self) {
        let mut why_not = String::new();
        for _ in 0..TRIES {
            if self.engine.lock().connection.armed_once {
                "it has been armed".clone_into(&mut why_not);
                break;
            }
            match device::open(&Spec::Board, self.array, &self.motors) {
                Ok(device) => {
                    let kind = device.kind();
                    if replace_mock(&self.engine, Box::new(device)).is_ok() {
                        info!("opened {kind}, in the mock's place");
                        (self.spec, self.opened) = (Spec::Board, kind);
                        return;
                    }
                    "too many commands wait".clone_into(&mut why_not);
                }
                Err(error) => why_not = error.to_string(),
            }
            thread::sleep(SETTLED);
        }
        warn!(
            "a board was plugged in, the mock stays in use ({why_not}): restart the daemon to use the board"
        );
    }
}

/// Hands a device to the streamer, with its calibration; returns it if too many commands wait.
pub(in crate::daemon) fn connect(engine: &Engine, device: Box<Device>) -> Result<(), Box<Device>> {
    apply::load_calibration(engine, Some(&device.identity()));
    hand_over(engine.lock(), device)
}

/// Replaces the mock by a board; if a client has ever requested to arm, returns the board instead.
fn replace_mock(engine: &Engine, board: Box<Device>) -> Result<(), Box<Device>> {
    let mock = engine.lock().calibration.identity.clone();
    apply::load_calibration(engine, Some(&board.identity()));
    let state = engine.lock();
    let refused = if state.connection.armed_once {
        drop(state);
        board
    } else {
        match hand_over(state, board) {
            Ok(()) => return Ok(()),
            Err(board) => board,
        }
    };
    apply::load_calibration(engine, Some(&mock));
    Err(refused)
}

fn hand_over(mut state: MutexGuard<'_, State>, device: Box<Device>) -> Result<(), Box<Device>> {
    let array = state.settings.array;
    let gains = state.calibration.in_use().map(|stored| stored.calibration.gains());
    // No reset is needed if no gains were set.
    if gains.is_some() || state.calibration.gains_set {
        state.calibration.gains_set = gains.is_some();
        if state.commands.set_gains(gains.unwrap_or_else(|| PerMotor::all(array, Gains::default()))).is_err()
        {
            return Err(device);
        }
    }
    state.plays.receipts.set_device_kind(device.kind());
    state.connection.true_positions = device.true_positions();
    state.commands.send_unanswered(Command::Connect(device)).map_err(|command| match command {
        Command::Connect(device) => device,
        _ => unreachable!("a queue gives back what it was given"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::sessions::caller::DAEMON;
    use crossbeam_channel::TryRecvError;
    use meissner_stream::Settings;
    use meissner_stream::queues::queues;

    #[test]
    fn a_watch_that_has_ended_reports_nothing() {
        let (_port, commands, _events) = queues().unwrap();
        let spec = Spec::Serial("/nonexistent/tty".into());
        let engine = Arc::new(Engine::new(commands, Settings::of(Array::paper()), spec.to_string(), None));
        let ((arrivals, plugged), (sender, messages)) = (bounded(1), bounded(4));
        let mut connector = Connector {
            array: Array::paper(),
            spec,
            motors: SimulatedMotorsConfig::default(),
            engine,
            messages,
            plugged,
            failure: None,
            opened: String::new(),
        };
        arrivals.send(()).unwrap();
        let arrival = connector.plugged.recv();
        assert!(connector.is_arrival(arrival));
        drop(arrivals);
        let arrival = connector.plugged.recv();
        assert!(!connector.is_arrival(arrival));
        assert_eq!(connector.plugged.try_recv(), Err(TryRecvError::Empty));
        sender.send(ConnectorMessage::Gone(None)).unwrap();
        assert!(matches!(connector.wait_until_gone(), Some(ConnectorMessage::Gone(None))));
    }

    #[test]
    fn a_board_replaces_the_mock_until_that_was_armed() {
        let (mut port, commands, _events) = queues().unwrap();
        let engine = Engine::new(commands, Settings::of(Array::paper()), "auto".to_owned(), None);
        let device = || {
            Box::new(device::open(&Spec::Mock, Array::paper(), &SimulatedMotorsConfig::default()).unwrap())
        };
        connect(&engine, device()).unwrap();
        replace_mock(&engine, device()).unwrap();
        drop(engine.send(DAEMON, Command::Arm { assume_rest: false }).unwrap());
        assert!(engine.lock().connection.armed_once && replace_mock(&engine, device()).is_err());
        let jobs: Vec<Command> = std::iter::from_fn(|| port.pop()).map(|request| request.command).collect();
        assert!(
            matches!(jobs[..], [Command::Connect(_), Command::Connect(_), Command::Arm { .. }]),
            "{jobs:?}"
        );
    }
}
