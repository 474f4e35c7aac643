//! The streamer's thread: runs [`Streamer`] in real time around a device.
//!
//! [`spawn`] starts it and returns the ends of its queues. It uses SCHED_FIFO and locked memory where the system allows.
//! The loop reads the clock, moves bytes and sleeps until something is due, bytes arrive or a request comes; it decides
//! nothing.
//!
//! Invariant: the loop does not allocate, lock, log or wait, except for a session's memory when a device comes or goes;
//! whatever owns memory leaves through the event queue.

use crate::device::{Device, priority};
use crate::queues::{
    Command, CommandError, CommandQueue, Emit, EventQueue, StreamEvent, ThreadQueues, queues,
};
use crate::settings::Settings;
use crate::streamer::Streamer;
use crate::time::{HostInstant, random};
use firmware_protocol::frame::MAX_FRAME;
use meissner_api::{EndCause, Realtime};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::BorrowedFd;
use rustix::mm::{MlockAllFlags, mlockall};
use std::io;
use std::ops::Range;
use std::thread::JoinHandle;
use std::time::Duration;

/// Most rounds of reading and writing per wake-up: a device that never stops sending must not hold up requests.
const ROUNDS: usize = 32;
/// A port that takes no bytes for so long is gone.
const STUCK_FOR: Duration = Duration::from_millis(500);
/// Most reads per round, for the same reason.
const MAX_READS: usize = 16;

/// Starts the streamer's thread; also returns which real-time features the system granted.
///
/// # Errors
/// If the system gives no descriptors or no thread.
pub fn spawn(settings: Settings) -> io::Result<(CommandQueue, EventQueue, Realtime, JoinHandle<()>)> {
    let (thread_queues, commands, events) = queues()?;
    let (granted_in, granted) = crossbeam_channel::bounded(1);
    let thread = std::thread::Builder::new().name("streamer".into()).spawn(move || {
        let _ = granted_in.send(request_realtime());
        Turns::new(settings, thread_queues).run();
    })?;
    let realtime = granted.recv().unwrap_or_default();
    Ok((commands, events, realtime, thread))
}

/// Requests SCHED_FIFO for the calling thread and locked memory for the process; returns what the system granted.
pub fn request_realtime() -> Realtime {
    // Pages are locked at their first touch: unused memory costs nothing.
    let mlock = mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT).is_ok();
    Realtime { fifo: priority::fifo(priority::FIFO_PRIORITY), mlock }
}

/// The thread's loop, turn by turn.
#[derive(Debug)]
pub struct Turns {
    queues: ThreadQueues,
    streamer: Streamer,
    device: Option<Box<Device>>,
    /// The frame being written, and its unwritten bytes.
    frame: [u8; MAX_FRAME],
    unsent: Range<usize>,
    /// Since when the port takes no bytes.
    stuck_since: Option<HostInstant>,
}

impl Turns {
    /// The loop of a new streamer, without a device.
    pub fn new(settings: Settings, queues: ThreadQueues) -> Self {
        let streamer = Streamer::new(settings);
        Self { queues, streamer, device: None, frame: [0; MAX_FRAME], unsent: 0..0, stuck_since: None }
    }

    fn run(mut self) {
        while self.turn() {
            self.sleep();
        }
    }

    /// Does what is due. Returns whether it goes on: after a shutdown it hands back its device.
    pub fn turn(&mut self) -> bool {
        self.execute_requests(HostInstant::now());
        self.exchange();
        if !self.streamer.is_closed() {
            self.queues.wake_listener();
            self.queues.count_loop();
            return true;
        }
        if let Some(device) = self.device.take() {
            self.queues.event(StreamEvent::Disconnected { reason: EndCause::Shutdown, device: Some(device) });
        }
        self.queues.event(StreamEvent::ThreadEnded);
        self.queues.wake_listener();
        false
    }

    /// How long until the next turn is due, if no request comes before.
    pub fn wait(&self) -> Duration {
        let now = HostInstant::now();
        // While a frame is unwritten nothing else can be sent: wait for the port, not for what is due.
        let least = if self.unsent.is_empty() { Duration::from_micros(1) } else { Duration::from_millis(1) };
        self.streamer.wake_at(now).since(now).max(least)
    }

