//! A board of the default array on a pseudo-terminal that notes when it receives an emergency stop.
//!
//! It is the mock in wall time, on a real-time thread where the system allows it, so that the load on the daemon does not delay
//! the measurement.

use firmware_protocol::tick::Tick;
use firmware_protocol::urgent::{Urgent, Watch};
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_stream::device::mock::Mock;
use meissner_stream::device::priority;
use meissner_stream::device::{Received, Terminal};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::time::{ClockId, clock_gettime};
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// See the module. Dropping it ends its thread.
#[derive(Debug)]
pub struct Board {
    path: PathBuf,
    /// The epoch and time of each emergency stop, once.
    estops: crossbeam_channel::Receiver<(u16, Instant)>,
    stop: Arc<AtomicBool>,
    clock: BoardClock,
    thread: Option<JoinHandle<()>>,
}

impl Board {
    /// Starts one.
    ///
    /// # Errors
    /// If the system gives no pseudo-terminal.
    pub fn start() -> io::Result<Self> {
        Self::with_clock_error(0.0)
    }

    /// Starts one whose clock runs fast by so many millionths.
    ///
    /// # Errors
    /// If the system gives no pseudo-terminal.
    pub fn with_clock_error(fast_ppm: f64) -> io::Result<Self> {
        let terminal = Terminal::open()?;
        let path = terminal.path().to_owned();
        let motors = SimulatedMotorsConfig { telemetry_hz: 0, ..SimulatedMotorsConfig::default() };
        let mock = Mock::new(Array::paper(), motors, 1).map_err(io::Error::other)?;
        let (told, estops) = crossbeam_channel::unbounded();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let clock = BoardClock {
            booted: Instant::now(),
            booted_ns: monotonic_ns(),
            hz: f64::from(Array::paper().rate().hz()) * (1.0 + fast_ppm / 1e6),
        };
        let thread = thread::Builder::new().name("board".into()).spawn(move || {
            let _ = priority::fifo(priority::FIFO_PRIORITY);
            serve(mock, clock, &terminal, &stopped, &told);
        })?;
        Ok(Self { path, estops, stop, clock, thread: Some(thread) })
    }

    /// The terminal to open as a serial port.
    pub const fn path(&self) -> &PathBuf {
        &self.path
    }

    /// When a tick of the board begins, by the host's `CLOCK_MONOTONIC`, ns.
    pub fn begin_of_ns(&self, tick: Tick) -> u64 {
        let passed = tick.since(Tick::BOOT) as f64 / self.clock.hz;
        self.clock.booted_ns + (passed * 1e9) as u64
    }

    /// When the board received each emergency stop: those since the last call, and later ones.
    pub const fn estops(&self) -> &crossbeam_channel::Receiver<(u16, Instant)> {
        &self.estops
    }
}

/// The clock of a board.
#[derive(Clone, Copy, Debug)]
struct BoardClock {
    booted: Instant,
    /// The same instant by the host's `CLOCK_MONOTONIC`.
    booted_ns: u64,
    hz: f64,
}

impl BoardClock {
    fn tick(&self) -> Tick {
        Tick::BOOT + (self.booted.elapsed().as_secs_f64() * self.hz) as u64
    }
}

fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

impl Drop for Board {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn serve(
    mut mock: Mock,
    clock: BoardClock,
    terminal: &Terminal,
    stop: &AtomicBool,
    told: &crossbeam_channel::Sender<(u16, Instant)>,
) {
    let (mut watch, mut last) = (Watch::new(), None);
    let (mut bytes, mut outgoing) = ([0; 4096], [0; 4096]);
    let millisecond = Timespec { tv_sec: 0, tv_nsec: 1_000_000 };
    while !stop.load(Ordering::Relaxed) {
        let _ = poll(&mut [PollFd::new(terminal, PollFlags::IN)], Some(&millisecond));
        loop {
            let len = match terminal.read(&mut bytes) {
                Received::Bytes(len) => len,
                Received::Nothing => break,
                // Without a daemon the poll returns at once, so wait here.
                Received::Closed => {
                    thread::sleep(Duration::from_millis(1));
                    break;
                }
            };
            for &byte in &bytes[..len] {
                if let Some(Urgent::EStop(epoch)) = watch.look(&[byte])
                    && last.replace(epoch) != Some(epoch)
                {
                    let _ = told.send((epoch, Instant::now()));
                }
            }
            mock.write(&bytes[..len]);
        }
        mock.run(clock.tick());
        loop {
            let len = mock.read(&mut outgoing);
            if len == 0 {
                break;
            }
            // The daemon reads all the time. Bytes that do not fit are lost, as on a real line.
            let _ = terminal.write(&outgoing[..len]);
        }
    }
}
