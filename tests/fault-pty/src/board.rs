//! A board at the far end of a pseudo-terminal: the recorded mock in wall time, with faults.
//!
//! A thread runs it every millisecond, or when bytes come. The runner changes it with [`Board::with`].
//!
//! Invariant: bytes reach the controller at the tick of the instant at which they were read, never at an earlier one: a thread that
//! was late makes a fault look worse, not better.

use firmware_protocol::tick::Tick;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_stream::Line;
use meissner_stream::device::mock::Mock;
use meissner_stream::device::priority::{BELOW_STREAMER, fifo};
use meissner_stream::device::{Received, Terminal};
use meissner_stream::faulty::{DeviceClock, Direction, Liar};
use meissner_stream::time::HostInstant;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// The period of the thread.
const PERIOD: Duration = Duration::from_millis(1);

/// A running board. Its terminal keeps its name, as a board's serial port does.
pub(crate) struct Board {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    name: PathBuf,
}

struct Shared {
    state: Mutex<State>,
    stop: AtomicBool,
}

/// The board, its line and its terminal.
pub(crate) struct State {
    pub(crate) mock: Mock,
    pub(crate) clock: DeviceClock,
    pub(crate) liar: Option<Liar>,
    /// It does nothing, with its lines low.
    pub(crate) hangs: bool,
    to_device: Direction,
    to_host: Direction,
    terminal: Option<Arc<Terminal>>,
    /// A program has the terminal open.
    is_open: bool,
    /// The beginning of a frame, without its end.
    partial: Vec<u8>,
    unsent: Vec<u8>,
    ran: HostInstant,
    stood_still: Duration,
}

fn recorded(boot: u32) -> Mock {
    let mut mock = Mock::new(Array::paper(), SimulatedMotorsConfig::default(), boot).unwrap();
    mock.record();
    mock
}

impl Board {
    /// Plugs it in at this name.
    pub(crate) fn new(name: &Path, seed: u64) -> Self {
        let now = HostInstant::now();
        let state = State {
            mock: recorded(seed as u32),
            clock: DeviceClock::started(Array::paper().rate(), now),
            liar: None,
            hangs: false,
            to_device: Direction::new(Line::default(), seed ^ 0x5eed),
            to_host: Direction::new(Line::default(), seed ^ 0xfeed),
            terminal: None,
            is_open: false,
            partial: Vec::new(),
            unsent: Vec::new(),
            ran: now,
            stood_still: Duration::ZERO,
        };
        let shared = Arc::new(Shared { state: Mutex::new(state), stop: AtomicBool::new(false) });
        let of_thread = Arc::clone(&shared);
        let thread = thread::spawn(move || of_thread.run());
        let board = Self { shared, thread: Some(thread), name: name.to_owned() };
        board.plug();
        board
    }

    /// Changes the board, or reads something of it, between two of its steps.
    pub(crate) fn with<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        change(&mut self.shared.state.lock().unwrap())
    }

    /// The board's clock now.
    pub(crate) fn tick(&self) -> Tick {
        self.with(|state| state.clock.tick_at(HostInstant::now()))
    }

    /// The longest time in which the thread did not run.
    pub(crate) fn stood_still(&self) -> Duration {
        self.with(|state| state.stood_still)
    }

    /// Pulls the cable.
    pub(crate) fn unplug(&self) {
        let _ = std::fs::remove_file(&self.name);
        self.with(State::unplug);
    }

    /// Plugs it in again: another terminal, at the same name.
    pub(crate) fn plug(&self) {
        let terminal = Terminal::open().unwrap();
        let _ = std::fs::remove_file(&self.name);
        symlink(terminal.path(), &self.name).unwrap();
        self.with(|state| state.terminal = Some(Arc::new(terminal)));
    }

    /// It starts again, with another boot id. Returns what was played until then, on the clock of that time.
    pub(crate) fn restart(&self, boot: u32) -> Vec<(Tick, firmware_protocol::controller::Run)> {
        let _ = std::fs::remove_file(&self.name);
        let trace = self.with(|state| {
            let trace = state.mock.take_trace();
            state.unplug();
            state.mock = recorded(boot);
            state.clock.restart(HostInstant::now());
            state.hangs = false;
            trace
        });
        self.plug();
        trace
    }

    /// Its clock goes on by `time` at once: the host was suspended, and the board was not.
    pub(crate) fn suspend_host(&self, time: Duration) {
        self.with(|state| {
            for _ in 0..time.as_millis() {
                state.clock.jump(PERIOD);
                state.run(HostInstant::now());
            }
            state.ran = HostInstant::now();
        });
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
        let _ = std::fs::remove_file(&self.name);
    }
}