    /// Readable when there are requests.
    pub fn wake_fd(&self) -> BorrowedFd<'_> {
        self.queues.wake_fd()
    }

    fn execute_requests(&mut self, now: HostInstant) {
        while let Some(request) = self.queues.pop() {
            match request.command {
                Command::Connect(device) => {
                    let rate = device.rate();
                    let mut id = [0; 4];
                    // Without random numbers the time tells sessions apart.
                    let id = if random(&mut id) { u32::from_le_bytes(id) } else { now.as_ns() as u32 };
                    (self.unsent, self.stuck_since) = (0..0, None);
                    let old = self.device.replace(device);
                    self.streamer.connect(now, id, rate, &mut self.queues);
                    let reason = self.streamer.take_disconnect_reason();
                    if let (Some(reason), Some(old)) = (reason, old) {
                        self.queues.event(StreamEvent::Disconnected { reason, device: Some(old) });
                    }
                }
                Command::Edge { at, by } => {
                    let device = self.device.as_mut().ok_or(CommandError::NoDevice);
                    let result = device.and_then(|device| device.edge(HostInstant::now(), at, by));
                    if request.ticket != 0 {
                        self.queues.event(StreamEvent::Answer { ticket: request.ticket, result });
                    }
                }
                Command::WithdrawEdges(by) => {
                    if let Some(device) = &mut self.device {
                        device.withdraw_edges(by);
                    }
                }
                _ => self.streamer.execute(now, request, &mut self.queues),
            }
        }
    }

    /// Reads, decides and writes until there is nothing to write: the streamer reacts to a report in the wake-up that brought it.
    fn exchange(&mut self) {
        for _ in 0..ROUNDS {
            // Read first: after a stall the device may have ended the play long ago.
            let read = self.read();
            let now = HostInstant::now();
            let wrote = read.and_then(|()| {
                self.streamer.step(now, &mut self.queues);
                self.write(now)
            });
            if wrote.is_err() {
                self.streamer.disconnect(now, EndCause::Unplugged, &mut self.queues);
            }
            if let Some(reason) = self.streamer.take_disconnect_reason() {
                self.give_back(reason);
            }
            if !wrote.unwrap_or(false) {
                break;
            }
        }
    }

    fn write(&mut self, now: HostInstant) -> io::Result<bool> {
        let Self { queues, streamer, device: Some(device), .. } = self else { return Ok(false) };
        // Ahead of a frame that waits for room.
        if let Some(epoch) = streamer.take_e_stop() {
            device.e_stop(epoch);
        }
        let mut wrote = false;
        loop {
            if self.unsent.is_empty() {
                self.unsent = 0..streamer.transmit(now, &mut self.frame, queues);
            }
            if self.unsent.is_empty() {
                return Ok(wrote);
            }
            let len = device.write(&self.frame[self.unsent.clone()])?;
            if len == 0 {
                let since = *self.stuck_since.get_or_insert(now);
                let stuck = now.since(since) >= STUCK_FOR;
                return if stuck { Err(io::ErrorKind::TimedOut.into()) } else { Ok(wrote) };
            }
            self.stuck_since = None;
            self.unsent.start += len;
            wrote = true;
        }
    }

    fn read(&mut self) -> io::Result<()> {
        let Self { queues, streamer, device: Some(device), .. } = self else { return Ok(()) };
        let read = |bytes: &mut [u8]| device.read(HostInstant::now(), bytes);
        read_all(read, HostInstant::now, |now, bytes| streamer.receive(now, bytes, queues))
    }

    fn give_back(&mut self, reason: EndCause) {
        if let Some(device) = self.device.take() {
            (self.unsent, self.stuck_since) = (0..0, None);
            self.queues.event(StreamEvent::Disconnected { reason, device: Some(device) });
        }
    }

    fn sleep(&self) {
        let wait = self.wait();
        let timeout = Timespec { tv_sec: wait.as_secs() as i64, tv_nsec: wait.subsec_nanos().into() };
        let commands = PollFd::from_borrowed_fd(self.queues.wake_fd(), PollFlags::IN);
        // An early return, by a signal, only causes an idle round.
        let _ = match self.device.as_ref().and_then(|device| Some((device, device.wake()?))) {
            Some((device, wake)) => {
                let wants_room = !self.unsent.is_empty() && device.polls_writable();
                let for_what = if wants_room { PollFlags::IN | PollFlags::OUT } else { PollFlags::IN };
                poll(&mut [commands, PollFd::from_borrowed_fd(wake, for_what)], Some(&timeout))
            }
            None => poll(&mut [commands], Some(&timeout)),
        };
    }
}

/// Reads until nothing waits, and hands over the bytes, each time with an instant at which they were there.
///
/// The clock is read after the bytes. If the thread stands still in between, they only seem to come late. With an earlier
/// instant, a status that came meanwhile would have a tick that the device's clock has not reached, and a sound device would seem
/// faulty.
fn read_all(
    mut read: impl FnMut(&mut [u8]) -> io::Result<usize>,
    now: impl Fn() -> HostInstant,
    mut receive: impl FnMut(HostInstant, &[u8]),
) -> io::Result<()> {
    let mut bytes = [0; 1024];
    for _ in 0..MAX_READS {
        let len = read(&mut bytes)?;
        if len == 0 {
            break;
        }
        receive(now(), &bytes[..len]);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    /// The host stands still for 30 ms in each read, and the device goes on.
    #[test]
    fn bytes_never_seem_to_come_before_they_were_there() {
        let now = Cell::new(HostInstant::from_ns(1_000_000));
        let (mut came, mut received) = (Vec::new(), Vec::new());
        let read = |bytes: &mut [u8]| {
            now.set(now.get() + Duration::from_millis(30));
            came.push(now.get());
            bytes[0] = came.len() as u8;
            Ok(if came.len() > 3 { 0 } else { 1 })
        };
        read_all(read, || now.get(), |at, bytes| received.push((at, bytes.to_vec()))).unwrap();
        assert_eq!(received.len(), 3);
        for (number, (at, bytes)) in received.iter().enumerate() {
            assert_eq!(bytes, &[number as u8 + 1]);
            assert!(*at >= came[number], "{at:?} is before {:?}", came[number]);
        }
    }
}