impl Shared {
    fn run(&self) {
        // A board is no process of this machine: it should run whenever the machine does. Without real-time priority it runs as
        // it can.
        let _ = fifo(BELOW_STREAMER);
        while !self.stop.load(Ordering::Relaxed) {
            let terminal = {
                let mut state = self.state.lock().unwrap();
                state.step();
                state.terminal.clone().filter(|_| state.is_open)
            };
            match terminal {
                Some(terminal) => {
                    let timeout = Timespec { tv_sec: 0, tv_nsec: PERIOD.subsec_nanos().into() };
                    let _ = poll(&mut [PollFd::new(&*terminal, PollFlags::IN)], Some(&timeout));
                }
                // A terminal that no program has open is always "ready".
                None => thread::sleep(PERIOD),
            }
        }
    }
}

impl State {
    /// Changes the line, towards the device and towards the host.
    pub(crate) fn set_lines(&mut self, (to_device, to_host): (Line, Line)) {
        (self.to_device.line, self.to_host.line) = (to_device, to_host);
    }

    /// Frames that the line has lost, repeated, damaged, delayed or held back.
    pub(crate) fn harmed(&self) -> u64 {
        self.to_device.harmed() + self.to_host.harmed()
    }

    /// Bytes come as if from the device.
    pub(crate) fn inject(&mut self, bytes: &[u8]) {
        self.to_host.send(HostInstant::now(), bytes);
    }

    fn unplug(&mut self) {
        self.terminal = None;
        self.closed();
    }

    /// No program has the terminal open any more.
    fn closed(&mut self) {
        if std::mem::take(&mut self.is_open) {
            self.mock.unplug();
        }
        self.to_device.clear();
        self.to_host.clear();
        self.partial.clear();
        self.unsent.clear();
    }

    fn step(&mut self) {
        let frames = self.receive();
        // The clock is read after the bytes, so that no byte counts as earlier than it was written.
        let now = HostInstant::now();
        self.stood_still = self.stood_still.max(now.since(self.ran));
        self.ran = now;
        self.to_device.send(now, &frames);
        self.run(now);
        self.transmit(now);
    }

    /// The frames that have come whole. The line gets only whole frames, because it loses whole ones.
    fn receive(&mut self) -> Vec<u8> {
        let Some(terminal) = self.terminal.clone() else { return Vec::new() };
        let mut bytes = [0; 4096];
        loop {
            match terminal.read(&mut bytes) {
                Received::Bytes(len) => {
                    self.is_open = true;
                    self.partial.extend(&bytes[..len]);
                }
                Received::Nothing => {
                    self.is_open = true;
                    break;
                }
                Received::Closed => {
                    self.closed();
                    return Vec::new();
                }
            }
        }
        let whole = self.partial.iter().rposition(|&byte| byte == 0).map_or(0, |end| end + 1);
        self.partial.drain(..whole).collect()
    }

    /// The mock plays up to now, takes in what has come, and answers.
    fn run(&mut self, now: HostInstant) {
        let arrived = self.to_device.arrived(now);
        if self.hangs {
            return;
        }
        let tick = self.clock.tick_at(now);
        self.mock.run(tick);
        if !arrived.is_empty() {
            self.mock.write(&arrived);
            self.mock.run(tick);
        }
        let mut bytes = [0; 4096];
        loop {
            let len = self.mock.read(&mut bytes);
            if len == 0 {
                break;
            }
            let to_host = &mut self.to_host;
            match &mut self.liar {
                Some(liar) => liar.change(&bytes[..len], |frame| to_host.send(now, frame)),
                None => to_host.send(now, &bytes[..len]),
            }
        }
    }

    fn transmit(&mut self, now: HostInstant) {
        self.unsent.extend(self.to_host.arrived(now));
        if let Some(terminal) = self.terminal.as_ref().filter(|_| self.is_open) {
            let sent = terminal.write(&self.unsent);
            self.unsent.drain(..sent);
        }
    }
}
